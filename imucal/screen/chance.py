"""What chance alone does: the spread of windows' variances, judged from their quiet half.

Every threshold of the screening is set from the data's own quiet half, so that a touch does not
hide itself by raising the yardstick, and noise of any colour keeps its false alarms rare.
"""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray

__all__ = ["ScaledChiSquare", "chi_square_quantile", "normal_quantile"]

#: Normal quantile of 10 %, with the sign turned.
_TENTH = 1.2815515655446004


@dataclass(frozen=True, slots=True)
class ScaledChiSquare:
    """Variances that spread as ``scale * chi2(edf) / edf``."""

    scale: float
    edf: float

    @classmethod
    def from_quiet_half(cls, variances: FloatArray, *, largest_edf: float) -> "ScaledChiSquare":
        """Return the law that has the median and the lowest tenth of `variances`, shape (k,), k >= 1.

        Up to 40 % of disturbed windows change neither by much.

        Source: Wilson & Hilferty (1931), the cube root of a chi-square variable is nearly normal.
        """
        tenth, middle = np.quantile(variances, [0.1, 0.5])
        if not tenth > 0:
            return cls(float(middle), 1.0)
        ratio = float((middle / tenth) ** (1 / 3))
        if ratio <= 1:
            return cls(float(middle), largest_edf)
        # Solve (1 - s^2) / (1 - s^2 - z s) = ratio for s = sqrt(2 / (9 edf)).
        a, b = ratio - 1, _TENTH * ratio
        s = (np.sqrt(b * b + 4 * a * a) - b) / (2 * a)
        edf = float(np.clip(2 / (9 * s * s), 1.0, largest_edf))
        return cls(float(middle) / (1 - 2 / (9 * edf)) ** 3, edf)

    def quantile(self, p_above: float) -> float:
        """Return what a variance exceeds with probability `p_above`."""
        return self.scale * chi_square_quantile(p_above, self.edf)


def chi_square_quantile(p_above: float, edf: float) -> float:
    """Return the quantile of chi2(edf)/edf that is exceeded with probability `p_above`."""
    from scipy.special import chdtri

    return float(chdtri(edf, p_above)) / edf


def normal_quantile(p_above: float) -> float:
    """Return the standard normal quantile that is exceeded with probability `p_above`."""
    from scipy.special import ndtri

    return -float(ndtri(p_above))
