"""Faults of a fleet with real processes; ``tests/benchmarks/fleet_faults.py`` has the slow ones."""

import os
from collections.abc import Callable
from functools import partial

import pytest

from tests.fleet.simulated_fleet import make_fleet
from tests.fleet_run.fault_scenarios import HERE, QUICK
from tests.fleet_run.faults import Bench


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """Return a folder with a few logs, and the store that an undisturbed run made of them."""
    bench = Bench(tmp_path_factory.mktemp("faults").resolve())
    make_fleet(bench.folder / "logs", logs=3, seconds=10.0, seed=8, axes=1)
    # The last one takes longer than the others together, so that a run lasts when the first is done.
    (slow,) = make_fleet(bench.folder / "slow", logs=1, seconds=10.0, seed=9)
    slow.path.rename(bench.folder / "logs" / "zeta.npz")
    assert bench.run("whole", *HERE, limit=partial(os.umask, 0o022)).code == 0
    return bench


@pytest.mark.slow
@pytest.mark.parametrize("fault", QUICK, ids=lambda fault: fault.__name__)
def test_a_fault_costs_nothing_but_time(bench: Bench, fault: Callable[[Bench], str]) -> None:
    """Nothing lost, nothing twice, the right exit code, and the results of an undisturbed run."""
    said = fault(bench)
    assert any(end in said for end in ("same results", "all others done", "timeout"))
