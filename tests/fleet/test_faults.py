"""Tests of faults of a fleet with real processes; ``tests/benchmarks/fleet_faults.py`` has the slow ones."""

import os
from collections.abc import Callable
from functools import partial

import pytest

from tests.fleet.fault_scenarios import HERE, QUICK
from tests.fleet.faults import Bench
from tests.fleet.simulated_fleet import make_fleet


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """Return a folder with a few logs and the store of an undisturbed run."""
    bench = Bench(tmp_path_factory.mktemp("faults").resolve())
    make_fleet(bench.folder / "logs", logs=3, seconds=10.0, seed=8, axes=1)
    # The last log takes longer than the others together, so that the run continues after the first.
    (slow,) = make_fleet(bench.folder / "slow", logs=1, seconds=10.0, seed=9)
    slow.path.rename(bench.folder / "logs" / "zeta.npz")
    assert bench.run("whole", *HERE, limit=partial(os.umask, 0o022)).code == 0
    return bench


@pytest.mark.slow
@pytest.mark.parametrize("fault", QUICK, ids=lambda fault: fault.__name__)
def test_a_fault_loses_no_log_and_changes_no_result(bench: Bench, fault: Callable[[Bench], str]) -> None:
    """The exit code is right, no log is repeated, and the results equal those of an undisturbed run."""
    try:
        summary = fault(bench)
    finally:
        bench.end_runs()
    assert summary.endswith(("same results", "all others done", "refused"))
