"""Fit of a given model to the bins of a record, and its squared coefficients.

Squared coefficients may be negative: positive estimates of an absent term are too large on average. The
weights come from a spectrum with each weak term at one standard deviation (McCullagh & Nelder 1989,
Generalized Linear Models, 2nd ed., section 2.5). The standard deviation is a function of the coefficient:
deviations at the logs' own estimates would favour low estimates.
"""

import math
from dataclasses import dataclass

import numpy as np

from imucal.allan.intervals import score_variances
from imucal.arrays import FloatArray
from imucal.fitting.bins import Bins
from imucal.fitting.homogeneity import symbol_of, widened
from imucal.fitting.noise_fit import Estimate
from imucal.fitting.spectral.blocks import ordinates_of
from imucal.fitting.spectral.bounds import completed, estimate_or_bound, numbered, with_absent
from imucal.fitting.spectral.disturbances.band_search import find_band
from imucal.fitting.spectral.estimates import Problem, misfits_of
from imucal.fitting.spectral.likelihood import Fits, derivatives
from imucal.fitting.spectral.maximum import misfit
from imucal.fitting.spectral.models import Structure, richest
from imucal.fitting.spectral.ordinates import SHAPED
from imucal.fitting.spectral.selection import choose


@dataclass(frozen=True, kw_only=True, eq=False)
class BinFit:
    """A model fitted to the bins of a record, up to the end of the band, in one scale.

    `whole` is the fit of the given terms and of N, B and K. `misfits` maps symbols to the factors by which a
    misfit widens their limits.
    """

    problem: Problem
    whole: Fits
    estimates: tuple[Estimate, ...]
    misfits: dict[str, float]


def fit_bins(bins: Bins, structure: Structure, *, level: float, near: float | None = None) -> BinFit:
    """Return the fit of a structure to the bins of a record, like `fit_mle`.

    `near` is the end of a known band that is not flat, as a fraction of Nyquist.
    """
    every = ordinates_of(bins)
    band = find_band(every, richest(structure), near=near, given=structure)
    seen = band.select(every)
    problem = Problem(
        ordinates=seen,
        level=level,
        tau0=bins.tau0,
        widening={"N": bins.widening},
    )
    choice = choose(seen, [structure], criterion="bic", band=band)
    fitted, own = estimate_or_bound(problem, choice)
    found = misfit(seen, fitted)
    estimates, _ = numbered(with_absent(problem, fitted, own), ())
    misfits = misfits_of(problem, fitted, found)
    return BinFit(
        problem=problem,
        whole=completed(problem, choice.fits),
        estimates=widened(estimates, None, misfits),
        misfits=misfits,
    )


#: Gain in log-likelihood that ends the search for squared coefficients: far below any error.
_CLOSE = 1e-9
#: Largest number of rounds of the reference.
_ROUNDS = 100
#: Deviations subtracted from an estimate before it enters the weights.
_SURE = 2.0
#: A deviation's growth is computed up to the estimate, at least this many deviations.
_FAR = 4.0
#: Least size of the other terms in this computation.
_FLOOR = 0.5


@dataclass(frozen=True, kw_only=True)
class SquaredCoefficient:
    """The estimate of a squared coefficient in SI², which may be negative.

    Its standard deviation is ``deviation + growth * square`` for a true value `square`.
    """

    value: float
    deviation: float
    growth: float


def squared_coefficients(found: BinFit) -> dict[str, SquaredCoefficient]:
    """Return the squared coefficient of each term of a fit except the ramp, by its key.

    The deviations include the errors of correlation times and response.
    """
    problem, fitted = found.problem, found.whole
    ordinates, models = problem.ordinates, fitted.models
    columns = fitted.variances()
    places = list(columns.values())
    unit = fitted.theta.copy()
    unit[:, : models.variances] = 0.0
    slopes = derivatives(ordinates, models, unit)
    power = np.maximum(ordinates.rest(fitted.beta[0]), 1e-9 * ordinates.power)
    start = np.exp(fitted.theta[0, places])
    peak, _ = score_variances(slopes[places], power, ordinates.size, start, _signed, close=_CLOSE)
    reference = _reference(slopes[places], ordinates.size, peak)
    spectrum = reference @ slopes[places]
    weight = 0.5 * ordinates.size / spectrum**2
    variance = _inverse(slopes[places], weight) @ (slopes[places] @ (weight * power / ordinates.size))
    first, whole = models.variances, slopes[: models.variances].sum(axis=0)
    level = dict(zip(places, reference.tolist(), strict=True))
    times = np.flatnonzero(models.free[0, first : models.response]).tolist()
    times_of = [level[SHAPED + term] * slopes[first + term] for term in times]
    response = models.response + np.arange(int(models.poles[0]))
    nuisance = np.array([*times_of, *(slopes[response] / whole * spectrum)]).reshape(-1, spectrum.size)
    laws = _deviation_laws(np.concatenate([slopes[places], nuisance]), ordinates.size, spectrum, variance)
    result = {}
    for key, value, (deviation, growth) in zip(columns, variance.tolist(), laws, strict=True):
        symbol = symbol_of(key)
        scale = problem.deviation(symbol) ** 2
        wider = problem.widening.get(symbol, 1.0) * found.misfits.get(symbol, 1.0)
        result[key] = SquaredCoefficient(
            value=scale * value, deviation=scale * wider * deviation, growth=wider * growth
        )
    return result


def _reference(shapes: FloatArray, size: FloatArray, peak: FloatArray) -> FloatArray:
    """Return the variances, shape (t,), for the weights: weak ones are replaced by their deviation."""
    reference = np.maximum(peak, _deviations(shapes, size, np.maximum(peak, 0.0) @ shapes))
    for _ in range(_ROUNDS):
        deviation = _deviations(shapes, size, reference @ shapes)
        wanted = np.maximum(deviation, peak - _SURE * deviation)
        if np.allclose(wanted, reference, rtol=1e-6):
            break
        reference = np.sqrt(reference * wanted)
    return reference


def _deviation_laws(
    slopes: FloatArray, size: FloatArray, spectrum: FloatArray, variance: FloatArray
) -> list[tuple[float, float]]:
    """Return deviation at zero and growth of each of the estimates `variance`, shape (t,).

    One term has a chosen value and the others their most likely values given it.
    """
    count = variance.size
    weight = 0.5 * size / spectrum**2
    gain = _inverse(slopes, weight)[:count] @ (slopes * weight)
    own = (gain * (2 * spectrum**2 / size)) @ gain.T
    deviation = np.sqrt(np.diag(own))
    laws = []
    for term in range(count):

        def at(square: float, term: int = term) -> float:
            others = variance + own[:, term] / own[term, term] * (square - variance[term])
            held = np.maximum(others, _FLOOR * deviation)
            held[term] = square
            return math.sqrt(float(np.sum((gain[term] * (held @ slopes[:count])) ** 2 * 2 / size)))

        absent = at(0.0)
        present = max(float(variance[term]), _FAR * absent)
        laws.append((absent, max(at(present) - absent, 0.0) / present))
    return laws


def _signed(slopes: FloatArray, level: FloatArray, count: FloatArray) -> FloatArray:
    return np.asarray(_inverse(slopes, count) @ (slopes @ (count * level)))


def _inverse(slopes: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the inverse of the slopes' information, a pseudo-inverse if some are collinear."""
    information = np.einsum("ib,b,jb->ij", slopes, weight, slopes)
    root = np.sqrt(np.maximum(np.diag(information), 1e-300))
    both = np.outer(root, root)
    return np.asarray(np.linalg.pinv(information / both, rcond=1e-12, hermitian=True) / both)


def _deviations(slopes: FloatArray, size: FloatArray, spectrum: FloatArray) -> FloatArray:
    inverse = _inverse(slopes, 0.5 * size / spectrum**2)
    return np.asarray(np.sqrt(np.maximum(np.diag(inverse), 0.0)))
