"""Columns in memory and in a temporary file are equal, and a recording contains no duplicates."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.clock import Clock
from imucal.findings import Finding
from imucal.readers.builder import RecordingBuilder
from imucal.readers.scales import Unscaled
from imucal.readers.store import GrowingColumn
from imucal.recording import Sensor

LIMITS = [1 << 30, 800]


@pytest.mark.parametrize("limit", LIMITS)
def test_a_growing_column_becomes_float_with_its_earlier_integers(limit: int) -> None:
    """Integers that are already in the file are converted too."""
    column = GrowingColumn(np.int64, limit=limit)
    blocks = [np.arange(0, 150), np.arange(150, 200), np.linspace(0.5, 9.5, 70), np.arange(5)]
    for block in blocks:
        column.append(block)
    taken = column.take()
    assert taken.dtype == np.float64
    npt.assert_array_equal(taken, np.concatenate(blocks))


@pytest.mark.parametrize("limit", LIMITS)
def test_integers_stay_integers(limit: int) -> None:
    """A float has too few digits for stamps in ns."""
    column = GrowingColumn(np.int64, limit=limit)
    stamps = 1_700_000_000_000_000_001 + np.arange(1000)
    for block in np.split(stamps, 4):
        column.append(block)
    npt.assert_array_equal(column.take(), stamps)


def test_a_recording_applies_order_and_scale_and_removes_duplicate_findings() -> None:
    """Samples are selected before they are scaled, and the first of two temperatures is kept."""
    builder = RecordingBuilder(path="log", format="csv", decisions=[("time", "stamps")])
    clock, order = Clock.even(3, 100.0), np.array([2, 0, 1])
    samples = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]])
    samples.flags.writeable = False
    accel = Unscaled(sensor=Sensor.ACCELEROMETER, rows=samples, clock=clock, order=order)
    builder.add_sensor(accel, 2.0)
    builder.add_sensor(Unscaled(sensor=Sensor.GYROSCOPE, rows=samples, clock=clock), 0.5)
    builder.add_temperature(np.array([20.0, 21.0, 22.0]), clock, order=order)
    builder.add_temperature(np.zeros(3), clock)
    builder.findings += 2 * [Finding(level="info", code="gaps", text="One.")]
    recording = builder.build(topics=["a"], message_types=["b"])
    assert [series.name for series in recording.series][::3] == ["accel_x", "gyro_x"]
    npt.assert_array_equal(recording.series[0].samples, [6.0, 2.0, 4.0])
    npt.assert_array_equal(recording.series[5].samples, [3.5, 4.0, 4.5])
    assert recording.temperature is not None
    npt.assert_array_equal(recording.temperature.samples, [22.0, 20.0, 21.0])
    assert len(recording.findings) == 1
    assert recording.source.decisions == (("time", "stamps"),)
