"""The layout of a text from a few lines: delimiter, rows, header, units, preamble."""

import pytest

from imucal.readers.tables.layout import (
    BLANKS,
    TextLayout,
    _fitting,
    _from_start,
    _named_delimiter,
    find_layout,
    rows_of_tag,
    split_line,
)

TEN = "one,two,three,four,five,six,seven,eight,nine,ten"
ROWS = ("1,2,3", "4,5,6", "7,8,9")


def found(*lines: str) -> TextLayout:
    layout = find_layout(lines)
    assert layout is not None
    return layout


@pytest.mark.parametrize(
    ("lines", "delimiter", "width"),
    [
        (ROWS, ",", 3),
        (("1;2;3",), ";", 3),
        (("1\t2\t3",) * 2, "\t", 3),
        (("1|2|3",) * 2, "|", 3),
        (("1 \t 2  3",) * 2, BLANKS, 3),
        # Decimal commas exclude the comma as delimiter.
        (("1,5;2,5;3,5",) * 2, ";", 3),
        # The delimiter that gives more cells wins.
        (("1,2,3;4,5,6;7,8,9",) * 2, ",", 7),
        # A spreadsheet's "sep=" in the first two lines has priority.
        (("sep=;", "1 2 3;4 5 6;7;8;9;10"), ";", 6),
        (("", "SEP=;", *("1,1;1,2;1,3",) * 2), ";", 3),
        (('sep="|"', "1|2|3|x,y,z", "1|2|3|x,y,z"), "|", 4),
        (("sep=\\t", *("1\t2 5\t3\t4",) * 2), "\t", 4),
        (("sep=\t", *("1\t2 5\t3\t4",) * 2), "\t", 4),
        (("sep=", *("1\t2 5\t3\t4",) * 2), "\t", 4),
        (("sep=x", *ROWS), ",", 3),
        (("sep=;", *ROWS), ",", 3),
    ],
)
def test_the_delimiter_gives_the_most_cells(lines: tuple[str, ...], delimiter: str, width: int) -> None:
    """A delimiter that the log names has priority."""
    layout = found(*lines)
    assert (layout.delimiter, layout.width) == (delimiter, width)


def test_a_delimiter_must_be_in_two_lines() -> None:
    """If there is only one line, that line is enough."""
    assert found("1;2;3").delimiter == ";"
    assert find_layout(["1;2;3", "hello"]) is None
    assert find_layout(["1,2", "3,4"]) is None


@pytest.mark.parametrize(
    ("head", "row", "width", "headers"),
    [
        ((), "{0},{0}.5", 2, ()),
        (("t,gz",), "{0},{0}.5", 2, ("t", "gz")),
        (("time gz",), "{0} {0}.5", 2, ("time", "gz")),
        (("gz",), "{0}.5", 1, ("gz",)),
        (("Rate Z (deg/s)",), "{0}.5", 1, ("Rate Z (deg/s)",)),
        ((), "{0}.5", 1, ()),
        (("# a rest", "t;gz"), "{0};{0},5", 2, ("t", "gz")),
    ],
)
def test_ten_lines_of_one_or_two_numbers_are_a_table(
    head: tuple[str, ...], row: str, width: int, headers: tuple[str, ...]
) -> None:
    """Most lines must contain only numbers."""
    rows = [row.format(i) for i in range(10)]
    layout = found(*head, *rows)
    assert (layout.width, layout.headers, len(layout.rows)) == (width, headers, 10)
    assert find_layout([*head, *rows[:9]]) is None
    assert find_layout([*rows, *(f"line {i} of a text" for i in range(7))]) is None


def test_a_header_identifies_the_delimiter() -> None:
    """Blanks in dates give more cells than there are names.

    A delimiter is considered if it gives at least half of the cells.
    """
    rows = ("2024 01 01;1;2;3", "2024 01 01;4;5;6")
    assert (found(*rows).delimiter, found("t;x;y;z", *rows).delimiter) == (";", ";")
    rows = ("2024 01 01 00 00;1;2;3", "2024 01 01 00 01;4;5;6")
    assert (found(*rows).delimiter, found("t;x;y;z", *rows).delimiter) == (BLANKS, ";")
    layout = found("t;x;y;z", *("1 2 3 4 5;1 2;1 2;7",) * 2)
    assert layout.delimiter == BLANKS
    assert layout.headers == ()


@pytest.mark.parametrize(
    ("line", "delimiter", "cells"),
    [
        (" a , b ,c", ",", ["a", "b", "c"]),
        ('a, "b, c" ,d', ",", ["a", "b, c", "d"]),
        ("a,'b,c'", ",", ["a", "'b", "c'"]),
        ("a\t b  c", BLANKS, ["a", "b", "c"]),
        ("", ",", [""]),
    ],
)
def test_a_line_is_split_into_stripped_cells(line: str, delimiter: str, cells: list[str]) -> None:
    """A delimiter within quotation marks does not split."""
    assert split_line(line, delimiter) == cells


def test_rows_are_selected_by_a_tag() -> None:
    """The tag is in a given column or in any, with or without quotation marks."""
    lines = ["imu,1", "'imu',2", "1,imu", "imux,1", ""]
    assert rows_of_tag(lines, ",", (0, "imu")) == ["imu,1", "'imu',2"]
    assert rows_of_tag(lines, ",", (1, "imu")) == ["1,imu"]
    assert rows_of_tag(lines, ",", (7, "imu")) == []
    assert rows_of_tag(lines, ",", (-1, "imu")) == ["imu,1", "'imu',2", "1,imu"]


@pytest.mark.parametrize(
    ("fitting", "lines", "start"),
    [
        ([0, 1, 2, 3, 4, 10, 11, 12, 13, 14, 15, 16], 20, 0),
        ([0, 1, 2, 3, 10, 11, 12, 13, 14, 15, 16], 20, 10),
        ([0, 5, 6, 7], 10, 5),
        ([0, 5, 6, 7], 11, 0),
        ([4], 5, 4),
    ],
)
def test_rows_start_where_most_lines_are_rows(fitting: list[int], lines: int, start: int) -> None:
    """Six of ten of the next eight lines must be rows, or of the remaining lines."""
    assert _from_start(fitting, lines)[0] == start


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([["1", "2"]], (0, [])),
        ([["1", "2", "3"]], (3, [0])),
        # At least four of ten non-empty cells must be numbers.
        ([["1", "2", "3", "4", *"abcdef"]], (10, [0])),
        ([["1", "2", "3", "4", *"abcdefg"]], (0, [])),
        ([["1", "2", "3", "4", *"abcdef", "", ""]], (12, [0])),
        # The width with the most cells wins; at a tie the larger width.
        ([["1"] * 3] * 3 + [["1"] * 4] * 2, (3, [0, 1, 2])),
        ([["1"] * 4] * 3 + [["1"] * 6] * 2, (6, [3, 4])),
        ([["1"] * 51] * 2 + [["1"] * 99], (51, [0, 1])),
        ([["1"] * 50, ["1"] * 51], (51, [1])),
        ([["1"] * 49, ["1"] * 50], (50, [1])),
        # Sparse rows belong to the table if they have its width.
        ([["1", "2", "3"], ["", "1", ""], ["", "", ""], ["a", "1", ""]], (3, [0, 1])),
    ],
)
def test_a_row_has_three_numbers(rows: list[list[str]], expected: tuple[int, list[int]]) -> None:
    """Enough of its cells must be numbers."""
    assert _fitting(rows, ".") == expected


@pytest.mark.parametrize(
    ("row", "decimal"),
    [
        (["1,5"], ","),
        (["1,5", "1.5"], "."),
        (["1,5", "2,5", "1.5"], ","),
        (["1,5e3", "-2,5", ".5"], ","),
        (["1", "x"], "."),
        (["1,"], "."),
    ],
)
def test_the_decimal_sign_is_the_more_frequent_one(row: list[str], decimal: str) -> None:
    """At a tie it is the point."""
    assert found(";".join(["1", "2", "3", *row])).decimal == decimal


@pytest.mark.parametrize(
    ("lines", "headers", "units", "preamble", "start"),
    [
        (ROWS, (), (), (), 0),
        (("one,two,three", *ROWS), ("one", "two", "three"), (), (), 1),
        (("note", "", "one,two,three", *ROWS), ("one", "two", "three"), (), ("note",), 3),
        (("note", *ROWS), (), (), ("note",), 1),
        # A comment mark is not a name.
        (("#,one,two,three", *ROWS), ("one", "two", "three"), (), (), 1),
        (("//,one,two,three", *ROWS), ("one", "two", "three"), (), (), 1),
        # A row of units needs units in three of ten cells.
        (("t,a,b", "[s],(g),note", *ROWS), ("t", "a", "b"), ("s", "g", None), (), 2),
        (("s,g,g", *ROWS), (), ("s", "g", "g"), ("s,g,g",), 1),
        # The header has an empty last cell, or one cell fewer than the rows because a column is empty.
        (("one,two,three,", *ROWS), ("one", "two", "three"), (), (), 1),
        (("one,two,three", "1,2,3,", "4,5,6,", "7,8,9,"), ("one", "two", "three", ""), (), (), 1),
        # The header has two rows of names.
        (("g,,", "x,y,z", *ROWS), ("g x", "g y", "g z"), (), ("g,,",), 2),
        (("x,y,z", *ROWS), ("x", "y", "z"), (), (), 1),
        (("g,", "x,y,z", *ROWS), ("g x", "g y", "g z"), (), ("g,",), 2),
        (("g,,,,", "x,y,z", *ROWS), ("x", "y", "z"), (), ("g,,,,",), 2),
        (
            (TEN, f"s,g,g{',note' * 7}", *("1,2,3,4,5,6,7,8,9,10",) * 3),
            tuple(TEN.split(",")),
            ("s", "g", "g", *(None,) * 7),
            (),
            2,
        ),
        # A name stands for three columns.
        (
            ("t,gyro,x,y,z,acc,x,y,z", *("1,2,3,4,5,6,7,8,9",) * 3),
            ("t", "gyro", "gyro x", "gyro y", "gyro z", "acc", "acc x", "acc y", "acc z"),
            (),
            (),
            1,
        ),
        (("gyro,x,y", *ROWS), ("gyro", "x", "y"), (), (), 1),
    ],
)
def test_the_header_is_the_last_line_of_names_above_the_rows(
    lines: tuple[str, ...],
    headers: tuple[str, ...],
    units: tuple[str | None, ...],
    preamble: tuple[str, ...],
    start: int,
) -> None:
    """The lines above the header are the preamble."""
    layout = found(*lines)
    assert (layout.headers, layout.units, layout.preamble, layout.start) == (headers, units, preamble, start)
    assert layout.mismatch is None
    assert len(layout.rows) == 3


@pytest.mark.parametrize(
    ("header", "mismatch"),
    [
        ("one,two", 2),
        ("one,two,three,four", 4),
        ("one", None),
        ("one,two,three,four,five", 5),
        ("one,two,three,", None),
    ],
)
def test_one_name_too_many_or_too_few_is_reported(header: str, mismatch: int | None) -> None:
    """A line that differs by more is not a header."""
    layout = found(header, *ROWS)
    assert layout.mismatch == mismatch
    assert layout.headers == (("one", "two", "three") if header == "one,two,three," else ())


@pytest.mark.parametrize(
    ("line", "rate"),
    [
        ("Fs,100", 100.0),
        ("Update Rate: 0.5kHz", 500.0),
        ("sample_rate: 2 khz", 2000.0),
        ("output data rate 12.5 Hz", 12.5),
        ("Fs,0", None),
        ("refs,100", None),
        ("note", None),
    ],
)
def test_a_rate_above_the_rows_is_read(line: str, rate: float | None) -> None:
    """The unit is Hz or kHz; a rate of zero is ignored."""
    assert found(line, "one,two,three", *ROWS).rate_hz == rate


def test_quotation_marks_are_detected_and_decimal_commas_become_points() -> None:
    assert [found(*ROWS).quoted, found('"a",b,c', *ROWS).quoted, found(*ROWS, '"1",2,3').quoted] == [
        False,
        False,
        True,
    ]
    layout = found("1,5;2;3", "2,5;3")
    assert (layout.decimal, layout.cells(0), layout.cells(2)) == (",", ["1.5"], ["3"])
    assert found(*ROWS).cells(1) == ["2", "5", "8"]
    assert found(*ROWS).cells(3) == []
    assert TextLayout(width=1, rows=()).quoted is False


@pytest.mark.parametrize(
    ("lines", "delimiter"),
    [
        (["sep=;", "a;b"], ";"),
        (["# made by hand", "sep=,", "a,b"], ","),
        (["# made", "# by hand", "sep=,", "a,b"], None),
        (["a;b"], None),
        ([], None),
    ],
)
def test_the_first_or_second_line_can_name_the_delimiter(lines: list[str], delimiter: str | None) -> None:
    assert _named_delimiter(lines) == delimiter
