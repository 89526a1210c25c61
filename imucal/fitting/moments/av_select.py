"""The choice of terms (every subset, by a criterion of moment selection) and of averaging times.

The sum of squares J with the inverse covariance as weight is chi-squared with (points - parameters)
degrees of freedom where the model is right. Models are ranked by J + parameters * penalty, with
penalty ln n (``bic``), 2 ln ln n (``hq``) or 2 (``aic``), n the number of samples.

Source: Andrews (1999), "Consistent moment selection procedures for generalized method of moments
estimation", Econometrica 67, 543: the criteria MMSC-BIC, MMSC-HQIC and MMSC-AIC.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.moments.av_intervals import CurveSpread, goodness
from imucal.fitting.moments.av_points import AvarPoints, columns
from imucal.fitting.moments.av_search import Solution, Weight, minimise, time_grid
from imucal.fitting.settings import CRITERIA, FitSettings
from imucal.solvers import non_negative

_LAWS = "QNBKR"
#: Models whose screened criterion is within so much of the best are computed in full, at most so many.
_WITHIN, _AT_MOST = 10.0, 10
#: A misfit above so many standard deviations means that the model does not describe the curve.
MISFIT = 3.0
#: A misfit of all averaging times above this makes the fit look whether the shortest are to blame.
_FILTERED = 5.0
#: They are, where the misfit without them is less by this factor.
_CURE = 3.0
#: At most so many octaves are left out: an output filter leaves the rest of the curve as it was.
_MOST_DROPPED = 8
#: The weight is computed anew at most so often; three are enough in practice.
_STEPS = 5
#: At most so many models are tried for one that describes the curve.
_CANDIDATES = 6


def dictionary(points: AvarPoints, weight: Weight) -> Solution:
    """Return the best fit of all laws and Gauss-Markov terms of many correlation times at once.

    It describes almost any curve; the terms left at zero are dropped.
    """
    grid = time_grid(points.m, per_decade=3)
    matrix = weight.whiten @ columns(points.m, _LAWS, grid)
    variances, objective = non_negative(matrix, weight.whiten @ points.avar)
    laws = "".join(law for law, value in zip(_LAWS, variances, strict=False) if value > 0)
    active = variances[len(_LAWS) :] > 0
    kept = np.concatenate([variances[: len(_LAWS)], variances[len(_LAWS) :][active]])
    return Solution(laws=laws, times=grid[active], variances=kept[kept > 0], objective=objective)


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
    price = CRITERIA[criterion](points.n)
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


def ranked(points: AvarPoints, weight: Weight, settings: FitSettings) -> list[tuple[float, Solution]]:
    """Return the models in reach, the best first; the one model where it is given."""
    structure = settings.structure
    if structure is None:
        return choose(points, weight, criterion=settings.criterion, max_gm=settings.max_gm)
    laws, count = "".join(symbol for symbol in structure if symbol != "GM"), structure.count("GM")
    return [(0.0, minimise(points.m, points.avar, weight, laws, count))]


@dataclass(frozen=True, slots=True)
class CurveFit:
    """A fit: the models in reach, the chosen one at its minimum, its weight and its misfit."""

    ranking: list[tuple[float, Solution]]
    solution: Solution
    weight: Weight
    misfit: float


@dataclass(frozen=True)
class ModelSearch:
    """Finds the models in reach of `points`, with the covariance that a rough fit by `eta3` gives."""

    points: AvarPoints
    eta3: Weight
    settings: FitSettings

    @cached_property
    def _rough(self) -> tuple[CurveSpread, Solution]:
        rough = dictionary(self.points, self.eta3)
        return CurveSpread.of_terms(self.points, rough.laws, rough.times), rough

    def whole(self) -> CurveFit:
        """Return the fit of all points.

        One given model without GM has one minimum for any weight, so that its own weight follows from
        any start; where it describes the curve, the costly covariance of the rough fit is not asked for.
        """
        if self.settings.structure is not None and "GM" not in self.settings.structure:
            given = _described(self.points, ranked(self.points, self.eta3, self.settings), self.eta3)
            if given.misfit < MISFIT:
                return given
        ranking, weight, _ = self.ranking(self.points)
        return _described(self.points, ranking, weight)

    def ranking(self, points: AvarPoints) -> tuple[list[tuple[float, Solution]], Weight, float]:
        """Return the models of the last `points`, their weight and the least misfit."""
        spread, rough = self._rough
        covariance = spread.within(self.points.size - points.size).at(rough.variances)
        weight = Weight.of_covariance(covariance)
        ranking = ranked(points, weight, self.settings)
        misfit = min(goodness(points, solution, covariance).statistic for _, solution in ranking)
        return ranking, weight, misfit


def best_band(points: AvarPoints, search: ModelSearch) -> tuple[AvarPoints, CurveFit]:
    """Return the longest run of points, up to the last, that a model describes, and the fit.

    An output filter bends the curve at its first averaging times only; without those it is as good
    as ever. Where no run is described, the one with the least misfit is taken if it is far better
    than the whole curve, and the misfit is reported.
    """
    whole = search.whole()
    structure = search.settings.structure
    least = 6 if structure is None else len(structure) + structure.count("GM") + 3
    if not whole.misfit >= _FILTERED:
        return points, whole
    best, kept_best = whole.misfit / _CURE, None
    most = min(points.size - least, points.size // 2, _MOST_DROPPED)
    for first in range(1, most + 1):
        kept = points.within(first)
        ranking, weight, misfit = search.ranking(kept)
        if misfit < best:
            best, kept_best = misfit, (kept, ranking, weight)
        if misfit < MISFIT:
            break
    if kept_best is None:
        return points, whole
    return kept_best[0], _described(*kept_best)


def _described(points: AvarPoints, ranking: list[tuple[float, Solution]], weight: Weight) -> CurveFit:
    """Return the first of the models that describes the curve with its own weight; else the first.

    The criterion ranks all models with one weight, under which a model that lacks a small term may
    win; with its own weight it then shows a misfit that the next one does not have.
    """
    fits: list[CurveFit] = []
    for place, (delta, start) in enumerate(ranking[:_CANDIDATES]):
        solution, own, covariance = _converged(points, start, weight)
        misfit = goodness(points, solution, covariance).statistic
        rest = [(d - delta, s) for d, s in ranking[place:]]
        fits.append(CurveFit(rest, solution, own, misfit))
        if not misfit >= MISFIT:
            return fits[-1]
    return fits[0]


def _converged(points: AvarPoints, solution: Solution, weight: Weight) -> tuple[Solution, Weight, FloatArray]:
    """Return the minimum with the weight of the model itself, that weight, and the covariance."""
    spread = CurveSpread.of_terms(points, solution.laws, solution.times)
    for _ in range(_STEPS):
        if np.any(np.abs(np.log(solution.times / spread.times)) > 0.2):
            spread = CurveSpread.of_terms(points, solution.laws, solution.times)
        weight = Weight.of_covariance(spread.at(solution.variances))
        before = solution
        solution = minimise(
            points.m, points.avar, weight, solution.laws, solution.times.size, near=solution.times
        )
        if np.allclose(solution.variances, before.variances, rtol=1e-3, atol=1e-12 * points.avar.max()):
            break
    return solution, weight, spread.at(solution.variances)
