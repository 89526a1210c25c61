"""The builder turns columns into a recording with units, order, findings and decisions."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.clock import Clock
from imucal.errors import ChoiceError
from imucal.findings import Finding
from imucal.readers.builder import RecordingBuilder
from imucal.readers.read_options import ReadOptions
from imucal.readers.scales import UnitGuess, Unscaled
from imucal.recording import RAW_COUNTS, Sensor

CLOCK = Clock.even(3, 10.0)


def test_writable_samples_are_scaled_in_place() -> None:
    """Read-only samples are copied."""
    builder = RecordingBuilder(path="log", format="csv")
    own, fixed = np.arange(9.0).reshape(3, 3), np.arange(9.0).reshape(3, 3)
    fixed.flags.writeable = False
    gyro = Unscaled(sensor=Sensor.GYROSCOPE, rows=own, clock=CLOCK)
    builder.add_sensor(gyro, 1.0)
    builder.add_sensor(Unscaled(sensor=Sensor.ACCELEROMETER, rows=fixed, clock=CLOCK), 2.0)
    found = builder.build(topics=("t",))
    assert [series.name for series in found.series] == [f"{s}_{a}" for s in ("gyro", "accel") for a in "xyz"]
    npt.assert_array_equal([series.samples for series in found.series[:3]], np.arange(9.0).reshape(3, 3))
    npt.assert_array_equal([series.samples for series in found.series[3:]], 2 * np.arange(9.0).reshape(3, 3))
    npt.assert_array_equal(fixed, np.arange(9.0).reshape(3, 3))
    builder.add_sensor(gyro, 0.5)
    npt.assert_array_equal(own, 0.5 * np.arange(9.0).reshape(3, 3))


def test_an_order_selects_samples_and_temperatures() -> None:
    """The first temperature is used."""
    builder = RecordingBuilder(path="log", format="csv")
    order = np.array([3, 0, 2])
    builder.add_sensor(
        Unscaled(sensor=Sensor.GYROSCOPE, rows=[np.arange(4.0)], clock=CLOCK, order=order, axes=("z",)), 1.0
    )
    builder.add_temperature(np.arange(4.0) + 20, CLOCK, order=order)
    builder.add_temperature(np.arange(3.0), CLOCK)
    found = builder.build(topics=())
    assert found.series[0].name == "gyro_z"
    assert found.series[0].samples.tolist() == [3.0, 0.0, 2.0]
    assert found.temperature is not None
    assert found.temperature.samples.tolist() == [23.0, 20.0, 22.0]


def test_duplicate_findings_and_decisions_are_removed() -> None:
    """Findings and decisions keep the order of their first appearance."""
    builder = RecordingBuilder(path="log", format="csv", decisions=[("unit", "SI")])
    first, second = (Finding(level="info", code=code, text=code) for code in ("a", "b"))
    builder.findings += [second, first, second]
    one = Unscaled(sensor=Sensor.GYROSCOPE, rows=[np.arange(3.0)], clock=CLOCK, axes=("x",))
    builder.add_sensor(one, 1.0)
    found = builder.build(topics=("t",), message_types=("m",))
    assert found.findings == (second, first)
    assert (found.source.topics, found.source.message_types) == (("t",), ("m",))
    assert (found.source.path, found.source.format, found.source.decisions) == (
        "log",
        "csv",
        (("unit", "SI"),),
    )


def samples(sensor: Sensor, stated: UnitGuess | None = None) -> Unscaled:
    """Return samples of a sensor that measures only gravity along z."""
    rows = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    return Unscaled(sensor=sensor, rows=rows, clock=CLOCK, stated=stated)


@pytest.mark.parametrize(
    ("options", "decision", "scale"),
    [
        (ReadOptions(), "g, inferred: median magnitude 1 is gravity in g", 9.80665),
        (ReadOptions(accel_unit="mg"), "mg, as given", 9.80665e-3),
        (ReadOptions(accel_scale=0.5), "count, 0.5 m/s^2 per count as given", 0.5),
        (ReadOptions(gyro_unit="deg/s"), "g, inferred: median magnitude 1 is gravity in g", 9.80665),
    ],
)
def test_given_units_override_inferred_ones(options: ReadOptions, decision: str, scale: float) -> None:
    """The option is a unit or a scale of counts; without one, gravity identifies the unit."""
    builder = RecordingBuilder(path="log", format="csv", options=options)
    builder.add([samples(Sensor.ACCELEROMETER)])
    assert builder.decisions == [("accelerometer unit", decision)]
    npt.assert_allclose(builder.series[2].samples, scale)


@pytest.mark.parametrize(
    ("options", "value"),
    [
        (ReadOptions(), "g"),
        (ReadOptions(accel_unit="mg"), "mg"),
        (ReadOptions(accel_scale=0.5), "0.5 per count"),
        (ReadOptions(accel_scale=1.0), RAW_COUNTS),
    ],
)
def test_the_source_has_the_unit_without_its_reason(options: ReadOptions, value: str) -> None:
    """Programs compare the value, and people read the decision."""
    builder = RecordingBuilder(path="log", format="csv", options=options)
    builder.add([samples(Sensor.ACCELEROMETER)])
    assert builder.build(topics=["t"]).source.values == {"accelerometer unit": value}


def test_units_in_the_log_override_inferred_ones() -> None:
    """The user's unit overrides both."""
    stated = UnitGuess(unit="m/s^2", reason="as Acme logs it")
    for options, how in (
        (ReadOptions(), "m/s^2, as Acme logs it"),
        (ReadOptions(accel_unit="g"), "g, as given"),
    ):
        builder = RecordingBuilder(path="log", format="csv", options=options)
        builder.add([samples(Sensor.ACCELEROMETER, stated)])
        assert builder.decisions == [("accelerometer unit", how)]


@pytest.mark.parametrize(
    ("options", "wrong"),
    [
        (ReadOptions(gyro_unit="g"), "'g' is not a unit of the gyroscope; expected one such as rad/s"),
        (
            ReadOptions(gyro_unit="furlong"),
            "'furlong' is not a unit of the gyroscope; expected one such as rad/s",
        ),
        (
            ReadOptions(gyro_unit="rad/s", gyro_scale=2.0),
            r"both a unit \(rad/s\) and a scale \(2\) are given for the gyroscope; give one",
        ),
    ],
)
def test_an_impossible_unit_is_refused(options: ReadOptions, wrong: str) -> None:
    """The error contains the place and the possible units."""
    builder = RecordingBuilder(path="log", format="csv", options=options)
    with pytest.raises(ChoiceError, match=f"^log: topic /imu: {wrong}"):
        builder.add([samples(Sensor.GYROSCOPE)], where="log: topic /imu")
