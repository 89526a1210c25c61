"""Is the sampling rate one that an IMU has."""

from collections.abc import Sequence

from imucal.findings import Finding
from imucal.screening.profile import Profile

#: Slowest and fastest, in Hz: averages of 1 s are logged, and no IMU gives more than 32 kHz.
_SLOWEST, _FASTEST = 0.5, 40e3


def check_rate(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return an error for each rate that comes of stamps in another unit, or of a wrong rate given.

    Every density and every time of the result follows the rate.
    """
    rates = dict.fromkeys(p.series.rate_hz for p in profiles)
    return tuple(_finding(rate) for rate in rates if not _SLOWEST <= rate <= _FASTEST)


def _finding(rate_hz: float) -> Finding:
    return Finding(
        level="error",
        code="absurd-rate",
        text=f"The samples come at {rate_hz:.4g} Hz: no IMU is so {'slow' if rate_hz < 1 else 'fast'}.",
        advice="Look at the unit of the stamps (s, ms, us, ns), or give the sampling rate in Hz.",
    )
