"""Faults of a fleet with real processes: tools that disturb a run and compare its store."""

import contextlib
import os
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import psutil

from imucal.errors import StoreError
from imucal.fleet.store import LogRow, Stored, is_fleet, read_store
from tests.cli.run import run
from tests.fleet.done_here import logs_done_here
from tests.report.blank import blank_pictures

#: Keys of a row that describe the run instead of the log.
OF_THE_RUN = ("cpu_s", "wall_s", "finished")
#: Seconds after which a process is considered hung.
PATIENCE = 120.0
#: CPU time in s that a process has used when it works on its log: the resolution of the system.
_WORKS_S = 0.01
#: Part of the command line of a child that answers questions, and of its forks.
CHILD = "imucal.child_process import serve"
#: The command, with the package of these tests and blank pictures.
COMMAND = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parents[2])!r})
from imucal.cli import main
from tests.report.blank import blank_pictures
with blank_pictures():
    main()
"""


class Ended(NamedTuple):
    """Exit code and output of a run."""

    code: int
    out: str
    err: str


class Bench:
    """A folder with logs, and runs of ``imucal fleet run`` in it."""

    def __init__(self, folder: Path, *, jobs: int = 2) -> None:
        self.folder, self.jobs = folder, jobs
        self._runs: list[subprocess.Popen[str]] = []

    def store(self, name: str) -> Stored:
        """Return the content of a store of the folder."""
        return read_store(self.folder / name)

    def rows(self, name: str) -> list[LogRow]:
        """Return the rows that count, without what describes the run."""
        return rows_of(self.folder / name)

    def statuses(self, name: str) -> dict[str, str]:
        """Return the status of each log."""
        return {row["path"]: row["status"] for row in self.rows(name)}

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
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
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
        imucal, *words = shlex.split(output.partition("to continue: ")[2].partition("\n")[0])
        assert imucal == "imucal"
        return self.type(*words)

    def type(self, *words: str) -> Ended:
        """Run a command in this process without faults."""
        with blank_pictures(), logs_done_here():
            done = run(*words, cwd=self.folder)
        return Ended(code=done.returncode, out=done.stdout, err=done.stderr)

    def wait_for_a_log(self, name: str, run: subprocess.Popen[str]) -> None:
        """Wait until a log is done."""

        def is_done() -> bool:
            assert run.poll() is None, run.communicate()[1]
            # The first file is empty until the settings are written.
            with contextlib.suppress(StoreError):
                return is_fleet(self.folder / name) and bool(self.store(name).rows)
            return False

        wait_until(is_done)


def rows_of(folder: Path) -> list[LogRow]:
    """Return the rows of a store that count, without what describes the run."""
    logs = read_store(folder).logs()
    return [{name: value for name, value in row.items() if name not in OF_THE_RUN} for row in logs]


def ended(run: subprocess.Popen[str]) -> Ended:
    """Wait for the end of a run."""
    out, err = run.communicate(timeout=PATIENCE)
    return Ended(code=run.returncode, out=out, err=err)


def wait_until(there: Callable[[], bool]) -> None:
    """Wait for a condition; fail after a long time."""
    deadline = time.monotonic() + PATIENCE
    while not there():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def stopped_log(above: int, *, forked: bool = True) -> psutil.Process:
    """Stop the process of a log below a run, which is a fork, or below a worker of a cluster; return it."""
    stopped: list[psutil.Process] = []

    def stop() -> bool:
        below = psutil.Process(above).children(recursive=True)
        pids = {child.pid for child in below if _is_child(child)}
        stopped.extend(log for log in below if not stopped and log.pid in pids and _stops(log, pids, forked))
        return bool(stopped)

    wait_until(stop)
    return stopped[0]


def _is_child(process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.Error):
        return CHILD in " ".join(process.cmdline())
    return False


def _stops(process: psutil.Process, pids: set[int], forked: bool) -> bool:  # noqa: FBT001 - of the caller
    """Stop a process that works on a log; return whether it had not ended before."""
    with contextlib.suppress(psutil.NoSuchProcess):
        used = process.cpu_times()
        # Right after its start, a fork does not end with its parent yet.
        if used.user + used.system < _WORKS_S or (forked and process.ppid() not in pids):
            return False
        process.suspend()
        wait_until(lambda: process.status() in {psutil.STATUS_STOPPED, psutil.STATUS_ZOMBIE})
        return bool(process.status() == psutil.STATUS_STOPPED)
    return False


def left_over(folder: Path) -> list[int]:
    """Return the processes whose working folder is still this one."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if process.cwd() == str(folder) and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process.pid)
    return found


@contextlib.contextmanager
def cluster(folder: Path, *, workers: int = 2) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Yield the address and the processes of a scheduler and some workers."""
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
            processes.append(subprocess.Popen(command, cwd=folder, stderr=subprocess.DEVNULL))  # noqa: S603
        yield address, processes
    finally:
        for process in processes:
            with contextlib.suppress(psutil.Error):
                for child in psutil.Process(process.pid).children(recursive=True):
                    child.kill()
            process.kill()
            process.wait()
