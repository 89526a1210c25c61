"""How slowly to heat and cool, so that the lag of the bias behind the thermometer does little harm."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imucal.errors import ArgumentError
from imucal.recording import Sensor
from imucal.temperature.curve import Curve
from imucal.temperature.result import AxisThermal, Thermal

__all__ = ["RampNeed", "plan_ramp"]

#: Temperatures at which the slope of a curve is computed.
_PLACES = 201


@dataclass(frozen=True, kw_only=True)
class RampNeed:
    """How fast the temperature of an axis may change for an error, in U, of a curve without a lag.

    `slope` is the largest change of the bias with the lagging temperature, in U/K. `speed_k_per_s` is the
    fastest change of the temperature, and `duration_s` the length of a log that heats and cools at this
    speed; None if the bias follows without a lag.
    """

    axis: str
    sensor: Sensor
    error: float
    slope: float
    lag_s: float
    speed_k_per_s: float | None
    duration_s: float | None


def plan_ramp(found: Thermal, errors: Mapping[Sensor, float]) -> tuple[RampNeed, ...]:
    """Return how slowly to heat and cool for the wanted errors, in U: one need per axis of their sensors.

    In a steady ramp, a first-order lag is a difference of the temperature of lag times speed. Its effect is
    the largest slope of the curve times this difference.

    Raises
    ------
    ArgumentError
        If an error is not positive.
    """
    for sensor, error in errors.items():
        if not (error > 0 and math.isfinite(error)):
            raise ArgumentError(f"the error of the {sensor} must be positive, got {error:g} {sensor.unit}")
    return tuple(
        _need(axis, errors[axis.sensor], found.high_c - found.low_c)
        for axis in found.axes
        if axis.sensor in errors
    )


def _need(axis: AxisThermal, error: float, span_k: float) -> RampNeed:
    slope = _slope(axis.curve)
    behind = slope * axis.curve.lag_s
    speed = error / behind if behind > 0 else None
    return RampNeed(
        axis=axis.name,
        sensor=axis.sensor,
        error=error,
        slope=slope,
        lag_s=axis.curve.lag_s,
        speed_k_per_s=speed,
        duration_s=None if speed is None else 2 * span_k / speed,
    )


def _slope(curve: Curve) -> float:
    """Return the largest change of the bias with the lagging temperature, in U/K."""
    if curve.kind != "lagged":
        return abs(curve.gradient)
    offsets = np.linspace(curve.low_c, curve.high_c, _PLACES) - curve.reference_c
    slopes = np.polynomial.polynomial.Polynomial(curve.coefficients).deriv()(offsets)
    return float(np.abs(slopes).max())
