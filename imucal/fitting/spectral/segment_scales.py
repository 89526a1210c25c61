"""Likelihood of spectra in segments of which two parts may be stronger or weaker than in the whole.

The parts have known shapes and unknown scales: one that is tested, and one that is free beside it in
each segment. Fisher scoring is then a 2 x 2 system a segment, and with the tested scale in common one
more unknown. Twice the drop of the likelihood from free to common is the test of homogeneity, the
chi-squared counterpart of Bartlett's test of equal variances.

Source: Bartlett (1937), Proc. R. Soc. A 160, 268.
"""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, IntArray

#: Logs of the scales stay above this: what is lower is invisible.
_LEAST = -18.0
#: Longest step of a log, and most steps.
_STEP, _STEPS = 1.5, 60
#: Gain of the log-likelihood that ends the search.
_CLOSE = 1e-4
_TINY = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scales:
    """Where the likelihood is greatest.

    Attributes
    ----------
    tested, beside
        Logs of the scales of both parts in each segment, shape (s,).
    objective
        -log L of all segments, less a constant.
    matrix
        Expected information of both logs: of `tested`, of both, of `beside`; shape (3, s).
    """

    tested: FloatArray
    beside: FloatArray
    objective: float
    matrix: FloatArray

    @property
    def information(self) -> FloatArray:
        """Information on `tested` with `beside` unknown, shape (s,)."""
        tested, both, beside = self.matrix
        own: FloatArray = tested - both**2 / (beside + _TINY)
        return own


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Parts:
    """The spectra of one test: what is held, what is tested, what varies beside it, shape (b,) each."""

    held: FloatArray
    tested: FloatArray
    beside: FloatArray
    size: FloatArray
    power: FloatArray
    first: IntArray

    def total(self, values: FloatArray) -> FloatArray:
        """Return the sum over each segment's bins, shape (s,)."""
        summed: FloatArray = np.add.reduceat(values, self.first)
        return summed

    def spread(self, values: FloatArray) -> FloatArray:
        """Return a segment's value at each of its bins, shape (b,)."""
        return np.repeat(values, np.diff(self.first, append=self.size.size))


def fit_scales(parts: Parts, *, common: bool) -> Scales:
    """Maximise the likelihood, the tested part the same in all segments where `common`."""
    count = parts.first.size
    theta = np.zeros((2, count))
    objective, gradient, matrix = _evaluate(parts, theta)
    shrink = np.ones(count)
    for _ in range(_STEPS):
        step = _step(gradient, matrix, common=common)
        trial = np.maximum(theta + shrink * step, _LEAST)
        found, slope, information = _evaluate(parts, trial)
        gain = objective - found
        if common:
            gain = np.full(count, gain.sum() / count)
        better = gain >= -_TINY * np.abs(objective)
        theta = np.where(better, trial, theta)
        objective = np.where(better, found, objective)
        gradient = np.where(better, slope, gradient)
        matrix = np.where(better, information, matrix)
        shrink = np.where(better, np.minimum(2 * shrink, 1.0), shrink / 4)
        if np.all(np.where(better, gain < _CLOSE, shrink < 1e-4)):
            break
    return Scales(tested=theta[0], beside=theta[1], objective=float(objective.sum()), matrix=matrix)


def scales_at(parts: Parts, tested: FloatArray, beside: FloatArray) -> Scales:
    """Return the likelihood at given logs of the scales, shape (s,) each."""
    objective, _, matrix = _evaluate(parts, np.array([tested, beside]))
    return Scales(tested=tested, beside=beside, objective=float(objective.sum()), matrix=matrix)


def _evaluate(parts: Parts, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return -log L (s,), its gradient (2, s) and the information's three entries (3, s)."""
    tested, beside = (parts.spread(np.exp(row)) for row in theta)
    tested, beside = tested * parts.tested, beside * parts.beside
    spectrum = parts.held + tested + beside
    ratio = parts.power / spectrum
    objective = 0.5 * parts.total(parts.size * np.log(spectrum) + ratio)
    tested, beside = tested / spectrum, beside / spectrum
    rest = 0.5 * (parts.size - ratio)
    gradient = np.array([parts.total(tested * rest), parts.total(beside * rest)])
    weight = 0.5 * parts.size
    pairs = ((tested, tested), (tested, beside), (beside, beside))
    return objective, gradient, np.array([parts.total(weight * a * b) for a, b in pairs])


def _step(gradient: FloatArray, matrix: FloatArray, *, common: bool) -> FloatArray:
    """Return the scoring step of both logs in each segment, shape (2, s)."""
    tested, both, beside = matrix[0] * (1 + 1e-9) + _TINY, matrix[1], matrix[2] * (1 + 1e-9) + _TINY
    left = gradient[0] - both / beside * gradient[1]
    rest = np.maximum(tested - both**2 / beside, _TINY)
    first = -left / rest
    if common:
        first = np.full(first.size, -left.sum() / rest.sum())
    first = np.clip(first, -_STEP, _STEP)
    second = np.clip(-(gradient[1] + both * first) / beside, -_STEP, _STEP)
    return np.array([first, second])
