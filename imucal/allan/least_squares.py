"""Least squares whose solutions are not negative."""

import numpy as np

from imucal.arrays import FloatArray

__all__ = ["non_negative"]


def non_negative(matrix: FloatArray, target: FloatArray) -> tuple[FloatArray, float]:
    """Return the x >= 0 that minimises |matrix x - target|², shape (p,), and this sum of squares.

    Columns are scaled first: those of noise terms differ by many decades, and a solver may take a small one
    for zero.

    Parameters
    ----------
    matrix
        Shape (k, p).
    target
        Shape (k,).
    """
    from scipy.optimize import nnls

    if not matrix.shape[1]:
        return np.zeros(0), float(target @ target)
    length = np.linalg.norm(matrix, axis=0)
    length[length == 0] = 1.0
    solution, distance = nnls(matrix / length, target)
    return solution / length, float(distance) ** 2
