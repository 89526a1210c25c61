"""Parsing of row blocks: numbers, rows of samples, and bad rows."""

import io
import math

import pytest

from imucal.readers.tables.layout import BLANKS, TextLayout, row_pattern
from imucal.readers.tables.text_blocks import BlockReader, Kind
from imucal.readers.tables.text_source import TextSource
from imucal.readers.tables.text_table import _read_blocks


def reader(**changes: object) -> BlockReader:
    layout = TextLayout(width=3, rows=(), headers=("t", "x", "y"), delimiter=",")
    kinds: dict[int, Kind] = {0: "integer", 1: "float"}
    return BlockReader(layout=layout, kinds=kinds, needed=frozenset({0}), **changes)  # type: ignore[arg-type]


def column(kind: Kind, *cells: str, needed: bool = True) -> list[float]:
    """Return the values of a column with some cells, each after a one."""
    layout = TextLayout(width=2, rows=(), headers=("n", "t"))
    blocks = BlockReader(
        layout=layout, kinds={0: "integer", 1: kind}, needed=frozenset({0, 1} if needed else {0})
    )
    blocks.add("".join(f"1,{cell}\n" for cell in cells).encode())
    assert blocks.good + blocks.bad == len(cells)
    values: list[float] = blocks.columns[1].take().tolist()
    return values


@pytest.mark.parametrize(
    ("cell", "kind", "values"),
    [
        ("1_0", "float", [3]),
        ("1_0", "integer", [3]),
        ("", "integer", [3]),
        ("12", "integer", [12, 3]),
        ("+12", "integer", [12, 3]),
        (str(2**63 - 1), "integer", [2**63 - 1, 3]),
        (str(2**63), "integer", [3]),
        (str(-(2**63)), "integer", [-(2**63), 3]),
        (str(-(2**63) - 1), "integer", [3]),
        ("12", "float", [12.0, 3]),
        ("+.5e1", "float", [5.0, 3]),
        ("-Infinity", "float", [-math.inf, 3]),
        ("x", "float", [3]),
        ("0x1", "float", [3]),
        ("1 2", "float", [3]),
        ("12:00:00", "stamp", [43_200 * 10**9]),
    ],
)
def test_cells_are_parsed_strictly(cell: str, kind: Kind, values: list[float]) -> None:
    """Integers have 64 bits, underscores are invalid, and two numbers are never joined."""
    found = column(kind, cell, "3")
    assert found == values
    assert {type(value) for value in found} == {float if kind == "float" else int}


def test_a_float_turns_an_integer_column_into_floats() -> None:
    """Damaged stamps in ns do not."""
    assert column("integer", "1", "1.5", "2") == [1.0, 1.5, 2.0]
    stamp = 1_700_000_000_000_000_001
    assert column("integer", str(stamp), "9" * 25, "1e30", "x", str(stamp + 2)) == [stamp, stamp + 2]


def test_an_empty_cell_of_floats_is_nan() -> None:
    """If the column is not needed, an empty cell belongs to another sensor."""
    values = column("float", "", "3", needed=False)
    assert math.isnan(values[0])
    assert values[1:] == [3]
    assert column("float", "", "3") == [3]


@pytest.mark.parametrize(
    ("row", "good"),
    [
        ("1,2,3", True),
        ("1,2", True),
        ("1,2,3,4", False),
        ("1,2,3,4,5", False),
        (",2,3", False),
        ("x,2,3", False),
        ("1", True),
    ],
)
def test_a_row_needs_every_required_cell(row: str, good: bool) -> None:  # noqa: FBT001 - of the case
    """A row must not have more cells than there are names."""
    blocks = reader()
    blocks.add(f"{row}\n".encode())
    assert (blocks.good, blocks.bad) == (int(good), int(not good))


@pytest.mark.parametrize(
    ("line", "values"),
    [
        (b'"5","6,0",7', [5]),
        (b'5,6,"a, b"', [5]),
        (b'"5","6,0,7', []),
        (b'5","6,0",7', []),
        (b'"5,6",0,7', []),
    ],
)
def test_a_quoted_delimiter_belongs_to_the_cell(line: bytes, values: list[int]) -> None:
    """A line with an unpaired quotation mark is bad."""
    layout = TextLayout(width=3, rows=(), quoted=True)
    blocks = BlockReader(layout=layout, kinds={0: "integer"}, needed=frozenset({0, 2}))
    blocks.add(line + b"\n1,2,3\n")
    assert blocks.columns[0].take().tolist() == [*values, 1]


def test_bad_rows_are_counted_and_the_first_is_kept() -> None:
    """The kept text has up to 120 characters. Comments, blank lines and repeated headers are not bad."""
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
def test_rows_are_selected_by_the_complete_tag(index: int, delimiter: str, found: list[bytes]) -> None:
    """An index of -1 means any column."""
    pattern = row_pattern((index, "IMU"), delimiter)
    text = b"""IMU,1,2\n"IMU" ,3,4\n7,IMU,5\nIMU2,1,2\n IMU 8 9\n8,'IMU',9\n"""
    assert pattern.findall(text) == found


@pytest.mark.parametrize(("start", "left"), [(0, [1, 2, 3, 4]), (1, [2, 3, 4]), (3, [4])])
def test_the_first_lines_are_skipped_across_blocks(start: int, left: list[int]) -> None:
    blocks = reader()
    layout = TextLayout(width=3, rows=(), start=start)
    source = TextSource("log", io.BytesIO(b"1,2,3\n"))
    assert _read_blocks(source, [b"1,2,3\n2,2,3\n", b"3,2,3\n4,2,3\n"], layout, [blocks]) == ""
    assert blocks.columns[0].take().tolist() == left
