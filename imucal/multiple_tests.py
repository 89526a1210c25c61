"""Adjust p-values for the number of tests."""

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["SIGNIFICANCE", "holm"]

#: Chance that at least one of all tests together raises a false alarm.
SIGNIFICANCE = 0.05


def holm(p_values: ArrayLike) -> list[float]:
    """Return p-values, shape (n,), adjusted for their number.

    If each hypothesis with an adjusted p-value of at most alpha is rejected, the chance of any false
    rejection is at most alpha, whether or not the tests depend on each other.
    Source: Holm (1979), Scandinavian Journal of Statistics 6, p. 65.
    """
    values = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(values)
    remaining = np.arange(values.size, 0, -1)
    adjusted = np.empty(values.size)
    adjusted[order] = np.minimum(np.maximum.accumulate(values[order] * remaining), 1.0)
    return [*map(float, adjusted)]
