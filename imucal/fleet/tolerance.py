"""The factor of a one-sided tolerance bound of a normal population."""

import math

from scipy.special import nctdtrit, ndtri

__all__ = ["tolerance_factor"]


def tolerance_factor(n: int, dof: int, content: float, confidence: float) -> float:
    """Return k: the mean of n values plus k standard deviations bounds a share `content` with `confidence`.

    The standard deviation has `dof` degrees of freedom: n - 1, or more if other values share it.

    Source: Krishnamoorthy & Mathew (2009), Statistical Tolerance Regions, eq. (2.2.3).
    """
    root = math.sqrt(n)
    return float(nctdtrit(dof, float(ndtri(content)) * root, confidence)) / root
