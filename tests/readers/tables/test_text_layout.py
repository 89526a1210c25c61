"""The columns text that is proposed where no header names the columns."""

import re
from collections.abc import Sequence

import pytest

from imucal.errors import ChoiceError, ReadError
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.plan import propose_columns
from imucal.readers.tables.text_table import _inertial_tags, lay_out
from imucal.units import G0


def proposed(*rows: Sequence[float | str], time: str = "", taken: Sequence[int] = ()) -> str:
    """Return the columns text for a table of some rows."""
    columns = [list(map(str, cells)) for cells in zip(*rows, strict=True)]
    return propose_columns(columns.__getitem__, len(columns), time=time, taken=taken, suffix="@i")


@pytest.mark.parametrize(
    ("pairs", "text"),
    [
        ([(1, 1), (2, 2)], "t=0,g=2:5@i"),
        ([(1, 1), (1, 2)], "t=1,g=2:5@i"),
        ([(1, 2), (1, 1)], "g=0:3@i"),
        ([(1, 1), (2, 1), (1, 2)], "t=1,g=2:5@i"),
        ([(1, 1)], "g=0:3@i"),
    ],
)
def test_time(pairs: list[tuple[float, float]], text: str) -> None:
    """The first column that only goes on, and does."""
    taken = (1,) if text.startswith("t=0") else ()
    assert proposed(*((*pair, 2, 3, 4) for pair in pairs), taken=taken) == text


@pytest.mark.parametrize(
    ("row", "time", "text"),
    [
        ((0, 0, G0, 2, 2, 2), "", "g=3:6@i,a=0:3@i"),
        ((0, 0, 1.049, 2, 2, 2), "", "g=3:6@i,a=0:3@i"),
        ((0, 0, 1.051, 2, 2, 2), "", "g=0:3@i,a=3:6@i"),
        ((0, 0, 0.951, 2, 2, 2), "", "g=3:6@i,a=0:3@i"),
        ((0, 0, 0.949, 2, 2, 2), "", "g=0:3@i,a=3:6@i"),
        # Two are none, and a column of text parts one.
        ((0, 0, 1, 0, 0, 1), "", "g=0:3@i,a=3:6@i"),
        ((0, 0, "x", 1, 2, 2, 2), "", "g=3:6@i"),
        # Beyond eight columns of numbers gravity tells nothing.
        ((0, 0, 1, 2, 2, 2, 9, 9), "", "g=3:6@i,a=0:3@i"),
        ((0, 0, 1, 2, 2, 2, 9, 9, 9), "", "g=0:3@i,a=3:6@i"),
        # The gyroscope's three columns overlap no others; they may stand apart.
        ((0, 0, 1, 2), "", "a=0:3@i"),
        ((0, 0, 1, 2, "x", 2, 2, 2), "", "g=5:8@i,a=0:3@i"),
        ((2, 2, 2, "x", 0, 0, 1), "", "g=0:3@i,a=4:7@i"),
        ((2, 2, 2, 2), "", "g=0:3@i"),
        ((2, "x", 2, "x", 2, "x", 2), "", ""),
        # A time that is known, or told by its text.
        ((2, 2, 2, 2, 2, 2), "9", "t=9,g=0:3@i,a=3:6@i"),
        (("12:00:01", 2, 2, 2), "", "t=0,g=1:4@i"),
        (("2026-01-02 12:00:01", 2, 2, 2), "", "t=0,g=1:4@i"),
        ((2, 2, 2, "2026-01-02", "12:00:01"), "", "t=3+4,g=0:3@i"),
        ((2, 2, 2, "2026-01-02", "12:00:01", "PM"), "", "t=3+4+5,g=0:3@i"),
        ((2, 2, 2, "2026-01-02"), "", "g=0:3@i"),
        # One axis, perhaps behind a time.
        (("x", 2), "", "gz=1@i"),
        ((1, "x", 2), "", "t=0,gz=2@i"),
        (("x", 2), "0", "t=0,gz=1@i"),
        ((1, 2), "0", ""),
        (("x", "y"), "", ""),
    ],
)
def test_proposals(row: tuple[float | str, ...], time: str, text: str) -> None:
    """Three columns of the size of gravity, within five percent, are the accelerometer; else the order is."""
    assert proposed(row, row, time=time) == text


def test_columns_that_are_taken_are_not_proposed() -> None:
    """Nor do they part others: places are those of the log."""
    assert proposed((7, 2, 2, 2, 7, 2, 2, 2), taken=(0, 4)) == "g=1:4@i,a=5:8@i"
    assert proposed((7, 2, 2, 7, 2), taken=(0, 3)) == ""


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
                f"log.csv: no rows of numbers, the first line is {'hello ' + 'x' * 74!r}; "
                "expected a table with a row per sample"
            ),
        ),
        (
            [f"{i},0.1,0.2,0.3" for i in range(5)],
            ChoiceError,
            (
                "log.csv: no header names the 4 columns, and an order is not guessed; found columns: "
                "0 0, 1 0.1, 2 0.2, 3 0.3; say which are which by a columns text such as t=0,g=1:4 "
                "(places from 0 with the end left out, or three names joined by +)"
            ),
        ),
    ],
)
def test_errors(lines: list[str], error: type[Exception], text: str) -> None:
    """What was found, what was expected and what to do."""
    with pytest.raises(error, match=f"^{re.escape(text)}$"):
        lay_out("log.csv", lines, ReadOptions())
