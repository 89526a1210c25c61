"""What a fleet costs: ``python -m tests.benchmarks.bench_fleet [speed] [engine] [store]``.

speed: logs/s and MB/s a core of ``fleet run`` on one worker, and in one process, against a plain loop over
`imucal.characterize`; CPU of all processes, in turn, so that a busy machine is the same for all.
engine: memory of client, scheduler and worker, and CPU a task, at 1e5 tasks that do nothing.
store: time and memory of writing and reading 1e6 rows of results.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import psutil

from imucal.fleet.store import FleetStore
from imucal.fleet_run import dask_engine
from imucal.fleet_run.dask_cluster import Engine
from imucal.fleet_run.dask_engine import outcomes
from tests.fleet.simulated_fleet import make_fleet
from tests.fleet_run.faults import Bench, cluster

LOOP = """
import sys
import imucal
from imucal.fleet import log_values
for path in sys.argv[1:]:
    report = imucal.characterize(imucal.read(path), imucal.Settings(model="N + B + K", bins=True))
    for axis in report.axes:
        log_values("", axis.fit)
"""


def cpu_of_children() -> float:
    """Return the CPU time of all processes that this one started and that have ended, in s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def speed(folder: Path, *, logs: int, seconds: float, rounds: int) -> None:
    """Print logs/s and MB/s a core, of CPU time."""
    bench = Bench(folder, jobs=1)
    made = make_fleet(folder / "logs", logs=logs, seconds=seconds, seed=3)
    paths = [str(log.path) for log in made]
    size = sum(os.path.getsize(path) for path in paths)  # noqa: PTH202
    environment = {**os.environ, "IMUCAL_THREADS": "1"}

    def loop(_: int) -> None:
        subprocess.run([sys.executable, "-c", LOOP, *paths], check=True, env=environment)  # noqa: S603

    def fleet(option: str, value: str, number: int) -> None:
        assert bench.run(f"store{number}{option}", option, value).code == 0

    cases = {
        "plain loop": loop,
        "fleet run --shard 1/1": partial(fleet, "--shard", "1/1"),
        "fleet run --jobs 1": partial(fleet, "--jobs", "1"),
    }
    best = dict.fromkeys(cases, float("inf"))
    for number in range(rounds):
        for name, case in cases.items():
            before = cpu_of_children()
            case(number)  # type: ignore[operator]
            best[name] = min(best[name], cpu_of_children() - before)
    for name, cpu in best.items():
        over = 100 * (cpu / best["plain loop"] - 1)
        print(
            f"{name:24} {logs / cpu:6.3f} logs/s  {size / cpu / 1e6:6.2f} MB/s a core, "
            f"{cpu / logs:6.2f} s a log, {over:+5.1f} % CPU",
            flush=True,
        )


def nothing(_: int) -> int:
    """Do nothing, as the work of a task."""
    return 0


def engine(folder: Path, *, tasks: int) -> None:
    """Print memory and CPU of many tasks that do nothing, on a scheduler of its own."""
    # More in hand than for real work, so that the time is that of the tasks and not of waiting for each.
    dask_engine.WINDOW = 300
    with cluster(folder, workers=1) as (address, scheduler):
        numbers = iter(range(1, tasks + 1))
        client = psutil.Process()
        server = psutil.Process(scheduler.pid)
        done, worker = 0, None
        begun = time.perf_counter()
        marks = {1000, tasks // 10, tasks // 5, tasks}
        asked = Engine(address=address, memory=1 << 30)
        take = partial(next, numbers, None)
        for done, _ in enumerate(outcomes(take, nothing, engine=asked, patience=lambda _: 1e9), 1):
            if done in marks:
                worker = worker or _worker()
                used = {"client": client, "scheduler": server, "worker": worker}
                memory = ", ".join(f"{n} {p.memory_info().rss / 1e6:.0f} MB" for n, p in used.items())
                cpu = ", ".join(f"{n} {1e3 * sum(p.cpu_times()[:2]) / done:.2f}" for n, p in used.items())
                wall = time.perf_counter() - begun
                print(f"{done:7} tasks, {wall:6.1f} s: {memory}; CPU ms a task: {cpu}", flush=True)
        assert done == tasks


def _worker() -> psutil.Process:
    """Return the process that does the tasks: the child of the nanny."""
    return next(
        p
        for p in psutil.Process().children(recursive=True)
        if "multiprocessing" in " ".join(p.cmdline()) and "resource_tracker" not in " ".join(p.cmdline())
    )


def store(folder: Path, *, logs: int = 60_000, batch: int = 20) -> None:
    """Print what a store of 18 rows of results a log costs, with bins of 3 kB an axis."""
    made = FleetStore(folder / "many")
    made.create()
    axes = [(sensor, axis) for sensor in ("gyroscope", "accelerometer") for axis in "xyz"]
    begun = time.perf_counter()
    for first in range(0, logs, batch):
        keys = [f"{number:032x}" for number in range(first, first + batch)]
        of_log = {"status": "ok", "verdict": "good", "findings": [], "finished": 1.0, "content": "c"}
        made.commit(
            [{"key": key, "path": f"logs/{key}.mcap", **of_log} for key in keys],
            [
                {"key": key, "sensor": sensor, "axis": axis, "term": term, "value": 1e-4, "high": 2e-4}
                for key in keys
                for sensor, axis in axes
                for term in "NBK"
            ],
            [
                {"key": key, "sensor": sensor, "axis": axis, "bins": os.urandom(3000)}
                for key in keys
                for sensor, axis in axes
            ],
        )
    wrote = time.perf_counter() - begun
    size = sum(path.stat().st_size for path in made.folder.rglob("*.parquet"))
    print(f"{logs} logs in {logs // batch} parts: written in {wrote:.1f} s, {size / 1e6:.0f} MB", flush=True)
    for name, read in (("logs", made.logs), ("results", made.results), ("bins", made.bins)):
        begun = time.perf_counter()
        rows = read().height
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        seconds = time.perf_counter() - begun
        print(f"{name}: {rows} rows in {seconds:.2f} s; highest memory so far {peak:.0f} MB", flush=True)


def main() -> None:
    """Run what is asked for, or everything."""
    parser = argparse.ArgumentParser()
    parser.add_argument("what", nargs="*", choices=["speed", "engine", "store", []])
    parser.add_argument("--tasks", type=int, default=100_000)
    parser.add_argument("--logs", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--rounds", type=int, default=2)
    given = parser.parse_args()
    for what in given.what or ["speed", "engine", "store"]:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name).resolve()
            if what == "speed":
                speed(folder, logs=given.logs, seconds=given.seconds, rounds=given.rounds)
            elif what == "engine":
                engine(folder, tasks=given.tasks)
            else:
                store(folder)


if __name__ == "__main__":
    main()
