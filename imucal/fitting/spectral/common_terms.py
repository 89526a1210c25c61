"""Have several records, or segments of one, a term in common? One likelihood ratio for both.

A spectrum is a sum of what is held, the part that is tested, and parts that vary beside it, so that a
change of theirs is not blamed on it. In each group of bins, a record or a segment, every part but the held
one has a scale of its own; or the tested one has the same in all groups. Twice the drop of the log-likelihood
from the first to the second is chi-squared with a degree of freedom for each group but one.

Fisher scoring of the scales is a small system a group. With the tested scale in common the others are
eliminated group by group, and the sums over the groups are one equation more.

Source: Wilks (1938), Annals of Mathematical Statistics 9, 60; of variances, Bartlett (1937), Proc. R. Soc. A
160, 268.
"""

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.spectral.likelihood import regress
from imucal.fitting.spectral.ordinates import Ordinates
from imucal.frozen import frozen_alone

#: Logs of the scales stay above this: what is lower is invisible.
_INVISIBLE = -30.0
#: A part that is absent is looked for from this share of the spectrum on, where its share is largest.
_SHARE = 0.1
#: Longest step of a log, and most steps.
_STEP, _STEPS = 1.5, 100
#: Gain of the log-likelihood that ends the search.
_CLOSE = 1e-5
#: Where the second of two scales ends: at first so many of its deviations, then half as much more each time,
#: so often; points of a grid between the ends, and scoring steps of the first scale at each.
_FIRST_REACH, _WIDER, _GRID, _SCORINGS = 1.2, 12, 32, 3
_TINY = 1e-12


@frozen_alone
class Parts:
    """The spectra of t tests over g groups of bins, b bins in all.

    The `ordinates` of all groups stand one after the other, each group's `first` bin at a place, shape (g,);
    `regressors`, shape (r,), says which of theirs are taken out. In each test `varied`, shape (t, q, b), is
    scaled, the tested part first, and `held`, shape (t, b), is not.
    """

    ordinates: Ordinates
    regressors: BoolArray
    first: IntArray
    varied: FloatArray
    held: FloatArray

    def total(self, values: FloatArray) -> FloatArray:
        """Return the sum over each group's bins, shape (…, g)."""
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
        """Maximise the likelihood, from scales of 1; the tested one is the same in all groups if `common`."""
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
        """Return the parts of one test."""
        rows = slice(test, test + 1)
        return replace(self, varied=self.varied[rows], held=self.held[rows])

    def sum_limits(
        self, logs: FloatArray, weights: FloatArray, reach: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return a weighted sum of the two scales of one test in each group, and its least and greatest.

        `logs`, shape (g, 2), are those of the maximum; `weights` is of shape (2,), the others of shape (g,).
        The limits are the extremes over all scales at which twice the drop of the log-likelihood is below the
        square of `reach`, because an expansion about the maximum is wrong where one scale is near zero.
        Scan scale 2. For each value maximise over scale 1. Keep the points whose drop is below `reach`².
        """
        best = self.at(logs[np.newaxis])
        tested, beside = np.moveaxis(best.logs[0], -1, 0)
        steps = _FIRST_REACH * 1.5 ** np.arange(_WIDER)[:, np.newaxis]
        tried = np.concatenate([np.exp(np.maximum(beside, -2.0) / 2) * steps, np.exp(beside / 2) / steps])
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
        # A curve that is flat there reaches to infinity.
        with np.errstate(over="ignore"):
            ends = np.where(left >= 0, fast * np.exp([-width, width]) + slow, np.nan)
        # Where the reach ends between two points of the grid.
        share = left[:-1] / (left[:-1] - left[1:])
        crossing = (fast + slow)[:-1] + share * np.diff(fast + slow, axis=0)
        crossing[left[:-1] * left[1:] > 0] = np.nan
        value = weights @ np.exp(best.logs[0].T)
        every = np.concatenate([*ends, crossing, value[np.newaxis]])
        return value, np.nanmin(every, axis=0), np.nanmax(every, axis=0)

    def _at_second(self, deviations: FloatArray, tested: FloatArray) -> "Scales":
        """Return the likelihood at the roots of the second scale, shape (t, g), the first at its best."""
        logs = np.empty((*deviations.shape, 2))
        logs[..., 0], logs[..., 1] = tested, 2 * np.log(np.maximum(deviations, np.exp(_INVISIBLE / 2)))
        for _ in range(_SCORINGS):
            found = self.at(logs)
            logs[..., 0] -= np.clip(found.gradient[..., 0] / (found.matrix[..., 0, 0] + _TINY), -1.0, 1.0)
        return self.at(logs)


@frozen_alone
class Scales:
    """The likelihood at some scales of each group in each test.

    At `logs` of them, shape (t, g, q), the tested one first: `objective`, -log L of each group less a
    constant, shape (t, g), its gradient in the logs, (t, g, q), and `matrix`, their expected information, (t,
    g, q, q).
    """

    logs: FloatArray
    objective: FloatArray
    gradient: FloatArray
    matrix: FloatArray

    def where(self, chosen: BoolArray, other: "Scales") -> "Scales":
        """Return these where `chosen`, shape (t, g), and the others elsewhere."""
        return Scales(
            logs=np.where(chosen[..., None], self.logs, other.logs),
            objective=np.where(chosen, self.objective, other.objective),
            gradient=np.where(chosen[..., None], self.gradient, other.gradient),
            matrix=np.where(chosen[..., None, None], self.matrix, other.matrix),
        )

    @property
    def information(self) -> FloatArray:
        """Information on the log of the tested scale with those beside it unknown, shape (t, g)."""
        return self._eliminated(np.zeros(self.objective.shape))[1]

    def _eliminated(self, damping: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return gradient and information of the tested scale, (t, g) each, with the others at their best.

        And by how much these move, shape (t, g, q-1, 2): at all, and with the tested one.
        """
        diagonal = np.diagonal(self.matrix, axis1=2, axis2=3)
        added = diagonal * 1e-9 + damping[..., None] * (diagonal + 1e-3) + _TINY
        matrix = self.matrix + added[..., None] * np.eye(diagonal.shape[2])
        across, right = matrix[..., 0, 1:], np.stack([self.gradient[..., 1:], matrix[..., 1:, 0]], axis=-1)
        moves: FloatArray = np.linalg.solve(matrix[..., 1:, 1:], right).astype(np.float64, copy=False)
        reduced = np.einsum("tgq,tgqk->ktg", across, moves)
        return self.gradient[..., 0] - reduced[0], np.maximum(matrix[..., 0, 0] - reduced[1], _TINY), moves

    def step(self, damping: FloatArray, *, common: bool) -> FloatArray:
        """Return the scoring step of all logs, shape (t, g, q), damped as in `scoring`, shape (t, g)."""
        left, rest, moves = self._eliminated(damping)
        if common:
            left, rest = (np.broadcast_to(x.sum(axis=1, keepdims=True), x.shape) for x in (left, rest))
        tested = np.clip(-left / rest, -_STEP, _STEP)[..., None]
        beside = -moves[..., 0] - moves[..., 1] * tested
        return np.concatenate([tested, np.clip(beside, -_STEP, _STEP)], axis=-1)


def visible(spectra: FloatArray, absent: list[int]) -> FloatArray:
    """Return factors on spectra, shape (p, b), that make those `absent` a share of the sum, shape (p,)."""
    factor = np.ones(len(spectra))
    whole = np.delete(spectra, absent, axis=0).sum(axis=0)
    factor[absent] = _SHARE / np.max(spectra[absent] / whole, axis=1, initial=1e-300)
    return factor
