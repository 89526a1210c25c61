"""The estimate of a term in which records differ: the mean over records, with their spread.

Hartung & Knapp (2001), Statistics in Medicine 20, 1771, give the interval of the mean.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.bins import Bins
from imucal.fitting.noise_fit import Estimate
from imucal.fitting.spectral.given_model import RecordTest, SquaredCoefficient, fit_bins, squared_coefficients
from imucal.fleet.random_effects import variance_between

#: Standard error of a logarithm below which each record tells a term by itself.
_TOLD = 0.3


def means_over_records(
    every: Sequence[Bins],
    structure: tuple[str, ...],
    tests: Sequence[tuple[RecordTest, Estimate, bool]],
    level: float,
) -> dict[str, tuple[Estimate, float]]:
    """Return the mean over records of each term, with its relative spread between them.

    Parameters
    ----------
    every
        Bins of the records.
    structure
        The terms that are fitted to each.
    tests
        The test of each term, its estimate where it is one for all records, and whether the records differ
        in it.
    level
        Confidence level of the limits.
    """

    @cache
    def squares() -> list[dict[str, SquaredCoefficient]]:
        return [_squares(one, structure, level) for one in every]

    return {
        test.key: _widened(test, joint, squares, level, differs=differs) for test, joint, differs in tests
    }


def _squares(bins: Bins, structure: tuple[str, ...], level: float) -> dict[str, SquaredCoefficient]:
    """Return the squared coefficients of one record by itself."""
    return squared_coefficients(fit_bins([bins], structure, level=level))


def _widened(
    test: RecordTest,
    joint: Estimate,
    squares: Callable[[], list[dict[str, SquaredCoefficient]]],
    level: float,
    *,
    differs: bool,
) -> tuple[Estimate, float]:
    """Return the estimate of a term where records differ, in it or in another one; and its spread.

    The interval is never inside that of one common coefficient.
    """
    if np.all((test.log_deviations < _TOLD) & (test.values > 0)):
        mean, low, high, spread = _mean(np.log(test.values), test.log_deviations, level, random=differs)
        value, low, high = math.exp(mean), math.exp(low), math.exp(high)
    else:
        told = [record[test.key] for record in squares()]
        values = np.array([square.value for square in told])
        # At one place for all: at its own, a large square has a large deviation, and the small more weight.
        common = max(float(values.mean()), 0.0)
        deviations = np.array([square.deviation + square.growth * common for square in told])
        if differs:
            deviations = np.full(len(told), np.sqrt(np.mean(deviations**2)))
        mean, low, high, spread = _mean(values, deviations, level, random=differs)
        value, low, high = (math.sqrt(max(x, 0.0)) for x in (mean, low, high))
        # Of the square, relative to the upper end where the mean is not told from zero; that of the common
        # coefficient where all limits of the mean are below it.
        spread = 0.5 * spread / max(value, 0.5 * max(high, joint.high)) ** 2
    low, high = min(low, joint.low), max(high, joint.high)
    widening = joint.widening * max((high - low) / (joint.high - joint.low), 1.0)
    if low <= 0 or value <= 0:
        return replace(Estimate.bounded(test.key, test.symbol, high), widening=widening), spread
    estimate = replace(joint, status="estimated", value=value, low=low, high=high, widening=widening)
    return estimate, spread


def _mean(
    values: FloatArray, deviations: FloatArray, level: float, *, random: bool
) -> tuple[float, float, float, float]:
    """Return the mean of r values, shape (r,), its limits, and their spread beyond their deviations."""
    from scipy.special import ndtri, stdtrit

    weight = deviations**-2.0
    dof = values.size - 1
    spread = 0.0
    if random:
        spread = math.sqrt(variance_between(values, deviations))
        weight = 1 / (deviations**2 + spread**2)
    mean = float(np.average(values, weights=weight))
    error = math.sqrt(1 / float(weight.sum()))
    wide = float(ndtri((1 + level) / 2))
    if random:
        scatter = float(np.sum(weight * (values - mean) ** 2)) / dof
        error *= math.sqrt(max(scatter, 1.0))
        wide = float(stdtrit(dof, (1 + level) / 2))
    return mean, mean - wide * error, mean + wide * error, spread
