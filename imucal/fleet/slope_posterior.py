"""Slopes of a coefficient over labels of its logs: a linear mixed model, its posterior summed on a grid.

In the logarithm, a log of unit u has ``a_u + x'(beta + b_u) + omega c``, known to a standard error: each unit
has a level and slopes of its own, the slopes about their mean beta with a spread tau of each label. The level
and beta are flat and integrated out; omega and the spreads, of which few logs tell little, are summed over.

Laird & Ware (1982), Biometrics 38, p. 963, give the model; Harville (1974), Biometrika 61, p. 383, the
likelihood that is left when what is flat is integrated out; Tiao & Tan (1965), Biometrika 52, p. 37, the
prior of a spread.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.fleet.labelled_logs import LabelledLogs
from imucal.fleet.mixtures import Mixtures

#: Grid points of omega and of each spread; the grid is narrowed so many times at most.
_POINTS, _ROUNDS = 10, 4
#: What lies so far below the posterior's peak, in the logarithm, is out of its support; and weighs nothing.
_OUTSIDE, _NOTHING = 10.0, 8.0
#: A scatter or spread of this share of the errors is none.
_NONE = 0.05


@dataclass(frozen=True, slots=True)
class Sums:
    """What the logs of a unit tell of its slopes, its level integrated out.

    Attributes
    ----------
    information
        Shape (…, labels, labels).
    score
        Shape (…, labels).
    height
        Log-likelihood at slopes of zero, shape (…,).
    """

    information: FloatArray
    score: FloatArray
    height: FloatArray

    def spread(self, label: int, tau: FloatArray) -> "Sums":
        """Return the same with slopes that differ between units by `tau`, broadcast against `height`."""
        column, own = self.information[..., label], self.score[..., label]
        scale = 1 + tau**2 * column[..., label]
        gain = tau**2 / scale
        return Sums(
            self.information - (gain[..., None] * column)[..., None] * column[..., None, :],
            self.score - (gain * own)[..., None] * column,
            self.height + 0.5 * gain * own**2 - 0.5 * np.log(scale),
        )


@dataclass(frozen=True, slots=True)
class SlopePosterior:
    """Points of the posterior of scatter and spreads, and the law of the mean slopes at each.

    Attributes
    ----------
    omega, tau
        Shape (points,) and (points, labels).
    weight
        Shape (points,); adds up to one.
    mean, covariance
        Of the mean slopes, shape (points, labels) and (points, labels, labels).
    """

    omega: FloatArray
    tau: FloatArray
    weight: FloatArray
    mean: FloatArray
    covariance: FloatArray

    def slope(self, label: int) -> Mixtures:
        """Return the mean slope of a label."""
        sd = np.sqrt(self.covariance[:, label, label])
        return Mixtures(self.mean[None, :, label], sd[None], self.weight)

    def own_slopes(self, logs: LabelledLogs, label: int) -> Mixtures:
        """Return the slope of each unit by its own logs; of the other labels, it moves as other units do."""
        sums = self._of(logs, leave=label)
        # A unit whose logs do not differ in the label tells nothing, of no interest to anyone.
        information = np.maximum(sums.information[..., label, label], 1e-300)
        rest = self._beyond(sums, label) / information
        return Mixtures((self.mean[:, None, label] + rest).T, 1 / np.sqrt(information).T, self.weight)

    def beyond(self, unit: LabelledLogs, label: int) -> Mixtures:
        """Return how far a unit that this posterior has not seen lies beyond what it expects, as a score."""
        sums = self._of(unit)
        information = sums.information[..., label]
        error = np.einsum("pui,pij,puj->pu", information, self.covariance, information)
        sd = np.sqrt(information[..., label] + error)
        return Mixtures(self._beyond(sums, label).T, sd.T, self.weight)

    def _of(self, logs: LabelledLogs, leave: int | None = None) -> Sums:
        """Return what each unit tells at each point, (points, units, …), with slopes of its own."""
        found = unit_sums(logs, self.omega)
        for label in range(self.tau.shape[1]):
            found = found if label == leave else found.spread(label, self.tau[:, label, None])
        return found

    def _beyond(self, sums: Sums, label: int) -> FloatArray:
        """Return the score of each unit's slope beyond the mean's, (points, units)."""
        expected = np.einsum("puj,pj->pu", sums.information[..., label], self.mean)
        result: FloatArray = sums.score[..., label] - expected
        return result


def slope_posterior(logs: LabelledLogs) -> SlopePosterior:
    """Return the posterior on a grid that is narrowed until it fits its support."""
    ranges = _ranges(logs)
    for _ in range(_ROUNDS):
        axes = [np.exp(np.linspace(*ends, _POINTS)) if ends[1] > ends[0] else np.zeros(1) for ends in ranges]
        slices = [_at_scatter(logs, omega, axes[1:]) for omega in axes[0].tolist()]
        mean, covariance, height = (np.array(part) for part in zip(*slices, strict=True))
        height -= height.max()
        narrower = [_support(height, axis, ends) for axis, ends in enumerate(ranges)]
        if all(2 * (new[1] - new[0]) >= old[1] - old[0] for new, old in zip(narrower, ranges, strict=True)):
            break
        ranges = narrower
    keep = height > -_NOTHING
    omega, *tau = (np.broadcast_to(grid, height.shape)[keep] for grid in np.ix_(*axes))
    weight = np.exp(height[keep])
    return SlopePosterior(omega, np.column_stack(tau), weight / weight.sum(), mean[keep], covariance[keep])


def unit_sums(logs: LabelledLogs, omega: FloatArray) -> Sums:
    """Return what each unit tells of its slopes, for each scatter omega, shape (omega,)."""
    starts = np.flatnonzero(np.diff(logs.unit, prepend=-1))
    w = 1 / (logs.deviation**2 + omega[:, None] ** 2)

    def total(values: FloatArray) -> FloatArray:
        result: FloatArray = np.add.reduceat(values, starts, axis=1)
        return result

    whole = total(w)
    x = logs.x - (total(w[..., None] * logs.x) / whole[..., None])[:, logs.unit]
    y = logs.y - (total(w * logs.y) / whole)[:, logs.unit]
    return Sums(
        information=total(w[..., None, None] * x[..., None] * x[..., None, :]),
        score=total((w * y)[..., None] * x),
        height=-0.5 * (total(w * y * y - np.log(w)) + np.log(whole)),
    )


def _at_scatter(
    logs: LabelledLogs, omega: float, spreads: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mean slopes, their covariance and the logarithm of the posterior, over a grid of spreads.

    The prior is Jeffreys' of omega and of each spread, for a measure that is flat in their logarithms.
    """
    each = unit_sums(logs, np.array([omega]))
    errors = np.diagonal(each.information[0], axis1=-2, axis2=-1)
    room = [1] * (len(spreads) - 1)
    each = Sums(*(part.reshape(*room, *part.shape) for part in (each.information, each.score, each.height)))
    prior = 2 * math.log(omega) + 0.5 * math.log(np.sum((logs.deviation**2 + omega**2) ** -2.0))
    height = np.full((1,) * len(spreads), prior)
    for label, (tau, own) in enumerate(zip(np.ix_(*spreads), errors.T, strict=True)):
        if tau.any():
            each = each.spread(label, tau[..., None])
            height = height + np.log(
                tau**2 * np.sqrt(np.sum((own / (1 + tau[..., None] ** 2 * own)) ** 2, axis=-1))
            )
    covariance = np.linalg.inv(each.information.sum(axis=-3))
    score = each.score.sum(axis=-2)
    mean = np.einsum("...ij,...j->...i", covariance, score)
    fit = each.height.sum(axis=-1) + 0.5 * np.einsum("...i,...i->...", score, mean)
    return mean, covariance, height + fit + 0.5 * np.linalg.slogdet(covariance)[1]


def _ranges(logs: LabelledLogs) -> list[tuple[float, float]]:
    """Return the ranges of the logarithms of omega and the spreads; of no width where there is no telling."""
    sums = unit_sums(logs, np.zeros(1))
    own = np.diagonal(sums.information[0], axis1=-2, axis2=-1)
    known = float(np.sqrt(np.mean(logs.deviation**2)))
    scatter = math.sqrt(float(np.mean((logs.y - _unit_means(logs, logs.y)) ** 2)))
    ranges = [(math.log(_NONE * known), math.log(2 * known + 3 * scatter))]
    for label in range(logs.x.shape[1]):
        tell = own[:, label] > 0
        if np.count_nonzero(tell) < 2:
            ranges.append((0.0, 0.0))
            continue
        error = 1 / math.sqrt(float(own[tell, label].max()))
        x = logs.x[:, label] - _unit_means(logs, logs.x[:, label])
        slope = scatter / math.sqrt(float(np.mean(x**2)))
        ranges.append((math.log(_NONE * error), math.log(3 * error + 10 * slope)))
    return ranges


def _unit_means(logs: LabelledLogs, values: FloatArray) -> FloatArray:
    """Return for each log the mean of its unit's logs."""
    result: FloatArray = (np.bincount(logs.unit, values) / np.bincount(logs.unit))[logs.unit]
    return result


def _support(height: FloatArray, axis: int, ends: tuple[float, float]) -> tuple[float, float]:
    """Return the range of an axis' likely points and one more to each side."""
    others = tuple(i for i in range(height.ndim) if i != axis)
    places = np.flatnonzero(np.max(height, axis=others) > -_OUTSIDE)
    size = height.shape[axis]
    grid = np.linspace(*ends, size)
    return float(grid[max(places[0] - 1, 0)]), float(grid[min(places[-1] + 1, size - 1)])
