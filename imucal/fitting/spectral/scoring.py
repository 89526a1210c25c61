"""Fisher scoring, damped as by Levenberg and Marquardt, of many candidates side by side."""

from dataclasses import fields

import numpy as np
import scipy

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.noise_fit import Goodness
from imucal.fitting.spectral.likelihood import Candidates, Evaluation, derivatives, evaluate
from imucal.fitting.spectral.ordinates import SHAPED, Ordinates

#: A term whose share of every bin is below exp(-_ABSENT) is absent.
_ABSENT = 18.0
#: Longest step of a parameter, in log units; of a response's, relative to 1 + its size.
_STEP = 1.5
#: A parameter with less information than this is not told at all.
_NONE = 1e-8
#: Steps -> how far behind the best, in log-likelihood, a candidate may be from then on …
_BEHIND = {3: 50.0, 12: 37.5, 20: 20.0}
#: … unless its last step made up more than this share of it.
_CATCHING_UP = 0.1
#: Neighbouring bins are joined until they hold so many degrees of freedom.
_JOIN = 8.0


def given_up(value: FloatArray, gain: FloatArray, steps: int) -> BoolArray:
    """Return which candidates of a race are far behind the best and do not catch up, shape (c,).

    `value` is the objective after so many steps, of which the last gained `gain`. Of those that ended
    within 12.5 of the best, on simulated and real logs of all kinds, none was given up.
    """
    most = [behind for first, behind in _BEHIND.items() if steps >= first]
    behind = value - np.min(value)
    return np.asarray((behind > (most[-1] if most else np.inf)) & (gain < _CATCHING_UP * behind))


def bounds(ordinates: Ordinates, candidates: Candidates) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest values of each parameter, each of shape (p,).

    A variance may fall until its term is invisible in every bin; a correlation time lies between
    the candidates' shortest and twice the record.
    """
    times = slice(candidates.variances, candidates.response)
    eighths = np.arange(0, ordinates.size.size, 8)
    power = np.add.reduceat(ordinates.power, eighths) + 1e-300
    level = power / np.add.reduceat(ordinates.size, eighths)
    visible = np.log(np.min(level / ordinates.basis[:, eighths], axis=1))
    low = np.full(candidates.width, -np.inf)
    high = np.full(candidates.width, np.inf)
    low[:SHAPED] = visible - _ABSENT
    low[SHAPED : candidates.variances] = np.log(level.min()) - _ABSENT - np.log(ordinates.samples)
    low[times] = np.log(candidates.shortest)
    high[times] = np.log(2 * ordinates.samples)
    return low, high


def maximize(
    ordinates: Ordinates,
    candidates: Candidates,
    start: FloatArray,
    *,
    free: BoolArray | None = None,
    ramp: FloatArray | None = None,
    iterations: int = 100,
    tolerance: float = 1e-7,
    handicap: FloatArray | None = None,
) -> Evaluation:
    """Maximise the likelihood of each candidate from its row of `start`, shape (c, p).

    Of the parameters that a candidate has, those `free`, shape (c, p), are moved; `ramp` are ramps to hold,
    see `evaluate`. A step that gains less log-likelihood than `tolerance` ends the search. A `handicap`,
    shape (c,), is added to the objectives in a race of which only the best matter: those far behind are given
    up on the way.
    """
    low, high = bounds(ordinates, candidates)
    moving = candidates.free if free is None else free & candidates.free
    state = evaluate(ordinates, candidates, np.clip(start, low, high), ramp=ramp)
    damping = np.full(candidates.count, 1e-3)
    last = np.full(candidates.count, np.inf)
    active = np.isfinite(state.objective) & moving.any(axis=1)
    for count in range(iterations):
        if handicap is not None:
            active &= ~given_up(state.objective + handicap, last, count)
        rows = np.flatnonzero(active)
        if not rows.size:
            break
        trial = _step(state, rows, moving, damping, limits=(low, high))
        every = rows.size == candidates.count
        own = candidates if every else candidates[rows]
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
    state: Evaluation,
    rows: IntArray,
    moving: BoolArray,
    damping: FloatArray,
    *,
    limits: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Return the damped scoring step from where the rows stand, inside the bounds."""
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


def covariance(information: FloatArray, free: BoolArray) -> FloatArray:
    """Return the covariance of the `free` parameters, shape (p,), as a matrix of shape (p, p).

    Parameters that the data do not tell (a term that is absent) have variance inf, and are held
    for the others; so have parameters that are held (0 information).
    """
    size = free.size
    result = np.zeros((size, size))
    diagonal = np.diag(information)
    used = np.flatnonzero(free & (diagonal > _NONE))
    result[np.arange(size), np.arange(size)] = np.inf
    if used.size:
        root = np.sqrt(diagonal[used])
        correlation = information[np.ix_(used, used)] / np.outer(root, root)
        values, vectors = np.linalg.eigh(correlation)
        inverse = (vectors / np.maximum(values, 1e-13)) @ vectors.T
        result[np.ix_(used, used)] = inverse / np.outer(root, root)
    return result


def misfit(ordinates: Ordinates, found: Evaluation) -> Goodness:
    """Return how far one candidate is from the ordinates that its likelihood was `found` with.

    Each group's sum of X²/S is chi-squared with its n degrees of freedom: mean n, variance 2n, and
    the squared standardised residual has mean 1 and variance 2 + 12/n.
    """
    _, size, residual = _residuals(ordinates, found)
    square = float(np.mean(residual**2))
    statistic = (square - 1) * size.size / float(np.sqrt(np.sum(2 + 12 / size)))
    return Goodness(statistic=statistic, p_value=float(scipy.special.ndtr(-statistic)), chi2_per_bin=square)


def misfit_factors(ordinates: Ordinates, found: Evaluation) -> FloatArray:
    """Return by what factor each variance parameter is less sure than the likelihood says, shape (p,).

    The root of the mean squared residual where the parameter's information lies: the variance that holds
    for a model which is only nearly right (Huber 1967, Proc. 5th Berkeley Symposium 1, 221) for one
    parameter by itself. Of a power law that the candidate lacks, where its information would lie.
    """
    first, _, residual = _residuals(ordinates, found)
    parts = derivatives(ordinates, found.candidates, found.theta)[: found.candidates.variances]
    laws = ordinates.basis.shape[0]
    absent = np.flatnonzero(np.max(parts[:laws], axis=1) <= 0)
    parts[absent] = ordinates.basis[absent]
    # The largest is one, so that the squares of what is far below the line stay numbers.
    share = parts / found.spectrum[0]
    share /= np.maximum(share.max(axis=1, keepdims=True), 1e-300)
    weight = np.add.reduceat(share**2 * ordinates.size, first, axis=1)
    return np.asarray(np.sqrt(weight @ residual**2 / np.maximum(weight.sum(axis=1), 1e-300)))


def _residuals(ordinates: Ordinates, found: Evaluation) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return groups of bins: the first of each, its degrees of freedom, its residual."""
    ratio = ordinates.rest(found.beta[0]) / found.spectrum[0]
    group = np.floor((np.cumsum(ordinates.size) - ordinates.size / 2) / _JOIN)
    first = np.flatnonzero(np.diff(group, prepend=-1.0) != 0)
    size = np.add.reduceat(ordinates.size, first)
    residual = (np.add.reduceat(ratio, first) - size) / np.sqrt(2 * size)
    return first, size, residual
