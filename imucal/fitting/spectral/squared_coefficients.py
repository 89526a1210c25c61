"""The variance of each term, also below zero: what a weak term's likelihood is nearly normal in.

A fit keeps variances positive, and so an absent term is never zero on average. The spectrum is linear in
the variances: with weights that do not follow the low ordinates, weighted least squares have no bias. The
weights are those of a spectrum that holds each weak term at one standard deviation.

The deviation of an estimate grows with the coefficient. It is given as a law, not at the estimate: who
weights many logs by deviations at their own estimates prefers those that drew low. Of a term told by two to
four deviations, such a mean was half to one deviation of a log too low, however many the logs.

Source: McCullagh & Nelder (1989), Generalized Linear Models, 2nd ed., section 2.5 (the weights of gamma
errors with identity link).
"""

import math
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.spectral.bin_fit import BinFit
from imucal.fitting.spectral.estimates import Fitted
from imucal.fitting.spectral.likelihood import derivatives
from imucal.fitting.spectral.ordinates import MARKOV, Ordinates
from imucal.fitting.spectral.structures import parameter_columns

_ROUNDS = 100
#: The search is at rest when a step gains less log-likelihood.
_REST = 1e-9
#: What is beyond so many deviations of an estimate is sure, and in the weights.
_SURE = 2.0
#: A law is taken at zero and at the estimate, or at so many deviations.
_FAR = 4.0
#: Beside the term that a law is of, a weak one is so many of its deviations at least.
_FLOOR = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class SquaredCoefficient:
    """The estimate of a squared coefficient in SI², which may be negative, and its law.

    Attributes
    ----------
    value
        The estimate.
    deviation
        Its standard deviation where the coefficient is zero.
    growth
        By how much that grows with the square: it is ``deviation + growth * square``.
    """

    value: float
    deviation: float
    growth: float


def squared_coefficients(found: BinFit) -> dict[str, SquaredCoefficient]:
    """Return the squared coefficient of each term of a fit but the ramp, by its key.

    Correlation times and the output filter's response stay where the fit has them; the deviations allow
    for their errors. They are wider, as the fit's limits are, for an excess kurtosis and for a misfit.
    """
    problem, fitted = found.problem, found.whole
    ordinates, candidate = problem.ordinates, fitted.candidate
    room = candidate.room_markov
    columns = [
        (name, column) for name, column in parameter_columns(fitted.structure, room) if column < MARKOV + room
    ]
    places = [column for _, column in columns]
    unit = fitted.maximum.theta.copy()
    unit[:, : MARKOV + room] = 0.0
    slopes = derivatives(ordinates, candidate, unit)
    power = _rest(ordinates, fitted.maximum.beta[0])
    start = np.exp(fitted.maximum.theta[0, places])
    peak = _search(slopes[places], ordinates.size, power, start)
    reference = _reference(slopes[places], ordinates.size, peak)
    spectrum = reference @ slopes[places]
    weight = 0.5 * ordinates.size / spectrum**2
    variance = _solve(slopes[places], weight, weight * power / ordinates.size)
    beside = _nuisance(slopes, fitted, dict(zip(places, reference.tolist(), strict=True)), spectrum)
    laws = _laws(np.concatenate([slopes[places], beside]), ordinates.size, spectrum, variance)
    result = {}
    for (name, _), value, (deviation, growth) in zip(columns, variance.tolist(), laws, strict=True):
        key = name.partition(".")[0]
        symbol = key.rstrip("0123456789")
        scale = problem.deviation(symbol) ** 2
        wider = problem.widening.get(symbol, 1.0) * found.misfits.get(symbol, 1.0)
        result[key] = SquaredCoefficient(
            value=scale * value, deviation=scale * wider * deviation, growth=wider * growth
        )
    return result


def _rest(ordinates: Ordinates, beta: FloatArray) -> FloatArray:
    """Return the squares that the regressors leave in each bin, shape (b,)."""
    drift: FloatArray = -2 * beta @ ordinates.cross + np.einsum("i,ijb,j->b", beta, ordinates.gram, beta)
    return np.maximum(ordinates.power + drift, 1e-9 * ordinates.power)


def _search(shapes: FloatArray, size: FloatArray, power: FloatArray, variance: FloatArray) -> FloatArray:
    """Return the variances, shape (t,), of the shapes, shape (t, b), where the likelihood is greatest."""

    def objective(spectrum: FloatArray) -> float:
        if spectrum.min() <= 0:
            return np.inf
        return 0.5 * float(np.sum(size * np.log(spectrum) + power / spectrum))

    spectrum = variance @ shapes
    now = objective(spectrum)
    for _ in range(_ROUNDS):
        weight = 0.5 * size / spectrum**2
        step = _solve(shapes, weight, (0.5 * (power - size * spectrum) / spectrum**2))
        stride = 1.0
        while stride > 1e-6 and not (then := objective((variance + stride * step) @ shapes)) < now:
            stride /= 2
        if stride <= 1e-6:
            break
        variance = variance + stride * step
        spectrum, gain, now = variance @ shapes, now - then, then
        if gain < _REST:
            break
    return variance


def _reference(shapes: FloatArray, size: FloatArray, peak: FloatArray) -> FloatArray:
    """Return the variances, shape (t,), of which weights are made: a weak one is its own deviation."""
    reference = np.maximum(peak, _deviations(shapes, size, np.maximum(peak, 0.0) @ shapes))
    for _ in range(_ROUNDS):
        deviation = _deviations(shapes, size, reference @ shapes)
        wanted = np.maximum(deviation, peak - _SURE * deviation)
        if np.allclose(wanted, reference, rtol=1e-6):
            break
        reference = np.sqrt(reference * wanted)
    return reference


def _solve(shapes: FloatArray, weight: FloatArray, residual: FloatArray) -> FloatArray:
    information = np.einsum("ib,b,jb->ij", shapes, weight, shapes)
    root = np.sqrt(np.diag(information))
    score = shapes @ residual / root
    step: FloatArray = np.linalg.lstsq(information / np.outer(root, root), score, rcond=1e-12)[0] / root
    return step


def _nuisance(
    slopes: FloatArray, fitted: Fitted, variance: dict[int, float], spectrum: FloatArray
) -> FloatArray:
    """Return the derivatives of the spectrum in correlation times and response, shape (j, b)."""
    candidate = fitted.candidate
    room, markov = candidate.room_markov, fitted.structure.count("GM")
    times = [variance[MARKOV + i] * slopes[MARKOV + room + i] for i in range(markov)]
    first = MARKOV + 2 * room
    whole = slopes[: MARKOV + room].sum(axis=0)
    response = [slopes[first + i] / whole * spectrum for i in range(int(candidate.poles[0]))]
    return np.array([*times, *response]).reshape(-1, spectrum.size)


def _laws(
    slopes: FloatArray, size: FloatArray, spectrum: FloatArray, variance: FloatArray
) -> list[tuple[float, float]]:
    """Return deviation at zero and growth of each of the estimates `variance`, shape (t,).

    `slopes`, shape (t + j, b), has the other parameters after them. The weights are those of `spectrum`; the
    spectrum itself has one term at a place to choose, and the others where they are most likely then. So the
    law does not follow the estimate, with which those of the others move.
    """
    count = variance.size
    weight = 0.5 * size / spectrum**2
    gain = _inverse(np.einsum("ib,b,jb->ij", slopes, weight, slopes))[:count] @ (slopes * weight)
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


def _inverse(information: FloatArray) -> FloatArray:
    root = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse: FloatArray = np.linalg.pinv(
        information / np.outer(root, root), rcond=1e-12, hermitian=True
    ) / np.outer(root, root)
    return inverse


def _deviations(slopes: FloatArray, size: FloatArray, spectrum: FloatArray) -> FloatArray:
    """Return standard deviations from the expected information, shape of the slopes' rows."""
    information = np.einsum("ib,b,jb->ij", slopes, 0.5 * size / spectrum**2, slopes)
    deviations: FloatArray = np.sqrt(np.maximum(np.diag(_inverse(information)), 0.0))
    return deviations
