"""The layout of a text log: a table, tagged rows or sentences; or the error that says what to do."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from imucal.errors import ChoiceError, ReadError
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.columns import Rows
from imucal.readers.tables.headless import named_columns, propose_columns, tagged_layout
from imucal.readers.tables.layout import Layout, find_layout
from imucal.readers.tables.vectornav import find_vectornav, good_sentences


@dataclass(frozen=True, slots=True, kw_only=True)
class TextLayout:
    """A text whose layout is known.

    Attributes
    ----------
    layout
        Of its rows.
    rows
        The rows to read, where the format is one of tagged rows.
    prepare
        Turns a block into rows of plain cells, where the format needs it.
    lines
        The head.
    """

    layout: Layout
    rows: Rows = None
    prepare: Callable[[bytes], bytes] | None = None
    lines: Sequence[str] = ()


def lay_out(path: str, lines: Sequence[str], options: ReadOptions) -> TextLayout:
    """Find the layout of a text.

    Raises
    ------
    ReadError
        If it holds no rows of numbers.
    ChoiceError
        If its header doesn't fit its rows.
    """
    sentences = find_vectornav(lines)
    if sentences is not None:
        return TextLayout(layout=sentences, rows=None, prepare=good_sentences, lines=lines)
    tagged = tagged_layout(lines)
    if tagged is not None:
        return TextLayout(layout=tagged[0], rows=tagged[1], lines=lines)
    layout = find_layout(lines)
    if layout is None:
        first = next((line.strip() for line in lines if line.strip()), "")
        msg = (
            f"{path}: no rows of three numbers or more, the first line is {first[:80]!r}; "
            "expected a table with a row per sample"
        )
        raise ReadError(msg)
    if layout.mismatch is not None and options.columns is None:
        msg = (
            f"{path}: the header has {layout.mismatch} names and the rows {layout.width} cells, so no name "
            f"belongs to a column; found the row {', '.join(layout.rows[0][:40])}; "
            "correct the header, or say which columns are which by a columns text such as t=0,g=1:4,a=4:7 "
            "(places from 0 with the end left out)"
        )
        raise ChoiceError(msg)
    layout = named_columns(layout)
    if not layout.headers and options.columns is None:
        shown = ", ".join(f"{place} {cell}" for place, cell in enumerate(layout.rows[0][:40]))
        msg = (
            f"{path}: no header names the {layout.width} columns, and an order is not guessed; "
            f"found the row {shown}; "
            "expected a header, or a columns text that says which are which, such as "
            f"{propose_columns(lines, layout)} (places from 0 with the end left out; check which is which)"
        )
        raise ChoiceError(msg)
    return TextLayout(layout=layout, lines=lines)
