"""The samples of a message instance: its counts and rates, and what a damaged stamp is."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.testing as npt
import pytest
from numpy.typing import ArrayLike

from imucal.arrays import IntArray
from imucal.errors import ChoiceError, DataError
from imucal.readers.flight_logs import (
    PX4,
    FlightLog,
    Instance,
    _choose,
    _listed,
    _log_findings,
    _refuse_options,
    _timed,
    samples_of,
)
from imucal.readers.read_options import ReadOptions
from imucal.recording import Sensor

LOG = Path("flight.ulg")
LATEST = 1 << 52


def instance(
    message: str, stamps: ArrayLike = (), *, multi: int = 0, several: bool = False, **data: ArrayLike
) -> Instance:
    """Return an instance with stamps in microseconds and other fields."""
    fields = {name: np.asarray(values) for name, values in data.items()}
    fields["timestamp"] = np.asarray(stamps, dtype=np.uint64)
    return Instance(message=message, multi=multi, several=several, data=fields, kind=PX4[message])


def every(step: int, n: int) -> IntArray:
    return 1000 + step * np.arange(n, dtype=np.int64)


@pytest.mark.parametrize(
    ("stamps", "duration", "rate"),
    [
        ((), 0.0, None),
        ((5,), 0.0, None),
        ((5, 5), 0.0, None),
        ((5, 7), 2e-6, 500_000.0),
        (every(10_000, 51), 0.5, 100.0),
        (every(1_000_000, 3), 2.0, 1.0),
        # A damaged stamp is a sample, but says nothing about the time.
        ((0, 1_000_000, LATEST), 1.0, 2.0),
        ((0, LATEST - 1), (LATEST - 1) * 1e-6, 1e6 / (LATEST - 1)),
    ],
)
def test_duration_and_rate(stamps: Sequence[int], duration: float, rate: float | None) -> None:
    found = instance("sensor_gyro", stamps)
    assert found.count == len(stamps)
    assert found.duration_s == pytest.approx(duration, rel=1e-12, abs=0)
    assert found.rate_hz == (None if rate is None else pytest.approx(rate, rel=1e-12))


def test_a_fifo_counts_what_its_messages_carry() -> None:
    assert instance("sensor_gyro_fifo", (0, 1), samples=np.array([200, 100], np.uint8)).count == 300
    assert instance("sensor_gyro_fifo", (0, 1)).count == 2
    assert instance("sensor_gyro", (0, 1), samples=[8, 8]).count == 2


@pytest.mark.parametrize(
    ("several", "name", "answers"),
    [
        (False, "sensor_gyro", {"sensor_gyro", "/sensor_gyro", "sensor_gyro:2"}),
        (True, "sensor_gyro:2", {"sensor_gyro:2"}),
    ],
)
def test_names(several: bool, name: str, answers: set[str]) -> None:  # noqa: FBT001
    found = instance("sensor_gyro", multi=2, several=several)
    asked = ("sensor_gyro", "/sensor_gyro", "sensor_gyro:2", "sensor_gyro:0", "sensor_accel")
    assert found.name == name
    assert {topic for topic in asked if found.answers_to(topic)} == answers


def test_a_stamp_beyond_any_board_is_damaged() -> None:
    axes: dict[str, Any] = {"x": [1.0, 2.0, 3.0], "y": [4.0, 5.0, 6.0], "z": [7.0, 8.0, 9.0]}
    found = samples_of(
        instance("sensor_gyro", (0, LATEST - 1, LATEST), **axes, temperature=[20, 21, 22]), Sensor.GYROSCOPE
    )
    npt.assert_array_equal(found.stamps, [0, (LATEST - 1) * 1000])
    npt.assert_array_equal(found.vectors, [[1, 4, 7], [2, 5, 8]])
    npt.assert_array_equal(found.temperature, [20, 21])


@pytest.mark.parametrize(("taken", "stamps"), [((1, 2), (1000, 2000)), ((0, 2), (11_000, 12_000))])
def test_the_time_of_sampling_counts_where_all_have_it(
    taken: tuple[int, ...], stamps: tuple[int, ...]
) -> None:
    axes: dict[str, Any] = {axis: [0.0, 1.0] for axis in "xyz"}
    times = np.array(taken, dtype=np.uint64)
    found = samples_of(
        instance("sensor_accel", (11, 12), timestamp_sample=times, **axes), Sensor.ACCELEROMETER
    )
    npt.assert_array_equal(found.stamps, stamps)
    assert found.temperature is None


def test_integrals_over_no_time_have_no_rate() -> None:
    axes: dict[str, Any] = {f"delta_angle[{i}]": [0.5 + i, 1.0 + i, 1.5 + i] for i in range(3)}
    found = samples_of(
        instance("vehicle_imu", (1, 2, LATEST), delta_angle_dt=[1, 0, 1], **axes), Sensor.GYROSCOPE
    )
    npt.assert_array_equal(found.stamps, [1000])
    npt.assert_allclose(found.vectors, [[0.5e6, 1.5e6, 2.5e6]], rtol=1e-12)


def test_a_fifo_holds_no_more_than_its_depth() -> None:
    # Full, empty, one sample, too many, and steps that are no number: only good buffers are read.
    axes: dict[str, Any] = {
        f"{axis}[{i}]": [10 * i + k for k in range(5)] for axis in "xyz" for i in range(2)
    }
    found = samples_of(
        instance(
            "sensor_accel_fifo",
            (100, 200, 300, 400, 500),
            samples=[2, 0, 1, 3, 2],
            dt=[5.0, 5.0, 5.0, 5.0, np.nan],
            scale=[0.5] * 5,
            **axes,
        ),
        Sensor.ACCELEROMETER,
    )
    npt.assert_array_equal(found.stamps, [95_000, 100_000, 300_000])
    npt.assert_array_equal(found.vectors, np.repeat([[0.0], [5.0], [1.0]], 3, axis=1))


def names(*instances: Instance, topics: tuple[str, ...] = ()) -> list[str]:
    return [one.name for one in _choose(LOG, instances, ReadOptions(topics=topics))]


def test_a_single_sample_is_not_fast() -> None:
    slow = instance("sensor_gyro", every(7_000_000, 3))
    assert names(instance("sensor_accel", (5,)), slow) == ["sensor_gyro"]


def test_a_fifth_of_the_fastest_rate_is_fast() -> None:
    combined = instance("sensor_combined", every(10_000, 101))
    with pytest.raises(ChoiceError) as error:
        names(combined, instance("vehicle_imu", every(50_000, 21)))
    assert str(error.value) == (
        "flight.ulg: several IMU messages: "
        "sensor_combined (gyroscope and accelerometer, 101 samples, 100 Hz), "
        "vehicle_imu (gyroscope and accelerometer, 21 samples, 20 Hz); name one, or one for each sensor"
    )
    assert names(combined, instance("vehicle_imu", every(50_001, 21))) == ["sensor_combined"]


def test_one_instance_of_each_sensor_is_a_pair() -> None:
    gyro, accel = instance("sensor_gyro", every(1000, 9)), instance("sensor_accel", every(1000, 9))
    assert names(accel, gyro) == ["sensor_gyro", "sensor_accel"]
    with pytest.raises(ChoiceError, match="several IMU messages"):
        names(gyro, instance("sensor_gyro_fifo", every(1000, 9)))
    with pytest.raises(ChoiceError, match="several IMU messages"):
        names(gyro, accel, instance("sensor_combined", every(1000, 9)))


def test_what_is_asked_for_must_be_there() -> None:
    single = instance("sensor_gyro", (5,))
    assert names(single, topics=("/sensor_gyro",)) == ["sensor_gyro"]
    with pytest.raises(ChoiceError) as error:
        names(single, topics=("imu",))
    assert str(error.value) == "flight.ulg: no message 'imu'; found sensor_gyro (gyroscope, 1 samples)"
    with pytest.raises(ChoiceError, match=r"no message 'imu'; found no IMU messages$"):
        names(topics=("imu",))
    with pytest.raises(
        ChoiceError, match=r"^flight\.ulg: no IMU messages; expected one of sensor_combined, "
    ):
        names()


def test_an_instance_without_a_rate_is_listed_without_one() -> None:
    assert _listed([instance("sensor_accel", (5,), multi=1, several=True)]) == (
        "sensor_accel:1 (accelerometer, 1 samples)"
    )


@pytest.mark.parametrize(
    ("durations", "text"),
    [
        ((250,), "The logger reports a dropout of 0.25 s in all: its card was too slow."),
        ((250, 1000), "The logger reports 2 dropouts of 1.25 s in all: its card was too slow."),
    ],
)
def test_dropouts_are_told(durations: tuple[int, ...], text: str) -> None:
    log = FlightLog(format="ulog", instances=[], damaged=False, dropouts=list(durations))
    (finding,) = _log_findings(log)
    assert (finding.level, finding.code, finding.text) == ("info", "dropouts", text)
    assert finding.advice == "Use a faster card or log fewer topics."


def test_damage_is_a_warning() -> None:
    (finding,) = _log_findings(FlightLog(format="ulog", instances=[], damaged=True, dropouts=[]))
    assert (finding.level, finding.code) == ("warning", "damaged")
    assert _log_findings(FlightLog(format="ulog", instances=[], damaged=False, dropouts=[])) == []


def test_a_ulog_has_one_clock() -> None:
    _refuse_options(LOG, ReadOptions(), [])
    _refuse_options(LOG, ReadOptions(time="header"), [])
    found = [instance("sensor_accel", (5,), multi=1, several=True)]
    with pytest.raises(ChoiceError) as caught:
        _refuse_options(LOG, ReadOptions(time="log"), found)
    assert str(caught.value) == (
        "flight.ulg: a flight log has no time 'log'; give the name of a message, or nothing; found "
        "sensor_accel:1 (accelerometer, 1 samples)"
    )
    with pytest.raises(ChoiceError, match=r"time unit 'ms'; .* found none of an IMU"):
        _refuse_options(LOG, ReadOptions(time_unit="ms"), [])


def test_both_sensors_of_a_message_have_their_own_fields() -> None:
    axes: dict[str, Any] = {f"gyro_rad[{i}]": [1.0 + i, 2.0 + i] for i in range(3)}
    axes |= {f"accelerometer_m_s2[{i}]": [5.0 + i, 7.0 + i] for i in range(3)}
    combined = instance("sensor_combined", (10, 20), **axes)
    npt.assert_array_equal(samples_of(combined, Sensor.GYROSCOPE).vectors, [[1, 2, 3], [2, 3, 4]])
    npt.assert_array_equal(samples_of(combined, Sensor.ACCELEROMETER).vectors, [[5, 6, 7], [7, 8, 9]])
    axes = {f"delta_velocity[{i}]": [2.0 + i] for i in range(3)}
    axes |= {f"delta_angle[{i}]": [1.0 + i] for i in range(3)}
    integrals = instance("vehicle_imu", (10,), delta_velocity_dt=[500_000], delta_angle_dt=[250_000], **axes)
    npt.assert_allclose(samples_of(integrals, Sensor.ACCELEROMETER).vectors, [[4, 6, 8]])
    npt.assert_allclose(samples_of(integrals, Sensor.GYROSCOPE).vectors, [[4, 8, 12]])


def test_sensors_with_equal_stamps_share_a_clock() -> None:
    axes: dict[str, Any] = {f"{field}[{i}]": np.sin(np.arange(60) * (i + 1))
                            for field in ("gyro_rad", "accelerometer_m_s2") for i in range(3)}  # fmt: skip
    combined = instance("sensor_combined", every(5000, 60), **axes)
    timed = _timed(LOG, [combined], ReadOptions())
    assert list(timed) == [Sensor.GYROSCOPE, Sensor.ACCELEROMETER]
    (_, first), (_, second) = timed.values()
    assert first is second
    assert first.clock.rate_hz == pytest.approx(200)
    assert first.clock.source == "timestamp of sensor_combined"
    # A sensor is read once, from the first message that has it.
    single: dict[str, Any] = {axis: np.arange(300.0) for axis in "xyz"}
    other = instance("sensor_gyro", every(1000, 300), **single)
    timed = _timed(LOG, [other, combined], ReadOptions())
    assert [samples.stamps.size for samples, _ in timed.values()] == [300, 60]
    axes = {f"delta_angle[{i}]": [1.0] for i in range(3)}
    empty = instance("vehicle_imu", (1,), delta_angle_dt=[0], **axes)
    with pytest.raises(DataError) as error:
        _timed(LOG, [empty], ReadOptions())
    assert str(error.value) == (
        "flight.ulg: vehicle_imu has no samples of the gyroscope; expected a recording"
    )
