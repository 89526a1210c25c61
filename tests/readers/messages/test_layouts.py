"""Fields of message definitions, and vectors with numbers that are not adjacent."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from imucal.readers import read
from imucal.readers.messages.definitions import DefinitionError, Field, built_in, defined
from tests.readers.logs import TOPIC, Message, samples, store, write_mcap

_POINTS = "P[] points\nfloat64 x\n===\nMSG: pkg/P\n"


def fields_of(text: str, *, ros1: bool = False) -> list[Field]:
    """Return the fields of a message of the type pkg/M."""
    return list(defined("pkg/M", text, ros1=ros1).fields())


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("float64 a", Field("a", "number", "f8")),
        ("float64[3] a", Field("a", "array", "f8", 3)),
        ("float64[] a", Field("a", "sequence", "f8")),
        ("float64[<=3] a", Field("a", "sequence", "f8")),
        ("string a", Field("a", "string")),
        ("string<=9 a", Field("a", "string")),
        ("string[] a", Field("a", "other")),
        ("wstring a", Field("a", "other")),
        ("wstring[] a", Field("a", "other")),
        ("time[2] a", Field("a", "other")),
        ("time[] a", Field("a", "other")),
    ],
)
def test_a_field_has_a_kind_and_a_code(text: str, expected: Field) -> None:
    """Kinds: number, fixed array, string, sequence, and fields of unknown size."""
    assert fields_of(text + "\n") == [expected]


@pytest.mark.parametrize(
    ("members", "expected"),
    [
        ("float64 x\nfloat64[2] y", Field("points", "sequence", "f8", 3)),
        ("float64 x\nfloat32 y", Field("points", "other")),
        ("string a\nstring b", Field("points", "other")),
        ("float64[] x", Field("points", "other")),
        ("float64 x\nstring[] y", Field("points", "other")),
    ],
)
def test_a_sequence_of_structures_needs_numbers_of_equal_size(members: str, expected: Field) -> None:
    """After other sequences the offsets are unknown, so later fields are omitted."""
    follows = [Field("x", "number", "f8")] if expected.kind == "sequence" else []
    assert fields_of(_POINTS + members) == [expected, *follows]


@pytest.mark.parametrize(
    ("ros1", "members", "paths"),
    [
        (False, "", ["e.structure_needs_at_least_one_member", "x"]),
        (False, "uint8 a", ["e.a", "x"]),
        (True, "", ["x"]),
        (True, "uint8 a", ["e.a", "x"]),
    ],
)
def test_an_empty_structure_takes_a_byte_in_ros2(ros1: bool, members: str, paths: list[str]) -> None:  # noqa: FBT001
    """In ROS 1 it takes no byte."""
    found = fields_of(f"E e\nfloat64 x\n===\nMSG: pkg/E\n{members}\n", ros1=ros1)
    assert [field.path for field in found] == paths


def test_a_type_is_searched_in_its_own_package_first() -> None:
    """A name with a package is searched only in that package."""
    text = "E e\n===\nMSG: std_msgs/E\nfloat32 s\n===\nMSG: pkg/E\nfloat64 p\n"
    assert fields_of(text) == [Field("e.p", "number", "f8")]
    with pytest.raises(DefinitionError, match="type pkg/E is not defined"):
        fields_of("E e\n===\nMSG: any/E\nfloat32 s\n")
    with pytest.raises(DefinitionError, match="type other/F is not defined"):
        fields_of("other/F e\n===\nMSG: pkg/E\nfloat32 s\n")


@pytest.mark.parametrize("frames", [("imu",), ("a", "longer")])
@pytest.mark.parametrize("code", ["float64", "float32"])
def test_vectors_with_interleaved_numbers_are_read(
    code: str, frames: tuple[str, ...], tmp_path: Path
) -> None:
    """The axes of both sensors alternate, and z of the gyroscope has another type."""
    names = [f"{kind}_{axis}" for axis in "xyz" for kind in ("gyro", "accel")]
    codes = [code if name != "gyro_z" else "float64" for name in names]
    text = "std_msgs/Header header\n" + "\n".join(map(" ".join, zip(codes, names, strict=True)))
    types, truth = store(pkg__msg__Apart=text), samples(120)
    known = types.types
    messages = []
    for row, stamp in enumerate(truth.stamps.tolist()):
        time = known["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
        head = known["std_msgs/msg/Header"](stamp=time, frame_id=frames[row % len(frames)])
        values = np.stack([truth.gyro[row], truth.accel[row]], axis=1).reshape(-1)
        message = known["pkg/msg/Apart"](header=head, **dict(zip(names, values.tolist(), strict=True)))
        data = bytes(types.serialize_cdr(message, "pkg/msg/Apart"))
        messages.append(Message(topic=TOPIC, type="pkg/msg/Apart", log=stamp, data=data))
    recording = read(write_mcap(tmp_path / "log.mcap", messages, types=types))
    for series, expected in zip(recording.series, truth.all.T, strict=True):
        exact = code == "float64" or series.name == "gyro_z"
        assert np.array_equal(series.samples, expected if exact else expected.astype(np.float32))


@pytest.mark.parametrize("ros1", [False, True])
def test_every_number_type_has_a_code(ros1: bool) -> None:  # noqa: FBT001
    """A byte is signed in ROS 1, and seconds of a time are unsigned."""
    codes = {f"{s}int{8 * n}": f"{s or 'i'}{n}" for s in ("", "u") for n in (1, 2, 4, 8)}
    codes |= {"bool": "u1", "char": "u1", "byte": "i1" if ros1 else "u1"}
    codes |= {"float32": "f4", "float64": "f8"}
    fields = fields_of("\n".join(f"{kind} a_{kind}" for kind in codes), ros1=ros1)
    assert {field.path: field.code for field in fields} == {f"a_{kind}": code for kind, code in codes.items()}
    times = [Field("t.sec", "number", "u4" if ros1 else "i4"), Field("t.nanosec", "number", "u4")]
    for kind in ("time", "duration", "builtin_interfaces/Time", "builtin_interfaces/msg/Duration"):
        assert fields_of(f"{kind} t", ros1=ros1) == times


@pytest.mark.parametrize(
    "text",
    ["uint8 kSmall=3\nint8 x\n", "string S=a=b # c\nint8 x", "int8 x\n\n=====\n", "int8 x\r\n# y=1\r\n",
     "int8 x 5\nstring<=3 T='x'\n"],
)  # fmt: skip
def test_definitions_that_rosbags_refuses_are_read(text: str) -> None:
    """Cases: lower-case constants, a separator at the end, and Windows line ends."""
    assert fields_of(text) == [Field("x", "number", "i1")]


def test_structures_are_adjacent() -> None:
    """An array has fields for each of its structures.

    A bounded or open sequence has one field that counts all numbers.
    """
    point = "\n===\nMSG: pkg/P\nfloat64 x\nfloat64[2] y"
    paths = [f"p[{i}].{name}" for i in range(2) for name in "xy"]
    assert [field.path for field in fields_of(f"P[2] p{point}")] == paths
    assert [field.path for field in fields_of(f"P p{point}")] == ["p.x", "p.y"]
    for size in ("", "<=2"):
        assert fields_of(f"P[{size}] p{point}") == [Field("p", "sequence", "f8", 3)]
    assert fields_of(f"P[0] p\nint8 z{point}") == [Field("z", "number", "i1")]


def test_comments_and_constants_are_not_fields() -> None:
    """An invalid line is an error that shows the line."""
    assert fields_of("# a\n\nint8 A=1\nint8 B = 2 # c\nint8 x # d\nint8 y 5\n") == [
        Field("x", "number", "i1"),
        Field("y", "number", "i1"),
    ]
    with pytest.raises(DefinitionError, match=r"^line 'int8' is not a field$"):
        fields_of("int8 x\nint8\n")


@pytest.mark.parametrize("ros1", [False, True])
def test_built_in_types_have_the_layout_of_rosbags(ros1: bool) -> None:  # noqa: FBT001
    """A definition by rosbags gives the same fields as the built-in type, also for nested types."""
    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.LATEST)
    for name in ("sensor_msgs/msg/Imu", "geometry_msgs/msg/TwistWithCovarianceStamped",
                 "geometry_msgs/msg/AccelStamped", "geometry_msgs/msg/Vector3", "geometry_msgs/msg/Twist",
                 "sensor_msgs/msg/Temperature"):  # fmt: skip
        theirs, _ = types.generate_msgdef(name, ros_version=1 if ros1 else 2)
        own = built_in(name, ros1=ros1)
        assert own is not None
        assert own.fields() == defined(name, theirs, ros1=ros1).fields()
    assert built_in("acme_msgs/msg/Imu", ros1=ros1) is None


def test_too_many_fields_are_refused() -> None:
    """The limit is 20 000 fields, including those of nested structures."""
    text = "P[{}] p\n===\nMSG: pkg/P\n" + "\n".join(f"int8 a{i}" for i in range(100))
    assert len(fields_of(text.format(200))) == 20_000
    with pytest.raises(DefinitionError, match=r"^pkg/M nests too deeply or has too many fields$"):
        fields_of(text.format(201))
