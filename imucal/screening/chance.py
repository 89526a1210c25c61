"""What chance alone does: limits that noise of any colour rarely passes.

Every threshold of the screening comes from the axis's own quiet windows, so that a touch does not
hide itself by raising the yardstick.
"""

import math

import numpy as np

from imucal.arrays import FloatArray


def variance_limit(variances: FloatArray, p_above: float) -> float:
    """Return what the variance of a quiet window exceeds with a probability of at most about `p_above`.

    A variance is a sum of weighted chi-squares: its tail falls as exp(-x/c), where c shows between
    the median and the 80 % quantile, whatever the colour of the noise. Windows in motion, when they
    are more than a fifth, would raise that; so the limit is never above that of two degrees of
    freedom with the same median. Shape of `variances` (k,), k >= 1.
    """
    middle, upper = (float(q) for q in np.quantile(variances, [0.5, 0.8]))
    reach = math.log(0.5 / p_above)
    fitted = middle + (upper - middle) / math.log(0.5 / 0.2) * reach
    return min(fitted, middle * (1 + reach / math.log(2)))


def chi_square_quantile(p_above: float, edf: float) -> float:
    """Return the quantile of chi2(edf)/edf that is exceeded with probability `p_above`."""
    from scipy.special import chdtri

    return float(chdtri(edf, p_above)) / edf


def normal_quantile(p_above: float) -> float:
    """Return the standard normal quantile that is exceeded with probability `p_above`."""
    from scipy.special import ndtri

    return -float(ndtri(p_above))
