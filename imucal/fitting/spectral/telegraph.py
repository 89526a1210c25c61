"""Random telegraph noise: a level that jumps to and fro between two values.

Its spectrum is that of a Gauss-Markov process, so no spectrum tells them apart; their distributions do.
Means over short spans are explained by N, B, K and a Gauss-Markov process, or by N, B, K and two levels
of the same spectrum, with many sharings of what the record holds among them. The likelihoods decide.

Given when the level jumped, samples are Gaussian: white noise, a walk, and flicker as a bank of Gauss-Markov
states, whose likelihood a Kalman filter gives. Of the 2^n courses of the level the filter keeps, for either
level now, the mean and the covariance of the states over all that came before: generalised pseudo-Bayes of
the second order. `tests/benchmarks/disturbance_limits.py` compares it with a filter that keeps hundreds of
courses, and the test with the best there can be.

Source: Machlup (1954), J. Appl. Phys. 25, 341 (the spectrum); Bar-Shalom, Li & Kirubarajan (2001), Estimation
with Applications to Tracking and Navigation, sec. 11.6.4 (the filter).
"""

from typing import NamedTuple

import numpy as np
import scipy

from imucal.allan.dct import dct_bins, dct_ordinates
from imucal.arrays import BoolArray, FloatArray
from imucal.findings import Finding
from imucal.fitting.spectral.blocks import Block, bin_blocks
from imucal.fitting.spectral.disturbances import Whitened, best_cycle
from imucal.fitting.spectral.likelihood import candidates_of, evaluate
from imucal.fitting.spectral.starts import find_starts
from imucal.frozen import frozen, frozen_alone
from imucal.noise.term import gauss_markov_dct
from imucal.noise.terms import GaussMarkov
from imucal.recording import AxisSeries
from imucal.units import pretty

#: Correlation times a decade of the bank, whose density ripples by 5.5 %: alike with and without levels.
_PER_DECADE = 1.0
#: Pieces of a record that are filtered at once, and samples before each that its states settle on.
_PIECES, _SETTLE = 8, 64
#: Least variance of the walk at first, in variances of the samples; and what keeps a logarithm finite.
_LEAST, _TINY = 0.05, 1e-290


class Mixtures(NamedTuple):
    """r mixtures of noise: variances in U² per sample, of N, B, K, and a last part; each of shape (r,).

    That has variance `markov` and correlation `time` in samples. It is either a Gauss-Markov process, or two
    levels ±sqrt(markov) with jumps every 2 `time` on average: of the same spectrum.
    """

    white: FloatArray
    flicker: FloatArray
    walk: FloatArray
    markov: FloatArray
    time: FloatArray


def log_likelihoods(samples: FloatArray, mixtures: Mixtures, two_levels: BoolArray) -> FloatArray:
    """Return log L of `samples`, shape (n,), under each mixture, shape (r,); up to 7 at the end are left out.

    `two_levels`, shape (r,), says whether the Markov part is two levels, or Gaussian. Eight pieces of the
    record are filtered side by side; the first 64 samples of each but the first settle its states.
    """
    rows = two_levels.size
    length = (samples.size - _SETTLE) // _PIECES
    places = np.arange(_PIECES)[:, np.newaxis] * length + np.arange(length + _SETTLE)
    every = Mixtures(*(np.tile(part, _PIECES) for part in mixtures))
    steps = _filtered(np.repeat(samples[places].T, rows, axis=1), every, np.tile(two_levels, _PIECES))
    steps[:_SETTLE, rows:] = 0.0
    return np.asarray(steps.sum(axis=0).reshape(_PIECES, rows).sum(axis=0))


def _filtered(samples: FloatArray, mixtures: Mixtures, two_levels: BoolArray) -> FloatArray:
    """Return the log-likelihood of each sample given those before, shape (n, r), of samples (n, r)."""
    n, rows = samples.shape
    decay, start, drive = _states(mixtures, two_levels, n, float(samples.var()))
    # Of each level before and now, (2, 2, r): the chance, and a sample's mean and variance. One that holds a
    # jump lies anywhere between the levels.
    size, stay = np.where(two_levels, np.sqrt(mixtures.markov), 0.0), 0.5 * (1 + np.exp(-1 / mixtures.time))
    same = np.eye(2, dtype=bool)[:, :, np.newaxis]
    jump, offset = np.where(same, stay, 1 - stay), np.diag([-1.0, 1.0])[:, :, np.newaxis] * size
    spread = mixtures.white + np.where(same, 0.0, size**2 / 3)
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
    bank = GaussMarkov.bank(1.0, 0.5, n / 3, _PER_DECADE)
    rows = two_levels.size
    times = np.stack([*(np.full(rows, term.T) for term in bank), mixtures.time])
    flicker = [term.sigma**2 * mixtures.flicker for term in bank]
    walk = np.maximum(total - mixtures.markov, _LEAST * total)
    start = np.stack([*flicker, np.where(two_levels, 0.0, mixtures.markov), walk])
    decay = np.stack([*np.exp(-1 / times), np.ones(rows)])
    drive = start * (1 - decay**2)
    drive[-1] = mixtures.walk
    return decay, start, drive


#: Spans, and fewest samples of one; a span is short against the time between jumps that can be told.
_SPANS, _FEWEST = 1024, 8
#: How much better in log-likelihood two levels must explain the means than the best Gaussian noise; and
#: than N, B and K alone, since flicker is mistaken for any Gauss-Markov process.
_MARGIN, _ON_PLAIN = 3.5, 5.5
#: Gaussian mixtures farther than this from the best in log-likelihood are no explanation, with jumps or not;
#: and the most correlation times that are tried.
_NEAR, _MOST_TIMES = 3.0, 5
#: Half the distance of two levels that may be told, in deviations of a span's noise; and by how much the
#: kurtosis of the best linear estimate of the level must fall short of a Gaussian's 3.
_APART, _FLAT = 0.5, 0.2
#: Fewer jumps a record are steps, each of its own.
_JUMPS = 8
#: Skewness of the differences from which a level that seems to jump is a sawtooth: of twelve telegraphs it
#: was 0.13 at most, of fourteen sawteeth 0.30 at least.
_LOPSIDED = 0.2
#: The means' deviation over the largest sample, below which they are equal.
_ROUNDING = 1e-12
#: Fitted with and without B, which GM is often mistaken for; and what is fitted without GM.
_STRUCTURES, _PLAIN = (("N", "B", "GM", "K"), ("N", "GM", "K")), ("N", "B", "K")
#: Columns of a row, in which `Mixtures` stand from N on; more correlation times than there are.
_WHITE, _MARKOV, _TIME = 1, 4, 5
_EVERY = 99
#: Factors on the variance and the time of the best two levels of a first search, in the columns of a row.
_ABOUT = np.array([[1, 1, 1, 1, size**2, time] for size in (0.85, 1.0, 1.15) for time in (0.75, 1.0, 1.35)])


@frozen
class TwoLevels:
    """A level that jumps: half the distance of the levels, in U, and the mean time between jumps, in s.

    Or that seems to: a sawtooth ramps one way, slowly, and jumps back.
    """

    amplitude: float
    dwell_s: float
    sawtooth: bool


def find_telegraph(series: AxisSeries) -> TwoLevels | None:
    """Return the two levels of finite samples; None where Gaussian noise explains them as well.

    Samples are taken as if there were no gaps.
    """
    width = max(series.n // _SPANS, _FEWEST)
    count = min(series.n // width, _SPANS)
    if count < _SPANS // 4:
        return None
    means = np.add.reduceat(series.samples[: count * width], np.arange(0, count * width, width)) / width
    scale = float(means.std())
    if scale <= _ROUNDING * float(np.abs(series.samples).max()):
        return None
    place = np.arange(count) - (count - 1) / 2
    flat = means / scale - np.mean(means / scale)
    found = _two_levels(flat - place * (place @ flat) / (place @ place))
    if found is None:
        return None
    size, time = found
    # Of two levels as many jump up as down; a sawtooth has many small differences and few large ones back.
    lag = max(round(time / 2), 1)
    every = (flat[apart:] - flat[:-apart] for apart in (lag, 2 * lag))
    centred = (steps - steps.mean() for steps in every)
    skewness = float(np.mean([np.mean(d**3) / np.mean(d**2) ** 1.5 for d in centred]))
    return TwoLevels(
        amplitude=scale * size, dwell_s=2 * width * series.tau0 * time, sawtooth=abs(skewness) > _LOPSIDED
    )


def telegraph_finding(found: TwoLevels | None, series: AxisSeries) -> tuple[Finding, ...]:
    """Return what to say of two levels."""
    if found is None:
        return ()
    size, often = f"{found.amplitude:.3g} {pretty(series.unit)}", f"every {found.dwell_s:.3g} s on average"
    if found.sawtooth:
        text = f"The level ramps and jumps back by about {size}, {often}, like a bias estimate."
        advice = "Record the samples without the device's own bias estimate; the fit reports it as B or GM."
        return (Finding("warning", "sawtooth", text, advice, axis=series.name),)
    text = f"The level jumps between two values, ±{size}, {often}: random telegraph noise."
    advice = "The fit describes it by B or GM: the spectrum is right, but Gaussian noise does not jump."
    return (Finding("warning", "telegraph", text, advice, axis=series.name),)


def _two_levels(means: FloatArray) -> tuple[float, float] | None:
    """Return half the distance of the levels and half the mean spans between jumps; None where none are."""
    block = Block(offset=0, bins=dct_bins(means.size), ordinates=dct_ordinates(means))
    sharings = _Sharings.of(block)
    likeliest = np.unravel_index(np.argmin(sharings.distance), sharings.distance.shape)
    gaussian = sharings.weights[likeliest]
    rows = sharings.worth_a_try(block)
    if not len(rows):
        return None
    likelihood = _likelihoods(means, gaussian, rows)
    found = rows[int(np.argmax(likelihood))]
    # What a cycle gains beside Gaussian noise, less half of ln n for each of its period, amplitude and phase.
    spectrum = sharings.spectrum[likeliest][block.bins.first - 1]
    cycle, _ = best_cycle(Whitened.by([block], spectrum, ()), means.size)
    cycle = 0.5 * (cycle - 3 * float(np.log(means.size)))
    if likelihood.max() < max(_MARGIN, _ON_PLAIN - sharings.on_plain, cycle):
        return None
    # About the best, and one that jumps so seldom that each jump is a step of its own.
    about = np.concatenate([found[np.newaxis] * _ABOUT, found[np.newaxis]])
    about[-1, _TIME] = means.size / (2 * _JUMPS)
    likelihood = _likelihoods(means, gaussian, about)
    best = int(np.argmax(likelihood))
    if best == len(about) - 1 or about[best, _TIME] >= about[-1, _TIME]:
        return None
    return float(np.sqrt(about[best, _MARKOV])), float(about[best, _TIME])


@frozen_alone
class _Sharings:
    """What each of N, B, K and GM may make of a record, for t correlation times, with B and without.

    `weights` are variances per span and times, in the columns of the likelihood, shape (2, t, p), `distance`
    is -log L above the least, shape (2, t), `spectrum` and `markov` are S and GM's part of it at each
    ordinate, shape (2, t, n-1). `on_plain` is what the best gains in log-likelihood on N, B and K alone.
    """

    weights: FloatArray
    distance: FloatArray
    on_plain: float
    spectrum: FloatArray
    markov: FloatArray

    @classmethod
    def of(cls, block: Block) -> "_Sharings":
        seen = bin_blocks([block], 1.0)
        candidates = candidates_of([*_STRUCTURES, _PLAIN], seen.names)
        owner, theta = find_starts(seen, candidates, keep=(1, _EVERY, 1))
        order = np.lexsort((theta[:, _TIME], owner))
        owner, theta = owner[order], theta[order]
        found = evaluate(seen, candidates[owner], theta)
        with_markov = owner < len(_STRUCTURES)
        least = float(found.objective[with_markov].min())
        shape, _ = gauss_markov_dct(theta[:, _TIME, np.newaxis], seen.lam, seen.length, seen.sign)
        markov = np.exp(theta[:, _MARKOV, np.newaxis]) * shape

        def parted(values: FloatArray) -> FloatArray:
            own = values[with_markov]
            return own.reshape(len(_STRUCTURES), -1, *own.shape[1:])

        count = block.bins.count
        return cls(
            weights=parted(np.exp(theta)),
            distance=parted(found.objective - least),
            on_plain=float(found.objective[~with_markov].min()) - least,
            spectrum=parted(np.repeat(found.spectrum, count, axis=1)),
            markov=parted(np.repeat(markov, count, axis=1)),
        )

    def worth_a_try(self, block: Block) -> FloatArray:
        """Return those whose Markov part may be two levels, and sharings between them, shape (r, p)."""
        times = self.weights[0, :, _TIME]
        likely = self.distance <= _NEAR
        likely &= self.weights[..., _MARKOV] > _APART**2 * self.weights[..., _WHITE]
        # And 3 less the kurtosis of that part's best linear estimate.
        estimate = np.zeros((*self.distance.shape, block.bins.n))
        estimate[..., 1:] = block.ordinates * self.markov / self.spectrum
        samples = scipy.fft.idct(estimate, norm="ortho")
        square = samples * samples
        likely &= 3 - np.mean(square * square, axis=-1) / np.mean(square, axis=-1) ** 2 > _FLAT
        chosen = np.flatnonzero(likely.any(axis=0) & (times <= block.bins.n / (2 * _JUMPS)))
        some = np.linspace(0, chosen.size - 1, min(chosen.size, _MOST_TIMES)).round().astype(int)
        with_flicker, without = self.weights[:, chosen[some]]
        return np.concatenate([with_flicker, (with_flicker + without) / 2, without])


def _likelihoods(means: FloatArray, gaussian: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the log-likelihood that two levels, shape (r, p), gain on the `gaussian` mixture, shape (p,)."""
    every = np.concatenate([gaussian[np.newaxis], rows])
    found = log_likelihoods(means, Mixtures(*every[:, _WHITE:].T), np.arange(len(every)) > 0)
    return np.asarray(found[1:] - found[0])
