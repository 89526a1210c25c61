"""Errors about texts with an ambiguous layout or ambiguous columns."""

import re
from pathlib import Path

import pytest

from imucal.errors import ChoiceError, ReadError
from imucal.readers import read


@pytest.mark.parametrize(
    ("lines", "error", "text"),
    [
        (
            ["", " hello " + "x" * 90],
            ReadError,
            (
                f"/log.csv: found no rows of numbers; the first line is {'hello ' + 'x' * 74!r}; "
                "expected a table with a row per sample"
            ),
        ),
        (
            [f"{i},0.1,0.2,9.8" for i in range(5)],
            ChoiceError,
            (
                "/log.csv: the 4 columns have no header; found columns: "
                "0 = 0, 1 = 0.1, 2 = 0.2, 3 = 9.8; name them in a columns text of the form "
                "t=TIME,g=X+Y+Z,a=X+Y+Z (names of columns, or their numbers from 0)"
            ),
        ),
    ],
)
def test_an_ambiguous_layout_is_refused(
    lines: list[str], error: type[Exception], text: str, tmp_path: Path
) -> None:
    """The error reports the content, the expected form and what to do."""
    path = tmp_path / "log.csv"
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    with pytest.raises(error, match=f"{re.escape(text)}$"):
        read(path)
