"""Slow and obviously right: the definitions, word for word."""

import math

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray

__all__ = ["exact_avar", "naive", "naive_moav"]


def naive_moav(samples: FloatArray, m: int) -> float:
    """Return half the mean square of the differences of neighbouring window means, every start point."""
    means = [samples[i : i + m].mean() for i in range(samples.size - m + 1)]
    differences = [after - before for before, after in zip(means, means[m:], strict=False)]
    return float(np.mean(np.square(differences)) / 2)


def exact_avar(samples: NDArray[np.int64], m: int) -> float:
    """Return the overlapping Allan variance of whole numbers, integrated without any rounding.

    The differences are exact integers below 2^53; their squares are rounded once, and summed exactly.
    """
    angle = np.concatenate([[0], np.cumsum(samples)])
    steps = angle[2 * m :] - 2 * angle[m:-m] + angle[: -2 * m]
    assert np.abs(steps).max() < 2**53
    squares = np.square(steps.astype(np.float64))
    return float(math.fsum(squares.tolist()) / (2 * m * m * int(steps.size)))


def naive(samples: FloatArray, m: int, estimator: str) -> float:
    """Return the sums of NIST SP 1065, eqs. 7, 10, 15 and 22, with x the sum of the samples and tau0 = 1."""
    x = np.concatenate([[0.0], np.cumsum(samples - samples.mean())])
    count = x.size
    match estimator:
        case "standard":
            clusters = samples[: samples.size // m * m].reshape(-1, m).mean(axis=1)
            return float(np.mean(np.diff(clusters) ** 2) / 2)
        case "overlapping":
            steps = [x[i + 2 * m] - 2 * x[i + m] + x[i] for i in range(count - 2 * m)]
            return float(np.mean(np.square(steps)) / (2 * m**2))
        case "modified":
            total = 0.0
            for j in range(count - 3 * m + 1):
                total += sum(x[i + 2 * m] - 2 * x[i + m] + x[i] for i in range(j, j + m)) ** 2
            return float(total / (2 * m**4 * (count - 3 * m + 1)))
        case "hadamard":
            steps = [x[i + 3 * m] - 3 * x[i + 2 * m] + 3 * x[i + m] - x[i] for i in range(count - 3 * m)]
            return float(np.mean(np.square(steps)) / (6 * m**2))
        case _:
            raise AssertionError(estimator)
