"""What one log says of each noise term, from the bins of its fit: for populations, where weak terms count."""

import math

from imucal.fitting.noise_fit import NoiseFit
from imucal.fitting.spectral.given_model import fit_bins, squared_coefficients
from imucal.fleet.log_value import LogValue
from imucal.fleet.poolable import bins_of, structure_of


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

    Every term has its value and limits, from a fit of the same `model` for every log, and its squared
    coefficient in SI squared with its law: an estimate without bias that may be negative, so that many weak
    logs together are right. A ramp has limits only.

    Raises
    ------
    DataError, ValueError
        As `pool`.
    """
    found = fit_bins(bins_of([fit]), structure_of(model, level), level=level)
    squares = squared_coefficients(found)
    values = {}
    for e in found.estimates:
        square = squares.get(e.key)
        values[e.key] = LogValue(
            unit=unit,
            value=e.value,
            low=e.low,
            high=e.high,
            variance=square.value if square else None,
            variance_sd=square.deviation if square else None,
            variance_growth=square.growth if square else 0.0,
            temperature_c=temperature_c,
            days=days,
            level=level,
            correlation_time=e.correlation_time.value if e.correlation_time else None,
        )
    return values
