"""Problems that users reported in public, rebuilt from simulated logs: a row names each of them."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import imucal
from imucal.arrays import FloatArray, IntArray
from imucal.errors import Fix
from imucal.health import Diagnosis, diagnose
from tests.health.cases import row_of
from tests.health.simulated import GRAVITY, Imu, Motion, Samples, sampled, swaying, turns_and_rests
from tests.slow_cases import first_by_default

#: Range of the accelerometer in flight, in m/s².
RANGE = 4 * GRAVITY
#: The rows about time.
OF_TIME = ("rate", "gaps", "stamps", "clocks-differ")


def turned(seed: int) -> Samples:
    rng = np.random.default_rng(seed)
    return sampled(turns_and_rests(rng, turns=10), rng)


# LIO-SAM: the IMU's axes are swapped, and the map flips within seconds.


@pytest.mark.parametrize("seed", [501, 502, 503])
def test_swapped_axes_of_the_gyroscope_are_named(seed: int) -> None:
    log = turned(seed)
    row = row_of(diagnose(replace(log, gyroscope=log.gyroscope[:, [1, 0, 2]]).recording()), "axes")
    assert (row.status, row.values["mapping"]) == ("fail", "x=y y=x z=z")
    assert "the gyroscope's x is along y and y is along x of the accelerometer" in row.found


@pytest.mark.parametrize("seed", [504, 505])
def test_axes_of_a_frame_that_is_forward_right_down_are_named(seed: int) -> None:
    log = turned(seed)
    row = row_of(diagnose(replace(log, gyroscope=log.gyroscope * [1, -1, -1]).recording()), "axes")
    assert (row.status, row.values["mapping"]) == ("fail", "x=x y=-y z=-z")


# Livox: the driver publishes the acceleration in g.


@pytest.mark.parametrize("seed", [511, 512])
def test_a_lidar_whose_accelerometer_is_in_g_fails(seed: int) -> None:
    log = turned(seed)
    diagnosis = diagnose(replace(log, accelerometer=log.accelerometer / GRAVITY).recording())
    row = row_of(diagnosis, "accelerometer-unit")
    assert (row.status, row.fix) == ("fail", Fix("", "accel_unit", "g"))
    assert "--accel-unit g" in row.advice
    assert row_of(diagnosis, "axes").status == "pass"


def test_a_car_without_rests_whose_accelerometer_is_in_g_fails() -> None:
    rng = np.random.default_rng(513)
    log = sampled(swaying(rng, sway=0.1, carried_m=0.3), rng)
    row = row_of(
        diagnose(replace(log, accelerometer=log.accelerometer / GRAVITY).recording()), "accelerometer-unit"
    )
    assert (row.status, row.fix) == ("fail", Fix("", "accel_unit", "g"))


# A rover whose yaw has the wrong sign.


def rover(rng: np.random.Generator, *, slope: float, turns_on_slope: bool = True) -> Motion:
    """Return a drive with stops: turns in place by 60° to 150°, on ramps of `slope` rad or between them.

    A turn on a ramp is about the ramp's normal; straight on a ramp, the heading is the ramp's.
    """
    steps: list[tuple[float, float]] = []
    for k in range(8):
        yaw = float(rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 2.6))
        climb = (0.0, slope if k % 2 else -slope)
        back = (0.0, -climb[1])
        steps += [climb, (yaw, 0.0), back] if turns_on_slope else [climb, back, (yaw, 0.0)]
    ends = np.cumsum([[0.0, 0.0], *steps], axis=0)
    length = 3.5

    def progress(t: FloatArray) -> FloatArray:
        k = np.clip((t // length).astype(int), 0, len(steps) - 1)
        s = np.clip((t - k * length - 1.5) / 2.0, 0, 1)
        share = s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)
        return np.asarray(ends[k] + (ends[k + 1] - ends[k]) * share[:, None])

    def attitude(t: FloatArray) -> Rotation:
        yaw, pitch = progress(t).T
        if turns_on_slope:
            return Rotation.from_euler("YZ", np.column_stack([pitch, yaw]))
        return Rotation.from_euler("ZY", np.column_stack([yaw, pitch]))

    def place(t: FloatArray) -> FloatArray:
        return np.asarray(attitude(t).apply([0.1, 0.05, 0.2]))

    return Motion(attitude, place, length * len(steps) + 1.5)


def mirrored_yaw(log: Samples) -> Samples:
    return replace(log, gyroscope=log.gyroscope * [1, 1, -1])


@pytest.mark.parametrize("seed", [521, 522, 523])
def test_a_rover_on_flat_ground_cannot_tell_the_sign_of_yaw(seed: int) -> None:
    rng = np.random.default_rng(seed)
    log = sampled(rover(rng, slope=0.0), rng)
    for one in (log, mirrored_yaw(log)):
        row = row_of(diagnose(one.recording()), "axes")
        assert row.status == "unknown"
        assert "about each of its three axes" in row.advice


@pytest.mark.parametrize("seed", [524, 525, 526])
def test_a_rover_that_yaws_only_between_ramps_cannot_tell_its_sign(seed: int) -> None:
    rng = np.random.default_rng(seed)
    log = sampled(rover(rng, slope=math.radians(25), turns_on_slope=False), rng)
    for one in (log, mirrored_yaw(log)):
        assert row_of(diagnose(one.recording()), "axes").status == "unknown"


@pytest.mark.parametrize("seed", [527, 528, 529])
def test_a_rover_that_yaws_on_ramps_tells_its_sign(seed: int) -> None:
    rng = np.random.default_rng(seed)
    log = sampled(rover(rng, slope=math.radians(25)), rng)
    assert row_of(diagnose(log.recording()), "axes").status == "pass"
    row = row_of(diagnose(mirrored_yaw(log).recording()), "axes")
    assert (row.status, row.values["mapping"]) == ("fail", "x=x y=y z=-z")


@pytest.mark.parametrize("seed", [530, 532])
def test_yaw_of_the_wrong_sign_fails_on_ramps_that_do_not_tell_the_other_axes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    log = sampled(rover(rng, slope=math.radians(18)), rng)
    assert row_of(diagnose(log.recording()), "axes").status == "unknown"
    row = row_of(diagnose(mirrored_yaw(log).recording()), "axes")
    assert (row.status, row.values["mapping"]) == ("fail", None)


# A camera with an IMU whose samples are stamped on arrival.


def in_bursts(even: IntArray, rng: np.random.Generator, size: int) -> IntArray:
    """Return when samples arrive that a buffer delivers together, 0.1 ms apart."""
    last = np.minimum(np.arange(even.size) // size * size + size - 1, even.size - 1)
    late = np.abs(rng.normal(0, 5e5, even.size))[last].astype(np.int64)
    return np.asarray(even[last] + late + np.arange(even.size) % size * 100_000)


def scheduled(even: IntArray, rng: np.random.Generator, scale: float) -> IntArray:
    """Return when samples arrive in a busy computer: in order, and late by an exponential time in periods."""
    late = rng.exponential(scale * float(np.diff(even).mean()), even.size).astype(np.int64)
    return np.asarray(np.maximum.accumulate(even + late) + np.arange(even.size))


Arrival = Callable[[IntArray, np.random.Generator], IntArray]
ARRIVALS: dict[str, Arrival] = {
    "bursts of 4": lambda even, rng: in_bursts(even, rng, 4),
    "bursts of 10": lambda even, rng: in_bursts(even, rng, 10),
    "frames of the camera": lambda even, _: even[
        np.minimum(np.arange(even.size) // 7 * 7 + 6, even.size - 1)
    ],
    "late by 0.4 periods": lambda even, rng: scheduled(even, rng, 0.4),
    "late by 2 periods": lambda even, rng: scheduled(even, rng, 2.0),
    "white jitter": lambda even, rng: (
        even + rng.normal(0, 0.3 * float(np.diff(even).mean()), even.size).astype(np.int64)
    ),
}


def read_with(log: Samples, stamps: IntArray, path: Path) -> Diagnosis:
    table = np.column_stack([log.gyroscope, log.accelerometer])
    lines = ["timestamp [ns],gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"]
    lines += [
        f"{stamp},{','.join(f'{value:.9g}' for value in row)}"
        for stamp, row in zip(stamps.tolist(), table.tolist(), strict=True)
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return diagnose(imucal.read(path))


@pytest.mark.parametrize("name", ARRIVALS)
@pytest.mark.parametrize("rate_hz", [200.0, 400.0])
def test_stamps_of_arrival_never_pass(name: str, rate_hz: float, tmp_path: Path) -> None:
    rng = np.random.default_rng(531)
    log = sampled(turns_and_rests(rng, turns=4), rng, Imu(rate_hz=rate_hz))
    even = 10**18 + np.round(np.arange(len(log.gyroscope)) * 1e9 / rate_hz).astype(np.int64)
    rows = [row_of(read_with(log, even, tmp_path / "even.csv"), code) for code in OF_TIME]
    assert {row.status for row in rows} <= {"pass", "unknown"}, rows
    damaged = read_with(log, ARRIVALS[name](even, rng), tmp_path / "arrival.csv")
    rows = [row_of(damaged, code) for code in OF_TIME]
    assert {row.status for row in rows} & {"warn", "fail"}, rows


# An accelerometer that is clipped in flight.


def clipped(log: Samples, limit: float = RANGE) -> Samples:
    return replace(log, accelerometer=np.clip(log.accelerometer, -limit, limit))


@pytest.mark.parametrize("seed", [541, 542, 543])
def test_hard_manoeuvres_beyond_the_range_fail(seed: int) -> None:
    rng = np.random.default_rng(seed)
    log = sampled(swaying(rng, carried_m=1.5), rng)
    assert row_of(diagnose(log.recording()), "saturated").status == "pass"
    row = row_of(diagnose(clipped(log).recording()), "saturated")
    assert row.status == "fail"
    assert "39.2" in row.found


@pytest.mark.parametrize("rate_hz", [200.0, 400.0, 1000.0])
@pytest.mark.parametrize("seed", first_by_default([544, 545], 1))
def test_vibration_beyond_the_range_fails(seed: int, rate_hz: float) -> None:
    rng = np.random.default_rng(seed)
    motion = swaying(rng, sway=0.15, carried_m=0.1, carried_hz=(0.1, 0.5))
    log = sampled(motion, rng, Imu(rate_hz=rate_hz), vibration=(0.1, 25.0))
    assert row_of(diagnose(log.recording()), "saturated").status == "pass"
    assert row_of(diagnose(clipped(log).recording()), "saturated").status == "fail"
