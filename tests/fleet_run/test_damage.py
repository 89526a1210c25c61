"""Tests of stores with a damaged file: exit code 5 with its name, and repair by the next run."""

import shutil
from pathlib import Path

import pytest

from imucal.fleet.store import FleetStore
from tests.cli.run import run
from tests.fleet.simulated_fleet import make_fleet
from tests.fleet_run.damage import damages
from tests.fleet_run.done_here import logs_done_here
from tests.fleet_run.faults import OF_THE_RUN
from tests.report.blank import blank_pictures

LABELS = ("--labels", "{model}/{unit}/{temperature_c}C/*.npz")
pytestmark = pytest.mark.usefixtures("logs_are_done_here", "pictures_are_blank")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with three logs of one axis and their fleet, one log per batch."""
    place = tmp_path_factory.mktemp("damage").resolve()
    for log in make_fleet(place / "logs", logs=3, seconds=10.0, seed=83, axes=1):
        with blank_pictures(), logs_done_here():
            done = run("fleet", "run", str(log.path.relative_to(place)), *LABELS, "--jobs", "1", cwd=place)
        assert done.returncode == 0, done.stderr
    return place


def test_all_damage_is_reported(place: Path, tmp_path: Path) -> None:
    """Any bit of any file may change; `python -m tests.benchmarks.fleet_flips` tests 300 changes."""
    found = list(damages(place / "fleet", tmp_path, number=36, seed=8401))
    assert not [damage for damage in found if damage.silent]
    assert len({Path(damage.file).parts[0] for damage in found}) == 6


@pytest.mark.parametrize("table", ["logs", "results", "bins", "derived"])
def test_damaged_parts_are_repaired_by_the_next_run(place: Path, tmp_path: Path, table: str) -> None:
    """The same command repairs them, and other parts do not change."""
    shutil.copytree(place, tmp_path / "copy")
    store, whole = FleetStore(tmp_path / "copy" / "fleet"), FleetStore(place / "fleet")
    part = min((store.folder / table).iterdir())
    data = bytearray(part.read_bytes())
    data[len(data) // 2] ^= 4
    part.write_bytes(data)
    refused = run("fleet", "report", "fleet", cwd=tmp_path / "copy")
    assert refused.returncode == 5
    message = f"Error: fleet/{table}/{part.name}: is damaged; run the fleet again"
    assert message in refused.stderr
    done = run("fleet", "run", "-o", "fleet", "--jobs", "1", cwd=tmp_path / "copy")
    assert done.returncode == 0, done.stderr
    assert f"{part}: is damaged; its logs are repeated" in done.stderr
    assert f"{1 if table != 'derived' else 0} log" in done.stderr
    assert store.damaged() == {}
    assert store.results().equals(whole.results())
    assert store.bins().equals(whole.bins())
    assert store.logs().drop(OF_THE_RUN).equals(whole.logs().drop(OF_THE_RUN))
    assert run("fleet", "report", "fleet", "--no-pictures", cwd=tmp_path / "copy").returncode == 0


def test_a_damaged_manifest_is_recreated_from_the_logs(place: Path, tmp_path: Path) -> None:
    """The advice in the error works, and no log is repeated."""
    shutil.copytree(place, tmp_path / "copy")
    manifest = tmp_path / "copy" / "fleet" / "manifest.parquet"
    manifest.write_bytes(manifest.read_bytes()[:-3])
    refused = run("fleet", "run", "-o", "fleet", cwd=tmp_path / "copy")
    assert refused.returncode == 5
    assert "manifest.parquet: is damaged; remove it and give the logs again" in (
        " ".join(refused.stderr.split())
    )
    manifest.unlink()
    done = run("fleet", "run", "logs", *LABELS, cwd=tmp_path / "copy")
    assert done.returncode == 0, done.stderr
    assert done.stderr.startswith("0 logs to do, 0 kB; 3 already done\n")


def test_damaged_settings_are_rejected(place: Path, tmp_path: Path) -> None:
    """A guessed model might differ from the finished logs' model; a fresh run works."""
    shutil.copytree(place, tmp_path / "copy")
    settings = tmp_path / "copy" / "fleet" / "settings.json"
    settings.write_text(settings.read_text(encoding="utf-8").replace("N + B", "N + K"), encoding="utf-8")
    refused = run("fleet", "run", "-o", "fleet", cwd=tmp_path / "copy")
    assert refused.returncode == 5
    assert "settings.json: is damaged; start the fleet again with --fresh" in (
        " ".join(refused.stderr.split())
    )
    done = run("fleet", "run", "logs", *LABELS, "--fresh", "--jobs", "1", cwd=tmp_path / "copy")
    assert done.returncode == 0, done.stderr
