"""The power response of an estimator: what it lets through of a spectrum."""

from math import comb

import numpy as np

from imucal.allan.dct import DctBins
from imucal.allan.estimators import Estimator
from imucal.arrays import FloatArray


def power_response(bins: DctBins, m: int, estimator: Estimator) -> tuple[FloatArray, FloatArray]:
    """Return an estimator's response H and its square, averaged over each bin, shape (b,).

    The variance is the mean of H S over all angular frequencies, S the spectrum per sample; for
    the Allan variance H = 2 sin(m w/2)^4 / (m sin(w/2))². Where a bin is wider than a ripple, the
    ripple's mean takes its place: the mean of (2 sin)^(2j) is the central binomial coefficient of j.

    Source: NIST SP 1065 (2008), eq. 65, for sampled data.
    """
    order = estimator.order
    tail = (2 * np.sin(bins.omega / 2)) ** (-2 * estimator.integrations) / estimator.scale(m)
    ripple = (2 * np.sin(m * bins.omega / 2)) ** (2 * order)
    wide = bins.count * m * np.pi / bins.n > 1
    response = np.where(wide, comb(2 * order, order), ripple) * tail
    squared = np.where(wide, comb(4 * order, 2 * order), ripple**2) * tail**2
    return response, squared
