"""The points of an Allan curve that a fit uses, and their covariance in closed form.

Variances are relative to a typical Allan variance, and times to the sampling period. An Allan variance is a
mean of squares of d_t, the second differences of the summed signal. For Gaussian noise the covariance follows
from each term's V(n), the generalised variance of a sum of n samples:

    cov(d_t at m_i, d_{t+k} at m_j) = -1/(4 m_i m_j) sum_ab c_a c_b V(|k + b m_j - a m_i|),
    cov(avar_i, avar_j) = 2/(M_i M_j) sum_k n_ij(k) s_ij(k)^2,        c = (1, -2, 1).

Source: Greenhall & Riley (2003), "Uncertainty of stability variances based on finite differences", for one
averaging time; two averaging times are analogous.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.allan.intervals import LIGHTEST, excess_kurtosis, graded_lags, trapezoid_weights
from imucal.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays, read_only
from imucal.errors import DataError
from imucal.noise.term import NoiseTerm, PowerLawTerm
from imucal.noise.terms import TERMS, AngleRandomWalk, GaussMarkov, RateRamp
from imucal.powerlaw import PowerLaw
from imucal.recording import AxisSeries

_SIGNS = np.array([1.0, -2.0, 1.0])
#: Maximum number of lags that are all summed.
_ALL_LAGS = 300
#: All lags up to this distance from a kink are summed; beyond it, four per octave.
_NEAR = 6
#: Largest lag, in averaging times: the covariance of flicker falls with the fourth power.
_FLICKER_REACH = 24
#: Largest lag beyond the windows, in correlation times.
_TIMES_REACH = 20.0
#: Smallest ratio of neighbouring averaging times; closer ones add almost no information.
_MIN_SPACING = 1.9


@dataclass(frozen=True, kw_only=True, eq=False)
class AvarCovariance(ReadOnlyArrays):
    """The covariance of Allan variances, as a function of the terms' variances per sample.

    `ramp`, shape (p,), is the mask of the ramps, which do not scatter. `quadratic`, shape (q, q, k, k),
    contains the coefficients of products of two of the other q variances, and `drift`, shape (q, k, k), those
    of products of a variance and the squared ramp per sample.
    """

    ramp: BoolArray
    quadratic: FloatArray
    drift: FloatArray

    def at(self, variances: FloatArray) -> FloatArray:
        """Return the covariance, shape (k, k), at variances of shape (p,)."""
        random, ramp = variances[~self.ramp], float(variances[self.ramp].sum())
        covariance = np.tensordot(np.multiply.outer(random, random), self.quadratic, axes=2)
        if ramp:
            covariance = covariance + ramp * np.tensordot(random, self.drift, axes=1)
        return np.asarray((covariance + covariance.T) / 2)


def avar_covariance(m: IntArray, n: int, terms: Sequence[NoiseTerm], *, overlapping: bool) -> AvarCovariance:
    """Return the covariance of the Allan variances of `n` samples at averaging factors `m`, shape (k,).

    Factors outside 1 … n // 2 raise a ValueError. `terms` have unit variances, and times in samples. The
    relative error is below 1e-3.
    """
    if m.size and not (m.min() >= 1 and m.max() <= n // 2):
        raise ValueError(f"averaging factors must be in 1..{n // 2} for {n} samples")
    return _computed(tuple(m.tolist()), n, tuple(terms), overlapping=overlapping)


@lru_cache(maxsize=32)
def _computed(
    m: tuple[int, ...], n: int, terms: tuple[NoiseTerm, ...], *, overlapping: bool
) -> AvarCovariance:
    """Return the covariance, cached because the axes of a log need the same one."""
    ramp = np.array([isinstance(term, RateRamp) for term in terms], dtype=bool)
    random = [term for term in terms if not isinstance(term, RateRamp)]
    quadratic = np.empty((len(random), len(random), len(m), len(m)))
    drift = np.empty((len(random), len(m), len(m)))
    for i, mi in enumerate(m):
        for j, mj in enumerate(m[: i + 1]):
            lags, weight, covariances = _lag_products(
                mi, mj, n, _reach(max(mi, mj), random), overlapping=overlapping
            )
            covariance = np.empty((len(random), lags.size))
            for row, term in zip(covariance, random, strict=True):
                row[:] = covariances[term] if term in covariances else _lag_covariance(lags, mi, mj, term)
            weighted = covariance * weight
            quadratic[..., i, j] = quadratic[..., j, i] = 2 * weighted @ covariance.T
            # A ramp gives d_t at m the mean w m / sqrt(2). Negative sums are rounding errors.
            drift[..., i, j] = 2 * mi * mj * np.maximum(weighted.sum(axis=1), 0.0)
            drift[..., j, i] = drift[..., i, j]
    return AvarCovariance(ramp=ramp, quadratic=quadratic, drift=drift)


@lru_cache(maxsize=8)
def _every_sum_variance(term: NoiseTerm, size: int) -> FloatArray:
    """Return V(n) up to a multiple of n², n = 0 … size-1."""
    return read_only(term.sum_variance(np.arange(size, dtype=np.float64), 1.0))


@lru_cache(maxsize=512)
def _lag_products(
    mi: int, mj: int, n: int, reach: int, *, overlapping: bool
) -> tuple[IntArray, FloatArray, dict[NoiseTerm, FloatArray]]:
    """Return lags, their weights n_ij(k) / (M_i M_j), and the covariances of the power laws there."""
    step = 1 if overlapping else math.gcd(mi, mj)
    stride_i, stride_j = (1, 1) if overlapping else (mi, mj)
    terms_i, terms_j = ((n - 2 * a + s) // s for a, s in ((mi, stride_i), (mj, stride_j)))
    length_i, length_j = terms_i * stride_i, terms_j * stride_j
    low, high = max(1 - length_i, -reach), min(length_j - 1, reach)
    lags = step * _lag_grid(mi // step, mj // step, -(-low // step), high // step)
    places = np.minimum(length_i, length_j - lags) - np.maximum(0, -lags)
    weight = trapezoid_weights(lags // step) * np.maximum(places, 0) / math.lcm(stride_i, stride_j)
    laws = unit_terms([symbol for symbol, term in TERMS.items() if issubclass(term, PowerLawTerm)])
    covariances = {law: _lag_covariance(lags, mi, mj, law) for law in laws}
    return lags, weight / (float(terms_i) * float(terms_j)), covariances


def _reach(longest: int, terms: Sequence[NoiseTerm]) -> int:
    """Return the largest lag; powers of two, so that few different grids are cached."""
    reach = _FLICKER_REACH * longest
    for time in (time for term in terms for time in term.values[1:]):
        while reach < 2 * longest + _TIMES_REACH * time:
            reach *= 2
    return reach


def _lag_grid(mi: int, mj: int, low: int, high: int) -> IntArray:
    if high - low <= _ALL_LAGS:
        return np.arange(low, high + 1, dtype=np.int64)
    kinks = np.unique([a * mi - b * mj for a in range(3) for b in range(3)])
    return graded_lags(kinks, low, high, dense=_NEAR, per_octave=4)


def _lag_covariance(lags: IntArray, mi: int, mj: int, term: NoiseTerm) -> FloatArray:
    """Return cov(d_t at mi, d_{t+k} at mj) at `lags` k, shape (l,).

    For a Gauss-Markov process and windows g samples apart it is
    -phi phi^g (1 - phi^mi)² (1 - phi^mj)² / (2 mi mj (1 - phi)²) with phi = exp(-1/T).
    """
    shifts = np.array([b * mj - a * mi for a in range(3) for b in range(3)], dtype=np.float64)
    signs = np.multiply.outer(_SIGNS, _SIGNS).ravel()
    # For windows that do not meet, the sum would have rounding errors that grow with their distance.
    apart = np.maximum(lags - 2 * mi, -2 * mj - lags)
    meet = np.ones(lags.size, dtype=bool)
    if isinstance(term, GaussMarkov):
        meet = apart < 0
    elif isinstance(term, PowerLawTerm) and term.law is not PowerLaw.FLICKER:
        meet = apart <= 0
    covariance = np.zeros(lags.size)
    distance = np.abs(shifts[:, np.newaxis] + lags[meet].astype(np.float64))
    if type(term).sum_variance is NoiseTerm.sum_variance:
        every = _every_sum_variance(term, 1 << int(distance.max(initial=1)).bit_length())
        summed = every[distance.astype(np.int64)]
    else:
        summed = term.sum_variance(distance, 1.0)
    covariance[meet] = signs @ summed / (-4.0 * mi * mj)
    if isinstance(term, GaussMarkov):
        rate = 1 / term.T
        size = (math.expm1(-rate * mi) * math.expm1(-rate * mj) / math.expm1(-rate)) ** 2
        covariance[~meet] = -np.exp(-rate * (apart[~meet] + 1.0)) * (size / (2.0 * mi * mj))
    return covariance


@dataclass(frozen=True, kw_only=True, eq=False)
class AvarPoints:
    """Allan variances to fit, at increasing averaging factors `m`; arrays have the shape (k,).

    `avar` are the variances divided by `scale`, in U², and `used` their indices in the curve. `n` is the
    number of samples; if unknown, the smallest that allows the longest averaging time. `tau0` is in s.
    `excess` is the excess kurtosis of the white part of the samples, 0 if unknown.
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
        return self.m.size

    def within(self, first: int) -> "AvarPoints":
        return replace(self, m=self.m[first:], avar=self.avar[first:], used=self.used[first:])

    def coefficient(self, symbol: str, variance: float) -> float:
        """Return a term's coefficient in SI from its variance per sample."""
        deviation = float(np.sqrt(variance * self.scale))
        return deviation / TERMS[symbol].per_sample(self.tau0)


def avar_points(series: AxisSeries | None, curve: AllanCurve) -> AvarPoints:
    """Return the points of `curve` that a fit uses.

    A curve of another estimator, or with fewer than 2 positive Allan variances, raises a DataError.
    """
    where = series.name if series is not None else "the curve"
    if curve.estimator not in {"overlapping", "standard"}:
        msg = (
            f"contains {curve.estimator} variances; a fit needs Allan variances, overlapping or "
            "standard: compute those"
        )
        raise DataError(msg, place=where)
    chosen: list[int] = []
    for index in np.flatnonzero(np.isfinite(curve.avar) & (curve.avar > 0)).tolist():
        if not chosen or curve.tau[index] >= _MIN_SPACING * curve.tau[chosen[-1]]:
            chosen.append(index)
    used = np.array(chosen, dtype=np.int64)
    if used.size < 2:
        msg = (
            f"{used.size} positive Allan variances at averaging times that differ by a factor "
            f"{_MIN_SPACING}; a fit needs at least 2: record for longer"
        )
        raise DataError(msg, place=where)
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


def is_timed(symbol: str) -> bool:
    """Whether a term has a correlation time."""
    return len(TERMS[symbol].parameters()) > 1


def unit_terms(symbols: Sequence[str], times: Iterable[float] = ()) -> tuple[NoiseTerm, ...]:
    """Return terms of unit variance per sample; `times` are in samples."""
    given = iter(times)
    return tuple(TERMS[s].of(1.0, float(next(given))) if is_timed(s) else TERMS[s].of(1.0) for s in symbols)


def columns(m: IntArray, terms: Sequence[NoiseTerm]) -> FloatArray:
    """Return the Allan variances of terms at averaging factors `m`, shape (k, p)."""
    factors = m.astype(np.float64)
    parts = [term.avar(factors, 1.0) for term in terms]
    return np.stack(parts, axis=1) if parts else np.empty((m.size, 0))


def spread_of(points: AvarPoints, terms: Sequence[NoiseTerm]) -> AvarCovariance:
    """Return the covariance of the points, for any variances of a set of terms.

    White noise of excess kurtosis g adds g avar_i avar_j / n.
    """
    gaussian = avar_covariance(points.m, points.n, terms, overlapping=points.overlapping)
    random = [term for term in terms if not isinstance(term, RateRamp)]
    quadratic = gaussian.quadratic.copy()
    for place, term in enumerate(random):
        if isinstance(term, AngleRandomWalk):
            quadratic[place, place] += points.excess / points.n / np.outer(points.m, points.m)
    return replace(gaussian, quadratic=quadratic)


def _excess_kurtosis(series: AxisSeries) -> float:
    """Return the excess kurtosis of the white part, or 0 if it is not significant.

    Tails lighter than a uniform distribution's belong to a tone.
    """
    steps = series.n - 1
    if steps < 100:
        return 0.0
    excess = excess_kurtosis(series.samples)
    # Squares of neighbouring differences have a correlation of 1/4.
    deviation = np.sqrt(24 / steps * 1.5)
    return max(2 * excess, LIGHTEST) if abs(excess) > 4 * deviation else 0.0
