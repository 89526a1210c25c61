"""Equivalent degrees of freedom of every value of a curve, by one of three methods.

hybrid
    Of the spectrum itself where the averaging time is short, of the generic model that fits it
    best where it is long, both corrected for heavy tails. The default.
model
    Of the generic model at every averaging time.
greenhall
    Of the power law that the lag-1 autocorrelation names at each averaging time, as Stable32 prints
    them. On few averages it often names the wrong law, which costs 10 to 15 % of coverage.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import comb

import numpy as np

from imucal.allan.covariance import GenericModel, model_edf
from imucal.allan.dct import DctBins, bin_power, dct_bins, dct_ordinates, fast_length, shared_number
from imucal.allan.estimators import Estimator
from imucal.allan.gaps import GappyVariances
from imucal.allan.generic import fit_curve, fit_spectrum
from imucal.allan.variance import sum_of_squares
from imucal.arrays import BoolArray, FloatArray, IntArray, read_only
from imucal.powerlaw import PowerLaw
from imucal.recording import AxisSeries

#: Up to n / 256 the spectrum has enough ordinates in the passband to need no model.
_CROSSOVER = 256

#: The kurtosis of a difference of two independent values is half of each one's.
_HALVED = 2.0

#: Excess kurtosis of a uniform distribution: the lightest tails that are believed.
_UNIFORM = -1.2

#: Fewer averages than this name no power law; the one named at the averaging time before stays.
_FEWEST = 30

#: Largest exponent p of f^p that each law stands for, rising; what is flatter is quantization.
_EXPONENTS = ((-1.5, PowerLaw.WALK), (-0.5, PowerLaw.FLICKER), (0.5, PowerLaw.WHITE))

#: Elements of a work array.
_BLOCK = 32768


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Question:
    """What a method is asked: degrees of freedom of `m` (k,) with `terms` (k,) differences each."""

    samples: FloatArray
    m: IntArray
    terms: FloatArray
    estimator: Estimator


def degrees_of_freedom(samples: FloatArray, m: IntArray, estimator: Estimator, method: str) -> FloatArray:
    """Return the equivalent degrees of freedom of each value of a curve.

    Parameters
    ----------
    samples
        Evenly spaced, shape (n,), finite.
    m
        Averaging factors, shape (k,), each within the estimator's reach.
    estimator
        What was computed.
    method
        ``hybrid``, ``model`` or ``greenhall``.

    Returns
    -------
    Shape (k,), each at least 1.

    Raises
    ------
    ValueError
        If the method is unknown.

    Source: Greenhall & Riley (2003), PTTI 35; Percival & Walden (2000), ch. 8 (the spectral form).
    """
    chosen = _method_named(method)
    terms = np.array([estimator.terms(samples.size, mi) for mi in m.tolist()], dtype=np.float64)
    question = _Question(samples=samples, m=m, terms=terms, estimator=estimator)
    edf: FloatArray = np.maximum(chosen(question), 1.0)
    return edf


def _hybrid(question: _Question) -> FloatArray:
    samples, m, estimator = question.samples, question.m, question.estimator
    used, bins, ordinates = _transformed(samples)
    power = bin_power(ordinates, bins)
    short = (m <= used // _CROSSOVER) & estimator.overlapping
    edf = np.empty(m.size)
    edf[short] = spectral_edf(power, bins, m[short], question.terms[short], estimator)
    if not short.all():
        model = fit_spectrum(ordinates, power, bins)
        long = replace(question, m=m[~short], terms=question.terms[~short])
        edf[~short] = _of_models([model] * long.m.size, long)
    return _less_for_heavy_tails(edf, question)


def _model(question: _Question) -> FloatArray:
    _, bins, ordinates = _transformed(question.samples)
    model = fit_spectrum(ordinates, bin_power(ordinates, bins), bins)
    return _of_models([model] * question.m.size, question)


def _greenhall(question: _Question) -> FloatArray:
    models = [
        GenericModel(variances=tuple(float(law is named) for law in PowerLaw))
        for named in named_laws(question.samples, question.m)
    ]
    return _of_models(models, question)


#: Name -> method.
EDF_METHODS: dict[str, Callable[[_Question], FloatArray]] = {
    "hybrid": _hybrid,
    "model": _model,
    "greenhall": _greenhall,
}


def _method_named(name: str) -> Callable[[_Question], FloatArray]:
    if name not in EDF_METHODS:
        msg = f"edf method {name!r} is not known: expected one of {', '.join(EDF_METHODS)}"
        raise ValueError(msg)
    return EDF_METHODS[name]


def named_laws(samples: FloatArray, m: IntArray) -> list[PowerLaw]:
    """Return the power law that the averages of `m` neighbouring samples follow, for each factor.

    Source: Riley & Greenhall (2004), "Power law noise identification using the lag 1
    autocorrelation", EFTF 18, eqs. 5-10.
    """
    laws: list[PowerLaw] = []
    for factor in m.tolist():
        count = samples.size // factor
        if count < _FEWEST:
            laws.append(laws[-1] if laws else PowerLaw.WHITE)
            continue
        averages = samples[: count * factor].reshape(count, factor).mean(axis=1)
        exponent = _exponent(averages)
        laws.append(next((law for top, law in _EXPONENTS if exponent < top), PowerLaw.QUANTIZATION))
    return laws


def _exponent(values: FloatArray, differences: int = 0) -> float:
    """Return the exponent of the spectrum of `values`, differencing them until they are stationary."""
    centred = values - values.mean()
    square = sum_of_squares(centred)
    lag_one = float((centred[1:] * centred[:-1]).sum()) / square if square > 0 else 0.0
    order = lag_one / (1 + lag_one)
    if order < 0.25 or differences == 2:
        return -2 * (order + differences)
    return _exponent(np.diff(values), differences + 1)


def _transformed(samples: FloatArray) -> tuple[int, DctBins, FloatArray]:
    """Return how many samples were used, their bins and DCT-II ordinates."""
    used = max(fast_length(samples.size), 2)
    return used, dct_bins(used), dct_ordinates(samples[:used])


def _of_models(models: Sequence[GenericModel], question: _Question) -> FloatArray:
    """Return the degrees of freedom of each factor under its own model."""
    triples = zip(models, question.m.tolist(), question.terms.tolist(), strict=True)
    return np.array([model_edf(model, m, terms, question.estimator) for model, m, terms in triples])


def spectral_edf(
    power: FloatArray, bins: DctBins, m: IntArray, terms: FloatArray, estimator: Estimator
) -> FloatArray:
    """Return the degrees of freedom that the spectrum itself gives, without a model.

    With G the spectrum of the differences, EDF = M (mean G)² / mean G². The squared power of a bin
    of n_b ordinates is too large by 1 + 2/n_b on average, which is taken out.

    Parameters
    ----------
    power, bins
        Sums of squared DCT-II ordinates of each bin, shape (b,).
    m, terms
        Averaging factors and the number M of differences of each, shape (k,).
    estimator
        An overlapping one.
    """
    count = bins.count.astype(np.float64)
    level = power / count
    square = level**2 * count / (count + 2)
    edf = np.empty(m.size)
    for i, (factor, number) in enumerate(zip(m.tolist(), terms.tolist(), strict=True)):
        response, squared = power_response(bins, factor, estimator)
        first, second = float((count * response) @ level), float((count * squared) @ square)
        edf[i] = number * first**2 / (second * (bins.n - 1)) if second > 0 else number
    return edf


@lru_cache(maxsize=256)
def power_response(bins: DctBins, m: int, estimator: Estimator) -> tuple[FloatArray, FloatArray]:
    """Return an estimator's response H and its square, averaged over each bin, shape (b,).

    The variance is the mean of H S over all angular frequencies, S the spectrum per sample; for
    the Allan variance H = 2 sin(m w/2)^4 / (m sin(w/2))². Where a bin is wider than a ripple, the
    ripple's mean takes its place: the mean of (2 sin)^(2j) is the central binomial coefficient of j.
    Axes of one length share them; both are read-only.

    Source: NIST SP 1065 (2008), eq. 65, for sampled data.
    """
    order = estimator.order
    tail = (2 * np.sin(bins.omega / 2)) ** (-2 * estimator.integrations) / estimator.scale(m)
    ripple = (2 * np.sin(m * bins.omega / 2)) ** (2 * order)
    wide = bins.count * m * np.pi / bins.n > 1
    response = np.where(wide, comb(2 * order, order), ripple) * tail
    squared = np.where(wide, comb(4 * order, 2 * order), ripple**2) * tail**2
    return read_only(response), read_only(squared)


def excess_kurtosis(samples: FloatArray, neighbours: BoolArray | None = None) -> float:
    """Return the excess kurtosis of the differences of neighbouring samples; 0 where they are constant.

    `neighbours`, shape (n-1,), says which samples are followed by their neighbour; None for all.
    """
    if samples.size < 3:
        return 0.0
    if neighbours is None:
        return shared_number(samples, "excess kurtosis", lambda: _excess_kurtosis(samples, None))
    return _excess_kurtosis(samples, neighbours)


def _excess_kurtosis(samples: FloatArray, neighbours: BoolArray | None) -> float:
    mean = float((samples[-1] - samples[0]) / (samples.size - 1))
    count = second = fourth = 0.0
    for start in range(0, samples.size - 1, _BLOCK):
        stop = min(start + _BLOCK, samples.size - 1)
        part = samples[start + 1 : stop + 1] - samples[start:stop]
        part -= mean
        np.square(part, out=part)
        if neighbours is not None:
            part = part[neighbours[start:stop]]
        count += part.size
        second += float(part.sum())
        fourth += sum_of_squares(part)
    return count * fourth / second**2 - 3 if second > 0 else 0.0


def _less_for_heavy_tails(
    edf: FloatArray, question: _Question, neighbours: BoolArray | None = None
) -> FloatArray:
    """Widen for tails heavier than a Gaussian's: Var gains kappa/n where windows are not too few."""
    kappa = max(_HALVED * excess_kurtosis(question.samples, neighbours), _UNIFORM)
    n, order = question.samples.size, question.estimator.order
    independent = n - order * question.m + 1.0
    corrected = edf / (1 + kappa * edf / (2 * np.maximum(independent, 1)))
    return np.where(independent >= order * question.m, corrected, edf)


def gappy_degrees_of_freedom(
    series: AxisSeries, values: GappyVariances, estimator: Estimator, method: str
) -> FloatArray:
    """Return the degrees of freedom where samples are missing, shape (k,), each at least 1.

    There is no spectrum of a series with gaps to go by: ``hybrid`` and ``model`` take the generic
    model nearest to the curve, with as many differences as there are windows, less for what was taken
    out of their mean square.

    Raises
    ------
    ValueError
        If the method is unknown.
    """
    chosen = _method_named(method)
    question = _Question(samples=series.samples, m=values.m, terms=values.terms, estimator=estimator)
    if chosen is _greenhall:
        return np.maximum(_greenhall(question), 1.0)
    m = values.m.astype(np.float64)
    model = fit_curve(m, values.avar, np.maximum(values.terms / m, 1.0))
    edf = _of_models([model] * m.size, question) / values.inflation**2
    neighbours = np.diff(series.clock.grid()) == 1
    corrected: FloatArray = np.maximum(_less_for_heavy_tails(edf, question, neighbours), 1.0)
    return corrected
