"""The likelihood of each unit's coefficient, its logs together, for one scatter between logs of a unit.

Logs of a unit scatter by omega about it, in the logarithm: temperature, mounting and the day are never the
same. A unit whose logs are all well told is a normal law; any other stands on a grid, to which a bound is
as welcome as an estimate.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.fleet.log_value import LogValues

#: Grid points of the weakly told units.
_POINTS = 301
#: How far below the median the grid reaches, in the logarithm: a coefficient 50 times smaller shows nowhere.
_DOWN = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitLikelihoods:
    """Likelihoods of the units' coefficients.

    Attributes
    ----------
    omega
        The scatter between logs of a unit.
    about
        Where the deviations of weak units hold, in the logarithm.
    normal
        Which units are a normal law, shape (units,).
    centre, deviation
        Of the normal law; of the others the same from curvature, for weights only.
    constant
        Logarithm of what the normal law leaves out: the scatter of logs about their units.
    theta
        Grid of logarithms of the coefficient for the others, shape (points,).
    weak
        Their log-likelihoods on it, shape (weak units, points).
    """

    omega: float
    about: float
    normal: BoolArray
    centre: FloatArray
    deviation: FloatArray
    constant: float
    theta: FloatArray
    weak: FloatArray


@dataclass(frozen=True, slots=True)
class Place:
    """Where a fleet lies: the median's logarithm, and a scale of the spread about it."""

    centre: float
    scale: float


def place_of(logs: LogValues) -> Place:
    """Return a robust first guess of where the units lie."""
    centre = float(np.median(logs.centre))
    mad = 1.4826 * float(np.median(np.abs(logs.centre - centre)))
    return Place(centre, max(mad, float(np.std(logs.centre)) / 2, 0.02))


def unit_likelihoods(logs: LogValues, omega: float, place: Place) -> UnitLikelihoods:
    """Return the likelihood of each unit, where logs of one unit scatter by `omega`."""
    n = len(logs.names)
    normal = np.bincount(logs.unit, ~logs.narrow, minlength=n) == 0
    weights = 1 / (logs.log_deviation(place.centre) ** 2 + omega**2)
    total = np.bincount(logs.unit, weights, minlength=n)
    centre = np.bincount(logs.unit, weights * logs.centre, minlength=n) / np.maximum(total, 1e-300)
    own = normal[logs.unit]
    constant = 0.5 * float(
        np.sum(np.log(weights[own]) - weights[own] * (logs.centre - centre[logs.unit])[own] ** 2)
        - np.sum(np.log(total[normal]))
    )
    theta = _grid(place)
    return UnitLikelihoods(
        omega=omega,
        about=place.centre,
        normal=normal,
        centre=centre,
        deviation=1 / np.sqrt(np.maximum(total, 1e-300)),
        constant=constant,
        theta=theta,
        weak=_weak(logs, ~normal, theta, omega),
    )


def blur(theta_to: FloatArray, theta: FloatArray, width: float) -> FloatArray:
    """Return the matrix that takes the mean of a function on `theta` over a normal law about `theta_to`.

    Beyond the ends of the grid the function is what it is there.
    """
    from scipy.special import ndtr

    step = float(theta[1] - theta[0])
    wide = max(width, step / 2)
    kernel = np.exp(-0.5 * ((theta_to[:, None] - theta) / wide) ** 2)
    cell = math.sqrt(2 * math.pi) * wide / step
    kernel[:, 0] = cell * ndtr((theta[0] + step / 2 - theta_to) / wide)
    kernel[:, -1] = cell * ndtr((theta_to - theta[-1] + step / 2) / wide)
    result: FloatArray = kernel / kernel.sum(axis=1, keepdims=True)
    return result


def weighted_quantiles(values: FloatArray, weights: FloatArray, at: Sequence[float]) -> FloatArray:
    """Return quantiles of weighted values."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    result: FloatArray = np.interp(np.asarray(at) * total[-1], total - weights[order] / 2, values[order])
    return result


def _grid(place: Place) -> FloatArray:
    reach = min(9 * place.scale, _DOWN)
    return np.linspace(place.centre - _DOWN - reach, place.centre + reach + 3 * place.scale, _POINTS)


def _weak(logs: LogValues, units: BoolArray, theta: FloatArray, omega: float) -> FloatArray:
    """Return the log-likelihoods of the units that are no normal law, their logs multiplied."""
    which = units[logs.unit]
    each = logs.log_likelihood(which, theta)
    if omega > 0 and each.size:
        top = each.max(axis=1, keepdims=True)
        each = np.log(np.exp(each - top) @ blur(theta, theta, omega).T + math.exp(-690)) + top
    result = np.zeros((int(np.count_nonzero(units)), theta.size))
    row = np.cumsum(units) - 1
    np.add.at(result, row[logs.unit[which]], each)
    return result
