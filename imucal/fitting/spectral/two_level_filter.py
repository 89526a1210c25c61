"""The likelihood of two levels in coloured noise, by a filter that merges what the level may have been.

Given when the level jumped, samples are Gaussian: white noise, a walk, and flicker as a bank of
Gauss-Markov states, whose likelihood a Kalman filter gives. Of the 2^n courses of the level the filter
keeps, for either level now, the mean and the covariance of the states over all that came before:
generalised pseudo-Bayes of the second order. It tells levels from Gaussian noise as well as a filter that
keeps hundreds of courses (`tests/benchmarks/disturbance_limits.py`).

Source: Bar-Shalom, Li & Kirubarajan (2001), Estimation with Applications to Tracking and Navigation,
sec. 11.6.4.
"""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.noise.bank import gauss_markov_bank

#: Correlation times a decade of the bank, whose density ripples by 5.5 %: alike with and without levels.
_PER_DECADE = 1.0
#: Pieces of a record that are filtered at once, and samples before each that its states settle on.
_PIECES, _SETTLE = 8, 64
#: Least variance of the walk at first, in variances of the samples; and what keeps a logarithm finite.
_LEAST, _TINY = 0.05, 1e-290


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mixtures:
    """r mixtures of noise: variances in U² per sample, and a time in samples; each of shape (r,).

    Attributes
    ----------
    white, flicker, walk
        Of N, B and K.
    markov, time
        Variance and correlation time of what is either a Gauss-Markov process, or two levels ±sqrt(markov)
        with jumps every 2 `time` on average: of the same spectrum.
    """

    white: FloatArray
    flicker: FloatArray
    walk: FloatArray
    markov: FloatArray
    time: FloatArray


_NAMES = ("white", "flicker", "walk", "markov", "time")


def log_likelihoods(samples: FloatArray, mixtures: Mixtures, two_levels: BoolArray) -> FloatArray:
    """Return log L of `samples`, shape (n,), under each mixture, shape (r,); up to 7 at the end are left out.

    `two_levels`, shape (r,), says whether the Markov part is two levels, or Gaussian. Eight pieces of the
    record are filtered side by side; the first 64 samples of each but the first settle its states.
    """
    rows = two_levels.size
    length = (samples.size - _SETTLE) // _PIECES
    places = np.arange(_PIECES)[:, np.newaxis] * length + np.arange(length + _SETTLE)
    every = Mixtures(**{name: np.tile(getattr(mixtures, name), _PIECES) for name in _NAMES})
    steps = _filtered(np.repeat(samples[places].T, rows, axis=1), every, np.tile(two_levels, _PIECES))
    steps[:_SETTLE, rows:] = 0.0
    return np.asarray(steps.sum(axis=0).reshape(_PIECES, rows).sum(axis=0))


def _filtered(samples: FloatArray, mixtures: Mixtures, two_levels: BoolArray) -> FloatArray:
    """Return the log-likelihood of each sample given those before, shape (n, r), of samples (n, r)."""
    n, rows = samples.shape
    decay, start, drive = _states(mixtures, two_levels, n, float(samples.var()))
    size = np.where(two_levels, np.sqrt(mixtures.markov), 0.0)
    offset, spread, jump = _pairs(size, mixtures)
    decays, own = decay[:, np.newaxis] * decay, range(len(decay))
    # Of the states for either level: means, shape (2, d, r), covariances, (2, d, d, r), and its chance.
    mean = np.zeros((2, len(decay), rows))
    covariance = np.zeros((2, len(decay), len(decay), rows))
    covariance[:, own, own] = start
    chance = np.full((2, rows), 0.5)
    likelihood = np.empty((n, rows))
    # Pairs of the level before and the level now, shape (2, 2, r), are summed over the first.
    for place in range(n):
        gain = covariance.sum(axis=2)
        variance = gain.sum(axis=1)[:, np.newaxis] + spread
        error = samples[place] - mean.sum(axis=1)[:, np.newaxis] - offset
        part = error / variance
        joint = chance[:, np.newaxis] * jump * np.exp(-0.5 * error * part) / np.sqrt(variance) + _TINY
        now = joint.sum(axis=0)
        likelihood[place] = now.sum(axis=0)
        chance = now / likelihood[place]
        share = joint / now
        moved = mean[:, np.newaxis] + part[:, :, np.newaxis] * gain[:, np.newaxis]
        mean = (share[:, :, np.newaxis] * moved).sum(axis=0)
        apart = np.sqrt(share[0] * share[1])[:, np.newaxis] * (moved[0] - moved[1])
        told = (share / variance)[:, :, np.newaxis] * gain[:, np.newaxis]
        merged = apart[:, :, np.newaxis] * apart[:, np.newaxis]
        for before in range(2):
            merged += share[before, :, np.newaxis, np.newaxis] * covariance[before]
            merged -= told[before][:, :, np.newaxis] * gain[before]
        mean *= decay
        covariance = merged * decays
        covariance[:, own, own] += drive
    return np.asarray(np.log(likelihood) - 0.5 * np.log(2 * np.pi))


def _states(
    mixtures: Mixtures, two_levels: BoolArray, n: int, total: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return decay, variance at first and of the driving noise of each state, shapes (d, r).

    Flicker's bank, the Markov process (still where it is two levels), and the walk. At first the walk has
    the variance of the samples, `total`, that is not the Markov part's: were it unknown, either level would
    do, and what is merged would never tell them apart.
    """
    bank = gauss_markov_bank(1.0, 0.5, n / 3, _PER_DECADE)
    rows = two_levels.size
    times = np.stack([*(np.full(rows, term.T) for term in bank), mixtures.time])
    flicker = [term.sigma**2 * mixtures.flicker for term in bank]
    walk = np.maximum(total - mixtures.markov, _LEAST * total)
    start = np.stack([*flicker, np.where(two_levels, 0.0, mixtures.markov), walk])
    decay = np.stack([*np.exp(-1 / times), np.ones(rows)])
    drive = start * (1 - decay**2)
    drive[-1] = mixtures.walk
    return decay, start, drive


def _pairs(size: FloatArray, mixtures: Mixtures) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean and variance that a sample has, and the chance, of each level before and now, (2, 2, r).

    A sample that holds a jump lies anywhere between the levels.
    """
    stay = 0.5 * (1 + np.exp(-1 / mixtures.time))
    same = np.eye(2, dtype=bool)[:, :, np.newaxis]
    offset = np.diag([-1.0, 1.0])[:, :, np.newaxis] * size
    spread = mixtures.white + np.where(same, 0.0, size**2 / 3)
    return offset, spread, np.where(same, stay, 1 - stay)
