"""Damped Fisher scoring (Levenberg and Marquardt) of many models at once."""

from dataclasses import fields

import numpy as np
import scipy

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.noise_fit import Goodness
from imucal.fitting.spectral.likelihood import Fits, derivatives, evaluate
from imucal.fitting.spectral.models import Models
from imucal.fitting.spectral.ordinates import SHAPED, Ordinates

#: A term whose share of every bin is below exp(-_ABSENT) is absent.
_ABSENT = 18.0
#: Longest step of a parameter, in log units; for a response coefficient, relative to 1 + its size.
_STEP = 1.5
#: Number of steps -> largest distance from the best, in log-likelihood, after them …
_BEHIND = {3: 50.0, 12: 37.5, 20: 20.0}
#: … unless the last step gained more than this share of the distance.
_CATCHING_UP = 0.1
#: Neighbouring bins are joined until they have this many degrees of freedom.
_JOIN = 8.0


def given_up(value: FloatArray, gain: FloatArray, steps: int) -> BoolArray:
    """Return the mask of the models that are far behind the best and do not catch up, shape (c,).

    `value` is the objective after `steps` steps, and `gain` the gain of the last one. On simulated and real
    logs, no model that ends within 12.5 of the best is given up.
    """
    most = [behind for first, behind in _BEHIND.items() if steps >= first]
    behind = value - np.min(value)
    return np.asarray((behind > (most[-1] if most else np.inf)) & (gain < _CATCHING_UP * behind))


def bounds(ordinates: Ordinates, models: Models) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper bounds of each parameter, shape (p,) each.

    At the lower bound of its variance a term is invisible in every bin. A correlation time is between the
    models' shortest and twice the record.
    """
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

    `free`, shape (c, p), is the mask of the parameters to move, by default all parameters of a model. `ramp`
    is a fixed ramp, see `evaluate`. The search ends if a step gains less log-likelihood than `tolerance`. If
    a `handicap`, shape (c,), is given, it is added to the objectives, and models far behind the best are
    given up early.
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
    """Return the parameters of some rows after a damped scoring step inside the bounds."""
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

    The sum of X²/S over a group is chi-squared with n degrees of freedom: it has mean n and variance 2n, and
    the squared standardised residual has mean 1 and variance 2 + 12/n.
    """
    _, size, residual = _residuals(ordinates, found)
    square = float(np.mean(residual**2))
    statistic = (square - 1) * size.size / float(np.sqrt(np.sum(2 + 12 / size)))
    return Goodness(statistic=statistic, p_value=float(scipy.special.ndtr(-statistic)), chi2_per_bin=square)


def misfit_factors(ordinates: Ordinates, found: Fits) -> FloatArray:
    """Return the factor by which a misfit widens the error of each variance parameter, shape (s,).

    It is the root of the mean squared residual, weighted by the parameter's information: the robust variance
    of one parameter of a misspecified model (Huber 1967, Proc. 5th Berkeley Symposium 1, 221). A power law
    that the model lacks gets the information that it would have.
    """
    first, _, residual = _residuals(ordinates, found)
    parts = derivatives(ordinates, found.models, found.theta)[: found.models.variances]
    laws = ordinates.basis.shape[0]
    absent = np.flatnonzero(np.max(parts[:laws], axis=1) <= 0)
    parts[absent] = ordinates.basis[absent]
    # Scale the maximum to one, so that small squares do not underflow.
    share = parts / found.spectrum[0]
    share /= np.maximum(share.max(axis=1, keepdims=True), 1e-300)
    weight = np.add.reduceat(share**2 * ordinates.size, first, axis=1)
    return np.asarray(np.sqrt(weight @ residual**2 / np.maximum(weight.sum(axis=1), 1e-300)))


def _residuals(ordinates: Ordinates, found: Fits) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return groups of bins: the first bin, the degrees of freedom and the residual of each."""
    ratio = ordinates.rest(found.beta[0]) / found.spectrum[0]
    group = np.floor((np.cumsum(ordinates.size) - ordinates.size / 2) / _JOIN)
    first = np.flatnonzero(np.diff(group, prepend=-1.0) != 0)
    size = np.add.reduceat(ordinates.size, first)
    residual = (np.add.reduceat(ratio, first) - size) / np.sqrt(2 * size)
    return first, size, residual
