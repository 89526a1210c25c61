"""Simulated fleets: the values of one coefficient with median 1, for each log of each unit."""

import numpy as np
from scipy.special import ndtri

from imucal.arrays import FloatArray
from imucal.fleet.values import LogValue

Z = float(ndtri(0.975))


def strong_fleet(
    rng: np.random.Generator, *, units: int, logs: int = 1, tau: float, error: float, omega: float = 0.0
) -> list[LogValue]:
    """Return a fleet whose estimates are normal in the logarithm."""
    found = []
    for unit in range(units):
        own = tau * rng.standard_normal()
        for _ in range(logs):
            value = float(np.exp(own + omega * rng.standard_normal() + error * rng.standard_normal()))
            low, high = value * np.exp(-Z * error), value * np.exp(Z * error)
            found.append(LogValue(unit=f"u{unit}", value=value, low=float(low), high=float(high)))
    return found


def weak_fleet(
    rng: np.random.Generator, *, units: int, logs: int = 1, tau: float, error: float, likelihood: bool = True
) -> list[LogValue]:
    """Return a fleet whose estimates are normal in the variance, many of them bounded."""
    found = []
    for unit in range(units):
        own = tau * rng.standard_normal()
        for _ in range(logs):
            square = float(np.exp(2 * own) + error * rng.standard_normal())
            detected = square > Z * error
            found.append(
                LogValue(
                    unit=f"u{unit}",
                    value=np.sqrt(square) if detected else None,
                    low=float(np.sqrt(square - Z * error)) if detected else 0.0,
                    high=float(np.sqrt(max(square, 0.0) + Z * error)),
                    variance=square if likelihood else None,
                    variance_sd=error if likelihood else None,
                )
            )
    return found


def two_batches(rng: np.random.Generator, units: int) -> FloatArray:
    """Return logarithms of units, shape (units,): a fifth is 1.8 times larger than the others."""
    is_larger = rng.random(units) < 0.2
    logarithms: FloatArray = 0.08 * rng.standard_normal(units) + np.log(1.8) * is_larger
    return logarithms
