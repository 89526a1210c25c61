"""Compute the Allan curve of an axis: the values, their degrees of freedom, and the averaging times."""

import re
from collections.abc import Sequence

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.allan.dct import Transform
from imucal.allan.intervals import degrees_of_freedom, gappy_degrees_of_freedom
from imucal.allan.variance import (
    GappyVariances,
    longest_run,
    run_variances,
    variances,
    window_variances,
)
from imucal.arrays import IntArray
from imucal.errors import ArgumentError, DataError
from imucal.recording import TINY, AxisSeries

#: A named set of averaging times with a number per decade.
_DECADE = re.compile(r"decade(?::(?P<count>[1-9]\d{0,3}))?")
#: Averaging times per decade if the name has no number.
_PER_DECADE = 10


def allan_curve(
    series: AxisSeries,
    *,
    taus: str | Sequence[float] = "octave",
    transform: Transform | None = None,
) -> AllanCurve:
    """Return the overlapping Allan variances (MOAV) of an axis, with their degrees of freedom.

    Parameters
    ----------
    series
        The axis; samples that are not finite count as missing.
    taus
        ``octave``, ``decade``, ``decade:20``, ``all``, or averaging times in s. The named sets except
        ``all`` end at about 2 degrees of freedom: m <= n/4.
    transform
        The transform of the finite samples, to save time; None computes it.

    Returns
    -------
    The curve. If samples are missing, averaging times without enough samples are left out, and the degrees of
    freedom come from the generic model nearest to the curve. `computed` contains the method.

    Raises
    ------
    DataError
        If there are too few samples, or a listed averaging time is out of range.
    ValueError
        If a set of averaging times is unknown.

    Source: IEEE Std 952-1997, Annex C; NIST SP 1065 (2008).
    """
    series = _axis(series).finite()
    refuse_tiny(series)
    if not series.clock.missing:
        computed, edf_method = "exact", "hybrid"
        m = _factors(series, taus, series.n)
        avar = variances(series.samples, m)
        edf = degrees_of_freedom(series.samples, m, transform)
    else:
        edf_method = "model"
        computed, values = _of_gaps(series, taus)
        m, avar = values.m, values.avar
        edf = gappy_degrees_of_freedom(series, values)
    return AllanCurve(
        tau=m.astype(np.float64) * series.tau0,
        m=m,
        avar=avar,
        edf=edf,
        n=series.n,
        computed=computed,
        edf_method=edf_method,
    )


def _axis(series: object) -> AxisSeries:
    if isinstance(series, AxisSeries):
        return series
    msg = f"found {type(series).__name__}, expected an axis; type imucal.allan_curve(recording['gyro_x'])"
    raise ArgumentError(msg)


def refuse_tiny(series: AxisSeries) -> None:
    """Raise DataError if the samples differ, but by less than any sensor's noise."""
    if not series.n:
        return
    span = float(series.samples.max()) - float(series.samples.min())
    if 0 < span < TINY:
        msg = (
            f"all samples are equal to {TINY:g} {series.unit}, expected noise; check the "
            "choice of "
            "columns, and the unit or scale"
        )
        raise DataError(msg, place=series.name)


def _of_gaps(series: AxisSeries, taus: str | Sequence[float]) -> tuple[str, GappyVariances]:
    """Return the method (``windows`` or ``runs``) and variances of a series with missing samples."""
    if series.clock.apart:
        m = _factors(series, taus, longest_run(series.clock))
        how, values = "runs", run_variances(series, m)
    else:
        m = _factors(series, taus, series.clock.grid_size)
        how, values = "windows", window_variances(series, m)
    if not values.m.size:
        msg = (
            f"too many samples are missing for an Allan variance: {series.n} of "
            f"{series.clock.grid_size} are present, without filled neighbouring windows or positive values"
        )
        raise DataError(msg, place=series.name)
    return how, values


def _factors(series: AxisSeries, taus: str | Sequence[float], span: int) -> IntArray:
    if span < 2:
        msg = f"{span} neighbouring samples are too few for an Allan variance; at least 2 are needed"
        raise DataError(msg, place=series.name)
    # A quarter of the span leaves about 2 to 4 degrees of freedom.
    drawn = max(span // 4, 1)
    return averaging_factors(taus, tau0=series.tau0, largest=span // 2, drawn=drawn, name=series.name)


def averaging_factors(
    taus: str | Sequence[float], *, tau0: float, largest: int, drawn: int, name: str = "series"
) -> IntArray:
    """Return distinct averaging factors, increasing, shape (k,), k >= 1.

    `taus` is as in `allan_curve`; others are a ValueError. A listed time beyond `largest`, or shorter than a
    sample, is a DataError that contains `name`. ``octave`` and ``decade`` end at `drawn`.
    """
    if not isinstance(taus, str):
        return _from_seconds(taus, tau0=tau0, largest=largest, name=name)
    if taus == "all":
        return np.arange(1, largest + 1, dtype=np.int64)
    if taus == "octave":
        return np.int64(1) << np.arange(drawn.bit_length(), dtype=np.int64)
    per_decade = _per_decade(taus)
    steps = np.arange(int(np.log10(drawn) * per_decade + 1e-9) + 1)
    return np.unique(np.round(10.0 ** (steps / per_decade)).astype(np.int64))


def _per_decade(taus: str) -> int:
    match = _DECADE.fullmatch(taus)
    if match is None:
        msg = (
            f"averaging times {taus!r} are not understood: expected 'octave', 'decade', 'decade:20', "
            "'all' or a list of seconds"
        )
        raise ArgumentError(msg)
    return int(match["count"] or _PER_DECADE)


def _from_seconds(taus: Sequence[float], *, tau0: float, largest: int, name: str) -> IntArray:
    seconds = np.asarray(taus, dtype=np.float64)
    if seconds.ndim != 1 or not seconds.size or not np.all(np.isfinite(seconds) & (seconds > 0)):
        raise ArgumentError(f"averaging times must be a list of positive seconds, got {taus!r}")
    factors = np.round(seconds / tau0)
    wrong = seconds[(factors < 1) | (factors > largest)]
    if wrong.size:
        msg = (
            f"the averaging time {wrong[0]:g} s is out of reach: the samples support "
            f"{tau0:g} s to {largest * tau0:g} s; leave it out or record longer"
        )
        raise DataError(msg, place=name)
    return np.unique(factors.astype(np.int64))
