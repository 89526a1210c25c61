"""The choice of a topic: ambiguous logs are refused with a list of the topics."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucal.errors import ChoiceError, DataError
from imucal.readers import describe, read
from imucal.recording import Sensor
from tests.raising import raises
from tests.readers.logs import (
    Message,
    Samples,
    header,
    imu,
    imu_messages,
    samples,
    store,
    write_bag,
    write_mcap,
)

TRUTH = samples(120)


def merged(*parts: list[Message]) -> list[Message]:
    """Return messages in order of log time."""
    return sorted((message for part in parts for message in part), key=lambda message: message.log)


def only(truth: Samples, sensor: Sensor) -> Samples:
    """Return samples whose other sensor is constantly zero, like those of RealSense drivers."""
    zero = np.zeros_like(truth.gyro)
    gyro = truth.gyro if sensor is Sensor.GYROSCOPE else zero
    accel = truth.accel if sensor is Sensor.ACCELEROMETER else zero
    return Samples(stamps=truth.stamps, log=truth.log, gyro=gyro, accel=accel)


def test_several_imu_topics_are_refused_with_a_list(tmp_path: Path) -> None:
    """The list contains type, count, rate and duration."""
    other = samples(61, rate=50.0, seed=9)
    messages = merged(imu_messages(TRUTH, topic="/imu/data"), imu_messages(other, topic="/imu/raw"))
    path = write_mcap(tmp_path / "log.mcap", messages)
    with pytest.raises(ChoiceError) as caught:
        read(path)
    assert str(caught.value) == (
        f"{path}: 2 topics carry IMU samples; choose one of these topics\n"
        "  /imu/data  sensor_msgs/msg/Imu  120 messages  100 Hz  1.19 s\n"
        "  /imu/raw   sensor_msgs/msg/Imu   61 messages   50 Hz  1.2 s"
    )
    recording = read(path, topic="/imu/raw")
    assert np.array_equal(recording.series[0].samples, other.gyro[:, 0])
    assert recording.source.decisions[0] == ("topic", "/imu/raw: as given")
    assert read(path, topic="imu/data").source.topics == ("/imu/data",)


def test_each_sensor_of_a_realsense_is_read_from_its_topic(tmp_path: Path) -> None:
    """Each topic has one sensor and its own rate. The clocks stay separate, without interpolation."""
    gyro, accel = samples(400, rate=400.0), samples(63, rate=63.0, seed=8)
    messages = merged(
        imu_messages(only(gyro, Sensor.GYROSCOPE), topic="/camera/gyro/sample"),
        imu_messages(only(accel, Sensor.ACCELEROMETER), topic="/camera/accel/sample"),
    )
    path = write_mcap(tmp_path / "log.mcap", messages)
    recording = read(path)
    assert [(s.name, s.n) for s in recording.series] == [
        ("gyro_x", 400), ("gyro_y", 400), ("gyro_z", 400), ("accel_x", 63), ("accel_y", 63), ("accel_z", 63),
    ]  # fmt: skip
    assert recording.series[0].rate_hz == pytest.approx(400, rel=1e-6)
    assert recording.series[3].rate_hz == pytest.approx(63, rel=1e-6)
    assert np.array_equal(recording.series[5].samples, accel.accel[:, 2])
    assert recording.source.topics == ("/camera/gyro/sample", "/camera/accel/sample")
    contents = describe(path)
    assert {topic.name: topic.sensors for topic in contents.topics} == {
        "/camera/gyro/sample": (Sensor.GYROSCOPE,),
        "/camera/accel/sample": (Sensor.ACCELEROMETER,),
    }
    assert contents.topics[0].note == "accelerometer constant: no data"
    reverse = read(path, topic=["/camera/accel/sample", "/camera/gyro/sample"])
    assert reverse.source.topics == recording.source.topics


def test_a_constant_sensor_is_left_out(tmp_path: Path) -> None:
    """A finding reports it."""
    path = write_mcap(tmp_path / "log.mcap", imu_messages(only(TRUTH, Sensor.GYROSCOPE)))
    recording = read(path)
    assert [series.name for series in recording.series] == ["gyro_x", "gyro_y", "gyro_z"]
    finding = next(finding for finding in recording.findings if finding.code == "no-data")
    assert finding.text == "The accelerometer of topic /imu/data is always (0, 0, 0): no data."
    assert finding.axis == "accel"


def test_a_log_of_constants_is_refused(tmp_path: Path) -> None:
    still = Samples(stamps=TRUTH.stamps, log=TRUTH.log, gyro=TRUTH.gyro * 0, accel=TRUTH.accel * 0 + 1)
    path = write_mcap(tmp_path / "log.mcap", imu_messages(still))
    with raises(DataError, "no sensor has samples that change", place="log.mcap"):
        read(path)


def vectors(topic: str, values: np.ndarray[Any, np.dtype[np.float64]]) -> list[Message]:
    """Return Vector3Stamped messages."""
    types = store()
    vector, stamped = (types.types[f"geometry_msgs/msg/{name}"] for name in ("Vector3", "Vector3Stamped"))
    kind = "geometry_msgs/msg/Vector3Stamped"
    return [
        Message(
            topic=topic,
            type=kind,
            log=log,
            data=bytes(types.serialize_cdr(stamped(header(types, stamp), vector(*row)), kind)),
        )
        for log, stamp, row in zip(TRUTH.log.tolist(), TRUTH.stamps.tolist(), values.tolist(), strict=True)
    ]


def test_plain_vectors_are_read_only_if_named(tmp_path: Path) -> None:
    """A vector can have any meaning, so the error only lists it."""
    messages = merged(vectors("/imu/gyro", TRUTH.gyro), vectors("/imu/accel", TRUTH.accel))
    path = write_mcap(tmp_path / "log.mcap", messages)
    with pytest.raises(ChoiceError) as caught:
        read(path)
    assert str(caught.value) == (
        f"{path}: no topic carries IMU messages, only vectors without a known meaning; choose one of these "
        "topics\n"
        "  /imu/gyro   geometry_msgs/msg/Vector3Stamped  120 messages  100 Hz  1.19 s\n"
        "  /imu/accel  geometry_msgs/msg/Vector3Stamped  120 messages  100 Hz  1.19 s"
    )
    recording = read(path, topic=["/imu/gyro", "/imu/accel"])
    found = np.array([series.samples for series in recording.series]).T
    assert np.array_equal(found, TRUTH.all)
    assert [s.name for s in read(path, topic="/imu/accel").series] == ["accel_x", "accel_y", "accel_z"]


def test_two_nameless_vectors_are_gyroscope_and_accelerometer_in_that_order(tmp_path: Path) -> None:
    """No topic has a sensor in its name, so the order of the options decides."""
    messages = merged(vectors("/a", TRUTH.gyro), vectors("/b", TRUTH.accel))
    recording = read(write_mcap(tmp_path / "log.mcap", messages), topic=["/a", "/b"])
    assert np.array_equal(recording.axis("gyroscope", "x").samples, TRUTH.gyro[:, 0])
    assert np.array_equal(recording.axis("accelerometer", "x").samples, TRUTH.accel[:, 0])


def test_the_available_topics_are_listed(tmp_path: Path) -> None:
    """Cases: a topic that does not exist, and a topic without IMU samples."""
    types = store(ros1=True)
    kind = "std_msgs/msg/String"
    text = bytes(types.serialize_ros1(types.types[kind](data="hello"), kind))
    chatter = [Message(topic="/chatter", type=kind, log=log, data=text) for log in TRUTH.log.tolist()]
    path = write_bag(tmp_path / "log.bag", merged(imu_messages(TRUTH, ros1=True), chatter))
    listed = (
        "  /imu/data  sensor_msgs/Imu  120 messages  100 Hz  1.19 s\n"
        "  /chatter   std_msgs/String  120 messages  100 Hz  1.19 s"
    )
    with pytest.raises(ChoiceError) as caught:
        read(path, topic="/imu")
    assert str(caught.value) == f"{path}: there is no topic /imu; choose one of these topics\n{listed}"
    with pytest.raises(ChoiceError) as caught:
        read(path, topic="/chatter")
    assert str(caught.value) == (
        f"{path}: topic /chatter of type std_msgs/String can't be read: its messages contain no numbers"
    )
    path = write_bag(tmp_path / "other.bag", chatter)
    with pytest.raises(ChoiceError) as caught:
        read(path)
    assert str(caught.value) == (
        f"{path}: no topic carries a gyroscope or an accelerometer; found\n"
        "  /chatter  std_msgs/String  120 messages  100 Hz  1.19 s"
    )


def test_a_time_column_of_messages_is_refused(tmp_path: Path) -> None:
    """Column names exist only in tables."""
    path = write_mcap(tmp_path / "log.mcap", imu_messages(TRUTH))
    with pytest.raises(ChoiceError) as caught:
        read(path, time="t_us")
    assert str(caught.value).startswith(
        f"{path}: topic /imu/data: there is no time column 't_us'; found columns: 0 header.stamp = 1.7e+18, "
    )


def test_three_topics_are_refused(tmp_path: Path) -> None:
    """There are only two sensors."""
    path = write_mcap(tmp_path / "log.mcap", imu_messages(TRUTH))
    with raises(ChoiceError, "3 topics", place="log.mcap", argument="topic"):
        read(path, topic=["/a", "/b", "/c"])


def test_zero_stamps_are_replaced_by_log_time(tmp_path: Path) -> None:
    """Some drivers do not fill the stamp."""
    empty = Samples(stamps=TRUTH.stamps * 0, log=TRUTH.log, gyro=TRUTH.gyro, accel=TRUTH.accel)
    recording = read(write_mcap(tmp_path / "log.mcap", imu_messages(empty)))
    assert recording.series[0].clock.source == "log time"
    assert recording.series[0].rate_hz == pytest.approx(100, rel=1e-9)
    assert recording.findings[0].code == "log-time-used"


def test_messages_out_of_order_are_sorted_by_log_time(tmp_path: Path) -> None:
    """Chunks written by several threads can be out of order."""
    messages = imu_messages(TRUTH)
    shuffled = messages[60:] + messages[:60]
    recording = read(write_mcap(tmp_path / "log.mcap", shuffled))
    found = np.array([series.samples for series in recording.series]).T
    assert np.array_equal(found, TRUTH.all)
    assert recording.findings[0].code == "log-out-of-order"
    assert recording.findings[0].text.startswith("1 messages ")


def test_messages_with_ordered_stamps_keep_their_order(tmp_path: Path) -> None:
    """The clock of the recorder was set back, but the stamps are in order."""
    log = np.where(np.arange(120) < 60, TRUTH.log, TRUTH.log - 3600 * 10**9)
    late = Samples(stamps=TRUTH.stamps, log=log, gyro=TRUTH.gyro, accel=TRUTH.accel)
    recording = read(write_mcap(tmp_path / "log.mcap", imu_messages(late)))
    found = np.array([series.samples for series in recording.series]).T
    assert np.array_equal(found, TRUTH.all)
    assert recording.findings[0].code == "log-out-of-order"


def test_messages_recorded_twice_are_read_once(tmp_path: Path) -> None:
    """The recorder had two subscriptions to the topic."""
    messages = imu_messages(TRUTH)
    recording = read(write_mcap(tmp_path / "log.mcap", merged(messages, messages)))
    found = np.array([series.samples for series in recording.series]).T
    assert np.array_equal(found, TRUTH.all)
    assert "duplicate-stamps" in [finding.code for finding in recording.findings]


@pytest.mark.parametrize(("name", "found"), [("/imu/temperature", True), ("/motor/temperature", False)])
def test_the_temperature_in_the_namespace_of_the_imu_is_read(
    name: str, found: object, tmp_path: Path
) -> None:
    """The temperature has a separate topic; topics in other namespaces can belong to other devices."""
    types = store()
    kind = "sensor_msgs/msg/Temperature"
    heat = types.types[kind]
    stamps = TRUTH.stamps[::10]
    messages = [
        Message(
            topic=name,
            type=kind,
            log=stamp + 1000,
            data=bytes(types.serialize_cdr(heat(header(types, stamp), 20.0 + row / 4, 0.0), kind)),
        )
        for row, stamp in enumerate(stamps.tolist())
    ]
    path = write_mcap(tmp_path / "log.mcap", merged(imu_messages(TRUTH), messages))
    temperature = read(path).temperature
    assert (temperature is not None) == found
    if temperature is not None:
        assert temperature.samples.tolist() == [20.0 + row / 4 for row in range(12)]
        assert temperature.clock.rate_hz == pytest.approx(10)


def two_imus(definition: str, build: Any) -> tuple[Any, list[Message]]:  # noqa: ANN401
    """Return types including one with that definition, and its messages; `build` gets types and row."""
    types = store(acme__msg__Pair=definition)
    messages = []
    for row, (stamp, log) in enumerate(zip(TRUTH.stamps.tolist(), TRUTH.log.tolist(), strict=True)):
        message = types.types["acme/msg/Pair"](header=header(types, stamp), **build(types, row))
        data = bytes(types.serialize_cdr(message, "acme/msg/Pair"))
        messages.append(Message(topic="/pair", type="acme/msg/Pair", log=log, data=data))
    return types, messages


def test_two_imus_in_a_message_require_a_choice(tmp_path: Path) -> None:
    """The error proposes a columns text for each IMU, and both texts work."""
    other = samples(120, seed=9)

    def build(types: Any, row: int) -> dict[str, Any]:  # noqa: ANN401
        left = imu(types, int(TRUTH.stamps[row]), TRUTH.gyro[row], TRUTH.accel[row])
        return {"left": left, "right": imu(types, int(other.stamps[row]), other.gyro[row], other.accel[row])}

    types, messages = two_imus("std_msgs/Header header\nsensor_msgs/Imu left\nsensor_msgs/Imu right", build)
    path = write_mcap(tmp_path / "log.mcap", messages, types=types)
    with pytest.raises(ChoiceError) as caught:
        read(path)
    problem = (
        "2 sets of gyroscope columns: left.angular_velocity.x, right.angular_velocity.x; found columns: "
    )
    assert str(caught.value).startswith(f"{path}: topic /pair: {problem}")
    texts = re.search(r"such as (\S+) or (\S+) ", str(caught.value))
    assert texts is not None
    names = [f"g={side}.angular_velocity,a={side}.linear_acceleration" for side in ("left", "right")]
    for one, name, truth in zip(texts.groups(), names, (TRUTH, other), strict=True):
        for text in (one, name):
            recording = read(path, columns=text)
            assert np.array_equal(np.array([series.samples for series in recording.series]), truth.all.T)
            assert recording.source.topics == ("/pair",)
    (topic,) = describe(path).topics
    assert topic.note.startswith(problem)


def test_a_second_acceleration_in_a_message_requires_a_choice(tmp_path: Path) -> None:
    """The message has an IMU and a separate acceleration; both proposed texts work."""

    def build(types: Any, row: int) -> dict[str, Any]:  # noqa: ANN401
        vector = types.types["geometry_msgs/msg/Vector3"]
        left = imu(types, int(TRUTH.stamps[row]), TRUTH.gyro[row], TRUTH.accel[row])
        return {"imu": left, "acceleration": vector(1.0, 2.0, float(row))}

    definition = "std_msgs/Header header\ngeometry_msgs/Vector3 acceleration\nsensor_msgs/Imu imu"
    types, messages = two_imus(definition, build)
    path = write_mcap(tmp_path / "log.mcap", messages, types=types)
    with pytest.raises(ChoiceError) as caught:
        read(path)
    assert "2 sets of accelerometer columns: acceleration.x, imu.linear_acceleration.x" in str(caught.value)
    texts = re.search(r"such as (\S+) or (\S+) ", str(caught.value))
    assert texts is not None
    expected = np.stack([np.ones(120), TRUTH.accel[:, 0]])
    found = [read(path, columns=text).axis("accelerometer", "x").samples for text in texts.groups()]
    assert np.array_equal(found, expected)
