"""Rows of a block: what is a number, which lines are samples, and which rows are bad."""

import math

import pytest

from imucal.readers.tables.layout import BLANKS, TextLayout, row_pattern
from imucal.readers.tables.text_table import BlockReader, Kind, _number, _read_blocks


def reader(**changes: object) -> BlockReader:
    layout = TextLayout(width=3, rows=(), headers=("t", "x", "y"), delimiter=",")
    kinds: dict[int, Kind] = {0: "integer", 1: "float"}
    return BlockReader(layout=layout, kinds=kinds, needed=frozenset({0}), **changes)  # type: ignore[arg-type]


def test_defaults() -> None:
    """No limit of memory that a column could reach, and no rows expected."""
    assert (reader().limit, reader().expected, reader().rows) == (1 << 62, 0, None)


@pytest.mark.parametrize(
    ("cell", "kind", "value"),
    [
        ("1_0", "float", None),
        ("1_0", "integer", None),
        ("1_0", "stamp", "1_0"),
        ("", "integer", None),
        ("12", "integer", 12),
        ("1.5", "integer", 1.5),
        (str(2**63 - 1), "integer", 2**63 - 1),
        (str(2**63), "integer", None),
        (str(-(2**63)), "integer", -(2**63)),
        (str(-(2**63) - 1), "integer", None),
        ("12", "float", 12.0),
        ("x", "float", None),
    ],
)
def test_numbers(cell: str, kind: Kind, value: float | str | None) -> None:
    """Whole numbers of 64 bits, no underscores; a text is itself."""
    assert _number(cell, kind) == value


def test_an_empty_cell_of_floats_is_nan() -> None:
    """It belongs to another sensor."""
    empty = _number("", "float")
    assert isinstance(empty, float)
    assert math.isnan(empty)


@pytest.mark.parametrize(
    ("cells", "row"),
    [
        (["1", "2", "3"], [1, 2.0]),
        (["1", "2"], [1, 2.0]),
        (["1", "2", "3", "4"], None),
        ([], None),
        (["", "2", "3"], None),
        (["1", "x", "3"], None),
    ],
)
def test_rows_by_hand(cells: list[str], row: list[float] | None) -> None:
    """No more cells than names, and each that is needed."""
    assert reader()._row(cells) == row


def test_bad_rows_are_counted_and_the_first_is_kept() -> None:
    """Up to 120 characters; comments, blank lines and the header again are not bad."""
    blocks = reader()
    bad = "x" * 130
    blocks.add(f"1,2,3\n# note\n% note\n// note\n; note\n\nt, x, y\n{bad}\nworse\n2,3,4\n".encode())
    assert (blocks.good, blocks.bad, blocks.first_bad) == (2, 2, "x" * 120)


@pytest.mark.parametrize(
    ("index", "delimiter", "found"),
    [
        (0, ",", [b"IMU,1,2", b'"IMU" ,3,4']),
        (1, ",", [b"7,IMU,5", b"8,'IMU',9"]),
        (-1, ",", [b"IMU,1,2", b'"IMU" ,3,4', b"7,IMU,5", b"8,'IMU',9"]),
        (0, BLANKS, [b'"IMU" ,3,4', b" IMU 8 9"]),
    ],
)
def test_tagged_rows(index: int, delimiter: str, found: list[bytes]) -> None:
    """The cell at the place holds the whole text; a place of -1 is any."""
    pattern = row_pattern((index, "IMU"), delimiter)
    text = b"""IMU,1,2\n"IMU" ,3,4\n7,IMU,5\nIMU2,1,2\n IMU 8 9\n8,'IMU',9\n"""
    assert pattern.findall(text) == found


@pytest.mark.parametrize(("start", "left"), [(0, [1, 2, 3, 4]), (1, [2, 3, 4]), (3, [4])])
def test_without_the_first_lines(start: int, left: list[int]) -> None:
    """Across blocks."""
    blocks = reader()
    layout = TextLayout(width=3, rows=(), start=start)
    assert _read_blocks([b"1,2,3\n2,2,3\n", b"3,2,3\n4,2,3\n"], layout, [blocks]) == ""
    assert blocks.columns[0].take().tolist() == left
