"""From the samples of an axis to its Allan curve."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucal.allan.cascade import Cascade
from imucal.allan.confidence import degrees_of_freedom, gappy_degrees_of_freedom
from imucal.allan.curve import AllanCurve
from imucal.allan.estimators import Estimator, estimator_named
from imucal.allan.gaps import longest_run, run_variances, window_variances
from imucal.allan.variance import variances
from imucal.arrays import IntArray
from imucal.errors import DataError
from imucal.recording import AxisSeries
from imucal.resources import memory_limit

_DECADE = re.compile(r"decade(?::(?P<count>[1-9]\d{0,3}))?")

#: Points per decade of ``decade``; ten is what data sheets draw.
_PER_DECADE = 10
#: Bytes per sample that the exact curve works in: the integral and the transform of the intervals.
_WORK = 32
#: Samples of a mapped file that are looked at at once.
_PIECE = 1 << 20


def allan_curve(
    series: AxisSeries,
    *,
    taus: str | Sequence[float] = "octave",
    estimator: str = "overlapping",
    edf: str = "hybrid",
) -> AllanCurve:
    """Return the Allan curve of an axis, with the degrees of freedom of each value.

    Parameters
    ----------
    series
        The axis; samples that are not finite count as missing.
    taus
        ``octave``, ``decade``, ``decade:20``, ``all``, or averaging times in s. The named sets but
        ``all`` stop where a value has some 2 degrees of freedom: m <= n/4, n/6 for third differences.
    estimator
        ``overlapping`` (the Allan variance, MOAV), ``standard``, ``modified`` or ``hadamard``.
    edf
        ``hybrid``, ``model`` or ``greenhall``; see `imucal.allan.confidence`.

    Returns
    -------
    The curve. Where the samples are too many for a quarter of the machine's memory it is streamed
    (`computed` is ``cascade``). Where samples are missing, `computed` says how it was done (see
    `imucal.allan.gaps`), averaging times that the samples can't give are left out, and the degrees
    of freedom are those of the generic model nearest to the curve.

    Raises
    ------
    DataError
        If there are too few samples, or a listed averaging time is out of their reach.
    ValueError
        If an option is not one of these.

    Source: IEEE Std 952-1997, Annex C; NIST SP 1065 (2008).
    """
    chosen = _Choice(taus=taus, estimator=estimator_named(estimator), edf=edf)
    per_octave = chosen.factors_per_octave()
    if per_octave and _WORK * series.n > memory_limit():
        return _streamed(series, per_octave)
    series = series.finite()
    return _gappy(series, chosen) if series.clock.missing else _exact(series, chosen)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Choice:
    """What the caller asked for."""

    taus: str | Sequence[float]
    estimator: Estimator
    edf: str

    def factors_per_octave(self) -> int:
        """Return how dense a streamed curve is to be; 0 where only the exact one will do."""
        if self.estimator.name != "overlapping" or not isinstance(self.taus, str) or self.taus == "all":
            return 0
        name, _, per_decade = self.taus.partition(":")
        return 1 if name == "octave" else max(1, round(int(per_decade or 10) * np.log10(2)))


def _streamed(series: AxisSeries, per_octave: int) -> AllanCurve:
    """Return the curve by one pass in constant memory; what is not finite counts as missing."""
    cascade = Cascade(axes=1, per_octave=per_octave)
    for segment in series.clock.segments:
        cascade.gap()
        for start in range(segment.start, segment.stop, _PIECE):
            piece = series.samples[start : min(start + _PIECE, segment.stop)]
            for part in np.split(piece, np.flatnonzero(np.diff(np.isfinite(piece))) + 1):
                if np.isfinite(part[0]):
                    cascade.feed(part[None, :])
                else:
                    cascade.gap()
    return cascade.curve(0, rate_hz=series.rate_hz)


def _exact(series: AxisSeries, chosen: _Choice) -> AllanCurve:
    estimator = chosen.estimator
    m = _factors(series, chosen, series.n)
    return AllanCurve(
        tau=m.astype(np.float64) * series.tau0,
        m=m,
        avar=variances(series.samples, m, estimator),
        edf=degrees_of_freedom(series.samples, m, estimator, chosen.edf),
        n=series.n,
        estimator=estimator.name,
        edf_method=chosen.edf,
    )


def _gappy(series: AxisSeries, chosen: _Choice) -> AllanCurve:
    if chosen.estimator.name == "overlapping":
        how = "windows"
        values = window_variances(series, _factors(series, chosen, series.clock.grid_size))
    else:
        how = "runs"
        m = _factors(series, chosen, longest_run(series.clock))
        values = run_variances(series, m, chosen.estimator)
    if not values.m.size:
        msg = (
            f"{series.name}: too many samples are missing for an Allan variance: {series.n} of "
            f"{series.clock.grid_size} are there, and no neighbouring windows are filled or no value is "
            "above zero"
        )
        raise DataError(msg)
    return AllanCurve(
        tau=values.m.astype(np.float64) * series.tau0,
        m=values.m,
        avar=values.avar,
        edf=gappy_degrees_of_freedom(series, values, chosen.estimator, chosen.edf),
        n=series.n,
        estimator=chosen.estimator.name,
        computed=how,
        edf_method="model" if chosen.edf == "hybrid" else chosen.edf,
    )


def _factors(series: AxisSeries, chosen: _Choice, span: int) -> IntArray:
    """Return the averaging factors for a series of `span` places."""
    largest = chosen.estimator.largest(span)
    if largest < 1:
        needed = chosen.estimator.order + 1 - chosen.estimator.integrations
        msg = (
            f"{series.name}: {span} neighbouring samples are too few for the {chosen.estimator.name} "
            f"estimator; at least {needed} are needed"
        )
        raise DataError(msg)
    return averaging_factors(
        chosen.taus,
        tau0=series.tau0,
        largest=largest,
        drawn=chosen.estimator.drawn(span),
        name=series.name,
    )


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
