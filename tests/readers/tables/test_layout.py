"""How a text is laid out, from a few lines: delimiter, rows, header, units, preamble."""

import pytest

from imucal.readers.tables.layout import (
    BLANKS,
    TextLayout,
    _fitting,
    _named_delimiter,
    _start,
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
        # Decimal commas leave the other delimiter.
        (("1,5;2,5;3,5",) * 2, ";", 3),
        # A second delimiter that makes more cells.
        (("1,2,3;4,5,6;7,8,9",) * 2, ",", 7),
        # A spreadsheet's word goes first, in the first two lines.
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
def test_delimiters(lines: tuple[str, ...], delimiter: str, width: int) -> None:
    """The one that gives most cells, unless the log names it."""
    layout = found(*lines)
    assert (layout.delimiter, layout.width) == (delimiter, width)


def test_a_delimiter_of_one_line_is_none() -> None:
    """It needs two lines, or all there are."""
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
def test_a_log_of_one_axis(head: tuple[str, ...], row: str, width: int, headers: tuple[str, ...]) -> None:
    """One or two columns, where most lines are nothing but numbers and there are ten of them."""
    rows = [row.format(i) for i in range(10)]
    layout = found(*head, *rows)
    assert (layout.width, layout.headers, len(layout.rows)) == (width, headers, 10)
    assert find_layout([*head, *rows[:9]]) is None
    assert find_layout([*rows, *(f"line {i} of a text" for i in range(7))]) is None


def test_a_header_settles_which_delimiter_is_meant() -> None:
    """Blanks in dates make more cells than there are names; a delimiter of half the cells is looked at."""
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
def test_cells_of_a_line(line: str, delimiter: str, cells: list[str]) -> None:
    """Without blanks around them; quotation marks hide a delimiter."""
    assert split_line(line, delimiter) == cells


def test_rows_of_a_tag() -> None:
    """In one column, or in any; with quotation marks or without."""
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
def test_rows_begin_where_most_lines_are_rows(fitting: list[int], lines: int, start: int) -> None:
    """Six of ten, of the next eight lines or of those that are left."""
    assert _start(fitting, lines) == start


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([["1", "2"]], (0, [])),
        ([["1", "2", "3"]], (3, [0])),
        # Four of ten cells, the empty ones left out.
        ([["1", "2", "3", "4", *"abcdef"]], (10, [0])),
        ([["1", "2", "3", "4", *"abcdefg"]], (0, [])),
        ([["1", "2", "3", "4", *"abcdef", "", ""]], (12, [0])),
        # The most cells win, of two equal ones the wider.
        ([["1"] * 3] * 3 + [["1"] * 4] * 2, (3, [0, 1, 2])),
        ([["1"] * 4] * 3 + [["1"] * 6] * 2, (6, [3, 4])),
        ([["1"] * 51] * 2 + [["1"] * 99], (51, [0, 1])),
        ([["1"] * 50, ["1"] * 51], (51, [1])),
        ([["1"] * 49, ["1"] * 50], (50, [1])),
        # Sparse rows belong to a table of that width.
        ([["1", "2", "3"], ["", "1", ""], ["", "", ""], ["a", "1", ""]], (3, [0, 1])),
    ],
)
def test_which_lines_are_rows(rows: list[list[str]], expected: tuple[int, list[int]]) -> None:
    """Three numbers or more, in cells of which enough are numbers."""
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
def test_the_decimal_sign(row: list[str], decimal: str) -> None:
    """The sign that more numbers have, the point where there are as many."""
    assert found(";".join(["1", "2", "3", *row])).decimal == decimal


@pytest.mark.parametrize(
    ("lines", "headers", "units", "preamble", "start"),
    [
        (ROWS, (), (), (), 0),
        (("one,two,three", *ROWS), ("one", "two", "three"), (), (), 1),
        (("note", "", "one,two,three", *ROWS), ("one", "two", "three"), (), ("note",), 3),
        (("note", *ROWS), (), (), ("note",), 1),
        # A mark of comments is no name.
        (("#,one,two,three", *ROWS), ("one", "two", "three"), (), (), 1),
        (("//,one,two,three", *ROWS), ("one", "two", "three"), (), (), 1),
        # A row of units; three cells of ten are enough.
        (("t,a,b", "[s],(g),note", *ROWS), ("t", "a", "b"), ("s", "g", None), (), 2),
        (("s,g,g", *ROWS), (), ("s", "g", "g"), ("s,g,g",), 1),
        # One cell too many where the last is empty, or one too few beside an empty column.
        (("one,two,three,", *ROWS), ("one", "two", "three"), (), (), 1),
        (("one,two,three", "1,2,3,", "4,5,6,", "7,8,9,"), ("one", "two", "three", ""), (), (), 1),
        # Two rows of names.
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
        # Names that stand for three columns.
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
def test_headers(
    lines: tuple[str, ...],
    headers: tuple[str, ...],
    units: tuple[str | None, ...],
    preamble: tuple[str, ...],
    start: int,
) -> None:
    """The last line of names above the rows, and what stands above it."""
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
def test_names_that_do_not_fit(header: str, mismatch: int | None) -> None:
    """One name too many or too few is said; a line that differs by more is no header."""
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
def test_a_stated_rate(line: str, rate: float | None) -> None:
    """In Hz or kHz, above the rows; zero is none."""
    assert found(line, "one,two,three", *ROWS).rate_hz == rate


def test_quotation_marks_and_decimal_commas() -> None:
    """Rows with quotation marks are told from those without; cells come with a decimal point."""
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
def test_a_spreadsheet_names_its_delimiter_at_the_top(lines: list[str], delimiter: str | None) -> None:
    """In the first line or the second."""
    assert _named_delimiter(lines) == delimiter
