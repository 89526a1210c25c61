"""Fisher information -> covariance, also where some parameters are not told by the data."""

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray

#: A parameter with less information than this is not told at all.
_NONE = 1e-8


def covariance(information: FloatArray, free: NDArray[np.bool_]) -> FloatArray:
    """Return the covariance of the `free` parameters, shape (p,), as a matrix of shape (p, p).

    Parameters that the data do not tell (a term that is absent) have variance inf, and are held
    for the others; so have parameters that are held (0 information).
    """
    size = free.size
    result = np.zeros((size, size))
    diagonal = np.diag(information)
    used = np.flatnonzero(free & (diagonal > _NONE))
    result[np.arange(size), np.arange(size)] = np.inf
    if used.size:
        root = np.sqrt(diagonal[used])
        correlation = information[np.ix_(used, used)] / np.outer(root, root)
        values, vectors = np.linalg.eigh(correlation)
        inverse = (vectors / np.maximum(values, 1e-13)) @ vectors.T
        result[np.ix_(used, used)] = inverse / np.outer(root, root)
    return result
