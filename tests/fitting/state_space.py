"""State space of a noise model, its Kalman filter and the exact likelihood, in O(n).

Gauss-Markov and random walk are scalar states, quantization is the difference of neighbouring errors, and
flicker is a bank of Gauss-Markov terms. The level and the slope are constants with a flat prior. The filter
advances by blocks of samples: given the states at a block's start, all covariances in the block have a
closed form that depends only on which samples are missing. One set of small matrices serves all whole
blocks, without approximation.

The likelihood is that of all contrasts between samples, since the level is unknown, as in
`imucal.fitting.spectral.likelihood`. The tests compare fits with `fit_exact`, and decompositions with one
dense conditioning of the states.

Source: Anderson & Moore (1979), "Optimal filtering", sec. 6.3 and 7.3; the likelihood equals the
diffuse Kalman filter's, de Jong (1991), Ann. Statist. 19, 1073.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.errors import DataError
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm, PowerLawTerm
from imucal.noise.terms import BiasInstability, GaussMarkov, RateRamp, RateRandomWalk, term_keys
from imucal.recording import AxisSeries

#: Correlation times per decade in the bank for flicker: its density ripples by 0.65 %.
_BANK_PER_DECADE = 1.5
#: Samples in a block; samples in a block if the gaps of many blocks differ.
_WHOLE, _HOLED = 256, 64
#: Share of blocks with different gaps above which the short length is used.
_MANY = 0.1
#: Standard deviation of a flat prior, relative to the largest sample.
_FLAT = 1e5
#: Name of the sum of all components.
BIAS = "bias"


@dataclass(frozen=True, kw_only=True, eq=False)
class StateSpace:
    """The independent scalar states of a model; samples are their sum plus white noise.

    Each of d states has a `decay` phi, a `drive` (variance of its driving noise per sample), and a `start`
    (variance at the first sample, infinite for a walk); shape (d,) each. `groups` maps a component's key to a
    mask of its states, shape (d,). The first state u of a `quantized` model, with decay 0 and in no group, is
    a quantization error: samples contain u[t+1] - u[t]. `flat` names the constants with a flat prior,
    ``level`` and ``R``, the slope. `white` is the variance of the white noise.
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
        """Return the states of a model's terms for `n` samples; a term without states raises a ValueError.

        The level is part of a walk; without a walk it is a constant of its own.
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
        # A block's covariance needs some white noise: 1e-7 of the least density hardly changes the
        # likelihood, and 1e-10 of the largest variance is the limit of double precision.
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
        """Number of states, without level and slope."""
        return self.decay.size

    @property
    def everything(self) -> BoolArray:
        """Mask of the states that belong to any component, shape (d,)."""
        return np.asarray(np.any([np.zeros(self.size, dtype=bool), *self.groups.values()], axis=0))

    def in_unit_of_white(self) -> "StateSpace":
        """Return the states with white noise of variance 1."""
        return replace(self, drive=self.drive / self.white, start=self.start / self.white, white=1.0)

    def extension(self, time: float) -> FloatArray:
        """Return the map from states, level and slope to a block's extended start, shape (d + 2, d + p).

        The extended start contains the states, the level in the block, and the slope.
        """
        d = self.size
        extension = np.zeros((d + 2, d + len(self.flat)))
        extension[:d, :d] = np.eye(d)
        for i, name in enumerate(self.flat):
            extension[d:, d + i] = (1.0, 0.0) if name == "level" else (time, 1.0)
        return extension


def _term_states(term: NoiseTerm, tau0: float, n: int) -> list[tuple[float, float, float]]:
    """Return decay, drive and start of each state of a walk, flicker or a Gauss-Markov term.

    White noise, quantization and a ramp have none; flicker is a bank for `n` samples.
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


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockLaw:
    """The covariances of a block of B samples, given the states at its start, in closed form.

    The extended start, shape (d + 2,), contains the states at the start, and level and slope in the block.
    The samples are `trace`, shape (B, d + 2), times it plus noise of covariance `samples`, shape (B, B). The
    states at the end are `passed`, shape (d, d + 2), times it plus noise of variance `end`, shape (d,), whose
    covariance with the samples is `with_end`, shape (B, d). `own` is the autocovariance of each state, shape
    (d, B + 1, B + 1); `sampled` its covariance with its part of each sample, shape (d, B, B + 1).
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
        """Return the law of a block of `length` samples; `share` is its part of the record."""
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


@dataclass(frozen=True, kw_only=True, eq=False)
class GapMatrices:
    """Matrices of blocks with the same missing samples: information on the start, prediction of the end.

    `inverse`, shape (seen, seen), and `log_det` belong to the covariance of the seen samples given the start.
    `weights`, shape (d + 2, seen), and `information`, shape (d + 2, d + 2), estimate the extended start. The
    end is passed @ extended start + gain @ samples + noise of covariance rest.
    """

    inverse: FloatArray
    log_det: float
    weights: FloatArray
    information: FloatArray
    passed: FloatArray
    gain: FloatArray
    rest: FloatArray

    @classmethod
    def of(cls, block: BlockLaw, seen: BoolArray) -> "GapMatrices":
        """Return the matrices of blocks with the samples `seen`, shape (B,)."""
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Blocks:
    """A record cut into blocks, shape (b, length), the last padded with missing samples."""

    samples: FloatArray
    seen: BoolArray

    @classmethod
    def of(cls, samples: FloatArray, seen: BoolArray) -> "Blocks":
        """Cut a record of shape (n,) into blocks, short ones if the gaps of many differ."""
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
        """Number of samples of a block."""
        return int(self.samples.shape[1])

    def with_equal_gaps(self) -> Iterator[tuple[IntArray, BoolArray]]:
        """Yield groups of blocks with the same gaps: their indices and seen samples, shape (length,)."""
        places: dict[bytes, list[int]] = {}
        for place, packed in enumerate(np.packbits(self.seen, axis=1)):
            places.setdefault(packed.tobytes(), []).append(place)
        for members in places.values():
            yield np.array(members), self.seen[members[0]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """The estimate of states, level and slope from the samples up to a block's end.

    `mean` and `covariance`, shapes (d + p,) and (d + p, d + p), are at the block's start; `cross` is the
    covariance of end and start; `predicted`, `ahead` and `inverse` are mean, covariance and its inverse at
    the end. `log_density` is the block's log density given earlier samples, without the flat priors' part.
    """

    mean: FloatArray
    covariance: FloatArray
    cross: FloatArray
    predicted: FloatArray
    ahead: FloatArray
    inverse: FloatArray
    log_density: float


def filtered(states: StateSpace, blocks: Blocks, block: BlockLaw) -> Iterator[Step]:
    """Yield the step of each block; the first sample must be seen and white noise have variance 1."""
    d, p = states.size, len(states.flat)
    # Matrices of each block, and its samples weighed for its start and for its end.
    matrices: dict[int, GapMatrices] = {}
    weighed, gained = np.empty((blocks.count, d + 2)), np.empty((blocks.count, d))
    for members, seen in blocks.with_equal_gaps():
        one = GapMatrices.of(block, seen)
        own = blocks.samples[members][:, seen]
        weighed[members], gained[members] = own @ one.weights.T, own @ one.gain.T
        matrices.update(dict.fromkeys(members.tolist(), one))
    inverse, mean = np.zeros((d + p, d + p)), np.zeros(d + p)
    proper = np.isfinite(states.start)
    inverse[:d, :d] = np.diag(np.where(proper, 1 / states.start, 0.0))
    log_prior = -float(np.log(states.start[proper]).sum())
    # Keep the information invertible: a first block of one sample does not determine a slope.
    inverse[d:, d:] = np.eye(p) / (_FLAT * max(1.0, float(np.abs(blocks.samples).max()))) ** 2
    for place in range(blocks.count):
        one, step = matrices[place], states.extension(place / blocks.count)
        covariance = inverse_of(inverse + step.T @ one.information @ step)
        before, mean = mean, covariance @ (inverse @ mean + step.T @ weighed[place])
        # The squares are minimal at the mean, so its rounding does not matter.
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
    """Return the inverse of a covariance, scaled to unit variances first."""
    scale = 1 / np.sqrt(np.diagonal(matrix))
    inverse = np.linalg.inv(matrix * np.outer(scale, scale)) * np.outer(scale, scale)
    return np.asarray((inverse + inverse.T) / 2)


def log_likelihood(
    model: NoiseModel, samples: FloatArray, seen: BoolArray, rate_hz: float
) -> tuple[float, float]:
    """Return the exact log-likelihood at the best slope of the model's ramp, and the slope (0 without ramp).

    `samples`, shape (n,), have their mean subtracted; only `seen` ones count. Flicker is a bank of
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
    # The slope is maximised, not integrated out.
    value -= 0.5 * math.log(last.ahead[-1, -1])
    length_s = blocks.samples.size / rate_hz
    return value, float(last.predicted[-1]) * math.sqrt(states.white) / length_s


def fit_exact(series: AxisSeries, start: NoiseModel) -> tuple[NoiseModel, float]:
    """Return the model of greatest exact likelihood near `start`, and that log-likelihood.

    It checks faster fits: each step costs one likelihood per parameter. A rate ramp is estimated too; a
    parameter stops at 1e-6 of its start.
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


def distances(
    series: AxisSeries, model: NoiseModel, names: tuple[str, ...], covariance: FloatArray
) -> dict[str, float]:
    """Return how far each parameter is from the exact likelihood's maximum, in standard errors."""
    here, there = _values(model), _values(fit_exact(series, model)[0])
    deviation = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    return {
        name: abs(there[name] - here[name]) / deviation[name]
        for name in here
        if np.isfinite(deviation[name]) and deviation[name] > 0
    }


def _values(model: NoiseModel) -> dict[str, float]:
    """Return the model's parameters under the names that a fit's covariance uses."""
    keys = term_keys(term.symbol for term in model.terms)
    return {
        name: abs(value)
        for term, key in zip(model.terms, keys, strict=True)
        for name, value in zip(term.parameter_names(key), term.values, strict=True)
    }


def on_grid(series: AxisSeries, purpose: str) -> tuple[FloatArray, BoolArray]:
    """Return finite samples on the clock's even grid, 0 in gaps, and a mask of the places with samples.

    Fewer than 2 samples raise a DataError that names the `purpose`.
    """
    if series.n < 2:
        raise DataError(f"{series.name}: {purpose} needs at least 2 samples, got {series.n}")
    samples = np.zeros(series.clock.grid_size)
    seen = np.zeros(samples.size, dtype=bool)
    place = series.clock.grid()
    samples[place], seen[place] = series.samples, True
    return samples, seen
