"""Columns into a recording: which samples, in which unit, and what is said once."""

import numpy as np
import numpy.testing as npt

from imucal.clock import Clock
from imucal.findings import Finding
from imucal.readers.builder import RecordingBuilder
from imucal.recording import Sensor

CLOCK = Clock.even(3, 10.0)


def test_samples_are_scaled() -> None:
    """In place where they are the package's own memory, and in a copy where they can't be written."""
    builder = RecordingBuilder(path="log", format="csv")
    own, fixed = np.arange(9.0).reshape(3, 3), np.arange(9.0).reshape(3, 3)
    fixed.flags.writeable = False
    builder.add_sensor(Sensor.GYROSCOPE, own, CLOCK, scale=1.0)
    builder.add_sensor(Sensor.ACCELEROMETER, fixed, CLOCK, scale=2.0)
    found = builder.build(topics=("t",))
    assert [series.name for series in found.series] == [f"{s}_{a}" for s in ("gyro", "accel") for a in "xyz"]
    npt.assert_array_equal([series.samples for series in found.series[:3]], np.arange(9.0).reshape(3, 3))
    npt.assert_array_equal([series.samples for series in found.series[3:]], 2 * np.arange(9.0).reshape(3, 3))
    npt.assert_array_equal(fixed, np.arange(9.0).reshape(3, 3))
    builder.add_sensor(Sensor.GYROSCOPE, own, CLOCK, scale=0.5)
    npt.assert_array_equal(own, 0.5 * np.arange(9.0).reshape(3, 3))


def test_samples_are_kept_in_an_order() -> None:
    """Some of them, of a sensor or a temperature; the first temperature counts."""
    builder = RecordingBuilder(path="log", format="csv")
    order = np.array([3, 0, 2])
    builder.add_sensor(Sensor.GYROSCOPE, [np.arange(4.0)], CLOCK, scale=1.0, order=order, names=("z",))
    builder.add_temperature(np.arange(4.0) + 20, CLOCK, order=order)
    builder.add_temperature(np.arange(3.0), CLOCK)
    found = builder.build(topics=())
    assert found.series[0].name == "gyro_z"
    assert found.series[0].samples.tolist() == [3.0, 0.0, 2.0]
    assert found.temperature is not None
    assert found.temperature.samples.tolist() == [23.0, 20.0, 22.0]


def test_what_is_said_twice_is_kept_once() -> None:
    """In the order in which it was said."""
    builder = RecordingBuilder(path="log", format="csv", decisions=[("unit", "SI")])
    first, second = (Finding(level="info", code=code, text=code) for code in ("a", "b"))
    builder.findings += [second, first, second]
    builder.add_sensor(Sensor.GYROSCOPE, [np.arange(3.0)], CLOCK, scale=1.0, names=("x",))
    found = builder.build(topics=("t",), message_types=("m",))
    assert found.findings == (second, first)
    assert (found.source.topics, found.source.message_types) == (("t",), ("m",))
    assert (found.source.path, found.source.format, found.source.decisions) == (
        "log",
        "csv",
        (("unit", "SI"),),
    )
