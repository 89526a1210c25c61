"""Is the sampling rate one that an IMU has."""

from collections.abc import Sequence

from imucal.findings import Finding
from imucal.screening.profile import Profile

#: Slowest and fastest, in Hz: averages of 1 s are logged, and no bench instrument gives more than 100 kHz.
_SLOWEST, _FASTEST = 0.5, 150e3
#: Fastest of MEMS sensors, in Hz: 32 kHz, and some room for their clocks.
_FASTEST_MEMS = 40e3


def check_rate(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return an error for each rate that comes of stamps in another unit, or of a wrong rate given.

    Every density and every time of the result follows the rate. Instruments on a bench sample at up to
    100 kHz, which is also 100 Hz with stamps in a wrong unit: a rate between is a warning.
    """
    rates = dict.fromkeys(p.series.rate_hz for p in profiles)
    return tuple(_finding(rate) for rate in rates if not _SLOWEST <= rate <= _FASTEST_MEMS)


def _finding(rate_hz: float) -> Finding:
    advice = "Look at the unit of the stamps (s, ms, us, ns), or give the sampling rate in Hz."
    if _FASTEST_MEMS < rate_hz <= _FASTEST:
        text = f"The samples come at {rate_hz:.4g} Hz: no MEMS sensor is so fast."
        return Finding(level="warning", code="fast-rate", text=text, advice=advice)
    text = f"The samples come at {rate_hz:.4g} Hz: no IMU is so {'slow' if rate_hz < 1 else 'fast'}."
    return Finding(level="error", code="absurd-rate", text=text, advice=advice)
