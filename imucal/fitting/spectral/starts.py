"""Blind starting values: a non-negative mixture of fixed spectra, on coarse bins.

Every set of terms is a mixture from a dictionary: the four power laws, and the spectra of the other
terms on a grid of correlation times. Multiplicative updates minimise the Itakura-Saito divergence, which is
the negative log-likelihood. They find the weights of all sets at once, without a guess or random numbers.

Source: Févotte & Idier (2011), Neural Computation 23, "Algorithms for NMF with the
beta-divergence" (the majorisation-minimisation update, exponent 1/2, and the majorisation-equalisation
update, exponent 1, which needs half as many rounds).
"""

from functools import cache
from itertools import combinations, product

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.spectral.likelihood import Fits
from imucal.fitting.spectral.models import Models, has_time
from imucal.fitting.spectral.ordinates import SHAPED, Ordinates, coarser
from imucal.fitting.spectral.scoring import maximize
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import TERMS

_GRID = 16
#: Rounds of updates, number of each model's best mixtures that they update, and their exponent.
_EVERY = 1_000_000
_THOROUGH, _QUICK = ((25, _EVERY, 0.5), (25, 40, 0.5)), ((6, _EVERY, 1.0), (19, 16, 1.0))
#: Rows at a time: few enough for the cache and for a single thread of the linear algebra library.
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
    models: Models,
    *,
    keep: tuple[int, int, int],
    quick: bool = False,
    response: FloatArray | None = None,
) -> tuple[IntArray, FloatArray]:
    """Return the best starts of each model: `keep` of them for 0, 1, 2 terms other than power laws.

    The results are the model of each start, shape (s,), and its parameters, shape (s, p). A model with more
    than two terms of one kind has a single start with evenly spread times. `quick` selects mixtures after a
    quarter of the rounds, enough if only the best of many models matters. Mixtures describe the noise before
    the output filter if its `response` is given.
    """
    times = time_grid(ordinates, models.shortest)
    plans = [_plan(tuple(row), models.slots[SHAPED:]) for row in models.has[:, SHAPED:].tolist()]
    sizes = [len(plan) for plan in plans]
    owner, places = np.repeat(np.arange(models.count), sizes), np.concatenate(plans)
    theta, score = np.empty((owner.size, models.width)), np.empty(owner.size)
    ramped: BoolArray = np.any(models.regressors, axis=1)[owner]
    for rows, own in ((~ramped, ordinates), (ramped, ordinates.detrended())):
        if rows.any():
            seen = own if response is None else own.unfiltered(response, int(models.zeros[0]))
            theta[rows], score[rows] = _mixtures(
                coarser(seen), models, owner[rows], places[rows], times, _QUICK if quick else _THOROUGH
            )
    terms = np.count_nonzero(models.has[:, SHAPED:], axis=1)
    order = np.lexsort((score, owner))
    rank = np.arange(owner.size) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    index = order[rank < np.array(keep)[np.minimum(terms, 2)][owner]]
    return owner[index], theta[index]


def fit_blindly(
    ordinates: Ordinates, models: Models, *, keep: tuple[int, int, int], tolerance: float
) -> Fits:
    """Return the best maximum of each model from its starts, after at most 40 steps."""
    owner, theta = find_starts(ordinates, models, keep=keep)
    every = maximize(ordinates, models[owner], theta, tolerance=tolerance, iterations=40)
    rows = [np.flatnonzero(owner == index) for index in range(models.count)]
    return every[[int(own[np.argmin(every.objective[own])]) for own in rows]]


@cache
def _plan(has: tuple[bool, ...], slots: tuple[str, ...]) -> IntArray:
    """Return sets of places in the dictionary for a model's slots, shape (s, g); -1 for an empty slot."""
    own = []
    for kind, symbol in enumerate(dict.fromkeys(slots)):
        count = sum(there and slot == symbol for there, slot in zip(has, slots, strict=True))
        sets = _combinations(count) if has_time(symbol) else [(0,) * count]
        empty = (-1,) * (slots.count(symbol) - count)
        own.append([(*(kind * _GRID + place for place in places), *empty) for places in sets])
    sets_of_all = [sum(parts, ()) for parts in product(*own)]
    return np.array(sets_of_all, dtype=np.int64).reshape(len(sets_of_all), len(slots))


def _combinations(count: int) -> list[tuple[int, ...]]:
    """Return sets of places in the grid of one kind."""
    if count > 2:
        return [tuple(np.linspace(0, _GRID - 1, count).round().astype(int).tolist())]
    return list(combinations(range(_GRID), count))


def _mixtures(  # noqa: PLR0917 - a helper of one caller
    ordinates: Ordinates,
    models: Models,
    owner: IntArray,
    places: IntArray,
    times: FloatArray,
    plan: tuple[tuple[int, int, float], ...],
) -> tuple[FloatArray, FloatArray]:
    """Return the parameters of each mixture, shape (s, p), and its -log L, shape (s,).

    `owner`, shape (s,), is the model of each mixture, and `places`, shape (s, g), are its terms. In each
    round of the `plan` only the best mixtures of each model continue; -log L of the others is infinite.
    """
    row, column = np.nonzero(places >= 0)
    place = places[row, column]
    dictionary = np.concatenate(
        [ordinates.basis, *(_spectra(ordinates, TERMS[kind], times) for kind in models.kinds)]
    )
    use = np.zeros((len(places), len(dictionary)))
    use[:, :SHAPED] = models.has[owner, :SHAPED]
    use[row, SHAPED + place] = 1.0
    level = np.maximum(ordinates.power, _TINY) / ordinates.size
    weights = use * np.quantile(level / dictionary, 0.2, axis=1) / use.sum(axis=1, keepdims=True)
    objective = np.zeros(len(places))
    for rounds, best, exponent in plan:
        order = np.lexsort((objective, owner))
        rank = np.arange(order.size) - np.searchsorted(owner[order], owner[order])
        rows = np.sort(order[(rank < best) & np.isfinite(objective[order])])
        objective = np.full(len(places), np.inf)
        for first in range(0, rows.size, _ROWS):
            part = rows[first : first + _ROWS]
            weights[part], objective[part] = _mix(ordinates, dictionary, weights[part], rounds, exponent)
    theta = np.zeros((len(places), models.width))
    logs = np.log(weights + _TINY)
    theta[:, :SHAPED] = logs[:, :SHAPED]
    theta[row, SHAPED + column] = logs[row, SHAPED + place]
    theta[row, models.variances + column] = np.log(times[place % _GRID])
    return theta, objective


def _spectra(ordinates: Ordinates, kind: type[NoiseTerm], times: FloatArray) -> FloatArray:
    """Return a term's spectra at the times of the grid, shape (t, b), or raise a ValueError."""
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
