"""Which fits may be pooled: they carry bins, and are of one sensor, one rate and one output filter."""

import math
from collections.abc import Sequence

from imucal.errors import DataError
from imucal.fitting.bins import Bins
from imucal.fitting.noise_fit import NoiseFit
from imucal.fitting.settings import FitSettings

#: Relative difference of two sampling rates, and of two filters' corners, that is none.
_SAME_RATE, _SAME_CORNER = 1e-3, 0.15


def structure_of(model: str, level: float) -> tuple[str, ...]:
    """Return the symbols of a sum of terms, the same for every record.

    Raises
    ------
    ValueError
        If the model is chosen by the record, or is no sum of terms.
    """
    structure = FitSettings(model=model, level=level).structure
    if structure is None:
        msg = "pool: model 'auto' would choose by the record; give the terms, such as 'N + B + K'"
        raise ValueError(msg)
    return structure


def bins_of(fits: Sequence[NoiseFit]) -> list[Bins]:
    """Return the bins that fits carry.

    Raises
    ------
    DataError
        If one has none.
    ValueError
        If there is no fit.
    """
    if not fits:
        msg = "pool: found no fits, expected at least one"
        raise ValueError(msg)
    every = []
    for number, fit in enumerate(fits, 1):
        if fit.bins is None:
            msg = (
                f"fit {number} of {len(fits)} ({fit.method}): found no bins, expected those of method 'mle'; "
                "fit the log again, and write its report with imucal fit --bins"
            )
            raise DataError(msg)
        every.append(fit.bins)
    return every


def refuse_different(fits: Sequence[NoiseFit]) -> None:
    """Refuse what is not of one sensor, one rate and one filter.

    Raises
    ------
    DataError
        That says which fit differs in what.
    """
    first = fits[0]
    for number, fit in enumerate(fits[1:], 2):
        where = f"fit {number} of {len(fits)}"
        if fit.sensor != first.sensor:
            msg = (
                f"{where}: found {_named(fit)}, expected {_named(first)} as in fit 1; pool one axis at a time"
            )
            raise DataError(msg)
        if abs(fit.rate_hz / first.rate_hz - 1) > _SAME_RATE:
            msg = (
                f"{where}: found {fit.rate_hz:.6g} Hz, expected {first.rate_hz:.6g} Hz as in fit 1; "
                "pool records of one sampling rate"
            )
            raise DataError(msg)
        if not _same_filter(first, fit):
            msg = (
                f"{where}: found {_filter(fit)}, expected {_filter(first)} as in fit 1; "
                "pool records of one setting of the sensor"
            )
            raise DataError(msg)


def _same_filter(one: NoiseFit, other: NoiseFit) -> bool:
    """Whether neither has an output filter, or both have one at about the same corner."""
    if one.response is None or other.response is None:
        return one.response is other.response
    return abs(math.log(one.response.cutoff_hz / other.response.cutoff_hz)) <= _SAME_CORNER


def _named(fit: NoiseFit) -> str:
    return "no sensor's name" if fit.sensor is None else f"the {fit.sensor}"


def _filter(fit: NoiseFit) -> str:
    if fit.response is None:
        return "no output filter"
    return f"an output filter at {fit.response.cutoff_hz:.4g} Hz"
