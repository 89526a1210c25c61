"""Where an Allan curve runs at a slope: the windows on which terms are read."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.fitting.moments.av_points import AvarPoints, columns
from imucal.noise.terms import TERMS

#: Slope of the Allan deviation of each term that can be read.
SLOPES = {symbol: term.slope for symbol, term in TERMS.items() if term.slope is not None}
#: A run of points has a slope if its line is within so much of it, half the way to the next slope at most.
_TOLERANCE = 0.15
#: Standard error of the slope of a run, at most: half the way to the next slope is two of them.
_SHARP = 0.125
#: Points, a factor of about two apart, that a line takes at least.
LEAST_POINTS = 3
#: Points with fewer degrees of freedom show no slope.
_LEAST_EDF = 3.0
#: Points within this factor of the lowest are the floor.
_FLOOR = 1.05


@dataclass(frozen=True, slots=True, eq=False)
class LogCurve:
    """Points, and the covariance of the logarithms of their deviations, shape (k, k)."""

    points: AvarPoints
    covariance: FloatArray

    @property
    def variance(self) -> FloatArray:
        """Variance of each logarithm, shape (k,)."""
        return np.diag(self.covariance)

    @property
    def sure(self) -> int:
        """How many of the points have enough degrees of freedom to show a slope."""
        return int(np.sum(self.variance < 1 / (2 * _LEAST_EDF)))

    def among(self, places: IntArray) -> FloatArray:
        """Return the covariance of some of the logarithms, shape (j, j)."""
        return self.covariance[np.ix_(places, places)]

    def shape(self, symbol: str) -> FloatArray:
        """Return the Allan variance of a term of unit variance at the points, shape (k,)."""
        return np.asarray(columns(self.points.m, symbol, np.zeros(0))[:, 0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reading:
    """One term's line: the logarithm of its coefficient, as weights on the points' logarithms."""

    symbol: str
    places: IntArray
    weights: FloatArray
    log_value: float

    def spread(self, curve: LogCurve) -> float:
        """Return the standard error of `log_value`."""
        return float(np.sqrt(self.weights @ curve.among(self.places) @ self.weights))

    @property
    def variance(self) -> float:
        """Square of the coefficient, as a variance per sample."""
        return float(np.exp(2 * self.log_value))


def read_term(
    curve: LogCurve, symbol: str, windows: Mapping[str, tuple[float, float]] | None
) -> Reading | None:
    """Return the reading of one term, or None where the curve has no such slope."""
    if windows is not None and symbol in windows:
        places = _given(curve.points, symbol, windows[symbol])
    else:
        places = _floor(curve) if symbol == "B" else _line(curve, SLOPES[symbol])
    if not places.size:
        return None
    weights = 1 / curve.variance[places]
    weights = weights / weights.sum()
    logs = np.log(np.sqrt(curve.points.avar[places]) / np.sqrt(curve.shape(symbol))[places])
    return Reading(symbol=symbol, places=places, weights=weights, log_value=float(weights @ logs))


def _given(points: AvarPoints, symbol: str, window: tuple[float, float]) -> IntArray:
    tau = points.m * points.tau0
    places = np.flatnonzero((tau >= window[0] * (1 - 1e-9)) & (tau <= window[1] * (1 + 1e-9)))
    if not places.size:
        msg = (
            f"window of {symbol}: no averaging time between {window[0]:g} and {window[1]:g} s; "
            f"the curve has {tau[0]:.4g} to {tau[-1]:.4g} s, a factor of about 2 apart"
        )
        raise ValueError(msg)
    return np.asarray(places, dtype=np.int64)


def _line(curve: LogCurve, slope: float) -> IntArray:
    """Return the longest run of points on a line of that slope; of equals, the surest."""
    x, y = np.log(curve.points.m.astype(np.float64)), np.log(curve.points.avar) / 2
    sure = curve.sure
    best: tuple[float, float, IntArray] = (0.0, 0.0, np.zeros(0, dtype=np.int64))
    for first in range(sure):
        for last in range(first + LEAST_POINTS, sure + 1):
            places = np.arange(first, last)
            found, spread = _slope(x[places], y[places], curve.among(places))
            steps = np.diff(y[places]) / np.diff(x[places])
            loose = _TOLERANCE + 3 * np.sqrt(_step_variance(x, curve.covariance, places))
            if spread > _SHARP or abs(found - slope) > _TOLERANCE or np.any(np.abs(steps - slope) > loose):
                continue
            sharpness = -float(np.mean(curve.variance[places]))
            if (last - first, sharpness) > best[:2]:
                best = (last - first, sharpness, places)
    return best[2]


def _slope(x: FloatArray, y: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """Return the weighted least-squares slope of y over x, and its standard error."""
    weight = 1 / np.diag(covariance)
    x = x - weight @ x / weight.sum()
    design = weight * x / ((weight * x) @ x)
    return float(design @ y), float(np.sqrt(design @ covariance @ design))


def _step_variance(x: FloatArray, covariance: FloatArray, places: IntArray) -> FloatArray:
    """Return the variance of the slope from each point of a run to the next."""
    a, b = places[:-1], places[1:]
    variance = np.diag(covariance)[a] + np.diag(covariance)[b] - 2 * covariance[a, b]
    return np.asarray(np.maximum(variance, 0.0) / np.square(x[b] - x[a]))


def _floor(curve: LogCurve) -> IntArray:
    """Return the points about the lowest, if the curve rises on both sides of it."""
    sure = curve.sure
    if sure < LEAST_POINTS:
        return np.zeros(0, dtype=np.int64)
    adev = np.sqrt(curve.points.avar[:sure])
    lowest = int(np.argmin(adev))
    if lowest in {0, sure - 1}:
        return np.zeros(0, dtype=np.int64)
    first, last = lowest, lowest
    while first > 0 and adev[first - 1] <= _FLOOR * adev[lowest]:
        first -= 1
    while last < sure - 1 and adev[last + 1] <= _FLOOR * adev[lowest]:
        last += 1
    return np.arange(first, last + 1)
