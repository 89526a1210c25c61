"""Tests of the work on a log: its row and report, the environment of its process, and failures to start."""

import errno
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucal.child_process import ChildProcess
from imucal.errors import WriteError
from imucal.fleet import running
from imucal.fleet.engines import child_process, on_this_machine, row_of
from imucal.fleet.identity import identity_of
from imucal.fleet.logs import LogTask
from imucal.fleet.plan import FleetPlan, FleetSettings
from imucal.fleet.store import RunFile, read_store
from imucal.fleet.work import first_row, work_on
from imucal.resources import POOLS, THREADS

#: Samples of the logs: enough for a fit, which takes a tenth of a second.
SAMPLES = 2000


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FleetSettings:
    """Return the settings of a store in an empty working folder."""
    monkeypatch.chdir(tmp_path)
    return FleetSettings(store=str(tmp_path / "fleet"), folder=str(tmp_path), memory=(4 << 30) + 4)


def write_log(name: str, *, samples: int = SAMPLES, moved: bool = False) -> LogTask:
    """Write a log of one axis at 100 Hz, whose sensor somebody may have moved."""
    rate = 1e-3 * np.random.default_rng(1).standard_normal(samples)
    if moved:
        rate[700:1000] += np.sin(np.arange(300) / 30)
    stamps = 1_767_225_600 + np.arange(samples) / 100
    np.savez(name, **{"time (s)": stamps, "gx (rad/s)": rate})  # type: ignore[arg-type] # its last argument is a flag
    return LogTask(place=name, labels={"unit": "u1", "bench": "3"}, size=1)


def test_a_log_has_a_row_with_its_terms(settings: FleetSettings) -> None:
    """Labels without a meaning are not in the row; the time of the first sample is."""
    task = write_log("log.npz")
    row = work_on(task, settings)
    assert set(row) == set(first_row(task, settings))
    identity = identity_of("log.npz")
    assert identity is not None
    expected = {"identity": identity.digest, "bytes": identity.size, "key": settings.key(identity.digest, {})}
    expected |= {"path": "log.npz", "unit": "u1", "model": None, "started": "2026-01-01T00:00:00+00:00"}
    expected |= {
        "status": "ok",
        "verdict": "good",
        "reason": "",
        "code": "",
        "report": "",
        "samples": SAMPLES,
    }
    assert {name: row[name] for name in expected} == expected
    assert (row["rate_hz"], row["seconds"]) == pytest.approx((100.0, SAMPLES / 100))
    terms = [(term["sensor"], term["axis"], term["term"]) for term in row["terms"]]
    assert terms == [("gyroscope", "x", term) for term in "NBK"]
    density = row["terms"][0]
    assert density["unit_si"] == "rad/s/sqrt(Hz)"
    assert density["low"] < 1e-4 < density["high"]
    assert density["low"] < density["value"] < density["high"]


@pytest.mark.parametrize(
    ("data", "status", "reason"),
    [
        (b"garbage", "unreadable", "found no rows of numbers; the first line is 'garbage'"),
        (b"", "unreadable", "the file is empty; expected a log"),
        (None, "unreadable", "can't be opened: No such file or directory"),
        (20, "no-data", "no axis can be analysed: gyro_x: 20 samples, expected at least 64"),
    ],
)
def test_a_failed_log_has_a_reason(
    settings: FleetSettings, data: bytes | int | None, status: str, reason: str
) -> None:
    """It does not begin with the path, which is in the row."""
    task = LogTask(place="log.npz")
    if isinstance(data, int):
        write_log("log.npz", samples=data)
    elif data is not None:
        Path("log.npz").write_bytes(data)
    row = work_on(task, settings)
    assert row["reason"].startswith(reason)
    assert (row["status"], row["terms"], row["report"]) == (status, [], "")
    assert bool(row["identity"]) is (data is not None)
    assert set(row) == set(first_row(task, settings))


@pytest.mark.usefixtures("pictures_are_blank")
@pytest.mark.parametrize(
    ("reports", "kept"), [("none", []), ("failed", ["moved.npz"]), ("all", ["moved.npz", "still.npz"])]
)
def test_a_failed_log_has_a_report_of_its_own(settings: FleetSettings, reports: str, kept: list[str]) -> None:
    """The client writes the files, which are not in the row of the store."""
    tasks = write_log("moved.npz", moved=True), write_log("still.npz")
    rows = [work_on(task, replace(settings, reports=reports)) for task in tasks]
    assert [(row["status"], row["verdict"]) for row in rows] == [("ok", "not-noise"), ("ok", "good")]
    folder = Path(settings.store)
    with RunFile(folder, settings.of_fits) as file:
        for row in rows:
            file.add(row)
    stored = read_store(folder).rows
    assert [row["path"] for row in stored if row["report"]] == kept
    assert not any("files" in row for row in stored)
    expected = {f"reports/{row['key']}/report.{kind}" for row in rows for kind in ("json", "html")}
    written = {str(path.relative_to(folder)) for path in folder.rglob("report.*")}
    assert written == {path for path in expected for row in stored if row["report"] and row["report"] in path}


@pytest.mark.usefixtures("pictures_are_blank")
def test_a_report_that_cannot_be_written_is_an_error(settings: FleetSettings) -> None:
    """The run exits with 5, and the log does not count as done."""
    row = work_on(write_log("moved.npz", moved=True), settings)
    with RunFile(Path(settings.store), settings.of_fits) as file:
        (Path(settings.store) / "reports").write_text("no folder")
        with pytest.raises(WriteError, match=r"can't be written: Not a directory") as error:
            file.add(row)
    assert error.value.exit_code == 5
    assert read_store(settings.store).rows == ()


def test_the_work_on_a_log_has_one_thread_and_the_default_allocator(
    settings: FleetSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask makes its workers return memory at once, which would take 50 % more time per log."""
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "65536")
    monkeypatch.setenv("IMUCAL_FLEET_TEST", "stays")
    child = child_process(settings)
    names = ("MALLOC_TRIM_THRESHOLD_", "IMUCAL_FLEET_TEST", "IMUCAL_MEMORY", THREADS, *POOLS)
    found = [child.ask(os.getenv, name, seconds=60, memory=4 << 30).value for name in names]
    assert child.ask(os.getcwd, seconds=60, memory=4 << 30).value == settings.folder
    child.end()
    assert found == [None, "stays", str((1 << 30) + 1), *["1"] * (1 + len(POOLS))]


def test_a_process_that_cannot_start_only_fails_its_log(
    settings: FleetSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The log contains the reason, the run continues, and the next run repeats the log."""

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    monkeypatch.setattr(ChildProcess, "ask", full)
    row = row_of(LogTask(place="a.mcap"), settings, child_process(settings))
    start = "its process can't be started (Resource temporarily unavailable), as on an overloaded machine"
    assert (row["status"], row["reason"]) == ("crash", f"{start}; run again when it is less loaded")


@pytest.mark.usefixtures("logs_are_done_here")
def test_an_internal_error_only_fails_its_log(
    settings: FleetSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its type and text are in the row."""

    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("bug")

    monkeypatch.setattr("imucal.fleet.work.characterize", broken)
    ((task, row),) = on_this_machine([write_log("log.npz")], settings)
    assert (task.path, row["status"]) == ("log.npz", "crash")
    assert row["reason"] == "internal error (ZeroDivisionError: bug); please report it"


def test_a_run_reports_the_logs_in_progress(settings: FleetSettings, monkeypatch: pytest.MonkeyPatch) -> None:
    """A log is reported when it starts and when it is done."""
    monkeypatch.setattr("imucal.fleet.engines.row_of", lambda task, how, _: first_row(task, how, status="ok"))
    plan = FleetPlan(logs=tuple(LogTask(place=f"{i}.mcap", size=10) for i in range(3)))
    seen: list[tuple[int, int, int]] = []
    count = running.run_plan(
        plan, settings, progress=lambda count: seen.append((count.done, count.running, count.done_size))
    )
    assert seen == [(0, 0, 0), (0, 1, 0), (1, 0, 10), (1, 1, 10), (2, 0, 20), (2, 1, 20), (3, 0, 30)]
    assert (count.logs, count.size, count.failed) == (3, 30, 0)
    assert [row["path"] for row in read_store(settings.store).logs()] == ["0.mcap", "1.mcap", "2.mcap"]
