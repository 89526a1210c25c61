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
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.noise.bank import gauss_markov_bank
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm, PowerLawTerm
from imucal.noise.terms import BiasInstability, GaussMarkov, RateRamp, RateRandomWalk
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
