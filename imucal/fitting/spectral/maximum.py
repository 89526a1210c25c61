"""Maximum of the likelihood of many models at once: blind starting values, then damped Fisher scoring.

Every set of terms is a mixture from a dictionary of spectra on a grid of correlation times. Multiplicative
updates minimise the Itakura-Saito divergence, the negative log-likelihood. Fisher scoring, damped as by
Levenberg and Marquardt, starts at the best mixtures.

Source: Févotte & Idier (2011), Neural Computation 23, "Algorithms for NMF with the beta-divergence" (the
majorisation-minimisation update, exponent 1/2, and the majorisation-equalisation update, exponent 1).
"""

from dataclasses import fields
from functools import cache
from itertools import combinations, product

import numpy as np
import scipy

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.noise_fit import Goodness
from imucal.fitting.spectral.likelihood import Fits, derivatives, evaluate
from imucal.fitting.spectral.models import Models, has_time
from imucal.fitting.spectral.ordinates import SHAPED, Ordinates, coarser
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import TERMS

#: A term whose share of every bin is below exp(-_ABSENT) is absent.
_ABSENT = 18.0
#: Longest step of a parameter, in log units; for a response coefficient, relative to 1 + its size.
_STEP = 1.5
#: Number of steps -> distance from the best, in log-likelihood, from which a model is given up …
_BEHIND = {3: 50.0, 12: 37.5, 20: 20.0}
#: … unless the last step gained more than this share of the distance.
_CATCHING_UP = 0.1
#: Neighbouring bins are joined until they have this many degrees of freedom.
_JOIN = 8.0


def given_up(value: FloatArray, gain: FloatArray, steps: int) -> BoolArray:
    """Return the mask of the models that are far behind the best and do not catch up."""
    most = [behind for first, behind in _BEHIND.items() if steps >= first]
    behind = value - np.min(value)
    return np.asarray((behind > (most[-1] if most else np.inf)) & (gain < _CATCHING_UP * behind))


def bounds(ordinates: Ordinates, models: Models) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper bounds of each parameter, shape (p,) each."""
    times = slice(models.variances, models.response)
    eighths = np.arange(0, ordinates.size.size, 8)
    power = np.add.reduceat(ordinates.power, eighths) + 1e-300
    level = power / np.add.reduceat(ordinates.size, eighths)
    visible = np.log(np.min(level / ordinates.basis[:, eighths], axis=1))
    low = np.full(models.width, -np.inf)
    high = np.full(models.width, np.inf)
    low[:SHAPED] = visible - _ABSENT
    low[SHAPED : models.variances] = np.log(level.min()) - _ABSENT - np.log(ordinates.samples)
    low[times] = np.log(models.shortest)
    high[times] = np.log(2 * ordinates.samples)
    return low, high


def maximize(
    ordinates: Ordinates,
    models: Models,
    start: FloatArray,
    *,
    free: BoolArray | None = None,
    ramp: FloatArray | None = None,
    iterations: int = 100,
    tolerance: float = 1e-7,
    handicap: FloatArray | None = None,
) -> Fits:
    """Maximise the likelihood of each model from its row of `start`, shape (c, p).

    `free`, shape (c, p), masks the parameters to move. `ramp` is as in `evaluate`. `tolerance` is the gain of
    the last step. With a `handicap` on the objectives, shape (c,), models far behind the best are given up
    early.
    """
    low, high = bounds(ordinates, models)
    moving = models.free if free is None else free & models.free
    state = evaluate(ordinates, models, np.clip(start, low, high), ramp=ramp)
    damping = np.full(models.count, 1e-3)
    last = np.full(models.count, np.inf)
    active = np.isfinite(state.objective) & moving.any(axis=1)
    for count in range(iterations):
        if handicap is not None:
            active &= ~given_up(state.objective + handicap, last, count)
        rows = np.flatnonzero(active)
        if not rows.size:
            break
        trial = _step(state, rows, moving, damping, limits=(low, high))
        every = rows.size == models.count
        own = models if every else models[rows]
        found = evaluate(ordinates, own, trial, ramp=None if ramp is None else ramp[rows])
        gain = state.objective[rows] - found.objective
        noise = 1e-14 * np.abs(state.objective[rows])
        better = gain >= -noise
        moved = np.max(np.abs(trial - state.theta[rows]), axis=1)
        last[rows[better]] = gain[better]
        if every and better.all():
            state = found
        else:
            for field in fields(state)[1:]:
                getattr(state, field.name)[rows[better]] = getattr(found, field.name)[better]
        damping[rows] = np.where(better, np.maximum(damping[rows] * 0.2, 1e-9), damping[rows] * 6)
        done = (better & ((gain < tolerance) & (moved < 1e-3) | (gain < 0.01 * tolerance + noise))) | (
            damping[rows] > 1e7
        )
        active[rows[done]] = False
    return state


def _step(
    state: Fits,
    rows: IntArray,
    moving: BoolArray,
    damping: FloatArray,
    *,
    limits: tuple[FloatArray, FloatArray],
) -> FloatArray:
    low, high = limits
    theta, score = state.theta[rows], state.score[rows]
    at_bound = (theta <= low) & (score > 0) | (theta >= high) & (score < 0)
    move = moving[rows] & ~at_bound
    matrix = np.where(move[:, :, None] & move[:, None, :], state.information[rows], 0.0)
    index = np.arange(theta.shape[1])
    diagonal = matrix[:, index, index]
    added = damping[rows, None] * (diagonal + 1e-3) + 1e-12
    matrix[:, index, index] = np.where(move, diagonal + added, 1.0)
    step = -np.linalg.solve(matrix, np.where(move, score, 0.0)[:, :, None])[:, :, 0]
    longest = np.where(np.isinf(low) & np.isinf(high), _STEP * (1 + np.abs(theta)), _STEP)
    return np.clip(theta + np.clip(step, -longest, longest), low, high)


def misfit(ordinates: Ordinates, found: Fits) -> Goodness:
    """Return the misfit of one model to the ordinates that it was fitted to.

    The sum of X²/S over a group is chi-squared with n degrees of freedom: the squared standardised residual
    has mean 1 and variance 2 + 12/n.
    """
    _, size, residual = _residuals(ordinates, found)
    square = float(np.mean(residual**2))
    statistic = (square - 1) * size.size / float(np.sqrt(np.sum(2 + 12 / size)))
    return Goodness(statistic=statistic, p_value=float(scipy.special.ndtr(-statistic)), chi2_per_bin=square)


def octave_score(ordinates: Ordinates, found: Fits) -> float:
    """Return the probability that a right model differs as much from the level of some octaves.

    The residuals of an octave are summed with their signs, so that an octave which is too high as a whole
    counts, even if each residual is small. The sum of X²/S over an octave of n ordinates, less n, has the
    variance 2n. Each parameter that the data determine takes away one degree of freedom.
    """
    octave = np.floor(np.log2(ordinates.fraction))
    order = np.argsort(octave, kind="stable")
    first = np.flatnonzero(np.diff(octave[order], prepend=-np.inf))
    size = np.add.reduceat(ordinates.size[order], first)
    ratio = np.add.reduceat((ordinates.rest(found.beta[0]) / found.spectrum[0])[order], first)
    known = size >= _LEAST_OF_OCTAVE
    score = (ratio - size)[known] / np.sqrt(2 * size[known])
    free = int(np.count_nonzero(np.diag(found.information[0])[found.models.free[0]] > _DETERMINED))
    return float(scipy.special.chdtrc(max(score.size - free, 1), np.sum(score**2)))


def misfit_factors(ordinates: Ordinates, found: Fits) -> FloatArray:
    """Return the factor by which a misfit widens the error of each variance parameter, shape (s,).

    It is the root of the mean squared residual, weighted by the parameter's information (Huber 1967, Proc.
    5th Berkeley Symposium 1, 221).
    """
    first, _, residual = _residuals(ordinates, found)
    parts = derivatives(ordinates, found.models, found.theta)[: found.models.variances]
    laws = ordinates.basis.shape[0]
    absent = np.flatnonzero(np.max(parts[:laws], axis=1) <= 0)
    parts[absent] = ordinates.basis[absent]
    # Scale, so that small squares do not underflow.
    share = parts / found.spectrum[0]
    share /= np.maximum(share.max(axis=1, keepdims=True), 1e-300)
    weight = np.add.reduceat(share**2 * ordinates.size, first, axis=1)
    return np.asarray(np.sqrt(weight @ residual**2 / np.maximum(weight.sum(axis=1), 1e-300)))


def _residuals(ordinates: Ordinates, found: Fits) -> tuple[IntArray, FloatArray, FloatArray]:
    ratio = ordinates.rest(found.beta[0]) / found.spectrum[0]
    group = np.floor((np.cumsum(ordinates.size) - ordinates.size / 2) / _JOIN)
    first = np.flatnonzero(np.diff(group, prepend=-1.0) != 0)
    size = np.add.reduceat(ordinates.size, first)
    residual = (np.add.reduceat(ratio, first) - size) / np.sqrt(2 * size)
    return first, size, residual


#: Probability of an octave score below which a description is not sound.
UNLIKELY = 1e-3
#: Least number of ordinates of an octave whose sum is nearly normal.
_LEAST_OF_OCTAVE = 60
#: Information on the logarithm of a parameter from which the data determine it, to a factor of e.
_DETERMINED = 1.0
#: Number of correlation times in the dictionary.
_GRID = 16
#: Number of mixtures that no model has.
_EVERY = 1_000_000
#: Rounds of updates, number of best mixtures of each model that take part, and exponent of the updates.
_THOROUGH = ((25, _EVERY, 0.5), (25, 40, 0.5))
#: The same for many models at once: the larger exponent needs fewer rounds.
_QUICK = ((6, _EVERY, 1.0), (19, 16, 1.0))
#: Rows at a time: few enough for the cache and for a single thread.
_ROWS = 96
#: Keeps logarithms and squares of inverses finite.
_TINY = 1e-140


def time_grid(ordinates: Ordinates, shortest: float) -> FloatArray:
    """Return correlation times in samples, log-spaced over the record."""
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

    The results are the model of each start, shape (s,), and its parameters, shape (s, p). With a `response`,
    mixtures describe the noise before the filter.
    """
    times = time_grid(ordinates, models.shortest)
    plans = [_plan(tuple(row), models.slots[SHAPED:]) for row in models.has[:, SHAPED:].tolist()]
    sizes = [len(plan) for plan in plans]
    owner, places = np.repeat(np.arange(models.count), sizes), np.concatenate(plans)
    theta, score = np.empty((owner.size, models.width)), np.empty(owner.size)
    ramped: BoolArray = np.any(models.regressors, axis=1)[owner]
    for rows, own in ((~ramped, ordinates), (ramped, ordinates.detrended())):
        if rows.any():
            seen = own if response is None else own.unfiltered(response)
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
    """Return the best maximum of each model from its starts."""
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
    round only the best mixtures of each model continue.
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
