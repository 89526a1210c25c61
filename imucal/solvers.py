"""Two small solvers: a root in a bracket, and least squares without negative solutions.

The problems are so small that importing `scipy.optimize` would take longer than solving all of them.
"""

import math
from collections.abc import Callable

import numpy as np

from imucal.arrays import FloatArray

#: Maximum number of steps of a search in a bracket.
_MAX_STEPS = 200
_MAX_SECANTS = 12
#: No variable is added if its product with the residuals is below this share of the largest product.
_NO_GAIN = 1e-12


def root(function: Callable[[float], float], low: float, high: float, *, tolerance: float) -> float:
    """Return a root of a continuous function between `low` and `high`, to within `tolerance`.

    Raises a ValueError if the function has the same sign at both ends. Each step takes two evaluations and
    doubles the number of correct digits near a simple root.

    Source: Ridders (1979), IEEE Trans. Circuits Syst. 26, 979.
    """
    at_low, at_high = function(low), function(high)
    if at_low * at_high > 0:
        msg = f"the function is {at_low} at {low} and {at_high} at {high}, expected different signs"
        raise ValueError(msg)
    for end, value in ((low, at_low), (high, at_high)):
        if value == 0:
            return end
    best = low
    for _ in range(_MAX_STEPS):
        middle = (low + high) / 2
        at_middle = function(middle)
        scale = math.sqrt(at_middle * at_middle - at_low * at_high)
        if at_middle == 0 or scale == 0:
            return middle
        step = (middle - low) * at_middle / scale
        trial = middle + (step if at_low > at_high else -step)
        at_trial = function(trial)
        done = at_trial == 0 or abs(trial - best) <= tolerance
        best = trial
        if done:
            break
        if at_middle * at_trial < 0:
            low, at_low, high, at_high = middle, at_middle, trial, at_trial
        elif at_low * at_trial < 0:
            high, at_high = trial, at_trial
        else:
            low, at_low = trial, at_trial
        if abs(high - low) <= tolerance:
            break
    return best


def root_near(
    function: Callable[[float], float],
    start: float,
    slope: float,
    *,
    low: float,
    high: float,
    tolerance: float,
) -> float | None:
    """Return a root of a decreasing, nearly linear function to within `tolerance`, by secants.

    The first step from `start` uses `slope`. Return None if a step leaves the range from `low` to `high`; use
    `root` then.
    """
    place = min(max(start, low), high)
    value = function(place)
    for _ in range(_MAX_SECANTS):
        if value == 0:
            return place
        following = place - value / slope
        if not low < following < high:
            return None
        found = function(following)
        if abs(following - place) <= tolerance:
            return following
        slope = (found - value) / (following - place)
        if not slope < 0:
            return None
        place, value = following, found
    return None


def non_negative(matrix: FloatArray, target: FloatArray) -> tuple[FloatArray, float]:
    """Return the x >= 0 that minimises |matrix x - target|², shape (p,), and this sum of squares.

    `matrix` has the shape (k, p), with p up to some dozens, and `target` the shape (k,).

    Source: Lawson & Hanson (1974), "Solving least squares problems", ch. 23.
    """
    length = np.sqrt(np.einsum("ij,ij->j", matrix, matrix))
    length[length == 0] = 1.0
    columns = matrix / length
    solution = _active_set(columns, target)
    rest = columns @ solution - target
    return solution / length, float(rest @ rest)


def _active_set(columns: FloatArray, target: FloatArray) -> FloatArray:
    size = columns.shape[1]
    solution = np.zeros(size)
    if 0 < size <= len(columns):
        whole = np.linalg.lstsq(columns, target, rcond=None)[0]
        if whole.min() > 0:
            return np.asarray(whole)
    used = np.zeros(size, dtype=bool)
    gain = columns.T @ target
    least = _NO_GAIN * float(np.abs(gain).max(initial=0.0))
    for _ in range(3 * size + 10):
        entering = np.where(used, -np.inf, gain)
        if entering.max(initial=-np.inf) <= least:
            break
        used[np.argmax(entering)] = True
        while True:
            trial = np.zeros(size)
            trial[used] = np.linalg.lstsq(columns[:, used], target, rcond=None)[0]
            negative = used & (trial <= 0)
            if not negative.any():
                break
            # Go towards the trial until the first variable is zero, and remove it.
            share = (solution[negative] / (solution[negative] - trial[negative])).min()
            solution += share * (trial - solution)
            used &= solution > 1e-15 * np.abs(solution).max()
            solution[~used] = 0.0
            if not used.any():
                break
        solution = trial if used.any() else np.zeros(size)
        gain = columns.T @ (target - columns @ solution)
    return solution
