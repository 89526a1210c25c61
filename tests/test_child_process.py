"""Tests of a child that answers each question in a fork: what ends a fork costs one question only."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import cast

import psutil
import pytest

from imucal.child_process import Answer, ChildProcess

#: Bytes that a question may use.
MEMORY = 1 << 30
#: Seconds after which a process is considered hung.
PATIENCE = 60.0
#: Arguments of `re.fullmatch` that take it years, in which it keeps the interpreter's lock.
ENDLESS = ("(a+)+", "a" * 60 + "b")

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks are safe on Linux only")


@pytest.fixture
def child() -> Iterator[ChildProcess]:
    """Yield a child with a preloaded module."""
    child = ChildProcess(counted="data", preloaded=("fractions",))
    yield child
    child.end()


def ask(child: ChildProcess, function: Callable[..., object], *args: object) -> Answer:
    """Ask with the usual limits."""
    return child.ask(function, *args, seconds=PATIENCE, memory=MEMORY)


def test_each_question_has_its_own_process(child: ChildProcess) -> None:
    """All are forks of one server, which imported the module."""
    pids = {ask(child, os.getpid).value for _ in range(3)}
    servers = {ask(child, os.getppid).value for _ in range(3)}
    assert len(pids | servers) == 4
    assert servers <= {process.pid for process in psutil.Process().children()}
    assert ask(child, eval, "'fractions' in __import__('sys').modules").value is True


@pytest.mark.parametrize(
    ("function", "args", "code"),
    [
        (signal.raise_signal, (signal.SIGSEGV,), -signal.SIGSEGV),
        (os.abort, (), -signal.SIGABRT),
        (os._exit, (3,), 3),
    ],
)
def test_a_crash_costs_one_question(
    child: ChildProcess, function: Callable[..., object], args: tuple[object, ...], code: int
) -> None:
    """The server answers the next one."""
    server = ask(child, os.getppid).value
    found = ask(child, function, *args)
    assert (found.outcome, found.code) == ("ended", code)
    assert ask(child, os.getppid).value == server


def test_errors_and_missing_memory_are_answers(child: ChildProcess) -> None:
    """The server keeps running."""
    server = ask(child, os.getppid).value
    assert ask(child, bytes, 1 << 36).outcome == "no-memory"
    failed = ask(child, int, "x")
    assert (failed.outcome, failed.words.partition(":")[0]) == ("failed", "ValueError")
    assert ask(child, sys.exit, 3).outcome == "failed"
    assert ask(child, os.getppid).value == server


@pytest.mark.parametrize("disturb", ["nothing", "fork stopped", "server killed"])
def test_an_endless_question_leaves_no_process(child: ChildProcess, disturb: str) -> None:
    """It is late, or ends with a killed server. The next question has another server."""
    server = psutil.Process(cast("int", ask(child, os.getppid).value))
    found: list[Answer] = []
    limit = {"nothing": 1.0, "fork stopped": 2.0, "server killed": PATIENCE}[disturb]

    def wait() -> None:
        found.append(child.ask(re.fullmatch, *ENDLESS, seconds=limit, memory=MEMORY))

    asking = threading.Thread(target=wait)
    asking.start()
    wait_until(lambda: bool(server.children()))
    (fork,) = server.children()
    if disturb == "fork stopped":
        # A fork that has not yet tied its life to the server's would stay, and hold the pipes.
        wait_until(lambda: fork.cpu_times().user > 0.02)
        fork.suspend()
    elif disturb == "server killed":
        server.kill()
    asking.join(PATIENCE)
    assert [answer.outcome for answer in found] == ["ended" if disturb == "server killed" else "late"]
    wait_until(lambda: has_ended(fork.pid) and has_ended(server.pid))
    assert ask(child, len, b"ab").value == 2


SCRIPT = f"""
import os, re, signal, threading, time
import psutil
from imucal.child_process import ChildProcess
child = ChildProcess(preloaded=("fractions",))
limits = dict(seconds=600, memory={MEMORY})
server = child.ask(os.getppid, **limits).value
threading.Thread(target=child.ask, args=(re.fullmatch, *{ENDLESS!r}), kwargs=limits).start()
while not (forks := psutil.Process(server).children()):
    time.sleep(0.01)
print(server, forks[0].pid, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_no_process_outlives_a_killed_parent() -> None:
    """The server looks for its parent, and the system kills the fork with its server."""
    done = subprocess.run([sys.executable, "-c", SCRIPT], stdout=subprocess.PIPE, text=True, check=False)  # noqa: S603
    assert done.returncode == -signal.SIGKILL
    server, fork = map(int, done.stdout.split())
    wait_until(lambda: has_ended(server) and has_ended(fork))


def wait_until(there: Callable[[], bool]) -> None:
    """Wait for a condition; fail after a long time."""
    deadline = time.monotonic() + PATIENCE
    while not there():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def has_ended(pid: int) -> bool:
    """Return whether there is no such process, or only a zombie."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return bool(psutil.Process(pid).status() == psutil.STATUS_ZOMBIE)
    return True
