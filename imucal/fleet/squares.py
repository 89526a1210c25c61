"""Estimates of squared coefficients whose deviation grows with the square.

The power of a few bins is a chi-square of it on top of a background, scaled; an estimate of a squared
coefficient, from weights that do not follow it, is nearly so. It is normal about a weak coefficient, and its
deviation in proportion to a strong one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, IntArray

#: A deviation that grows by less is constant.
_NO_GROWTH = 1e-4
#: A square that is small beside a deviation, relative to it.
_SMALL = 1e-3


@dataclass(frozen=True, slots=True)
class Squares:
    """Estimates, which may be negative, of squared coefficients; shape (n,) each.

    Attributes
    ----------
    estimate
        Of the square.
    sd, growth
        The standard deviation of an estimate is ``sd + growth * square``.
    """

    estimate: FloatArray
    sd: FloatArray
    growth: FloatArray

    def deviation(self, square: float) -> FloatArray:
        """Return the standard deviation of each, were its squared coefficient `square`."""
        result: FloatArray = self.sd + self.growth * square
        return result

    def log_likelihood(self, square: FloatArray) -> FloatArray:
        """Return the log-likelihood of squared coefficients, shape (n, squares), against the most likely."""
        estimate, sd, growth = self._columns()
        likely = np.maximum(estimate, 0.0)

        def height(square: FloatArray) -> FloatArray:
            apart = (estimate - square) / (sd + growth * square)
            grows = np.maximum(growth, _NO_GROWTH)
            chi_square = (np.log1p(grows * square / sd) + grows * apart) / grows**2
            return np.where(growth < _NO_GROWTH, 0.5 * apart**2, chi_square)

        result: FloatArray = height(likely) - height(square)
        return result

    def below(self, square: FloatArray) -> FloatArray:
        """Return the chance of an estimate below each, were the squares those, shape (n, squares).

        Wilson & Hilferty (1931), Proc. National Academy of Sciences 17, p. 684: the cube root of a
        chi-square is nearly normal. An estimate may lie below what its background alone would be, since
        the other terms are not known: far down it is normal.
        """
        from scipy.special import ndtr

        estimate, sd, growth = self._columns()
        apart = (estimate - square) / (sd + growth * square)
        grows = np.maximum(growth, _NO_GROWTH)
        root = (np.cbrt(1 + grows * apart) - 1) * 3 / grows + grows / 3
        root = np.where(apart < 0, np.maximum(root, apart), root)
        result: FloatArray = ndtr(np.where(growth < _NO_GROWTH, apart, root))
        return result

    def mean_by(self, group: IntArray, at: float) -> "Squares":
        """Return the mean of each group, shape (groups,), with weights that are best at a square `at`."""
        weight = self.deviation(at) ** -2.0
        share = weight / np.bincount(group, weight)[group]

        def error(square: float) -> FloatArray:
            own: FloatArray = (share * self.deviation(square)) ** 2
            return np.sqrt(np.bincount(group, own))

        mean: FloatArray = np.bincount(group, share * self.estimate).astype(np.float64)
        sd = error(0.0)
        # The deviation of a mean is nearly linear too; any small square tells how it begins.
        far = at or _SMALL * float(sd.min())
        return Squares(mean, sd, (error(far) - sd) / far)

    def take(self, which: Sequence[int] | IntArray) -> "Squares":
        """Return some of them."""
        rows = np.asarray(which)
        return Squares(self.estimate[rows], self.sd[rows], self.growth[rows])

    def _columns(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.estimate[:, None], self.sd[:, None], self.growth[:, None]
