"""Tests of commands with a damaged store: exit code 5 with its file, and repair by the next run."""

import shutil
from pathlib import Path

import pytest

from imucal.fleet.store import read_store
from tests.cli.run import run
from tests.fleet.damage import COMMANDS, damages
from tests.fleet.done_here import logs_done_here
from tests.fleet.faults import rows_of
from tests.fleet.simulated_fleet import make_fleet
from tests.report.blank import blank_pictures

LABELS = ("--labels", "{model}/{unit}/{temperature_c}C/*.npz", "--jobs", "1")
pytestmark = pytest.mark.usefixtures("logs_are_done_here", "pictures_are_blank")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with two logs of one axis and their fleet, one log per run."""
    place = tmp_path_factory.mktemp("damage").resolve()
    for log in make_fleet(place / "logs", logs=2, seconds=10.0, seed=83, axes=1):
        with blank_pictures(), logs_done_here():
            done = run("fleet", "run", str(log.path.relative_to(place)), *LABELS, cwd=place)
        assert done.returncode == 0, done.stderr
    return place


def test_all_damage_is_reported(place: Path, tmp_path: Path) -> None:
    """Any byte may change; `python -m tests.benchmarks.fleet_flips` tests 300 changes."""
    found = list(damages(place / "fleet", tmp_path, number=24, seed=8401))
    assert not [damage for damage in found if damage.silent]
    assert len({damage.command for damage in found}) == len(COMMANDS)


@pytest.mark.parametrize(
    ("line", "old", "new"),
    [(1, b"alpha", b"Alpha"), (2, b"alpha", b"Alpha"), (2, b"}\n", b"")],
    ids=["names of logs", "results", "torn results"],
)
def test_damage_is_repaired_by_the_next_run(
    place: Path, tmp_path: Path, line: int, old: bytes, new: bytes
) -> None:
    """A run without names repeats the log of a damaged line; lost names are given again."""
    copy = tmp_path / "copy"
    shutil.copytree(place, copy)
    file = min((copy / "fleet").glob("run-*.fleet"))
    lines = file.read_bytes().splitlines(keepends=True)
    lines[line - 1] = lines[line - 1].replace(old, new)
    file.write_bytes(b"".join(lines))
    refused = run("fleet", "report", "fleet", cwd=copy)
    assert refused.returncode == 5
    assert f"{file.name}:{line}: is damaged, and does not count; run the fleet again" in refused.stderr
    again = run("fleet", "run", "-o", "fleet", "--jobs", "1", cwd=copy)
    if line == 1:
        assert again.returncode == 5
        assert f"{file.name}:1: is damaged, and contained names of logs; give the logs again" in again.stderr
        again = run("fleet", "run", "logs", *LABELS, cwd=copy)
    assert again.returncode == 0, again.stderr
    assert f"{file.name}:{line}: is damaged; its logs are repeated" in again.stderr
    assert f"{('0 logs', '1 log')[line - 1]} to do" in again.stderr
    assert rows_of(copy / "fleet") == rows_of(place / "fleet")
    assert read_store(copy / "fleet").asked == read_store(place / "fleet").asked
    assert run("fleet", "report", "fleet", "--no-pictures", cwd=copy).returncode == 0
