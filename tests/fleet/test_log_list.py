"""Tests of the search for logs by names, folders and wildcards, and of the labels in their paths."""

from pathlib import Path

import pytest

from imucal.errors import ArgumentError, ReadError
from imucal.fleet.logs import find_logs, label_pattern
from imucal.fleet.manifest import labels_in
from tests.cli.run import run


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder of logs with a bag folder and other files."""
    for name in (
        *("logs/b/2.mcap", "logs/b/10.mcap", "logs/a/x.csv.gz", "logs/a/notes.txt", "logs/.hidden.csv"),
        *("logs/bag/metadata.yaml", "logs/bag/bag_0.db3", "logs/a/readme.md"),
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("x")
    monkeypatch.chdir(tmp_path)
    return tmp_path


ALL = ["logs/a/x.csv.gz", "logs/b/2.mcap", "logs/b/10.mcap", "logs/bag"]


@pytest.mark.parametrize(
    ("names", "logs"),
    [
        (["logs"], ALL),
        (["logs/**"], ALL),
        (["logs/*"], ALL),
        (["logs/*/*"], [*ALL[:3], "logs/bag/bag_0.db3"]),
        (["logs/a/*.txt"], ["logs/a/notes.txt"]),
        (["logs/b/*.mcap"], ["logs/b/2.mcap", "logs/b/10.mcap"]),
        (["logs/**/*.db3"], ["logs/bag/bag_0.db3"]),
        (["logs/bag"], ["logs/bag"]),
        (["logs/a/notes.txt", "missing.bag"], ["logs/a/notes.txt", "missing.bag"]),
        (["logs/b/10.mcap", "logs/b"], ["logs/b/10.mcap", "logs/b/2.mcap"]),
    ],
)
@pytest.mark.usefixtures("tree")
def test_names_are_expanded_to_logs(names: list[str], logs: list[str]) -> None:
    """Each log appears once, in natural order; an explicitly named file is always a log."""
    found = find_logs(names)
    assert found == logs


def test_a_list_has_one_name_per_line(tree: Path) -> None:
    """Lines of standard input may also be folders."""
    done = run("fleet", "run", "-", "--dry-run", cwd=tree, text="logs/b\n\n logs/a/x.csv.gz \n")
    found = [line.split("\t")[1] for line in done.stdout.splitlines()]
    assert found == [*ALL[1:3], ALL[0]]


def test_a_name_may_be_missing_or_have_brackets(tree: Path) -> None:
    """The reader reports a missing log, and the other logs are done."""
    assert find_logs(["gone/a.mcap"]) == ["gone/a.mcap"]
    (tree / "log[1].csv").write_text("x")
    assert find_logs(["log[1].csv"]) == ["log[1].csv"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("*.bag", r"\*\.bag: no log has this name; expected files, or folders with logs"),
        ("empty", r"empty: no log in this folder; expected files that end in \.mcap"),
        ("nowhere", r"nowhere: no such file or folder; expected logs, or folders with logs"),
    ],
)
def test_a_name_without_logs_is_an_error(tree: Path, name: str, message: str) -> None:
    """An empty fleet would hide the mistake."""
    (tree / "empty").mkdir()
    with pytest.raises(ReadError, match=message):
        find_logs([name])


@pytest.mark.parametrize(
    ("pattern", "path", "labels"),
    [
        ("{model}/{unit}/*.mcap", "a/bmi/007/x.mcap", {"model": "bmi", "unit": "007"}),
        ("{unit}/{temperature_c}C/*", "u1/-25C/x.bag", {"unit": "u1", "temperature_c": -25.0}),
        ("{model}-{unit}.*", "logs/adis-3-b.csv", {"model": "adis", "unit": "3-b"}),
        ("{unit}/**/*.csv", "u1/2026/05/x.csv", {"unit": "u1"}),
        ("{unit}_run?.npz", "u1_run7.npz", {"unit": "u1"}),
        ("{model}/{unit}/*.mcap", "s3://bucket/bmi/007/x.mcap", {"model": "bmi", "unit": "007"}),
        ("{model}/{unit}/*.mcap", "C:\\logs\\bmi\\007\\x.mcap", {"model": "bmi", "unit": "007"}),
        ("{unit}.(1).csv", "u.(1).csv", {"unit": "u"}),
        ("{model}/{unit}/*.mcap", "007/x.mcap", {}),
        ("{model}/{unit}/*.mcap", "bmi/007/x.mcap.part", {}),
        ("{unit}/*.csv", "u1/deep/x.csv", {"unit": "deep"}),
    ],
)
def test_a_pattern_is_matched_with_the_end_of_a_path(
    pattern: str, path: str, labels: dict[str, str | float]
) -> None:
    """A star and a label match within one folder name."""
    assert labels_in(path, pattern) == labels


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("*.mcap", "no label; write for example '{model}/{unit}/"),
        ("{unit}/{unit}", "'unit' is duplicated; give each label its own name"),
        ("{unit/*", "an unmatched brace; write for example"),
        ("{}/x", "'' is not a label name; write for example {unit}"),
        ("{path}/x", "'path' is not a label name"),
    ],
)
def test_invalid_patterns_are_rejected(pattern: str, message: str) -> None:
    """The error contains a valid example."""
    with pytest.raises(ArgumentError, match=r"^labels ") as caught:
        label_pattern(pattern)
    assert message in str(caught.value)
