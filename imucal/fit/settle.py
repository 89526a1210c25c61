"""From the chosen candidate to estimates: bounded terms leave the model and keep their bound."""

from dataclasses import dataclass, replace

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

__all__ = ["Setting", "numbered", "settle"]

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
        if not gone or len(estimates) == 1:
            break
        # One at a time: of two terms that may stand for one another, one is needed.
        fitted, dropped = _without_least(ordinates, fitted, gone, setting)
        bounded[dropped.key] = dropped
        estimates = _estimate(ordinates, fitted, setting)
    symbols = {e.symbol for e in (*estimates, *bounded.values())}
    for symbol in _ALWAYS:
        if symbol not in symbols:
            bounded[symbol] = _bound(ordinates, choice, fitted, symbol, setting)
    order = list(TERMS)
    everything = (*estimates, *bounded.values())
    return fitted, tuple(
        sorted(everything, key=lambda e: (order.index(e.symbol), e.status == "bounded", e.key))
    )


def numbered(
    estimates: tuple[Estimate, ...], names: tuple[str, ...]
) -> tuple[tuple[Estimate, ...], tuple[str, ...]]:
    """Return estimates and parameters with several Gauss-Markov terms numbered, bounded ones last."""
    if sum(e.symbol == "GM" for e in estimates) < 2:
        return estimates, names
    result, seen = [], 0
    for found in estimates:
        seen += found.symbol == "GM"
        result.append(replace(found, key=f"GM{seen}") if found.symbol == "GM" else found)
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
