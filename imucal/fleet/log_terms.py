"""What one log says of each noise term, from the bins of its fit: for populations, where weak terms count."""

import math

from imucal.fitting.noise_fit import NoiseFit
from imucal.fitting.spectral.bin_fit import fit_bins
from imucal.fitting.spectral.squared_coefficients import squared_coefficients
from imucal.fleet.log_value import LogValue
from imucal.fleet.poolable import bins_of, structure_of

#: A term so many deviations above zero is told by its limits, better than by a normal law of its variance.
_STRONG = 3.0


def log_values(
    unit: str,
    fit: NoiseFit,
    *,
    model: str = "N + B + K",
    level: float = 0.95,
    temperature_c: float = math.nan,
    days: float = math.nan,
) -> dict[str, LogValue]:
    """Return what one log says of each term, for `imucal.population`; from the bins of its fit.

    Every term has its value and limits, from a fit of the same `model` for every log. One that is not
    three deviations above zero has its squared coefficient and deviation too, in SI squared: an estimate
    without bias that may be negative, so that the mean of many weak logs is right.

    Raises
    ------
    DataError, ValueError
        As `pool`.

    Notes
    -----
    The deviation is that of a term which is one deviation above zero: in 100 simulated records of 10⁵
    samples it was 1.0 to 1.4 times the scatter there, 1.5 to 2.7 times where the term was absent or nearly
    so, 0.6 times at two and a half.
    """
    found = fit_bins(bins_of([fit]), structure_of(model, level), level=level)
    squares = squared_coefficients(found.problem, found.whole)
    values = {}
    for e in found.estimates:
        square = squares.get(e.key)
        weak = square is not None and square.value <= _STRONG * square.deviation
        values[e.key] = LogValue(
            unit=unit,
            value=e.value,
            low=e.low,
            high=e.high,
            variance=square.value if square and weak else None,
            variance_sd=square.deviation if square and weak else None,
            temperature_c=temperature_c,
            days=days,
            level=level,
            correlation_time=e.correlation_time.value if e.correlation_time else None,
        )
    return values
