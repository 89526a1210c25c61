"""What a fleet costs: ``python -m tests.benchmarks.bench_fleet [speed] [engine] [store]``.

speed: CPU a log of ``fleet run`` on one worker, and in one process, against a plain loop over
`imucal.characterize`, and what a run costs besides, by two numbers of logs; CPU of all processes, in turn, so
that a busy machine is the same for all.
engine: memory of client, scheduler and worker, and CPU a task, at 1e5 tasks that do nothing.
store: time and memory of writing and reading 1e6 rows of results.
"""

import argparse
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from itertools import chain, repeat
from pathlib import Path

import psutil

from imucal.fleet.store import FleetStore
from imucal.fleet_run import dask_engine
from imucal.fleet_run.dask_cluster import Engine
from imucal.fleet_run.dask_engine import outcomes
from tests.fleet.simulated_fleet import RATE, make_fleet
from tests.fleet_run.faults import Bench, cluster

#: How the same logs are done, in turn: options of ``fleet run``, or none for a plain loop.
CASES = {
    "plain loop": (),
    "fleet run --shard 1/1": ("--shard", "1/1"),
    "fleet run --jobs 1": ("--jobs", "1"),
}
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


def speed(folder: Path, *, logs: tuple[int, int], seconds: float, rounds: int) -> None:
    """Print CPU a log and a run, of two numbers of logs: the lowest of some rounds of each."""
    bench = Bench(folder, jobs=1)
    few, many = logs
    environment = {**os.environ, "IMUCAL_THREADS": "1"}
    paths = {number: _made(folder, number, seconds) for number in logs}
    size = os.path.getsize(paths[few][0])  # noqa: PTH202
    best: dict[str, dict[int, float]] = {}
    for turn in range(rounds):
        for number in logs:
            for name, option in CASES.items():
                before = cpu_of_children()
                if option:
                    store = f"store{turn}-{number}-{option[0]}"
                    assert bench.run(store, *option, logs=f"logs{number}").code == 0
                    inside = bench.store(store).logs()["cpu_s"].sum()
                else:
                    command = [sys.executable, "-c", LOOP, *paths[number]]
                    subprocess.run(command, check=True, env=environment)  # noqa: S603
                    inside = 0.0
                used = cpu_of_children() - before
                # All processes were waited for, so that theirs is in it.
                assert used > inside, (used, inside)
                known = best.setdefault(name, {})
                known[number] = min(known.get(number, math.inf), used)
                print(f"  round {turn} {name:22} {number} logs: {used:7.2f} s", flush=True)
    each = {name: (known[many] - known[few]) / (many - few) for name, known in best.items()}
    print(f"logs of {size / 1e6:.0f} MB, {seconds / 3600:g} h at {RATE:g} Hz, six axes; s of CPU:")
    print("                        a log   over   MB/s  a run besides")
    for name, cpu in each.items():
        over, start = 100 * (cpu / each["plain loop"] - 1), best[name][few] - few * cpu
        print(f"{name:22} {cpu:6.2f} {over:+5.1f} % {size / cpu / 1e6:6.1f} {start:6.1f}", flush=True)


def _made(folder: Path, number: int, seconds: float) -> list[str]:
    """Make logs that are all right, each of other samples."""
    made = make_fleet(folder / f"logs{number}", logs=number, seconds=seconds, seed=3)
    assert not any(log.broken for log in made)
    return [str(log.path) for log in made]


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
        take = chain(numbers, repeat(None)).__next__
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
    parser.add_argument("--logs", type=int, nargs=2, default=(1, 6), help="speed: two numbers of logs")
    parser.add_argument("--seconds", type=float, default=40_000.0, help="speed: length of each log")
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    for what in given.what or ["speed", "engine", "store"]:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name).resolve()
            if what == "speed":
                speed(folder, logs=tuple(given.logs), seconds=given.seconds, rounds=given.rounds)
            elif what == "engine":
                engine(folder, tasks=given.tasks)
            else:
                store(folder)


if __name__ == "__main__":
    main()
