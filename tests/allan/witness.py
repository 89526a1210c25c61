"""Slow reference implementations that follow the definitions literally."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray

__all__ = ["PUBLISHED", "WITNESSES", "exact_avar", "naive_moav"]


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


def _integral(samples: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(samples - samples.mean())])


def _standard(samples: FloatArray, m: int) -> float:
    clusters = samples[: samples.size // m * m].reshape(-1, m).mean(axis=1)
    return float(np.mean(np.diff(clusters) ** 2) / 2)


def _overlapping(samples: FloatArray, m: int) -> float:
    x = _integral(samples)
    steps = [x[i + 2 * m] - 2 * x[i + m] + x[i] for i in range(x.size - 2 * m)]
    return float(np.mean(np.square(steps)) / (2 * m**2))


def _modified(samples: FloatArray, m: int) -> float:
    x, total = _integral(samples), 0.0
    for j in range(x.size - 3 * m + 1):
        total += sum(x[i + 2 * m] - 2 * x[i + m] + x[i] for i in range(j, j + m)) ** 2
    return float(total / (2 * m**4 * (x.size - 3 * m + 1)))


def _hadamard(samples: FloatArray, m: int) -> float:
    x = _integral(samples)
    steps = [x[i + 3 * m] - 3 * x[i + 2 * m] + 3 * x[i + m] - x[i] for i in range(x.size - 3 * m)]
    return float(np.mean(np.square(steps)) / (6 * m**2))


#: Estimator -> sum of NIST SP 1065 (eqs. 10, 7, 15 and 22); x is the sum of the samples, tau0 = 1.
WITNESSES: dict[str, Callable[[FloatArray, int], float]] = {
    "overlapping": _overlapping,
    "standard": _standard,
    "modified": _modified,
    "hadamard": _hadamard,
}

#: Estimator -> deviations of the 1000-point series at m = 1, 10, 100: NIST SP 1065, tables 30 and 31.
PUBLISHED: dict[str, tuple[str, str, str]] = {
    "overlapping": ("0.2922319", "0.09159953", "0.03241343"),
    "standard": ("0.2922319", "0.09965736", "0.03897804"),
    "modified": ("0.2922319", "0.06172376", "0.02170921"),
    "hadamard": ("0.2943883", "0.09581083", "0.03237638"),
}
