"""Which fields of a message are an IMU's: by their names, at any depth, several in one message."""

from itertools import pairwise

import pytest
from imucal.readers.messages.message_types import ImuFields, Stamp, find_imus, is_command, sensor_of_topic

from imucal.readers.messages.definitions import DefinitionError, defined
from imucal.recording import Sensor

GYRO, ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER
V3 = "===\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
IMU = "===\nMSG: pkg/Imu\nbuiltin_interfaces/Time stamp\nfloat64 temp\nfloat64[3] gyro\nfloat64[3] accel\n"
HEADER = "===\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"


def found(
    text: str, *, name: str = "pkg/M", topic: str = "/t", sensor: Sensor | None = None
) -> dict[str, ImuFields]:
    """Return what a message can give."""
    return find_imus(name, defined(name, text, ros1=False).fields(), topic, sensor)


def paths(imu: ImuFields) -> dict[Sensor, tuple[str, ...]]:
    """Return the paths of its vectors."""
    return {vector.sensor: vector.paths for vector in imu.vectors}


@pytest.mark.parametrize(
    ("text", "gyro"),
    [
        ("float64[3] gyro", ("gyro",)),
        ("float32[3] gyro", ("gyro",)),
        ("float64 gyro_x\nfloat64 gyro_y\nfloat64 gyro_z", ("gyro_x", "gyro_y", "gyro_z")),
        ("geometry_msgs/Vector3 gyro\n" + V3, ("gyro.x", "gyro.y", "gyro.z")),
        ("float64[3] gyro\nfloat64[3] angular_velocity", ("angular_velocity",)),
        ("float64[4] gyro", None),
        ("float64[] gyro", None),
        ("int32[3] gyro", None),
        ("float64 gyro_x\nfloat64 gyro_y", None),
        ("float64 gyro_x\nint32 gyro_y\nfloat64 gyro_z", None),
        ("float64[3] gyros", None),
    ],
)
def test_what_is_a_vector(text: str, gyro: tuple[str, ...] | None) -> None:
    """Three floating numbers, as an array, a structure, or one by one; the best name first."""
    imus = found(text)
    assert {key: paths(imu)[GYRO] for key, imu in imus.items()} == ({} if gyro is None else {"": gyro})


def test_units_are_certain_in_the_standard_fields_alone() -> None:
    """Both vectors must be; elsewhere SI is assumed, and said."""
    both = "geometry_msgs/Vector3 angular_velocity\ngeometry_msgs/Vector3 {}\n" + V3
    (standard,) = found(both.format("linear_acceleration")).values()
    (other,) = found(both.format("accel")).values()
    assert (standard.standard, other.standard) == (True, False)
    assert standard.sensors == (GYRO, ACCEL)
    assert [vector.field for vector in standard.vectors] == ["angular_velocity", "linear_acceleration"]
    (plain,) = found("float64[3] angular_velocity").values()
    assert not plain.standard


def test_vectors_that_are_not_read_are_named() -> None:
    """Another of the same sensor in the same place."""
    (imu,) = found("float64[3] gyro\nfloat64[3] gyroscope\nfloat64[3] accel").values()
    assert paths(imu) == {GYRO: ("gyro",), ACCEL: ("accel",)}
    assert imu.others == ("gyroscope",)


def test_several_imus_in_a_message_have_their_own_stamps() -> None:
    """Each its own where it has one, and none of another's; the message's own level is called top."""
    imus = found("pkg/Imu left\npkg/Imu right\n" + IMU)
    assert list(imus) == ["left", "right"]
    for side, imu in imus.items():
        assert paths(imu) == {GYRO: (f"{side}.gyro",), ACCEL: (f"{side}.accel",)}
        assert imu.stamp == Stamp(sec=f"{side}.stamp.sec", nanosec=f"{side}.stamp.nanosec")
        assert imu.temperature == f"{side}.temp"
    text = "std_msgs/Header header\nfloat64[3] gyro\nfloat64[3] accel\npkg/Imu left\n" + HEADER + IMU
    imus = found(text)
    assert list(imus) == ["top", "left"]
    assert imus["top"].stamp == Stamp(sec="header.stamp.sec", nanosec="header.stamp.nanosec")
    assert imus["top"].temperature == ""
    assert imus["left"].stamp == Stamp(sec="left.stamp.sec", nanosec="left.stamp.nanosec")


def test_sensors_that_no_field_holds_together() -> None:
    """One of each is one IMU; two gyroscopes are two."""
    one = "===\nMSG: pkg/G\nfloat64[3] gyro\n===\nMSG: pkg/A\nfloat64[3] accel\n"
    (imu,) = found("pkg/G first\npkg/A second\n" + one).values()
    assert paths(imu) == {GYRO: ("first.gyro",), ACCEL: ("second.accel",)}
    imus = found("pkg/G first\npkg/G second\npkg/A third\n" + one)
    assert {key: list(paths(imu)) for key, imu in imus.items()} == {
        "first": [GYRO],
        "second": [GYRO],
        "third": [ACCEL],
    }


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
def test_what_the_name_of_a_topic_says(topic: str, sensor: Sensor | None) -> None:
    """One sensor, or nothing."""
    assert sensor_of_topic(topic) is sensor
    imus = found("float64 x\nfloat64 y\nfloat64 z", name="geometry_msgs/msg/Vector3", topic=topic)
    assert {kind for imu in imus.values() for kind in paths(imu)} == ({sensor} if sensor else set())
    assert all(imu.plain for imu in imus.values())


def test_a_vector_is_what_the_caller_says() -> None:
    """Whatever its topic is called; a twist is a gyroscope in any case."""
    text = "float64 x\nfloat64 y\nfloat64 z"
    imus = found(text, name="geometry_msgs/msg/Vector3", topic="/accel", sensor=GYRO)
    assert paths(imus[""]) == {GYRO: ("x", "y", "z")}
    twist = "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n" + V3
    imus = found(twist, name="geometry_msgs/Twist", sensor=ACCEL)
    assert paths(imus[""]) == {GYRO: ("angular.x", "angular.y", "angular.z")}


def test_messages_of_px4() -> None:
    """Increments over their durations, one sensor a message, or both; only under that package's name."""
    text = "uint64 timestamp\nuint64 timestamp_sample\nfloat32[3] delta_angle\nfloat32[3] delta_velocity\n"
    imu = found(text + "uint32 delta_angle_dt\nuint32 delta_velocity_dt", name="px4_msgs/msg/VehicleImu")[""]
    assert imu.stamp == Stamp(sec="timestamp_sample", scale=1000)
    assert [(vector.paths, vector.divisor) for vector in imu.vectors] == [
        (("delta_angle",), "delta_angle_dt"),
        (("delta_velocity",), "delta_velocity_dt"),
    ]
    assert imu.wanted == (
        "delta_angle",
        "delta_angle_dt",
        "delta_velocity",
        "delta_velocity_dt",
        "timestamp_sample",
    )
    imu = found(text + "uint32 delta_angle_dt\nuint32 dt", name="px4_msgs/msg/VehicleImu")[""]
    assert imu.vectors[1].divisor == "dt"
    assert found(text + "uint32 dt", name="px4_msgs/msg/VehicleImu") == {}
    text = "uint64 timestamp\nfloat32 x\nfloat32 y\nfloat32 z\nfloat32 temperature"
    for name, sensor in (("SensorGyro", GYRO), ("SensorAccel", ACCEL)):
        imu = found(text, name=f"px4_msgs/msg/{name}")[""]
        assert (paths(imu), imu.temperature) == ({sensor: ("x", "y", "z")}, "temperature")
        assert imu.wanted == ("x", "y", "z", "timestamp", "temperature")
        assert found(text, name=f"other_msgs/msg/{name}") == {}
    assert found(text, name="px4_msgs/msg/SensorMag") == {}
    imu = found("uint64 timestamp\nfloat32[3] gyro_rad\nfloat32[3] accelerometer_m_s2", name="px4_msgs/X")[""]
    assert (imu.stamp, list(paths(imu))) == (Stamp(sec="timestamp"), [GYRO, ACCEL])


@pytest.mark.parametrize(
    ("text", "stamp"),
    [
        ("builtin_interfaces/Time stamp", "stamp"),
        ("builtin_interfaces/Time timestamp", "timestamp"),
        ("builtin_interfaces/Time time", "time"),
        ("builtin_interfaces/Time since", None),
        ("builtin_interfaces/Time since\nbuiltin_interfaces/Time time", "time"),
    ],
)
def test_what_is_a_stamp(text: str, stamp: str | None) -> None:
    """A time by one of three names."""
    (imu,) = found(text + "\nfloat64[3] gyro").values()
    assert imu.stamp == (Stamp(sec=f"{stamp}.sec", nanosec=f"{stamp}.nanosec") if stamp else None)


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
def test_what_is_a_temperature(name: str, known: bool) -> None:  # noqa: FBT001
    """A floating number by one of a few names."""
    (imu,) = found(f"float32 {name}\nfloat64[3] gyro").values()
    assert imu.temperature == (name if known else "")
    (imu,) = found(f"int32 {name}\nfloat64[3] gyro").values()
    assert imu.temperature == ""


def test_definitions_end_where_the_layout_is_not_known() -> None:
    """Nests of sixteen are read, deeper ones refused; so are more elements than twenty thousand."""

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


def test_a_definition_that_holds_itself_is_refused() -> None:
    """As a field or as a sequence: it would never end."""
    for text in ("pkg/M m", "pkg/M[] m", "pkg/M[2] m", "pkg/A[] a\n===\nMSG: pkg/A\npkg/A[] a"):
        with pytest.raises(DefinitionError, match="nests too deeply"):
            defined("pkg/M", text, ros1=True).fields()


@pytest.mark.parametrize(("ros1", "code"), [(True, "i1"), (False, "u1")])
def test_a_byte_is_signed_in_ros_1_alone(ros1: bool, code: str) -> None:  # noqa: FBT001
    assert [field.code for field in defined("pkg/M", "byte b", ros1=ros1).fields()] == [code]


@pytest.mark.parametrize(
    ("topic", "command"),
    [("/turtle1/cmd_vel", True), ("/arm/command", True), ("/setpoint", True), ("/commander/imu", False),
     ("/twist", False), ("/targets/rate", True), ("/retarget", False)],
)  # fmt: skip
def test_a_command_is_known_by_the_name_of_its_topic(topic: str, *, command: bool) -> None:
    """Only whole words of the name count."""
    assert is_command(topic) is command
