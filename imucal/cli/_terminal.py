"""How wide a table may be, and texts broken to keep within it."""

import shutil
import textwrap

#: Widest table: what fits a terminal, a mail and a log of CI.
FULL = 80
#: Narrower than this nothing is made to fit.
_LEAST = 30


def width() -> int:
    """Return the columns of the terminal, 80 at most; 80 where the output is no terminal."""
    return max(_LEAST, min(FULL, shutil.get_terminal_size((FULL, 24)).columns))


def fitted(line: str, columns: int, *, indent: int) -> list[str]:
    """Return a line, broken between words where it is too long, later lines indented."""
    if len(line) <= columns:
        return [line]
    return textwrap.wrap(line, columns, subsequent_indent=" " * indent, break_on_hyphens=False)


def wrapped(text: str, *, indent: int = 0) -> list[str]:
    """Break a text into lines of the page's width; line breaks of its own are kept."""
    lines = []
    for line in text.rstrip().split("\n"):
        own = indent + len(line) - len(line.lstrip())
        lines += textwrap.wrap(
            line,
            width(),
            initial_indent=" " * own if line.strip() else "",
            subsequent_indent=" " * (own + 2),
            break_on_hyphens=False,
        ) or [""]
    return lines
