"""Named columns of messages of any type: ROS, JSON and protobuf, in any unit, at any path."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.testing as npt
import pytest

from imucal.errors import ChoiceError, ImucalError
from imucal.readers import describe, read
from imucal.readers.containers import Channel
from imucal.readers.messages import schemas
from imucal.readers.messages.topics import find_topics
from imucal.readers.read_options import ReadOptions
from imucal.recording import Recording
from imucal.units import G0
from tests.raising import raises
from tests.readers.logs import TOPIC, Message, header, samples, store, write_bag, write_db3, write_mcap
from tests.readers.messages.test_messages import axes, messages_of
from tests.slow_cases import first_by_default

TRUTH = samples(120)
KIND = "acme/msg/Raw"
DEG = np.degrees(TRUTH.gyro)
#: Counts of a converter: 131 per deg/s, 16384 per g.
COUNTS = np.hstack([np.round(DEG * 131), np.round(TRUTH.accel / G0 * 16384)]).astype(np.int16)


def is_near(recording: Recording, tolerance: float = 1e-12, *, stamped: bool = True) -> None:
    """Check samples, units and start."""
    npt.assert_allclose(axes(recording), TRUTH.all, rtol=tolerance, atol=tolerance)
    start = recording.series[0].clock.start_ns
    assert start == (TRUTH.stamps if stamped else TRUTH.log)[0]


def ros(folder: Path, text: str, build: Callable[[Any, int], dict[str, Any]], **more: Any) -> Path:  # noqa: ANN401 - texts of other types
    """Write messages of a custom type; `build` gets the types and the row and returns the fields."""
    types = store(acme__msg__Raw=text, **more)

    def message(row: int) -> Any:  # noqa: ANN401 - rosbags makes the types
        return types.types[KIND](**build(types, row))

    return write_mcap(folder / "log.mcap", messages_of(KIND, types, message), types=types)


def stamp(types: Any, row: int) -> Any:  # noqa: ANN401 - rosbags makes the types
    return header(types, int(TRUTH.stamps[row]))


def single(folder: Path) -> Path:
    """Write one number for each axis gx ... az, in SI units, with a header."""
    names = ("gx", "gy", "gz", "ax", "ay", "az")
    text = "std_msgs/Header header\n" + "\n".join(f"float64 {name}" for name in names)
    return ros(
        folder, text, lambda t, i: {"header": stamp(t, i), **dict(zip(names, TRUTH.all[i], strict=True))}
    )


def two_gyros(folder: Path) -> Path:
    text = "std_msgs/Header header\nfloat64[3] fast_gyro\nfloat64[3] slow_gyro\nfloat64[3] accel"

    def build(types: Any, row: int) -> dict[str, Any]:  # noqa: ANN401 - rosbags makes the types
        gyro, accel = TRUTH.gyro[row], TRUTH.accel[row]
        return {"header": stamp(types, row), "fast_gyro": gyro, "slow_gyro": gyro / 2, "accel": accel}

    return ros(folder, text, build)


def with_units(folder: Path) -> Path:
    """Write a time in us and axes with units in their names."""
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
    """Write arrays of raw counts, of fixed or variable length."""
    text = f"std_msgs/Header header\n{kind} g\n{kind} a"
    return ros(folder, text, lambda t, i: {"header": stamp(t, i), "g": COUNTS[i, :3], "a": COUNTS[i, 3:]})


def several(folder: Path) -> Path:
    """Write a list of IMUs with a header each; their positions differ between messages."""
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


DPS = "g=gyro_x_dps+gyro_y_dps+gyro_z_dps"
MG = "a=accel_x_mg+accel_y_mg+accel_z_mg"
#: Columns of `single`.
SINGLE = "g=gx+gy+gz,a=ax+ay+az"


@pytest.mark.parametrize(
    ("write", "columns", "options", "tolerance"),
    [
        (single, SINGLE, {"gyro_unit": "rad/s"}, 0),
        (single, "t=header.stamp,g=1:4,a=4:7", {"gyro_unit": "rad/s"}, 0),
        (with_units, f"{DPS},{MG},t=stamp_us", {}, 1e-12),
        (with_units, None, {}, 1e-12),
        (counts, "g=g,a=a", SCALES, 6e-4),
        (counts, "g=g[0]+g[1]+g[2],a=a[0]+a[1]+a[2]", SCALES, 6e-4),
        (counts, None, SCALES, 6e-4),
        (lambda folder: counts(folder, "int16[]"), "g=g,a=a", SCALES, 6e-4),
        (several, "g=imus[1].rate,a=imus[1].force,t=imus[1].header.stamp", {"gyro_unit": "rad/s"}, 0),
    ],
)  # fmt: skip
def test_named_columns_of_ros_messages_are_read(
    write: Callable[[Path], Path],
    columns: str | None,
    options: dict[str, Any],
    tolerance: float,
    tmp_path: Path,
) -> None:
    """Columns are numbers, arrays, sequences or lists of structures.

    The unit comes from the name, the options or the data.
    """
    is_near(read(write(tmp_path), columns=columns, **options), tolerance)


def test_the_axes_can_be_in_any_order(tmp_path: Path) -> None:
    """The sensor is mounted rotated."""
    recording = read(single(tmp_path), columns="g=gz+gx+gy", gyro_unit="rad/s")
    assert [series.name for series in recording.series] == ["gyro_x", "gyro_y", "gyro_z"]
    npt.assert_array_equal(axes(recording), TRUTH.gyro[:, [2, 0, 1]])


def test_the_unit_of_counts_must_be_given_and_that_of_decimals_is_assumed(tmp_path: Path) -> None:
    """The unit of decimals is an assumption, so a finding reports it."""
    with raises(ChoiceError, "topic /imu/data: the unit of the gyroscope .* integer", argument="gyro_unit"):
        read(counts(tmp_path), columns="g=g,a=a")
    recording = read(single(tmp_path), columns=SINGLE)
    is_near(recording, 0)
    assert "unit-assumed" in [finding.code for finding in recording.findings]


def refused(path: Path, **options: Any) -> str:  # noqa: ANN401 - options of any kind
    with pytest.raises(ImucalError) as caught:
        read(path, **options)
    return str(caught.value)


def vague(folder: Path) -> Path:
    """Write names of which only the accelerometer's are recognised."""
    names = ("turn_x", "turn_y", "turn_z", "ax", "ay", "az")
    text = "std_msgs/Header header\n" + "\n".join(f"float64 {name}" for name in names)
    return ros(
        folder, text, lambda t, i: {"header": stamp(t, i), **dict(zip(names, TRUTH.all[i], strict=True))}
    )


def test_a_columns_text_is_proposed_for_an_unrecognised_sensor(tmp_path: Path) -> None:
    """The columns text in the finding works."""
    path = vague(tmp_path)
    recording = read(path)
    assert [series.name for series in recording.series] == ["accel_x", "accel_y", "accel_z"]
    (finding,) = (finding for finding in recording.findings if finding.code == "sensor-missing")
    assert finding.level == "warning"
    match = re.search(r"such as (\S+)\.$", finding.advice)
    assert match is not None
    is_near(read(path, columns=match[1], gyro_unit="rad/s"), 0)


def test_a_list_of_structures_is_read_only_if_it_is_named(tmp_path: Path) -> None:
    """The IMU could be any element of the list; the error explains what to do."""
    path = several(tmp_path)
    message = refused(path)
    assert message == (
        f"{path}: topic /imu/data: no column has the name of a gyroscope or accelerometer axis; found "
        "columns: 0 header.stamp = 1.7e+18; name them in a columns text of the form t=TIME,g=X+Y+Z,a=X+Y+Z "
        "(names of columns, or their numbers from 0)"
    )
    units: dict[str, Any] = {"gyro_unit": "rad/s", "accel_unit": "m/s^2"}
    first = read(path, columns="g=imus[0].rate,a=imus[0].force", **units)
    npt.assert_array_equal(axes(first), 5 * TRUTH.all)
    assert "there is no column 'imus[0].rats'" in refused(path, columns="g=imus[0].rats")


def test_missing_columns_are_refused(tmp_path: Path) -> None:
    """The error lists the existing columns."""
    path = single(tmp_path)
    assert refused(path, columns="g=wx+wy+wz") == (
        f"{path}: no topic has the columns in the columns text; found these topics\n"
        "  /imu/data (acme/msg/Raw): columns text 'g=wx+wy+wz': there is no column 'wx'; found header.stamp, "
        "gx, gy, gz, ax, ay, az"
    )
    assert refused(path, columns="g=wx+wy+wz", topic=TOPIC) == (
        f"{path}: topic /imu/data of type acme/msg/Raw can't be read: columns text 'g=wx+wy+wz': there is no "
        "column 'wx'; found header.stamp, gx, gy, gz, ax, ay, az"
    )


def test_a_named_temperature_is_read_or_refused(tmp_path: Path) -> None:
    """A missing temperature column, or one without numbers, is an error."""
    names = ("gx", "gy", "gz", "ax", "ay", "az")
    text = "std_msgs/Header header\nstring note\n" + "".join(f"float64 {name}\n" for name in names)

    def build(types: Any, row: int) -> dict[str, Any]:  # noqa: ANN401 - rosbags makes the types
        values = dict(zip(names, TRUTH.all[row], strict=True))
        return {"header": stamp(types, row), "note": "", **values, "warmth": 20.0 + row / 4}

    path = ros(tmp_path, text + "float32 warmth", build)
    found = read(path, columns=f"{SINGLE},temp=warmth").temperature
    assert found is not None
    npt.assert_array_equal(found.samples, 20.0 + np.arange(120) / 4)
    assert read(path, columns=SINGLE).temperature is None
    for wrong in ("note", "coldness"):
        problem = refused(path, columns=f"{SINGLE},temp={wrong}")
        assert f"there is no column '{wrong}'; found header.stamp, " in problem
        assert "az, warmth" in problem


def test_an_impossible_temperature_is_ignored(tmp_path: Path) -> None:
    """The value is a raw count, as in tables; the decision contains the reason."""
    names = ("gx", "gy", "gz", "ax", "ay", "az")
    text = "std_msgs/Header header\nint16 temp\n" + "".join(f"float64 {name}\n" for name in names)

    def build(types: Any, row: int) -> dict[str, Any]:  # noqa: ANN401 - rosbags makes the types
        return {"header": stamp(types, row), "temp": 8000, **dict(zip(names, TRUTH.all[row], strict=True))}

    recording = read(ros(tmp_path, text, build))
    assert recording.temperature is None
    assert dict(recording.source.decisions)["temperature"].startswith("left out: a median of 8000 is not")


def test_messages_of_two_devices_on_one_topic_are_refused(tmp_path: Path) -> None:
    """The error proposes a columns text for each device, and both texts work."""
    names = ("gx", "gy", "gz", "ax", "ay", "az")
    text = "std_msgs/Header header\nuint8 device_id\n" + "".join(f"float64 {name}\n" for name in names)

    def build(types: Any, row: int) -> dict[str, Any]:  # noqa: ANN401 - rosbags makes the types
        values = dict(zip(names, TRUTH.all[row], strict=True))
        return {"header": stamp(types, row), "device_id": row % 2, **values}

    path = ros(tmp_path, text, build)
    texts = re.search(r"such as (\S+) or (\S+) ", refused(path))
    assert texts is not None
    for device, columns in enumerate(texts.groups()):
        recording = read(path, columns=columns, gyro_unit="rad/s")
        npt.assert_array_equal(axes(recording), TRUTH.all[device::2])
        assert recording.series[0].rate_hz == pytest.approx(50)
    for gyro, accel in (("@device_id:0", "@device_id:1"), ("@device_id:a", "@device_id:a"), ("", "@imu")):
        message = refused(path, columns=f"g=gx+gy+gz{gyro},a=ax+ay+az{accel}")
        assert "messages are selected by one number for both sensors, such as @id:1" in message


def test_messages_without_a_finite_time_are_dropped(tmp_path: Path) -> None:
    text = "float64 clock_s\nfloat64[3] gyro\nfloat64[3] accel"
    first = int(TRUTH.stamps[0]) // 10**9 * 10**9

    def build(_: Any, row: int) -> dict[str, Any]:  # noqa: ANN401 - rosbags makes the types
        time = np.nan if row in {3, 9} else (int(TRUTH.stamps[row]) - first) * 1e-9
        return {"clock_s": time, "gyro": TRUTH.gyro[row], "accel": TRUTH.accel[row]}

    recording = read(ros(tmp_path, text, build))
    npt.assert_array_equal(axes(recording), np.delete(TRUTH.all, [3, 9], axis=0))
    assert recording.series[0].clock.missing == 2
    text = "2 rows have no finite time; they were dropped."
    assert [finding.text for finding in recording.findings if finding.code == "bad-rows"] == [text]


def test_the_unit_of_a_time_is_inferred_or_given(tmp_path: Path) -> None:
    """The time's steps or the option determine the unit; seconds as floats keep their digits."""
    first = int(TRUTH.stamps[0]) // 10**9 * 10**9

    def build(_: Any, row: int) -> dict[str, Any]:  # noqa: ANN401 - rosbags makes the types
        return {"clock": (int(TRUTH.stamps[row]) - first) * 1e-9, "w": TRUTH.gyro[row]}

    path = ros(tmp_path, "float64 clock\nfloat64[3] w", build)
    for unit in ("s", None):
        recording = read(path, columns="g=w,t=clock", gyro_unit="rad/s", time_unit=unit)
        assert recording.series[0].rate_hz == pytest.approx(100)
        npt.assert_array_equal(axes(recording), TRUTH.gyro)
    stamped = single(tmp_path)
    assert "the time header.stamp, complete time stamps; omit it, or name another time column" in refused(
        stamped, columns=SINGLE, gyro_unit="rad/s", time_unit="s"
    )


def json_log(folder: Path, build: Callable[[int], object]) -> Path:
    messages = [
        Message(topic=TOPIC, type="any", log=log, data=json.dumps(build(row)).encode(), encoding="json")
        for row, log in enumerate(TRUTH.log.tolist())
    ]
    return write_mcap(folder / "log.mcap", messages, definitions={"any": ("jsonschema", "{}")})


@pytest.mark.parametrize(
    ("build", "columns"),
    [
        (
            lambda i: {"t": {"sec": int(TRUTH.stamps[i]) // 10**9, "nsec": int(TRUTH.stamps[i]) % 10**9},
                       "data": {"g": DEG[i].tolist(), "a": (TRUTH.accel[i] / G0).tolist()}},
            "g=data.g,a=data.a,t=t",
        ),
        (
            lambda i: {"ns": int(TRUTH.stamps[i]),
                       "imus": [{}, {"v": [*DEG[i].tolist(), *(TRUTH.accel[i] / G0).tolist()]}]},
            None,
        ),
        (
            lambda i: {"stamp_ns": int(TRUTH.stamps[i]), "gyro_dps": dict(zip("xyz", DEG[i], strict=True)),
                       "accel": dict(zip("xyz", TRUTH.accel[i] / G0, strict=True))},
            "g=gyro_dps,a=accel,t=stamp_ns",
        ),
    ],
)  # fmt: skip
def test_json_messages_of_any_layout_are_read(
    build: Callable[[int], object], columns: str | None, tmp_path: Path
) -> None:
    """Messages are lists, mappings or lists of mappings; the first message defines the fields."""
    path = json_log(tmp_path, build)
    (topic,) = describe(path).topics
    assert topic.fields
    if columns is None:
        # The first element of the list is empty and has no fields.
        assert topic.fields == ("ns number",)
        return
    is_near(read(path, columns=columns, gyro_unit="deg/s", accel_unit="g"))


def protobuf_log(folder: Path, *, standard: bool = False) -> Path:
    """Write messages with a custom schema and omitted zeros, as users of Foxglove do."""
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


def test_known_protobuf_fields_need_no_columns_text(tmp_path: Path) -> None:
    """Names and stamps are recognised as in other messages."""
    is_near(read(protobuf_log(tmp_path, standard=True)), 0)


def test_named_columns_of_protobuf_messages_are_read(tmp_path: Path) -> None:
    """The error lists the columns; list elements are named by their index."""
    path = protobuf_log(tmp_path)
    assert "1 turning_dps.x = " in refused(path, topic=TOPIC)
    (topic,) = describe(path).topics
    assert topic.fields[-1] == "raw int32[]"
    is_near(read(path, columns="g=turning_dps,a=push_g", gyro_unit="deg/s", accel_unit="g"))
    columns = "g=raw[0]+raw[1]+raw[2],a=raw[3]+raw[4]+raw[5],t=timestamp"
    is_near(read(path, columns=columns, **SCALES), 6e-4)


@pytest.mark.parametrize("seeds", first_by_default([range(10), range(10, 30)], 1))
@pytest.mark.parametrize(
    ("write", "columns"),
    [
        (lambda folder: protobuf_log(folder, standard=True), "g=raw"),
        (lambda folder: protobuf_log(folder, standard=True), None),
        (several, "g=imus[1].rate,a=imus[1].force"),
        (lambda folder: counts(folder, "int16[]"), "g=g,a=a"),
        (lambda folder: json_log(folder, lambda i: {"g": DEG[i].tolist()}), "g=g"),
        (lambda folder: json_log(folder, lambda i: {"g": DEG[i].tolist()}), None),
        (single, None),
    ],
    ids=["protobuf", "protobuf by name", "list of structures", "sequence", "JSON", "JSON by name", "ROS"],
)
def test_a_damaged_log_gives_samples_or_an_error_with_its_path(
    write: Callable[[Path], Path], columns: str | None, seeds: range, tmp_path: Path
) -> None:
    """Schemas, definitions and messages are damaged at random."""
    path = write(tmp_path)
    original = path.read_bytes()
    for seed in seeds:
        rng = np.random.default_rng(seed)
        data = bytearray(original)
        for place in rng.integers(0, len(data), 1 + int(rng.integers(20))):
            data[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
        for action in (lambda path: read(path, columns=columns, **SCALES), describe):
            try:
                action(path)
            except ImucalError as error:
                assert str(error).startswith(str(path))  # noqa: PT017 - the message is the point


def test_a_recursive_schema_is_not_searched_completely() -> None:
    """The type has many fields of its own type."""
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


def test_fields_are_listed_with_their_types(tmp_path: Path) -> None:
    """Fields in lists are listed for the first element."""
    (topic,) = describe(several(tmp_path)).topics
    assert topic.fields == (
        "header.stamp time",
        "imus[0].header.stamp time",
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
        ("b", True),
        ("c[99]", True),
        ("d[7].x", True),
        ("e", False),
        ("f[63]", True),
        ("f[64]", False),
        ("s", False),
    ],
)
def test_a_path_with_a_valid_index_is_found(path: str, there: bool) -> None:  # noqa: FBT001 - a parameter of the case
    """The index is checked if the length is known."""
    text = "float64 a\nint16[3] b\nint16[] c\nD[] d\nstring s\nfloat32[64] f\n===\nMSG: acme/D\nfloat64 x"
    channel = Channel(
        key=1, topic="/t", type="acme/msg/M", encoding="cdr", definition=text, definition_kind="ros2msg"
    )
    container: Any = SimpleNamespace(channels=[channel])
    (topic,) = find_topics([container], ReadOptions(columns=f"g={path}+a+a" if "[" in path else f"g={path}"))
    names = [number.name for number in topic.numbers]
    assert (path in names or f"{path}[2]" in names) == there


@pytest.mark.parametrize("columns", ["g=w,a=imus[0].f", "g=w,a=f"])
def test_named_columns_of_ros1_and_ros2_bags_are_read(columns: str, tmp_path: Path) -> None:
    """The message is read by fixed offsets, or as a tree if it has a list of structures."""
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
        is_near(read(path, columns=columns, gyro_unit="rad/s"), 0)
