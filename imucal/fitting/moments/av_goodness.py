"""How well a model describes Allan variances."""

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.moments.av_points import AvarPoints
from imucal.fitting.moments.av_search import Solution
from imucal.fitting.noise_fit import Goodness


def goodness(points: AvarPoints, solution: Solution, covariance: FloatArray) -> Goodness:
    """Return how well a model describes the points, whose covariance it is given.

    An Allan variance with few degrees of freedom is far from normal; its cube root is not (Wilson
    & Hilferty 1931). The sum of squares is of those, with the correlations of `covariance`.
    """
    from scipy.special import chdtrc, ndtri

    model = solution.avar(points.m)
    tau = (float(points.m[0] * points.tau0), float(points.m[-1] * points.tau0))
    freedom = points.size - solution.parameters
    if freedom < 1 or not model.min() > 0:
        # Nothing is left to judge by, or the model is no noise at all.
        return Goodness(statistic=np.nan, p_value=np.nan, chi2_per_bin=np.nan, tau_s=tau)
    deviation = np.sqrt(np.diag(covariance))
    third = 2 / 9 * (deviation / model) ** 2 / 2
    score = (np.cbrt(points.avar / model) - (1 - third)) / np.sqrt(third)
    correlation = covariance / np.outer(deviation, deviation)
    misfit = float(score @ np.linalg.solve(correlation, score))
    p_value = float(chdtrc(freedom, misfit))
    # Beyond what a normal score can say, Wilson and Hilferty's own approximation goes on.
    spread = 2 / (9 * freedom)
    statistic = (
        float(-ndtri(p_value)) if p_value > 1e-15 else (np.cbrt(misfit / freedom) - 1 + spread) / spread**0.5
    )
    return Goodness(statistic=float(statistic), p_value=p_value, chi2_per_bin=misfit / freedom, tau_s=tau)
