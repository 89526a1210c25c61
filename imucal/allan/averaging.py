"""Averaging factors m: octave, decade, all, or a list of seconds."""

import re
from collections.abc import Sequence

import numpy as np

from imucal.arrays import IntArray
from imucal.errors import DataError

_DECADE = re.compile(r"decade(?::(?P<count>[1-9]\d{0,3}))?")

#: Points per decade of ``decade``; ten is what data sheets draw.
_PER_DECADE = 10


def averaging_factors(
    taus: str | Sequence[float], *, tau0: float, largest: int, drawn: int, name: str = "series"
) -> IntArray:
    """Return distinct averaging factors, rising.

    Parameters
    ----------
    taus
        ``octave`` (1, 2, 4, …), ``decade`` or ``decade:20`` (so many a decade, evenly spaced in log,
        rounded to distinct integers), ``all``, or averaging times in s, each rounded to a whole
        number of samples.
    tau0
        Sampling period, in s.
    largest
        Largest factor that the estimator accepts, at least 1; ``all`` and a list may go up to it.
    drawn
        Largest factor of ``octave`` and ``decade``, beyond which a value has some 2 degrees of
        freedom or fewer; at least 1.
    name
        What a message calls the series.

    Returns
    -------
    Shape (k,), k >= 1.

    Raises
    ------
    ValueError
        If `taus` is not one of these.
    DataError
        If a listed averaging time is shorter than a sample or longer than the series supports.
    """
    if not isinstance(taus, str):
        return _from_seconds(taus, tau0=tau0, largest=largest, name=name)
    if taus == "all":
        return np.arange(1, largest + 1, dtype=np.int64)
    if taus == "octave":
        return np.int64(1) << np.arange(drawn.bit_length(), dtype=np.int64)
    match = _DECADE.fullmatch(taus)
    if match is None:
        msg = (
            f"averaging times {taus!r} are not understood: expected 'octave', 'decade', 'decade:20', "
            "'all' or a list of seconds"
        )
        raise ValueError(msg)
    per_decade = int(match["count"] or _PER_DECADE)
    steps = np.arange(int(np.log10(drawn) * per_decade + 1e-9) + 1)
    return np.unique(np.round(10.0 ** (steps / per_decade)).astype(np.int64))


def _from_seconds(taus: Sequence[float], *, tau0: float, largest: int, name: str) -> IntArray:
    seconds = np.asarray(taus, dtype=np.float64)
    if seconds.ndim != 1 or not seconds.size or not np.all(np.isfinite(seconds) & (seconds > 0)):
        msg = f"averaging times must be a list of positive seconds, got {taus!r}"
        raise ValueError(msg)
    factors = np.round(seconds / tau0)
    wrong = seconds[(factors < 1) | (factors > largest)]
    if wrong.size:
        msg = (
            f"{name}: the averaging time {wrong[0]:g} s is out of reach: the samples support "
            f"{tau0:g} s to {largest * tau0:g} s; leave it out or record longer"
        )
        raise DataError(msg)
    return np.unique(factors.astype(np.int64))
