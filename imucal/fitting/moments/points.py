"""The points of an Allan curve that a fit is made of, in units of one sample and one scale.

Everything a fit of a curve computes is relative to a typical Allan variance of it and to the
sampling period, so that the unit of the samples changes nothing but the unit of the result.

The covariance of Allan variances across averaging times, in closed form.

An Allan variance is a mean of squares of d_t, the second differences of the summed signal, so for
Gaussian noise every covariance of two of them is a sum of squared covariances of d_t. Those follow
from V(n), the generalised variance of a sum of n samples, of each process in the model:

    cov(d_t at m_i, d_{t+k} at m_j) = -1/(4 m_i m_j) sum_ab c_a c_b V(|k + b m_j - a m_i|),
    cov(avar_i, avar_j) = 2/(M_i M_j) sum_k n_ij(k) s_ij(k)^2,        c = (1, -2, 1).

The sum is quadratic in the variance parameters of the processes. Its coefficients are computed
once for a set of processes; the covariance of any model made of them is then a small contraction.

Source: Greenhall & Riley (2003), "Uncertainty of stability variances based on finite differences",
for one averaging time; the same argument holds for two.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.allan.intervals import excess_kurtosis, trapezoid_weights
from imucal.arrays import FloatArray, IntArray, read_only
from imucal.errors import DataError
from imucal.noise.term import NoiseTerm, PowerLawTerm
from imucal.noise.terms import TERMS, GaussMarkov, RateRamp
from imucal.powerlaw import PowerLaw
from imucal.recording import AxisSeries

#: A power law; or another term of unit deviation per sample, its time in samples.
Process: TypeAlias = PowerLaw | NoiseTerm

_LAWS = tuple(PowerLaw)
_SIGNS = np.array([1.0, -2.0, 1.0])
#: Up to so many lags are summed one by one.
_ALL_LAGS = 300
#: About each kink all lags so near are summed; beyond, four an octave.
_NEAR = np.arange(-6, 7)
_SPREAD = np.unique(np.round(6 * 2 ** (np.arange(0, 4 * 45) / 4)).astype(np.int64))
#: The covariance of flicker falls as the fourth power of the lag: it is summed to so many times m.
_FLICKER_REACH = 24
#: A covariance with a correlation time is summed to so many of these beyond the windows.
_TIMES_REACH = 20.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AvarCovariance:
    """The covariance of Allan variances, as a function of the processes' variance parameters.

    Attributes
    ----------
    quadratic
        Coefficients of v_p v_q, shape (p, p, k, k).
    drift
        Coefficients of v_p w^2 with w the ramp per sample, shape (p, k, k).
    """

    quadratic: FloatArray
    drift: FloatArray

    def __post_init__(self) -> None:
        for name in ("quadratic", "drift"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def at(self, variances: FloatArray, ramp_squared: float = 0.0) -> FloatArray:
        """Return the covariance, shape (k, k), at variance parameters of shape (p,)."""
        pairs = np.multiply.outer(variances, variances)
        covariance = np.tensordot(pairs, self.quadratic, axes=2)
        if ramp_squared:
            covariance = covariance + ramp_squared * np.tensordot(variances, self.drift, axes=1)
        return np.asarray((covariance + covariance.T) / 2)

    def within(self, first: int) -> "AvarCovariance":
        """Return the covariance of the Allan variances from index `first` on."""
        return AvarCovariance(
            quadratic=self.quadratic[..., first:, first:], drift=self.drift[..., first:, first:]
        )


def avar_covariance(
    m: IntArray, n: int, processes: Sequence[Process], *, overlapping: bool
) -> AvarCovariance:
    """Return the covariance of the Allan variances of `n` samples at averaging factors `m`.

    Parameters
    ----------
    m
        Averaging factors, shape (k,), each in 1 <= m <= n // 2.
    n
        Number of samples.
    processes
        The processes of the model, in the order of the variance parameters.
    overlapping
        Whether the Allan variances are the overlapping ones (MOAV) or those of adjacent windows.

    Raises
    ------
    ValueError
        If an averaging factor is out of range.

    Notes
    -----
    Lags are summed on a grid that is dense where the covariance has its kinks, so a pair of
    averaging times costs some thousand evaluations whatever the record; relative error below 1e-3.
    """
    if m.size and not (m.min() >= 1 and m.max() <= n // 2):
        msg = f"averaging factors must be in 1..{n // 2} for {n} samples"
        raise ValueError(msg)
    return _computed(tuple(m.tolist()), n, tuple(processes), overlapping=overlapping)


@lru_cache(maxsize=32)
def _computed(
    m: tuple[int, ...], n: int, processes: tuple[Process, ...], *, overlapping: bool
) -> AvarCovariance:
    """Return the covariance; the axes of a log ask for the same ones."""
    size = len(m)
    quadratic = np.empty((len(processes), len(processes), size, size))
    drift = np.empty((len(processes), size, size))
    for i in range(size):
        for j in range(i + 1):
            squares, linear = _pair(m[i], m[j], n, processes, overlapping=overlapping)
            quadratic[..., i, j] = quadratic[..., j, i] = squares
            drift[..., i, j] = drift[..., j, i] = linear
    return AvarCovariance(quadratic=quadratic, drift=drift)


def sum_variance(process: Process, n: FloatArray) -> FloatArray:
    """Return V(n), up to a multiple of n^2, of which covariances of second differences know nothing.

    For a Gauss-Markov process that multiple is left out: it would cost all digits where the
    correlation time is much longer than n. Of a term without a closed form `n` are whole numbers.
    """
    if isinstance(process, PowerLaw):
        return process.sum_variance(n)
    if not isinstance(process, GaussMarkov):
        return _every_sum_variance(process, 1 << int(n.max(initial=1)).bit_length())[n.astype(np.int64)]
    rate = 1 / process.T
    x = n * rate
    series = x**3 * (1 / 6 - x * (1 / 24 - x * (1 / 120 - x / 720)))
    rest = np.where(x < 0.02, series, -np.expm1(-x) - x + x**2 / 2)
    half = 2 * math.sinh(rate / 2) ** 2
    slow = rate < 0.01
    slope = rate / 3 - rate**3 / 90 if slow else 1 / math.tanh(rate / 2) - rate / half
    return np.asarray(n * slope - rest / half)


@lru_cache(maxsize=8)
def _every_sum_variance(process: NoiseTerm, size: int) -> FloatArray:
    return read_only(process.sum_variance(np.arange(size, dtype=np.float64), 1.0))


def _pair(
    mi: int, mj: int, n: int, processes: Sequence[Process], *, overlapping: bool
) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients for one pair of averaging times: shapes (p, p) and (p,)."""
    times = [time for p in processes if not isinstance(p, PowerLaw) for time in p.values[1:]]
    lags, weight, of_laws = _laws(mi, mj, n, _reach(max(mi, mj), times), overlapping=overlapping)
    covariance = np.empty((len(processes), lags.size))
    for row, process in zip(covariance, processes, strict=True):
        row[:] = (
            of_laws[_LAWS.index(process)]
            if isinstance(process, PowerLaw)
            else _lag_covariance(lags, mi, mj, process)
        )
    weighted = covariance * weight
    squares = 2 * weighted @ covariance.T
    # The ramp gives d_t at m the mean w m / sqrt(2); sums of covariances below zero are rounding.
    linear = 4 * (mi * mj / 2) * np.maximum(weighted.sum(axis=1), 0.0)
    return squares, linear


@lru_cache(maxsize=512)
def _laws(
    mi: int, mj: int, n: int, reach: int, *, overlapping: bool
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return lags, their weights n_ij(k) / (M_i M_j), and the covariances of the power laws there."""
    step = 1 if overlapping else math.gcd(mi, mj)
    stride_i, stride_j = (1, 1) if overlapping else (mi, mj)
    terms_i, terms_j = ((n - 2 * a + s) // s for a, s in ((mi, stride_i), (mj, stride_j)))
    length_i, length_j = terms_i * stride_i, terms_j * stride_j
    low, high = max(1 - length_i, -reach), min(length_j - 1, reach)
    lags = step * _lag_grid(mi // step, mj // step, -(-low // step), high // step)
    places = np.minimum(length_i, length_j - lags) - np.maximum(0, -lags)
    weight = trapezoid_weights(lags // step) * np.maximum(places, 0) / math.lcm(stride_i, stride_j)
    of_laws = np.stack([_lag_covariance(lags, mi, mj, law) for law in _LAWS])
    return lags, weight / (float(terms_i) * float(terms_j)), of_laws


def _reach(longest: int, times: Sequence[float]) -> int:
    """Return how far from 0 lags are summed: by powers of two, so that few different grids are made."""
    reach = _FLICKER_REACH * longest
    for time in times:
        while reach < 2 * longest + _TIMES_REACH * time:
            reach *= 2
    return reach


def _lag_grid(mi: int, mj: int, low: int, high: int) -> IntArray:
    """Return lags from `low` to `high`: all, or dense about the nine kinks and ever sparser beyond."""
    if high - low <= _ALL_LAGS:
        return np.arange(low, high + 1, dtype=np.int64)
    spread = _SPREAD[: np.searchsorted(_SPREAD, high - low, side="right")]
    offsets = np.concatenate([-spread, _NEAR, spread])
    kinks = np.unique([a * mi - b * mj for a in range(3) for b in range(3)])
    about = kinks[:, np.newaxis] + offsets
    # Up to half way to the next kink, whose own lags go on from there.
    half = np.concatenate([[low], (kinks[1:] + kinks[:-1]) // 2, [high]])
    own = (about >= half[:-1, np.newaxis]) & (about <= half[1:, np.newaxis])
    between = np.linspace(-2 * mj, 2 * mi, 129).astype(np.int64)
    lags = np.concatenate([about[own], between, [low, high]])
    return np.asarray(np.unique(lags[(lags >= low) & (lags <= high)]), dtype=np.int64)


def _lag_covariance(lags: IntArray, mi: int, mj: int, process: Process) -> FloatArray:
    """Return cov(d_t at mi, d_{t+k} at mj) at `lags` k, shape (l,)."""
    shifts = np.array([b * mj - a * mi for a in range(3) for b in range(3)], dtype=np.float64)
    signs = np.multiply.outer(_SIGNS, _SIGNS).ravel()
    # Windows that do not meet: the sum would leave rounding errors, the larger the farther apart.
    apart = np.maximum(lags - 2 * mi, -2 * mj - lags)
    if isinstance(process, GaussMarkov):
        meet = apart < 0
    elif isinstance(process, PowerLaw) and process is not PowerLaw.FLICKER:
        # The windows of a law that touch may share a value.
        meet = apart <= 0
    else:
        meet = np.ones(lags.size, dtype=bool)
    covariance = np.zeros(lags.size)
    distance = np.abs(shifts[:, np.newaxis] + lags[meet].astype(np.float64))
    covariance[meet] = signs @ sum_variance(process, distance) / (-4.0 * mi * mj)
    if isinstance(process, GaussMarkov):
        covariance[~meet] = _gauss_markov_apart(apart[~meet], mi, mj, process.T)
    return covariance


def _gauss_markov_apart(apart: IntArray, mi: int, mj: int, time: float) -> FloatArray:
    """Return the covariance of a Gauss-Markov process in windows `apart` samples from end to start.

    A product: -phi phi^apart (1 - phi^mi)² (1 - phi^mj)² / (2 mi mj (1 - phi)²), phi = exp(-1/T).
    """
    rate = 1 / time
    size = (math.expm1(-rate * mi) * math.expm1(-rate * mj) / math.expm1(-rate)) ** 2
    return np.asarray(-np.exp(-rate * (apart + 1.0)) * (size / (2.0 * mi * mj)))


#: Averaging times that a fit uses lie at least so far apart; closer ones say almost the same.
_LEAST_RATIO = 1.9

#: Excess kurtosis of a uniform distribution: the lightest tails that are believed.
_LIGHTEST = -1.2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AvarPoints:
    """Allan variances to fit.

    Attributes
    ----------
    m
        Averaging factors, shape (k,), rising.
    avar
        Allan variances over `scale`, shape (k,).
    scale
        In the square of the sample unit.
    n
        Number of samples they were made from.
    known_n
        Whether `n` was known; else it is the least that allows the longest averaging time.
    tau0
        Sampling period, in s.
    overlapping
        Whether they are the overlapping Allan variances.
    used
        Their indices in the curve, shape (k,).
    excess
        Excess kurtosis of the white part of the samples; 0 where it is Gaussian or unknown.
    """

    m: IntArray
    avar: FloatArray
    scale: float
    n: int
    known_n: bool
    tau0: float
    overlapping: bool
    used: IntArray
    excess: float = 0.0

    @property
    def size(self) -> int:
        """Number of points."""
        return self.m.size

    def within(self, first: int) -> "AvarPoints":
        """Return the points from index `first` on."""
        return replace(self, m=self.m[first:], avar=self.avar[first:], used=self.used[first:])

    def coefficient(self, symbol: str, variance: float) -> float:
        """Return a term's coefficient in SI, from its variance per sample over `scale`."""
        deviation = float(np.sqrt(variance * self.scale))
        return deviation / TERMS[symbol].per_sample(self.tau0)

    def term(self, symbol: str, variance: float, time: float = 0.0) -> NoiseTerm:
        """Return the term with that variance per sample and, where it has one, time in samples."""
        value = self.coefficient(symbol, variance)
        term = TERMS[symbol]
        return term.of(value, *[time * self.tau0] * (len(term.parameters()) - 1))


def avar_points(series: AxisSeries | None, curve: AllanCurve) -> AvarPoints:
    """Return the points of `curve` that are worth fitting.

    Raises
    ------
    DataError
        If the curve is of another estimator, or holds fewer than 2 positive Allan variances.
    """
    where = series.name if series is not None else "the curve"
    if curve.estimator not in {"overlapping", "standard"}:
        msg = (
            f"{where}: is of {curve.estimator} variances; a fit needs Allan variances, overlapping or "
            "standard: compute those"
        )
        raise DataError(msg)
    usable = np.isfinite(curve.avar) & (curve.avar > 0)
    used = _spaced(curve.tau, usable)
    if used.size < 2:
        msg = (
            f"{where}: {used.size} positive Allan variances at averaging times a factor {_LEAST_RATIO} "
            "apart; a fit needs at least 2: record for longer"
        )
        raise DataError(msg)
    m = curve.m[used]
    known = curve.n >= 2 * int(m[-1])
    scale = float(np.exp(np.mean(np.log(curve.avar[used]))))
    return AvarPoints(
        m=m,
        avar=curve.avar[used] / scale,
        scale=scale,
        n=curve.n if known else 2 * int(m[-1]),
        known_n=known,
        tau0=float(curve.tau[used[-1]] / m[-1]),
        overlapping=curve.estimator == "overlapping",
        used=used,
        excess=_excess_kurtosis(series) if series is not None else 0.0,
    )


def parts_of(structure: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the symbols of the terms without a time, and of those with one."""
    laws = tuple(symbol for symbol in structure if len(TERMS[symbol].parameters()) == 1)
    return laws, tuple(symbol for symbol in structure if symbol not in laws)


def _terms(laws: Sequence[str], kinds: Sequence[str], times: Iterable[float]) -> list[NoiseTerm]:
    """Return the terms of unit deviation per sample, their times in samples."""
    terms = [TERMS[symbol].of(1 / TERMS[symbol].per_sample(1.0)) for symbol in laws]
    every = zip(kinds, map(float, times), strict=True)
    return terms + [TERMS[symbol].of(1 / TERMS[symbol].per_sample(1.0), time) for symbol, time in every]


def columns(
    m: IntArray, laws: Sequence[str], kinds: Sequence[str] = (), times: Iterable[float] = ()
) -> FloatArray:
    """Return the Allan variance of each term of unit variance per sample, shape (k, p).

    Parameters
    ----------
    m
        Averaging factors, shape (k,).
    laws, kinds
        Symbols of the terms without a time, such as N, B and K, and of those with one.
    times
        The times, in samples, shape (g,); the columns of their terms follow.
    """
    parts = [term.avar(m.astype(np.float64), 1.0) for term in _terms(laws, kinds, times)]
    return np.stack(parts, axis=1) if parts else np.empty((m.size, 0))


def processes(laws: Sequence[str], kinds: Sequence[str], times: Iterable[float]) -> list[Process]:
    """Return the random processes of the terms (the ramp is none), in the order of `columns`."""
    return [
        term.law if isinstance(term, PowerLawTerm) else term
        for term in _terms(laws, kinds, times)
        if not isinstance(term, RateRamp)
    ]


def _spaced(tau: FloatArray, usable: np.ndarray) -> IntArray:
    """Return the indices of usable averaging times, each a factor of about 2 above the last."""
    chosen: list[int] = []
    for index in np.flatnonzero(usable).tolist():
        if not chosen or tau[index] >= _LEAST_RATIO * tau[chosen[-1]]:
            chosen.append(index)
    return np.array(chosen, dtype=np.int64)


def _excess_kurtosis(series: AxisSeries) -> float:
    """Return the excess kurtosis of the white part; 0 where it does not differ from 0 for sure.

    Differences of neighbours hold white noise twice and hardly anything else, and their excess
    kurtosis is half of it. What has lighter tails than a uniform distribution is a tone, no noise.
    """
    steps = series.n - 1
    if steps < 100:
        return 0.0
    excess = excess_kurtosis(series.samples)
    # Neighbouring differences share a sample: their squares correlate by 1/4.
    deviation = np.sqrt(24 / steps * 1.5)
    return max(2 * excess, _LIGHTEST) if abs(excess) > 4 * deviation else 0.0
