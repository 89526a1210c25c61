"""Tests of `imucal.run_fleet`: the same store as the command, from scripts and notebooks."""

import html
import json
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import imucal
from imucal.errors import ReadError, WriteError
from imucal.fleet.files import write_fleet
from imucal.fleet.page import render_fleet_page
from imucal.fleet.plan import as_json
from imucal.fleet.store import read_store
from tests.cli.run import run
from tests.fleet.faults import rows_of
from tests.fleet.simulated_fleet import make_fleet

LABELS = "{model}/{unit}/{temperature_c}C/*.npz"
pytestmark = pytest.mark.usefixtures("logs_are_done_here", "pictures_are_blank")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with three logs, one of them garbage, and the fleet that the command wrote."""
    folder = tmp_path_factory.mktemp("call").resolve()
    make_fleet(folder / "logs", logs=3, seconds=20.0, seed=6, axes=1)
    (folder / "logs/alpha/u00/15C/log0000.npz").write_bytes(b"garbage")
    arguments = ("--labels", LABELS, "--shard", "1/1", "--max-failed", "50%", "-o", "typed")
    assert run("fleet", "run", "logs", *arguments, cwd=folder).returncode == 0
    return folder


def runs(store: str) -> dict[str, bytes]:
    """Return the files of results in a store of the working folder."""
    return {file.name: file.read_bytes() for file in Path(store).glob("run-*.fleet")}


@pytest.mark.slow
def test_the_function_and_the_command_write_the_same_fleet(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows and keys are equal, failed logs are in the fleet, and progress is reported."""
    monkeypatch.chdir(folder)
    reports: list[tuple[int, int]] = []

    def report(done: int, of: int) -> None:
        reports.append((done, of))

    fleet = imucal.run_fleet("logs", "called", labels=LABELS, shard=(1, 1), progress=report)
    assert reports[0] == (0, 3)
    assert reports[-1] == (3, 3)
    assert [log.path for logs in fleet.failures.values() for log in logs] == [
        "logs/alpha/u00/15C/log0000.npz"
    ]
    typed, called = read_store("typed"), read_store("called")
    assert rows_of(Path("called")) == rows_of(Path("typed"))
    assert (called.asked, called.settings) == (typed.asked, typed.settings)
    # Command and function find no work in each other's folder, and write nothing.
    files = runs("called"), runs("typed")
    again = run("fleet", "run", "-o", "called", "--shard", "1/1", "--max-failed", "50%", cwd=folder)
    assert again.stderr.startswith("0 logs to do, 0 kB; 3 already done\n")
    assert imucal.run_fleet(folder="typed", shard=(1, 1)).asked == 3
    assert (runs("called"), runs("typed")) == files


def test_reading_arguments_and_options_have_the_same_key(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are given as command options or as arguments of `imucal.read`."""
    monkeypatch.chdir(folder)
    log = "logs/beta/u00/15C/log0001.npz"
    options = ("--skip", "1s", "--gyro-unit", "deg/s", "--strict")
    assert run("fleet", "run", log, *options, "--shard", "1/1", "-o", "part", cwd=folder).returncode == 0
    files = runs("part")
    reading = {"strict": True, "skip_s": 1.0, "gyro_unit": "deg/s", "columns": None, "topic": ""}
    imucal.run_fleet([Path(log)], "part", shard=(1, 1), reading=reading)
    assert runs("part") == files


SCRIPT = """
import asyncio, imucal

async def cell():
    fleet = imucal.run_fleet("logs", "scripted", labels={labels!r}, jobs=1)
    print(fleet.asked, len(fleet.logs), __file__)

asyncio.run(cell())
"""


@pytest.mark.slow
def test_a_script_needs_no_main_guard(folder: Path) -> None:
    """Children do not run the script, so it prints its line once. As in a notebook, an event loop runs."""
    script = folder / "script.py"
    script.write_text(SCRIPT.format(labels=LABELS))
    done = subprocess.run(  # noqa: S603 - our own interpreter
        [sys.executable, str(script)], cwd=folder, capture_output=True, text=True, check=False, timeout=600
    )
    assert (done.stdout, done.stderr) == (f"3 3 {script}\n", "")
    assert rows_of(folder / "scripted") == rows_of(folder / "typed")


def test_a_zero_is_not_treated_as_missing() -> None:
    """A duration of 0 s must not select the full log; false and empty values are omitted."""
    empty = {"skip_s": 0.0, "strict": False, "topic": (), "columns": None, "time": ""}
    assert as_json({"take_s": 0.0, "rate_hz": 0, **empty}) == {"take_s": 0.0, "rate_hz": 0}


def test_an_empty_part_of_a_log_is_no_data(folder: Path) -> None:
    done = run("fleet", "run", "logs/beta", "--take", "0", "--shard", "1/1", "-o", "nought", cwd=folder)
    assert (done.returncode, "1 no-data" in done.stdout) == (4, True), (done.stdout, done.stderr)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"shard": (0, 4)}, ValueError, r"shard \(0, 4\), expected \(i, n\) with i from 1 to n"),
        ({"shard": (1, 2), "scheduler": "tcp://h:1"}, ValueError, "expected shard or scheduler, not both"),
        ({"reports": "some"}, ValueError, "reports 'some', expected one of none, failed, all"),
        ({"level": 95}, ValueError, "level 95, expected one between 0 and 1"),
        ({"jobs": 0}, ValueError, "jobs 0, expected a number from 1"),
        ({"memory": "much"}, ValueError, "memory 'much', expected a size such as 500M or 2G, 300M or more"),
        ({"memory": 0}, ValueError, "memory 0, expected a size such as 500M or 2G, 300M or more"),
        ({"memory": "20M"}, ValueError, "memory '20M', expected"),
        ({"timeout_s": 0}, ValueError, "timeout_s 0, expected seconds above 0"),
        ({"timeout_s": float("nan")}, ValueError, "timeout_s nan, expected seconds above 0"),
        ({"model": "Z"}, ValueError, "Z"),
        ({"model": "auto"}, ValueError, "auto"),
        ({"labels": "*.npz"}, ValueError, "no label; write for example"),
        ({"labels": ""}, ValueError, "no label; write for example"),
        ({"manifest": ""}, imucal.ImucalError, "expected a CSV table"),
        (
            {"labels": "{temperature_c}/*/*/*.npz"},
            imucal.ImucalError,
            "temperature_c is '.*', expected a number",
        ),
        ({"logs": "missing/*.bag"}, ReadError, "no log has this name"),
        ({"logs": None}, ReadError, "expected the folder of a fleet"),
        ({"logs": []}, ValueError, r"logs \[\], expected at least one; omit them to continue"),
        ({"logs": [], "folder": "typed"}, ValueError, "expected at least one; omit them"),
        (
            {"folder": "typed", "model": "N + K"},
            ValueError,
            r"/typed: contains fits with model N \+ B \+ K, found",
        ),
        ({"folder": "logs"}, WriteError, "no imucal fleet; nothing was changed"),
    ],
)
def test_mistakes_are_rejected(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: dict[str, Any],
    error: type[Exception],
    message: str,
) -> None:
    """The error contains the given and the expected value."""
    monkeypatch.chdir(folder)
    with pytest.raises(error, match=message):
        imucal.run_fleet(**{"logs": "logs", "folder": "slip", "shard": (1, 1), **arguments})
    assert not Path("slip").exists()


def test_a_fresh_run_repeats_everything(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder may contain a report, and the model may change."""
    monkeypatch.chdir(folder)
    logs = "logs/beta"
    first = imucal.run_fleet(logs, "anew", labels=LABELS, shard=(1, 1))
    write_fleet(first)
    again = imucal.run_fleet(logs, "anew", labels=LABELS, shard=(1, 1), fresh=True, model="N")
    assert (first.asked, again.asked) == (1, 1)
    assert read_store("anew").settings["model"] == "N"
    assert len(runs("anew")) == 1
    done = run("fleet", "run", logs, "-o", "anew", "--shard", "1/1", "--fresh", cwd=folder)
    assert (done.returncode, done.stderr.splitlines()[0].split(",")[0]) == (0, "1 log to do"), done.stderr
    assert read_store("anew").settings == {"model": "N + B + K", "level": 0.95}


def test_labels_may_be_given_later(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page contains the command to type; other labels of the logs are kept."""
    monkeypatch.chdir(folder)
    fleet = imucal.run_fleet("logs", "later", labels="{model}/*/*/*.npz", shard=(1, 1))
    assert len(fleet.loose) == 2
    page = render_fleet_page(fleet)
    typed = ("fleet", "run", "-o", "later", "--labels", fleet.labels)
    assert f"imucal {shlex.join(typed)}" in html.unescape(page)
    done = run(*typed, "--shard", "1/1", "--max-failed", "50%", cwd=folder)
    assert done.stderr.startswith("0 logs to do, 0 kB; 3 already done\n")
    labels = [log.labels for log in read_store("later").asked.values()]
    assert all(label["unit"] for label in labels)
    assert sorted(str(label["model"]) for label in labels) == ["alpha", "beta", "gamma"]
    # The run without work wrote the report again.
    models = json.loads((folder / "later" / "fleet.json").read_text())["models"]
    assert [len(model["units"]) for model in models] == [1, 1]
    # Two logs do not match the pattern and keep their labels.
    again = imucal.run_fleet(folder="later", labels="beta/{unit}/*/*.npz", shard=(1, 1))
    assert not again.loose
    unlike = run("fleet", "run", "-o", "later", "--labels", "beta/{unit}/*/*.npz", "--dry-run", cwd=folder)
    assert unlike.stderr.splitlines()[0].endswith(" of 3 logs do not match beta/{unit}/*/*.npz")
