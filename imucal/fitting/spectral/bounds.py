"""Estimates whose intervals allow for the choice of the model.

If a weak term is dropped, its neighbour absorbs its power with an interval that is too narrow. So each model
whose criterion is near the best is completed with the terms that every fit reports, and a term's interval is
the hull of its intervals in these models. The weight of a model decreases with its distance from the best.

Leeb & Pötscher (2005), Econometric Theory 21, p. 21, "Model selection and inference: facts and fiction",
explain the problem; `tests/benchmarks/coverage_auto.py` measures the coverage of this remedy.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy

from imucal.fitting.homogeneity import NEGLIGIBLE
from imucal.fitting.noise_fit import Estimate, Interval
from imucal.fitting.spectral.estimates import Problem, estimate, quantile
from imucal.fitting.spectral.likelihood import Fits
from imucal.fitting.spectral.maximum import bounds, maximize
from imucal.fitting.spectral.models import COLUMN, has_time
from imucal.fitting.spectral.selection import RankedModels, alternatives_among
from imucal.noise.terms import ALWAYS, TERMS, GaussMarkov, in_order, term_keys


def estimate_or_bound(problem: Problem, choice: RankedModels) -> tuple[Fits, tuple[Estimate, ...]]:
    """Return the best candidate, and estimates or bounds of its terms.

    A term whose interval contains zero is bounded and left out of the model. The other terms keep their
    intervals from the fit with it, since it may exist.
    """
    fitted = choice.fits[[0]]
    bounded: dict[str, Estimate] = {}
    estimates = estimate(problem, fitted)
    while len(estimates) > 1 and (gone := _can_not_stay(problem, fitted, estimates)):
        fits = [drop_terms(problem, fitted, [e.key]) for e in gone]
        least = int(np.argmin([float(fit.objective[0]) for fit in fits]))
        fitted, bounded[gone[least].key] = fits[least], gone[least]
        estimates = estimate(problem, fitted)
    return fitted, ordered((*estimates, *bounded.values()))


def with_absent(problem: Problem, fitted: Fits, estimates: tuple[Estimate, ...]) -> tuple[Estimate, ...]:
    """Add the upper bounds of N, B and K if the model lacks them."""
    absent = set(ALWAYS).difference(e.symbol for e in estimates)
    bounds_of = [upper_bound(problem, add_term(problem, fitted, symbol), symbol) for symbol in absent]
    return ordered((*estimates, *bounds_of))


def ordered(estimates: Iterable[Estimate]) -> tuple[Estimate, ...]:
    """Return estimates by rising slope, then by key."""
    order = list(TERMS)
    return tuple(sorted(estimates, key=lambda e: (order.index(e.symbol), e.key)))


def _can_not_stay(problem: Problem, fitted: Fits, estimates: tuple[Estimate, ...]) -> list[Estimate]:
    """Return terms of which one must be dropped to make the other estimates meaningful.

    A bounded term with an arbitrary time widens other intervals; terms may replace one another.
    """
    gone = [e for e in estimates if e.status == "bounded"]
    timed = [e for e in gone if has_time(e.symbol)]
    if timed or len(gone) < 2:
        return timed
    if len(gone) < len(fitted.structure):
        without = drop_terms(problem, fitted, [e.key for e in gone])
        drop = float(without.objective[0] - fitted.objective[0])
        if 2 * drop < quantile(problem.level) ** 2:
            return []
    return gone


def numbered(
    estimates: tuple[Estimate, ...], names: tuple[str, ...]
) -> tuple[tuple[Estimate, ...], tuple[str, ...]]:
    """Return estimates and parameter names, with numbered keys for several terms of one kind."""
    every = ordered(estimates)
    keys = term_keys(e.symbol for e in every)
    new = {e.key: key for e, key in zip(every, keys, strict=True)}
    result = tuple(replace(e, key=new[e.key]) for e in every)
    return result, tuple(".".join((new[key], *rest)) for key, *rest in (n.split(".") for n in names))


def drop_terms(problem: Problem, fitted: Fits, keys: list[str]) -> Fits:
    """Return the fit without some of its terms."""
    columns = [at for key, at in fitted.variances().items() if key in keys]
    return maximize(problem.ordinates, fitted.models.without(columns, ramp="R" in keys), fitted.theta)


def add_term(problem: Problem, fitted: Fits, symbol: str) -> Fits:
    """Return the fit with a power-law term added, started from almost zero."""
    models = fitted.models.with_laws([symbol])[[0, 0]]
    low, _ = bounds(problem.ordinates, models)
    column = COLUMN[symbol]
    starts = np.repeat(fitted.theta, 2, axis=0)
    starts[:, column] = low[column] + np.array([8.0, 16.0])
    found = maximize(problem.ordinates, models, starts)
    return found[[int(np.argmin(found.objective))]]


def completed(problem: Problem, fitted: Fits) -> Fits:
    """Return the fit with the terms that every fit reports."""
    for symbol in fitted.missing:
        fitted = add_term(problem, fitted, symbol)
    return fitted


def upper_bound(problem: Problem, fitted: Fits, symbol: str) -> Estimate:
    """Return the bound of a power-law term that was added."""
    _, highs = problem.limits(fitted, [COLUMN[symbol]])
    value = float(fitted.theta[0, COLUMN[symbol]])
    high = value + problem.widening.get(symbol, 1.0) * (float(highs[0]) - value)
    return Estimate.bounded(symbol, symbol, problem.deviation(symbol) * float(np.exp(high / 2)))


#: Distance in the criterion from the best up to which a model counts in full.
_FULL_WEIGHT = 6.0
#: Distance from which it does not count; between the two, limits change steadily.
_NO_WEIGHT = 9.0
#: Difference in Akaike's criterion within which the data can't distinguish models.
_INDISTINGUISHABLE = 4.0
#: Share of the record from which a Gauss-Markov term's correlation time makes it K.
_WALK = 1 / 20
#: Terms whose lower limit is only lowered by a model of weight below 1. B is not among them: a Gauss-Markov
#: term of some seconds next to a walk resembles flicker.
_LOWERED = frozenset({"K"})
#: Largest number of models that are completed.
_MAX_COMPLETED = 16


@dataclass(frozen=True, kw_only=True, eq=False)
class Alternative:
    """Estimates of a model near the best, by key; `weight` (1 near, 0 far) scales the intervals."""

    weight: float
    terms: dict[str, Estimate]
    fitted: Fits

    @property
    def slow(self) -> bool:
        return self.terms["K"].horizon_s < np.inf

    def excludes(self, key: str) -> bool:
        return _may_be_zero(self.terms[key]) and (self.weight >= 1 or key not in _LOWERED)


def hull_estimates(
    problem: Problem, choice: RankedModels
) -> tuple[Fits, tuple[Estimate, ...], tuple[Estimate, ...]]:
    """Return the model to draw, its own estimates, and estimates whose intervals cover all near models.

    If N, B or K is detected but not in the chosen model, it is added to the drawn model, so that the printed
    terms add up to the line. The exception is a K that describes a Gauss-Markov term of the model.
    """
    fitted, own = estimate_or_bound(problem, choice)
    models = [_alternative(problem, distance, model) for distance, model in _completed(problem, choice)]
    detected = {key for key in ALWAYS if not any(model.excludes(key) for model in models)}
    walks = "K" not in fitted.structure and models[0].slow
    drawn = detected - {"K"} if walks else detected
    if drawn - set(fitted.structure):
        fitted, own = _richer(problem, fitted, drawn, own)
    values = {key: models[0].terms[key] for key in ALWAYS} | {e.key: e for e in own}
    values |= {key: _first_detected(values[key], models) for key in detected}
    found = {key: _hull(value, _span(key, values, models)) for key, value in values.items()}
    if found["N"].value is None:
        found["N"] = _floor(problem, found["N"], [model.fitted for model in models])
    return fitted, own, ordered(_with_rivals(problem, choice, found, models))


def _with_rivals(
    problem: Problem, choice: RankedModels, found: dict[str, Estimate], models: list[Alternative]
) -> Iterator[Estimate]:
    """Yield estimates with their alternative terms, and K with the longest time for which it is valid."""
    others, markov = _alternatives(choice), GaussMarkov.symbol
    horizon = min(model.terms["K"].horizon_s for model in models)
    if markov in others["K"]:
        # K is valid up to the lower limit of the replacing term's T.
        rivals = (s for s in choice.structures if markov in s and "K" not in s)
        rival = choice.fits[[choice.structures.index(next(rivals))]]
        slowest = [column for name, column in rival.columns() if name.endswith(".T")][-1]
        horizon = min(horizon, problem.tau0 * float(np.exp(problem.limits(rival, [slowest])[0][0])))
    elif horizon < np.inf:
        others["K"] = (*others["K"], markov)
    if any(model.excludes("N") for model in models) and markov not in others["N"]:
        others["N"] = (*others["N"], markov)
    for e in found.values():
        yield replace(e, alternatives=others[e.symbol], horizon_s=horizon if e.key == "K" else np.inf)


def _first_detected(own: Estimate, models: list[Alternative]) -> Estimate:
    every = (own, *(model.terms[own.key] for model in models))
    return next((e for e in every if e.value is not None), own)


def _alternative(problem: Problem, distance: float, model: Fits) -> Alternative:
    """Return the estimates of a model at a `distance` from the best; its slowest term may replace K."""
    weight = min((_NO_WEIGHT - distance) / (_NO_WEIGHT - _FULL_WEIGHT), 1.0)
    reach = weight * quantile(problem.level)
    terms = {
        e.key: e for e in estimate(replace(problem, level=float(2 * scipy.special.ndtr(reach) - 1)), model)
    }
    slowest = max((e for e in terms.values() if e.value), key=_time_of, default=terms["K"])
    if _may_be_zero(terms["K"]) and _time_of(slowest) > _WALK * problem.ordinates.samples * problem.tau0:
        terms["K"] = _walk(slowest, terms["K"].high, reach, model)
    return Alternative(weight=weight, terms=terms, fitted=model)


def _time_of(found: Estimate) -> float:
    time = found.correlation_time
    return time.value if time and found.symbol == GaussMarkov.symbol else 0.0


def _walk(slow: Estimate, high: float, reach: float, model: Fits) -> Estimate:
    """Return the walk sigma sqrt(2/T) of a slow Gauss-Markov term, valid up to the lower limit of T.

    Its limits are `reach` standard errors of half of log(sigma²/T).
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


def _floor(problem: Problem, bound: Estimate, models: list[Fits]) -> Estimate:
    """Return N from the minima of the near models' spectra, if a fast Gauss-Markov term can replace it."""
    ordinates = problem.ordinates
    levels, freedom = [], []
    for model in models:
        spectrum = model.unfiltered(ordinates)
        lowest = int(np.argmin(spectrum))
        octave = np.abs(np.log2(ordinates.fraction / ordinates.fraction[lowest])) < 0.5
        levels.append(problem.deviation("N") * float(np.sqrt(spectrum[lowest])))
        freedom.append(float(ordinates.size[octave].sum()))
    # Relative standard error of the root of a variance from n ordinates: sqrt(2/n)/2.
    reach = problem.widening.get("N", 1.0) * quantile(problem.level) / np.sqrt(2 * max(min(freedom), 1.0))
    low, high = min(levels) * float(np.exp(-reach)), max(levels) * float(np.exp(reach))
    return replace(bound, status="estimated", value=levels[0], low=low, high=max(bound.high, high))


def _richer(
    problem: Problem, fitted: Fits, detected: set[str], own: tuple[Estimate, ...]
) -> tuple[Fits, tuple[Estimate, ...]]:
    for symbol in ALWAYS:
        if symbol in detected and symbol not in fitted.structure:
            fitted = add_term(problem, fitted, symbol)
    return fitted, ordered(({e.key: e for e in own} | {e.key: e for e in estimate(problem, fitted)}).values())


def _span(key: str, values: dict[str, Estimate], models: list[Alternative]) -> list[tuple[float, Estimate]]:
    """Return the weight and estimate of a term in each model, or in similar models only."""
    if key in ALWAYS:
        return [(model.weight, model.terms[key]) for model in models]
    others = values.keys() - set(ALWAYS)
    return [(m.weight, m.terms[key]) for m in models if m.terms.keys() - set(ALWAYS) == others]


def either(estimates: tuple[Estimate, ...], others: tuple[Estimate, ...]) -> tuple[Estimate, ...]:
    """Return the estimates, with intervals of N, B and K that cover both fits."""
    other = {e.key: e for e in others if e.symbol in ALWAYS}
    spans = {e.key: [(1.0, e), (1.0, other[e.key])] for e in estimates if e.key in other}
    return tuple(
        replace(_hull(e, spans[e.key]), alternatives=e.alternatives, horizon_s=e.horizon_s)
        if e.key in spans
        else e
        for e in estimates
    )


def _alternatives(choice: RankedModels) -> dict[str, tuple[str, ...]]:
    fit = 2 * (choice.fits.objective + choice.fits.models.parameters)
    near = np.flatnonzero(fit - fit.min() <= _INDISTINGUISHABLE)
    return alternatives_among([choice.structures[i] for i in near.tolist()])


def _hull(own: Estimate, span: list[tuple[float, Estimate]]) -> Estimate:
    """Return an estimate with the limits of all models.

    A model of weight 1 with the term at zero bounds it; so does any model if the term is not in `_LOWERED`.
    """
    if not span:
        return own
    high = max(e.high for _, e in span)
    zeros = [weight for weight, e in span if _may_be_zero(e)]
    if own.value is None or (zeros and (max(zeros) >= 1 or own.key not in _LOWERED)):
        return Estimate.bounded(own.key, own.symbol, high)
    low = min([own.value, *(e.low for _, e in span if not _may_be_zero(e))])
    low *= float(np.prod([1 - weight for weight in zeros]))
    time = _time_hull(own.correlation_time, [e for _, e in span])
    found = replace(own, low=low, high=max(own.value, high), correlation_time=time)
    return Estimate.bounded(own.key, own.symbol, high) if _may_be_zero(found) else found


def _time_hull(own: Interval | None, span: list[Estimate]) -> Interval | None:
    if own is None:
        return None
    times = [own, *(e.correlation_time for e in span if e.correlation_time)]
    return replace(own, low=min(t.low for t in times), high=max(t.high for t in times))


def _may_be_zero(found: Estimate) -> bool:
    return found.low <= NEGLIGIBLE * found.high


def _completed(problem: Problem, choice: RankedModels) -> Iterator[tuple[float, Fits]]:
    """Yield distances and distinct completions of the near models, the best first."""
    distances = choice.criterion - choice.criterion[0]
    seen = set()
    for index in np.flatnonzero(distances < _NO_WEIGHT)[:_MAX_COMPLETED].tolist():
        model = choice.fits[[index]]
        structure = in_order((*model.structure, *model.missing))
        if structure not in seen:
            seen.add(structure)
            yield float(distances[index]), completed(problem, model)
