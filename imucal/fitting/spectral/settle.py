"""From the chosen candidate to estimates: terms that may be zero have a bound instead of a value."""

from dataclasses import dataclass, replace

import numpy as np

from imucal.fitting.noise_fit import Estimate
from imucal.fitting.spectral.estimates import (
    Fitted,
    Scales,
    add_term,
    drop_terms,
    estimate,
    upper_bound,
)
from imucal.fitting.spectral.intervals import quantile
from imucal.fitting.spectral.ordinates import Ordinates
from imucal.fitting.spectral.selection import Choice
from imucal.noise.terms import ALWAYS, TERMS

#: Models within this of the best have a say in an absent term's bound, and how many at most.
_NEAR, _VOICES = 6.0, 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """What every interval of a fit is computed with.

    Attributes
    ----------
    level
        Confidence level.
    shortest
        Shortest correlation time, in samples.
    common
        Regressors in every model.
    scales
        From scaled units to SI.
    """

    level: float
    shortest: float
    common: tuple[str, ...]
    scales: Scales


def settle(ordinates: Ordinates, choice: Choice, setting: Setting) -> tuple[Fitted, tuple[Estimate, ...]]:
    """Return the best candidate, and estimates or bounds of its terms and of N, B and K.

    A term whose interval holds zero is bounded and left out of the model; the other terms keep the
    values and intervals that they have beside it, since it may be there.
    """
    fitted = _candidate(choice, 0)
    bounded: dict[str, Estimate] = {}
    while True:
        estimates = _estimate(ordinates, fitted, setting)
        gone = [e for e in estimates if e.status == "bounded"]
        markov = [e for e in gone if e.symbol == "GM"]
        if not markov and (len(gone) < 2 or _may_all_be_absent(ordinates, fitted, gone, setting)):
            break
        if len(estimates) == 1:
            break
        # Dropped one at a time: a Gauss-Markov term without power, whose time means nothing but
        # makes others unsure; and of terms that may stand for one another all but one.
        fitted, dropped = _without_least(ordinates, fitted, markov or gone, setting)
        bounded[dropped.key] = dropped
    symbols = {e.symbol for e in (*estimates, *bounded.values())}
    for symbol in ALWAYS:
        if symbol not in symbols:
            bounded[symbol] = _bound(ordinates, choice, fitted, symbol, setting)
    order = list(TERMS)
    everything = sorted((*estimates, *bounded.values()), key=lambda e: (order.index(e.symbol), e.key))
    return fitted, tuple(everything)


def _may_all_be_absent(ordinates: Ordinates, fitted: Fitted, gone: list[Estimate], setting: Setting) -> bool:
    """Whether the terms whose intervals hold zero may all be zero together."""
    keys = [e.key for e in gone]
    if len(keys) == len(fitted.structure):
        return False
    without = drop_terms(ordinates, fitted, keys, shortest=setting.shortest, common=setting.common)
    drop = float(without.maximum.objective[0] - fitted.maximum.objective[0])
    return 2 * drop < quantile(setting.level) ** 2


def numbered(
    estimates: tuple[Estimate, ...], names: tuple[str, ...]
) -> tuple[tuple[Estimate, ...], tuple[str, ...]]:
    """Return estimates and parameters where each of several Gauss-Markov terms has a number.

    One that stayed when others were dropped was called ``GM``; it comes first.
    """
    if sum(e.symbol == "GM" for e in estimates) < 2 or all(e.key != "GM" for e in estimates):
        return estimates, names
    others = (e.key for e in estimates if e.symbol == "GM" and e.key != "GM")
    keys = {"GM": "GM1"} | {key: f"GM{index + 2}" for index, key in enumerate(sorted(others))}
    result = [replace(e, key=keys[e.key]) if e.symbol == "GM" else e for e in estimates]
    result.sort(key=lambda e: (list(TERMS).index(e.symbol), e.key))
    return tuple(result), tuple(name.replace("GM.", "GM1.") for name in names)


def _without_least(
    ordinates: Ordinates, fitted: Fitted, gone: list[Estimate], setting: Setting
) -> tuple[Fitted, Estimate]:
    """Return the fit without the term whose absence costs the least likelihood, and its bound."""
    fits = [
        drop_terms(ordinates, fitted, [e.key], shortest=setting.shortest, common=setting.common) for e in gone
    ]
    best = int(np.argmin([float(fit.maximum.objective[0]) for fit in fits]))
    return fits[best].by_time(), gone[best]


def _candidate(choice: Choice, index: int) -> Fitted:
    row = np.array([index])
    return Fitted(
        structure=choice.structures[index],
        candidate=choice.candidates.take(row),
        maximum=choice.maximum.take(row),
    ).by_time()


def _estimate(ordinates: Ordinates, fitted: Fitted, setting: Setting) -> tuple[Estimate, ...]:
    return estimate(ordinates, fitted, setting.scales, level=setting.level, shortest=setting.shortest)


def _bound(ordinates: Ordinates, choice: Choice, fitted: Fitted, symbol: str, setting: Setting) -> Estimate:
    """Return the bound of an absent term: the highest that any model near the best leaves it."""
    near = np.flatnonzero(choice.criterion - choice.criterion[0] <= _NEAR)[1 : _VOICES + 1]
    voices = [fitted, *(_candidate(choice, int(i)) for i in near)]
    found = []
    for voice in voices:
        with_term = (
            voice
            if symbol in voice.structure
            else add_term(ordinates, voice, symbol, shortest=setting.shortest, common=setting.common)
        )
        bound, _ = upper_bound(
            ordinates, with_term, symbol, setting.scales, level=setting.level, shortest=setting.shortest
        )
        found.append(bound)
    return max(found, key=lambda e: e.high)
