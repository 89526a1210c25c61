"""The columns text that is proposed where no header names the columns."""

import re

import numpy as np
import pytest

from imucal.errors import ChoiceError, ReadError
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.plan import _gravity, _nearest, _time_column
from imucal.readers.tables.plan import _proposals_proposal as _proposal
from imucal.readers.tables.text_table import _inertial_tags, lay_out
from imucal.units import G0


@pytest.mark.parametrize(
    ("steps", "column"),
    [
        ([[1, 1], [2, 2]], 0),
        ([[1, 1], [1, 2]], 1),
        ([[1, 2], [1, 1]], None),
        ([[1, 1], [2, 1], [1, 2]], 1),
        ([[1, 1]], None),
    ],
)
def test_time(steps: list[list[float]], column: int | None) -> None:
    """The first column that only goes on, and does."""
    assert _time_column(np.array(steps, dtype=np.float64)) == column


@pytest.mark.parametrize(
    ("row", "time", "column"),
    [
        ([0, 0, G0, 1, 1, 1], None, 0),
        ([7, 0, 0, 1, 2, 2, 2], 0, 1),
        ([0, 0, 1.049, 2, 2, 2], None, 0),
        ([0, 0, 1.051, 2, 2, 2], None, None),
        ([0, 0, 0.951, 2, 2, 2], None, 0),
        ([0, 0, 0.949, 2, 2, 2], None, None),
        # Two are none, and so is one that the time splits.
        ([0, 0, 1, 0, 0, 1], None, None),
        ([0, 7, 0, 1], 1, None),
    ],
)
def test_gravity(row: list[float], time: int | None, column: int | None) -> None:
    """Three columns of the size of gravity, within five percent."""
    assert _gravity(np.array([row] * 3, dtype=np.float64), time) == column


@pytest.mark.parametrize(
    ("starts", "accel", "nearest"),
    [
        ([0, 3, 6], 3, 0),
        ([1, 4, 7], 1, 4),
        ([0, 1, 6], 3, 0),
        ([7], 3, 7),
        ([2, 3, 4], 3, None),
        ([], 3, None),
    ],
)
def test_the_gyroscope_stands_beside(starts: list[int], accel: int, nearest: int | None) -> None:
    """Right before or behind the accelerometer, else anywhere it does not overlap."""
    assert _nearest(starts, accel) == nearest


@pytest.mark.parametrize(
    ("numeric", "time", "accel", "text"),
    [
        (range(7), 0, 4, "t=0,g=1:4,a=4:7"),
        (range(7), 0, None, "t=0,g=1:4,a=4:7"),
        (range(6), None, None, "g=0:3,a=3:6"),
        (range(2, 9), 0, None, "t=2,g=3:6,a=6:9"),
        ((0, 1, 2, 4, 5, 6), None, None, "g=0:3,a=4:7"),
        (range(4), 0, None, "t=0,g=1:4"),
        (range(4), 0, 1, "t=0,a=1:4"),
        ((0, 2, 4, 6), None, None, ""),
    ],
)
def test_proposals(numeric: list[int], time: int | None, accel: int | None, text: str) -> None:
    """By the places of the columns in the log; nothing where nothing fits."""
    assert _proposal(numeric, time, accel) == text


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
