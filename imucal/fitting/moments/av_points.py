"""The points of an Allan curve that a fit is made of, in units of one sample and one scale.

Everything a fit of a curve computes is relative to a typical Allan variance of it and to the
sampling period, so that the unit of the samples changes nothing but the unit of the result.
"""

from dataclasses import dataclass, replace

import numpy as np

from imucal.allan.confidence import excess_kurtosis
from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray, IntArray
from imucal.errors import DataError
from imucal.fitting.moments.av_covariance import Process
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import TERMS, GaussMarkov
from imucal.powerlaw import PowerLaw
from imucal.recording import AxisSeries

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
        """Return the term with that variance per sample and, for GM, correlation time in samples."""
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


def columns(m: IntArray, laws: str, times: FloatArray) -> FloatArray:
    """Return the Allan variance of each term of unit variance per sample, shape (k, p).

    Parameters
    ----------
    m
        Averaging factors, shape (k,).
    laws
        Symbols other than GM, such as ``NBK``.
    times
        Correlation times of the Gauss-Markov terms, in samples, shape (g,); their columns follow.
    """
    factors = m.astype(np.float64)
    parts = [TERMS[law].of(1.0).avar(factors, 1.0) for law in laws]
    parts += [GaussMarkov(sigma=1.0, T=float(time)).avar(factors, 1.0) for time in times]
    return np.stack(parts, axis=1) if parts else np.empty((m.size, 0))


def processes(laws: str, times: FloatArray) -> list[Process]:
    """Return the random processes of the terms (the ramp is none), in the order of `columns`."""
    return [PowerLaw(law) for law in laws if law != "R"] + [float(time) for time in times]


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
