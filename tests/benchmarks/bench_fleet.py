"""Cost of a fleet: ``python -m tests.benchmarks.bench_fleet [speed] [engine] [store]``.

speed: CPU per log of ``fleet run`` on one worker and in one process, compared with a simple loop over
`imucal.characterize`, and the overhead of a run, from two numbers of logs. CPU time is that of all
processes, and the cases alternate, so that a busy machine affects all of them.

engine: memory of client, scheduler and worker, and CPU per log, for 1e5 logs without work: in batches
like real runs, and in tasks of one log.

store: time and memory of writing and reading 1e6 rows of results and more, in parts like real runs.
"""

import argparse
import math
import multiprocessing
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from unittest.mock import patch

import numpy as np
import psutil

from imucal.fleet.store import FleetStore
from imucal.fleet_run import on_dask, running
from imucal.fleet_run.plan import FleetPlan, FleetSettings, LogTask
from imucal.fleet_run.running import BATCH_S, RunCount, run_plan
from tests.fleet.simulated_fleet import RATE, make_fleet
from tests.fleet_run.faults import Bench, cluster

#: Alternating cases: options of ``fleet run``, or none for a simple loop.
CASES = {
    "plain loop": (),
    "fleet run --shard 1/1": ("--shard", "1/1"),
    "fleet run --jobs 2": ("--jobs", "2"),
}
#: Ways to read a store: the last two read 5000 logs at a time.
READINGS = ("logs", "results", "bins", "bins of strewn logs", "all bins at once")
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
    """Return the CPU time of all ended child processes, in s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def speed(folder: Path, *, logs: tuple[int, int], seconds: float, rounds: int) -> None:
    """Print CPU per log and per run for two numbers of logs: the lowest of some rounds."""
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
                # All processes were waited for, so their CPU time is included.
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
    """Return logs without faults and with different samples."""
    made = make_fleet(folder / f"logs{number}", logs=number, seconds=seconds, seed=3)
    assert not any(log.broken for log in made)
    return [str(log.path) for log in made]


def nothing(_: object, __: FleetSettings, ___: Sequence[LogTask]) -> int:
    """Do nothing, like the work on a batch without failed logs."""
    return 0


def engine(folder: Path, *, logs: int, seconds: float) -> None:
    """Print memory and CPU of a run of logs without work, in batches of `seconds` expected duration.

    It is the real `imucal.fleet_run.running.run_plan`, on a scheduler in its own process; only the work of a
    task is replaced. More batches are submitted than for real work, so that the time is that of the tasks.
    """
    on_dask.WINDOW, running.BATCH_S = 100, seconds
    tasks = tuple(LogTask(place=f"logs/{number:07}.mcap", size=10_000) for number in range(logs))
    plan = FleetPlan(logs=tasks)
    marks = iter(sorted({1000, 2000, 5000, *(logs * part // 100 for part in (10, 20, 40, 60, 80, 100))}))
    with (
        patch.object(running, "_on_worker", nothing),
        cluster(folder, workers=1) as (address, scheduler),
    ):
        settings = FleetSettings(
            store=str(folder / "store"), folder=str(folder), memory=1 << 30, scheduler=address
        )
        processes = {"client": psutil.Process(), "scheduler": psutil.Process(scheduler.pid)}
        begun, before = time.perf_counter(), sum(processes["client"].cpu_times()[:2])
        mark = next(marks)
        print(f"{logs} logs, {seconds:g} s a batch; resident memory in MB, CPU in ms a log:", flush=True)

        def tell(count: RunCount) -> None:
            nonlocal mark
            if count.done < mark:
                return
            mark = next((one for one in marks if one > count.done), logs + 1)
            processes.setdefault("worker", _worker())
            used = {name: sum(process.cpu_times()[:2]) for name, process in processes.items()}
            used["client"] -= before
            memory = {name: process.memory_info().rss / 1e6 for name, process in processes.items()}
            figures = ", ".join(f"{n} {memory[n]:.1f} MB {1e3 * used[n] / count.done:.3f} ms" for n in used)
            print(f"{count.done:7} logs, {time.perf_counter() - begun:6.1f} s: {figures}", flush=True)

        done = run_plan(plan, settings, progress=tell)
        assert (done.done, done.failed) == (logs, 0)


def _worker() -> psutil.Process:
    """Return the process that executes the tasks: the child of the nanny."""
    return next(
        p
        for p in psutil.Process().children(recursive=True)
        if "multiprocessing" in " ".join(p.cmdline()) and "resource_tracker" not in " ".join(p.cmdline())
    )


def store(folder: Path, *, logs: int, batch: int) -> None:
    """Print the cost of writing and reading a store with 18 results per log and bins of 3 kB per axis."""
    made = FleetStore(folder / "many")
    made.create()
    axes = [(sensor, axis) for sensor in ("gyroscope", "accelerometer") for axis in "xyz"]
    begun = time.perf_counter()
    for first in range(0, logs, batch):
        keys = [f"{number:032x}" for number in range(first, min(first + batch, logs))]
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
    parts = -(-logs // batch)
    size = sum(path.stat().st_size for path in made.folder.rglob("*.parquet"))
    print(f"{logs} logs in {parts} parts: written in {wrote:.1f} s, {size / 1e6:.0f} MB", flush=True)
    for what in READINGS:
        # A separate process per reading measures its own memory.
        process = multiprocessing.get_context("spawn").Process(target=_read, args=(made.folder, what, logs))
        process.start()
        process.join()
        assert process.exitcode == 0


def _read(folder: Path, what: str, logs: int) -> None:
    """Print time and memory of one reading of a store."""
    made = FleetStore(folder)
    keys = [f"{number:032x}" for number in range(logs)]
    if what == "bins of strewn logs":
        keys = np.random.default_rng(1).permutation(keys).tolist()
    begun = time.perf_counter()
    if what in {"logs", "results"}:
        rows = getattr(made, what)().height
    elif what == "all bins at once":
        rows = made.bins().height
    else:
        groups = [keys[first : first + 5000] for first in range(0, logs, 5000)]
        rows = sum(made.bins(group).height for group in groups)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(f"{what}: {rows} rows, {time.perf_counter() - begun:.1f} s, at most {peak:.0f} MB", flush=True)


def main() -> None:
    """Run the requested parts, or all."""
    parser = argparse.ArgumentParser()
    parser.add_argument("what", nargs="*", choices=["speed", "engine", "store", []])
    parser.add_argument("--tasks", type=int, default=100_000, help="engine, store: logs")
    parser.add_argument("--batch", type=int, default=6, help="store: logs of a part")
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
                for seconds in (BATCH_S, 0.0):
                    engine(folder, logs=given.tasks, seconds=seconds)
            else:
                store(folder, logs=given.tasks, batch=given.batch)


if __name__ == "__main__":
    main()
