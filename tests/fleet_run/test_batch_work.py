"""Tests of the process that works on a log: its environment, failures to start, and progress."""

import errno
import os
from pathlib import Path

import pytest

from imucal.errors import WriteError
from imucal.fleet.store import FleetStore
from imucal.fleet_run import running
from imucal.fleet_run.log_work import child_process, work_on_batch
from imucal.fleet_run.plan import FleetPlan, FleetSettings, LogTask
from imucal.processes import ChildProcess
from imucal.resources import POOLS, THREADS
from tests.fleet.simulated_fleet import make_fleet


def test_the_work_on_a_log_has_one_thread_and_the_default_allocator(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dask makes its workers return memory at once, which would take 50 % more time per log."""
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "65536")
    monkeypatch.setenv("IMUCAL_FLEET_TEST", "stays")
    child = child_process(FleetSettings(store="s", folder="f", memory=(4 << 30) + 4))
    found = {
        name: child.ask(os.getenv, name, seconds=60, memory=4 << 30).value
        for name in ("MALLOC_TRIM_THRESHOLD_", "IMUCAL_FLEET_TEST", "IMUCAL_MEMORY", THREADS, *POOLS)
    }
    child.end()
    assert found.pop("MALLOC_TRIM_THRESHOLD_") is None
    assert found.pop("IMUCAL_FLEET_TEST") == "stays"
    assert found.pop("IMUCAL_MEMORY") == str((1 << 30) + 1)
    assert set(found.values()) == {"1"}


def test_a_process_that_cannot_start_only_fails_its_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The log contains the reason, the run and the worker continue, and the next run repeats the log."""

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    monkeypatch.setattr(ChildProcess, "ask", full)
    FleetStore(tmp_path / "store").create()
    settings = FleetSettings(store=str(tmp_path / "store"), folder=str(tmp_path), memory=4 << 30)
    assert work_on_batch(settings, [LogTask(place="a.mcap")], child_process(settings)) == 1
    (done,) = FleetStore(tmp_path / "store").logs().rows(named=True)
    assert done["status"] == "crash"
    assert done["reason"] == (
        "its process can't be started (Resource temporarily unavailable), as on an overloaded "
        "machine; run again when it is less loaded"
    )


def test_a_report_that_cannot_be_written_ends_the_run(tmp_path: Path) -> None:
    """On a full disk, the run exits with 5 and the log does not count as done."""
    (log,) = make_fleet(tmp_path / "logs", logs=1, seconds=10.0, seed=83, axes=1)
    store = FleetStore(tmp_path / "store")
    store.create()
    (store.folder / "reports").write_text("no folder")
    settings = FleetSettings(store=str(store.folder), folder=str(tmp_path), memory=4 << 30, reports="all")
    child = child_process(settings)
    with pytest.raises(WriteError, match=r"the report .*: File exists") as error:
        work_on_batch(settings, [LogTask(place=str(log.path))], child)
    child.end()
    assert error.value.exit_code == 5
    assert store.logs().is_empty()


def test_a_run_reports_the_logs_in_progress(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A long batch is reported when it starts and when it is done."""
    monkeypatch.setattr(running, "OWN_BATCH_S", 0.0)
    monkeypatch.setattr(running, "work_on_batch", lambda _, __, ___: 0)
    tasks = tuple(LogTask(place=f"{i}.mcap", size=1) for i in range(3))
    plan = FleetPlan(logs=tasks)
    seen: list[tuple[int, int]] = []
    settings = FleetSettings(store=str(tmp_path), folder=str(tmp_path), memory=4 << 30)
    running.run_plan(plan, settings, progress=lambda count: seen.append((count.done, count.running)))
    assert seen == [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1), (3, 0)]
