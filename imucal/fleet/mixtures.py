"""Mixtures of normal laws: numbers that are normal at each point of a posterior's grid."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray

#: Halvings that find a quantile.
_HALVINGS = 40
#: Points of less weight than this, of the greatest, say nothing of a quantile.
_LITTLE = 1e-3


@dataclass(frozen=True, slots=True)
class Mixtures:
    """Several numbers, each normal at each point of a grid.

    Attributes
    ----------
    mean, sd
        Shape (numbers, points).
    weight
        Shape (points,); adds up to one.
    """

    mean: FloatArray
    sd: FloatArray
    weight: FloatArray

    def take(self, which: Sequence[int]) -> "Mixtures":
        """Return some of the numbers."""
        return Mixtures(self.mean[list(which)], self.sd[list(which)], self.weight)

    def followed_by(self, other: "Mixtures") -> "Mixtures":
        """Return these numbers and others of the same grid."""
        return Mixtures(np.vstack([self.mean, other.mean]), np.vstack([self.sd, other.sd]), self.weight)

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Return means and the roots of the mean variances at a point, shape (numbers,)."""
        return self.mean @ self.weight, np.sqrt(self.sd**2 @ self.weight)

    def two_sided(self) -> FloatArray:
        """Return the chance that each lies beyond zero, from where most of it is, on either side."""
        from scipy.special import ndtr

        above = ndtr(self.mean / self.sd) @ self.weight
        result: FloatArray = 2 * np.minimum(above, 1 - above)
        return result

    def quantiles(self, at: Sequence[float]) -> FloatArray:
        """Return quantiles, shape (numbers, quantiles), by bisection."""
        from scipy.special import ndtr

        keep = self.weight > _LITTLE * self.weight.max()
        mean, sd, weight = self.mean[:, keep], self.sd[:, keep], self.weight[keep] / self.weight[keep].sum()
        found = []
        for level in at:
            low, high = np.min(mean - 9 * sd, axis=1), np.max(mean + 9 * sd, axis=1)
            for _ in range(_HALVINGS):
                middle = (low + high) / 2
                below = ndtr((middle[:, None] - mean) / sd) @ weight < level
                low, high = np.where(below, middle, low), np.where(below, high, middle)
            found.append((low + high) / 2)
        return np.column_stack(found)
