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
import scipy

from imucal.fitting.homogeneity import NOUGHT
from imucal.fitting.noise_fit import Estimate, Interval
from imucal.fitting.spectral.estimates import Fitted, Problem, estimate, quantile
from imucal.fitting.spectral.likelihood import (
    COLUMN,
    Candidates,
    Structure,
    candidates_of,
    shaped_symbols,
)
from imucal.fitting.spectral.ordinates import SHAPED
from imucal.fitting.spectral.scoring import bounds, maximize
from imucal.fitting.spectral.selection import RankedModels
from imucal.frozen import frozen_alone
from imucal.noise.terms import ALWAYS, TERMS, GaussMarkov, in_order, term_keys


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
    if timed or len(gone) < 2:
        return timed
    if len(gone) < len(fitted.structure):
        without = drop_terms(problem, fitted, [e.key for e in gone])
        drop = float(without.maximum.objective[0] - fitted.maximum.objective[0])
        if 2 * drop < quantile(problem.level) ** 2:
            return []
    return gone


def numbered(
    estimates: tuple[Estimate, ...], names: tuple[str, ...]
) -> tuple[tuple[Estimate, ...], tuple[str, ...]]:
    """Return estimates and parameters where each of several terms of one kind has a number.

    One that stayed when others were dropped was called by its symbol alone; it comes first.
    """
    every = ordered(estimates)
    keys = term_keys(e.symbol for e in every)
    new = {e.key: key for e, key in zip(every, keys, strict=True)}
    result = tuple(replace(e, key=new[e.key]) for e in every)
    return result, tuple(".".join((new[key], *rest)) for key, *rest in (n.split(".") for n in names))


def fitted_model(choice: RankedModels, index: int) -> Fitted:
    """Return one of the ranked models, terms of one kind by rising time."""
    return Fitted(structure=choice.structures[index], maximum=choice.maximum[[index]]).by_time()


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
    return Fitted(structure=structure, maximum=maximize(problem.ordinates, candidate, start))


def behind_filter(problem: Problem, fitted: Fitted, structure: Structure, room: int) -> Candidates:
    """Return the candidate of another structure behind a fit's output filter."""
    return candidates_of(
        [structure],
        problem.ordinates.names,
        poles=int(fitted.candidate.poles[0]),
        zeros=int(fitted.candidate.zeros[0]),
        room_shaped=room,
        shortest=fitted.candidate.shortest,
    )


def add_term(problem: Problem, fitted: Fitted, symbol: str) -> Fitted:
    """Return the fit with a power-law term added, started from almost none of it."""
    structure = in_order((*fitted.structure, symbol))
    candidate = behind_filter(problem, fitted, structure, fitted.candidate.room)
    low, _ = bounds(problem.ordinates, candidate)
    column = COLUMN[symbol]
    starts = np.repeat(fitted.maximum.theta, 2, axis=0)
    starts[:, column] = low[column] + np.array([8.0, 16.0])
    found = maximize(problem.ordinates, candidate[[0, 0]], starts)
    return Fitted(structure=structure, maximum=found[[int(np.argmin(found.objective))]])


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
#: A Gauss-Markov term slower than this part of the record is a walk to it: it speaks for K.
_WALK = 1 / 20
#: Terms whose lower limit is lowered, not set to zero, by a model of weight below 1. B is not among them: a
#: Gauss-Markov term of some seconds next to a walk resembles flicker; B was shown in 21 of 24 records.
_FADES = frozenset({"K"})
#: Most models that are looked at.
_MOST = 16


@frozen_alone
class Opinion:
    """What a near model says of its terms: its estimates by their keys.

    Its `say` is how much it counts, 1 near the best and 0 far from it; limits are as far from the values.
    """

    say: float
    terms: dict[str, Estimate]
    fitted: Fitted

    @property
    def slow(self) -> bool:
        """Whether its K is the walk of a slow Gauss-Markov term."""
        return self.terms["K"].horizon_s < np.inf

    def vetoes(self, key: str) -> bool:
        """Whether a term may be zero here, and this is near enough for that to bound it."""
        return _may_be_zero(self.terms[key]) and (self.say >= 1 or key not in _FADES)


def hull_estimates(
    problem: Problem, choice: RankedModels
) -> tuple[Fitted, tuple[Estimate, ...], tuple[Estimate, ...]]:
    """Return the model to draw, its own estimates, and those whose intervals hold for every near model.

    A term whose interval reaches down to zero is bounded, also where the chosen model has it. Where N, B
    or K is shown that the chosen model lacks, the model is drawn with it: a parameter costs the choice
    more than data need to show it, and terms that are printed should add up to the line. Not so a K that
    is the walk of a Gauss-Markov term, which the model has already.
    """
    fitted, own = estimate_or_bound(problem, choice)
    models = [_opinion(problem, distance, model) for distance, model in _completed(problem, choice)]
    shown = {key for key in ALWAYS if not any(model.vetoes(key) for model in models)}
    walks = "K" not in fitted.structure and models[0].slow
    drawn = shown - {"K"} if walks else shown
    if drawn - set(fitted.structure):
        fitted, own = _richer(problem, fitted, drawn, own)
    values = {key: models[0].terms[key] for key in ALWAYS} | {e.key: e for e in own}
    values |= {key: _first_shown(values[key], models) for key in shown}
    found = {key: _hull(value, _span(key, values, models)) for key, value in values.items()}
    if found["N"].value is None:
        found["N"] = _floor(problem, found["N"], [model.fitted for model in models])
    return fitted, own, ordered(_with_rivals(problem, choice, found, models))


def _with_rivals(
    problem: Problem, choice: RankedModels, found: dict[str, Estimate], models: list[Opinion]
) -> Iterator[Estimate]:
    """Yield estimates with the terms that may stand in their place, and for how long K holds beside them."""
    others, markov = _alternatives(choice), GaussMarkov.symbol
    horizon = min(model.terms["K"].horizon_s for model in models)
    if markov in others["K"]:
        # The lower limit of T of the slowest term that the nearest model has in place of K.
        rivals = (s for s in choice.structures if markov in s and "K" not in s)
        rival = fitted_model(choice, choice.structures.index(next(rivals)))
        slowest = [column for name, column in rival.columns() if name.endswith(".T")][-1]
        horizon = min(horizon, problem.tau0 * float(np.exp(problem.limits(rival, [slowest])[0][0])))
    elif horizon < np.inf:
        others["K"] = (*others["K"], markov)
    if any(model.vetoes("N") for model in models) and markov not in others["N"]:
        others["N"] = (*others["N"], markov)
    for e in found.values():
        yield replace(e, alternatives=others[e.symbol], horizon_s=horizon if e.key == "K" else np.inf)


def _first_shown(own: Estimate, models: list[Opinion]) -> Estimate:
    """Return what the nearest model with a value says of a term, where the chosen one has none."""
    every = (own, *(model.terms[own.key] for model in models))
    return next((e for e in every if e.value is not None), own)


def _opinion(problem: Problem, distance: float, model: Fitted) -> Opinion:
    """Return what a model at that distance from the best says; its slowest term may say what K is."""
    say = min((_NO_SAY - distance) / (_NO_SAY - _FULL_SAY), 1.0)
    reach = say * quantile(problem.level)
    terms = {
        e.key: e for e in estimate(replace(problem, level=float(2 * scipy.special.ndtr(reach) - 1)), model)
    }
    slowest = max((e for e in terms.values() if e.value), key=_time_of, default=terms["K"])
    if _may_be_zero(terms["K"]) and _time_of(slowest) > _WALK * problem.ordinates.samples * problem.tau0:
        terms["K"] = _walk(slowest, terms["K"].high, reach, model)
    return Opinion(say=say, terms=terms, fitted=model)


def _time_of(found: Estimate) -> float:
    """Return the correlation time of a Gauss-Markov term, in s; 0 of other terms."""
    time = found.correlation_time
    return time.value if time and found.symbol == GaussMarkov.symbol else 0.0


def _walk(slow: Estimate, high: float, reach: float, model: Fitted) -> Estimate:
    """Return the walk sigma sqrt(2/T) that a slow Gauss-Markov term begins with; at most `high`, or more.

    Sigma and T of such a term are unsure by themselves, and the walk that both make is not: its
    limits are `reach` standard errors of half the difference of log sigma² and log T. It holds for times
    up to the lower limit of T.
    """
    columns = dict(model.columns())
    sigma, time = (columns[name] for name in GaussMarkov.parameter_names(slow.key))
    inverse = model.covariance
    variance = inverse[sigma, sigma]
    if np.isfinite(inverse[time, time]):
        variance += inverse[time, time] - 2 * inverse[sigma, time]
    factor = float(np.exp(0.5 * reach * np.sqrt(max(variance, 0.0))))
    span = slow.correlation_time
    value = float((slow.value or 0.0) * np.sqrt(2 / _time_of(slow)))
    low, high = value / factor, max(value * factor, high)
    walk = Estimate(key="K", symbol="K", status="estimated", value=value, low=low, high=high)
    return replace(walk, horizon_s=span.low if span else np.inf)


def _floor(problem: Problem, bound: Estimate, models: list[Fitted]) -> Estimate:
    """Return the greatest white noise below the spectra of the near models, where N may be zero.

    Every record has a floor. Where a quick Gauss-Markov term at the end of the band may have all of it, the
    models differ in its name and not in its level.
    """
    ordinates = problem.ordinates
    levels, freedom = [], []
    for model in models:
        spectrum = model.unfiltered(ordinates)
        lowest = int(np.argmin(spectrum))
        octave = np.abs(np.log2(ordinates.fraction / ordinates.fraction[lowest])) < 0.5
        levels.append(problem.deviation("N") * float(np.sqrt(spectrum[lowest])))
        freedom.append(float(ordinates.size[octave].sum()))
    # A variance told by n ordinates is sure to the root of 2/n; its root to half of that.
    reach = problem.widening.get("N", 1.0) * quantile(problem.level) / np.sqrt(2 * max(min(freedom), 1.0))
    low, high = min(levels) * float(np.exp(-reach)), max(levels) * float(np.exp(reach))
    return replace(bound, status="estimated", value=levels[0], low=low, high=max(bound.high, high))


def _richer(
    problem: Problem, fitted: Fitted, shown: set[str], own: tuple[Estimate, ...]
) -> tuple[Fitted, tuple[Estimate, ...]]:
    """Return the chosen model, less what was dropped, with the terms that are shown; and its estimates."""
    for symbol in ALWAYS:
        if symbol in shown and symbol not in fitted.structure:
            fitted = add_term(problem, fitted, symbol)
    return fitted, ordered(({e.key: e for e in own} | {e.key: e for e in estimate(problem, fitted)}).values())


def _span(key: str, values: dict[str, Estimate], models: list[Opinion]) -> list[tuple[float, Estimate]]:
    """Return the say of each model and what it says of a term.

    Of others than N, B and K, each model that has the same ones.
    """
    if key in ALWAYS:
        return [(model.say, model.terms[key]) for model in models]
    others = values.keys() - set(ALWAYS)
    return [(m.say, m.terms[key]) for m in models if m.terms.keys() - set(ALWAYS) == others]


def either(estimates: tuple[Estimate, ...], others: tuple[Estimate, ...]) -> tuple[Estimate, ...]:
    """Return estimates with N, B and K so wide that they hold the limits of two fits; else the first's."""
    other = {e.key: e for e in others if e.symbol in ALWAYS}
    spans = {e.key: [(1.0, e), (1.0, other[e.key])] for e in estimates if e.key in other}
    return tuple(
        replace(_hull(e, spans[e.key]), alternatives=e.alternatives, horizon_s=e.horizon_s)
        if e.key in spans
        else e
        for e in estimates
    )


def _alternatives(choice: RankedModels) -> dict[str, tuple[str, ...]]:
    """Return for each term those that may stand in its place: one of the two is there, but not told which.

    Every model of about the best likelihood has one of them, and neither is in all of these models. Here
    a parameter has the price of Akaike's criterion: what tells two things apart is the record, and not
    that one of them is simpler to write down.
    """
    fit = 2 * (choice.maximum.objective + choice.maximum.candidates.parameters)
    near = [set(choice.structures[i]) for i in np.flatnonzero(fit - fit.min() <= _ALIKE)]

    def replaces(one: str, other: str) -> bool:
        without_one, without_other = ([s for s in near if symbol not in s] for symbol in (one, other))
        return bool(without_one and without_other) and all(one in s or other in s for s in near)

    return {one: tuple(other for other in TERMS if replaces(one, other)) for one in TERMS}


def _hull(own: Estimate, span: list[tuple[float, Estimate]]) -> Estimate:
    """Return an estimate with the limits of all models; itself where no near model has its term.

    A model with its full say that has the term at zero bounds it; one with less draws the lower limit of one
    that `_FADES` towards zero.
    """
    if not span:
        return own
    high = max(e.high for _, e in span)
    zeros = [say for say, e in span if _may_be_zero(e)]
    if own.value is None or (zeros and (max(zeros) >= 1 or own.key not in _FADES)):
        return Estimate.bounded(own.key, own.symbol, high)
    low = min([own.value, *(e.low for _, e in span if not _may_be_zero(e))])
    low *= float(np.prod([1 - say for say in zeros]))
    time = _time_hull(own.correlation_time, [e for _, e in span])
    found = replace(own, low=low, high=max(own.value, high), correlation_time=time)
    return Estimate.bounded(own.key, own.symbol, high) if _may_be_zero(found) else found


def _time_hull(own: Interval | None, span: list[Estimate]) -> Interval | None:
    """Return a correlation time with the limits of all models."""
    if own is None:
        return None
    times = [own, *(e.correlation_time for e in span if e.correlation_time)]
    return replace(own, low=min(t.low for t in times), high=max(t.high for t in times))


def _may_be_zero(found: Estimate) -> bool:
    """Whether an interval reaches down to zero, or to what is printed as zero beside its upper limit."""
    return found.low <= NOUGHT * found.high


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
