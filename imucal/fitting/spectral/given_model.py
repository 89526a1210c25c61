"""Fit of a given model to stored bins of one record or of several jointly.

A likelihood ratio tests whether records of one sensor have the same coefficient (Wilks 1938, Annals of
Mathematical Statistics 9, 60). The other terms are free in each record.

Squared coefficients may be negative: positive estimates of an absent term are too large on average. The
weights come from a spectrum with each weak term at one standard deviation (McCullagh & Nelder 1989,
Generalized Linear Models, 2nd ed., section 2.5). The standard deviation is a function of the coefficient:
deviations at the logs' own estimates would favour low estimates.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from imucal.allan.intervals import score_variances
from imucal.arrays import FloatArray
from imucal.fitting.bins import Bins
from imucal.fitting.homogeneity import symbol_of, widened
from imucal.fitting.noise_fit import Estimate, Goodness
from imucal.fitting.spectral.blocks import joined, ordinates_of
from imucal.fitting.spectral.bounds import completed, estimate_or_bound, numbered, with_absent
from imucal.fitting.spectral.common_terms import Parts, visible
from imucal.fitting.spectral.disturbances.band import Band
from imucal.fitting.spectral.disturbances.band_search import find_band, flat_band
from imucal.fitting.spectral.estimates import Problem, misfits_of, model_of
from imucal.fitting.spectral.likelihood import Fits, derivatives
from imucal.fitting.spectral.maximum import bounds, misfit
from imucal.fitting.spectral.models import Structure, richest
from imucal.fitting.spectral.ordinates import SHAPED, Ordinates
from imucal.fitting.spectral.selection import choose
from imucal.frozen import frozen, frozen_alone
from imucal.noise.model import NoiseModel


@frozen_alone
class BinFit:
    """A model fitted to the bins of some records, up to the end of the band, in one scale.

    `problem` joins all records. `whole` is the fit of the given terms and of N, B and K. `misfits` maps
    symbols to the factors by which a misfit widens their limits.
    """

    records: tuple[Ordinates, ...]
    problem: Problem
    band: Band
    whole: Fits
    model: NoiseModel
    estimates: tuple[Estimate, ...]
    goodness: Goodness
    misfits: dict[str, float]


def fit_bins(
    bins: Sequence[Bins], structure: Structure, *, level: float, near: float | None = None
) -> BinFit:
    """Return the fit of a structure to one or several records, like `fit_mle` with given bins.

    `near` is the end of a known band that is not flat, as a fraction of Nyquist.
    """
    parts = [ordinates_of(one) for one in bins]
    every = joined(parts) if len(parts) > 1 else parts[0]
    band = _band(every, parts, structure, near)
    seen = band.select(every)
    # Half the excess kurtosis plus one.
    surplus = np.average([one.widening**2 for one in bins], weights=[one.size.sum() for one in bins])
    problem = Problem(
        ordinates=seen,
        level=level,
        tau0=bins[0].tau0,
        widening={"N": float(np.sqrt(surplus))},
    )
    choice = choose(seen, [structure], criterion="bic", band=band)
    fitted, own = estimate_or_bound(problem, choice)
    whole = completed(problem, choice.fits)
    found = misfit(seen, fitted)
    estimates, _ = numbered(with_absent(problem, fitted, own), ())
    owner = np.repeat(np.arange(len(parts)), [one.size.size for one in parts])
    edges = [band.select(every[owner == i]) for i in range(len(parts))]
    misfits = misfits_of(problem, fitted, found)
    return BinFit(
        records=tuple(edges),
        problem=problem,
        band=band,
        whole=whole,
        model=model_of(problem, fitted, own),
        estimates=widened(estimates, None, misfits),
        goodness=found,
        misfits=misfits,
    )


def _band(every: Ordinates, parts: Sequence[Ordinates], structure: Structure, near: float | None) -> Band:
    """Return the band and response of all records; flat if most records are flat by themselves.

    Records with different coefficients may jointly resemble an output filter.
    """
    rich = richest(structure)
    if near is not None or len(parts) == 1:
        return find_band(every, rich, near=near, given=structure)
    if flat := flat_band(every, rich, given=structure):
        return flat
    alone = [band for part in parts if (band := flat_band(part, rich, given=structure))]
    return alone[0] if 2 * len(alone) > len(parts) else find_band(every, rich, given=structure)


#: Information on a log coefficient below which it is undetermined.
_NONE = 1e-8
#: Distance of a log variance from its lower bound below which a term is absent.
_RAISED = 8.0


@frozen_alone
class RecordTest:
    """The test of one term over r records.

    `statistic` is twice the drop of the log-likelihood with one coefficient for all records, chi-squared
    with r - 1 degrees of freedom if they share it. `values` are the records' coefficients in SI, shape (r,).
    `log_deviations` are the standard errors of their logarithms, inf if undetermined.
    """

    key: str
    symbol: str
    statistic: float
    dof: int
    p_value: float
    values: FloatArray
    log_deviations: FloatArray


def record_tests(fit: BinFit) -> tuple[RecordTest, ...]:
    """Return the test of each term of a joint fit except the ramp; () for a single record."""
    if len(fit.records) < 2:
        return ()
    fitted, dof = fit.whole, len(fit.records) - 1
    terms = fitted.variances()
    parts, logs = _parts(fit, list(terms.values()))
    free, common = (parts.fit(common=held) for held in (False, True))
    tests = []
    for row, (key, column) in enumerate(terms.items()):
        symbol, information = symbol_of(key), free.information[row]
        surplus = fit.problem.widening.get(symbol, 1.0) ** 2
        statistic = max(2 * float(np.sum(common.objective[row] - free.objective[row])) / surplus, 0.0)
        deviations = np.where(information > _NONE, np.exp((logs[column] + free.logs[row, :, 0]) / 2), 0.0)
        with np.errstate(divide="ignore"):
            errors = 0.5 * np.sqrt(surplus / np.where(information > _NONE, information, 0.0))
        tests.append(
            RecordTest(
                key=key,
                symbol=symbol,
                statistic=statistic,
                dof=dof,
                p_value=float(scipy.special.chdtrc(dof, statistic)),
                values=fit.problem.deviation(symbol) * deviations,
                log_deviations=errors,
            )
        )
    return tuple(tests)


def _parts(fit: BinFit, columns: list[int]) -> tuple[Parts, FloatArray]:
    """Return the parts of each term's test, and the logs of their variances."""
    models, theta = fit.whole.models, fit.whole.theta
    joint, count = Ordinates.joined(fit.records), len(fit.records)
    owner = np.repeat(np.arange(count), [one.size.size for one in fit.records])
    rows = np.concatenate([np.zeros(count, dtype=np.int64), np.arange(1, len(joint.regressors))])
    own = np.ones((rows.size, owner.size))
    own[:count] = owner == np.arange(count)[:, np.newaxis]
    spectra = derivatives(joint, models, theta)[: models.variances]
    low, _ = bounds(fit.problem.ordinates, models)
    absent = [column for column in columns if theta[0, column] < low[column] + _RAISED]
    factor = visible(spectra, absent)
    varied = [[one, *(column for column in columns if column != one)] for one in columns]
    parts = Parts(
        ordinates=replace(
            joint,
            cross=joint.cross[rows] * own,
            gram=joint.gram[np.ix_(rows, rows)] * own * own[:, np.newaxis],
        ),
        regressors=models.regressors[0, rows],
        first=np.flatnonzero(np.diff(owner, prepend=-1)),
        varied=(factor[:, np.newaxis] * spectra)[np.array(varied)],
        held=np.zeros((len(columns), owner.size)),
    )
    return parts, theta[0, : models.variances] + np.log(factor)


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


@frozen
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
