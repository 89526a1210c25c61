"""Compute the Allan curve of an axis: directly, or by a cascade if the log does not fit in memory.

The cascade passes once over all axes in constant memory, octave by octave. Level j contains every 2^j-th
point of the integrated samples and computes the factors m' 2^j with m' from 128 to 255. Level 0 computes
every factor below 256 exactly. Start points of a large factor are therefore at most m/128 apart: values
differ from the exact ones by about 0.2 % of the interval's width (at m/32 by up to 2 %). The degrees of
freedom account for this.
"""

import re
from collections.abc import Sequence

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.allan.intervals import degrees_of_freedom, fit_curve, gappy_degrees_of_freedom, model_edf
from imucal.allan.variance import (
    ESTIMATORS,
    Estimator,
    GappyVariances,
    SquareSum,
    estimator_named,
    longest_run,
    run_variances,
    variances,
    window_variances,
)
from imucal.arguments import takes
from imucal.arrays import FloatArray, IntArray
from imucal.errors import ArgumentError, DataError
from imucal.recording import AxisSeries
from imucal.resources import memory_limit

#: Level 0 computes the factors below twice this; every other level the factors from this to twice this.
_BASE = 128
#: Points a level collects before it processes them: most at level 0, fewest at high levels.
_BLOCK, _SMALLEST_BLOCK = 32768, 4096
#: The mean of this many first samples is subtracted, so that the integral stays small.
_REFERENCE = 65536
#: Named set of averaging times, and its default number per decade, as in data sheets.
_DECADE, _PER_DECADE = re.compile(r"decade(?::(?P<count>[1-9]\d{0,3}))?"), 10
#: Bytes per sample used by the exact curve: the integral and the transform for the intervals.
_WORK = 32
#: Samples of a mapped file read at a time.
_PIECE = 1 << 20

_OVERLAPPING = ESTIMATORS["overlapping"]


class Cascade:
    """Allan variances of several axes with one clock, fed block by block.

    There are `per_octave` factors per octave, from 1 to 32, evenly spaced in log and rounded to distinct
    integers. Memory is about 2 MB per axis for any length. `curve` may be called at any time between blocks.
    """

    def __init__(self, *, axes: int, per_octave: int = 1) -> None:
        if axes < 1 or not 1 <= per_octave <= _BASE:
            raise ArgumentError(
                f"need axes >= 1 and per_octave from 1 to {_BASE}, got {axes} and {per_octave}"
            )
        steps = np.arange(per_octave * _BASE.bit_length()) / per_octave
        low = np.unique(np.round(2.0**steps).astype(np.int64))
        self._axes = axes
        self._first = low[low < 2 * _BASE]
        self._later = self._first[self._first >= _BASE]
        self._levels = [_Level(self._first, axes, _BLOCK)]
        self._reference: FloatArray = np.zeros((axes, 1))
        self._last = np.zeros((axes, 1))
        self._started = False
        self._n = 0

    @property
    def n(self) -> int:
        """Number of samples fed so far, per axis."""
        return self._n

    def feed(self, samples: FloatArray) -> None:
        """Add the next samples, shape (axes, k), of any k; another shape is a ValueError.

        A value that is not finite is a DataError; call `gap` for missing samples.
        """
        block = np.asarray(samples)
        if block.ndim != 2 or block.shape[0] != self._axes:
            raise ArgumentError(f"samples must have shape ({self._axes}, k), got {block.shape}")
        if self._n == 0 and block.shape[1]:
            self._reference = np.asarray(block[:, :_REFERENCE], dtype=np.float64).mean(axis=1, keepdims=True)
        for start in range(0, block.shape[1], _BLOCK):
            self._feed_part(np.array(block[:, start : start + _BLOCK], dtype=np.float64, order="C"))

    def gap(self) -> None:
        """Mark missing samples here: no difference spans this place."""
        self._settle()
        for level in self._levels:
            level.forget()
        self._started = False

    def curve(self, axis: int, *, rate_hz: float) -> AllanCurve:
        """Return the curve of one axis so far, up to m = n/4.

        Fewer than 2 samples are a DataError. The degrees of freedom come from the generic model nearest to
        the curve.
        """
        self._settle()
        shifts = np.repeat(np.arange(len(self._levels)), [level.m.size for level in self._levels])
        stride = np.int64(1) << shifts
        m = np.concatenate([level.m for level in self._levels]) * stride
        terms = np.concatenate([level.terms for level in self._levels])
        sums = np.concatenate([level.sums(axis) for level in self._levels])
        keep = (terms > 0) & (m <= _OVERLAPPING.drawn(self._n))
        if not keep.any():
            msg = f"{self._n} samples are too few for an Allan variance; at least 2 neighbours are needed"
            raise DataError(msg)
        m, stride, terms = m[keep], stride[keep], terms[keep]
        avar = sums[keep] / (2.0 * m.astype(np.float64) ** 2 * terms)
        model = fit_curve(m, avar, np.maximum(terms * stride / m, 1.0))
        edf = [
            model_edf(model, factor, count, _OVERLAPPING, stride=step)
            for factor, count, step in zip(m.tolist(), terms.tolist(), stride.tolist(), strict=True)
        ]
        return AllanCurve(
            tau=m.astype(np.float64) / rate_hz,
            m=m,
            avar=avar,
            edf=np.array(edf),
            n=self._n,
            computed="cascade",
            edf_method="model",
        )

    def _feed_part(self, part: FloatArray) -> None:
        if not np.isfinite(part.sum()):
            msg = f"the samples after number {self._n} are not all finite; leave those out and call gap()"
            raise DataError(msg)
        self._n += part.shape[1]
        part -= self._reference
        np.cumsum(part, axis=1, out=part)
        part += self._last
        if not self._started:
            part = np.concatenate([self._last, part], axis=1)
            self._started = True
        self._last = part[:, -1:].copy()
        self._put(0, part)

    def _put(self, index: int, points: FloatArray) -> None:
        """Pass points of the integral, shape (axes, k), to a level and every second one to the next."""
        level = self._levels[index]
        taken = 0
        while taken < points.shape[1]:
            taken += level.take(points[:, taken:])
            if level.full:
                self._pass_on(index)

    def _pass_on(self, index: int) -> None:
        points = self._levels[index].work()
        if index + 1 == len(self._levels):
            block = max(_BLOCK >> min(index + 1, 3), _SMALLEST_BLOCK)
            self._levels.append(_Level(self._later, self._axes, block))
        self._put(index + 1, points)

    def _settle(self) -> None:
        """Process the waiting points of every level that is long enough for a difference."""
        index = 0
        while index < len(self._levels):
            if self._levels[index].ready:
                self._pass_on(index)
            index += 1


class _Level:
    """Points of the integral at one decimation; keeps the last ones between blocks."""

    def __init__(self, m: IntArray, axes: int, block: int) -> None:
        self.m = m
        self.terms = np.zeros(m.size, dtype=np.int64)
        self._reach = 2 * int(m.max())
        self._points = np.empty((axes, self._reach + block))
        self._block = block
        self._kept = 0
        self.waiting = 0
        self._odd = 0
        self._lower = np.empty(self._reach + block)
        self._upper = np.empty(block)
        self._sums = [[SquareSum(self._upper) for _ in range(axes)] for _ in range(m.size)]

    @property
    def full(self) -> bool:
        return bool(self.waiting == self._block)

    @property
    def ready(self) -> bool:
        return self.waiting > 0 and self._kept + self.waiting > 2 * int(self.m.min())

    def take(self, points: FloatArray) -> int:
        """Store as many points as fit; return their number."""
        count: int = min(self._block - self.waiting, points.shape[1])
        start = self._kept + self.waiting
        self._points[:, start : start + count] = points[:, :count]
        self.waiting += count
        return count

    def work(self) -> FloatArray:
        """Add the differences that end in the waiting points; return every second of those points."""
        end = self._kept + self.waiting
        for i, m in enumerate(self.m.tolist()):
            start = max(self._kept - 2 * m, 0)
            count = end - start - 2 * m
            if count > 0:
                self.terms[i] += count
                for values, square in zip(self._points, self._sums[i], strict=True):
                    lower, upper = self._lower[: count + m], self._upper[:count]
                    np.subtract(values[start + m : end], values[start : end - m], out=lower)
                    np.subtract(lower[m:], lower[:-m], out=upper)
                    square.add(count)
        passed = self._points[:, self._kept + self._odd : end : 2].copy()
        self._odd = (self._odd + self.waiting) % 2
        keep = min(self._reach, end)
        self._points[:, :keep] = self._points[:, end - keep : end].copy()
        self._kept, self.waiting = keep, 0
        return passed

    def sums(self, axis: int) -> list[float]:
        """Return the sum of squares of each factor."""
        return [row[axis].total() for row in self._sums]

    def forget(self) -> None:
        """Drop the kept points, because a gap follows."""
        self._kept = self.waiting = self._odd = 0


@takes('imucal.allan_curve(recording["gyro_x"])', series=AxisSeries)
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
        ``octave``, ``decade``, ``decade:20``, ``all``, or averaging times in s. The named sets except
        ``all`` end at about 2 degrees of freedom: m <= n/4, n/6 for third differences.
    estimator
        ``overlapping`` (the Allan variance, MOAV), ``standard``, ``modified`` or ``hadamard``.
    edf
        ``hybrid``, ``model`` or ``greenhall``; see `imucal.allan.intervals`.

    Returns
    -------
    The curve. If the samples need more than a quarter of the machine's memory, it is streamed
    (`computed` is ``cascade``). If samples are missing, `computed` contains the method (see
    `imucal.allan.variance`), averaging times without enough samples are left out, and the degrees of
    freedom come from the generic model nearest to the curve.

    Raises
    ------
    DataError
        If there are too few samples, or a listed averaging time is out of range.
    ValueError
        If an option is unknown.

    Source: IEEE Std 952-1997, Annex C; NIST SP 1065 (2008).
    """
    chosen = estimator_named(estimator)
    if (
        chosen is _OVERLAPPING
        and isinstance(taus, str)
        and taus != "all"
        and _WORK * series.n > memory_limit()
    ):
        per_octave = 1 if taus == "octave" else max(1, round(_per_decade(str(taus)) * np.log10(2)))
        return _streamed(series, per_octave)
    series = series.finite()
    if not series.clock.missing:
        computed, m = "exact", _factors(series, taus, chosen, series.n)
        avar = variances(series.samples, m, chosen)
        freedom = degrees_of_freedom(series.samples, m, chosen, edf)
    else:
        computed, values = _of_gaps(series, taus, chosen)
        m, avar = values.m, values.avar
        freedom = gappy_degrees_of_freedom(series, values, chosen, edf)
        edf = "model" if edf == "hybrid" else edf
    return AllanCurve(
        tau=m.astype(np.float64) * series.tau0,
        m=m,
        avar=avar,
        edf=freedom,
        n=series.n,
        estimator=estimator,
        computed=computed,
        edf_method=edf,
    )


def same_curve(series: AxisSeries, curve: AllanCurve) -> AllanCurve:
    """Return the curve of an axis with the averaging times, estimator and method of another curve."""
    edf = curve.edf_method or "hybrid"
    return allan_curve(series, taus=curve.tau.tolist(), estimator=curve.estimator, edf=edf)


def _streamed(series: AxisSeries, per_octave: int) -> AllanCurve:
    """Return the curve by one pass in constant memory; values that are not finite count as missing."""
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


def _of_gaps(
    series: AxisSeries, taus: str | Sequence[float], estimator: Estimator
) -> tuple[str, GappyVariances]:
    """Return the method (``windows`` or ``runs``) and variances of a series with missing samples."""
    if estimator.name == "overlapping" and not series.clock.apart:
        m = _factors(series, taus, estimator, series.clock.grid_size)
        how, values = "windows", window_variances(series, m)
    else:
        m = _factors(series, taus, estimator, longest_run(series.clock))
        how, values = "runs", run_variances(series, m, estimator)
    if not values.m.size:
        msg = (
            f"{series.name}: too many samples are missing for an Allan variance: {series.n} of "
            f"{series.clock.grid_size} are present, without filled neighbouring windows or positive values"
        )
        raise DataError(msg)
    return how, values


def _factors(series: AxisSeries, taus: str | Sequence[float], estimator: Estimator, span: int) -> IntArray:
    """Return the averaging factors for a series that spans `span` sampling periods."""
    largest = estimator.largest(span)
    if largest < 1:
        needed = estimator.order + 1 - estimator.integrations
        msg = (
            f"{series.name}: {span} neighbouring samples are too few for the {estimator.name} "
            f"estimator; at least {needed} are needed"
        )
        raise DataError(msg)
    return averaging_factors(
        taus, tau0=series.tau0, largest=largest, drawn=estimator.drawn(span), name=series.name
    )


def averaging_factors(
    taus: str | Sequence[float], *, tau0: float, largest: int, drawn: int, name: str = "series"
) -> IntArray:
    """Return distinct averaging factors, increasing, shape (k,), k >= 1.

    `taus` is ``octave`` (1, 2, 4, …), ``decade`` or ``decade:20`` (20 per decade, evenly spaced in log,
    rounded to distinct integers), ``all``, or averaging times in s, each rounded to a whole number of samples
    of period `tau0` in s; others are a ValueError. `largest` is the estimator's largest factor and limits
    ``all`` and lists. A listed time beyond it, or shorter than a sample, is a DataError that contains `name`.
    ``octave`` and ``decade`` end at `drawn`, beyond which a value has about 2 degrees of freedom or fewer.
    Both limits are at least 1.
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
            f"{name}: the averaging time {wrong[0]:g} s is out of reach: the samples support "
            f"{tau0:g} s to {largest * tau0:g} s; leave it out or record longer"
        )
        raise DataError(msg)
    return np.unique(factors.astype(np.int64))
