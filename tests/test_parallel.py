"""Tests of parallel work: its results equal the results of sequential work."""

import multiprocessing
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucal.parallel import may_fork, side_by_side

WORKERS = [1, 2, 3, 9]
SKIP = pytest.mark.skipif(not may_fork(), reason="processes are not forked here")


pytestmark = pytest.mark.usefixtures("forks")


@pytest.mark.parametrize("workers", WORKERS)
def test_results_are_in_the_order_of_the_items(workers: int) -> None:
    """The first item takes longest."""

    def work(item: int) -> int:
        time.sleep(0.002 * (6 - item))
        return item * item

    assert side_by_side(work, range(6), workers=workers) == [0, 1, 4, 9, 16, 25]
    assert side_by_side(work, [], workers=workers) == []


@pytest.mark.parametrize("workers", WORKERS)
def test_progress_contains_the_count(workers: int) -> None:
    """It has the first unfinished item; the count rises up to the number of items."""
    reports: list[tuple[int, str | None]] = []
    side_by_side(str.upper, list("abcd"), workers=workers, done=lambda *what: reports.append(what))
    counts = [count for count, _ in reports]
    assert counts[0] == 0
    assert counts == sorted(counts)
    assert reports[0] == (0, "a")
    assert reports[-1] == (4, None)


@SKIP
def test_the_work_is_done_by_the_given_number_of_processes() -> None:
    """No process remains afterwards."""

    def work(_: int) -> int:
        time.sleep(0.05)
        return os.getpid()

    by = set(side_by_side(work, range(8), workers=3))
    assert len(by) == 3
    assert os.getpid() not in by
    assert not multiprocessing.active_children()
    for process in by:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


@pytest.mark.parametrize("workers", WORKERS)
def test_the_error_of_the_first_item_is_raised(workers: int) -> None:
    """The second item fails earlier; the error has its cause, as in sequential work."""

    def work(item: int) -> None:
        time.sleep(0.05 if item == 0 else 0.0)
        msg = f"item {item}"
        raise ArithmeticError(msg) from ValueError("cause")

    with pytest.raises(ArithmeticError, match=r"^item 0$") as caught:
        side_by_side(work, range(50), workers=workers)
    assert isinstance(caught.value.__cause__, ValueError)
    assert not multiprocessing.active_children()


@SKIP
@pytest.mark.parametrize("how", ["killed", "no memory", "no pickle"])
def test_failed_work_of_a_child_is_repeated_here(how: str) -> None:
    """A child is killed or lacks memory, or its result cannot be pickled."""
    here = os.getpid()

    def work(item: int) -> Any:  # noqa: ANN401 - also what can not be pickled
        if item == 1 and os.getpid() != here:
            if how == "killed":
                os.kill(os.getpid(), signal.SIGKILL)
            if how == "no memory":
                raise MemoryError
            return lambda: None
        return item, os.getpid() == here

    found = side_by_side(work, range(4), workers=2)
    assert [item for item, _ in found] == [0, 1, 2, 3]
    assert [own for _, own in found][:2] == [False, True]


@SKIP
def test_children_share_the_memory_of_their_parent() -> None:

    def own(_: int) -> int:
        text = Path("/proc/self/smaps_rollup").read_text(encoding="ascii")
        return next(int(line.split()[1]) for line in text.splitlines() if line.startswith("Private_Dirty"))

    held = np.ones(10_000_000)
    assert max(side_by_side(own, range(4), workers=2)) < 20_000
    assert held.all()


@SKIP
def test_a_warning_that_is_an_error_is_raised_here() -> None:
    """The warning filter applies in the children, too."""

    def work(item: int) -> int:
        warnings.warn(f"of {item}", RuntimeWarning, stacklevel=1)
        return item

    with pytest.raises(RuntimeWarning, match="of 0"):
        side_by_side(work, range(3), workers=2)


@SKIP
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGKILL"])
def test_no_process_outlives_its_parent(tmp_path: Path, name: str) -> None:
    """An interrupt only prints the parent's text."""
    number = getattr(signal, name)
    script = f"""
        import os, pathlib, time
        from imucal.parallel import side_by_side
        def work(item):
            pathlib.Path({str(tmp_path)!r}, str(os.getpid())).touch()
            time.sleep(60)
        try:
            side_by_side(work, range(9), workers=2)
        except KeyboardInterrupt:
            print("interrupted")
    """
    with subprocess.Popen(  # noqa: S603 - this interpreter and a constant script
        [sys.executable, "-c", textwrap.dedent(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
    ) as process:
        until(lambda: len(list(tmp_path.iterdir())) == 2)
        if name == "SIGINT":
            # A terminal sends the interrupt to all processes.
            os.killpg(process.pid, number)
        else:
            process.send_signal(number)
        output, errors = process.communicate(timeout=30)
    assert output == ("interrupted\n" if name == "SIGINT" else "")
    assert not errors
    until(lambda: not any(is_there(int(child.name)) for child in tmp_path.iterdir()))


def until(happened: object, seconds: float = 30) -> None:
    """Wait for a condition."""
    assert callable(happened)
    end = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


def is_there(process: int) -> bool:
    """Return whether a process runs and is not a zombie."""
    try:
        return ") Z" not in Path(f"/proc/{process}/stat").read_text(encoding="utf-8")
    except OSError:
        return False


def test_an_interrupt_ends_the_work() -> None:
    """No process remains."""

    def interrupted(_: int, __: int | None) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        side_by_side(time.sleep, [60] * 9, workers=2, done=interrupted)
    assert not multiprocessing.active_children()


def test_other_threads_prevent_forks() -> None:
    """A lock of another thread would stay locked in a child."""
    end = threading.Event()
    other = threading.Thread(target=end.wait)
    other.start()
    try:
        assert not may_fork()
        assert side_by_side(lambda _: os.getpid(), range(3), workers=3) == [os.getpid()] * 3
    finally:
        end.set()
        other.join()


def test_other_parallel_work_prevents_forks(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread of a pool or a worker process already uses the processors."""
    with ThreadPoolExecutor(1) as pool:
        assert not pool.submit(may_fork).result()
    monkeypatch.setattr(multiprocessing, "parent_process", multiprocessing.current_process)
    assert not may_fork()
