"""Check whether one half of a record predicts the other.

A fit that describes a whole record may still predict badly, because the noise changes. So the coefficients
of the fitted terms are estimated from one half of the record by weighted least squares of its binned psd P_b
with c_b ordinates, and the Allan variance that they predict is compared with the other half's. The Allan
variance at t is the sum of w_b P_b with

    w_b = 4/(pi t) (I(pi t f_high) - I(pi t f_low)),   I(x) = Si(2x) - Si(4x)/2 - sin⁴x / x,

where I is the integral of sin⁴x / x². Observed over predicted has Fisher's F distribution.

Source: Rutman & Walls (1991), Proc. IEEE 79, 952 (the Allan variance as an integral of the psd).
"""

import math
from dataclasses import replace
from statistics import NormalDist

import numpy as np
import scipy

from imucal.allan import Spectrum, spectrum
from imucal.arrays import FloatArray
from imucal.clock import Clock
from imucal.findings import Finding
from imucal.fitting.cross_checks import without_disturbances
from imucal.fitting.noise_fit import NoiseFit
from imucal.frozen import frozen
from imucal.noise.terms import TERMS
from imucal.recording import AxisSeries

#: Averaging times at which the halves are compared, in s.
TIMES_S = (10.0, 30.0, 100.0, 300.0)
#: Least length of a half, in averaging times.
_LONGER = 12.0
#: Highest frequency in use, in Hz; higher ones hardly matter at 10 s.
_HIGHEST = 3.0
#: Blocks per period of the highest frequency; least ratio of a filter's corner to it.
_FINE, _BELOW = 4.0, 4.0
#: Least number of places of a block with gaps, and inverse of its least filled share.
_SPARSE = 4
#: False alarm rate of the check per record.
_CHANCE = 0.01
#: Lower limit of a prediction, as a share of the model's: least squares may give negative values.
_MIN_SHARE = 0.05
#: Number of bins left out around each line.
_OF_LINE = 3


@frozen
class Prediction:
    """The prediction of one half of a record from the other, at one averaging time.

    `half`, 1 or 2, is the observed half. `predicted` and `observed` are Allan deviations in U. `score` is
    standard-normal.
    """

    half: int
    time_s: float
    predicted: float
    observed: float
    score: float


def half_predictions(series: AxisSeries, fit: NoiseFit) -> tuple[Prediction, ...]:
    """Return how well each half of a record predicts the other; () if the record is too short.

    Samples are finite, gaps allowed, after subtracting the shapes that their `fit` by maximum likelihood took
    out.
    """
    highest = min(_HIGHEST, series.rate_hz / 2, (fit.goodness.band_hz or (0.0, math.inf))[1])
    if fit.response is not None:
        highest = min(highest, fit.response.cutoff_hz / _BELOW)
    if series.clock.missing:
        highest = min(highest, series.rate_hz / (_FINE * _SPARSE))
    blocks = _blocks(series, max(1, int(series.rate_hz / (_FINE * highest))))
    middle = blocks.duration_s / 2
    halves = [blocks.between(0.0, middle), blocks.between(middle, math.inf)]
    times = [t for t in TIMES_S if all(_reach(half) >= _LONGER * t for half in halves)]
    if not times or not fit.model.terms:
        return ()
    if any(term.symbol == "R" for term in fit.model.terms):
        for i, half in enumerate(halves):
            time = half.clock.grid() - half.clock.grid().mean()
            slope = float(time @ half.samples) / float(time @ time)
            halves[i] = replace(half, samples=half.samples - slope * time)
    seen = [_Half(spectrum(half), fit, np.array(times), half.tau0, highest) for half in halves]
    return tuple(
        Prediction(half=number, time_s=t, predicted=math.sqrt(p), observed=math.sqrt(o), score=float(z))
        for number, (one, other) in enumerate((seen[::-1], seen), 1)
        for t, p, o, z in zip(times, *_held(one, other), strict=True)
    )


def self_check(
    series: AxisSeries, fit: NoiseFit, temperature: FloatArray | None = None
) -> tuple[Finding, ...]:
    """Return a warning if one half of a record predicts the other badly.

    Samples are finite, spikes replaced, gaps allowed; their `fit` is by maximum likelihood. `temperature`,
    shape (n,), is in degrees Celsius.
    """
    if fit.taken_out:
        series = without_disturbances(series, fit, temperature)
    found = half_predictions(series, fit)
    worst = max(found, key=lambda one: abs(one.score), default=None)
    # Bonferroni's bound: the scores are correlated.
    if worst is None or abs(worst.score) <= -NormalDist().inv_cdf(_CHANCE / 2 / len(found)):
        return ()
    names = ("first", "second")
    one, other = names[worst.half - 1], names[2 - worst.half]
    text = (
        f"The {other} half of the record predicts the {one} badly: at {worst.time_s:g} s its Allan deviation "
        f"is {worst.observed:.3g} {series.unit}, where {worst.predicted:.3g} {series.unit} is predicted "
        f"(score {worst.score:+.1f})."
    )
    advice = (
        "The noise changes with time, or the model is wrong. Check temperature and vibration, and use "
        "larger numbers in a filter: the noise may change again."
    )
    return (Finding("warning", "predicts-badly", text, advice, axis=series.name),)


def _reach(series: AxisSeries) -> float:
    return max((s.size for s in series.clock.segments), default=0) * series.tau0


def _blocks(series: AxisSeries, size: int) -> AxisSeries:
    """Return the means of blocks of `size` places, without nearly empty blocks."""
    clock = series.clock
    if size == 1:
        return series
    edges = np.arange(clock.grid_size // size + 1) * size
    starts = np.searchsorted(clock.grid(), edges) if clock.missing else edges
    count = np.diff(starts)
    keep = _SPARSE * count >= size
    sums = np.add.reduceat(series.samples[: starts[-1]], starts[:-1][count > 0])
    means = np.zeros(count.size)
    means[count > 0] = sums / count[count > 0]
    even = Clock.even(count.size, series.rate_hz / size)
    return replace(series, samples=means, clock=even).keeping(keep)


class _Half:
    """The binned psd of a half, the weights of its Allan variances, and the fit's terms."""

    def __init__(self, own: Spectrum, fit: NoiseFit, times: FloatArray, tau0: float, highest: float) -> None:
        keep = own.frequency <= highest
        for line in fit.goodness.lines:
            if line.frequency_hz <= highest:
                keep[np.argsort(np.abs(own.frequency - line.frequency_hz))[:_OF_LINE]] = False
        self.psd, self.count = own.psd[keep], own.count[keep]
        middles = (own.frequency[1:] + own.frequency[:-1]) / 2
        edges = np.concatenate([[own.frequency[0] / 2], middles, [own.frequency[-1]]])

        def integral(f: FloatArray) -> FloatArray:
            x = np.pi * np.outer(times, f)
            result: FloatArray = (
                scipy.special.sici(2 * x)[0] - scipy.special.sici(4 * x)[0] / 2 - np.sin(x) ** 4 / x
            )
            return result

        self.weights = 4 / (np.pi * times[:, None]) * np.diff(integral(edges))[:, keep]
        f = own.frequency[keep]
        terms = [term for term in fit.model.terms if term.symbol != "R"]
        self.fitted = np.sum([term.psd(f, tau0) for term in terms], axis=0)
        shapes = [TERMS[symbol].of(1.0) for symbol in "NBK" if symbol not in {t.symbol for t in terms}]
        self.columns = np.stack([term.psd(f, tau0) for term in (*terms, *shapes)], axis=1)

    def coefficients(self) -> tuple[FloatArray, FloatArray]:
        """Return the squared coefficients relative to the fit's, and their covariance."""
        root = np.sqrt(self.count / 2) / self.fitted
        scaled = self.columns * root[:, None]
        unit = np.linalg.norm(scaled, axis=0)
        inverse = np.linalg.pinv(scaled / unit) / unit[:, None]
        return inverse @ (self.psd * root), inverse @ inverse.T


def _held(one: _Half, other: _Half) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return predicted and observed Allan variances and their scores, shape (t,) each."""
    found, covariance = one.coefficients()
    shares = other.weights @ other.columns
    model = other.weights @ other.fitted
    predicted = np.maximum(shares @ found, _MIN_SHARE * model)
    freedom = 2 * model**2 / np.einsum("ti,ij,tj->t", shares, covariance, shares)
    edf = model**2 / np.sum((other.weights * other.fitted) ** 2 / other.count, axis=1)
    observed = other.weights @ other.psd
    ratio = observed / predicted
    below, above = (
        scipy.special.ndtri(law(edf, freedom, ratio)) for law in (scipy.special.fdtr, scipy.special.fdtrc)
    )
    return predicted, observed, np.where(below < 0, below, -above)
