"""Detection of the IMU columns of a message: by name, at any depth, several in one message."""

from collections.abc import Iterator
from itertools import count, pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from imucal.errors import ChoiceError, ReadError
from imucal.readers.candidates import Candidate, is_command
from imucal.readers.choose import candidates_of
from imucal.readers.clocks import LOG_TIME
from imucal.readers.containers import Channel
from imucal.readers.messages import schemas
from imucal.readers.messages.definitions import DefinitionError, defined, read_definitions
from imucal.readers.messages.schemas import protobuf_leaves
from imucal.readers.messages.topics import Topic, find_topics
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.column_log import ColumnLog
from imucal.readers.tables.plan import SensorPlan, TablePlan
from imucal.recording import Sensor
from tests.raising import raises

GYRO, ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER
V3 = "===\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
QUATERNION = "===\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
IMU = "===\nMSG: pkg/Imu\nbuiltin_interfaces/Time stamp\nfloat64 temp\nfloat64[3] gyro\nfloat64[3] accel\n"
HEADER = "===\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"


def topic_of(text: str, name: str, topic: str, options: ReadOptions) -> Topic:
    """Return a topic of a log without messages."""
    channel = Channel(
        key=1, topic=topic, type=name, encoding="cdr", definition=text, definition_kind="ros2msg"
    )
    container: Any = SimpleNamespace(channels=[channel])
    (one,) = find_topics([container], options)
    return one


def found(text: str, *, name: str = "pkg/M", topic: str = "/t", **options: Any) -> Candidate:  # noqa: ANN401
    """Return a topic of a log without messages as a candidate."""
    asked = ReadOptions(**options)
    log = ColumnLog(Path("log"), {})
    log.tables = [topic_of(text, name, topic, asked).table([], asked)]
    (one,) = candidates_of(log, asked)
    return one


def planned(topic: Candidate) -> TablePlan:
    """Return the columns of a topic, chosen only by its names."""
    return topic.plan


def paths(plan: TablePlan) -> dict[Sensor, tuple[str, ...]]:
    """Return the names of the columns of each sensor."""
    return {sensor.triad.sensor: sensor.triad.headers for sensor in plan.sensors}


def time_of(sensor: SensorPlan) -> tuple[str, int | None] | None:
    """Return the name of a sensor's time and its ns per count; None for the log time."""
    if sensor.time is None or sensor.time.name == LOG_TIME:
        return None
    return sensor.time.name, sensor.time.ns


@pytest.mark.parametrize(
    ("text", "gyro"),
    [
        ("float64[3] gyro", ("gyro[0]", "gyro[1]", "gyro[2]")),
        ("float32[3] gyro", ("gyro[0]", "gyro[1]", "gyro[2]")),
        ("int32[3] gyro", ("gyro[0]", "gyro[1]", "gyro[2]")),
        ("float64 gyro_x\nfloat64 gyro_y\nfloat64 gyro_z", ("gyro_x", "gyro_y", "gyro_z")),
        ("float64 gyro_x\nint32 gyro_y\nfloat64 gyro_z", ("gyro_x", "gyro_y", "gyro_z")),
        ("geometry_msgs/Vector3 gyro\n" + V3, ("gyro.x", "gyro.y", "gyro.z")),
        ("float64[4] gyro", None),
        ("float64[] gyro", None),
        ("float64 gyro_x\nfloat64 gyro_y", None),
        ("float64[3] orientation", None),
        ("geometry_msgs/Quaternion rate\n" + QUATERNION, None),
        ("geometry_msgs/Vector3 rotation\n" + V3, None),
        ("geometry_msgs/Vector3[] gyro\n" + V3, None),
        ("float64[9] angular_velocity_covariance", None),
        ("float64[3] mean_gyro", None),
        ("float64 gx\nfloat64 gy\nfloat64 gz", None),
    ],
)
def test_three_numbers_are_a_vector(text: str, gyro: tuple[str, ...] | None) -> None:
    """The numbers are an array, a structure or three fields; quaternions and angles do not count."""
    topic = found(text)
    assert topic.sensors == (() if gyro is None else (GYRO,))
    if gyro is not None:
        assert paths(planned(topic)) == {GYRO: gyro}


@pytest.mark.parametrize(
    ("name", "gyro", "accel", "stated"),
    [
        ("sensor_msgs/msg/Imu", "angular_velocity", "linear_acceleration", True),
        ("pkg/M", "angular_velocity", "linear_acceleration", True),
        ("pkg/M", "gyro", "accel", False),
        ("px4_msgs/msg/M", "gyro", "accel", True),
    ],
)
def test_units_are_certain_only_in_known_types(name: str, gyro: str, accel: str, *, stated: bool) -> None:
    """Known types are those of ROS and PX4, and fields with the same names.

    Units of other types are inferred.
    """
    plan = planned(found(f"geometry_msgs/Vector3 {gyro}\ngeometry_msgs/Vector3 {accel}\n" + V3, name=name))
    units = [(one.stated.unit, one.stated.reason) if one.stated else None for one in plan.sensors]
    known = [("rad/s", "from the message type"), ("m/s^2", "from the message type")]
    assert units == (known if stated else [None, None])


def test_single_letters_are_sensors_only_in_pairs() -> None:
    """Without rates, ax, ay, az could be the acceleration of a position."""
    text = "".join(f"float64 {letter}{axis}\n" for letter in "va" for axis in "xyz")
    assert found(text).sensors == ()
    assert found(text, columns="a=ax+ay+az").sensors == (ACCEL,)
    assert found(text.replace("v", "w")).sensors == (GYRO, ACCEL)


def test_a_unit_in_a_name_overrides_the_type() -> None:
    text = "".join(f"float64 gyro_{axis}_dps\n" for axis in "xyz")
    for name in ("pkg/M", "sensor_msgs/M"):
        (sensor,) = planned(found(text, name=name)).sensors
        assert sensor.stated is not None
        assert (sensor.stated.unit, sensor.stated.reason) == ("deg/s", "from the column header")


def test_several_imus_in_a_message_require_a_choice() -> None:
    """Each IMU can be named and has its own stamp."""
    topic = found("pkg/Imu left\npkg/Imu right\n" + IMU)
    assert topic.sensors == (GYRO, ACCEL)
    with raises(ChoiceError, r"left.gyro\[0\], right.gyro\[0\]", place="topic /t", argument="columns"):
        planned(topic)
    for side in ("left", "right"):
        asked = {"columns": f"g={side}.gyro,a={side}.accel,t={side}.stamp"}
        plan = found("pkg/Imu left\npkg/Imu right\n" + IMU, **asked).plan
        assert paths(plan)[ACCEL] == tuple(f"{side}.accel[{i}]" for i in range(3))
        assert time_of(plan.sensors[0]) == (f"{side}.stamp", 1)


def test_separate_fields_can_form_one_imu() -> None:
    """Two gyroscopes require a choice."""
    one = "===\nMSG: pkg/G\nfloat64[3] gyro\n===\nMSG: pkg/A\nfloat64[3] accel\n"
    plan = planned(found("pkg/G first\npkg/A second\n" + one))
    assert {sensor: names[0] for sensor, names in paths(plan).items()} == {
        GYRO: "first.gyro[0]",
        ACCEL: "second.accel[0]",
    }
    with raises(ChoiceError, "2 sets of gyroscope columns", place="topic /t", argument="columns"):
        planned(found("pkg/G first\npkg/G second\npkg/A third\n" + one))


@pytest.mark.parametrize(
    ("topic", "sensor"),
    [
        ("/camera/gyro/sample", GYRO),
        ("/accel", ACCEL),
        ("/imu/w", GYRO),
        ("/wheel", None),
        ("/w_raw", GYRO),
        ("/gyro_accel", None),
        ("/vectors", None),
        ("/specific_force", ACCEL),
        ("/omega", GYRO),
        ("/angular_accel", None),
    ],
)
def test_the_name_of_a_topic_can_contain_one_sensor(topic: str, sensor: Sensor | None) -> None:
    """A topic with a sensor in its name is read only if the user names it."""
    one = found("float64 x\nfloat64 y\nfloat64 z", name="geometry_msgs/msg/Vector3", topic=topic)
    assert one.sensors == ((sensor,) if sensor else ())
    assert one.weak == bool(one.sensors)
    stamped = found("geometry_msgs/Vector3 vector\n" + V3, name="geometry_msgs/Vector3Stamped", topic=topic)
    assert stamped.sensors == one.sensors


def test_the_order_of_named_topics_gives_the_sensors() -> None:
    """The first topic is the gyroscope, whatever its name is. A twist is always a gyroscope."""
    text = "float64 x\nfloat64 y\nfloat64 z"
    vector: dict[str, Any] = {"name": "geometry_msgs/msg/Vector3", "topics": ("/accel", "/b")}
    first, second = (found(text, topic=topic, **vector) for topic in ("/accel", "/b"))
    assert (first.sensors, second.sensors) == ((GYRO,), (ACCEL,))
    assert paths(planned(second)) == {ACCEL: ("x", "y", "z")}
    for topics in (("/b",), ("/a", "/b", "/c")):
        assert found(text, topic="/b", name="geometry_msgs/msg/Vector3", topics=topics).sensors == ()
    twist = "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n" + V3
    one = found(twist, name="geometry_msgs/Twist", topic="/b", topics=("/a", "/b"))
    assert paths(planned(one)) == {GYRO: ("angular.x", "angular.y", "angular.z")}
    one = found(twist, name="geometry_msgs/Accel")
    assert paths(planned(one)) == {ACCEL: ("accel.linear.x", "accel.linear.y", "accel.linear.z")}
    assert one.weak


def test_increments_of_px4_become_rates() -> None:
    """One message contains one or both sensors. The rule applies only to types of the package px4_msgs."""
    text = "uint64 timestamp\nuint64 timestamp_sample\nfloat32[3] delta_angle\nfloat32[3] delta_velocity\n"
    for span in ("delta_velocity_dt", "dt"):
        kind = "px4_msgs/msg/VehicleImu"
        topic = found(text + f"uint32 delta_angle_dt\nuint32 {span}", name=kind)
        plan = planned(topic)
        assert time_of(plan.sensors[0]) == ("timestamp_sample", 1000)
        numbers = topic_of(text + f"uint32 delta_angle_dt\nuint32 {span}", kind, "/t", ReadOptions()).numbers
        decoded = {numbers[index].path for sensor in plan.sensors for index in sensor.triad.indices}
        assert decoded == {
            *(f"delta_angle[{i}]/delta_angle_dt" for i in range(3)),
            *(f"delta_velocity[{i}]/{span}" for i in range(3)),
        }
    assert found(text + "uint32 delta_angle_dt\nuint32 dt", name="pkg/VehicleImu").sensors == ()
    text = "uint64 timestamp\nfloat32 x\nfloat32 y\nfloat32 z\nfloat32 temperature"
    for name, sensor in (("SensorGyro", GYRO), ("SensorAccel", ACCEL)):
        topic = found(text, name=f"px4_msgs/msg/{name}")
        plan = planned(topic)
        assert (topic.weak, paths(plan)) == (False, {sensor: ("x", "y", "z")})
        assert plan.temperature is not None
        assert topic.table.columns[plan.temperature].name == "temperature"
    assert found(text, name="px4_msgs/msg/SensorMag").sensors == ()
    plan = planned(
        found("uint64 timestamp\nfloat32[3] gyro_rad\nfloat32[3] accelerometer_m_s2", name="px4_msgs/X")
    )
    assert [time_of(sensor) for sensor in plan.sensors] == [("timestamp", 1000)] * 2


@pytest.mark.parametrize(
    ("text", "stamp"),
    [
        ("builtin_interfaces/Time stamp", "stamp"),
        ("builtin_interfaces/Time timestamp", "timestamp"),
        ("builtin_interfaces/Time time", "time"),
        ("builtin_interfaces/Time since", None),
        ("builtin_interfaces/Time since\nbuiltin_interfaces/Time time", "time"),
        ("builtin_interfaces/Time log_time\nstd_msgs/Header header", "header.stamp"),
    ],
)
def test_a_time_is_recognised_by_its_name(text: str, stamp: str | None) -> None:
    """The stamp of a header is preferred."""
    (sensor,) = planned(found(text + "\nfloat64[3] gyro\n" + HEADER)).sensors
    assert time_of(sensor) == ((stamp, 1) if stamp else None)


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("temperature", True),
        ("imu_temp", True),
        ("temp", True),
        ("board_temp", True),
        ("tempo", False),
        ("attempt", False),
    ],
)
def test_a_temperature_is_recognised_by_its_name(name: str, known: bool) -> None:  # noqa: FBT001
    plan = planned(found(f"float32 {name}\nfloat64[3] gyro"))
    assert plan.temperature == (0 if known else None)


def test_fields_after_an_unknown_layout_are_omitted() -> None:
    """Definitions with more than sixteen levels or twenty thousand elements are refused."""

    def nested(depth: int) -> str:
        names = [f"pkg/T{i}" for i in range(depth + 1)]
        parts = [f"===\nMSG: {one}\n{two} a\n" for one, two in pairwise(names)]
        return f"{names[0]} a\n" + "".join(parts) + f"===\nMSG: {names[-1]}\nfloat64 x\n"

    assert defined("pkg/M", nested(15), ros1=True).fields()[0].path == ".".join(["a"] * 16 + ["x"])
    with pytest.raises(DefinitionError, match="nests too deeply"):
        defined("pkg/M", nested(16), ros1=True).fields()
    many = "pkg/E[{}] a\n===\nMSG: pkg/E\n\n"
    assert defined("pkg/M", many.format(20_000), ros1=True).fields() == ()
    with pytest.raises(DefinitionError, match=r"^a has 20001 elements$"):
        defined("pkg/M", many.format(20_001), ros1=True).fields()
    assert [field.path for field in defined("pkg/M", "string s\nfloat64 x", ros1=True).fields()] == [
        "s",
        "x",
    ]
    for kind in ("time[2]", "time[]", "duration[1]"):
        assert [field.path for field in defined("pkg/M", f"{kind} s\nfloat64 x", ros1=True).fields()] == ["s"]
    assert [field.path for field in defined("pkg/M", "wstring s\nfloat64 x", ros1=True).fields()] == ["s"]
    assert [field.path for field in defined("pkg/M", "string[2] s\nfloat64 x", ros1=True).fields()] == ["s"]


def test_a_recursive_definition_is_refused() -> None:
    """The recursion is a field, an array or a sequence."""
    for text in ("pkg/M m", "pkg/M[] m", "pkg/M[2] m", "pkg/A[] a\n===\nMSG: pkg/A\npkg/A[] a"):
        with pytest.raises(DefinitionError, match="nests too deeply"):
            defined("pkg/M", text, ros1=True).fields()


@pytest.mark.parametrize(("ros1", "code"), [(True, "i1"), (False, "u1")])
def test_a_byte_is_signed_only_in_ros_1(ros1: bool, code: str) -> None:  # noqa: FBT001
    assert [field.code for field in defined("pkg/M", "byte b", ros1=ros1).fields()] == [code]


@pytest.mark.parametrize(
    ("topic", "command"),
    [("/turtle1/cmd_vel", True), ("/arm/command", True), ("/setpoint", True), ("/commander/imu", False),
     ("/twist", False), ("/targets/rate", True), ("/retarget", False)],
)  # fmt: skip
def test_a_topic_name_can_identify_commands(topic: str, *, command: bool) -> None:
    """Only complete words of the name count, and an IMU is never a command."""
    assert is_command(topic) is command
    twist = "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n" + V3
    assert found(twist, name="geometry_msgs/Twist", topic=topic).sensors == (() if command else (GYRO,))
    assert found(twist, name="geometry_msgs/Twist", topic=topic, topics=(topic,)).sensors == (GYRO,)
    assert found("float64[3] gyro", name="pkg/Imu", topic=topic).sensors == (GYRO,)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("float64 x\n" * 30_000, r"^it has 300000 bytes; expected at most 262144$"),
        ("float64[] x [" + "1," * 50_000 + "]", r"^a line has 100014 bytes; expected at most 16384$"),
        ("a/" * 50_000 + " x", r"^a line has 100002 bytes; expected at most 16384$"),
        # Structures without fields have no end by their fields.
        (
            "pkg/B[20000] b\n===\nMSG: pkg/B\npkg/C[20000] c\n===\nMSG: pkg/C\n",
            "too many fields",
        ),
    ],
)
def test_a_definition_that_takes_long_is_refused(text: str, expected: str) -> None:
    with pytest.raises(DefinitionError, match=expected):
        defined("pkg/M", text, ros1=True).fields()


@pytest.mark.parametrize("line", ["", "  ", "#", "\t# a comment"])
def test_many_lines_without_a_field_are_removed_first(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rosbags takes 8 s for 100 000 comments."""
    from rosbags import typesys

    parse, texts = typesys.get_types_from_msg, []

    def recorded(text: str, name: str) -> Any:  # noqa: ANN401 - rosbags nests tuples
        texts.append(text)
        return parse(text, name)

    monkeypatch.setattr(typesys, "get_types_from_msg", recorded)
    fields = defined("pkg/M", "float64 x\n" + f"{line}\n" * 20_000 + "float64 y", ros1=True).fields()
    assert [field.path for field in fields] == ["x", "y"]
    assert texts == ["float64 x\nfloat64 y\n"]


def test_a_definition_is_a_regular_file_of_usual_size(tmp_path: Path) -> None:
    """A link to a device has no end."""
    path = tmp_path / "Imu.msg"
    path.symlink_to("/dev/zero")
    with raises(ReadError, "a device", place="Imu.msg"):
        read_definitions([path])
    large = tmp_path / "Large.msg"
    large.write_text("float64 x\n" * 30_000)
    with raises(ReadError, "300000 bytes", place="Large.msg"):
        read_definitions([large])


def _wide(number: int) -> bytes:
    """Return descriptors of a message with `number` fields of a message that contains as many of itself."""
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet

    descriptors = FileDescriptorSet()
    file = descriptors.file.add(name="wide", syntax="proto3")
    for name in ("A", "B"):
        kind = file.message_type.add(name=name)
        for i in range(number):
            kind.field.add(
                name=f"f{i}",
                number=i + 1,
                type=FieldDescriptorProto.TYPE_MESSAGE,
                label=FieldDescriptorProto.LABEL_OPTIONAL,
                type_name=".B",
            )
    return bytes(descriptors.SerializeToString())


def test_protobuf_descriptors_have_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of nested types of 3000 fields each, 20 000 fields are visited, and more than 1 MiB is refused."""
    pytest.importorskip("google.protobuf")

    def channel(schema: bytes) -> Any:  # noqa: ANN401 - a part of a channel
        return SimpleNamespace(schema=schema, type="A")

    counters = []

    def counter() -> Iterator[int]:
        counters.append(count())
        return counters[-1]

    monkeypatch.setattr(schemas, "count", counter)
    assert protobuf_leaves(channel(_wide(3000))) == []
    # Each open message sees the limit once more.
    assert max(map(next, counters)) <= 20_000 + 2000
    with pytest.raises(
        DefinitionError, match=r"its protobuf schema has 1048577 bytes; expected at most 1048576"
    ):
        protobuf_leaves(channel(bytes((1 << 20) + 1)))
