"""Tests of real recordings: the screening agrees with the descriptions of their authors."""

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.clock import Clock
from imucal.findings import Finding
from imucal.pipeline import screen
from imucal.units import G0
from tests.real_data import real_data
from tests.screening.still import recording


def findings(gyro: FloatArray, accel: FloatArray, rate_hz: float) -> tuple[Finding, ...]:
    clock = Clock.even(gyro.shape[1], rate_hz)
    return screen(recording(np.ascontiguousarray(gyro), np.ascontiguousarray(accel), clock=clock))


def serious(found: tuple[Finding, ...]) -> list[str]:
    return [f.code for f in found if f.level != "info"]


def mpu6050(name: str) -> tuple[Finding, ...]:
    counts = np.loadtxt(real_data("real", "mpu6050", name), delimiter=",", skiprows=5).T
    return findings(np.radians(counts[3:6] / 131), counts[:3] / 16384 * G0, 100.0)


@pytest.mark.parametrize("name", ["example_data_tinit_calc.csv", "imu_static_test.csv"])
def test_mpu6050_at_rest_has_no_warning(name: str) -> None:
    """The recordings are static, from a cheap IMU."""
    assert serious(mpu6050(name)) == []


@pytest.mark.parametrize("name", ["imu_90_x_rot.csv", "example_data_calibration.csv"])
def test_mpu6050_that_was_turned_is_not_at_rest(name: str) -> None:
    """The logs are a rotation by 90 degrees and a calibration in many poses."""
    found = [f for f in mpu6050(name) if f.code == "motion"]
    assert [f.level for f in found] == ["error"]
    assert "turned" in found[0].text


def test_mpu6050_as_counts_has_suspicious_units() -> None:
    """Raw counts are read as SI, for both sensors."""
    counts = np.loadtxt(real_data("real", "mpu6050", "imu_static_test.csv"), delimiter=",", skiprows=5).T
    found = findings(counts[3:6], counts[:3], 100.0)
    assert sorted(f.axis or "" for f in found if f.code == "unit-suspect") == ["accel", "gyro"]


def test_broad_at_rest_has_no_warning() -> None:
    """It is the longest rest of a benchmark recording."""
    path = real_data("real", "broad_rest", "03_undisturbed_slow_rotation_C_rest.csv")
    table = np.loadtxt(path, delimiter=",", skiprows=1).T
    assert serious(findings(table[1:4], table[4:7], 285.714)) == []


def test_stampfly_has_a_bump_and_held_samples() -> None:
    """The bump is in the first seconds of one log; the other log has one jump."""
    table = np.loadtxt(
        real_data("real", "stampfly", "stampfly_fft_20260113T222234.csv"), delimiter=",", skiprows=1
    ).T
    found = findings(table[1:4], table[4:7], 499.75)
    (bump,) = (f for f in found if f.code in ("motion", "touch"))
    assert "gyro_y" in bump.text
    assert bump.keep_s is not None
    assert bump.keep_s[0] < 6
    assert {f.axis for f in found if f.code == "held-samples"} == {"gyro", "accel"}
    table = np.loadtxt(
        real_data("real", "stampfly", "stampfly_fft_20260114T115628.csv"), delimiter=",", skiprows=1
    ).T
    found = findings(table[1:4], table[4:7], 399.9)
    # A jump of the level, which the fit removes.
    assert [(f.code, f.axis) for f in found if f.level != "info"] == [("step", "gyro_x")]
    assert {f.code for f in found if f.level == "info"} == {"roll-off", "tone"}


def test_a_hand_is_not_at_rest() -> None:
    """A telephone was held steadily in a hand."""
    table = np.genfromtxt(real_data("real", "iphone_handheld", "25.csv"), delimiter=",", names=True)
    gyro = np.stack([table[f"gyroRotation{axis}"] for axis in "XYZ"])
    accel = np.stack([table[f"accelerometerAcceleration{axis}"] * G0 for axis in "XYZ"])
    found = findings(gyro, accel, 99.6)
    assert ("error", "motion") in {(f.level, f.code) for f in found}
