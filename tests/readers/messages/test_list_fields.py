"""Lists of samples in one message, and single axes, in every container and encoding."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.testing as npt
import pytest

from imucal.arrays import FloatArray, IntArray
from imucal.errors import ChoiceError
from imucal.readers import read
from imucal.readers.messages.leaves import _axis_of
from imucal.readers.messages.message_types import Named, parse_fields_text
from imucal.readers.messages.trees import spread_times
from imucal.recording import Recording, Sensor
from tests.cli.run import run
from tests.readers.logs import TOPIC, Message, header, samples, store, write_bag, write_db3, write_mcap
from tests.readers.messages.test_messages import axes
from tests.readers.messages.test_named_fields import json_log, protobuf_log, single

TRUTH = samples(120)
KIND = "acme/msg/Some"
#: Samples in each message; a buffer is not always read when it holds as many.
COUNTS = [8, 7, 9] * 5
ENDS = np.cumsum(COUNTS)
RAD: dict[str, Any] = {"gyro_unit": "rad/s"}


def xyz(values: FloatArray) -> dict[str, float]:
    return dict(zip("xyz", values.tolist(), strict=True))


def rows_of(message: int) -> range:
    return range(int(ENDS[message]) - COUNTS[message], int(ENDS[message]))


def ros_log(folder: Path, kind: str, *, stamped: bool, drop: tuple[int, ...] = ()) -> Path:
    """Write messages of lists of IMUs, with stamps in each element or only in the message."""
    ros1 = kind == "bag"
    one = ("std_msgs/Header header\n" if stamped else "") + "float64[3] rate\ngeometry_msgs/Vector3 force"
    types = store(ros1=ros1, acme__msg__Some="std_msgs/Header header\nOne[] imus", acme__msg__One=one)
    vector, part = types.types["geometry_msgs/msg/Vector3"], types.types["acme/msg/One"]
    messages = []
    for number in range(len(COUNTS)):
        rows = rows_of(number)
        imus = [
            part(
                **({"header": header(types, int(TRUTH.stamps[row]))} if stamped else {}),
                rate=TRUTH.gyro[row],
                force=vector(*TRUTH.accel[row].tolist()),
            )
            for row in rows
        ]
        message = types.types[KIND](header=header(types, int(TRUTH.stamps[rows[-1]])), imus=imus)
        data = types.serialize_ros1(message, KIND) if ros1 else types.serialize_cdr(message, KIND)
        if number not in drop:
            messages.append(Message(topic=TOPIC, type=KIND, log=int(TRUTH.log[rows[-1]]), data=bytes(data)))
    path = folder / {"mcap": "log.mcap", "bag": "log.bag", "db3": "bag"}[kind]
    if kind == "bag":
        return write_bag(path, messages, types=types)
    return (write_mcap if kind == "mcap" else write_db3)(path, messages, types=types)


def is_truth(recording: Recording) -> None:
    """Check all samples, their rate, and that nothing is missing."""
    npt.assert_array_equal(axes(recording), TRUTH.all)
    clock = recording.series[0].clock
    assert clock.rate_hz == pytest.approx(100, rel=1e-3)
    assert clock.missing == 0


@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
@pytest.mark.parametrize("stamped", [True, False])
def test_lists_in_ros_messages(kind: str, tmp_path: Path, *, stamped: bool) -> None:
    """All elements are samples, at their own stamps or spread over the time of the message."""
    path = ros_log(tmp_path, kind, stamped=stamped)
    recording = read(path, fields="gyro=imus[].rate accel=imus[].force", **RAD)
    is_truth(recording)
    if stamped:
        assert recording.series[0].clock.start_ns == TRUTH.stamps[0]
        assert recording.series[0].clock.jitter_s == pytest.approx(0, abs=1e-9)
    by_log = read(path, fields="gyro=imus[].rate accel=imus[].force", time="log", **RAD)
    is_truth(by_log)


def test_a_message_that_is_missing_leaves_a_gap(tmp_path: Path) -> None:
    """As long as its samples."""
    path = ros_log(tmp_path, "mcap", stamped=False, drop=(6,))
    recording = read(path, fields="gyro=imus[].rate accel=imus[].force", **RAD)
    clock = recording.series[0].clock
    assert (clock.n, clock.missing) == (112, 8)
    npt.assert_array_equal(clock.grid(), np.delete(np.arange(120), rows_of(6)))


def test_one_element_alone_is_read_by_its_index(tmp_path: Path) -> None:
    """One sample a message, and a word on the others; what it says to type works."""
    path = ros_log(tmp_path, "mcap", stamped=True)
    recording = read(path, fields="gyro=imus[0].rate", **RAD)
    npt.assert_array_equal(axes(recording), TRUTH.gyro[[rows_of(k)[0] for k in range(len(COUNTS))]])
    (found,) = (finding for finding in recording.findings if finding.code == "other-vectors")
    assert found.text == (
        "Messages of /imu/data contain 8 elements of imus; one was read. If all are samples of one "
        "sensor, use imus[]."
    )
    everything = read(path, fields="gyro=imus[].rate", **RAD)
    npt.assert_array_equal(axes(everything), TRUTH.gyro)
    assert not [finding for finding in everything.findings if finding.code == "other-vectors"]


@pytest.mark.parametrize(
    ("build", "fields"),
    [
        (
            lambda rows: {"t": {"sec": int(TRUTH.stamps[rows[-1]]) // 10**9,
                                "nsec": int(TRUTH.stamps[rows[-1]]) % 10**9},
                          "s": [{"g": TRUTH.gyro[i].tolist(), "a": TRUTH.accel[i].tolist()} for i in rows]},
            "gyro=s[].g accel=s[].a time=t",
        ),
        (
            lambda rows: {"s": [{"ns": int(TRUTH.stamps[i]), "g": xyz(TRUTH.gyro[i]),
                                 "a": xyz(TRUTH.accel[i])} for i in rows]},
            "gyro=s[].g accel=s[].a time=s[].ns",
        ),
        (
            lambda rows: {f"{s}{a}": TRUTH.all[list(rows), 3 * k + j].tolist()
                          for k, s in enumerate("ga") for j, a in enumerate("xyz")},
            "gyro=gx[],gy[],gz[] accel=ax[],ay[],az[]",
        ),
    ],
    ids=["lists", "mappings", "buffers"],
)  # fmt: skip
def test_lists_in_json(build: Callable[[range], object], fields: str, tmp_path: Path) -> None:
    """Of vectors, of mappings, and a list for each axis; without stamps the log time is spread."""
    messages = [
        Message(
            topic=TOPIC,
            type="any",
            log=int(TRUTH.log[rows_of(k)[-1]]),
            data=json.dumps(build(rows_of(k))).encode(),
            encoding="json",
        )
        for k in range(len(COUNTS))
    ]
    path = write_mcap(tmp_path / "log.mcap", messages, definitions={"any": ("jsonschema", "{}")})
    is_truth(read(path, fields=fields, **RAD))


def test_a_damaged_message_is_lost_alone(tmp_path: Path) -> None:
    """One whose lists differ in length, and one that is no JSON: the others are read."""
    good = [{"g": TRUTH.gyro[list(rows_of(k)), 2].tolist(), "n": [0.0]} for k in range(len(COUNTS))]
    data = [json.dumps(message).encode() for message in good]
    data[4] = b"{"
    messages = [
        Message(topic=TOPIC, type="any", log=int(TRUTH.log[ENDS[k] - 1]), data=data[k], encoding="json")
        for k in range(len(COUNTS))
    ]
    path = write_mcap(tmp_path / "log.mcap", messages, definitions={"any": ("jsonschema", "{}")})
    recording = read(path, fields="gyro.z=g[]", **RAD)
    assert [series.name for series in recording.series] == ["gyro_z"]
    npt.assert_array_equal(recording.series[0].samples, np.delete(TRUTH.gyro[:, 2], rows_of(4)))
    assert any(finding.code == "damaged" for finding in recording.findings)
    with pytest.raises(Exception, match=r"lists of 1, 8 elements"):
        read(path, fields="gyro.z=g[] gyro.x=n[]", **RAD)


def test_lists_in_protobuf(tmp_path: Path) -> None:
    """A repeated field: six numbers a message, as many samples of one axis."""
    recording = read(protobuf_log(tmp_path), fields="gyro.z=raw[]", gyro_scale=1.0)
    assert recording.series[0].n == 6 * 120
    assert recording.series[0].rate_hz == pytest.approx(600, rel=1e-3)


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        (
            "gyro=imus[].rate accel=imus[0].force",
            "imus[].rate[0] has [] and imus[0].force.x has not",
        ),
        ("gyro=imus[0].rate time=imus[].header.stamp", "imus[].header.stamp.sec has [] and"),
        ("gyro=imus[][].rate", "'gyro=imus[][].rate' can't be read"),
    ],
)
def test_half_lists(fields: str, problem: str, tmp_path: Path) -> None:
    """Samples of each element beside those of the message would be held ones."""
    with pytest.raises(ChoiceError, match=re.escape(problem)):
        read(ros_log(tmp_path, "mcap", stamped=True), fields=fields, **RAD)


def turn_log(folder: Path) -> Path:
    """Write JSON with two numbers, of which one tells its axis."""

    def build(row: int) -> object:
        rate = float(TRUTH.gyro[row, 2])
        return {"turn": rate, "omega": {"z": rate}}

    return json_log(folder, build)


@pytest.mark.parametrize(
    ("write", "fields", "other"),
    [
        (single, "gyro=gz", "gyro.x=gz"),
        (turn_log, "gyro=omega.z", "gyro.x=turn"),
        (lambda path: protobuf_log(path, standard=True), "g=angular_velocity.z", "g.x=angular_velocity.z"),
        (lambda folder: ros_log(folder, "bag", stamped=True), "g.z=imus[].rate[2]", "g.x=imus[].rate[2]"),
        (lambda folder: ros_log(folder, "db3", stamped=True), "g.z=imus[].rate[2]", "g.x=imus[].rate[2]"),
    ],
    ids=["mcap", "json", "protobuf", "bag", "db3"],
)  # fmt: skip
def test_one_axis(write: Callable[[Path], Path], fields: str, other: str, tmp_path: Path) -> None:
    """By a name that says which, or by one that is given; the others are not there."""
    path = write(tmp_path)
    for text, name in ((fields, "gyro_z"), (other, "gyro_x")):
        recording = read(path, fields=text, **RAD)
        assert [series.name for series in recording.series] == [name]
        npt.assert_array_equal(recording.series[0].samples, TRUTH.gyro[:, 2])


def test_two_axes_and_another_sensor(tmp_path: Path) -> None:
    """Each sensor has the axes that are named, in the order x, y, z."""
    recording = read(single(tmp_path), fields="gyro.z=gz g.x=gx accel=ax,ay,az", **RAD)
    assert [series.name for series in recording.series] == [
        "gyro_x",
        "gyro_z",
        "accel_x",
        "accel_y",
        "accel_z",
    ]
    npt.assert_array_equal(axes(recording), TRUTH.all[:, [0, 2, 3, 4, 5]])


def test_an_axis_that_no_name_tells(tmp_path: Path) -> None:
    """The error says what to type, and that works."""
    path = json_log(tmp_path, lambda i: {"turn": float(TRUTH.gyro[i, 2])})
    with pytest.raises(ChoiceError) as caught:
        read(path, fields="gyro=turn", **RAD)
    match = re.search(r"such as (\S+)$", str(caught.value))
    assert match is not None
    assert match[1] == "gyro.z=turn"
    assert read(path, fields=match[1], **RAD).series[0].name == "gyro_z"
    done = run("fit", "log.mcap", "--fields", match[1], "--gyro-unit", "rad/s", "--no-report", cwd=tmp_path)
    assert "gyro z: 120 samples" in done.stderr


@pytest.mark.parametrize(
    ("path", "axis"),
    [("gz", "z"), ("gyro_y_dps", "y"), ("a.X", "x"), ("rotationRateZ", "z"), ("s[].wx", "x"), ("y", "y"),
     ("gyroz", None), ("rate", None), ("raw[2]", None)],
)  # fmt: skip
def test_axes_by_name(path: str, axis: str | None) -> None:
    """A letter that stands alone, behind the sensor's, or as a capital."""
    if axis is not None:
        assert _axis_of(Sensor.GYROSCOPE, path) == axis
        return
    with pytest.raises(ChoiceError, match=re.escape(f"such as gyro.z={path}")):
        _axis_of(Sensor.GYROSCOPE, path)


def test_texts_of_axes() -> None:
    """Named one by one, in any order; not twice, and not beside the whole."""
    text = parse_fields_text(["gyro.z=a", "g.X=b accel=c"])
    assert text is not None
    assert text.gyro == Named(paths=("b", "a"), axes=("x", "z"))
    assert text.accel == Named(paths=("c",))
    for wrong in (
        "gyro.z=a g.z=b",
        "gyro=a gyro.z=b",
        "gyro.z=a gyro=b",
        "gyro.z=a,b",
        "time.z=a",
        "gyro.w=a",
    ):
        with pytest.raises(ChoiceError, match=r"can't be read; expected the form .* or gyro\.z=PATH"):
            parse_fields_text([wrong])


def spread(counts: list[int], ends: list[int]) -> IntArray:
    times = np.repeat(np.array(ends, dtype=np.int64), counts)
    spread_times(times, (times.copy(),))
    return times


def test_spreading() -> None:
    """The last element has the message's time; the distance is the usual one, not that of a gap."""
    assert spread([2, 2, 2, 2], [20, 40, 60, 80]).tolist() == [10, 20, 30, 40, 50, 60, 70, 80]
    assert spread([2, 1, 3], [20, 30, 60]).tolist() == [10, 20, 30, 40, 50, 60]
    assert spread([2, 2, 2, 2], [20, 40, 100, 120]).tolist() == [10, 20, 30, 40, 90, 100, 110, 120]
    assert spread([1, 1, 1], [20, 40, 60]).tolist() == [20, 40, 60]
    assert spread([3], [20]).tolist() == [20, 20, 20]
    assert spread([2, 2], [0, 0]).tolist() == [0, 0, 0, 0]
