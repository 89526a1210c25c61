"""Covariance, intervals and misfit of a model that was fitted to Allan variances.

With weight W and covariance V of the Allan variances y, the estimate is linear near its solution,
theta = (G'WG)^-1 G'W y, and its covariance the sandwich of V. V itself depends on the variances:
the larger the true variance, the wider the spread. An interval therefore holds the values v with

    (estimate - v)^2 / (s(estimate) s(v)) < chi-squared quantile,

where s(v) is the standard error if v were true. Where V is proportional to v^2 this is the interval
of a logarithm; where other terms make the spread, it is Wald's; it always has an upper end.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.moments.av_covariance import AvarCovariance, avar_covariance
from imucal.fitting.moments.av_points import AvarPoints, columns, processes
from imucal.fitting.moments.av_search import Solution, Weight
from imucal.fitting.noise_fit import Goodness


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CurveSpread:
    """The covariance of the Allan variances of a curve, for any variances of a set of terms."""

    points: AvarPoints
    laws: str
    times: FloatArray
    gaussian: AvarCovariance

    @classmethod
    def of_terms(cls, points: AvarPoints, laws: str, times: FloatArray) -> "CurveSpread":
        """Return it for the laws and the correlation times (in samples) of a model."""
        gaussian = avar_covariance(points.m, points.n, processes(laws, times), overlapping=points.overlapping)
        return cls(points=points, laws=laws, times=times, gaussian=gaussian)

    def within(self, first: int) -> "CurveSpread":
        """Return it for the points from index `first` on."""
        return replace(self, points=self.points.within(first), gaussian=self.gaussian.within(first))

    def at(self, variances: FloatArray) -> FloatArray:
        """Return the covariance, shape (k, k), at variances in the order of `columns`.

        White noise of excess kurtosis g adds g avar_i avar_j / n, avar its own Allan variance:
        each Allan variance is a mean of squares in which every sample weighs the same.
        """
        ramp = self.laws.find("R")
        random = variances if ramp < 0 else np.delete(variances, ramp)
        covariance = self.gaussian.at(random, float(variances[ramp]) if ramp >= 0 else 0.0)
        if self.points.excess and "N" in self.laws:
            white = float(variances[self.laws.index("N")]) / self.points.m
            covariance = covariance + self.points.excess * np.outer(white, white) / self.points.n
        return covariance


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spread:
    """How far the estimates of a solution scatter.

    Attributes
    ----------
    curve
        Covariance of the Allan variances.
    weight
        The weight the estimates were made with.
    """

    curve: CurveSpread
    weight: Weight

    def covariance(self, solution: Solution, at: FloatArray, free: np.ndarray) -> FloatArray:
        """Return the covariance of the free variances and, after them, all log correlation times.

        Parameters
        ----------
        solution
            Whose correlation times and variances give the derivatives.
        at
            Variances that make the covariance of the curve, shape (p,).
        free
            Which variances are free, shape (p,); those at zero are held there.
        """
        design = self.weight.whiten @ derivatives(solution, self.curve.points, free)
        length = np.sqrt(np.einsum("ij,ij->j", design, design))
        length[length == 0] = 1.0
        # Of minimal norm, so that terms the curve can't tell apart give a wide answer, not an error.
        solve = np.linalg.pinv(design / length, rcond=1e-12) @ self.weight.whiten
        return np.asarray(solve @ self.curve.at(at) @ solve.T / np.outer(length, length))


def derivatives(solution: Solution, points: AvarPoints, free: np.ndarray) -> FloatArray:
    """Return the derivatives of the model by its free variances and log correlation times."""
    step = 1e-4
    plain = columns(points.m, solution.laws, solution.times)
    later = columns(points.m, "", solution.times * np.exp(step))
    sooner = columns(points.m, "", solution.times * np.exp(-step))
    count = solution.times.size
    if count == 0:
        return plain[:, free]
    slopes = (later - sooner) / (2 * step) * solution.variances[-count:]
    shown = free[-count:]
    return np.hstack([plain[:, free], slopes[:, shown]])


def limits(value: float, spread_at: Callable[[float], float], quantile: float) -> tuple[float, float]:
    """Return the interval of a variance; its lower end is 0 where 0 is inside.

    Parameters
    ----------
    value
        The estimate, at least 0.
    spread_at
        Returns the standard error of the estimate if its argument were the true variance.
    quantile
        Chi-squared quantile with one degree of freedom.
    """
    from scipy.optimize import brentq

    own = spread_at(value)

    def excess(trial: float) -> float:
        return (value - trial) ** 2 - quantile * own * spread_at(trial)

    low = 0.0
    if excess(0.0) > 0:
        low = float(brentq(excess, 0.0, value, xtol=1e-6 * value, rtol=1e-6))
    high = value + np.sqrt(quantile) * own
    for _ in range(200):
        if excess(high) > 0:
            break
        high = value + 2 * (high - value)
    else:
        return low, float("inf")
    return low, float(brentq(excess, value, high, xtol=1e-6 * high, rtol=1e-6))


def goodness(points: AvarPoints, solution: Solution, covariance: FloatArray) -> Goodness:
    """Return how well a model describes the points, whose covariance it is given.

    An Allan variance with few degrees of freedom is far from normal; its cube root is not (Wilson
    & Hilferty 1931). The sum of squares is of those, with the correlations of `covariance`.
    """
    from scipy.special import chdtrc, ndtri

    model = solution.avar(points.m)
    tau = (float(points.m[0] * points.tau0), float(points.m[-1] * points.tau0))
    freedom = points.size - solution.parameters
    if freedom < 1 or not model.min() > 0:
        # Nothing is left to judge by, or the model is no noise at all.
        return Goodness(statistic=np.nan, p_value=np.nan, chi2_per_bin=np.nan, tau_s=tau)
    deviation = np.sqrt(np.diag(covariance))
    third = 2 / 9 * (deviation / model) ** 2 / 2
    score = (np.cbrt(points.avar / model) - (1 - third)) / np.sqrt(third)
    correlation = covariance / np.outer(deviation, deviation)
    misfit = float(score @ np.linalg.solve(correlation, score))
    p_value = float(chdtrc(freedom, misfit))
    # Beyond what a normal score can say, Wilson and Hilferty's own approximation goes on.
    spread = 2 / (9 * freedom)
    statistic = (
        float(-ndtri(p_value)) if p_value > 1e-15 else (np.cbrt(misfit / freedom) - 1 + spread) / spread**0.5
    )
    return Goodness(statistic=float(statistic), p_value=p_value, chi2_per_bin=misfit / freedom, tau_s=tau)
