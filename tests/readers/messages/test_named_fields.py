"""Fields of any message that the user names: ROS, JSON and protobuf, in any unit, at any place."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.testing as npt
import pytest

from imucal.errors import ChoiceError, ImucalError
from imucal.readers import describe, read
from imucal.readers.containers import Channel
from imucal.readers.messages import schemas
from imucal.readers.messages.leaves import Leaf, Leaves
from imucal.readers.messages.message_types import parse_fields_text
from imucal.recording import Recording
from imucal.units import G0
from tests.readers.logs import TOPIC, Message, header, samples, store, write_bag, write_db3, write_mcap
from tests.readers.messages.test_messages import axes, messages_of

TRUTH = samples(120)
KIND = "acme/msg/Raw"
DEG = np.degrees(TRUTH.gyro)
#: Counts of a converter: 131 a deg/s, 16384 a g.
COUNTS = np.hstack([np.round(DEG * 131), np.round(TRUTH.accel / G0 * 16384)]).astype(np.int16)


def is_near(recording: Recording, tolerance: float = 1e-12, *, stamped: bool = True) -> None:
    """Check samples, units and start."""
    npt.assert_allclose(axes(recording), TRUTH.all, rtol=tolerance, atol=tolerance)
    start = recording.series[0].clock.start_ns
    assert start == (TRUTH.stamps if stamped else TRUTH.log)[0]


def ros(folder: Path, text: str, build: Callable[[Any, int], dict[str, Any]], **more: Any) -> Path:  # noqa: ANN401 - texts of other types
    """Write messages of a type of ones own; `build` gets the types and the row and returns the fields."""
    types = store(acme__msg__Raw=text, **more)

    def message(row: int) -> Any:  # noqa: ANN401 - rosbags makes the types
        return types.types[KIND](**build(types, row))

    return write_mcap(folder / "log.mcap", messages_of(KIND, types, message), types=types)


def stamp(types: Any, row: int) -> Any:  # noqa: ANN401 - rosbags makes the types
    return header(types, int(TRUTH.stamps[row]))


def single(folder: Path) -> Path:
    """Write gx ... az of one number each, in SI, with a header."""
    names = ("gx", "gy", "gz", "ax", "ay", "az")
    text = "std_msgs/Header header\n" + "\n".join(f"float64 {name}" for name in names)
    return ros(
        folder, text, lambda t, i: {"header": stamp(t, i), **dict(zip(names, TRUTH.all[i], strict=True))}
    )


def with_units(folder: Path) -> Path:
    """Write units in the names, and a time in us."""
    names = [f"gyro_{axis}_dps" for axis in "xyz"] + [f"accel_{axis}_mg" for axis in "xyz"]
    text = "uint64 stamp_us\nstring note\n" + "\n".join(f"float64 {name}" for name in names)
    values = np.hstack([DEG, TRUTH.accel / G0 * 1000])
    return ros(
        folder,
        text,
        lambda _, i: {
            "stamp_us": int(TRUTH.stamps[i]) // 1000,
            "note": "n" * (i % 5),
            **dict(zip(names, values[i], strict=True)),
        },
    )


def counts(folder: Path, kind: str = "int16[3]") -> Path:
    """Write arrays of raw counts, of a fixed or of any length."""
    text = f"std_msgs/Header header\n{kind} g\n{kind} a"
    return ros(folder, text, lambda t, i: {"header": stamp(t, i), "g": COUNTS[i, :3], "a": COUNTS[i, 3:]})


def several(folder: Path) -> Path:
    """Write a list of IMUs, each with a header: their places differ from message to message."""
    text = "std_msgs/Header header\nOne[] imus\n"
    one = "std_msgs/Header header\nfloat64[3] rate\ngeometry_msgs/Vector3 force"

    def build(types: Any, row: int) -> dict[str, Any]:  # noqa: ANN401 - rosbags makes the types
        vector = types.types["geometry_msgs/msg/Vector3"]
        imus = [
            types.types["acme/msg/One"](
                header=header(types, int(TRUTH.stamps[row]), "f" * (row % 3 + which)),
                rate=TRUTH.gyro[row] * (1 if which else 5),
                force=vector(*(TRUTH.accel[row] * (1 if which else 5)).tolist()),
            )
            for which in range(2)
        ]
        return {"header": stamp(types, row), "imus": imus}

    return ros(folder, text, build, acme__msg__One=one)


SCALES: dict[str, Any] = {"gyro_scale": float(np.radians(1 / 131)), "accel_scale": G0 / 16384}


DPS = "gyro=gyro_x_dps,gyro_y_dps,gyro_z_dps"
MG = "accel=accel_x_mg,accel_y_mg,accel_z_mg"


@pytest.mark.parametrize(
    ("write", "fields", "options", "tolerance"),
    [
        (single, "gyro=gx,gy,gz accel=ax,ay,az", {"gyro_unit": "rad/s"}, 0),
        (single, ("gyro=gx,gy,gz", "accel=ax,ay,az", "time=header.stamp"), {"gyro_unit": "rad/s"}, 0),
        (with_units, f"{DPS} {MG} time=stamp_us", {}, 1e-12),
        (counts, "gyro=g accel=a", SCALES, 6e-4),
        (counts, "g=g[0],g[1],g[2] a=a[0],a[1],a[2]", SCALES, 6e-4),
        (lambda folder: counts(folder, "int16[]"), "gyro=g accel=a", SCALES, 6e-4),
        (several, "gyro=imus[1].rate accel=imus[1].force time=imus[1].header.stamp",
         {"gyro_unit": "rad/s"}, 0),
    ],
)  # fmt: skip
def test_ros_messages(
    write: Callable[[Path], Path], fields: str, options: dict[str, Any], tolerance: float, tmp_path: Path
) -> None:
    """Numbers, arrays, sequences, lists of structures; the unit from the name, the caller or the data."""
    is_near(read(write(tmp_path), fields=fields, **options), tolerance)


def test_the_axes_may_be_in_any_order(tmp_path: Path) -> None:
    """A sensor that is built in turned."""
    recording = read(single(tmp_path), fields="gyro=gz,gx,gy", gyro_unit="rad/s")
    assert [series.name for series in recording.series] == ["gyro_x", "gyro_y", "gyro_z"]
    npt.assert_array_equal(axes(recording), TRUTH.gyro[:, [2, 0, 1]])


def test_units_that_nothing_says_are_asked_for(tmp_path: Path) -> None:
    """Counts of a gyroscope say nothing of it; beside an SI accelerometer it is assumed, and said."""
    with pytest.raises(
        ChoiceError, match=r"topic /imu/data: the unit of the gyroscope is unknown: .* integer"
    ):
        read(counts(tmp_path), fields="gyro=g accel=a")
    recording = read(single(tmp_path), fields="gyro=gx,gy,gz accel=ax,ay,az")
    is_near(recording, 0)
    assert "unit-assumed" in [finding.code for finding in recording.findings]


def said(path: Path, **options: Any) -> str:  # noqa: ANN401 - options of any kind
    with pytest.raises(ImucalError) as caught:
        read(path, **options)
    return str(caught.value)


@pytest.mark.parametrize("write", [single, with_units, counts, several])
def test_what_the_error_proposes_works(write: Callable[[Path], Path], tmp_path: Path) -> None:
    """The text names this log's own fields."""
    path = write(tmp_path)
    match = re.search(r"fields text such as '([^']+)'", said(path))
    assert match is not None
    # Counts have no unit, and the first IMU of the list is written five times too large.
    recording = read(path, fields=match[1], **(SCALES if write in {counts, several} else {}))
    assert len(recording.series) == 6


def test_fields_that_are_not_there(tmp_path: Path) -> None:
    """The error lists those that are."""
    message = said(single(tmp_path), fields="gyro=wx,wy,wz")
    assert message == (
        f"{tmp_path / 'log.mcap'}: no topic has the fields in the fields text; found these topics\n"
        "  /imu/data (acme/msg/Raw): it has no wx,wy,wz; found header.stamp.sec int32, header.stamp.nanosec "
        "uint32, gx float64, gy float64, gz float64, ax float64, ay float64, az float64"
    )


def test_a_temperature_that_is_named(tmp_path: Path) -> None:
    """It is read, or asked for: one that is no number of the messages is not passed over."""
    names = ("gx", "gy", "gz", "ax", "ay", "az")
    text = "std_msgs/Header header\nstring note\n" + "".join(f"float64 {name}\n" for name in names)

    def build(types: Any, row: int) -> dict[str, Any]:  # noqa: ANN401 - rosbags makes the types
        values = dict(zip(names, TRUTH.all[row], strict=True))
        return {"header": stamp(types, row), "note": "", **values, "warmth": 20.0 + row / 4}

    path = ros(tmp_path, text + "float32 warmth", build)
    sensors = "gyro=gx,gy,gz accel=ax,ay,az"
    found = read(path, fields=f"{sensors} temp=warmth").temperature
    assert found is not None
    npt.assert_array_equal(found.samples, 20.0 + np.arange(120) / 4)
    assert read(path, fields=sensors).temperature is None
    for wrong in ("note", "coldness"):
        problem = said(path, fields=f"{sensors} temp={wrong}")
        assert f"there is no temperature {wrong} in the messages with the samples; found " in problem
        assert "warmth float32" in problem


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("gyro", "'gyro' can't be read"),
        ("gyro=a,b", "'gyro=a,b' can't be read"),
        ("speed=a,b,c", "'speed=a,b,c' can't be read"),
        ("gyro=a g=b", "'g=b' can't be read"),
        ("time=a", "names no sensor"),
    ],
)
def test_texts_that_are_wrong(text: str, problem: str) -> None:
    """What was wrong, and the form."""
    with pytest.raises(ChoiceError, match=re.escape(problem)):
        parse_fields_text([text])


def test_a_time_without_unit_is_asked_for(tmp_path: Path) -> None:
    """The name, or the option, says it; a float of seconds keeps its digits."""
    text = "float64 clock\nfloat64[3] w"
    first = int(TRUTH.stamps[0]) // 10**9 * 10**9
    path = ros(
        tmp_path, text, lambda _, i: {"clock": (int(TRUTH.stamps[i]) - first) * 1e-9, "w": TRUTH.gyro[i]}
    )
    fields = "gyro=w time=clock"
    assert "the time clock has no unit in its name; give the time unit" in said(
        path, fields=fields, gyro_unit="rad/s"
    )
    recording = read(path, fields=fields, gyro_unit="rad/s", time_unit="s")
    assert recording.series[0].rate_hz == pytest.approx(100)
    npt.assert_array_equal(axes(recording), TRUTH.gyro)
    assert "omit it, or name a time of one number in a fields text" in said(
        path, fields="gyro=w", gyro_unit="rad/s", time_unit="s"
    )


def json_log(folder: Path, build: Callable[[int], object]) -> Path:
    messages = [
        Message(topic=TOPIC, type="any", log=log, data=json.dumps(build(row)).encode(), encoding="json")
        for row, log in enumerate(TRUTH.log.tolist())
    ]
    return write_mcap(folder / "log.mcap", messages, definitions={"any": ("jsonschema", "{}")})


@pytest.mark.parametrize(
    ("build", "fields"),
    [
        (
            lambda i: {"t": {"sec": int(TRUTH.stamps[i]) // 10**9, "nsec": int(TRUTH.stamps[i]) % 10**9},
                       "data": {"g": DEG[i].tolist(), "a": (TRUTH.accel[i] / G0).tolist()}},
            "gyro=data.g accel=data.a time=t",
        ),
        (
            lambda i: {"ns": int(TRUTH.stamps[i]),
                       "imus": [{}, {"v": [*DEG[i].tolist(), *(TRUTH.accel[i] / G0).tolist()]}]},
            None,
        ),
        (
            lambda i: {"stamp_ns": int(TRUTH.stamps[i]), "gyro_dps": dict(zip("xyz", DEG[i], strict=True)),
                       "accel": dict(zip("xyz", TRUTH.accel[i] / G0, strict=True))},
            "gyro=gyro_dps accel=accel time=stamp_ns",
        ),
    ],
)  # fmt: skip
def test_json_of_any_layout(build: Callable[[int], object], fields: str | None, tmp_path: Path) -> None:
    """Lists, mappings, lists of mappings; the fields are those of the first message."""
    path = json_log(tmp_path, build)
    (topic,) = describe(path).topics
    assert topic.fields
    if fields is None:
        # A list of which the first element is empty shows nothing.
        assert topic.fields == ("ns number",)
        return
    is_near(read(path, fields=fields, gyro_unit="deg/s", accel_unit="g"))


def protobuf_log(folder: Path, *, standard: bool = False) -> Path:
    """Write messages as Foxglove's users do: a schema of their own, zeros left out."""
    pytest.importorskip("google.protobuf")
    from google.protobuf import descriptor_pb2 as pb
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass
    from google.protobuf.timestamp_pb2 import DESCRIPTOR
    from mcap.writer import Writer

    kinds = pb.FieldDescriptorProto
    file = pb.FileDescriptorProto(name="acme.proto", package="acme", syntax="proto3")
    file.dependency.append(DESCRIPTOR.name)
    vector = file.message_type.add(name="Vector")
    for number, axis in enumerate("xyz", 1):
        vector.field.add(name=axis, number=number, type=kinds.TYPE_DOUBLE, label=kinds.LABEL_OPTIONAL)
    imu = file.message_type.add(name="Imu")
    own = ("angular_velocity", "linear_acceleration") if standard else ("turning_dps", "push_g")
    for number, (name, type_name) in enumerate(
        [("timestamp", ".google.protobuf.Timestamp"), *((name, ".acme.Vector") for name in own)], 1
    ):
        imu.field.add(
            name=name,
            number=number,
            type=kinds.TYPE_MESSAGE,
            type_name=type_name,
            label=kinds.LABEL_OPTIONAL,
        )
    imu.field.add(name="note", number=4, type=kinds.TYPE_STRING, label=kinds.LABEL_OPTIONAL)
    imu.field.add(name="raw", number=5, type=kinds.TYPE_INT32, label=kinds.LABEL_REPEATED)
    timestamp = pb.FileDescriptorProto()
    DESCRIPTOR.CopyToProto(timestamp)
    files = pb.FileDescriptorSet(file=[timestamp, file])
    pool = DescriptorPool()
    for part in files.file:
        pool.Add(part)
    message = GetMessageClass(pool.FindMessageTypeByName("acme.Imu"))
    values = (TRUTH.gyro, TRUTH.accel) if standard else (DEG, TRUTH.accel / G0)
    path = folder / "log.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("", "test")
        schema = writer.register_schema("acme.Imu", "protobuf", files.SerializeToString())
        channel = writer.register_channel(TOPIC, "protobuf", schema)
        for row, log in enumerate(TRUTH.log.tolist()):
            one = message(note="n" * (row % 4), raw=COUNTS[row].tolist())
            one.timestamp.FromNanoseconds(int(TRUTH.stamps[row]))
            for name, vectors in zip(own, values, strict=True):
                for axis, value in zip("xyz", vectors[row].tolist(), strict=True):
                    setattr(getattr(one, name), axis, value)
            writer.add_message(channel, log, one.SerializeToString(), log)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def test_protobuf_by_its_own_names(tmp_path: Path) -> None:
    """Known names are found as in any message, with the stamp in it."""
    is_near(read(protobuf_log(tmp_path, standard=True)), 0)


def test_protobuf_by_named_fields(tmp_path: Path) -> None:
    """The error lists the fields; lists of numbers by their places."""
    path = protobuf_log(tmp_path)
    message = said(path, topic=TOPIC)
    assert "turning_dps.x double" in message
    assert "raw int32[]" in message
    is_near(read(path, fields="gyro=turning_dps accel=push_g", gyro_unit="deg/s", accel_unit="g"))
    fields = "gyro=raw[0],raw[1],raw[2] accel=raw[3],raw[4],raw[5] time=timestamp"
    is_near(read(path, fields=fields, **SCALES), 6e-4)


@pytest.mark.parametrize(
    ("write", "fields"),
    [
        (lambda folder: protobuf_log(folder, standard=True), "gyro=raw"),
        (several, "gyro=imus[1].rate accel=imus[1].force"),
        (lambda folder: counts(folder, "int16[]"), "gyro=g accel=a"),
        (lambda folder: json_log(folder, lambda i: {"g": DEG[i].tolist()}), "gyro=g"),
    ],
    ids=["protobuf", "list of structures", "sequence", "JSON"],
)
def test_damaged_logs(write: Callable[[Path], Path], fields: str, tmp_path: Path) -> None:
    """Schemas, definitions and messages of any damage: samples, or a message that names the log."""
    path = write(tmp_path)
    whole = path.read_bytes()
    for seed in range(30):
        rng = np.random.default_rng(seed)
        data = bytearray(whole)
        for place in rng.integers(0, len(data), 1 + int(rng.integers(20))):
            data[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
        for action in (lambda path: read(path, fields=fields, **SCALES), describe):
            try:
                action(path)
            except ImucalError as error:
                assert str(error).startswith(str(path))  # noqa: PT017 - the message is the point


def test_a_schema_that_holds_itself() -> None:
    """Many fields of its own type: not all are looked into."""
    pb = pytest.importorskip("google.protobuf.descriptor_pb2")
    kinds = pb.FieldDescriptorProto
    file = pb.FileDescriptorProto(name="a.proto", package="a")
    one = file.message_type.add(name="A")
    for number in range(1, 60):
        one.field.add(
            name=f"f{number}",
            number=number,
            type=kinds.TYPE_MESSAGE,
            type_name=".a.A",
            label=kinds.LABEL_OPTIONAL,
        )
    schema = pb.FileDescriptorSet(file=[file]).SerializeToString()
    channel = Channel(key=1, topic="/a", type="a.A", encoding="protobuf", schema=schema)
    assert schemas.protobuf_leaves(channel) == []


def test_info_lists_the_fields(tmp_path: Path) -> None:
    """With their types; those in lists by the first element."""
    (topic,) = describe(several(tmp_path)).topics
    assert topic.fields == (
        "header.stamp.sec int32",
        "header.stamp.nanosec uint32",
        "imus[0].header.stamp.sec int32",
        "imus[0].header.stamp.nanosec uint32",
        "imus[0].rate float64[3]",
        "imus[0].force.x float64",
        "imus[0].force.y float64",
        "imus[0].force.z float64",
    )


@pytest.mark.parametrize(
    ("path", "there"),
    [
        ("a", True),
        ("b[2]", True),
        ("b[3]", False),
        ("b", False),
        ("c[99]", True),
        ("d[7].x", True),
        ("e", False),
    ],
)
def test_paths(path: str, there: bool) -> None:  # noqa: FBT001 - a parameter of the case
    """An index is checked where the length is known."""
    leaves = Leaves([Leaf("a", "f8"), Leaf("b", "int16[3]"), Leaf("c", "int16[]"), Leaf("d[0].x", "f8")])
    assert leaves.is_number(path) is there


@pytest.mark.parametrize("fields", ["gyro=w accel=imus[0].f", "gyro=w accel=f"])
def test_other_containers(fields: str, tmp_path: Path) -> None:
    """A ROS 1 bag and a ROS 2 bag: by the walk, and by the tree of a list of structures."""
    text = "std_msgs/Header header\nfloat64[3] w\nfloat64[3] f\nOne[] imus"
    one = "std_msgs/Header header\nfloat64[3] f"
    for ros1 in (True, False):
        types = store(ros1=ros1, acme__msg__Raw=text, acme__msg__One=one)
        messages = []
        for row, log in enumerate(TRUTH.log.tolist()):
            top = header(types, int(TRUTH.stamps[row]))
            inner = types.types["acme/msg/One"](top, TRUTH.accel[row])
            message = types.types[KIND](top, TRUTH.gyro[row], TRUTH.accel[row], [inner])
            data = types.serialize_ros1(message, KIND) if ros1 else types.serialize_cdr(message, KIND)
            messages.append(Message(topic=TOPIC, type=KIND, log=log, data=bytes(data)))
        path = tmp_path / ("log.bag" if ros1 else "bag")
        path = (write_bag if ros1 else write_db3)(path, messages, types=types)
        is_near(read(path, fields=fields, gyro_unit="rad/s"), 0)
