"""The exact Gaussian likelihood of samples, in O(n), with samples missing anywhere.

Every term is a state that moves from sample to sample: Gauss-Markov and random walk are scalars,
quantization is the pair of its neighbouring errors, flicker a bank of Gauss-Markov terms. Given
the samples, the states have a banded precision matrix, whose Cholesky factor gives the likelihood
as a Kalman filter does, in the same number of operations but in compiled code; a missing sample
is one that adds nothing. Blocks of samples pass on what they say about the next block's first
state, so that memory does not grow with the record.

The level is unknown with a flat prior, whether a walk starts there or not: the likelihood is that
of all contrasts between samples, as in `imucal.fitting.spectral.likelihood`.

`fit_exact` is what ``verify`` compares a fit with; the tests hold the faster likelihood against it.

Source: Rue & Held (2005), "Gaussian Markov random fields", sec. 2.3-2.4; the result equals the
diffuse Kalman filter's, de Jong (1991), Ann. Statist. 19, 1073.

The states that a noise model's samples are the sum of, under the names of its terms.

A block of samples given the states at its ends: covariances in closed form, and what follows.

Which samples a block misses decides all of it, so that one set of matrices serves all blocks that are
whole.

Smoothing: what the states of a noise model did, given all samples, in O(n).

The states are those of `imucal.fitting.state_space`; a level and a slope without noise stand beside
them. All is Gaussian, so that the answer is the conditional mean and its standard error, of which
the textbook's Kalman filter and smoother are one way to a result. Here the record is cut into
blocks of samples. Given the states at its start and at its end, a block is independent of the
others, and within it every covariance is known in closed form. So

1. each block says what its samples tell about the states at its ends,
2. a filter and a smoother run from block to block, and
3. each block's inside is a linear map of its samples and its ends.

The maps of 1 and 3 depend on which samples are missing only: one set of small matrices serves all
blocks that are whole, and what is left per sample are a few matrix products. Nothing is
approximated: the result is that of one dense conditioning of the whole record.

Source: Rauch, Tung & Striebel (1965), AIAA J. 3, 1445 (the smoother); Anderson & Moore (1979),
"Optimal filtering", sec. 7.3. It is the E-step of Shumway & Stoffer (1982), J. Time Ser. Anal. 3, 253.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.errors import DataError
from imucal.noise.bank import gauss_markov_bank
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm, PowerLawTerm
from imucal.noise.terms import BiasInstability, GaussMarkov, RateRamp, RateRandomWalk, term_keys
from imucal.recording import AxisSeries

#: Columns of the banded matrix in a block.
_BLOCK = 1 << 18
#: Correlation times a decade in a bank for flicker: its density ripples by 0.65 %.
_BANK_PER_DECADE = 1.5
#: A walk that adds less than this of the white noise's density, even at the lowest frequency, is
#: left out: beside it the precision of white noise would be rounded away.
_UNSEEN_WALK = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StateSpace:
    """Independent scalar states and white noise: ``y_t = sum of states + u_{t+1} - u_t + w_t``.

    Attributes
    ----------
    decay, drive
        phi and the variance of the driving noise per sample of each state, shape (d,). A state u,
        where there is one, stands first, with decay 0.
    start
        Variance of each state at the first sample, shape (d,); infinite for a walk.
    quantized
        Whether the first state is u.
    white
        Variance of w.
    """

    decay: FloatArray
    drive: FloatArray
    start: FloatArray
    quantized: bool
    white: float

    @property
    def level_is_state(self) -> bool:
        """Whether a walk takes up the unknown level."""
        return bool(np.any(np.isinf(self.start)))


def log_likelihood(model: NoiseModel, series: AxisSeries) -> float:
    """Return the exact log-likelihood of the samples under `model`.

    Missing and non-finite samples are skipped. A rate ramp is taken out with its value; flicker is
    a bank of Gauss-Markov terms (its density within 3 %).

    Raises
    ------
    DataError
        If fewer than 2 samples are finite.
    """
    samples, seen = _on_grid(series)
    system = state_space(model, rate_hz=series.rate_hz, n=samples.size)
    ramp = sum(term.coefficient for term in model.terms if term.symbol == "R")
    times = np.arange(samples.size) * series.tau0
    value, _ = profile(system, np.where(seen, samples - ramp * times, 0.0), seen)
    return value


def fit_exact(series: AxisSeries, structure: tuple[str, ...], start: NoiseModel) -> tuple[NoiseModel, float]:
    """Return the model of greatest exact likelihood near `start`, and that log-likelihood.

    A witness for faster fits: each step costs one likelihood a parameter. A rate ramp is
    estimated with the rest; a term whose variance goes to zero stops at 1e-6 of its start.

    Raises
    ------
    ValueError
        If `start` does not have the terms of `structure`.
    """
    from scipy.optimize import minimize

    if tuple(term.symbol for term in start.terms) != structure:
        msg = f"start must have the terms {structure}, got {start}"
        raise ValueError(msg)
    samples, seen = _on_grid(series)
    moved = [i for i, term in enumerate(start.terms) if term.symbol != "R"]
    times = (np.arange(samples.size) * series.tau0)[:, np.newaxis]
    ramps = times - times.mean() if "R" in structure else None

    def at(steps: FloatArray) -> NoiseModel:
        values = iter(np.exp(np.clip(steps, math.log(1e-6), math.log(1e6))).tolist())
        terms = list(start.terms)
        for place in moved:
            term = terms[place]
            if isinstance(term, GaussMarkov):
                terms[place] = replace(term, sigma=term.sigma * next(values), T=term.T * next(values))
            elif isinstance(term, PowerLawTerm):
                terms[place] = replace(term, value=term.value * next(values))
        return NoiseModel(terms=tuple(terms))

    def evaluate(steps: FloatArray) -> tuple[float, FloatArray]:
        system = state_space(at(steps), rate_hz=series.rate_hz, n=samples.size)
        return profile(system, samples, seen, ramps)

    size = len(moved) + structure.count("GM")

    def cost(steps: FloatArray) -> float:
        return -evaluate(steps)[0]

    begin = np.zeros(size, dtype=np.float64)
    found = minimize(cost, begin, method="BFGS", options={"gtol": 1e-3})
    value, ramp = evaluate(found.x)
    terms = list(at(found.x).terms)
    if ramp.size:
        terms[structure.index("R")] = RateRamp(value=float(ramp[0]))
    return NoiseModel(terms=tuple(terms)), value


def state_space(model: NoiseModel, *, rate_hz: float, n: int) -> StateSpace:
    """Return the states of a model's random terms for `n` samples.

    Raises
    ------
    ValueError
        If a term has no states.
    """
    tau0 = 1 / rate_hz
    variances = {t.symbol: t.variance(tau0) for t in model.terms if isinstance(t, PowerLawTerm)}
    white, quantization = variances.get("N", 0.0), variances.get("Q", 0.0)
    states = [(0.0, quantization, quantization)] if quantization else []
    for term in model.terms:
        if term.symbol == "K" and variances["K"] * n**2 < _UNSEEN_WALK * white:
            continue
        states += term_states(term, tau0, n)
    decay, drive, start = np.array(states).reshape(-1, 3).T.copy()
    if not white:
        white = unseen_white(model, rate_hz, n, float(drive.max(initial=0.0)) or 1.0)
    return StateSpace(decay=decay, drive=drive, start=start, quantized=bool(quantization), white=white)


def term_states(term: NoiseTerm, tau0: float, n: int) -> list[tuple[float, float, float]]:
    """Return decay, drive and start of each state of a walk, flicker or a Gauss-Markov term.

    None of white noise, quantization and a ramp. As in `StateSpace`; flicker is a bank for `n` samples.

    Raises
    ------
    ValueError
        If the term has no states.
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
        markov = gauss_markov_bank(term.value, tau0 / 2, 3 * n * tau0, _BANK_PER_DECADE)
    return [(t.phi(tau0), t.q(tau0) ** 2, t.sigma**2) for t in markov]


def profile(
    system: StateSpace, samples: FloatArray, seen: np.ndarray, regressors: FloatArray | None = None
) -> tuple[float, FloatArray]:
    """Return the log-likelihood at the best coefficients of `regressors`, and those.

    Parameters
    ----------
    system
        The states.
    samples
        Shape (n,); any value where `seen`, shape (n,), is false.
    regressors
        Shape (n, r): known shapes of unknown size.
    """
    columns = [samples[:, np.newaxis]]
    if regressors is not None:
        columns.append(regressors)
    if not system.level_is_state:
        columns.append(np.ones((samples.size, 1)))
    stacked = np.hstack(columns) * seen[:, np.newaxis]
    log_det, gram = _eliminate(system, stacked, seen)
    count = int(seen.sum())
    fixed = gram[1:, 1:]
    size: FloatArray = np.zeros(0)
    square = float(gram[0, 0])
    if fixed.size:
        size = np.asarray(np.linalg.solve(fixed, gram[1:, 0]), dtype=np.float64)
        square -= float(gram[0, 1:] @ size)
    if not system.level_is_state:
        log_det += math.log(fixed[-1, -1])
    value = -0.5 * ((count - 1) * math.log(2 * math.pi) + log_det + square)
    return value, size[: 0 if regressors is None else regressors.shape[1]]


def unseen_white(model: NoiseModel, rate_hz: float, n: int, largest: float) -> float:
    """Return a variance of white noise that can't be told from none.

    The precision of the states needs some; a 1e-7 of the least density changes the likelihood of a
    sample by as little, and 1e-10 of the largest variance is what double precision can carry.
    """
    frequencies = np.geomspace(rate_hz / (2 * n), rate_hz / 2, 256)
    least = float(model.psd(frequencies, rate_hz=rate_hz).min()) * rate_hz
    return max(1e-7 * least, 1e-10 * largest)


def _on_grid(series: AxisSeries) -> tuple[FloatArray, np.ndarray]:
    """Return the samples less their mean on the clock's even grid, and where there are any."""
    series = series.finite()
    if series.n < 2:
        msg = f"{series.name}: a likelihood needs at least 2 samples, got {series.n}"
        raise DataError(msg)
    samples = np.zeros(series.clock.grid_size)
    seen = np.zeros(samples.size, dtype=bool)
    place = series.clock.grid()
    samples[place] = series.samples - series.samples.mean()
    seen[place] = True
    return samples, seen


def _eliminate(system: StateSpace, columns: FloatArray, seen: np.ndarray) -> tuple[float, FloatArray]:
    """Return log |Sigma| (its diffuse part left out) and columns' Sigma^-1 columns, shape (r, r)."""
    from scipy.linalg.lapack import dpbtrf, dtbtrs

    n, d = columns.shape[0], system.decay.size
    white = system.white
    gram = columns.T @ columns / white
    count = float(seen.sum())
    if d == 0:
        return count * math.log(white), gram
    proper = np.isfinite(system.start)
    log_det = count * math.log(white) + float(np.log(system.start[proper]).sum())
    log_det += n * float(np.log(system.drive).sum())
    precision = np.zeros((d, d))
    precision[proper, proper] = 1 / system.start[proper]
    right = np.zeros((d, columns.shape[1]))
    block = max(_BLOCK // d, 2)
    for first in range(0, n, block):
        last = min(first + block, n)
        band = _band(system, seen[first:last])
        for offset in range(d):
            band[offset, : d - offset] += np.diagonal(precision, -offset)
        message = _message(system, columns[first:last])
        message[:d] += right
        factor, info = dpbtrf(band, lower=1, overwrite_ab=1)
        if info:
            msg = f"the precision of the states is not positive: block at sample {first}, pivot {info}"
            raise ArithmeticError(msg)
        solved, _ = dtbtrs(factor, message, uplo="L", overwrite_b=1)
        log_det += 2 * float(np.log(factor[0, :-d]).sum())
        gram -= solved[:-d].T @ solved[:-d]
        corner = np.zeros((d, d))
        for offset in range(d):
            corner += np.diag(factor[offset, factor.shape[1] - d : factor.shape[1] - offset], -offset)
        precision, right = corner @ corner.T, corner @ solved[-d:]
    # What is left is the state one sample after the last.
    log_det += float(np.linalg.slogdet(precision)[1])
    gram -= right.T @ np.linalg.solve(precision, right)
    return log_det, gram


def _band(system: StateSpace, seen: np.ndarray) -> FloatArray:
    """Return the lower band of the precision of the states of a block and of the sample after it."""
    size, d = seen.size, system.decay.size
    band = np.zeros((d + 1, size + 1, d))
    band[0, :-1] += system.decay**2 / system.drive
    band[0, 1:] += 1 / system.drive
    band[d, :-1] -= system.decay / system.drive
    weight = seen / system.white
    signs = np.ones(d)
    if system.quantized:
        signs[0] = -1.0
        band[0, 1:, 0] += weight
        for i in range(d):
            band[d - i, :-1, i] += weight * signs[i]
    for offset in range(d):
        for i in range(d - offset):
            band[offset, :-1, i] += weight * (signs[i] * signs[i + offset])
    return np.asfortranarray(band.reshape(d + 1, (size + 1) * d))


def _message(system: StateSpace, columns: FloatArray) -> FloatArray:
    """Return what the samples of a block say about its states, shape (d (size + 1), r)."""
    size, count = columns.shape
    d = system.decay.size
    message = np.zeros((size + 1, d, count))
    message[:-1] = columns[:, np.newaxis, :] / system.white
    if system.quantized:
        message[:-1, 0] *= -1.0
        message[1:, 0] += columns / system.white
    return np.asfortranarray(message.reshape((size + 1) * d, count))


#: The component that is the sum of all.
BIAS = "bias"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LatentStates:
    """The states of a model, which samples are the sum of, with white noise beside them.

    Attributes
    ----------
    decay, drive, start
        As of `imucal.fitting.state_space.StateSpace`, shape (d,).
    groups
        Key of the component -> which states it sums, shape (d,); a quantization error, where there
        is one, stands first and belongs to none.
    quantized
        Whether the first state u is a quantization error: samples hold u[t+1] - u[t].
    flat
        Names of what has no noise and a flat prior: ``level`` and ``R``, the slope.
    white
        Variance of the white noise.
    """

    decay: FloatArray
    drive: FloatArray
    start: FloatArray
    groups: dict[str, BoolArray]
    quantized: bool
    flat: tuple[str, ...]
    white: float

    @classmethod
    def of(cls, model: NoiseModel, *, rate_hz: float, n: int) -> "LatentStates":
        """Return the states of a model's terms for `n` samples.

        A walk holds the level; without one the level stands for itself.

        Raises
        ------
        ValueError
            If a term has no states.
        """
        tau0 = 1 / rate_hz
        states: list[tuple[float, float, float]] = []
        owners: list[str] = []
        variances = {t.symbol: t.variance(tau0) for t in model.terms if isinstance(t, PowerLawTerm)}
        if variances.get("Q"):
            states, owners = [(0.0, variances["Q"], variances["Q"])], [""]
        for term, key in zip(model.terms, term_keys(t.symbol for t in model.terms), strict=True):
            own = term_states(term, tau0, n)
            states += own
            owners += [key] * len(own)
        decay, drive, start = np.array(states).reshape(-1, 3).T.copy()
        flat: tuple[str, ...] = () if np.isinf(start).any() else ("level",)
        if any(term.symbol == "R" for term in model.terms):
            flat += ("R",)
        white = variances.get("N") or unseen_white(model, rate_hz, n, float(drive.max(initial=0.0)) or 1.0)
        names = [key for key in dict.fromkeys(owners) if key]
        return cls(
            decay=decay,
            drive=drive,
            start=start,
            groups={name: np.array([owner == name for owner in owners]) for name in names},
            quantized=bool(variances.get("Q")),
            flat=flat,
            white=white,
        )

    @property
    def size(self) -> int:
        """Number of states that move."""
        return self.decay.size

    @property
    def everything(self) -> BoolArray:
        """Which states are of a component, shape (d,)."""
        every = np.zeros(self.size, dtype=bool)
        for group in self.groups.values():
            every |= group
        return every

    def in_unit_of_white(self) -> "LatentStates":
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PartLaw:
    """What a component's covariances are, given the states at a block's start of B samples.

    Attributes
    ----------
    variance
        Of the component at each sample, shape (B,).
    with_samples, with_end
        Covariance with each sample, shape (B, B), and with each state at the block's end, (B, d).
    trace
        What the extended start adds to it, shape (B, d + 2).
    """

    variance: FloatArray
    with_samples: FloatArray
    with_end: FloatArray
    trace: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BlockLaw:
    """The covariances of a block of B samples, given the states at its start, in closed form.

    The states at the start, and level and slope in the block, are the extended start, shape (d + 2,).

    Attributes
    ----------
    samples
        Covariance of the samples, shape (B, B).
    trace
        What the extended start adds to the samples, shape (B, d + 2).
    end, passed
        Variance of the states at the end, shape (d,), and what the extended start adds to them,
        shape (d, d + 2).
    with_end
        Covariance of the samples with the states at the end, shape (B, d).
    parts
        Of each component.
    """

    samples: FloatArray
    trace: FloatArray
    end: FloatArray
    passed: FloatArray
    with_end: FloatArray
    parts: dict[str, PartLaw]

    @classmethod
    def of(cls, states: LatentStates, length: int, share: float) -> "BlockLaw":
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
        # Of each state with itself; then of samples with states, and of samples with samples.
        own = left[:, lag] * variance[:, least]
        sampled, trace = own[:, :B].copy(), left[:, :B].copy()
        if states.quantized:
            sampled[0], trace[0] = np.diff(own[0], axis=0), np.diff(left[0])
        between = sampled[:, :, :B].copy()
        if states.quantized:
            between[0] = np.diff(sampled[0], axis=1)
        local = np.stack([np.ones(B), t[:B] / B * share])
        passed = np.zeros((d, d + 2))
        passed[:, :d] = np.diag(left[:, B])
        parts = {}
        for key, group in (*states.groups.items(), (BIAS, states.everything)):
            part = np.zeros((B, d + 2))
            part[:, :d] = np.where(group, left[:, :B].T, 0.0)
            if key == BIAS:
                part[:, d:] = local.T
            parts[key] = PartLaw(
                variance=variance[group, :B].sum(axis=0),
                with_samples=sampled[group][:, :, :B].sum(axis=0).T,
                with_end=np.where(group, own[:, :B, B].T, 0.0),
                trace=part,
            )
        return cls(
            samples=between.sum(axis=0) + np.eye(B),
            trace=np.concatenate([trace, local]).T,
            end=variance[:, B],
            passed=passed,
            with_end=sampled[:, :, B].T,
            parts=parts,
        )


def inverse_of(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a covariance, its rows scaled first."""
    scale = 1 / np.sqrt(np.diagonal(matrix))
    inverse = np.linalg.inv(matrix * np.outer(scale, scale)) * np.outer(scale, scale)
    return np.asarray((inverse + inverse.T) / 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Told:
    """What blocks that miss the same samples tell: of their start, and of their end given the start.

    Attributes
    ----------
    information, weights
        Information about the extended start, shape (d+2, d+2), and what it takes of the samples,
        shape (d+2, seen).
    passed, gain, rest
        End = passed @ extended start + gain @ samples + noise of covariance rest.
    inverse
        Of the samples' covariance given the start, shape (seen, seen).
    """

    information: FloatArray
    weights: FloatArray
    passed: FloatArray
    gain: FloatArray
    rest: FloatArray
    inverse: FloatArray

    @classmethod
    def of(cls, block: BlockLaw, seen: BoolArray) -> "Told":
        inverse: FloatArray = np.asarray(np.linalg.inv(block.samples[np.ix_(seen, seen)]), dtype=np.float64)
        trace, with_end = block.trace[seen], block.with_end[seen]
        weights, gain = trace.T @ inverse, with_end.T @ inverse
        rest = np.diag(block.end) - gain @ with_end
        return cls(
            information=weights @ trace,
            weights=weights,
            passed=block.passed - gain @ trace,
            inverse=inverse,
            gain=gain,
            rest=(rest + rest.T) / 2,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inside:
    """The inside of blocks that miss the same samples, given their ends.

    For each component: mean = of_samples @ samples + of_ends @ (extended start, end), and the
    variance that is left when all of these are known.
    """

    states: LatentStates
    seen: BoolArray
    of_samples: dict[str, FloatArray]
    of_ends: dict[str, FloatArray]
    left: dict[str, FloatArray]

    @classmethod
    def of(cls, states: LatentStates, block: BlockLaw, seen: BoolArray) -> "Inside":
        told = Told.of(block, seen)
        inverse_rest = inverse_of(told.rest)
        of_samples, of_ends, left = {}, {}, {}
        for key, part in block.parts.items():
            cross = part.with_samples[:, seen]
            alone = cross @ told.inverse
            to_end = (part.with_end - alone @ block.with_end[seen]) @ inverse_rest
            to_samples = alone - to_end @ told.gain
            start = part.trace - to_samples @ block.trace[seen] - to_end @ block.passed
            of_samples[key], of_ends[key] = to_samples, np.concatenate([start, to_end], axis=1)
            known = np.sum(to_samples * cross, axis=1) + np.sum(to_end * part.with_end, axis=1)
            left[key] = part.variance - known
        return cls(states=states, seen=seen, of_samples=of_samples, of_ends=of_ends, left=left)


#: Samples in a block; in one of a record of which many blocks have holes of their own.
_WHOLE, _HOLED = 256, 64
#: Share of blocks with holes of their own above which blocks are short.
_MANY = 0.1
#: Standard deviation of a flat prior, beside the largest sample.
_FLAT = 1e5
#: Blocks whose insides are computed at once; so few that each is computed by itself.
_AT_ONCE, _FEW = 512, 4

#: Called with the number of samples done and of all.
Progress: TypeAlias = Callable[[int, int], None]
#: Of a block: information about its extended start, what passes to its end, and the rest there.
_Summary: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Smoothed:
    """Conditional means and standard errors, shapes (n,), by the components' keys; ``bias`` is their sum."""

    mean: dict[str, FloatArray]
    error: dict[str, FloatArray]


def smooth(
    states: LatentStates, samples: FloatArray, seen: BoolArray, *, progress: Progress | None = None
) -> Smoothed:
    """Return the components given the samples.

    Parameters
    ----------
    states
        What the samples are made of.
    samples
        Shape (n,); any value where `seen`, shape (n,), is false. The first is seen.
    progress
        Called after some blocks.

    Returns
    -------
    Smoothed
        ``level`` and ``R`` (the slope times the time since the first sample) among the components,
        where they are.
    """
    n, scale = samples.size, float(np.sqrt(states.white))
    blocks = _cut(samples / scale, seen)
    unit = states.in_unit_of_white()
    block = BlockLaw.of(unit, blocks.length, 1 / blocks.count)
    ends = _Ends.of(unit, blocks, block)
    mean = {key: np.empty(blocks.samples.shape) for key in _keys(states)}
    error = {key: np.empty(blocks.samples.shape) for key in _keys(states)}
    done = 0
    for members, holes in blocks.alike():
        inside = Inside.of(unit, block, holes)
        for part in np.array_split(members, -(-members.size // _AT_ONCE)):
            for key, value, variance in _components(inside, blocks, ends, part):
                mean[key][part] = scale * value
                error[key][part] = scale * np.sqrt(np.maximum(variance, 0.0))
            done += part.size
            if progress:
                progress(min(done * blocks.length, n), n)
    return Smoothed(
        mean={key: value.reshape(-1)[:n] for key, value in mean.items()},
        error={key: value.reshape(-1)[:n] for key, value in error.items()},
    )


def _keys(states: LatentStates) -> tuple[str, ...]:
    level, slope = (tuple(name for name in states.flat if name == key) for key in ("level", "R"))
    return (*level, *states.groups, *slope, BIAS)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Blocks:
    """The record cut into blocks, shape (b, length), the last filled up with missing samples."""

    samples: FloatArray
    seen: BoolArray

    @property
    def count(self) -> int:
        return int(self.samples.shape[0])

    @property
    def length(self) -> int:
        return int(self.samples.shape[1])

    def alike(self) -> Iterator[tuple[IntArray, BoolArray]]:
        """Yield the blocks that miss the same samples: their places, and which are seen, shape (length,)."""
        places: dict[bytes, list[int]] = {}
        for place, packed in enumerate(np.packbits(self.seen, axis=1)):
            places.setdefault(packed.tobytes(), []).append(place)
        for members in places.values():
            yield np.array(members), self.seen[members[0]]


def _cut(samples: FloatArray, seen: BoolArray) -> _Blocks:
    """Cut a record into blocks; short ones where many have holes of their own."""
    count = -(-samples.size // _WHOLE)
    padded = np.zeros(count * _WHOLE, dtype=bool)
    padded[: seen.size] = seen
    whole = padded.reshape(count, _WHOLE)
    kinds = len({packed.tobytes() for packed in np.packbits(whole, axis=1)})
    length = _HOLED if kinds > max(_MANY * count, 3) else _WHOLE
    count = -(-samples.size // length)
    filled = np.zeros((2, count * length))
    filled[0, : samples.size] = np.where(seen, samples, 0.0)
    filled[1, : samples.size] = seen
    shape = (count, length)
    return _Blocks(samples=filled[0].reshape(shape), seen=filled[1].reshape(shape) > 0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ends:
    """Smoothed states at the blocks' starts and ends, level and slope at the end of each.

    Attributes
    ----------
    mean
        Shape (b, 2d + p): states at the start, states at the end, level and slope.
    covariance
        Shape (b, 2d + p, 2d + p).
    """

    mean: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, states: LatentStates, blocks: _Blocks, block: BlockLaw) -> "_Ends":
        """Filter forwards and smooth backwards over the blocks."""
        d, p = states.size, len(states.flat)
        told, weighed, gained = _gather(blocks, block)
        steps = [states.extension(i / blocks.count) for i in range(blocks.count)]
        inverse, mean = np.zeros((d + p, d + p)), np.zeros(d + p)
        inverse[:d, :d] = np.diag(np.where(np.isinf(states.start), 0.0, 1 / states.start))
        # A first block of one sample says nothing of a slope, and what has no bound has no inverse.
        inverse[d:, d:] = np.eye(p) / (_FLAT * max(1.0, float(np.abs(blocks.samples).max()))) ** 2
        held = []
        for (information, passed, rest), step, weight, gain in zip(told, steps, weighed, gained, strict=True):
            covariance = inverse_of(inverse + step.T @ information @ step)
            mean = covariance @ (inverse @ mean + step.T @ weight)
            forward = np.concatenate([passed @ step, np.eye(d + p)[d:]])
            ahead = forward @ covariance @ forward.T
            ahead[:d, :d] += rest
            inverse = inverse_of(ahead)
            predicted = forward @ mean
            predicted[:d] += gain
            held.append((mean, covariance, forward @ covariance, ahead, inverse, predicted))
            mean = predicted
        return cls._backwards(held, d, p)

    @classmethod
    def _backwards(cls, held: Sequence[tuple[FloatArray, ...]], d: int, p: int) -> "_Ends":
        """Smooth: each block's start given its end, whose mean and covariance are known from the last on."""
        last = held[-1]
        end_mean, end_covariance = last[5], last[3]
        means = np.empty((len(held), 2 * d + p))
        covariances = np.empty((len(held), 2 * d + p, 2 * d + p))
        for block in range(len(held) - 1, -1, -1):
            mean, covariance, cross, ahead, inverse, predicted = held[block]
            gain = cross.T @ inverse
            start_mean = mean + gain @ (end_mean - predicted)
            start_covariance = covariance + gain @ (end_covariance - ahead) @ gain.T
            joint = gain @ end_covariance
            # Level and slope are the same at both ends, to the last digit.
            start_mean[d:], start_covariance[d:, d:] = end_mean[d:], end_covariance[d:, d:]
            start_covariance[:d, d:], start_covariance[d:, :d] = joint[:d, d:], joint[:d, d:].T
            means[block] = np.concatenate([start_mean[:d], end_mean])
            covariances[block, :d, :d] = start_covariance[:d, :d]
            covariances[block, :d, d:] = joint[:d]
            covariances[block, d:, :d] = joint[:d].T
            covariances[block, d:, d:] = end_covariance
            end_mean, end_covariance = start_mean, start_covariance
        return cls(mean=means, covariance=covariances)


def _gather(blocks: _Blocks, block: BlockLaw) -> tuple[list[_Summary], FloatArray, FloatArray]:
    """Return what each block tells, and its samples weighed for its start and for its end."""
    told: list[_Summary] = [(block.passed, block.passed, block.passed)] * blocks.count
    d = block.end.size
    weighed, gained = np.empty((blocks.count, d + 2)), np.empty((blocks.count, d))
    for members, seen in blocks.alike():
        one = Told.of(block, seen)
        own = blocks.samples[members][:, seen]
        weighed[members] = own @ one.weights.T
        gained[members] = own @ one.gain.T
        for place in members.tolist():
            told[place] = (one.information, one.passed, one.rest)
    return told, weighed, gained


def _components(
    inside: Inside, blocks: _Blocks, ends: _Ends, members: IntArray
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Yield each component's key, means and variances in some blocks, shapes (b, length)."""
    own = blocks.samples[members][:, inside.seen]
    extended, covariance = _extended(inside.states, blocks, ends, members)
    for key, of_ends in inside.of_ends.items():
        mean = own @ inside.of_samples[key].T + extended @ of_ends.T
        yield key, mean, _spread(covariance, of_ends) + inside.left[key]
    d, B = inside.states.size, blocks.length
    for i, name in enumerate(inside.states.flat):
        mean, variance = ends.mean[members, 2 * d + i], ends.covariance[members, 2 * d + i, 2 * d + i]
        time = np.ones((members.size, B))
        if name == "R":
            time = (members[:, np.newaxis] + np.arange(B) / B) / blocks.count
        yield name, mean[:, np.newaxis] * time, variance[:, np.newaxis] * time**2


def _spread(covariance: FloatArray, of_ends: FloatArray) -> FloatArray:
    """Return the variances, shape (b, length), of `of_ends`, shape (length, e), times the blocks' ends."""
    if covariance.shape[0] < _FEW:
        return np.asarray(np.sum(of_ends @ covariance * of_ends, axis=2))
    # One product for all blocks: of the pairs of columns with the covariances' upper halves.
    row, column = np.triu_indices(of_ends.shape[1])
    pairs = of_ends[:, row] * of_ends[:, column] * np.where(row == column, 1.0, 2.0)
    spread: FloatArray = covariance[:, row, column] @ pairs.T
    return spread


def _extended(
    states: LatentStates, blocks: _Blocks, ends: _Ends, members: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of the blocks' extended starts and ends, shape (b, 2d + 2)."""
    steps = np.array([_step(states, block / blocks.count) for block in members.tolist()])
    mean = np.einsum("bij,bj->bi", steps, ends.mean[members])
    return mean, steps @ ends.covariance[members] @ np.swapaxes(steps, 1, 2)


def _step(states: LatentStates, time: float) -> FloatArray:
    """Return the map from start, end, level and slope to extended start and end."""
    d, p = states.size, len(states.flat)
    step = np.zeros((2 * d + 2, 2 * d + p))
    extension = states.extension(time)
    step[: d + 2, :d], step[: d + 2, 2 * d :] = extension[:, :d], extension[:, d:]
    step[d + 2 :, d : 2 * d] = np.eye(d)
    return step
