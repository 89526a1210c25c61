"""The search for a model of Allan variances: which terms, which averaging times, which weight."""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.moments.av_goodness import goodness
from imucal.fitting.moments.av_intervals import CurveSpread
from imucal.fitting.moments.av_points import AvarPoints
from imucal.fitting.moments.av_search import Solution, Weight, minimise
from imucal.fitting.moments.av_select import choose

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


def ranked(
    points: AvarPoints, weight: Weight, structure: tuple[str, ...] | None, criterion: str, max_gm: int
) -> list[tuple[float, Solution]]:
    """Return the models in reach, the best first; the one model where it is given."""
    if structure is None:
        return choose(points, weight, criterion=criterion, max_gm=max_gm)
    laws, count = _laws(structure)
    return [(0.0, minimise(points.m, points.avar, weight, laws, count))]


def _laws(structure: tuple[str, ...]) -> tuple[str, int]:
    return "".join(symbol for symbol in structure if symbol != "GM"), structure.count("GM")


@dataclass(frozen=True, slots=True)
class Fitted:
    """A fit: the models in reach, the chosen one at its minimum, its weight and its misfit."""

    ranking: list[tuple[float, Solution]]
    solution: Solution
    weight: Weight
    misfit: float


@dataclass(frozen=True, slots=True)
class Search:
    """Finds the models in reach, with the covariance that a rough fit gives."""

    spread: CurveSpread
    rough: Solution
    structure: tuple[str, ...] | None
    criterion: str
    max_gm: int

    def ranking(self, points: AvarPoints) -> tuple[list[tuple[float, Solution]], Weight, float]:
        """Return the models of the last `points`, their weight and the least misfit."""
        first = self.spread.points.size - points.size
        covariance = self.spread.within(first).at(self.rough.variances)
        weight = Weight.of_covariance(covariance)
        ranking = ranked(points, weight, self.structure, self.criterion, self.max_gm)
        misfit = min(goodness(points, solution, covariance).statistic for _, solution in ranking)
        return ranking, weight, misfit


def best_band(points: AvarPoints, search: Search) -> tuple[AvarPoints, Fitted]:
    """Return the longest run of points, up to the last, that a model describes, and the fit.

    An output filter bends the curve at its first averaging times only; without those it is as good
    as ever. Where no run is described, the one with the least misfit is taken if it is far better
    than the whole curve, and the misfit is reported.
    """
    ranking, weight, _ = search.ranking(points)
    whole = _described(points, ranking, weight)
    least = 6 if search.structure is None else len(search.structure) + search.structure.count("GM") + 3
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


def _described(points: AvarPoints, ranking: list[tuple[float, Solution]], weight: Weight) -> Fitted:
    """Return the first of the models that describes the curve with its own weight; else the first.

    The criterion ranks all models with one weight, under which a model that lacks a small term may
    win; with its own weight it then shows a misfit that the next one does not have.
    """
    fits: list[Fitted] = []
    for place, (delta, start) in enumerate(ranking[:_CANDIDATES]):
        solution, own, covariance = _converged(points, start, weight)
        misfit = goodness(points, solution, covariance).statistic
        rest = [(d - delta, s) for d, s in ranking[place:]]
        fits.append(Fitted(rest, solution, own, misfit))
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
