"""Starting values of an output filter's response, read off the spectrum."""

from math import comb
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray
from imucal.fitting.spectral.ordinates import Ordinates

#: Poles and zeros of a response.
Order: TypeAlias = tuple[int, int]


def start_response(seen: Ordinates, low: FloatArray, order: Order, *, width: int, room: int) -> FloatArray:
    """Return starting parameters, shape (1, p): slow terms as given, response from the spectrum.

    `low`, shape (1, >= width), holds the slow terms in its first `width` columns; `room` columns for
    the response follow.

    Where white noise dominates, numerator / S = (1 + sum a_i x^i) / N²: a linear regression in 1/N²
    and a/N². Where that is not positive, the flattest response 1 + c x^j that fits best.
    """
    poles, zeros = order
    theta = np.concatenate([low[:, :width], np.zeros((1, room))], axis=1)
    if not poles:
        return theta
    x = seen.lam / seen.top
    high = seen.fraction > min(0.03, 0.3 * float(seen.fraction.max()))
    numerator = np.maximum(1 - seen.lam / 4, 1e-12) ** zeros
    target = (numerator * seen.size / np.maximum(seen.power, 1e-300))[high]
    powers = x[:, None] ** np.arange(poles + 1)
    weight = np.sqrt(seen.size[high]) / target
    solution = np.linalg.lstsq(powers[high] * weight[:, None], target * weight, rcond=None)[0]
    for _ in range(2):
        fitted = powers @ solution
        if np.any(fitted <= 0) or solution.sum() <= 0:
            solution = _flattest(seen, high, numerator, order)
            break
        weight = np.sqrt(seen.size[high]) / fitted[high]
        better = np.linalg.lstsq(powers[high] * weight[:, None], target * weight, rcond=None)[0]
        if np.any(powers @ better <= 0) or better.sum() <= 0:
            break
        solution = better
    theta[0, 1] = -np.log(solution[0])
    theta[0, width : width + poles] = solution[1:] / solution[0]
    return theta


def _flattest(seen: Ordinates, high: NDArray[np.bool_], numerator: FloatArray, order: Order) -> FloatArray:
    """Return the best of a row of Butterworth responses, as coefficients of numerator / S."""
    poles, zeros = order
    x, best, solution = seen.lam / seen.top, np.inf, np.zeros(poles + 1)
    for corner in np.geomspace(0.03, 0.97, 24):
        # |H|² = (1 - lam/4)^z / ((1 - lam/4)^z + c lam^j), one half at the corner.
        at = float(np.sin(np.pi / 2 * corner)) ** 2
        binomial = np.array([comb(zeros, i) * (-seen.top / 4) ** i for i in range(zeros + 1)])
        form = np.zeros(poles + 1)
        form[: zeros + 1] = binomial
        form[poles] += (1 - at) ** zeros * (seen.top / 4 / at) ** poles
        shape = numerator / (x[:, None] ** np.arange(poles + 1) @ form)
        ratio = (seen.power / shape)[high]
        level = ratio.sum() / seen.size[high].sum()
        misfit_ = float(np.sum(seen.size[high] * np.log(level * shape[high]) + ratio / level))
        if misfit_ < best:
            best, solution = misfit_, form / level
    return solution
