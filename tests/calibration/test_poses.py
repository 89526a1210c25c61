"""Rests of a log: found where they are, and excluded if they moved."""

from dataclasses import replace

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.calibration.mean_covariance import white_model
from imucal.calibration.poses import (
    RestMeans,
    Triad,
    attitudes,
    find_rests,
    half_differences,
    moved_rests,
    triad,
)
from imucal.errors import DataError
from imucal.noise import NoiseModel
from imucal.recording import Sensor
from tests.calibration.simulated import FACES, GRAVITY, RATE, Log, Truth, log
from tests.calibration.simulated import attitudes as some_attitudes

NOISE = NoiseModel.parse("N=2e-3 + B=5e-4 + K=5e-5"), NoiseModel.parse("N=1.5e-4 + B=2e-5 + K=2e-6")


def simulated(seed: int, count: int = 12) -> Log:
    rng = np.random.default_rng(seed)
    return log(Truth.draw(rng), NOISE, some_attitudes(count, rng), rng)


def triads(one: Log) -> tuple[Triad, Triad]:
    recording = one.recording()
    found = triad(recording, Sensor.ACCELEROMETER), triad(recording, Sensor.GYROSCOPE)
    assert found[0] is not None
    assert found[1] is not None
    return found[0], found[1]


def test_finds_every_rest_and_no_turn() -> None:
    """Twelve rests of 5 s: found to half a second, and none reaches into a turn."""
    one = simulated(6700)
    found = find_rests(*triads(one)) * RATE
    assert len(found) == 12
    assert np.all(found[:, 0] >= one.spans[:, 0])
    assert np.all(found[:, 1] <= one.spans[:, 1] + 0.1 * RATE)
    assert np.all(np.diff(found, axis=1)[:, 0] > 4.3 * RATE)


def test_a_gyroscope_at_another_rate_gives_the_same_rests() -> None:
    """Half the rate, and it starts 0.25 s later."""
    one = simulated(6701)
    accelerometer, gyroscope = triads(one)
    other = replace(gyroscope, samples=gyroscope.samples[25::2], rate_hz=RATE / 2, offset_s=0.25)
    same, found = find_rests(accelerometer, gyroscope), find_rests(accelerometer, other)
    assert len(found) == len(same)
    np.testing.assert_allclose(found, same, atol=0.5)


def test_a_steady_turn_is_no_rest() -> None:
    """Turning at 3 deg/s about the vertical varies as little as a rest."""
    one = simulated(6702)
    moving = one.gyroscope.copy()
    moving[one.spans[4, 0] : one.spans[4, 1]] += np.radians(3.0)
    found = find_rests(*triads(replace(one, gyroscope=moving)))
    middle = one.spans[4].mean() / RATE
    assert not np.any((found[:, 0] < middle) & (middle < found[:, 1]))
    assert len(found) == 11


def test_a_gap_ends_a_rest() -> None:
    """Missing samples part a rest into two."""
    accelerometer, gyroscope = triads(simulated(6703))
    samples = gyroscope.samples.copy()
    samples[240:250] = np.nan
    assert len(find_rests(accelerometer, replace(gyroscope, samples=samples))) == 13


def test_short_rests_are_left_out() -> None:
    """Shorter than asked for."""
    assert len(find_rests(*triads(simulated(6704)), at_least_s=6.0)) == 0


def test_a_hand_that_trembles() -> None:
    """Rates of 0.01 rad/s on all axes count as rest only if asked for."""
    one = simulated(6705)
    t = np.arange(len(one.f)) / RATE
    tremor = 0.012 * np.sin(2 * np.pi * np.array([1.1, 1.7, 2.3]) * t[:, None])
    # The reference is the quietest windows: the IMU lies on a table in a third of the log.
    tremor[: len(t) // 3] = 0
    shaken = replace(one, gyroscope=one.gyroscope + tremor)
    assert len(find_rests(*triads(shaken))) < 8
    assert len(find_rests(*triads(shaken), in_hand=True)) == 12


def creep(one: Log, rest: int, degrees: float) -> FloatArray:
    """Return the accelerometer's samples if one rest tilts steadily by so much."""
    first, end = one.spans[rest]
    up = one.f[first] / GRAVITY
    axis = np.cross(up, [0.48, 0.6, 0.64])
    moved = one.accelerometer.copy()
    angle = np.radians(degrees) * np.linspace(0, 1, end - first)
    moved[first:end] += angle[:, None] * np.cross(axis / np.linalg.norm(axis), up * GRAVITY)
    return moved


def z_of(data: Triad, one: Log) -> FloatArray:
    rests = RestMeans.of(data, one.spans / RATE)
    return half_differences(data, rests, (NOISE[0],) * 3)


def test_a_creeping_rest_is_found() -> None:
    """0.2° in 5 s, in 8 of 8 logs; no other rest is blamed."""
    for seed in range(8):
        one = simulated(6800 + seed, count=8)
        accelerometer, _ = triads(replace(one, accelerometer=creep(one, 5, 0.2)))
        assert np.flatnonzero(moved_rests(z_of(accelerometer, one))).tolist() == [5]


@pytest.mark.slow
def test_creep_and_false_alarms_in_300_logs() -> None:
    """At least 98 % of the creeping rests, and at most 1 % false alarms."""
    found = false = 0
    for seed in range(300):
        one = simulated(640_000 + seed, count=16)
        still, _ = triads(one)
        creeping, _ = triads(replace(one, accelerometer=creep(one, 5, 0.2)))
        false += bool(moved_rests(z_of(still, one)).any())
        found += bool(moved_rests(z_of(creeping, one))[5])
    assert found >= 294
    assert false <= 3


def test_differences_of_halves_have_unit_deviation() -> None:
    """With the true model, over six logs of 12 rests and three axes."""
    logs = [simulated(6900 + k) for k in range(6)]
    z = np.concatenate([z_of(triads(one)[0], one).ravel() for one in logs])
    assert z.std() == pytest.approx(1.0, abs=0.15)


def test_a_dead_axis_is_an_error() -> None:
    """It never changes."""
    one = simulated(6706)
    dead = one.accelerometer.copy()
    dead[:, 1] = 0.25
    with pytest.raises(DataError, match="accel_y never changes"):
        find_rests(*triads(replace(one, accelerometer=dead)))


def test_coarse_steps_have_the_deviation_of_rounding() -> None:
    """An axis that holds one value in every rest is as uncertain as its rounding."""
    samples = np.repeat([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]], 50, axis=0)
    data = Triad(sensor=Sensor.ACCELEROMETER, samples=samples, rate_hz=10.0)
    rests = RestMeans.of(data, np.array([[0.0, 5.0], [5.0, 10.0]]))
    np.testing.assert_allclose(rests.deviations, 3 / np.sqrt(12))
    assert white_model(float(rests.deviations[0]), 10.0).terms


def test_attitudes_are_counted_once() -> None:
    """Repeats, and a neighbour within 10°."""
    near = [[np.sin(0.1), 0.0, np.cos(0.1)]]
    assert attitudes(np.vstack([FACES, FACES, near])) == 6


def test_missing_and_odd_axes() -> None:
    """None of them, only some, or a clock for each."""
    recording = simulated(6707).recording()
    accelerometers = tuple(s for s in recording.series if s.sensor is Sensor.ACCELEROMETER)
    assert triad(replace(recording, series=accelerometers), Sensor.GYROSCOPE) is None
    with pytest.raises(DataError, match="has only x, y"):
        triad(replace(recording, series=accelerometers[:2]), Sensor.ACCELEROMETER)
    odd = (*accelerometers[:2], accelerometers[2].between(0.0, 10.0))
    with pytest.raises(DataError, match="different clock"):
        triad(replace(recording, series=odd), Sensor.ACCELEROMETER)
