"""A noise model's samples as a sum of states: their filter, and with it the exact likelihood, in O(n).

Every term is a state that moves from sample to sample: Gauss-Markov and random walk are scalars,
quantization is the difference of neighbouring errors, flicker a bank of Gauss-Markov terms. A level
and a slope without noise stand beside them, with a flat prior. All is Gaussian, so a Kalman filter
is one way to the likelihood. Here it goes from block to block: given the states at its start, every
covariance in a block of samples is known in closed form, and depends on which samples are missing
only. One set of small matrices serves all whole blocks, and nothing is approximated.

The likelihood is that of all contrasts between samples, since the level is unknown, whether a walk
starts there or not: as in `imucal.fitting.spectral.likelihood`. `fit_exact` is what ``verify``
compares a fit with; the tests hold the faster likelihood against it.

Source: Anderson & Moore (1979), "Optimal filtering", sec. 6.3 and 7.3; the likelihood equals the
diffuse Kalman filter's, de Jong (1991), Ann. Statist. 19, 1073.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.errors import DataError
from imucal.frozen import frozen_alone
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm, PowerLawTerm
from imucal.noise.terms import BiasInstability, GaussMarkov, RateRamp, RateRandomWalk, term_keys
from imucal.recording import AxisSeries

#: Correlation times a decade in a bank for flicker: its density ripples by 0.65 %.
_BANK_PER_DECADE = 1.5
#: Samples in a block; in one of a record of which many blocks have holes of their own.
_WHOLE, _HOLED = 256, 64
#: Share of blocks with holes of their own above which blocks are short.
_MANY = 0.1
#: Standard deviation of a flat prior, beside the largest sample.
_FLAT = 1e5
#: The component that is the sum of all.
BIAS = "bias"


@frozen_alone
class StateSpace:
    """The independent scalar states of a model, which samples are the sum of, with white noise beside them.

    Each of d states has a `decay` phi, the variance of the noise that drives it per sample, and its variance
    at the first sample, infinite for a walk; shape (d,) each. `groups` says which states a component sums,
    shape (d,), by its key. A `quantized` model's first state u, with decay 0 and in no group, is a
    quantization error: samples hold u[t+1] - u[t]. What has no noise and a `flat` prior is ``level`` and
    ``R``, the slope; `white` is the variance of the white noise.
    """

    decay: FloatArray
    drive: FloatArray
    start: FloatArray
    groups: dict[str, BoolArray]
    quantized: bool
    flat: tuple[str, ...]
    white: float

    @classmethod
    def of(cls, model: NoiseModel, *, rate_hz: float, n: int) -> "StateSpace":
        """Return the states of a model's terms for `n` samples; a term that has none is a ValueError.

        A walk holds the level; without one the level stands for itself.
        """
        tau0 = 1 / rate_hz
        variances = {t.symbol: t.variance(tau0) for t in model.terms if isinstance(t, PowerLawTerm)}
        quantization = variances.get("Q", 0.0)
        states = [(0.0, quantization, quantization)] if quantization else []
        owners = [""] * len(states)
        for term, key in zip(model.terms, term_keys(t.symbol for t in model.terms), strict=True):
            own = _term_states(term, tau0, n)
            states += own
            owners += [key] * len(own)
        decay, drive, start = np.array(states).reshape(-1, 3).T.copy()
        # The covariance of a block needs some white noise: a 1e-7 of the least density changes the likelihood
        # of a sample by as little, and 1e-10 of the largest variance is what double precision can carry.
        frequencies = np.geomspace(rate_hz / (2 * n), rate_hz / 2, 256)
        least = float(model.psd(frequencies, rate_hz=rate_hz).min()) * rate_hz
        shown = {"level": not np.isinf(start).any(), "R": any(term.symbol == "R" for term in model.terms)}
        return cls(
            decay=decay,
            drive=drive,
            start=start,
            groups={
                key: np.array([owner == key for owner in owners]) for key in dict.fromkeys(owners) if key
            },
            quantized=bool(quantization),
            flat=tuple(name for name, is_shown in shown.items() if is_shown),
            white=variances.get("N") or max(1e-7 * least, 1e-10 * (float(drive.max(initial=0.0)) or 1.0)),
        )

    @property
    def size(self) -> int:
        """Number of states that move."""
        return self.decay.size

    @property
    def everything(self) -> BoolArray:
        """Which states are of a component, shape (d,)."""
        return np.asarray(np.any([np.zeros(self.size, dtype=bool), *self.groups.values()], axis=0))

    def in_unit_of_white(self) -> "StateSpace":
        """Return the states with white noise of variance 1."""
        return replace(self, drive=self.drive / self.white, start=self.start / self.white, white=1.0)

    def extension(self, time: float) -> FloatArray:
        """Return the map from states, level and slope to a block's extended start, shape (d + 2, d + p).

        The extended start holds the states, the level in the block, and the slope.
        """
        d = self.size
        extension = np.zeros((d + 2, d + len(self.flat)))
        extension[:d, :d] = np.eye(d)
        for i, name in enumerate(self.flat):
            extension[d:, d + i] = (1.0, 0.0) if name == "level" else (time, 1.0)
        return extension


def _term_states(term: NoiseTerm, tau0: float, n: int) -> list[tuple[float, float, float]]:
    """Return decay, drive and start of each state of a walk, flicker or a Gauss-Markov term.

    None of white noise, quantization and a ramp; flicker is a bank for `n` samples.
    """
    if not isinstance(term, PowerLawTerm | GaussMarkov | RateRamp):
        msg = f"the state space has no state for {term.symbol} ({term.names[0]}); leave it out"
        raise ValueError(msg)  # noqa: TRY004 - it is the model that is wrong, not a type
    if not term.coefficient > 0:
        return []
    if isinstance(term, RateRandomWalk):
        return [(1.0, term.variance(tau0), math.inf)]
    markov: tuple[GaussMarkov, ...] = (term,) if isinstance(term, GaussMarkov) else ()
    if isinstance(term, BiasInstability):
        markov = GaussMarkov.bank(term.value, tau0 / 2, 3 * n * tau0, _BANK_PER_DECADE)
    return [(t.phi(tau0), t.q(tau0) ** 2, t.sigma**2) for t in markov]


@frozen_alone
class BlockLaw:
    """The covariances of a block of B samples, given the states at its start, in closed form.

    The states at the start, and level and slope in the block, are the extended start, shape (d + 2,). It adds
    `trace`, shape (B, d + 2), to the `samples`, whose covariance is of shape (B, B), and `passed`, shape
    (d, d + 2), to the states at the end, of variance `end`, shape (d,), and covariance `with_end` with the
    samples, shape (B, d). `own` is the covariance of each state at a place with itself at another, shape
    (d, B + 1, B + 1), and `sampled` of what it adds to each sample with it, shape (d, B, B + 1).
    """

    samples: FloatArray
    trace: FloatArray
    end: FloatArray
    passed: FloatArray
    with_end: FloatArray
    own: FloatArray
    sampled: FloatArray

    @classmethod
    def of(cls, states: StateSpace, length: int, share: float) -> "BlockLaw":
        """Return the law of a block of so many samples, `share` of the record, the slope's unit of time."""
        d, B = states.size, length
        t = np.arange(B + 1.0)
        rate = -np.log(np.maximum(states.decay, 1e-300))[:, np.newaxis]
        with np.errstate(invalid="ignore", divide="ignore"):
            grown = np.where(rate > 0, np.expm1(-2 * rate * t) / np.expm1(-2 * rate), t)
        variance = states.drive[:, np.newaxis] * grown
        left = states.decay[:, np.newaxis] ** t
        lag = np.abs(np.subtract.outer(t, t)).astype(int)
        least = np.minimum.outer(t, t).astype(int)
        own = left[:, lag] * variance[:, least]
        sampled, trace = own[:, :B].copy(), left[:, :B].copy()
        between = sampled.sum(axis=0)[:, :B] + np.eye(B)
        if states.quantized:
            between -= sampled[0, :, :B]
            sampled[0], trace[0] = np.diff(own[0], axis=0), np.diff(left[0])
            between += np.diff(sampled[0], axis=1)
        passed = np.zeros((d, d + 2))
        passed[:, :d] = np.diag(left[:, B])
        return cls(
            samples=between,
            trace=np.concatenate([trace, np.stack([np.ones(B), t[:B] / B * share])]).T,
            end=variance[:, B],
            passed=passed,
            with_end=sampled[:, :, B].T,
            own=own,
            sampled=sampled,
        )


@frozen_alone
class Told:
    """What blocks that miss the same samples tell: of their start, and of their end given the start.

    The covariance of the samples seen given the start has an `inverse`, shape (seen, seen), and the logarithm
    of a determinant. It makes `weights` of the samples for the extended start, shape (d + 2, seen), on which
    they have `information`, shape (d + 2, d + 2). The end is passed @ extended start + gain @ samples + noise
    of covariance rest.
    """

    inverse: FloatArray
    log_det: float
    weights: FloatArray
    information: FloatArray
    passed: FloatArray
    gain: FloatArray
    rest: FloatArray

    @classmethod
    def of(cls, block: BlockLaw, seen: BoolArray) -> "Told":
        """Return it for blocks of which the samples `seen`, shape (B,), are there."""
        covariance = block.samples[np.ix_(seen, seen)]
        inverse = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        trace, with_end = block.trace[seen], block.with_end[seen]
        weights, gain = trace.T @ inverse, with_end.T @ inverse
        rest = np.diag(block.end) - gain @ with_end
        return cls(
            inverse=inverse,
            log_det=float(np.linalg.slogdet(covariance)[1]),
            weights=weights,
            information=weights @ trace,
            passed=block.passed - gain @ trace,
            gain=gain,
            rest=(rest + rest.T) / 2,
        )


@frozen_alone
class Blocks:
    """A record cut into blocks, shape (b, length), the last filled up with missing samples."""

    samples: FloatArray
    seen: BoolArray

    @classmethod
    def of(cls, samples: FloatArray, seen: BoolArray) -> "Blocks":
        """Cut a record of shape (n,) into blocks; short ones where many have holes of their own."""
        whole = cls._cut(samples, seen, _WHOLE)
        kinds = len({packed.tobytes() for packed in np.packbits(whole.seen, axis=1)})
        return cls._cut(samples, seen, _HOLED) if kinds > max(_MANY * whole.count, 3) else whole

    @classmethod
    def _cut(cls, samples: FloatArray, seen: BoolArray, length: int) -> "Blocks":
        count = -(-samples.size // length)
        filled, there = np.zeros(count * length), np.zeros(count * length, dtype=bool)
        filled[: samples.size] = np.where(seen, samples, 0.0)
        there[: samples.size] = seen
        return cls(samples=filled.reshape(count, length), seen=there.reshape(count, length))

    @property
    def count(self) -> int:
        """Number of blocks."""
        return int(self.samples.shape[0])

    @property
    def length(self) -> int:
        """Number of samples of each."""
        return int(self.samples.shape[1])

    def alike(self) -> Iterator[tuple[IntArray, BoolArray]]:
        """Yield the blocks that miss the same samples: their places, and which are seen, shape (length,)."""
        places: dict[bytes, list[int]] = {}
        for place, packed in enumerate(np.packbits(self.seen, axis=1)):
            places.setdefault(packed.tobytes(), []).append(place)
        for members in places.values():
            yield np.array(members), self.seen[members[0]]


@frozen_alone
class Step:
    """What the samples up to a block's end tell of states, level and slope.

    Mean and covariance at its start, shapes (d + p,) and (d + p, d + p), `cross`, that of those at its end
    with them, and at its end the mean `predicted`, the covariance `ahead` and its inverse. `log_density` is
    that of the block's samples given those before; of the first, but for its part in what is flat.
    """

    mean: FloatArray
    covariance: FloatArray
    cross: FloatArray
    predicted: FloatArray
    ahead: FloatArray
    inverse: FloatArray
    log_density: float


def filtered(states: StateSpace, blocks: Blocks, block: BlockLaw) -> Iterator[Step]:
    """Yield what is known after each block, the first sample of which is seen; white noise has variance 1."""
    d, p = states.size, len(states.flat)
    # Of each block: what its kind tells, and its samples weighed for its start and for its end.
    told: dict[int, Told] = {}
    weighed, gained = np.empty((blocks.count, d + 2)), np.empty((blocks.count, d))
    for members, seen in blocks.alike():
        one = Told.of(block, seen)
        own = blocks.samples[members][:, seen]
        weighed[members], gained[members] = own @ one.weights.T, own @ one.gain.T
        told.update(dict.fromkeys(members.tolist(), one))
    inverse, mean = np.zeros((d + p, d + p)), np.zeros(d + p)
    proper = np.isfinite(states.start)
    inverse[:d, :d] = np.diag(np.where(proper, 1 / states.start, 0.0))
    log_prior = -float(np.log(states.start[proper]).sum())
    # A first block of one sample says nothing of a slope, and what has no bound has no inverse.
    inverse[d:, d:] = np.eye(p) / (_FLAT * max(1.0, float(np.abs(blocks.samples).max()))) ** 2
    for place in range(blocks.count):
        one, step = told[place], states.extension(place / blocks.count)
        covariance = inverse_of(inverse + step.T @ one.information @ step)
        before, mean = mean, covariance @ (inverse @ mean + step.T @ weighed[place])
        # Of the squares the least at the mean, so that its rounding does not matter.
        rest = (blocks.samples[place] - block.trace @ (step @ mean))[blocks.seen[place]]
        misfit = rest @ one.inverse @ rest + (mean - before) @ inverse @ (mean - before)
        log_det = one.log_det - log_prior - float(np.linalg.slogdet(covariance)[1])
        forward = np.concatenate([one.passed @ step, np.eye(d + p)[d:]])
        cross = forward @ covariance
        ahead = cross @ forward.T
        ahead[:d, :d] += one.rest
        inverse = inverse_of(ahead)
        log_prior = float(np.linalg.slogdet(inverse)[1])
        predicted = forward @ mean
        predicted[:d] += gained[place]
        yield Step(
            mean=mean,
            covariance=covariance,
            cross=cross,
            predicted=predicted,
            ahead=ahead,
            inverse=inverse,
            log_density=-0.5 * (log_det + float(misfit)),
        )
        mean = predicted


def inverse_of(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a covariance, its rows scaled first."""
    scale = 1 / np.sqrt(np.diagonal(matrix))
    inverse = np.linalg.inv(matrix * np.outer(scale, scale)) * np.outer(scale, scale)
    return np.asarray((inverse + inverse.T) / 2)


def log_likelihood(
    model: NoiseModel, samples: FloatArray, seen: BoolArray, rate_hz: float
) -> tuple[float, float]:
    """Return the exact log-likelihood at the best slope of a ramp, where the model has one, and that slope.

    Of samples without their mean, shape (n,), those that were `seen` count. Flicker is a bank of
    Gauss-Markov terms (its density within 3 %).
    """
    states = StateSpace.of(model, rate_hz=rate_hz, n=samples.size)
    blocks = Blocks.of(samples / math.sqrt(states.white), seen)
    unit = states.in_unit_of_white()
    steps = list(filtered(unit, blocks, BlockLaw.of(unit, blocks.length, 1 / blocks.count)))
    contrasts, last = np.count_nonzero(seen) - 1, steps[-1]
    value = sum(step.log_density for step in steps) - contrasts / 2 * math.log(2 * math.pi * states.white)
    if "R" not in states.flat:
        return value, 0.0
    # With the slope at its best, not integrated out.
    value -= 0.5 * math.log(last.ahead[-1, -1])
    length_s = blocks.samples.size / rate_hz
    return value, float(last.predicted[-1]) * math.sqrt(states.white) / length_s


def fit_exact(series: AxisSeries, start: NoiseModel) -> tuple[NoiseModel, float]:
    """Return the model of greatest exact likelihood near `start`, and that log-likelihood.

    A witness for faster fits: each step costs one likelihood a parameter. A rate ramp is estimated with the
    rest; a term whose variance goes to zero stops at 1e-6 of its start.
    """
    samples, seen = on_grid(series.finite(), "a likelihood")
    samples = np.where(seen, samples - samples[seen].mean(), 0.0)

    def at(steps: FloatArray) -> NoiseModel:
        factors = iter(np.exp(np.clip(steps, math.log(1e-6), math.log(1e6))).tolist())
        return NoiseModel(
            terms=tuple(
                term if term.symbol == "R" else term.of(*(value * next(factors) for value in term.values))
                for term in start.terms
            )
        )

    def cost(steps: FloatArray) -> float:
        return -log_likelihood(at(steps), samples, seen, series.rate_hz)[0]

    free = sum(len(term.values) for term in start.terms if term.symbol != "R")
    found = scipy.optimize.minimize(cost, np.zeros(free), method="BFGS", options={"gtol": 1e-3})
    best = at(found.x)
    value, ramp = log_likelihood(best, samples, seen, series.rate_hz)
    terms = (RateRamp(value=ramp) if term.symbol == "R" else term for term in best.terms)
    return NoiseModel(terms=tuple(terms)), value


def on_grid(series: AxisSeries, purpose: str) -> tuple[FloatArray, BoolArray]:
    """Return finite samples on the clock's even grid, 0 where there are none, and where there are any.

    Fewer than 2 are too few for the `purpose`, which is a DataError.
    """
    if series.n < 2:
        raise DataError(f"{series.name}: {purpose} needs at least 2 samples, got {series.n}")
    samples = np.zeros(series.clock.grid_size)
    seen = np.zeros(samples.size, dtype=bool)
    place = series.clock.grid()
    samples[place], seen[place] = series.samples, True
    return samples, seen
