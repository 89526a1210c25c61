"""Many real logs of 10 s with ``imucal fleet run``: ``python -m tests.benchmarks.fleet_short_logs``.

Each log is a part of two runs of an ADIS16405 at rest in the folder IMUCAL_REAL_DATA. Their starts are
spread so that all fit, 4 s apart for 5000 logs. Neighbours share samples, so statistics of the fleet are
meaningless, but each log is different. Ten logs form a unit. It prints CPU, time, memory, and the outcome of
the logs.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from tests.benchmarks.repeatability import real_axes

#: Sampling rate of the sensor in Hz.
RATE = 100
#: Length of a log in s.
SECONDS = 10
#: Logs of a unit.
OF_A_UNIT = 10


def make_logs(folder: Path, logs: int) -> None:
    """Write the logs as NPZ, in one folder per unit."""
    runs: dict[int, dict[str, list[np.ndarray]]] = {}
    for name, run, series in real_axes():
        runs.setdefault(run, {}).setdefault(name.partition("_")[0], []).append(series.samples)
    length = RATE * SECONDS
    stamps = np.arange(length) / RATE
    each = logs // len(runs)
    for number in range(logs):
        sensors = list(runs.values())[min(number // each, len(runs) - 1)]
        whole = len(sensors["gyro"][0]) - length
        first = round((number % each) * whole / each)
        gyro, accel = (np.column_stack([s[first : first + length] for s in sensors[k]]) for k in sensors)
        path = folder / f"u{number // OF_A_UNIT:04}" / f"{number % OF_A_UNIT}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        columns: dict[str, Any] = {"time (s)": stamps, "gyro (rad/s)": gyro, "accel (m/s^2)": accel}
        np.savez(path, **columns)


def main() -> None:
    """Write the logs, run them, load the fleet again, and print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--logs", type=int, default=5000)
    parser.add_argument("--jobs", default="1")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name).resolve()
        make_logs(folder / "logs", asked.logs)
        command = [sys.executable, "-m", "imucal", "fleet", "run", "logs", "--jobs", asked.jobs]
        for what in ([*command, "--labels", "{unit}/*.npz"], [*command, "--labels", "{unit}/*.npz"]):
            table = _run(what, folder)
            print(table, flush=True)
        size = sum(path.stat().st_size for path in (folder / "fleet").glob("run-*.fleet"))
        print(f"store {size / 1e6:.0f} MB; load {os.getloadavg()[0]:.1f}")


def _run(command: list[str], folder: Path) -> str:
    """Run a command to its end; return CPU, time, memory and its output."""
    begun, before, most, alone = time.perf_counter(), _cpu_of_children(), 0, 0
    with subprocess.Popen(  # noqa: S603 - this very imucal
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        of_process = psutil.Process(process.pid)
        while process.poll() is None:
            try:
                every = [of_process, *of_process.children(recursive=True)]
                memory = [one.memory_info().rss for one in every]
            except psutil.NoSuchProcess:
                continue
            most, alone = max(most, sum(memory)), max(alone, memory[0])
            time.sleep(0.5)
        output = process.stdout.read() if process.stdout else ""
    used = _cpu_of_children() - before
    return (
        f"exit {process.returncode}, {used:.1f} s of CPU, {time.perf_counter() - begun:.1f} s, the command "
        f"{alone / 1e6:.0f} MB, all processes {most / 1e6:.0f} MB\n{output}"
    )


def _cpu_of_children() -> float:
    """Return the CPU time of all ended child processes, in s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
