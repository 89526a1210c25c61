"""The process that does a log: what it is given of its worker's environment."""

import os

import pytest

from imucal.fleet_run.batch_work import _child
from imucal.fleet_run.log_tasks import FleetSettings
from imucal.resources import POOLS, THREADS


def test_a_log_has_one_thread_and_the_usual_allocator(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dask has its workers give back memory at once, which would cost a log half more time."""
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "65536")
    monkeypatch.setenv("IMUCAL_FLEET_TEST", "stays")
    # A size of its own, so that the process is none that another test has left.
    child = _child(FleetSettings(store="s", folder="f", memory=(4 << 30) + 4))
    found = {
        name: child.ask(os.getenv, name, seconds=60, memory=4 << 30).value
        for name in ("MALLOC_TRIM_THRESHOLD_", "IMUCAL_FLEET_TEST", "IMUCAL_MEMORY", THREADS, *POOLS)
    }
    child.end()
    assert found.pop("MALLOC_TRIM_THRESHOLD_") is None
    assert found.pop("IMUCAL_FLEET_TEST") == "stays"
    assert found.pop("IMUCAL_MEMORY") == str((1 << 30) + 1)
    assert set(found.values()) == {"1"}
