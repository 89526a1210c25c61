"""Samples of message instances in a ULog: counts, rates and damaged stamps."""

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.testing as npt
import pytest
from numpy.typing import ArrayLike

from imucal.arrays import IntArray
from imucal.errors import ChoiceError
from imucal.readers import describe, read
from imucal.readers.contents import TopicContents
from imucal.readers.flight_logs import PX4, FlightLog, columns_of, flight_log, log_findings
from imucal.recording import Recording
from tests.raising import raises
from tests.readers.ulog.test_ulog import SENSOR, Writer

LATEST = 1 << 52
COMBINED = "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;"
INTEGRALS = (
    "uint64_t timestamp;float[3] delta_angle;float[3] delta_velocity;uint16_t delta_angle_dt;"
    "uint16_t delta_velocity_dt;"
)


def columns(message: str, stamps: ArrayLike = (), **data: ArrayLike) -> dict[str, Any]:
    """Return the columns of an instance with stamps in microseconds and other fields."""
    fields = {name: np.asarray(values) for name, values in data.items()}
    fields["timestamp"] = np.asarray(stamps, dtype=np.uint64)
    return dict(columns_of(message, fields, PX4[message]))


def every(step: int, n: int) -> IntArray:
    return 1000 + step * np.arange(n, dtype=np.int64)


def written(path: Path, messages: Mapping[tuple[str, int], Sequence[int]]) -> Path:
    """Write instances of messages with stamps; their samples are a sine."""
    log = Writer()
    for name in dict.fromkeys(name for name, _ in messages):
        kinds = {"sensor_combined": COMBINED, "vehicle_imu": INTEGRALS}
        log.format(name, kinds.get(name, SENSOR))
    for (name, multi), stamps in messages.items():
        log.add(name, multi)
        for at, stamp in enumerate(stamps):
            values = [float(np.sin(at * (i + 1))) for i in range(6)]
            rest = {"sensor_combined": struct.pack("<6f", *values)}
            rest["vehicle_imu"] = struct.pack("<6fHH", *values, 5000, 5000)
            of_sensor = struct.pack("<QI4f", stamp, 7, *values[:3], 30.0)
            log.message(name, struct.pack("<Q", stamp) + rest.get(name, of_sensor), multi)
    return log.store(path)


def contents(path: Path, stamps: Sequence[int]) -> TopicContents:
    (found,) = describe(written(path / "log.ulg", {("sensor_gyro", 0): stamps})).topics
    return found


@pytest.mark.parametrize(
    ("stamps", "count", "duration", "rate"),
    [
        ((5,), 1, 0.0, None),
        ((5, 5), 2, 0.0, None),
        ((5, 7), 2, 2e-6, 500_000.0),
        (every(10_000, 51), 51, 0.5, 100.0),
        (every(1_000_000, 3), 3, 2.0, 1.0),
        # A damaged stamp is not counted.
        ((5, 1_000_005, LATEST), 2, 1.0, 1.0),
        ((5, LATEST - 1), 2, (LATEST - 6) * 1e-6, 1e6 / (LATEST - 6)),
    ],
)
def test_valid_stamps_give_duration_and_rate(
    stamps: Sequence[int], count: int, duration: float, rate: float | None, tmp_path: Path
) -> None:
    found = contents(tmp_path, stamps)
    assert found.count == count
    assert found.duration_s == pytest.approx(duration, rel=1e-12, abs=0)
    assert found.rate_hz == (None if rate is None else pytest.approx(rate, rel=1e-12))


@pytest.mark.parametrize(
    ("several", "name", "answers"),
    [
        (False, "sensor_gyro", {"sensor_gyro", "/sensor_gyro", "sensor_gyro:2"}),
        (True, "sensor_gyro:2", {"sensor_gyro:2"}),
    ],
)
def test_an_instance_is_named_by_message_and_number(
    several: bool,  # noqa: FBT001
    name: str,
    answers: set[str],
    tmp_path: Path,
) -> None:
    """The number is optional if there is only one instance."""
    stamps = every(1000, 50).tolist()
    messages = {("sensor_gyro", multi): stamps for multi in ([1, 2] if several else [2])}
    path = written(tmp_path / "log.ulg", messages)
    found = set()
    for topic in ("sensor_gyro", "/sensor_gyro", "sensor_gyro:2", "sensor_gyro:0", "sensor_accel"):
        try:
            assert read(path, topic=topic).source.topics == (name,)
            found.add(topic)
        except ChoiceError as error:
            assert f"there is no topic {topic}" in str(error)  # noqa: PT017 - the others answer
    assert found == answers


def test_a_stamp_beyond_any_board_is_damaged() -> None:
    axes: dict[str, Any] = {"x": [1.0, 2.0, 3.0], "y": [4.0, 5.0, 6.0], "z": [7.0, 8.0, 9.0]}
    found = columns("sensor_gyro", (0, LATEST - 1, LATEST), **axes, temperature=[20, 21, 22])
    npt.assert_array_equal(found["timestamp"], [0, (LATEST - 1) * 1000])
    npt.assert_array_equal([found[axis] for axis in "xyz"], [[1, 2], [4, 5], [7, 8]])
    npt.assert_array_equal(found["temperature"], [20, 21])


@pytest.mark.parametrize(("taken", "stamps"), [((1, 2), (1000, 2000)), ((0, 2), (11_000, 12_000))])
def test_the_time_of_sampling_is_used_if_all_samples_have_it(
    taken: tuple[int, ...], stamps: tuple[int, ...]
) -> None:
    axes: dict[str, Any] = {axis: [0.0, 1.0] for axis in "xyz"}
    times = np.array(taken, dtype=np.uint64)
    found = columns("sensor_accel", (11, 12), timestamp_sample=times, **axes)
    npt.assert_array_equal(found["timestamp"], stamps)
    assert "temperature" not in found


def test_integrals_over_zero_time_have_no_rate() -> None:
    fields: dict[str, Any] = {f"delta_angle[{i}]": [0.5 + i, 1.0 + i, 1.5 + i] for i in range(3)}
    fields |= {f"delta_velocity[{i}]": [2.0 + i] * 3 for i in range(3)}
    over = {"delta_angle_dt": [1, 0, 1], "delta_velocity_dt": [250_000] * 3}
    found = columns("vehicle_imu", (1, 2, LATEST), **over, **fields)
    npt.assert_array_equal(found["timestamp"], [1000, 2000])
    npt.assert_allclose(found["gyro_rad[1]"], [1.5e6, np.nan], rtol=1e-12)
    npt.assert_allclose(found["accelerometer_m_s2[2]"], [16, 16], rtol=1e-12)


def test_a_fifo_with_more_samples_than_its_depth_is_damaged() -> None:
    # Cases: full, empty, one sample, too many samples, and invalid steps; only valid buffers are read.
    axes: dict[str, Any] = {
        f"{axis}[{i}]": [10 * i + k for k in range(5)] for axis in "xyz" for i in range(2)
    }
    found = columns(
        "sensor_accel_fifo",
        (100, 200, 300, 400, 500),
        samples=[2, 0, 1, 3, 2],
        dt=[5.0, 5.0, 5.0, 5.0, np.nan],
        scale=[0.5] * 5,
        **axes,
    )
    npt.assert_array_equal(found["timestamp"], [95_000, 100_000, 300_000])
    for axis in "xyz":
        npt.assert_array_equal(found[axis], [0.0, 5.0, 1.0])


def test_a_message_without_a_field_is_damage() -> None:
    axes: dict[str, Any] = {axis: np.zeros(2) for axis in "xyz"}
    stamps: dict[str, Any] = {"timestamp": np.array([1, 2], dtype=np.uint64)}
    found: dict[tuple[str, int], dict[str, Any]] = {
        ("sensor_gyro", 0): stamps | axes,
        ("sensor_gyro", 1): stamps,
        ("sensor_accel", 0): axes,
    }
    log = flight_log(found, PX4, damaged=False)
    assert log.damaged
    assert list(log.messages) == [("sensor_gyro", 0)]
    assert not flight_log(dict([next(iter(found.items()))]), PX4, damaged=False).damaged


def names(path: Path, messages: Mapping[str, IntArray], **options: Any) -> tuple[str, ...]:  # noqa: ANN401
    """Return the topics that are read from a log of messages with stamps."""
    stamps = {(name, 0): values.tolist() for name, values in messages.items()}
    return read(written(path / "flight.ulg", stamps), **options).source.topics


def test_a_single_sample_is_not_fast(tmp_path: Path) -> None:
    messages = {"sensor_accel": every(1, 1), "sensor_gyro": every(1000, 50)}
    assert names(tmp_path, messages) == ("sensor_gyro",)


def test_a_fifth_of_the_fastest_rate_is_fast(tmp_path: Path) -> None:
    messages = {"sensor_combined": every(10_000, 101), "vehicle_imu": every(50_000, 21)}
    with pytest.raises(ChoiceError) as error:
        names(tmp_path, messages)
    assert str(error.value) == (
        f"{tmp_path / 'flight.ulg'}: 2 topics carry IMU samples; choose one of these topics\n"
        "  sensor_combined  sensor_combined  101 messages  100 Hz  1 s\n"
        "  vehicle_imu      vehicle_imu       21 messages   20 Hz  1 s"
    )
    assert names(tmp_path, messages | {"vehicle_imu": every(50_001, 21)}) == ("sensor_combined",)
    slow = describe(tmp_path / "flight.ulg").topics[1]
    assert (slow.name, slow.note) == ("vehicle_imu", "read only if it is named")


def test_one_instance_of_each_sensor_is_a_pair(tmp_path: Path) -> None:
    both = {"sensor_accel": every(1000, 50), "sensor_gyro": every(1000, 50)}
    assert names(tmp_path, both) == ("sensor_gyro", "sensor_accel")
    with raises(ChoiceError, "3 topics carry IMU samples", place="flight.ulg", argument="topic"):
        names(tmp_path, both | {"sensor_combined": every(1000, 50)})
    assert names(tmp_path, both, topic=["sensor_accel", "sensor_gyro"]) == ("sensor_gyro", "sensor_accel")


def test_a_requested_topic_must_exist(tmp_path: Path) -> None:
    single = {"sensor_gyro": every(1000, 50)}
    assert names(tmp_path, single, topic="/sensor_gyro") == ("sensor_gyro",)
    with raises(ChoiceError, r"no topic imu; .*\n  sensor_gyro ", place="flight.ulg", argument="topic"):
        names(tmp_path, single, topic="imu")


@pytest.mark.parametrize(
    ("durations", "text"),
    [
        ((250,), "The logger reports a dropout of 0.25 s in all: its card was too slow."),
        ((250, 1000), "The logger reports 2 dropouts of 1.25 s in all: its card was too slow."),
    ],
)
def test_dropouts_are_an_info_with_advice(durations: tuple[int, ...], text: str) -> None:
    (finding,) = log_findings(FlightLog({}, damaged=False, dropouts=list(durations)))
    assert (finding.level, finding.code, finding.text) == ("info", "dropouts", text)
    assert finding.advice == "Use a faster card or log fewer topics."


def test_damage_is_a_warning() -> None:
    (finding,) = log_findings(FlightLog({}, damaged=True, dropouts=[]))
    assert (finding.level, finding.code) == ("warning", "damaged")
    assert list(log_findings(FlightLog({}, damaged=False, dropouts=[]))) == []


def combined(path: Path, **options: Any) -> Recording:  # noqa: ANN401 - options of any kind
    """Read 60 samples of both sensors at 200 Hz."""
    stamps = {("sensor_combined", 0): every(5000, 60).tolist()}
    return read(written(path / "flight.ulg", stamps), **options)


def test_a_flight_log_has_one_clock(tmp_path: Path) -> None:
    """The stamps of the log are complete, and there is no recording time."""
    first = combined(tmp_path, time="header").series
    assert {series.clock.source for series in first} == {"timestamp of sensor_combined"}
    with raises(
        ChoiceError, "no log time besides the time stamps", place="topic sensor_combined", argument="time"
    ):
        combined(tmp_path, time="log")
    with raises(ChoiceError, "time unit ms does not apply", argument="time"):
        combined(tmp_path, time_unit="ms")


def test_sensors_with_equal_stamps_share_a_clock(tmp_path: Path) -> None:
    recording = combined(tmp_path)
    gyro, accel = recording.axis("gyroscope", "x"), recording.axis("accelerometer", "y")
    assert gyro.clock is accel.clock
    assert gyro.rate_hz == pytest.approx(200)
    npt.assert_array_equal(gyro.samples, np.sin(np.arange(60)).astype(np.float32))
    npt.assert_array_equal(accel.samples, np.sin(np.arange(60) * 5).astype(np.float32))


def test_a_sensor_without_samples_is_left_out(tmp_path: Path) -> None:
    """Integrals over zero time give no sample. The other sensor is read."""
    log = Writer()
    log.format("vehicle_imu", INTEGRALS)
    log.add("vehicle_imu")
    for at in range(9):
        values = [float(value) for value in range(at, at + 6)]
        log.message("vehicle_imu", struct.pack("<Q6fHH", 1000 * at + 1000, *values, 0, 5000))
    recording = read(log.store(tmp_path / "log.ulg"))
    assert [series.name for series in recording.series] == ["accel_x", "accel_y", "accel_z"]
    (finding,) = [finding for finding in recording.findings if finding.code == "no-data"]
    assert finding.axis == "gyro"
