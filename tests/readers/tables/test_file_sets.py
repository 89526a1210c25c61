"""Files that are read together: which of them holds nothing but times."""

from pathlib import Path

import pytest

from imucal.readers.tables.file_sets import _is_time_file, _read_times


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


@pytest.mark.parametrize(
    ("header", "ns", "source"),
    [("time_ms", 1_000_000, "from the header of times.csv"), ("time", None, "")],
)
def test_the_unit_of_a_file_of_times(header: str, ns: int | None, source: str, tmp_path: Path) -> None:
    """The header is named as the source of the unit only where it has one."""
    path = tmp_path / "times.csv"
    path.write_text(f"{header}\n1\n2.5\n4\n", encoding="utf-8")
    times = _read_times(path)
    assert (times.choice.name, times.choice.ns, times.choice.ns_source) == (header, ns, source)
    assert times.values.tolist() == [1.0, 2.5, 4.0]
