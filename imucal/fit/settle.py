"""From the chosen candidate to estimates: bounded terms leave the model and keep their bound."""

from dataclasses import dataclass

import numpy as np

from imucal.fit.estimates import (
    Fitted,
    Scales,
    add_term,
    drop_terms,
    estimate,
    upper_bound,
)
from imucal.fit.ordinates import Ordinates
from imucal.fit.result import Estimate
from imucal.fit.selection import Choice
from imucal.noise.terms import TERMS

__all__ = ["Setting", "settle"]

#: Terms that every fit reports.
_ALWAYS = ("N", "B", "K")
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
    """Return the best candidate without the terms that may be zero, and estimates or bounds of all."""
    fitted = _candidate(choice, 0)
    bounded: dict[str, Estimate] = {}
    estimates = _estimate(ordinates, fitted, setting)
    while True:
        gone = [e for e in estimates if e.status == "bounded"]
        if not gone or len(gone) == len(estimates):
            break
        bounded |= {e.key: e for e in gone}
        keys = [e.key for e in gone]
        fitted = drop_terms(
            ordinates, fitted, keys, shortest=setting.shortest, common=setting.common
        ).by_time()
        estimates = _estimate(ordinates, fitted, setting)
    symbols = {e.symbol for e in (*estimates, *bounded.values())}
    for symbol in _ALWAYS:
        if symbol not in symbols:
            bounded[symbol] = _bound(ordinates, choice, fitted, symbol, setting)
    order = list(TERMS)
    everything = sorted((*estimates, *bounded.values()), key=lambda e: (order.index(e.symbol), e.key))
    return fitted, _unique(everything)


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


def _unique(estimates: list[Estimate]) -> tuple[Estimate, ...]:
    """Return the estimates under keys of their own: a bounded GM beside others gets the next number."""
    markov = [e for e in estimates if e.symbol == "GM"]
    if len({e.key for e in markov}) == len(markov):
        return tuple(estimates)
    ordered = sorted(markov, key=lambda e: (e.status == "bounded", e.key))
    names = {id(e): f"GM{index + 1}" for index, e in enumerate(ordered)}
    return tuple(
        e
        if e.symbol != "GM"
        else Estimate(
            key=names[id(e)],
            symbol="GM",
            status=e.status,
            value=e.value,
            low=e.low,
            high=e.high,
            correlation_time=e.correlation_time,
        )
        for e in estimates
    )
