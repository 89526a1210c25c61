"""Blind starting values: a non-negative mixture of fixed spectra, on coarse bins.

Every set of terms is a mixture of a dictionary: the four power laws and Gauss-Markov spectra on a
grid of correlation times. Multiplicative updates of the Itakura-Saito divergence, which is the
likelihood, find the weights of all sets at once, without a starting guess and without chance.

Source: Févotte & Idier (2011), Neural Computation 23, "Algorithms for NMF with the
beta-divergence" (the majorisation-minimisation update, exponent 1/2).
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.spectral.likelihood import Candidates
from imucal.fitting.spectral.ordinates import MARKOV, Ordinates, coarser
from imucal.noise.term import gauss_markov_dct

_GRID = 16
#: Rounds of updates, and how many of the best mixtures of each candidate so far they are of.
_EVERY = 1_000_000
_THOROUGH, _QUICK = ((25, _EVERY), (25, 40)), ((12, _EVERY), (38, 16))
#: Rows at a time: small enough for the cache, and for one thread of the linear algebra library.
_ROWS = 96
#: Keeps logarithms and squares of inverses finite.
_TINY = 1e-140


def time_grid(ordinates: Ordinates, shortest: float) -> FloatArray:
    """Return correlation times in samples, log-spaced over what the record can show."""
    highest = float(ordinates.fraction.max())
    low = max(shortest, 2.0) / highest**0.5
    high = max(ordinates.samples / 6, 2 * low)
    return np.geomspace(low, high, _GRID)


def find_starts(
    ordinates: Ordinates,
    candidates: Candidates,
    *,
    shortest: float,
    keep: tuple[int, int, int],
    quick: bool = False,
) -> tuple[IntArray, FloatArray]:
    """Return the best starts of each candidate: `keep` of them for 0, 1, 2 Gauss-Markov terms.

    That is which candidate each start belongs to, shape (s,), and its parameters, shape (s, p). A
    candidate with more than two has a single start, its times spread evenly. `quick` judges mixtures after
    half as many rounds: enough where many candidates start side by side, and the best of them matters.
    """
    times = time_grid(ordinates, shortest)
    plans = [_combinations(int(count)) for count in candidates.markov]
    every = np.concatenate([_padded(plan, candidates.room_markov) for plan in plans])
    owner = np.repeat(np.arange(candidates.count), [len(plan) for plan in plans])
    theta = np.empty((owner.size, candidates.width))
    score = np.empty(owner.size)
    ramped: BoolArray = np.any(candidates.regressors, axis=1)[owner]
    for rows, seen in ((~ramped, ordinates), (ramped, ordinates.detrended())):
        if rows.any():
            sought = _Sought(owner=owner[rows], laws=candidates.laws[owner[rows]], places=every[rows])
            theta[rows], score[rows] = _mixtures(
                coarser(seen), sought, times, candidates, _QUICK if quick else _THOROUGH
            )
    best = [
        start + np.argsort(score[start : start + len(plan)], kind="stable")[: keep[min(int(count), 2)]]
        for start, plan, count in zip(
            np.cumsum([0, *(len(plan) for plan in plans[:-1])]), plans, candidates.markov, strict=True
        )
    ]
    index = np.concatenate(best)
    return owner[index], theta[index]


def _padded(combos: list[tuple[int, ...]], room: int) -> IntArray:
    """Return combinations as rows of `room` places; -1 stands for none."""
    places = np.full((len(combos), room), -1, dtype=np.int64)
    places[:, : len(combos[0])] = combos
    return places


def _combinations(count: int) -> list[tuple[int, ...]]:
    if count > 2:
        return [tuple(np.linspace(0, _GRID - 1, count).round().astype(int).tolist())]
    return list(combinations(range(_GRID), count))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sought:
    """Mixtures: candidate of each, shape (s,), its laws, shape (s, 4), places of its times, shape (s, g)."""

    owner: IntArray
    laws: BoolArray
    places: IntArray


def _mixtures(
    ordinates: Ordinates,
    sought: _Sought,
    times: FloatArray,
    candidates: Candidates,
    plan: tuple[tuple[int, int], ...],
) -> tuple[FloatArray, FloatArray]:
    """Return the parameters of each mixture, shape (s, p), and its -log L, shape (s,).

    By a `plan` of rounds; that of a mixture which is not among the last best of its candidate is infinite.
    """
    places = sought.places
    row, column = np.nonzero(places >= 0)
    place = places[row, column]
    shapes, _ = gauss_markov_dct(
        np.log(times)[:, None], ordinates.lam, ordinates.length, np.zeros(ordinates.lam.shape)
    )
    dictionary = np.concatenate([ordinates.basis, shapes])
    use = np.zeros((len(places), MARKOV + times.size))
    use[:, :MARKOV] = sought.laws
    use[row, MARKOV + place] = 1.0
    level = np.maximum(ordinates.power, _TINY) / ordinates.size
    weights = use * np.quantile(level / dictionary, 0.2, axis=1) / use.sum(axis=1, keepdims=True)
    objective = np.zeros(len(places))
    for rounds, best in plan:
        rows = _best_of_each(objective, sought.owner, best)
        found = _mixed(ordinates, dictionary, weights, rows, rounds)
        objective = np.full(len(places), np.inf)
        objective[rows] = found
    theta = np.zeros((len(places), candidates.width))
    logs = np.log(weights + _TINY)
    theta[:, :MARKOV] = logs[:, :MARKOV]
    theta[row, MARKOV + column] = logs[row, MARKOV + place]
    theta[row, MARKOV + candidates.room_markov + column] = np.log(times[place])
    return theta, objective


def _best_of_each(objective: FloatArray, owner: IntArray, most: int) -> IntArray:
    """Return the rows whose finite objective is among the `most` best of their owner, rising."""
    order = np.lexsort((objective, owner))
    sorted_owner = owner[order]
    rank = np.arange(order.size) - np.searchsorted(sorted_owner, sorted_owner)
    return np.sort(order[(rank < most) & np.isfinite(objective[order])])


def _mixed(
    ordinates: Ordinates, dictionary: FloatArray, weights: FloatArray, rows: IntArray, rounds: int
) -> FloatArray:
    """Put `rounds` more rounds into some rows of `weights`, in place, and return their -log L."""
    objective = np.empty(rows.size)
    for first in range(0, rows.size, _ROWS):
        part = rows[first : first + _ROWS]
        weights[part], objective[first : first + _ROWS] = _mix(ordinates, dictionary, weights[part], rounds)
    return objective


def _mix(
    ordinates: Ordinates, dictionary: FloatArray, weights: FloatArray, rounds: int
) -> tuple[FloatArray, FloatArray]:
    """Return the weights after some rounds of multiplicative updates, and -log L."""
    plenty = np.ascontiguousarray((dictionary * ordinates.size).T)
    transposed = np.ascontiguousarray(dictionary.T)
    for _ in range(rounds):
        inverse = 1 / (weights @ dictionary + _TINY)
        push = inverse @ plenty
        inverse *= inverse
        inverse *= ordinates.power
        weights = weights * np.sqrt((inverse @ transposed) / push)
    spectrum = weights @ dictionary + _TINY
    objective = 0.5 * (np.log(spectrum) * ordinates.size + ordinates.power / spectrum).sum(axis=1)
    return weights, objective
