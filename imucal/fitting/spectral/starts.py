"""Blind starting values: a non-negative mixture of fixed spectra, on coarse bins.

Every set of terms is a mixture of a dictionary: the four power laws, and the spectra of the other
terms on a grid of correlation times. Multiplicative updates of the Itakura-Saito divergence, which is the
likelihood, find the weights of all sets at once, without a starting guess and without chance.

Source: Févotte & Idier (2011), Neural Computation 23, "Algorithms for NMF with the
beta-divergence" (the majorisation-minimisation update, exponent 1/2, and the majorisation-equalisation
update, exponent 1, which needs half as many rounds).
"""

from functools import cache
from itertools import combinations, groupby, product

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.spectral.likelihood import Candidates, Evaluation
from imucal.fitting.spectral.ordinates import SHAPED, Ordinates, coarser
from imucal.fitting.spectral.scoring import maximize
from imucal.noise.term import NoiseTerm

_GRID = 16
#: Rounds of updates, how many of the best mixtures of each candidate so far they are of, and their exponent.
_EVERY = 1_000_000
_THOROUGH, _QUICK = ((25, _EVERY, 0.5), (25, 40, 0.5)), ((6, _EVERY, 1.0), (19, 16, 1.0))
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
    keep: tuple[int, int, int],
    quick: bool = False,
    response: FloatArray | None = None,
) -> tuple[IntArray, FloatArray]:
    """Return the best starts of each candidate: `keep` of them for 0, 1, 2 terms with a time.

    That is which candidate each start belongs to, shape (s,), and its parameters, shape (s, p). A
    candidate with more than two of a kind has a single start, their times spread evenly. `quick` judges
    mixtures after a quarter of the rounds: enough where many candidates start side by side, and the best of
    them matters. Mixtures are of the noise before the candidates' output filter, if its `response` is known.
    """
    times = time_grid(ordinates, candidates.shortest)
    plans = [_plan(tuple(row), candidates.kinds) for row in candidates.shaped.tolist()]
    sizes = [len(plan) for plan in plans]
    owner, places = np.repeat(np.arange(candidates.count), sizes), np.concatenate(plans)
    theta, score = np.empty((owner.size, candidates.width)), np.empty(owner.size)
    ramped: BoolArray = np.any(candidates.regressors, axis=1)[owner]
    for rows, own in ((~ramped, ordinates), (ramped, ordinates.detrended())):
        if rows.any():
            seen = own if response is None else own.unfiltered(response, int(candidates.zeros[0]))
            theta[rows], score[rows] = _mixtures(
                coarser(seen), candidates, owner[rows], places[rows], times, _QUICK if quick else _THOROUGH
            )
    terms = np.count_nonzero(candidates.shaped >= 0, axis=1)
    order = np.lexsort((score, owner))
    rank = np.arange(owner.size) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    index = order[rank < np.array(keep)[np.minimum(terms, 2)][owner]]
    return owner[index], theta[index]


def fit_blindly(
    ordinates: Ordinates, candidates: Candidates, *, keep: tuple[int, int, int], tolerance: float
) -> Evaluation:
    """Return the best maximum of each candidate from its starts, after 40 steps at most."""
    owner, theta = find_starts(ordinates, candidates, keep=keep)
    every = maximize(ordinates, candidates[owner], theta, tolerance=tolerance, iterations=40)
    rows = [np.flatnonzero(owner == index) for index in range(candidates.count)]
    return every[[int(own[np.argmin(every.objective[own])]) for own in rows]]


@cache
def _plan(row: tuple[int, ...], kinds: tuple[type[NoiseTerm], ...]) -> IntArray:
    """Return sets of places in the dictionary for a candidate's terms, shape (s, g); -1 for no term."""
    own = []
    for kind, terms in groupby(row):
        count = len(list(terms))
        if kind < 0:
            own.append([(-1,) * count])
        else:
            timed = len(kinds[kind].parameters()) > 1
            sets = _combinations(count) if timed else [(0,)]
            own.append([tuple(kind * _GRID + place for place in places) for places in sets])
    sets_of_all = [sum(parts, ()) for parts in product(*own)]
    return np.array(sets_of_all, dtype=np.int64).reshape(len(sets_of_all), len(row))


def _combinations(count: int) -> list[tuple[int, ...]]:
    """Return sets of places in the grid of one kind."""
    if count > 2:
        return [tuple(np.linspace(0, _GRID - 1, count).round().astype(int).tolist())]
    return list(combinations(range(_GRID), count))


def _mixtures(  # noqa: PLR0917 - a helper of one caller
    ordinates: Ordinates,
    candidates: Candidates,
    owner: IntArray,
    places: IntArray,
    times: FloatArray,
    plan: tuple[tuple[int, int, float], ...],
) -> tuple[FloatArray, FloatArray]:
    """Return the parameters of each mixture, shape (s, p), and its -log L, shape (s,).

    Mixtures are given by their candidate, shape (s,), and the places of their terms, shape (s, g). By a
    `plan` of rounds; that of a mixture which is not among the last best of its candidate is infinite.
    """
    row, column = np.nonzero(places >= 0)
    place = places[row, column]
    dictionary = np.concatenate(
        [ordinates.basis, *(_spectra(ordinates, kind, times) for kind in candidates.kinds)]
    )
    use = np.zeros((len(places), len(dictionary)))
    use[:, :SHAPED] = candidates.laws[owner]
    use[row, SHAPED + place] = 1.0
    level = np.maximum(ordinates.power, _TINY) / ordinates.size
    weights = use * np.quantile(level / dictionary, 0.2, axis=1) / use.sum(axis=1, keepdims=True)
    objective = np.zeros(len(places))
    for rounds, best, exponent in plan:
        # Those whose finite objective is among so many best of their owner.
        order = np.lexsort((objective, owner))
        rank = np.arange(order.size) - np.searchsorted(owner[order], owner[order])
        rows = np.sort(order[(rank < best) & np.isfinite(objective[order])])
        objective = np.full(len(places), np.inf)
        for first in range(0, rows.size, _ROWS):
            part = rows[first : first + _ROWS]
            weights[part], objective[part] = _mix(ordinates, dictionary, weights[part], rounds, exponent)
    theta = np.zeros((len(places), candidates.width))
    logs = np.log(weights + _TINY)
    theta[:, :SHAPED] = logs[:, :SHAPED]
    theta[row, SHAPED + column] = logs[row, SHAPED + place]
    theta[row, candidates.variances + column] = np.log(times[place % _GRID])
    return theta, objective


def _spectra(ordinates: Ordinates, kind: type[NoiseTerm], times: FloatArray) -> FloatArray:
    """Return a term's spectra at the times of the grid, shape (t, b); none to be told by is a ValueError."""
    shapes, _ = kind.dct_shapes(
        np.log(times)[:, None], ordinates.lam, ordinates.length, np.zeros(ordinates.lam.shape)
    )
    if not (np.all(shapes >= 0) and np.all(np.isfinite(shapes)) and np.all(shapes.max(axis=1) > 0)):
        msg = (
            f"method 'mle' can't fit {kind.symbol} ({kind.names[0]}): its psd is 0, negative or not finite, "
            f"expected a positive density; leave {kind.symbol} out"
        )
        raise ValueError(msg)
    return np.maximum(shapes, _TINY)


def _mix(
    ordinates: Ordinates, dictionary: FloatArray, weights: FloatArray, rounds: int, exponent: float
) -> tuple[FloatArray, FloatArray]:
    """Return the weights after some rounds of multiplicative updates, and -log L."""
    plenty = np.ascontiguousarray((dictionary * ordinates.size).T)
    transposed = np.ascontiguousarray(dictionary.T)
    for _ in range(rounds):
        inverse = 1 / (weights @ dictionary + _TINY)
        push = inverse @ plenty
        inverse *= inverse
        inverse *= ordinates.power
        weights = weights * ((inverse @ transposed) / push) ** exponent
    spectrum = weights @ dictionary + _TINY
    objective = 0.5 * (np.log(spectrum) * ordinates.size + ordinates.power / spectrum).sum(axis=1)
    return weights, objective
