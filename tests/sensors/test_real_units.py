"""Real units against the data sheets of their parts: N within a factor of 1.5, or with a known reason."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.errors import Fix
from imucal.pipeline import Settings, characterize
from imucal.recording import AXES, AxisSeries, Recording, Sensor, Source
from imucal.sensors import find_sensor
from imucal.sheet_comparison import compared_with_sheet, sheet_ratios
from imucal.units import G0
from tests.real_data import real_data


def _recording(gyro: FloatArray, accel: FloatArray, rate_hz: float) -> Recording:
    """Return a recording of samples in SI, shape (n, 3) each."""
    series = [
        AxisSeries.from_samples(samples[:, column], rate_hz=rate_hz, sensor=sensor, axis=axis)
        for sensor, samples in ((Sensor.GYROSCOPE, gyro), (Sensor.ACCELEROMETER, accel))
        for column, axis in enumerate(AXES)
    ]
    return Recording(series=tuple(series), source=Source(path="real", format="test"))


def _adis16405() -> Recording:
    log = np.load(real_data("real", "adis16405", "adis16405_run1.npz"))
    part = slice(0, 200_000)
    gyro = np.radians(0.05) * log["gyro_counts"][part].astype(np.float64)
    return _recording(gyro, 3.33e-3 * G0 * log["accel_counts"][part].astype(np.float64), 100.0)


def _mpu6050() -> Recording:
    path = real_data("real", "mpu6050", "example_data_tinit_calc.csv")
    counts = np.loadtxt(path, delimiter=",", skiprows=5)
    return _recording(np.radians(counts[:, 3:6] / 131), counts[:, :3] / 16384 * G0, 100.0)


def _bmi270() -> Recording:
    path = real_data("real", "stampfly", "stampfly_fft_20260114T115628.csv")
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    return _recording(rows[:, 1:4], rows[:, 4:7], 399.9)


RECORDS: Mapping[str, Callable[[], Recording]] = {
    "ADIS16405": _adis16405,
    "MPU-6050": _mpu6050,
    "BMI270": _bmi270,
}
#: Allowed ratios of N to the data sheet, if not 1/1.5 to 1.5: a low-pass filter below the rate of the log
#: makes N of this accelerometer smaller (0.50 to 0.63).
ALLOWED = {("BMI270", Sensor.ACCELEROMETER): (0.45, 1.5)}


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDS)
def test_white_noise_is_near_the_data_sheet(name: str) -> None:
    """No finding, and no wrong unit: the figures describe real units."""
    recording, part = RECORDS[name](), find_sensor(name)
    report = characterize(recording, Settings(model="N + B"))
    found = compared_with_sheet(report, recording, part)
    codes = {finding.code for finding in found.all_findings}
    assert not codes & {"unit-of-sensor", "above-data-sheet"}
    ratios = [r for r in sheet_ratios(found, part, forced=True) if r.term.symbol == "N"]
    assert len(ratios) == 2
    for ratio in ratios:
        low, high = ALLOWED.get((name, ratio.term.sensor), (1 / 1.5, 1.5))
        assert low < (ratio.low + ratio.high) / 2 < high


def test_a_wrong_unit_is_named() -> None:
    """Counts of a real MPU-6050, converted to degrees and read as radians."""
    recording, part = _mpu6050(), find_sensor("MPU-6050")
    series = tuple(
        replace(each, samples=np.degrees(each.samples)) if each.sensor is Sensor.GYROSCOPE else each
        for each in recording.series
    )
    wrong = replace(recording, series=series)
    report = characterize(wrong, Settings(model="N", method="slope"))
    found = compared_with_sheet(report, wrong, part)
    (finding,) = [f for f in found.all_findings if f.code == "unit-of-sensor"]
    assert (finding.axis, finding.fix) == ("gyro", Fix("", "gyro_unit", "deg/s"))
    assert "was read as rad/s" in finding.text
    assert "those of the MPU-6050 in deg/s" in finding.text
    assert not [f for f in found.all_findings if f.code == "above-data-sheet"]
