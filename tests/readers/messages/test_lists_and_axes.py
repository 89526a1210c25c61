"""Lists of samples in one message, and single axes, in every container and encoding."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.testing as npt
import pytest

from imucal.errors import ChoiceError
from imucal.readers import read
from tests.cli.run import run
from tests.readers.logs import TOPIC, Message, header, samples, store, write_bag, write_db3, write_mcap
from tests.readers.messages.test_messages import axes
from tests.readers.messages.test_named_columns import json_log, protobuf_log, single

TRUTH = samples(120)
KIND = "acme/msg/Some"
#: Samples in each message; the size varies because buffers are not read at exact intervals.
COUNTS = [8, 7, 9] * 5
ENDS = np.cumsum(COUNTS)
RAD: dict[str, Any] = {"gyro_unit": "rad/s"}


def rows_of(message: int) -> range:
    return range(int(ENDS[message]) - COUNTS[message], int(ENDS[message]))


def ros_log(folder: Path, kind: str, *, stamped: bool) -> Path:
    """Write messages with lists of IMUs, with stamps in each element or only in the message."""
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
        messages.append(Message(topic=TOPIC, type=KIND, log=int(TRUTH.log[rows[-1]]), data=bytes(data)))
    path = folder / {"mcap": "log.mcap", "bag": "log.bag", "db3": "bag"}[kind]
    if kind == "bag":
        return write_bag(path, messages, types=types)
    return (write_mcap if kind == "mcap" else write_db3)(path, messages, types=types)


@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
@pytest.mark.parametrize("stamped", [True, False])
def test_one_element_of_a_list_can_be_read(kind: str, tmp_path: Path, *, stamped: bool) -> None:
    """Each message gives one sample, at the time of the element or of the message."""
    path = ros_log(tmp_path, kind, stamped=stamped)
    firsts = [rows_of(number)[0] for number in range(len(COUNTS))]
    time = ",t=imus[0].header.stamp" if stamped else ""
    recording = read(path, columns=f"g=imus[0].rate,a=imus[0].force{time}", **RAD)
    npt.assert_array_equal(axes(recording), TRUTH.all[firsts])
    start = firsts[0] if stamped else rows_of(0)[-1]
    assert recording.series[0].clock.start_ns == TRUTH.stamps[start]


def test_only_damaged_json_messages_are_lost(tmp_path: Path) -> None:
    """One message is not JSON, and one has a list that is too short."""
    data = [json.dumps({"g": TRUTH.gyro[i].tolist()}).encode() for i in range(120)]
    data[4], data[5] = b"{", b'{"g": [1.0, 2.0]}'
    messages = [
        Message(topic=TOPIC, type="any", log=log, data=text, encoding="json")
        for log, text in zip(TRUTH.log.tolist(), data, strict=True)
    ]
    path = write_mcap(tmp_path / "log.mcap", messages, definitions={"any": ("jsonschema", "{}")})
    recording = read(path, columns="gz=g[2]", **RAD)
    assert [series.name for series in recording.series] == ["gyro_z"]
    npt.assert_array_equal(recording.series[0].samples, np.delete(TRUTH.gyro[:, 2], [4, 5]))
    (found,) = (finding for finding in recording.findings if finding.code == "damaged")
    assert "in 2 places" in found.text


def turn_log(folder: Path) -> Path:
    """Write JSON with two numbers; only one has a name with an axis."""

    def build(row: int) -> object:
        rate = float(TRUTH.gyro[row, 2])
        return {"turn": rate, "omega": {"z": rate}}

    return json_log(folder, build)


@pytest.mark.parametrize(
    ("write", "columns", "other"),
    [
        (single, "gz=gz", "gx=gz"),
        (turn_log, "gz=omega.z", "gx=turn"),
        (lambda path: protobuf_log(path, standard=True), "gz=angular_velocity.z", "gx=angular_velocity.z"),
        (lambda folder: ros_log(folder, "bag", stamped=True), "gz=imus[2].rate[2]", "gx=imus[2].rate[2]"),
        (lambda folder: ros_log(folder, "db3", stamped=True), "gz=imus[2].rate[2]", "gx=imus[2].rate[2]"),
    ],
    ids=["mcap", "json", "protobuf", "bag", "db3"],
)  # fmt: skip
def test_a_single_axis_can_be_read(
    write: Callable[[Path], Path], columns: str, other: str, tmp_path: Path
) -> None:
    """The name of the column is free, and the recording has no other axis."""
    path = write(tmp_path)
    rows = [rows_of(k)[2] for k in range(len(COUNTS))] if "imus" in columns else slice(None)
    for text, name in ((columns, "gyro_z"), (other, "gyro_x")):
        recording = read(path, columns=text, **RAD)
        assert [series.name for series in recording.series] == [name]
        npt.assert_array_equal(recording.series[0].samples, TRUTH.gyro[rows, 2])


def test_some_axes_of_a_sensor_can_be_read(tmp_path: Path) -> None:
    """The result has the order x, y, z."""
    recording = read(single(tmp_path), columns="gz=gz,gx=gx,a=ax+ay+az", **RAD)
    names = ["gyro_x", "gyro_z", "accel_x", "accel_y", "accel_z"]
    assert [series.name for series in recording.series] == names
    npt.assert_array_equal(axes(recording), TRUTH.all[:, [0, 2, 3, 4, 5]])


def test_the_axis_of_a_column_without_axis_name_must_be_given(tmp_path: Path) -> None:
    """The error shows the columns text, which works."""
    path = json_log(tmp_path, lambda i: {"turn": float(TRUTH.gyro[i, 2])})
    with pytest.raises(ChoiceError) as caught:
        read(path, columns="g=turn", **RAD)
    match = re.search(r"for one axis write (\w+=\w+)", str(caught.value))
    assert match is not None
    assert match[1] == "gz=0"
    assert read(path, columns=match[1], **RAD).series[0].name == "gyro_z"
    asked = ("--columns", "gz=turn", "--gyro-unit", "rad/s")
    done = run("fit", "log.mcap", *asked, "--no-report", cwd=tmp_path)
    assert "gyro z: 120 samples" in done.stderr
