"""Equivalent degrees of freedom of every value of a curve.

At short averaging times they follow from the spectrum itself. At long ones, and with gaps, they follow from a
generic model. Both are corrected for heavy tails.

The generic model is the sum of the four power laws and a drift that best fits a spectrum. Its degrees of
freedom are exact. A variance is the mean square of M differences d_t. For Gaussian noise

    Var = (2/M) Σ_{|k|<M} (1 - |k|/M) s(k)² + (4 µ²/M) Σ (1 - |k|/M) s(k),   EDF = 2 (s(0) + µ²)² / Var

where s(k) is the autocovariance of d_t and µ its mean (from a drift). Let V(n) be the generalised
variance of the sum of n samples (`imucal.powerlaw`). Then

    s(k) = [-6 V(k) + 4 V(k-m) + 4 V(k+m) - V(k-2m) - V(k+2m)] / (4 m²)

Source: Greenhall & Riley (2003), "Uncertainty of stability variances based on finite
differences", PTTI 35, eqs. 6-10; the power laws' V(n) replaces their continuous limit.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from imucal.allan.dct import (
    DctBins,
    Transform,
    bin_power,
    dct_bins,
    fast_length,
    ramp_ordinates,
    run_ordinates,
)
from imucal.allan.least_squares import non_negative
from imucal.allan.variance import GappyVariances, sum_of_squares
from imucal.arrays import BoolArray, FloatArray, IntArray, read_only
from imucal.powerlaw import PowerLaw
from imucal.recording import AxisSeries

#: More lags than this are summed on a graded grid.
_ALL_LAGS = 1024
#: Lags kept around each kink.
_DENSE = 24
#: Lags per octave beyond.
_PER_OCTAVE = 16
#: Flicker's covariance falls as k^-4: this many averaging times are enough.
_FAR = 32
#: Above this ordinate a drift contributes less than 1e-6 of its squares.
_DRIFT_ORDINATES = 128
#: Minimum gain of twice the log likelihood: the 95 % quantile of chi-squared with 1 dof.
_DRIFT_GAIN = 3.84
#: Most rounds of Fisher scoring.
_ROUNDS = 100
#: Most halvings of a step of Fisher scoring.
_HALVINGS = 20
#: Updates of the starting point of Fisher scoring.
_UPDATES = 20
#: Mean of (2 sin)^4 over a period: the central binomial coefficient of 2.
_MEAN_RIPPLE = 6
#: Mean of (2 sin)^8 over a period: the central binomial coefficient of 4.
_MEAN_SQUARED_RIPPLE = 70
#: Averaging factors up to n divided by this need no model.
_CROSSOVER = 256
#: A difference of two independent values has half the excess kurtosis of one value.
_HALVED = 2.0
#: Excess kurtosis of a uniform distribution: the lower limit of the estimate.
LIGHTEST = -1.2
#: Samples per block: a work array of this length fits in a second-level cache of 1 MB.
_BLOCK = 32768


@dataclass(frozen=True, kw_only=True)
class GenericModel:
    """A sum of the four power laws, with the variance of each in U², and a drift per sample, in U."""

    variances: tuple[float, ...]
    drift: float = 0.0


def model_edf(model: GenericModel, m: int, terms: float) -> float:
    """Return the equivalent degrees of freedom of one value, at least 1.

    The scale of `model` does not matter. `terms` is the number M of averaged differences.
    """
    variances = np.array(model.variances)
    if not variances.any() and not model.drift:
        variances = np.array([0.0, 1.0, 0.0, 0.0])
    # A drift adds a mean to a second difference.
    mean_square = (model.drift * m) ** 2 / 2
    lags, weights, basis = _basis(m, int(terms))
    weights = weights * (1 - lags / terms)
    covariance = variances @ basis
    lag_sum = max(float(weights @ covariance), 0.0)
    total = float(weights @ covariance**2) + 2 * mean_square * lag_sum
    level = float(covariance[0]) + mean_square
    return max(terms * level**2 / total, 1.0) if total > 0 else terms


@lru_cache(maxsize=128)
def _basis(m: int, span: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    lags, weights = _lag_grid(m, min(span - 1, _FAR * m))
    return lags, weights, np.array([_covariance(law, lags, m) for law in PowerLaw])


def _lag_grid(m: int, last: int) -> tuple[FloatArray, FloatArray]:
    """Return lags from 0 to `last` and weights that sum an even function over them."""
    lags = np.arange(last + 1)
    if last > _ALL_LAGS:
        kinks = m * np.arange(3)
        lags = graded_lags(kinks, 0, last, dense=_DENSE, per_octave=_PER_OCTAVE)
    weights = 2 * trapezoid_weights(lags)
    weights[0] -= 1
    return lags.astype(np.float64), weights


def trapezoid_weights(lags: IntArray) -> FloatArray:
    """Return weights, so that weighted values at increasing `lags` sum over all lags between."""
    weight = np.ones(lags.size)
    skipped = (np.diff(lags) - 1) / 2
    weight[:-1] += skipped
    weight[1:] += skipped
    return weight


def graded_lags(kinks: IntArray, low: int, high: int, *, dense: int, per_octave: int) -> IntArray:
    """Return lags from `low` to `high`: all within `dense` of increasing kinks, fewer beyond."""
    octaves = max(np.log2((high - low) / dense), 0.0)
    out = np.round(dense * 2.0 ** (np.arange(int(octaves * per_octave) + 1) / per_octave))
    about = kinks[:, np.newaxis] + np.concatenate([-out, np.arange(1.0 - dense, dense), out])
    half = np.concatenate([[low], (kinks[1:] + kinks[:-1]) // 2, [high]])[:, np.newaxis]
    own = about[(about >= half[:-1]) & (about <= half[1:])]
    between = np.linspace(kinks[0], kinks[-1], 129)
    lags = np.unique(np.concatenate([own, between, [low, high]]).astype(np.int64))
    return lags[(lags >= low) & (lags <= high)]


def _covariance(law: PowerLaw, k: FloatArray, m: int) -> FloatArray:
    """Return s(k), the autocovariance of the differences."""
    variance = law.sum_variance
    inside = (k <= 2 * m) | (law is PowerLaw.FLICKER)
    lag = k[inside]
    fourth_difference = (
        variance(lag - 2 * m)
        - 4 * variance(lag - m)
        + 6 * variance(lag)
        - 4 * variance(lag + m)
        + variance(lag + 2 * m)
    )
    covariance = np.zeros(k.shape)
    covariance[inside] = -fourth_difference / (4 * m**2)
    return covariance


def fit_spectrum(ordinates: FloatArray, power: FloatArray, bins: DctBins) -> GenericModel:
    """Return the maximum-likelihood generic model of DCT-II ordinates.

    The lowest `ordinates`, from k = 1, determine the drift. `power` contains the sums of squared ordinates in
    `bins`, shape (b,). Each bin adds to the score -log L = ½ Σ (n_b log S_b + P_b / S_b).

    Source: Whittle (1953), with the exact E[X_k²] of the DCT-II instead of the psd.
    """
    count = bins.count.astype(np.float64)
    basis = np.array([law.dct_spectrum(bins.n, bins.first, bins.count) for law in PowerLaw])
    plain, plain_score = _fit(basis, power, count)
    steady = GenericModel(variances=tuple(plain.tolist()))
    singles = min(_DRIFT_ORDINATES, ordinates.size, int(np.argmin(bins.count == 1)) or bins.size)
    shape, low = ramp_ordinates(bins.n, singles), ordinates[:singles]
    variances = plain
    for _ in range(3):
        spectrum = variances @ basis[:, :singles]
        if not spectrum.all():
            return steady
        drift = float(np.sum(low * shape / spectrum) / np.sum(shape**2 / spectrum))
        rest = power.copy()
        rest[:singles] = (low - drift * shape) ** 2
        variances, score = _fit(basis, rest, count, start=plain)
    if 2 * (plain_score - score) > _DRIFT_GAIN:
        return GenericModel(variances=tuple(variances.tolist()), drift=drift)
    return steady


def fit_curve(m: IntArray | FloatArray, avar: FloatArray, weight: FloatArray) -> GenericModel:
    """Return the generic model nearest to a curve, for series without a spectrum."""
    good = avar > 0
    basis = np.array([law.avar(m[good].astype(np.float64)) for law in PowerLaw])
    variances = _non_negative(basis / avar[good], np.ones(int(good.sum())), weight[good])
    return GenericModel(variances=tuple(variances.tolist()))


def _fit(
    basis: FloatArray, power: FloatArray, count: FloatArray, start: FloatArray | None = None
) -> tuple[FloatArray, float]:
    level = power / count
    floor = float(level.sum()) * 1e-30
    if not floor:
        return np.zeros(len(basis)), 0.0
    variances = _start(basis, level, count) if start is None else start
    return score_variances(basis, power, count, variances, _non_negative, floor=floor)


def score_variances(
    basis: FloatArray,
    power: FloatArray,
    count: FloatArray,
    start: FloatArray,
    solve: Callable[[FloatArray, FloatArray, FloatArray], FloatArray],
    *,
    floor: float = 0.0,
    close: float = 1e-3,
) -> tuple[FloatArray, float]:
    """Maximise the likelihood of a sum of spectra by Fisher scoring; return the variances and -log L.

    The spectrum is the sum of `basis`, shape (t, b), times the variances, shape (t,), plus `floor`. A bin has
    the sum `power` of `count` squares. Each step is a weighted least-squares solution, ``solve(basis /
    spectrum, level / spectrum, count)``. The search ends if a step gains less than `close`.
    """
    variances, score = start, _score(start @ basis + floor, power, count)
    for _ in range(_ROUNDS):
        spectrum = variances @ basis + floor
        step = solve(basis / spectrum, power / count / spectrum, count) - variances
        for halvings in range(_HALVINGS):
            trial = variances + 0.5**halvings * step
            trial_score = _score(trial @ basis + floor, power, count)
            if trial_score < score:
                break
        else:
            break
        gain, variances, score = score - trial_score, trial, trial_score
        if gain < close:
            break
    return variances, score


def _start(basis: FloatArray, level: FloatArray, count: FloatArray) -> FloatArray:
    """Return a starting point by multiplicative updates, which keep variances positive."""
    variances = np.array([np.quantile(level / law, 0.25) for law in basis]) / len(basis)
    variances += np.array([float((level * count).sum() / (law * count).sum()) for law in basis]) * 1e-6
    for _ in range(_UPDATES):
        spectrum = variances @ basis
        variances = variances * np.sqrt(
            (basis @ (count * level / spectrum**2)) / (basis @ (count / spectrum))
        )
    return variances


def _score(spectrum: FloatArray, power: FloatArray, count: FloatArray) -> float:
    if not spectrum.min() > 0:
        return np.inf
    return 0.5 * float(count @ np.log(spectrum) + np.sum(power / spectrum))


def _non_negative(basis: FloatArray, target: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the weights v >= 0 that minimise Σ weight (target - v @ basis)²."""
    root = np.sqrt(weight)
    return non_negative((basis * root).T, target * root)[0]


def degrees_of_freedom(samples: FloatArray, m: IntArray, transform: Transform | None = None) -> FloatArray:
    """Return the equivalent degrees of freedom of each value of a curve, shape (k,), each at least 1.

    `samples`, shape (n,), are evenly spaced and finite. Their `transform` saves time.

    Source: Greenhall & Riley (2003), PTTI 35; Percival & Walden (2000), ch. 8 (the spectral form).
    """
    terms = (samples.size + 1 - 2 * m).astype(np.float64)
    # Drop a few samples to make the transform fast.
    used = max(fast_length(samples.size), 2)
    bins, ordinates = dct_bins(used), run_ordinates(samples, 0, used, transform)
    power, edf = bin_power(ordinates, bins), np.empty(m.size)
    short = m <= bins.n // _CROSSOVER
    edf[short] = spectral_edf(power, bins, m[short], terms[short])
    if not short.all():
        model = fit_spectrum(ordinates, power, bins)
        edf[~short] = _of_model(model, m[~short], terms[~short])
    return np.maximum(less_for_heavy_tails(edf, samples, m), 1.0)


def _of_model(model: GenericModel, m: IntArray, terms: FloatArray) -> FloatArray:
    pairs = zip(m.tolist(), terms.tolist(), strict=True)
    return np.array([model_edf(model, factor, number) for factor, number in pairs])


def spectral_edf(power: FloatArray, bins: DctBins, m: IntArray, terms: FloatArray) -> FloatArray:
    """Return the degrees of freedom from the spectrum itself, without a model.

    With G the spectrum of the differences, EDF = M (mean G)² / mean G². The squared power of a bin of n_b
    ordinates is too large by the factor 1 + 2/n_b, which is divided out. `terms` are the numbers M of
    differences.
    """
    count = bins.count.astype(np.float64)
    level = power / count
    square = level**2 * count / (count + 2)
    edf = np.empty(m.size)
    for i, (factor, number) in enumerate(zip(m.tolist(), terms.tolist(), strict=True)):
        response, squared = power_response(bins, factor)
        first, second = float((count * response) @ level), float((count * squared) @ square)
        edf[i] = number * first**2 / (second * (bins.n - 1)) if second > 0 else number
    return edf


@lru_cache(maxsize=256)
def power_response(bins: DctBins, m: int) -> tuple[FloatArray, FloatArray]:
    """Return the response H of the Allan variance and its square, averaged over each bin, shape (b,); cached.

    The variance is the mean of H S over all angular frequencies, with S the spectrum per sample, and H = 2
    sin(m w/2)^4 / (m sin(w/2))². In wide bins the ripple is replaced by its mean.

    Source: NIST SP 1065 (2008), eq. 65, for sampled data.
    """
    tail = (2 * np.sin(bins.omega / 2)) ** -2 / (2 * m**2)
    ripple = (2 * np.sin(m * bins.omega / 2)) ** 4
    wide = bins.count * m * np.pi / bins.n > 1
    response = np.where(wide, _MEAN_RIPPLE, ripple) * tail
    squared = np.where(wide, _MEAN_SQUARED_RIPPLE, ripple**2) * tail**2
    return read_only(response), read_only(squared)


def excess_kurtosis(samples: FloatArray, neighbours: BoolArray | None = None) -> float:
    """Return the excess kurtosis of the differences of neighbouring samples; 0 if they are constant.

    `neighbours`, shape (n-1,), is True where no sample is missing before the next one.
    """
    if samples.size < 3:
        return 0.0
    mean = float((samples[-1] - samples[0]) / (samples.size - 1))
    count = second = fourth = 0.0
    for start in range(0, samples.size - 1, _BLOCK):
        part = np.diff(samples[start : start + _BLOCK + 1])
        part -= mean
        np.square(part, out=part)
        if neighbours is not None:
            part = part[neighbours[start : start + _BLOCK]]
        count += part.size
        second += float(part.sum())
        fourth += sum_of_squares(part)
    return count * fourth / second**2 - 3 if second > 0 else 0.0


def less_for_heavy_tails(
    edf: FloatArray,
    samples: FloatArray,
    m: IntArray,
    neighbours: BoolArray | None = None,
) -> FloatArray:
    """Return fewer degrees of freedom for tails heavier than a Gaussian's, more for lighter ones."""
    kappa = max(_HALVED * excess_kurtosis(samples, neighbours), LIGHTEST)
    independent = samples.size - 2 * m + 1.0
    corrected = edf / (1 + kappa * edf / (2 * np.maximum(independent, 1)))
    return np.where(independent >= 2 * m, corrected, edf)


def gappy_degrees_of_freedom(series: AxisSeries, values: GappyVariances) -> FloatArray:
    """Return the degrees of freedom where samples are missing, shape (k,), each at least 1.

    A series with gaps has no spectrum, so the generic model nearest to the curve is used at every time.
    """
    model = fit_curve(values.m, values.avar, np.maximum(values.terms / values.m, 1.0))
    edf = _of_model(model, values.m, values.terms) / values.inflation**2
    neighbours = np.diff(series.clock.grid()) == 1
    return np.maximum(less_for_heavy_tails(edf, series.samples, values.m, neighbours), 1.0)
