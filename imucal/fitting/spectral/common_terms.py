"""Likelihood-ratio test of a term that several records, or segments of one record, may have in common.

A spectrum is the sum of a fixed part, the tested part, and free parts. Each group of bins (a record or a
segment) has its own scale of every part except the fixed one. If the scale of the tested part is equal in all
groups, twice the drop of the log-likelihood is chi-squared with one degree of freedom less than groups.

Source: Wilks (1938), Annals of Mathematical Statistics 9, 60; of variances, Bartlett (1937), Proc. R. Soc. A
160, 268.
"""

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.spectral.likelihood import regress
from imucal.fitting.spectral.ordinates import Ordinates

#: Lower bound of the logs of the scales.
_INVISIBLE = -30.0
#: Starting value of an absent part, as a share of the spectrum.
_SHARE = 0.1
#: Longest step of a log.
_STEP = 1.5
#: Largest number of steps.
_STEPS = 100
#: Gain of the log-likelihood that ends the search.
_CLOSE = 1e-5
#: First end of the scan of scale 2, in its deviations; each next one is 1.5 times as far.
_FIRST_REACH = 1.2
#: Number of ends to try on each side.
_WIDER = 12
#: Grid points between the ends.
_GRID = 32
#: Scoring steps of scale 1 at each point: it starts near its maximum.
_SCORINGS = 3
_TINY = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class Parts:
    """The spectra of t tests over g groups of bins, b bins in all.

    `first`, shape (g,), is the index of each group's first bin. `regressors`, shape (r,), is the mask of the
    regressors to remove. `varied`, shape (t, q, b), are the scaled parts of each test, the tested part first,
    and `held`, shape (t, b), is the fixed part.
    """

    ordinates: Ordinates
    regressors: BoolArray
    first: IntArray
    varied: FloatArray
    held: FloatArray

    def total(self, values: FloatArray) -> FloatArray:
        """Return the sum over each group's bins."""
        return np.asarray(np.add.reduceat(values, self.first, axis=-1))

    def at(self, logs: FloatArray) -> "Scales":
        """Return the likelihood at given logs of the scales, shape (t, g, q)."""
        size, count = self.ordinates.size, np.diff(self.first, append=self.ordinates.size.size)
        parts = np.repeat(np.exp(logs), count, axis=1).swapaxes(1, 2) * self.varied
        spectrum = self.held + parts.sum(axis=1)
        use = np.tile(self.regressors, (len(spectrum), 1))
        ratio = regress(self.ordinates, use, spectrum)[2] / spectrum
        parts /= spectrum[:, np.newaxis]
        matrix = np.empty((*logs.shape, logs.shape[2]))
        for i, j in combinations_with_replacement(range(logs.shape[2]), 2):
            matrix[..., i, j] = matrix[..., j, i] = self.total(0.5 * size * parts[:, i] * parts[:, j])
        return Scales(
            logs=logs,
            objective=0.5 * self.total(size * np.log(spectrum) + ratio),
            gradient=self.total(0.5 * (size - ratio)[:, np.newaxis] * parts).swapaxes(1, 2),
            matrix=matrix,
        )

    def fit(self, *, common: bool) -> "Scales":
        """Maximise the likelihood; if `common`, all groups share the tested scale."""
        tests, count, _ = self.varied.shape
        best = self.at(np.zeros((tests, self.first.size, count)))
        damping = np.full(best.objective.shape, 1e-3)
        for _ in range(_STEPS):
            found = self.at(np.maximum(best.logs + best.step(damping, common=common), _INVISIBLE))
            moved, gain = np.max(np.abs(found.logs - best.logs), axis=2), best.objective - found.objective
            if common:
                gain = np.broadcast_to(gain.sum(axis=1, keepdims=True), gain.shape)
                moved = np.broadcast_to(moved.max(axis=1, keepdims=True), gain.shape)
            better = gain >= -_TINY * np.abs(best.objective)
            best = found.where(better, best)
            damping = np.where(better, np.maximum(damping * 0.2, 1e-9), damping * 6)
            rests = (gain < _CLOSE) & (moved < 1e-3) | (gain < 0.01 * _CLOSE)
            if np.all(np.where(better, rests, damping > 1e7)):
                break
        return best

    def of(self, test: int) -> "Parts":
        rows = slice(test, test + 1)
        return replace(self, varied=self.varied[rows], held=self.held[rows])

    def sum_limits(
        self, logs: FloatArray, weights: FloatArray, reach: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return a weighted sum of the two scales of one test in each group, and its limits, shape (g,) each.

        The limits are the extremes over all scales at which twice the drop of the log-likelihood is below
        `reach`²: an expansion is wrong if one scale is near zero.
        """
        best = self.at(logs[np.newaxis])
        tested, others = np.moveaxis(best.logs[0], -1, 0)
        steps = _FIRST_REACH * 1.5 ** np.arange(_WIDER)[:, np.newaxis]
        tried = np.concatenate([np.exp(np.maximum(others, -2.0) / 2) * steps, np.exp(others / 2) / steps])
        inside = 2 * (self._at_second(tried, tested).objective - best.objective) < reach**2
        inside[-1] = False
        tried[-1] = 0.0
        out = [np.argmin(inside[:_WIDER], axis=0), _WIDER + np.argmin(inside[_WIDER:], axis=0)]
        top, bottom = np.take_along_axis(tried, np.array(out), axis=0)
        found = self._at_second(bottom + np.linspace(0.0, 1.0, _GRID)[:, np.newaxis] * (top - bottom), tested)
        peak = np.minimum(best.objective, found.objective.min(axis=0))
        left = reach**2 - 2 * (found.objective - peak)
        width = np.sqrt(np.maximum(left, 0.0) / (found.matrix[..., 0, 0] + _TINY))
        fast, slow = np.moveaxis(weights * np.exp(found.logs), -1, 0)
        # A flat curve extends to infinity.
        with np.errstate(over="ignore"):
            ends = np.where(left >= 0, fast * np.exp([-width, width]) + slow, np.nan)
        # Interpolate between the grid points.
        share = left[:-1] / (left[:-1] - left[1:])
        crossing = (fast + slow)[:-1] + share * np.diff(fast + slow, axis=0)
        crossing[left[:-1] * left[1:] > 0] = np.nan
        value = weights @ np.exp(best.logs[0].T)
        every = np.concatenate([*ends, crossing, value[np.newaxis]])
        return value, np.nanmin(every, axis=0), np.nanmax(every, axis=0)

    def _at_second(self, deviations: FloatArray, tested: FloatArray) -> "Scales":
        logs = np.empty((*deviations.shape, 2))
        logs[..., 0], logs[..., 1] = tested, 2 * np.log(np.maximum(deviations, np.exp(_INVISIBLE / 2)))
        for _ in range(_SCORINGS):
            found = self.at(logs)
            logs[..., 0] -= np.clip(found.gradient[..., 0] / (found.matrix[..., 0, 0] + _TINY), -1.0, 1.0)
        return self.at(logs)


@dataclass(frozen=True, kw_only=True, eq=False)
class Scales:
    """The likelihood at some scales of each group in each test.

    `logs`, shape (t, g, q), have the tested scale first. `objective`, shape (t, g), is -log L less a
    constant, `gradient` its gradient, and `matrix`, shape (t, g, q, q), the expected information.
    """

    logs: FloatArray
    objective: FloatArray
    gradient: FloatArray
    matrix: FloatArray

    def where(self, chosen: BoolArray, other: "Scales") -> "Scales":
        return Scales(
            logs=np.where(chosen[..., None], self.logs, other.logs),
            objective=np.where(chosen, self.objective, other.objective),
            gradient=np.where(chosen[..., None], self.gradient, other.gradient),
            matrix=np.where(chosen[..., None, None], self.matrix, other.matrix),
        )

    @property
    def information(self) -> FloatArray:
        """Information on the log of the tested scale, shape (t, g)."""
        return self._eliminated(np.zeros(self.objective.shape))[1]

    def _eliminated(self, damping: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return gradient and information of the tested scale, (t, g) each, with the others eliminated.

        The third result, shape (t, g, q-1, 2), are the steps of the others: alone, and per tested step.
        """
        diagonal = np.diagonal(self.matrix, axis1=2, axis2=3)
        added = diagonal * 1e-9 + damping[..., None] * (diagonal + 1e-3) + _TINY
        matrix = self.matrix + added[..., None] * np.eye(diagonal.shape[2])
        across, right = matrix[..., 0, 1:], np.stack([self.gradient[..., 1:], matrix[..., 1:, 0]], axis=-1)
        moves: FloatArray = np.linalg.solve(matrix[..., 1:, 1:], right).astype(np.float64, copy=False)
        reduced = np.einsum("tgq,tgqk->ktg", across, moves)
        return self.gradient[..., 0] - reduced[0], np.maximum(matrix[..., 0, 0] - reduced[1], _TINY), moves

    def step(self, damping: FloatArray, *, common: bool) -> FloatArray:
        """Return the scoring step of all logs, shape (t, g, q), damped as in `maximum`."""
        left, rest, moves = self._eliminated(damping)
        if common:
            left, rest = (np.broadcast_to(x.sum(axis=1, keepdims=True), x.shape) for x in (left, rest))
        tested = np.clip(-left / rest, -_STEP, _STEP)[..., None]
        others = -moves[..., 0] - moves[..., 1] * tested
        return np.concatenate([tested, np.clip(others, -_STEP, _STEP)], axis=-1)


def visible(spectra: FloatArray, absent: list[int]) -> FloatArray:
    """Return factors, shape (p,), that make `absent` spectra a visible share of the sum."""
    factor = np.ones(len(spectra))
    whole = np.delete(spectra, absent, axis=0).sum(axis=0)
    factor[absent] = _SHARE / np.max(spectra[absent] / whole, axis=1, initial=1e-300)
    return factor
