"""The minimum of a weighted sum of squares of Allan variances, over every non-negative model.

The model is linear in the variances, so for given correlation times the minimum is a non-negative
least-squares problem, which has one solution and needs no start. Correlation times are searched on
a grid that covers the curve and refined from its best places. The result is the same every time.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.errors import DataError
from imucal.fitting.moments.av_points import columns
from imucal.solvers import non_negative

#: Correlation times a decade in the grid.
_PER_DECADE = 5
#: Places of the grid from which a search is refined.
_STARTS = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Weight:
    """The weight matrix Omega = whiten' whiten of a sum of squares; `whiten` has shape (k, k)."""

    whiten: FloatArray

    @classmethod
    def of_covariance(cls, covariance: FloatArray) -> "Weight":
        """Return the inverse of a covariance of shape (k, k).

        The covariance is known to some 1e-3 (its lags are summed on a grid), so a nugget of 1e-6
        of each variance changes nothing and keeps the factorisation safe.

        Raises
        ------
        DataError
            If the covariance is of no noise, as that of a curve that falls by many decades.
        """
        variance = np.diag(covariance)
        if not (np.all(np.isfinite(covariance)) and variance.min() > 0):
            msg = (
                "the covariance of the Allan variances is not that of any noise; expected noise, look at the "
                "samples"
            )
            raise DataError(msg)
        deviation = np.sqrt(variance)
        correlation = covariance / np.outer(deviation, deviation) + 1e-6 * np.eye(deviation.size)
        try:
            factor = np.linalg.cholesky(correlation)
        except np.linalg.LinAlgError as error:
            msg = (
                "the Allan variances fall or rise as those of no noise do, so their covariance has no "
                "inverse; expected noise, look at the samples"
            )
            raise DataError(msg) from error
        return cls(whiten=np.linalg.solve(factor, np.diag(1 / deviation)))

    @classmethod
    def of_deviations(cls, deviations: FloatArray) -> "Weight":
        """Return the diagonal weight 1 / deviation^2, shape (k,)."""
        return cls(whiten=np.diag(1 / deviations))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """A model at its minimum: `laws` and GM terms, their variances per sample, the sum of squares.

    Attributes
    ----------
    laws
        Symbols of the terms other than GM, such as ``NBK``.
    times
        Correlation times in samples, shape (g,), rising.
    variances
        Variances per sample of the laws, then of the GM terms, shape (p,).
    objective
        Weighted sum of squares.
    """

    laws: str
    times: FloatArray
    variances: FloatArray
    objective: float

    @property
    def parameters(self) -> int:
        """Number of free parameters."""
        return len(self.laws) + 2 * self.times.size

    def avar(self, m: IntArray) -> FloatArray:
        """Return the model's Allan variance, shape (k,)."""
        return columns(m, self.laws, self.times) @ self.variances


def time_grid(m: IntArray, per_decade: int = _PER_DECADE) -> FloatArray:
    """Return correlation times in samples that the Allan variances at `m` can tell, shape (g,)."""
    low, high = 0.7 * float(m[0]), 1.5 * float(m[-1])
    return np.geomspace(low, high, max(2, int(np.ceil(per_decade * np.log10(high / low)))))


def minimise(
    m: IntArray, avar: FloatArray, weight: Weight, laws: str, count: int, *, near: FloatArray | None = None
) -> Solution:
    """Return the global minimum over the variances and `count` correlation times.

    Parameters
    ----------
    m, avar
        Averaging factors and Allan variances, shape (k,).
    weight
        Of the sum of squares.
    laws
        Symbols of the terms other than GM.
    count
        Number of Gauss-Markov terms.
    near
        Correlation times of a minimum with another weight, shape (count,): they and the best place
        of the grid are refined then, instead of the best few.
    """
    target = weight.whiten @ avar
    fixed = weight.whiten @ columns(m, laws, np.zeros(0))
    if count == 0:
        variances, objective = non_negative(fixed, target)
        return Solution(laws=laws, times=np.zeros(0), variances=variances, objective=objective)
    grid = time_grid(m, _PER_DECADE if count <= 2 else 3)
    varied = weight.whiten @ columns(m, "", grid)
    starts = _best_of_grid(fixed, varied, target, grid, count)
    if near is not None:
        starts = [near, starts[0]]

    bounds = (np.log(grid[0]) - 1, np.log(grid[-1]) + 1)

    def residuals(logs: FloatArray) -> FloatArray:
        matrix = np.hstack([fixed, weight.whiten @ columns(m, "", np.exp(logs))])
        return np.asarray(target - matrix @ non_negative(matrix, target)[0])

    found = [_refined(residuals, np.log(start), bounds) for start in starts]
    times = np.sort(np.exp(min(found, key=lambda pair: pair[1])[0]))
    variances, objective = non_negative(np.hstack([fixed, weight.whiten @ columns(m, "", times)]), target)
    return Solution(laws=laws, times=times, variances=variances, objective=objective)


def _best_of_grid(
    fixed: FloatArray, varied: FloatArray, target: FloatArray, grid: FloatArray, count: int
) -> list[FloatArray]:
    """Return the correlation times of the best few places of the grid."""
    places = list(combinations(range(grid.size), count))
    costs = [non_negative(np.hstack([fixed, varied[:, place]]), target)[1] for place in places]
    order = np.argsort(costs, kind="stable")[: _STARTS * count]
    return [grid[list(places[index])] for index in order]


def _refined(
    residuals: Callable[[FloatArray], FloatArray], start: FloatArray, bounds: tuple[float, float]
) -> tuple[FloatArray, float]:
    """Return the minimum near `start` and its sum of squares, by Gauss-Newton steps.

    Source: Golub & Pereyra (1973), SIAM J. Numer. Anal. 10, 413: the linear parameters are
    eliminated from the residuals.
    """
    from scipy.optimize import least_squares

    inside = np.clip(start, bounds[0] + 1e-6, bounds[1] - 1e-6)
    found = least_squares(residuals, inside, bounds=bounds, xtol=1e-8, ftol=1e-12, gtol=1e-12)
    return np.asarray(found.x, dtype=np.float64), 2 * float(found.cost)
