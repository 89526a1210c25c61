"""The squared coefficient of each unit of a fleet, and the scale on which squares are compared.

Logs that determine a coefficient are nearly normal in its logarithm. Of weak logs the estimate of the square
is nearly normal, and may be negative. The scale of this module is right for both.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.fleet.values import LogValues

#: Largest error of a strong log, in the logarithm of the coefficient.
_STRONG = 0.1
#: Spread between units, in the logarithm, that sets the floor of a scale. With 0.3 the tolerance bound covers
#: 87 % of fleets whose spread is 0.6, with 0.5 it covers 90 %; larger values only make it larger.
_USUAL = 0.5
#: Smallest floor of a scale, as a share of a typical square: smaller ones lose digits.
_SHARP = 1e-6
#: Points and weights of a mean over normal noise.
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(15)


@dataclass(frozen=True, slots=True)
class Scale:
    """A scale of squared coefficients on which noise and the spread between units are nearly normal.

    It is the logarithm of the coefficient above the square `floor`, and linear in the square below. Source:
    Durbin et al. (2002), Bioinformatics 18, S105 (stabilised variance with additive and relative errors).
    """

    floor: float

    def place(self, square: FloatArray) -> FloatArray:
        """Return the places of squared coefficients."""
        result: FloatArray = 0.5 * (np.arcsinh(square / self.floor) + math.log(self.floor / 2))
        return result

    def slope(self, square: FloatArray) -> FloatArray:
        """Return the change of the place with the logarithm of the coefficient: 1 for large squares."""
        result: FloatArray = square / np.hypot(square, self.floor)
        return result

    def square(self, place: float) -> float:
        """Return the square at a place."""
        return self.floor * math.sinh(2 * place - math.log(self.floor / 2))

    def coefficient(self, place: float) -> float:
        """Return the coefficient at a place; zero if its square is negative."""
        return math.sqrt(max(self.square(place), 0.0))


class UnitSquares:
    """The squared coefficient of each unit, shape (units,): the mean of its logs.

    Errors are those at a `typical` square. Units are `weak` if one of their logs is; the logs of a strong
    unit are averaged in the logarithm. `within` is the standard deviation between logs of a unit, in the
    logarithm.
    """

    def __init__(self, logs: LogValues, typical: float, within: float) -> None:
        unit, weak = logs.unit, weak_logs(logs, typical)
        weight = 1 / (np.where(weak, 1.0, logs.deviation) ** 2 + within**2)
        total = np.bincount(unit, weight)
        strong = np.exp(2 * np.bincount(unit, weight * logs.centre) / total)
        means = logs.squares.mean_by(unit, typical)
        self.weak: BoolArray = np.bincount(unit, weak) > 0
        self.square: FloatArray = np.where(self.weak, means.estimate, strong)
        self._typical, self._noise = typical, means.deviation(typical)
        self._strong_error: FloatArray = 1 / np.sqrt(total)
        self._scatter: FloatArray = within / np.sqrt(np.bincount(unit))

    @property
    def scale(self) -> Scale:
        """The scale for these units: its floor is where their noise is as large as a usual spread."""
        floor = float(np.median(np.where(self.weak, self._noise, 0.0))) / (2 * _USUAL)
        return Scale(max(floor, _SHARP * self._typical))

    @property
    def error(self) -> FloatArray:
        """Standard errors in the logarithm of the coefficient."""
        return np.where(
            self.weak, np.hypot(self._noise / (2 * self._typical), self._scatter), self._strong_error
        )

    def on(self, scale: Scale) -> tuple[FloatArray, FloatArray]:
        """Return the places of the units on a scale, and their standard errors.

        Weak units have the error at the typical square: with their own estimate, a small square would have a
        large error and too little weight. Noise lowers the mean place, because the scale is concave; this
        bias is removed.
        """
        typical, weights = np.array(self._typical), _WEIGHTS / _WEIGHTS.sum()
        around = scale.place(typical + self._noise[:, None] * _NODES)
        mean = around @ weights
        noise = np.sqrt((around - mean[:, None]) ** 2 @ weights)
        error = np.where(
            self.weak,
            np.hypot(noise, scale.slope(typical) * self._scatter),
            scale.slope(self.square) * self._strong_error,
        )
        return scale.place(self.square) - np.where(self.weak, mean - scale.place(typical), 0.0), error


def weak_logs(logs: LogValues, typical: float) -> BoolArray:
    """Return the logs whose squares are normal, and not their logarithms.

    The error at a `typical` square decides: by its own error, a large estimate would be strong where a small
    one is not.
    """
    usual = logs.squares.deviation(typical) <= 2 * _STRONG * typical
    strong = logs.narrow & (usual | (logs.deviation <= _STRONG / 2))
    return np.where(logs.weighed, ~strong, ~logs.narrow)


def with_squares(logs: LogValues) -> LogValues:
    """Return the logs, with a rough square for those that have only an upper limit: half the limit."""
    only_limit = logs.bounded & ~logs.weighed
    estimate = np.where(only_limit, np.exp(2 * logs.centre), logs.squares.estimate)
    return replace(logs, squares=replace(logs.squares, estimate=estimate))


def typical_square(logs: LogValues) -> float:
    """Return the mean square of logs, weighted by their errors; positive."""
    has_square = logs.weighed | logs.bounded
    square = np.where(has_square, logs.squares.estimate, np.exp(2 * logs.centre))
    usual = math.exp(2 * logs.middle)
    error = logs.squares.deviation(usual)
    mean = float(np.average(square, weights=1 / (error**2 + np.median(error) ** 2)))
    return mean if mean > 0 else usual
