"""Faults of a fleet with real processes: tools that disturb a run and compare its store."""

import contextlib
import os
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from imucal.fleet.store import FleetStore
from tests.cli.run import run
from tests.fleet_run.done_here import logs_done_here
from tests.report.blank import blank_pictures

#: Columns that describe the run instead of the log.
OF_THE_RUN = ("cpu_s", "wall_s", "finished", "part")
#: Seconds after which a process is considered hung.
PATIENCE = 240.0
#: Part of the command line of a worker's child.
CHILD = "imucal.processes"
#: The command, with the package of these tests and blank pictures.
COMMAND = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
from imucal.cli import main
from tests.report.blank import blank_pictures
with blank_pictures():
    main()
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """Exit code and output of a run."""

    code: int
    out: str
    err: str


class Bench:
    """A folder with logs, and runs of ``imucal fleet run`` in it."""

    def __init__(self, folder: Path, *, jobs: int = 2) -> None:
        self.folder, self.jobs = folder, jobs
        self._runs: list[subprocess.Popen[str]] = []

    def store(self, name: str) -> FleetStore:
        """Return a store of the folder."""
        return FleetStore(self.folder / name)

    def start(
        self, name: str, *arguments: str, logs: str = "logs", limit: Callable[[], object] | None = None
    ) -> subprocess.Popen[str]:
        """Start a run in its own session, like a terminal."""
        command = ["fleet", "run", logs, "-o", name, "--max-failed", "100%", *arguments]
        process = subprocess.Popen(  # noqa: S603 - our own command
            [sys.executable, "-c", COMMAND, *command],
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=limit,  # noqa: PLW1509 - the limit only applies to the run
        )
        self._runs.append(process)
        return process

    def end_runs(self) -> None:
        """Kill the runs that a failed scenario left, and close all pipes."""
        for process in self._runs:
            if process.poll() is None:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            for pipe in (process.stdout, process.stderr):
                if pipe is not None:
                    pipe.close()
        self._runs.clear()

    def run(
        self, name: str, *arguments: str, logs: str = "logs", limit: Callable[[], object] | None = None
    ) -> Ended:
        """Run to the end."""
        return ended(self.start(name, *arguments, logs=logs, limit=limit))

    def finish(self, name: str, *, logs: str = "logs") -> Ended:
        """Do the remaining logs, one at a time and in this process."""
        return self.type("fleet", "run", logs, "-o", name, "--max-failed", "100%", "--shard", "1/1")

    def type_again(self, output: str) -> Ended:
        """Run the command that a run printed to continue."""
        line = next(line for line in output.splitlines() if "to continue: " in line)
        imucal, *words = shlex.split(line.partition("to continue: ")[2])
        assert imucal == "imucal"
        return self.type(*words)

    def type(self, *words: str) -> Ended:
        """Run a command in this process without faults."""
        with blank_pictures(), logs_done_here():
            done = run(*words, cwd=self.folder)
        return Ended(code=done.returncode, out=done.stdout, err=done.stderr)

    def wait_for_parts(self, name: str, run: subprocess.Popen[str], parts: int = 1) -> None:
        """Wait until some batches are done."""
        folder = self.folder / name / "logs"

        def there() -> bool:
            if run.poll() is not None:
                msg = f"the run ended before: {run.communicate()[1]}"
                raise AssertionError(msg)
            return folder.is_dir() and len(list(folder.glob("part-*.parquet"))) >= parts

        wait_until(there)

    def differences(self, name: str, other: str, *, logs: bool = True) -> list[str]:
        """Return the tables in which two stores differ, ignoring row order and times."""
        one, two = self.store(name), self.store(other)
        found = []
        if logs and not one.logs().drop(OF_THE_RUN).equals(two.logs().drop(OF_THE_RUN)):
            found.append("logs")
        if not one.results().equals(two.results()):
            found.append("results")
        if not one.bins().equals(two.bins()):
            found.append("bins")
        return found


def ended(run: subprocess.Popen[str]) -> Ended:
    """Wait for the end of a run."""
    try:
        out, err = run.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        os.killpg(run.pid, signal.SIGKILL)
        run.communicate()
        raise
    return Ended(code=run.returncode, out=out, err=err)


def wait_until(there: Callable[[], bool]) -> None:
    """Wait for a condition; fail after a long time."""
    deadline = time.monotonic() + PATIENCE
    while not there():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def children_of(pid: int) -> list[psutil.Process]:
    """Return the processes that work on logs, of all workers of a run."""
    found = []
    with contextlib.suppress(psutil.Error):
        for process in psutil.Process(pid).children(recursive=True):
            with contextlib.suppress(psutil.Error):
                if CHILD in " ".join(process.cmdline()):
                    found.append(process)
    return found


def workers_of(folder: Path) -> list[psutil.Process]:
    """Return the workers of a cluster in a folder: the parents of the processes that work on one log.

    Their other children and this process may read files there too.
    """
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if CHILD in " ".join(process.cmdline()) and process.cwd() == str(folder):
                found.append(process.parent())
    others = [worker for worker in found if worker is not None and worker.pid != os.getpid()]
    return [worker for worker in others if CHILD not in " ".join(worker.cmdline())]


def left_over(folder: Path) -> list[int]:
    """Return the processes whose working folder is still this one."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if process.cwd() == str(folder) and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process.pid)
    return found


def hanging_log(path: Path) -> None:
    """Create a log whose reading never ends: a terminal without input."""
    path.symlink_to("/dev/ptmx")


def huge_log(path: Path, *, samples: int = 5_000_000) -> None:
    """Create a log of one axis with many samples."""
    rate = np.random.default_rng(0).standard_normal(samples, np.float32)
    np.savez(path, **{"gz (rad/s)": rate, "time (s)": np.arange(samples) / 200})  # type: ignore[arg-type]


class Hold:
    """Makes the processes of logs wait before their work, in processes with this `environment`."""

    _WAIT = f"""
import os, sys, time
go = os.path.join(os.path.dirname(__file__), "go")
while {CHILD!r} in " ".join(sys.orig_argv) and not os.path.exists(go):
    time.sleep(0.02)
"""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir()
        # Python imports this module when it starts.
        (folder / "sitecustomize.py").write_text(self._WAIT, encoding="utf-8")
        others = os.environ.get("PYTHONPATH")
        self.environment = {"PYTHONPATH": os.pathsep.join(filter(None, [str(folder), others]))}

    def release(self) -> None:
        """Let all processes work."""
        (self._folder / "go").touch()


@contextlib.contextmanager
def cluster(
    folder: Path, *, workers: int = 2, environment: Mapping[str, str] | None = None
) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Yield the address and the process of a scheduler with some workers."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    commands = [
        ["dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"],
        *[["dask_worker", address, "--nthreads", "1", "--no-dashboard", "--death-timeout", "60"]] * workers,
    ]
    processes = []
    try:
        for name, *arguments in commands:
            command = [sys.executable, "-m", f"distributed.cli.{name}", *arguments]
            own = {**os.environ, **(environment or {})} if name == "dask_worker" else None
            processes.append(subprocess.Popen(command, cwd=folder, env=own, stderr=subprocess.DEVNULL))  # noqa: S603
        yield address, processes[0]
    finally:
        for process in processes:
            with contextlib.suppress(psutil.Error):
                for child in psutil.Process(process.pid).children(recursive=True):
                    child.kill()
            process.kill()
            process.wait()
