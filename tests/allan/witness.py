"""Slow reference implementations that follow the definitions literally."""

import math

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray

__all__ = ["exact_avar", "literal_moav", "naive_moav"]


def naive_moav(samples: FloatArray, m: int) -> float:
    """Return half the mean square of the differences between adjacent window means at every start."""
    means = [samples[i : i + m].mean() for i in range(samples.size - m + 1)]
    differences = [after - before for before, after in zip(means, means[m:], strict=False)]
    return float(np.mean(np.square(differences)) / 2)


def exact_avar(samples: NDArray[np.int64], m: int) -> float:
    """Return the overlapping Allan variance of integers, integrated without rounding.

    The differences are exact integers below 2^53; their squares are rounded once, and summed exactly.
    """
    angle = np.concatenate([[0], np.cumsum(samples)])
    steps = angle[2 * m :] - 2 * angle[m:-m] + angle[: -2 * m]
    assert np.abs(steps).max() < 2**53
    squares = np.square(steps.astype(np.float64))
    return float(math.fsum(squares.tolist()) / (2 * m * m * int(steps.size)))


def literal_moav(samples: FloatArray, m: int) -> float:
    """Return the sum of NIST SP 1065, eq. 11, with x the sum of the samples and tau0 = 1."""
    x = np.concatenate([[0.0], np.cumsum(samples - samples.mean())])
    steps = [x[i + 2 * m] - 2 * x[i + m] + x[i] for i in range(x.size - 2 * m)]
    return float(np.mean(np.square(steps)) / (2 * m**2))
