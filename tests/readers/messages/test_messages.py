"""Message types of every layout: what rosbags wrote by its own code, the walker finds by the definition."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.testing as npt
import pytest

from imucal.errors import ChoiceError, ReadError
from imucal.readers import describe, read
from imucal.recording import Recording
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
    """Serialise one message a sample; `build` gets the row."""
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
def test_reads_frame_ids_of_any_length_in_both_byte_orders(
    frames: Sequence[str],
    order: str,
    tmp_path: Path,
) -> None:
    """Strings of different lengths shift what follows, message by message."""
    messages = imu_messages(TRUTH, frames=frames, little_endian=order == "little")
    check(read(write_mcap(tmp_path / "log.mcap", messages)))


def test_reads_both_byte_orders_in_one_topic(tmp_path: Path) -> None:
    """Two publishers on different machines."""
    little = imu_messages(TRUTH, frames=("a", "abcdef"))
    big = imu_messages(TRUTH, frames=("a", "abcdef"), little_endian=False)
    mixed = [(big if row % 3 else little)[row] for row in range(len(little))]
    check(read(write_mcap(tmp_path / "log.mcap", mixed)))


@pytest.mark.parametrize("frames", [("imu",), ("a", "bcd")])
def test_reads_ros1_frame_ids_of_any_length(frames: Sequence[str], tmp_path: Path) -> None:
    """ROS 1 strings have no terminator and nothing is aligned."""
    messages = imu_messages(TRUTH, ros1=True, frames=frames)
    check(read(write_bag(tmp_path / "log.bag", messages, compression="lz4")))


def test_reads_xcdr2(tmp_path: Path) -> None:
    """Doubles are aligned to four bytes; laid out by hand here."""
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
def test_refuses_other_encapsulations(code: int, tmp_path: Path) -> None:
    """Parameter lists and the like are laid out in another way."""
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
def test_reads_custom_types_that_hold_an_imu(big: bool, tmp_path: Path) -> None:  # noqa: FBT001
    """Strings, sequences and structures in front, at another depth; the type's name says nothing."""
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


def test_numbers_behind_a_list_of_texts_are_read(tmp_path: Path) -> None:
    """Structures of strings in front can't be skipped at once: messages are parsed one by one."""
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
def test_reads_px4_sensor_combined(defined: bool, tmp_path: Path) -> None:  # noqa: FBT001
    """Microseconds and arrays of float32; a log without the definition needs its .msg file."""
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
        with pytest.raises(ChoiceError, match=r"give its \.msg file, SensorCombined\.msg"):
            read(path)
    recording = read(path) if defined else read(path, message_definition=file)
    assert np.array_equal(axes(recording), single.astype(np.float64))
    assert recording.series[0].clock.start_ns == TRUTH.stamps[0]


def test_reads_px4_vehicle_imu(tmp_path: Path) -> None:
    """Increments over a time each become rates; a time of zero gives no sample."""
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


def test_refuses_a_built_in_definition_that_does_not_fit(tmp_path: Path) -> None:
    """Another version of the type has another size: better no samples than wrong ones."""
    messages = [
        Message(topic=TOPIC, type=IMU, log=m.log, data=m.data + bytes(16)) for m in imu_messages(TRUTH)
    ]
    path = write_mcap(tmp_path / "log.mcap", messages, definitions={IMU: ("", "")})
    with pytest.raises(ReadError, match=r"a message has \d+ bytes instead of the \d+ of its definition"):
        read(path)


def test_a_damaged_definition_is_refused(tmp_path: Path) -> None:
    """A definition that lost a field would shift all others; the right one can be given."""
    text, _ = store().generate_msgdef(IMU, ros_version=2)
    damaged = text.replace("float64[9] angular_velocity_covariance", "float64[8] angular_velocity_covariance")
    assert damaged != text
    path = write_mcap(tmp_path / "log.mcap", imu_messages(TRUTH), definitions={IMU: ("ros2msg", damaged)})
    with pytest.raises(ReadError, match=r"a message has \d+ bytes instead of the \d+ of its definition"):
        read(path)


def test_reads_json_messages(tmp_path: Path) -> None:
    """Foxglove's way of writing a ROS message."""
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


def test_a_json_stamp_beyond_all_times_loses_its_message_alone(tmp_path: Path) -> None:
    """It is no number of 64 bits; the others are read, and it is said."""
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


def test_refuses_an_encoding_by_name(tmp_path: Path) -> None:
    """Topic, type and encoding, and what can be read."""
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


def test_a_definition_file_makes_up_for_a_missing_one(tmp_path: Path) -> None:
    """A bag from before ROS 2 Iron with a type of one's own."""
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


def test_units_of_a_type_of_ones_own(tmp_path: Path) -> None:
    """The caller says deg/s and g, or a scale."""
    path = write_db3(tmp_path / "bag", imu_messages(TRUTH))
    recording = read(path, gyro_unit="deg/s", accel_scale=0.5)
    npt.assert_allclose(axes(recording)[:, :3], np.deg2rad(TRUTH.gyro), rtol=1e-15)
    npt.assert_array_equal(axes(recording)[:, 3:], TRUTH.accel * 0.5)
    with pytest.raises(
        ChoiceError, match="topic /imu/data: 'furlong' is not a unit of the gyroscope; expected one of"
    ):
        read(path, gyro_unit="furlong")


def test_two_publishers_may_differ(tmp_path: Path) -> None:
    """One topic, two channels: other definitions, other frame ids, and a byte too many at the end."""
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


def test_takes_the_built_in_definition_for_idl(tmp_path: Path) -> None:
    """Of an IDL definition only the name is understood; types of one's own need a .msg file."""
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


def test_not_a_number_passes_through(tmp_path: Path) -> None:
    """What to do with it is not the reader's business."""
    truth = samples(50)
    truth.gyro[3, 1] = np.nan
    truth.accel[7, 2] = np.inf
    recording = read(write_mcap(tmp_path / "log.mcap", imu_messages(truth)))
    npt.assert_array_equal(axes(recording), truth.all)
