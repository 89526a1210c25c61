"""The streaming octave cascade: one pass over all axes, constant memory, for logs beyond memory.

Level j holds every 2^j-th point of the integrated samples and serves the factors m' 2^j with m'
from 128 to 255; level 0 serves every factor below 256 and is exact. So the start points of a large
factor lie at most m/128 apart: values differ from the exact ones by some 0.2 % of their interval's
width (at m/32 by up to 2 %), and the degrees of freedom count it.
"""

import numpy as np

from imucal.allan.covariance import model_edf
from imucal.allan.curve import AllanCurve
from imucal.allan.estimators import ESTIMATORS
from imucal.allan.generic import fit_curve
from imucal.allan.variance import SquareSum
from imucal.arrays import FloatArray, IntArray
from imucal.errors import DataError

#: Level 0 serves the factors below twice this, every other level those from this up.
_BASE = 128

#: Points a level takes in before it works on them; the axes take turns in the cache.
_BLOCK = 32768
_SMALLEST_BLOCK = 4096

#: The mean of so many first samples is taken out, so that the integral stays small.
_REFERENCE = 65536

_OVERLAPPING = ESTIMATORS["overlapping"]


class Cascade:
    """Allan variances of several axes of one clock, fed block by block.

    Parameters
    ----------
    axes
        Number of axes.
    per_octave
        Factors per octave, from 1 to 32, evenly spaced in log and rounded to distinct integers.

    Notes
    -----
    Memory is some 2 MB an axis, however long the log is. A curve can be taken at any time;
    feeding may go on after it.
    """

    def __init__(self, *, axes: int, per_octave: int = 1) -> None:
        if axes < 1 or not 1 <= per_octave <= _BASE:
            msg = f"need axes >= 1 and per_octave from 1 to {_BASE}, got {axes} and {per_octave}"
            raise ValueError(msg)
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
        """Take in the next samples, shape (axes, k), of any k.

        Raises
        ------
        ValueError
            If the shape is not (axes, k).
        DataError
            If a sample is not finite; `gap` is how a break is told.
        """
        block = np.asarray(samples)
        if block.ndim != 2 or block.shape[0] != self._axes:
            msg = f"samples must have shape ({self._axes}, k), got {block.shape}"
            raise ValueError(msg)
        if self._n == 0 and block.shape[1]:
            self._reference = np.asarray(block[:, :_REFERENCE], dtype=np.float64).mean(axis=1, keepdims=True)
        for start in range(0, block.shape[1], _BLOCK):
            self._feed_part(np.array(block[:, start : start + _BLOCK], dtype=np.float64, order="C"))

    def gap(self) -> None:
        """Say that samples are missing here: no difference will span the place."""
        self._settle()
        for level in self._levels:
            level.forget()
        self._started = False

    def curve(self, axis: int, *, rate_hz: float) -> AllanCurve:
        """Return the curve of one axis so far, up to m = n/4.

        The degrees of freedom are those of the generic model nearest to the curve.

        Raises
        ------
        DataError
            If fewer than 2 samples were fed.
        """
        self._settle()
        m, stride, terms, avar = self._values(axis)
        keep = (terms > 0) & (m <= _OVERLAPPING.drawn(self._n))
        if not keep.any():
            msg = f"{self._n} samples are too few for an Allan variance; at least 2 neighbours are needed"
            raise DataError(msg)
        m, stride, terms, avar = m[keep], stride[keep], terms[keep], avar[keep]
        model = fit_curve(m.astype(np.float64), avar, np.maximum(terms * stride / m, 1.0))
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
        """Hand points of the integral, shape (axes, k), to a level and every second one to the next."""
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
        """Work on what the levels hold, but for levels too short for any difference."""
        index = 0
        while index < len(self._levels):
            if self._levels[index].ready:
                self._pass_on(index)
            index += 1

    def _values(self, axis: int) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
        """Return m, stride, number of differences and variance of every factor, each of shape (k,)."""
        shifts = np.repeat(np.arange(len(self._levels)), [level.m.size for level in self._levels])
        small = np.concatenate([level.m for level in self._levels])
        stride = np.int64(1) << shifts
        m = small * stride
        terms = np.concatenate([level.terms for level in self._levels])
        sums = np.concatenate([level.sums(axis) for level in self._levels])
        avar = sums / (2.0 * m.astype(np.float64) ** 2 * np.maximum(terms, 1))
        return m, stride, terms, avar


class _Level:
    """Points of the integral at one decimation, with the last ones kept between blocks."""

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
        """Store as many points as there is room for; return how many."""
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
                    self._difference(values[start:end], m)
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

    def _difference(self, values: FloatArray, m: int) -> None:
        lower, upper = self._lower[: values.size - m], self._upper[: values.size - 2 * m]
        np.subtract(values[m:], values[:-m], out=lower)
        np.subtract(lower[m:], lower[:-m], out=upper)

    def forget(self) -> None:
        """Drop the kept points: the next ones follow a break."""
        self._kept = self.waiting = self._odd = 0
