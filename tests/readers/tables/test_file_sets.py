"""Files that are read together: which of them holds nothing but times."""

from pathlib import Path

import pytest

from imucal.readers.tables.file_sets import _is_time_file


@pytest.mark.parametrize(
    ("content", "times"),
    [
        ("time\n1\n2\n", True),
        ("time\n1\n", False),
        ("count\n1\n2\n", False),
        ("time\n1\nx\n", False),
        ("time\n\n1\n2.5\n", True),
        ("time,gx\n1,2\n2,3\n", False),
        ("", False),
    ],
)
def test_a_file_of_times(content: str, times: bool, tmp_path: Path) -> None:  # noqa: FBT001 - of the case
    """One column named as a time, with two numbers or more."""
    path = tmp_path / "times.csv"
    path.write_text(content, encoding="utf-8")
    assert _is_time_file(path) == times
