"""Units that the user gives, that the log states, and their values in the source of a recording."""

import numpy as np
import pytest

from imucal.clock import Clock
from imucal.errors import ChoiceError
from imucal.readers.read_options import ReadOptions
from imucal.readers.scales import UnitGuess, Unscaled, find_units
from imucal.recording import RAW_COUNTS, Sensor

CLOCK = Clock.even(3, 10.0)
ACCEL = Sensor.ACCELEROMETER


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
    unit = find_units("log", options, [samples(ACCEL)], [])[ACCEL]
    assert unit.described(ACCEL) == decision
    assert unit.factor(ACCEL, CLOCK.rate_hz) == pytest.approx(scale)


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
    assert find_units("log", options, [samples(ACCEL)], [])[ACCEL].value == value


def test_units_in_the_log_override_inferred_ones() -> None:
    """The user's unit overrides both."""
    stated = UnitGuess(unit="m/s^2", reason="as Acme logs it")
    for options, how in (
        (ReadOptions(), "m/s^2, as Acme logs it"),
        (ReadOptions(accel_unit="g"), "g, as given"),
    ):
        unit = find_units("log", options, [samples(ACCEL, stated)], [])[ACCEL]
        assert unit.described(ACCEL) == how


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
    with pytest.raises(ChoiceError, match=f"^log: topic /imu: {wrong}"):
        find_units("log: topic /imu", options, [samples(Sensor.GYROSCOPE)], [])
