"""Choice among structures by an information criterion, and the models that it can't distinguish."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.errors import DataError
from imucal.findings import Finding
from imucal.fitting.noise_fit import Candidate
from imucal.fitting.settings import CRITERIA
from imucal.fitting.spectral.disturbances.band import Band
from imucal.fitting.spectral.likelihood import Fits
from imucal.fitting.spectral.maximum import find_starts, maximize
from imucal.fitting.spectral.models import SHORTEST_GIVEN, Structure, models_of
from imucal.fitting.spectral.ordinates import Ordinates, coarser
from imucal.noise.model import structure_text
from imucal.noise.terms import TERMS

#: Distance from the best on coarse bins of models that are fitted on all bins.
_REFINED_WITHIN = 25.0
#: The same behind an output filter, whose response adapts only then.
_REFINED_BEHIND = 120.0
#: Largest number of models fitted on all bins.
_MAX_REFINED = 16
#: Models whose criterion is within this of the best are listed.
LISTED_WITHIN = 6.0
#: Distance in twice the log-likelihood of an equally good second maximum.
_AS_GOOD = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class RankedModels:
    """The fits of models, sorted by rising information `criterion`, shape (c,).

    `modes`, shape (c,), is the objective of each model's second-best maximum less its best, inf if there is
    only one.
    """

    fits: Fits
    criterion: FloatArray
    modes: FloatArray

    @property
    def structures(self) -> list[Structure]:
        return self.fits.models.structures


def choose(
    ordinates: Ordinates,
    structures: list[Structure],
    *,
    criterion: str,
    shortest: float = SHORTEST_GIVEN,
    band: Band | None = None,
) -> RankedModels:
    """Fit every structure and return the fits by rising criterion.

    Correlation times are at least `shortest` samples. `band` has the output filter's response.
    """
    poles = band.poles if band else 0
    models = models_of(structures, ordinates.names, poles=poles, shortest=shortest)
    coarse = coarser(ordinates, singles=48, merge=3)
    response = _positive(band.response, ordinates) if band else np.zeros(0)
    owner, theta = find_starts(coarse, models, keep=(1, 2, 3), quick=True, response=response)
    if band:
        theta[:, models.width - poles :] = response
    # The response was found with the richest model: keep it in the first round.
    free = models.free[owner]
    if band:
        free[:, models.width - poles :] = False
    cost = CRITERIA[criterion](ordinates.count) * models.parameters.astype(np.float64)
    rough = maximize(
        # Fewer bins are enough: the best models are fitted again on all bins.
        coarser(ordinates, singles=24, merge=8),
        models[owner],
        theta,
        free=free,
        tolerance=1e-3,
        iterations=40,
        handicap=cost[owner] / 2,
    )
    if not np.isfinite(rough.objective).any():
        msg = (
            f"spectrum of {ordinates.count:.0f} ordinates: no model has a finite likelihood, expected noise; "
            "look at the samples for values that are not measurements"
        )
        raise DataError(msg)
    best = np.full(models.count, np.inf)
    np.minimum.at(best, owner, 2 * rough.objective)
    value = best + cost
    order = np.argsort(value, kind="stable")
    reach = _REFINED_BEHIND if poles else _REFINED_WITHIN
    near = order[value[order] <= value[order[0]] + reach][:_MAX_REFINED]
    rows = [row for index in near for row in _distinct(np.flatnonzero(owner == index), rough.objective)]
    index = np.array(rows, dtype=np.int64)
    fine = maximize(ordinates, models[owner[index]], rough.theta[index])
    return _ranked(fine, owner=owner[index], near=near, cost=cost)


def _positive(response: FloatArray, ordinates: Ordinates) -> FloatArray:
    """Return the response, found on wider bins, reduced until it is positive in every bin."""
    powers = (ordinates.lam[:, None] / ordinates.top) ** np.arange(1, response.size + 1)
    for _ in range(60):
        if not response.size or np.min(1 + powers @ response) > 0:
            break
        response = 0.9 * response
    return response


def _distinct(rows: IntArray, objective: FloatArray) -> list[int]:
    """Return the row of a model's best maximum, and of the second-best if it differs."""
    order = rows[np.argsort(objective[rows], kind="stable")]
    behind = objective[order] - objective[order[0]]
    return [int(order[0]), *order[(behind > 0.02) & (behind < 10)][:1].tolist()]


def _ranked(fine: Fits, *, owner: IntArray, near: IntArray, cost: FloatArray) -> RankedModels:
    best, modes = [], []
    for index in near:
        rows = np.flatnonzero(owner == index)
        rows = rows[np.argsort(fine.objective[rows], kind="stable")]
        best.append(int(rows[0]))
        behind = fine.objective[rows] - fine.objective[rows[0]]
        modes.append(float(np.min(behind[behind > 0.02], initial=np.inf)))
    value = 2 * fine.objective[best] + cost[near]
    order = np.argsort(value, kind="stable")
    rows = np.array(best, dtype=np.int64)[order]
    return RankedModels(fits=fine[rows], criterion=value[order], modes=np.array(modes)[order])


def near_candidates(choice: RankedModels) -> tuple[Candidate, ...]:
    """Return the models near the best, the best first."""
    delta = choice.criterion - choice.criterion[0]
    return tuple(
        Candidate(structure=structure_text(structure), delta=float(d))
        for structure, d in zip(choice.structures, delta, strict=True)
        if d <= LISTED_WITHIN
    )


def alternatives_among(near: Sequence[Structure]) -> dict[str, tuple[str, ...]]:
    """Return for each term its alternatives: every model near the best contains one of the two."""

    def replaces(one: str, other: str) -> bool:
        without_one, without_other = ([s for s in near if symbol not in s] for symbol in (one, other))
        return bool(without_one and without_other) and all(one in s or other in s for s in near)

    return {one: tuple(other for other in TERMS if replaces(one, other)) for one in TERMS}


def choice_findings(choice: RankedModels, axis: str) -> tuple[Finding, ...]:
    """Return findings about equally good models, and about a second maximum."""
    near = near_candidates(choice)
    findings = []
    if len(near) > 1:
        others = ", ".join(f"{c.structure} (+{c.delta:.1f})" for c in near[1:])
        text = (
            f"The record can't separate {near[0].structure} from {others}: {_difference(choice, len(near))}."
        )
        advice = "Record for longer, or give the model if it is known."
        findings.append(Finding("info", "model-choice", text, advice, axis=axis))
    if choice.modes[0] < _AS_GOOD / 2:
        text = (
            f"{near[0].structure} fits the record about equally well with two sets of coefficients. The "
            "better one is reported; its intervals do not contain the other."
        )
        advice = "Record for longer, or give a simpler model."
        findings.append(Finding("warning", "two-maxima", text, advice, axis=axis))
    return tuple(findings)


def _difference(choice: RankedModels, count: int) -> str:
    sets = [set(structure) for structure in choice.structures[:count]]
    unsure = sorted({s for one in sets for s in one if not all(s in other for other in sets)})
    if not unsure:
        counts = {s: {structure.count(s) for structure in choice.structures[:count]} for s in sets[0]}
        symbol, numbers = next((s, found) for s, found in counts.items() if len(found) > 1)
        return f"it may have {min(numbers)} to {max(numbers)} {symbol} terms"
    if len(unsure) == 1:
        return f"{unsure[0]} may or may not be present"
    return f"it can't distinguish {', '.join(unsure[:-1])} and {unsure[-1]}"
