"""Message types of every layout: decoding by the definition equals the values that rosbags wrote."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.testing as npt
import pytest

from imucal.errors import ChoiceError, ReadError
from imucal.readers import describe, read
from imucal.recording import Recording
from tests.raising import raises
from tests.readers.logs import (
    IMU,
    TOPIC,
    Message,
    Samples,
    header,
    imu,
    imu_messages,
    samples,
    store,
    write_bag,
    write_db3,
    write_mcap,
)

TRUTH = samples(120)


def axes(recording: Recording) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the samples, shape (n, axes)."""
    return np.array([series.samples for series in recording.series]).T


def check(recording: Recording, truth: Samples = TRUTH) -> None:
    """Compare samples and start with the truth."""
    assert np.array_equal(axes(recording), truth.all)
    assert recording.series[0].clock.start_ns == truth.stamps[0]


def messages_of(kind: str, types: Any, build: Any, *, big: bool = False) -> list[Message]:  # noqa: ANN401
    """Serialise one message per sample; `build` gets the row."""
    return [
        Message(
            topic=TOPIC,
            type=kind,
            log=log,
            data=bytes(types.serialize_cdr(build(row), kind, little_endian=not big)),
        )
        for row, log in enumerate(TRUTH.log.tolist())
    ]


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("frames", [("imu",), ("a", "imu_link", "", "a/very/long/frame/of/reference", "xyz")])
def test_frame_ids_of_any_length_are_read_in_both_byte_orders(
    frames: Sequence[str],
    order: str,
    tmp_path: Path,
) -> None:
    """Strings of different lengths shift the following fields from message to message."""
    messages = imu_messages(TRUTH, frames=frames, little_endian=order == "little")
    check(read(write_mcap(tmp_path / "log.mcap", messages)))


def test_one_topic_can_have_both_byte_orders(tmp_path: Path) -> None:
    """The two publishers run on different machines."""
    little = imu_messages(TRUTH, frames=("a", "abcdef"))
    big = imu_messages(TRUTH, frames=("a", "abcdef"), little_endian=False)
    mixed = [(big if row % 3 else little)[row] for row in range(len(little))]
    check(read(write_mcap(tmp_path / "log.mcap", mixed)))


@pytest.mark.parametrize("frames", [("imu",), ("a", "bcd")])
def test_ros1_frame_ids_of_any_length_are_read(frames: Sequence[str], tmp_path: Path) -> None:
    """ROS 1 strings have no terminator, and no field is aligned."""
    messages = imu_messages(TRUTH, ros1=True, frames=frames)
    check(read(write_bag(tmp_path / "log.bag", messages, compression="lz4")))


def test_xcdr2_is_read(tmp_path: Path) -> None:
    """XCDR2 aligns doubles to four bytes; the test builds the messages by hand."""
    result = []
    for row, message in enumerate(imu_messages(TRUTH)):
        stamp = int(TRUTH.stamps[row])
        body = (stamp // 10**9).to_bytes(4, "little") + (stamp % 10**9).to_bytes(4, "little")
        body += (4).to_bytes(4, "little") + b"imu\0"
        numbers = np.zeros(37)
        numbers[13:16], numbers[25:28] = TRUTH.gyro[row], TRUTH.accel[row]
        data = b"\x00\x07\x00\x00" + body + numbers.tobytes()
        result.append(Message(topic=TOPIC, type=IMU, log=message.log, data=data))
    check(read(write_mcap(tmp_path / "log.mcap", result)))


@pytest.mark.parametrize("code", [0x0002, 0x0003, 0x0009, 0x1234])
def test_other_encapsulations_are_refused(code: int, tmp_path: Path) -> None:
    """Parameter lists, for example, have another layout."""
    messages = [
        Message(topic=TOPIC, type=IMU, log=m.log, data=code.to_bytes(2, "big") + m.data[2:])
        for m in imu_messages(TRUTH)
    ]
    path = write_mcap(tmp_path / "log.mcap", messages)
    with pytest.raises(ReadError) as caught:
        read(path)
    assert str(caught.value) == (
        f"{path}: no message of topic {TOPIC} could be read: encapsulation 0x{code:04x} is not supported; "
        "expected plain CDR or XCDR2"
    )


CUSTOM = """
std_msgs/Header header
string name
string[2] fixed_names
float32[] readings
geometry_msgs/Vector3[] points
uint8 flag
bool[3] flags
int16 FIVE=5
uint8[<=4] few  # bounded
sensor_msgs/Imu imu
float64 temperature
"""


@pytest.mark.parametrize("big", [False, True])
def test_an_imu_within_a_custom_type_is_read(big: bool, tmp_path: Path) -> None:  # noqa: FBT001
    """Strings, sequences and structures precede the IMU, and the name of the type has no meaning."""
    text = CUSTOM.replace("string[2] fixed_names\n", "")
    types = store(acme__msg__Widget=text)
    known = types.types
    vector = known["geometry_msgs/msg/Vector3"]

    def build(row: int) -> Any:  # noqa: ANN401
        stamp = int(TRUTH.stamps[row])
        return known["acme/msg/Widget"](
            header=header(types, stamp),
            name="x" * (row % 5),
            readings=np.arange(row % 4, dtype=np.float32),
            points=[vector(1.0, 2.0, 3.0)] * (row % 3),
            flag=1,
            flags=np.array([True, False, True]),
            few=np.arange(row % 4, dtype=np.uint8),
            imu=imu(types, stamp, TRUTH.gyro[row], TRUTH.accel[row], "f" * (row % 7)),
            temperature=20.0 + row,
        )

    messages = messages_of("acme/msg/Widget", types, build, big=big)
    recording = read(write_mcap(tmp_path / "log.mcap", messages, types=types))
    check(recording)
    assert recording.temperature is not None
    npt.assert_array_equal(recording.temperature.samples, 20.0 + np.arange(120))


def test_numbers_after_a_list_of_strings_are_read(tmp_path: Path) -> None:
    """Structures with strings have no fixed size, so messages are parsed one by one."""
    types = store(acme__msg__ImuList="diagnostic_msgs/KeyValue[] pairs\nbool[2] on\nsensor_msgs/Imu imu")
    known = types.types
    pair = known["diagnostic_msgs/msg/KeyValue"](key="a", value="b")

    def build(row: int) -> Any:  # noqa: ANN401
        reading = imu(types, int(TRUTH.stamps[row]), TRUTH.gyro[row], TRUTH.accel[row])
        return known["acme/msg/ImuList"](pairs=[pair], on=np.array([True, False]), imu=reading)

    path = write_mcap(tmp_path / "log.mcap", messages_of("acme/msg/ImuList", types, build), types=types)
    check(read(path))
    check(read(path, columns="g=imu.angular_velocity,a=imu.linear_acceleration"))


PX4_COMBINED = """
uint64 timestamp
float32[3] gyro_rad
uint32 gyro_integral_dt
int32 accelerometer_timestamp_relative
float32[3] accelerometer_m_s2
uint32 accelerometer_integral_dt
uint8 accelerometer_clipping
uint8 gyro_clipping
uint8 accel_calibration_count
uint8 gyro_calibration_count
"""
PX4_IMU = """
uint64 timestamp
uint64 timestamp_sample
uint32 accel_device_id
uint32 gyro_device_id
float32[3] delta_angle
float32[3] delta_velocity
uint32 delta_angle_dt
uint32 delta_velocity_dt
uint8 delta_angle_clipping
uint8 delta_velocity_clipping
uint8 accel_calibration_count
uint8 gyro_calibration_count
"""


@pytest.mark.parametrize("defined", [True, False])
def test_px4_sensor_combined_is_read(defined: bool, tmp_path: Path) -> None:  # noqa: FBT001
    """The stamps are microseconds. A log without the definition needs the .msg file."""
    types = store(px4_msgs__msg__SensorCombined=PX4_COMBINED)
    single = TRUTH.all.astype(np.float32)

    def build(row: int) -> Any:  # noqa: ANN401
        return types.types["px4_msgs/msg/SensorCombined"](
            int(TRUTH.stamps[row] // 1000), single[row, :3], 4000, 0, single[row, 3:], 4000, 0, 0, 0, 0
        )

    messages = messages_of("px4_msgs/msg/SensorCombined", types, build)
    given = None if defined else {"px4_msgs/msg/SensorCombined": ("", "")}
    path = write_mcap(tmp_path / "log.mcap", messages, types=types, definitions=given)
    file = tmp_path / "SensorCombined.msg"
    file.write_text(PX4_COMBINED, encoding="utf-8")
    if not defined:
        with raises(ChoiceError, r"SensorCombined\.msg", place="log.mcap", argument="message_definition"):
            read(path)
    recording = read(path) if defined else read(path, message_definition=file)
    assert np.array_equal(axes(recording), single.astype(np.float64))
    assert recording.series[0].clock.start_ns == TRUTH.stamps[0]


def test_increments_of_px4_vehicle_imu_become_rates(tmp_path: Path) -> None:
    """An increment is divided by its duration; a duration of zero gives no sample."""
    types = store(px4_msgs__msg__VehicleImu=PX4_IMU)
    spans = np.where(np.arange(120) % 2, 9_990, 10_010).astype(np.uint32)
    spans[50] = 0
    seconds = spans[:, None] * 1e-6
    steps = (TRUTH.all * seconds).astype(np.float32)

    def build(row: int) -> Any:  # noqa: ANN401
        time = int(TRUTH.stamps[row] // 1000)
        return types.types["px4_msgs/msg/VehicleImu"](
            time + 7, time, 1, 2, steps[row, :3], steps[row, 3:], int(spans[row]), int(spans[row]), 0, 0, 0, 0
        )

    messages = messages_of("px4_msgs/msg/VehicleImu", types, build)
    recording = read(write_mcap(tmp_path / "log.mcap", messages, types=types))
    good = spans > 0
    expected = steps.astype(np.float64)[good] / (spans[good].astype(np.float64) * 1e-6)[:, None]
    npt.assert_array_equal(axes(recording)[good], expected)
    assert np.isnan(axes(recording)[50]).all()
    assert recording.series[0].clock.start_ns == TRUTH.stamps[0]


def test_a_built_in_definition_of_another_size_is_refused(tmp_path: Path) -> None:
    """The log has another version of the type, so samples would be wrong."""
    messages = [
        Message(topic=TOPIC, type=IMU, log=m.log, data=m.data + bytes(16)) for m in imu_messages(TRUTH)
    ]
    path = write_mcap(tmp_path / "log.mcap", messages, definitions={IMU: ("", "")})
    with pytest.raises(ReadError, match=r"a message has \d+ bytes instead of the \d+ of its definition"):
        read(path)


def test_a_damaged_definition_is_refused(tmp_path: Path) -> None:
    """A missing field would shift all other fields. The user can give the right definition."""
    text, _ = store().generate_msgdef(IMU, ros_version=2)
    damaged = text.replace("float64[9] angular_velocity_covariance", "float64[8] angular_velocity_covariance")
    assert damaged != text
    path = write_mcap(tmp_path / "log.mcap", imu_messages(TRUTH), definitions={IMU: ("ros2msg", damaged)})
    with raises(ReadError, "316 bytes instead of the 308", place="log.mcap"):
        read(path)


def test_json_messages_are_read(tmp_path: Path) -> None:
    """Foxglove writes ROS messages as JSON."""
    import json

    messages = []
    for row, stamp in enumerate(TRUTH.stamps.tolist()):
        content = {
            "header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": "é"},
            "angular_velocity": dict(zip("xyz", TRUTH.gyro[row].tolist(), strict=True)),
            "linear_acceleration": TRUTH.accel[row].tolist(),
        }
        data = json.dumps(content).encode()
        messages.append(Message(topic=TOPIC, type=IMU, log=stamp, data=data, encoding="json"))
    check(read(write_mcap(tmp_path / "log.mcap", messages, definitions={IMU: ("jsonschema", "{}")})))


def test_a_json_stamp_beyond_64_bits_loses_only_its_message(tmp_path: Path) -> None:
    """The other messages are read, and a finding reports the loss."""
    import json

    messages = []
    for row, stamp in enumerate(TRUTH.stamps.tolist()):
        content = {
            "header": {"stamp": {"sec": 10**40 if row == 7 else stamp // 10**9, "nanosec": stamp % 10**9}},
            "angular_velocity": TRUTH.gyro[row].tolist(),
            "linear_acceleration": TRUTH.accel[row].tolist(),
        }
        data = json.dumps(content).encode()
        messages.append(Message(topic=TOPIC, type=IMU, log=stamp, data=data, encoding="json"))
    recording = read(write_mcap(tmp_path / "log.mcap", messages, definitions={IMU: ("jsonschema", "{}")}))
    assert recording.series[0].samples.size == len(messages) - 1
    assert "a JSON message has no IMU sample: OverflowError" in recording.findings[0].text


def test_an_unknown_encoding_is_refused(tmp_path: Path) -> None:
    """The error contains topic, type, encoding and the supported encodings."""
    messages = [
        Message(topic=TOPIC, type="acme.Imu", log=log, data=b"\x0a\x00", encoding="flatbuffer")
        for log in TRUTH.log.tolist()
    ]
    path = write_mcap(tmp_path / "log.mcap", messages, definitions={"acme.Imu": ("flatbuffer", "")})
    with pytest.raises(ChoiceError) as caught:
        read(path)
    assert str(caught.value) == (
        f"{path}: topic {TOPIC} of type acme.Imu can't be read: messages are encoded as 'flatbuffer'; "
        "expected one of cdr, ros1, json, protobuf; convert the log to CSV with a row "
        "per message, or to JSON messages"
    )


def test_a_definition_file_replaces_a_missing_definition(tmp_path: Path) -> None:
    """Bags before ROS 2 Iron contain no definitions of custom types."""
    text = "std_msgs/Header header\nfloat32 spare\nfloat64[3] gyro\nfloat64[3] accel\n"
    types = store(acme__msg__RawImu=text)

    def build(row: int) -> Any:  # noqa: ANN401
        stamp = header(types, int(TRUTH.stamps[row]))
        return types.types["acme/msg/RawImu"](stamp, 0.0, TRUTH.gyro[row], TRUTH.accel[row])

    kind = "acme/msg/RawImu"
    messages = messages_of(kind, types, build)
    path = write_mcap(tmp_path / "log.mcap", messages, definitions={kind: ("", "")})
    with pytest.raises(ChoiceError) as caught:
        read(path)
    assert str(caught.value) == (
        f"{path}: topic {TOPIC} of type {kind} can't be read: the log has no definition of {kind}; "
        "give its .msg file, RawImu.msg"
    )
    own, _ = types.generate_msgdef(kind, ros_version=2)
    file = tmp_path / "RawImu.msg"
    file.write_text(own, encoding="utf-8")
    recording = read(path, message_definition=file)
    check(recording)
    unit = dict(recording.source.decisions)["gyroscope unit"]
    assert unit == "rad/s, inferred: the log does not contain it; the accelerometer is in SI units"
    assert [finding.code for finding in recording.findings] == ["delay", "unit-assumed"]


def test_units_and_scales_of_messages_can_be_given(tmp_path: Path) -> None:
    path = write_db3(tmp_path / "bag", imu_messages(TRUTH))
    recording = read(path, gyro_unit="deg/s", accel_scale=0.5)
    npt.assert_allclose(axes(recording)[:, :3], np.deg2rad(TRUTH.gyro), rtol=1e-15)
    npt.assert_array_equal(axes(recording)[:, 3:], TRUTH.accel * 0.5)
    with raises(ChoiceError, "'furlong'", argument="gyro_unit"):
        read(path, gyro_unit="furlong")


def test_two_publishers_of_a_topic_can_differ(tmp_path: Path) -> None:
    """The two channels have different definitions and frame ids, and one has an extra byte at the end."""
    from mcap.writer import Writer

    types = store()
    text, _ = types.generate_msgdef(IMU, ros_version=2)
    messages = imu_messages(TRUTH, frames=("a", "abcdefgh"))
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=4096)
        writer.start("ros2", "test")
        channels = [
            writer.register_channel(TOPIC, "cdr", writer.register_schema(IMU, "ros2msg", definition.encode()))
            for definition in (text, text + "\n# another version of the comments\n")
        ]
        for row, message in enumerate(messages):
            data = message.data + (b"\0" if row % 2 else b"")
            writer.add_message(channels[row % 2], message.log, data, message.log)
        writer.finish()  # type: ignore[no-untyped-call]
    check(read(path))
    assert [topic.count for topic in describe(path).topics] == [120]


def test_the_built_in_definition_replaces_an_idl_definition(tmp_path: Path) -> None:
    """IDL definitions are not parsed; custom types need a .msg file."""
    path = write_mcap(
        tmp_path / "log.mcap", imu_messages(TRUTH), definitions={IMU: ("ros2idl", "module sensor_msgs {};")}
    )
    check(read(path))
    kind = "acme/msg/Imu"
    own = [Message(topic=TOPIC, type=kind, log=m.log, data=m.data) for m in imu_messages(TRUTH)]
    path = write_mcap(tmp_path / "own.mcap", own, definitions={kind: ("ros2idl", "module acme {};")})
    with pytest.raises(ChoiceError) as caught:
        read(path)
    assert str(caught.value) == (
        f"{path}: topic {TOPIC} of type {kind} can't be read: the log has no definition of {kind}, "
        f"except one of kind 'ros2idl'; give its .msg file, Imu.msg"
    )


def test_nan_and_infinity_in_messages_are_kept(tmp_path: Path) -> None:
    """The reader does not decide what to do with them."""
    truth = samples(50)
    truth.gyro[3, 1] = np.nan
    truth.accel[7, 2] = np.inf
    recording = read(write_mcap(tmp_path / "log.mcap", imu_messages(truth)))
    npt.assert_array_equal(axes(recording), truth.all)
