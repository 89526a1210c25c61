"""Tests of the search for logs by names, folders and wildcards."""

from pathlib import Path

import pytest

from imucal.errors import ReadError
from imucal.fleet_run.logs import find_logs
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


def test_a_missing_log_is_kept() -> None:
    """Its reader reports the error, and the other logs are done."""
    assert find_logs(["gone/a.mcap"]) == ["gone/a.mcap"]


@pytest.mark.usefixtures("tree")
def test_an_existing_name_with_brackets_is_not_a_wildcard(tree: Path) -> None:
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
