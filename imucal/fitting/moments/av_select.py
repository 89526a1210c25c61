"""The choice of terms on Allan variances: every subset, by a criterion of moment selection.

The sum of squares J with the inverse covariance as weight is chi-squared with (points - parameters)
degrees of freedom where the model is right. Models are ranked by J + parameters * penalty, with
penalty ln n (``bic``), 2 ln ln n (``hq``) or 2 (``aic``), n the number of samples.

Source: Andrews (1999), "Consistent moment selection procedures for generalized method of moments
estimation", Econometrica 67, 543: the criteria MMSC-BIC, MMSC-HQIC and MMSC-AIC.
"""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.moments.av_points import AvarPoints, columns
from imucal.fitting.moments.av_search import Solution, Weight, minimise, time_grid

_LAWS = "QNBKR"
#: Models whose screened criterion is within so much of the best are computed in full, at most so many.
_WITHIN, _AT_MOST = 10.0, 10


def penalty(criterion: str, n: int) -> float:
    """Return what a parameter costs in units of the sum of squares."""
    if criterion == "bic":
        return float(np.log(n))
    return float(2 * np.log(np.log(max(n, 3)))) if criterion == "hq" else 2.0


def dictionary(points: AvarPoints, weight: Weight) -> Solution:
    """Return the best fit of all laws and Gauss-Markov terms of many correlation times at once.

    It describes almost any curve; the terms left at zero are dropped.
    """
    from scipy.optimize import nnls

    grid = time_grid(points.m, per_decade=3)
    matrix = weight.whiten @ columns(points.m, _LAWS, grid)
    length = np.sqrt(np.einsum("ij,ij->j", matrix, matrix))
    solution, residual = nnls(matrix / length, weight.whiten @ points.avar)
    variances = solution / length
    laws = "".join(law for law, value in zip(_LAWS, variances, strict=False) if value > 0)
    active = variances[len(_LAWS) :] > 0
    kept = np.concatenate([variances[: len(_LAWS)], variances[len(_LAWS) :][active]])
    return Solution(laws=laws, times=grid[active], variances=kept[kept > 0], objective=float(residual) ** 2)


def choose(
    points: AvarPoints, weight: Weight, *, criterion: str, max_gm: int
) -> list[tuple[float, Solution]]:
    """Return the best models and how much worse their criterion is, the best (0) first.

    Notes
    -----
    All sets of the five laws with up to `max_gm` Gauss-Markov terms at the correlation times of a
    grid are screened by their normal equations at once; a solution with a negative variance is one
    of a smaller model. The best are then computed with free correlation times.
    """
    price = penalty(criterion, points.n)
    screened = sorted(_screen(points, weight, max_gm, price), key=lambda entry: entry[0])
    if not screened:
        return []
    near = [entry for entry in screened if entry[0] <= screened[0][0] + _WITHIN][:_AT_MOST]
    solutions = [minimise(points.m, points.avar, weight, laws, count) for _, laws, count in near]
    ranked = sorted(((s.objective + price * s.parameters, s) for s in solutions), key=lambda pair: pair[0])
    best = ranked[0][0]
    return [(value - best, solution) for value, solution in ranked]


def _screen(
    points: AvarPoints, weight: Weight, max_gm: int, price: float
) -> Iterator[tuple[float, str, int]]:
    """Yield the criterion of each structure, at the best correlation times of a grid."""
    grid = time_grid(points.m)
    matrix = weight.whiten @ columns(points.m, _LAWS, grid)
    matrix = matrix / np.sqrt(np.einsum("ij,ij->j", matrix, matrix))
    target = weight.whiten @ points.avar
    # A ridge far below what tells models apart keeps equal columns from being singular.
    gram = matrix.T @ matrix + 1e-12 * np.eye(matrix.shape[1])
    moment, total = matrix.T @ target, float(target @ target)
    for count in range(max_gm + 1):
        places = np.array(list(combinations(range(len(_LAWS), matrix.shape[1]), count)), dtype=np.int64)
        for size in range(len(_LAWS) + 1):
            parameters = size + 2 * count
            if not 0 < parameters < points.size:
                continue
            for laws in combinations(range(len(_LAWS)), size):
                fixed = np.broadcast_to(np.array(laws, dtype=np.int64), (len(places), size))
                cost = _least_cost(gram, moment, total, np.hstack([fixed, places]))
                if np.isfinite(cost):
                    yield cost + price * parameters, "".join(_LAWS[law] for law in laws), count


def _least_cost(gram: FloatArray, moment: FloatArray, total: float, sets: np.ndarray) -> float:
    """Return the least sum of squares over `sets` of columns, shape (s, p), with positive variances."""
    normal = gram[sets[:, :, np.newaxis], sets[:, np.newaxis, :]]
    right = moment[sets]
    solution = np.linalg.solve(normal, right[..., np.newaxis])[..., 0]
    cost = np.where(np.all(solution > 0, axis=1), total - np.einsum("ij,ij->i", solution, right), np.inf)
    return float(cost.min())
