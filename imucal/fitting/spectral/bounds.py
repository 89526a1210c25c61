"""From the chosen candidate to estimates whose intervals hold though the model was chosen.

A term that may be zero has a bound instead of a value. An interval that takes the chosen structure for
granted does not cover: a weak term is dropped by the choice, and its neighbour takes its power with a
narrow interval. So each model whose criterion is near the best is completed with the terms that every fit
reports, at zero where the data want them there, and a term's interval reaches from its lowest limit in any
of them to its highest. What a model has to say gets less with its distance from the best.

Leeb & Pötscher (2005), Econometric Theory 21, p. 21, "Model selection and inference: facts and fiction",
show why a remedy is needed; how well this one covers is measured by `tests/benchmarks/coverage_auto.py`.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from imucal.fitting.noise_fit import Estimate
from imucal.fitting.spectral.estimates import Fitted, Problem, estimate, quantile
from imucal.fitting.spectral.likelihood import Candidates, Structure, candidates_of, shaped_symbols
from imucal.fitting.spectral.ordinates import LAWS, SHAPED
from imucal.fitting.spectral.scoring import bounds, maximize
from imucal.fitting.spectral.selection import RankedModels
from imucal.noise.terms import ALWAYS, TERMS, in_order, term_keys

#: Symbol of a power-law term -> its column in a row of parameters.
COLUMN = {law.value: index for index, law in enumerate(LAWS)}


def estimate_or_bound(problem: Problem, choice: RankedModels) -> tuple[Fitted, tuple[Estimate, ...]]:
    """Return the best candidate, and estimates or bounds of its terms.

    A term whose interval holds zero is bounded and left out of the model; the other terms keep the
    values and intervals that they have beside it, since it may be there.
    """
    fitted = fitted_model(choice, 0)
    bounded: dict[str, Estimate] = {}
    estimates = estimate(problem, fitted)
    while len(estimates) > 1 and (gone := _can_not_stay(problem, fitted, estimates)):
        # The term whose absence costs the least likelihood.
        fits = [drop_terms(problem, fitted, [e.key]) for e in gone]
        least = int(np.argmin([float(fit.maximum.objective[0]) for fit in fits]))
        fitted, bounded[gone[least].key] = fits[least].by_time(), gone[least]
        estimates = estimate(problem, fitted)
    return fitted, ordered((*estimates, *bounded.values()))


def with_absent(problem: Problem, fitted: Fitted, estimates: tuple[Estimate, ...]) -> tuple[Estimate, ...]:
    """Add the bounds of N, B and K that a given model lacks: what it leaves them beside its own terms."""
    absent = set(ALWAYS).difference(e.symbol for e in estimates)
    bounds_of = [upper_bound(problem, add_term(problem, fitted, symbol), symbol) for symbol in absent]
    return ordered((*estimates, *bounds_of))


def ordered(estimates: Iterable[Estimate]) -> tuple[Estimate, ...]:
    """Return estimates by rising slope, those of one symbol by their keys."""
    order = list(TERMS)
    return tuple(sorted(estimates, key=lambda e: (order.index(e.symbol), e.key)))


def _can_not_stay(problem: Problem, fitted: Fitted, estimates: tuple[Estimate, ...]) -> list[Estimate]:
    """Return the terms of which one must go before the others' estimates mean something.

    Terms with a time but without power, whose time means nothing but makes others unsure; else terms
    that may stand for one another: each may be zero, but not all together.
    """
    gone = [e for e in estimates if e.status == "bounded"]
    timed = [e for e in gone if len(TERMS[e.symbol].parameters()) > 1]
    if timed or len(gone) < 2 or _may_all_be_absent(problem, fitted, gone):
        return timed
    return gone


def _may_all_be_absent(problem: Problem, fitted: Fitted, gone: list[Estimate]) -> bool:
    """Whether the terms whose intervals hold zero may all be zero together."""
    keys = [e.key for e in gone]
    if len(keys) == len(fitted.structure):
        return False
    without = drop_terms(problem, fitted, keys)
    drop = float(without.maximum.objective[0] - fitted.maximum.objective[0])
    return 2 * drop < quantile(problem.level) ** 2


def numbered(
    estimates: tuple[Estimate, ...], names: tuple[str, ...]
) -> tuple[tuple[Estimate, ...], tuple[str, ...]]:
    """Return estimates and parameters where each of several terms of one kind has a number.

    One that stayed when others were dropped was called by its symbol alone; it comes first.
    """
    every = sorted(estimates, key=lambda e: (list(TERMS).index(e.symbol), e.key))
    keys = term_keys(e.symbol for e in every)
    new = {e.key: key for e, key in zip(every, keys, strict=True)}
    result = tuple(replace(e, key=new[e.key]) for e in every)
    return result, tuple(".".join((new[key], *rest)) for key, *rest in (n.split(".") for n in names))


def fitted_model(choice: RankedModels, index: int) -> Fitted:
    """Return one of the ranked models, terms of one kind by rising time."""
    row = np.array([index])
    return Fitted(
        structure=choice.structures[index],
        candidate=choice.candidates.take(row),
        maximum=choice.maximum.take(row),
    ).by_time()


def drop_terms(problem: Problem, fitted: Fitted, keys: list[str]) -> Fitted:
    """Return the fit of the structure without some of its terms, started where it stands."""
    terms = list(zip(term_keys(fitted.structure), fitted.structure, strict=True))
    structure = tuple(symbol for key, symbol in terms if key not in keys)
    old = fitted.candidate
    shaped = [key for key, symbol in terms if symbol in shaped_symbols(fitted.structure)]
    places = [i for i, key in enumerate(shaped) if key not in keys]
    candidate = behind_filter(problem, fitted, structure, len(places))
    times = [old.variances + i for i in places]
    columns = [*range(SHAPED), *(SHAPED + i for i in places), *times, *range(old.response, old.width)]
    start = fitted.maximum.theta[:, columns]
    maximum = maximize(problem.ordinates, candidate, start, shortest=problem.shortest)
    return Fitted(structure=structure, candidate=candidate, maximum=maximum)


def behind_filter(problem: Problem, fitted: Fitted, structure: Structure, room: int) -> Candidates:
    """Return the candidate of another structure behind a fit's output filter."""
    return candidates_of(
        [structure],
        problem.ordinates.names,
        poles=int(fitted.candidate.poles[0]),
        zeros=int(fitted.candidate.zeros[0]),
        common=problem.common,
        room_shaped=room,
    )


def add_term(problem: Problem, fitted: Fitted, symbol: str) -> Fitted:
    """Return the fit with a power-law term added, started from almost none of it."""
    structure = in_order((*fitted.structure, symbol))
    candidate = behind_filter(problem, fitted, structure, fitted.candidate.room)
    low, _ = bounds(problem.ordinates, candidate, shortest=problem.shortest)
    column = COLUMN[symbol]
    starts = np.repeat(fitted.maximum.theta, 2, axis=0)
    starts[:, column] = low[column] + np.array([8.0, 16.0])
    both = candidate.take(np.zeros(2, dtype=np.int64))
    found = maximize(problem.ordinates, both, starts, shortest=problem.shortest)
    best = np.array([int(np.argmin(found.objective))])
    return Fitted(structure=structure, candidate=candidate, maximum=found.take(best))


def completed(problem: Problem, fitted: Fitted) -> Fitted:
    """Return the fit with the terms that every fit reports, at zero where the data want them there."""
    for symbol in fitted.missing:
        fitted = add_term(problem, fitted, symbol)
    return fitted


def upper_bound(problem: Problem, fitted: Fitted, symbol: str) -> Estimate:
    """Return the bound of a power-law term that was added."""
    _, highs = problem.limits(fitted, [COLUMN[symbol]])
    value = float(fitted.maximum.theta[0, COLUMN[symbol]])
    high = value + problem.widening.get(symbol, 1.0) * (float(highs[0]) - value)
    return Estimate.bounded(symbol, symbol, problem.deviation(symbol) * float(np.exp(high / 2)))


#: A model has its full say up to the first distance in the criterion from the best, none from the second on.
_FULL_SAY, _NO_SAY = 6.0, 9.0
#: Models whose likelihoods, at two a parameter, are within this tell their terms apart no more.
_ALIKE = 4.0
#: A lower limit of less than this part of the upper one is none.
_NOUGHT = 0.02
#: Most models that are looked at.
_MOST = 16


def hull_estimates(
    problem: Problem, choice: RankedModels, fitted: Fitted, own: tuple[Estimate, ...]
) -> tuple[Fitted, tuple[Estimate, ...], tuple[Estimate, ...]]:
    """Return the model to draw, its own estimates, and those whose intervals hold for every near model.

    A term whose interval reaches down to zero is bounded, also where the chosen model has it. Where N, B
    or K is shown that the chosen model lacks, the model is drawn with it: a parameter costs the choice
    more than data need to show it, and terms that are printed should add up to the line.
    """
    models = [
        {e.key: e for e in estimate(_with_say(problem, distance), model)}
        for distance, model in _completed(problem, choice)
    ]
    shown = {key for key in ALWAYS if not any(_may_be_zero(model[key]) for model in models)}
    if shown - set(fitted.structure):
        fitted, own = _richer(problem, fitted, shown, own)
    values = {key: models[0][key] for key in ALWAYS} | {e.key: e for e in own}
    others = _alternatives(choice)
    found = (_hull(value, _span(key, values, models)) for key, value in values.items())
    return fitted, own, ordered(replace(e, alternatives=others.get(e.symbol, ())) for e in found)


def _richer(
    problem: Problem, fitted: Fitted, shown: set[str], own: tuple[Estimate, ...]
) -> tuple[Fitted, tuple[Estimate, ...]]:
    """Return the chosen model, less what was dropped, with the terms that are shown; and its estimates."""
    for symbol in ALWAYS:
        if symbol in shown and symbol not in fitted.structure:
            fitted = add_term(problem, fitted, symbol)
    return fitted, ordered(({e.key: e for e in own} | {e.key: e for e in estimate(problem, fitted)}).values())


def _span(key: str, values: dict[str, Estimate], models: list[dict[str, Estimate]]) -> list[Estimate]:
    """Return what each model says of a term; of others than N, B and K, each model that has the same ones."""
    if key in ALWAYS:
        return [model[key] for model in models]
    others = values.keys() - set(ALWAYS)
    return [model[key] for model in models if model.keys() - set(ALWAYS) == others]


def _alternatives(choice: RankedModels) -> dict[str, tuple[str, ...]]:
    """Return for each term those that may stand in its place: one of the two is there, but not told which.

    Every model of about the best likelihood has one of them, and neither is in all of these models. Here
    a parameter has the price of Akaike's criterion: what tells two things apart is the record, and not
    that one of them is simpler to write down.
    """
    fit = 2 * (choice.maximum.objective + choice.candidates.parameters)
    near = [set(choice.structures[i]) for i in np.flatnonzero(fit - fit.min() <= _ALIKE)]

    def replaces(one: str, other: str) -> bool:
        without_one, without_other = ([s for s in near if symbol not in s] for symbol in (one, other))
        return bool(without_one and without_other) and all(one in s or other in s for s in near)

    return {one: tuple(other for other in TERMS if replaces(one, other)) for one in TERMS}


def _hull(own: Estimate, span: list[Estimate]) -> Estimate:
    """Return an estimate with the limits of all models; itself where no near model has its term."""
    if not span:
        return own
    high = max(e.high for e in span)
    if own.value is None or any(map(_may_be_zero, span)):
        return Estimate.bounded(own.key, own.symbol, high)
    time = own.correlation_time
    if time is not None:
        times = [time, *(e.correlation_time for e in span if e.correlation_time)]
        time = replace(time, low=min(t.low for t in times), high=max(t.high for t in times))
    low = min(own.value, *(e.low for e in span))
    return replace(own, low=low, high=max(own.value, high), correlation_time=time)


def _may_be_zero(found: Estimate) -> bool:
    """Whether an interval reaches down to zero, or to what is printed as zero beside its upper limit."""
    return found.low <= _NOUGHT * found.high


def _completed(problem: Problem, choice: RankedModels) -> Iterator[tuple[float, Fitted]]:
    """Yield the distinct completions of the near models and their distances, that of the best first."""
    distances = choice.criterion - choice.criterion[0]
    seen = set()
    for index in np.flatnonzero(distances < _NO_SAY)[:_MOST].tolist():
        model = fitted_model(choice, index)
        structure = in_order((*model.structure, *model.missing))
        if structure not in seen:
            seen.add(structure)
            yield float(distances[index]), completed(problem, model)


def _with_say(problem: Problem, distance: float) -> Problem:
    """Return the problem at the level that a model at that distance deserves."""
    from scipy.special import ndtr

    say = min((_NO_SAY - distance) / (_NO_SAY - _FULL_SAY), 1.0)
    return replace(problem, level=float(2 * ndtr(say * quantile(problem.level)) - 1))
