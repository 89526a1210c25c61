"""Equivalent degrees of freedom of every value of a curve, by one of four methods.

hybrid
    Of the spectrum itself where the averaging time is short, of the generic model that fits it
    best where it is long, both corrected for heavy tails. The default.
model
    Of the generic model at every averaging time.
greenhall
    Of the power law that the lag-1 autocorrelation names at each averaging time, as other tools do.
eta3
    max(M / 2m, 1), as the GMWM packages do; too wide by 1.7 in log.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucal.allan.covariance import GenericModel, model_edf
from imucal.allan.dct import DctBins, bin_power, dct_bins, dct_ordinates, fast_length
from imucal.allan.estimators import Estimator
from imucal.allan.gaps import GappyVariances
from imucal.allan.generic import fit_curve, fit_spectrum
from imucal.allan.noise_id import named_laws
from imucal.allan.response import power_response
from imucal.allan.variance import sum_of_squares
from imucal.arrays import FloatArray, IntArray
from imucal.powerlaw import PowerLaw
from imucal.recording import AxisSeries

#: Up to n / 256 the spectrum has enough ordinates in the passband to need no model.
_CROSSOVER = 256

#: The kurtosis of a difference of two independent values is half of each one's.
_HALVED = 2.0

#: Excess kurtosis of a uniform distribution: the lightest tails that are believed.
_UNIFORM = -1.2

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
        ``hybrid``, ``model``, ``greenhall`` or ``eta3``.

    Returns
    -------
    Shape (k,), each at least 1.

    Raises
    ------
    ValueError
        If the method is unknown.

    Source: Greenhall & Riley (2003), PTTI 35; Percival & Walden (2000), ch. 8 (eta3, and the
    spectral form).
    """
    if method not in EDF_METHODS:
        msg = f"edf method {method!r} is not known: expected one of {', '.join(EDF_METHODS)}"
        raise ValueError(msg)
    terms = np.array([estimator.terms(samples.size, mi) for mi in m.tolist()], dtype=np.float64)
    question = _Question(samples=samples, m=m, terms=terms, estimator=estimator)
    edf: FloatArray = np.maximum(EDF_METHODS[method](question), 1.0)
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
        edf[~short] = _of_model(model, question, ~short)
    return _less_for_heavy_tails(edf, question)


def _model(question: _Question) -> FloatArray:
    _, bins, ordinates = _transformed(question.samples)
    model = fit_spectrum(ordinates, bin_power(ordinates, bins), bins)
    return _of_model(model, question, np.ones(question.m.size, dtype=bool))


def _greenhall(question: _Question) -> FloatArray:
    models = [
        GenericModel(variances=tuple(float(law is named) for law in PowerLaw))
        for named in named_laws(question.samples, question.m)
    ]
    triples = zip(models, question.m.tolist(), question.terms.tolist(), strict=True)
    return np.array([model_edf(model, m, terms, question.estimator) for model, m, terms in triples])


def _eta3(question: _Question) -> FloatArray:
    return question.terms / (2.0 * question.m if question.estimator.overlapping else 2.0)


#: Name -> method.
EDF_METHODS: dict[str, Callable[[_Question], FloatArray]] = {
    "hybrid": _hybrid,
    "model": _model,
    "greenhall": _greenhall,
    "eta3": _eta3,
}


def _transformed(samples: FloatArray) -> tuple[int, DctBins, FloatArray]:
    """Return how many samples were used, their bins and DCT-II ordinates."""
    used = max(fast_length(samples.size), 2)
    return used, dct_bins(used), dct_ordinates(samples[:used])


def _of_model(model: GenericModel, question: _Question, chosen: NDArray[np.bool_]) -> FloatArray:
    pairs = zip(question.m[chosen].tolist(), question.terms[chosen].tolist(), strict=True)
    return np.array([model_edf(model, m, terms, question.estimator) for m, terms in pairs])


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


def excess_kurtosis(samples: FloatArray, neighbours: NDArray[np.bool_] | None = None) -> float:
    """Return the excess kurtosis of the differences of neighbouring samples; 0 where they are constant.

    `neighbours`, shape (n-1,), says which samples are followed by their neighbour; None for all.
    """
    if samples.size < 3:
        return 0.0
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
    edf: FloatArray, question: _Question, neighbours: NDArray[np.bool_] | None = None
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
    if method not in EDF_METHODS:
        msg = f"edf method {method!r} is not known: expected one of {', '.join(EDF_METHODS)}"
        raise ValueError(msg)
    question = _Question(samples=series.samples, m=values.m, terms=values.terms, estimator=estimator)
    if method == "eta3":
        return np.maximum(_eta3(question), 1.0)
    if method == "greenhall":
        return np.maximum(_greenhall(question), 1.0)
    m = values.m.astype(np.float64)
    model = fit_curve(m, values.avar, np.maximum(values.terms / m, 1.0))
    edf = _of_model(model, question, np.ones(m.size, dtype=bool))
    edf /= values.inflation**2
    neighbours = np.diff(series.clock.grid()) == 1
    corrected: FloatArray = np.maximum(_less_for_heavy_tails(edf, question, neighbours), 1.0)
    return corrected
