"""Tests of the temperature on an even grid, its lag, and the branches of a ramp."""

import numpy as np
import pytest

import imucal
from imucal.clock import Clock
from imucal.errors import DataError
from imucal.recording import Recording, Source, Temperature
from imucal.temperature.thermometer import Thermometer, branches_of, turning_points
from tests.raising import raises
from tests.real_data import real_data


def thermometer(samples: list[float] | np.ndarray, rate_hz: float = 1.0) -> Thermometer:
    values = np.asarray(samples, np.float64)
    heat = Temperature(samples=values, clock=Clock.even(values.size, rate_hz))
    return Thermometer.of(Recording(source=Source(path="log", format="csv"), series=(), temperature=heat))


def test_a_lag_of_a_steady_ramp_is_a_delay() -> None:
    """Behind a lag, a temperature that rises by r per second is r times the lag lower, less half a sample."""
    found = thermometer(np.arange(4000) * 0.01, rate_hz=10.0)
    behind = found.lagging(20.0)
    assert found.samples[-1] - behind[-1] == pytest.approx(0.1 * (20.0 - 0.05), rel=1e-3)


def test_means_are_those_of_the_samples() -> None:
    """A mean over whole samples is the average; over a part of a sample it is the sample."""
    rng = np.random.default_rng(71)
    found = thermometer(rng.standard_normal(60))
    means = found.means(found.samples, np.array([0.0, 6.0, 6.5, 60.0]))
    assert means[0] == pytest.approx(found.samples[:6].mean())
    assert means[1] == pytest.approx(found.samples[6])
    assert means[2] == pytest.approx((found.samples[6] / 2 + found.samples[7:].sum()) / 53.5)


def test_missing_values_are_interpolated() -> None:
    """NaN is no temperature."""
    samples = np.arange(100.0)
    samples[40:50] = np.nan
    assert np.allclose(thermometer(samples).samples, np.arange(100.0))


def test_failed_transfers_are_left_out() -> None:
    """A thermometer that can't be read says -127 or 85 °C."""
    samples = 20 + np.arange(200.0) / 20
    samples[[0, 50, 51, 120]] = [-127.0, 85.0, 85.0, -127.0]
    assert np.allclose(thermometer(samples).samples[1:], (20 + np.arange(200.0) / 20)[1:])


def test_a_long_log_is_averaged() -> None:
    """Many samples become means, so that a noisy thermometer is quieter."""
    rng = np.random.default_rng(72)
    found = thermometer(20 + rng.standard_normal(65536 * 4), rate_hz=100.0)
    assert found.samples.size == 65536
    assert found.samples.std() == pytest.approx(0.5, rel=0.05)
    assert found.duration_s == pytest.approx(65536 * 4 / 100)


def test_each_place_has_the_mean_time_of_its_samples() -> None:
    """A correction interpolates between them, so a line of the time stays a line."""
    for count in (1000, 65536 * 3):
        found = thermometer(np.arange(float(count)), rate_hz=4.0)
        assert np.allclose(found.times_s, found.samples / 4)
    clock = Clock.even(8, 2.0)
    assert found.seconds_of(clock).tolist() == [place / 2 for place in range(8)]


def test_the_topics_of_a_px4_log_are_named() -> None:
    """Its usual topic has no temperature; the ones that the error names can be read."""
    log = real_data("formats", "pyulog_sample_px4_events.ulg")
    with raises(DataError, "--topic sensor_gyro --topic sensor_accel"):
        Thermometer.of(imucal.read(log))
    assert len(imucal.read(log, topic=["sensor_gyro", "sensor_accel"]).series) == 6


def test_a_constant_temperature_is_refused() -> None:
    """It has too few values for a ramp."""
    with raises(DataError, "the temperature has fewer than 16 different values"):
        thermometer(np.full(1000, 25.0))


@pytest.mark.parametrize(
    ("temperature", "turns", "heats"),
    [
        ([0, 5, 10, 5, 0], [0, 2, 4], [True, False]),
        ([10, 5, 0, 5, 10, 4], [0, 2, 4, 5], [False, True, False]),
        ([0, 5, 4.5, 10, 9.5, 10], [0, 5], [True]),
        ([10, 9, 9.5, 0], [0, 3], [False]),
        ([5, 5, 5, 10, 0], [0, 3, 4], [True, False]),
    ],
)
def test_branches_end_where_the_temperature_turns(
    temperature: list[float], turns: list[int], heats: list[bool]
) -> None:
    """Noise and overshoots below the least change are no turns."""
    values = np.array(temperature, np.float64)
    found = turning_points(values, 2.0)
    assert found.tolist() == turns
    branch, heating = branches_of(values, found)
    assert heating.tolist() == heats
    assert branch.max() == len(heats) - 1
    assert np.all(np.diff(branch) >= 0)


def test_turns_are_found_in_noise() -> None:
    """Five cycles have ten branches."""
    rng = np.random.default_rng(73)
    place = np.arange(5000) / 5000
    values = 20 - 15 * np.cos(2 * np.pi * 5 * place) + 0.3 * rng.standard_normal(5000)
    found = turning_points(values, 6.0)
    assert found.size == 11
    assert np.abs(found - np.arange(11) * 500).max() < 80
