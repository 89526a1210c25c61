"""The columns text that is proposed where the columns."""

import re
from collections.abc import Sequence

import pytest

from imucal.errors import ChoiceError, ReadError
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.columns import NamedTable
from imucal.readers.tables.names import parse_column
from imucal.readers.tables.proposals import proposal
from imucal.readers.tables.text_table import _inertial_tags, lay_out
from imucal.units import G0


def proposed(
    *rows: Sequence[float | str], names: Sequence[str] = (), file: str = "log.csv", tagged: bool = False
) -> str:
    """Return the columns text for a table of some rows."""
    columns = [list(map(str, cells)) for cells in zip(*rows, strict=True)]
    headers = names or [""] * len(columns)
    named = tuple(parse_column(headers[at], at, cells=cells) for at, cells in enumerate(columns))
    table = NamedTable(path=file, columns=named)
    return proposal(table, name=file, rows="@i" if tagged else "")


@pytest.mark.parametrize(
    ("pairs", "text"),
    [
        ([(1, 1), (2, 2)], ""),
        ([(1,), (2,)], "t=0,a=1:4"),
        ([(1, 1), (1, 2)], "t=1,a=2:5"),
        ([(1, 1, 1), (1, 1, 2)], "t=2,a=3:6"),
        ([(), ()], "a=0:3"),
    ],
)
def test_time(pairs: list[tuple[float, ...]], text: str) -> None:
    """The first column that only goes on, and does; what is left is taken three by three."""
    assert proposed(*((*pair, 0, 0, G0) for pair in pairs)) == text


@pytest.mark.parametrize(
    ("row", "text"),
    [
        ((0, 0, G0, 2, 2, 2), "g=3:6,a=0:3"),
        ((2, 2, 2, 0, 0, G0), "g=0:3,a=3:6"),
        # Within fifteen percent, in g and mg too, or counts of a usual range.
        ((0, 0, 1.149, 2, 2, 2), "g=3:6,a=0:3"),
        ((0, 0, 1.151, 2, 2, 2), ""),
        ((0, 0, 851, 2, 2, 2), "g=3:6,a=0:3"),
        ((0, 0, 16384, 30, 20, 10), "g=3:6,a=0:3"),
        # A column of text parts two; neighbours have one column between them at most.
        ((0, 0, "x", 1, 2, 2, 2), ""),
        ((0, 0, 1, "x", 2, 2, 2), "g=4:7,a=0:3"),
        ((0, 0, 1, "x", "y", 2, 2, 2), "a=0:3"),
        # Beyond eight columns of numbers gravity tells nothing.
        ((0, 0, 1, 2, 2, 2, 9, 9), "g=3:6,a=0:3"),
        ((0, 0, 1, 2, 2, 2, 9, 9, 9), ""),
        ((0, 0, 1, 2), "a=0:3"),
        ((2, 2, 2, 2), ""),
        # A time that its text tells.
        (("12:00:01", 0, 0, 1), "t=0,a=1:4"),
        (("2026-01-02 12:00:01", 0, 0, 1), "t=0,a=1:4"),
        ((0, 0, 1, "2026-01-02", "12:00:01"), "t=3+4,a=0:3"),
        ((0, 0, 1, "2026-01-02", "12:00:01", "PM"), "t=3+4+5,a=0:3"),
        # One axis, perhaps behind a time.
        (("x", 2), "gz=1"),
        (("12:00:01", 2), "t=0,gz=1"),
        (("x", "y"), ""),
    ],
)
def test_proposals_by_numbers(row: tuple[float | str, ...], text: str) -> None:
    """Three columns whose mean is gravity are the accelerometer, and those beside them the gyroscope."""
    assert proposed(row, row) == text


@pytest.mark.parametrize(
    ("names", "text"),
    [
        ("t accl0 accl1 accl2 gyr0 gyr1 gyr2", "t=0,g=4:7,a=1:4"),
        ("t acc1 acc2 acc3 - - -", "t=0,a=1:4"),
        ("t LN_ACCELX LN_ACCELY LN_ACCELZ turnX turnY turnZ", "t=0,g=4:7,a=1:4"),
        ("t Gyro - - Acc - -", "t=0,g=1:4,a=4:7"),
        ("t d[0] d[1] d[2] d[3] d[4] d[5]", ""),
        ("t x y z acc_x acc_y acc_z", "t=0,g=1:4,a=4:7"),
        # What is named as something else, or as nothing known, is no sensor.
        ("t robot_x robot_y robot_z acc_x acc_y acc_z", "t=0,a=4:7"),
        ("t robot_x robot_y theta v w dist", ""),
        ("t lat lon alt lat_std lon_std alt_std", ""),
        ("t qx qy qz mag_x mag_y mag_z", ""),
        ("t wheel1 wheel2 wheel3 wheel4 steer brake", ""),
        # Of two numbered axes nobody knows where they count from.
        ("t gyro_1 gyro_2 a b c d", ""),
        ("t gyro_y gyro_z a b c d", "t=0,gy=1,gz=2"),
    ],
)
def test_proposals_by_names(names: str, text: str) -> None:
    """A part of a name is enough; below the threshold there is no proposal."""
    plain = names.replace("-", "").split(" ")
    assert proposed((1, 2, 3, 2, 3, 2, 3), (2, 2, 3, 2, 3, 2, 3), names=plain) == text


@pytest.mark.parametrize(("file", "text"), [("gyr_x.txt", "gz=0"), ("data_acc.txt", "az=0"), ("y.csv", "")])
def test_the_only_column_may_be_named_by_its_file(file: str, text: str) -> None:
    assert proposed((1,), (2,), names=["y"], file=file) == text


def test_rows_of_an_inertial_sensor_are_in_the_usual_order() -> None:
    """Where their tag says so, and gravity does not tell."""
    assert proposed((1, 2, 3, 2, 3, 2, 3), (2, 2, 3, 2, 3, 2, 3), tagged=True) == "t=0,g=1:4@i,a=4:7@i"
    assert proposed((1, 2, 3, 2, 3, 2, 3), (2, 2, 3, 2, 3, 2, 3)) == ""


def test_tags() -> None:
    """Of the first three cells, the most frequent first."""
    lines = ["'IMU',1", "1,GYR,2", "1,GYR,2", "1,2,acc", "1,2,3,INS", "note,1"]
    assert _inertial_tags(lines, ",") == ["GYR", "IMU", "acc"]


@pytest.mark.parametrize(
    ("lines", "error", "text"),
    [
        (
            ["", " hello " + "x" * 90],
            ReadError,
            (
                f"log.csv: found no rows of numbers; the first line is {'hello ' + 'x' * 74!r}; "
                "expected a table with a row per sample"
            ),
        ),
        (
            [f"{i},0.1,0.2,9.8" for i in range(5)],
            ChoiceError,
            (
                "log.csv: the 4 columns have no header; found columns: "
                "0 0, 1 0.1, 2 0.2, 3 9.8; name them in a columns text such as t=0,a=1:4 "
                "(numbers from 0 without the end, or three names joined by +)"
            ),
        ),
    ],
)
def test_errors(lines: list[str], error: type[Exception], text: str) -> None:
    """What was found, what was expected and what to do."""
    with pytest.raises(error, match=f"^{re.escape(text)}$"):
        lay_out("log.csv", lines, ReadOptions())
