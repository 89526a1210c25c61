"""Tails heavier than normal, which make the power of white noise less certain."""

import numpy as np

from imucal.arrays import FloatArray


def heavy_tails(samples: FloatArray) -> float:
    """Return the factor by which heavy tails widen N's interval, at least 1.

    The variance of the logarithm of white noise's mean square is (2 + k)/n with its excess kurtosis
    k; that of its steps is k/2. Excess within four standard errors counts as none.
    """
    steps = np.diff(samples)
    steps -= steps.mean()
    square = steps * steps
    variance = float(square.mean())
    if variance <= 0:
        return 1.0
    square /= variance
    excess = 2 * (float(np.mean(square * square)) - 3)
    chance = 8 * float(np.sqrt(24 / steps.size))
    return float(np.sqrt(1 + excess / 2)) if excess > chance else 1.0
