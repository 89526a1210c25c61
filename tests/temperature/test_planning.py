"""Tests of the speed of a ramp for a wanted error."""

import numpy as np
import pytest

from imucal.errors import ArgumentError
from imucal.recording import Sensor
from imucal.temperature import Thermal
from imucal.temperature.planning import plan_ramp
from tests.raising import raises
from tests.temperature.test_exports import found

__all__ = ["found"]


def test_a_ramp_at_the_speed_has_the_error(found: Thermal) -> None:
    """In a steady ramp the bias differs from that of a steady temperature by at most the error."""
    errors = {Sensor.GYROSCOPE: 2e-5, Sensor.ACCELEROMETER: 5e-4}
    needs = {need.axis: need for need in plan_ramp(found, errors)}
    assert list(needs) == [axis.name for axis in found.axes]
    for axis in found.axes:
        need, curve = needs[axis.name], axis.curve
        if curve.kind == "present":
            assert (need.speed_k_per_s, need.duration_s) == (None, None)
            continue
        assert need.speed_k_per_s is not None
        behind = need.speed_k_per_s * curve.lag_s
        temperature = np.linspace(curve.low_c + behind, curve.high_c, 400)
        off = np.abs(curve.bias(temperature, temperature - behind) - curve.static(temperature))
        assert off.max() == pytest.approx(errors[axis.sensor], rel=0.02)
        assert need.duration_s == pytest.approx(2 * (found.high_c - found.low_c) / need.speed_k_per_s)


def test_only_sensors_with_an_error_are_planned(found: Thermal) -> None:
    """An error must be positive."""
    assert len(plan_ramp(found, {Sensor.GYROSCOPE: 1e-4})) == 3
    with raises(ArgumentError, "the error of the gyroscope must be positive"):
        plan_ramp(found, {Sensor.GYROSCOPE: 0.0})
