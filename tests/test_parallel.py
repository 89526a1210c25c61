"""Several things at a time, with results as if it had been done one after the other."""

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

from imucal.processes import may_fork, side_by_side

WORKERS = [1, 2, 3, 9]
SKIP = pytest.mark.skipif(not may_fork(), reason="processes are not forked here")


pytestmark = pytest.mark.usefixtures("forks")


@pytest.mark.parametrize("workers", WORKERS)
def test_results_are_in_the_order_of_the_items(workers: int) -> None:
    """Also where the first takes longest."""

    def work(item: int) -> int:
        time.sleep(0.002 * (6 - item))
        return item * item

    assert side_by_side(work, range(6), workers=workers) == [0, 1, 4, 9, 16, 25]
    assert side_by_side(work, [], workers=workers) == []


@pytest.mark.parametrize("workers", WORKERS)
def test_progress_contains_the_count(workers: int) -> None:
    """With the first item that is not done; it rises one by one, and ends with all."""
    told: list[tuple[int, str | None]] = []
    side_by_side(str.upper, list("abcd"), workers=workers, done=lambda *what: told.append(what))
    counts = [count for count, _ in told]
    assert counts[0] == 0
    assert counts == sorted(counts)
    assert told[0] == (0, "a")
    assert told[-1] == (4, None)


@SKIP
def test_the_work_is_done_by_so_many_other_processes() -> None:
    """None of them is there afterwards."""

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
def test_the_first_error_in_their_order_is_raised(workers: int) -> None:
    """Though the second item fails at once and the first one later; as it would have been, with its cause."""

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
def test_what_a_child_cannot_do_is_done_here(how: str) -> None:
    """A child that the system kills, one without memory, a result that can't be sent."""
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
def test_what_is_of_the_item_is_not_sent() -> None:
    """A result that holds its item is given back with the very item, as if it had been made here."""
    items = [np.zeros(1000) for _ in range(3)]
    found = side_by_side(lambda item: {"of": item, "size": item.size}, items, workers=2)
    assert all(one["of"] is item for one, item in zip(found, items, strict=True))


@SKIP
def test_children_hold_little_of_their_own() -> None:
    """What their parent has they share."""

    def own(_: int) -> int:
        text = Path("/proc/self/smaps_rollup").read_text(encoding="ascii")
        return next(int(line.split()[1]) for line in text.splitlines() if line.startswith("Private_Dirty"))

    held = np.ones(10_000_000)
    assert max(side_by_side(own, range(4), workers=2)) < 20_000
    assert held.all()


@SKIP
def test_warnings_of_a_child_are_shown_here() -> None:
    """Each as often as its filter lets it through."""

    def work(item: int) -> int:
        warnings.warn(f"of {item}", RuntimeWarning, stacklevel=1)
        return item

    with pytest.warns(RuntimeWarning, match="of") as caught:
        side_by_side(work, range(3), workers=2)
    assert sorted(str(one.message) for one in caught) == ["of 0", "of 1", "of 2"]


@SKIP
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGKILL"])
def test_no_process_outlives_its_parent(tmp_path: Path, name: str) -> None:
    """However it ends; after an interrupt with the parent's words alone."""
    number = getattr(signal, name)
    script = f"""
        import os, pathlib, time
        from imucal.processes import side_by_side
        def work(item):
            pathlib.Path({str(tmp_path)!r}, str(os.getpid())).touch()
            time.sleep(60)
        try:
            side_by_side(work, range(9), workers=2)
        except KeyboardInterrupt:
            print("interrupted")
    """
    with subprocess.Popen(  # noqa: S603 - this interpreter, and a text that stands here
        [sys.executable, "-c", textwrap.dedent(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
    ) as process:
        until(lambda: len(list(tmp_path.iterdir())) == 2)
        if name == "SIGINT":
            # As a terminal does, to all of them.
            os.killpg(process.pid, number)
        else:
            process.send_signal(number)
        said, wrong = process.communicate(timeout=30)
    assert said == ("interrupted\n" if name == "SIGINT" else "")
    assert not wrong
    until(lambda: not any(is_there(int(child.name)) for child in tmp_path.iterdir()))


def until(happened: object, seconds: float = 30) -> None:
    """Wait until something has happened."""
    assert callable(happened)
    end = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


def is_there(process: int) -> bool:
    """Whether a process runs, and is not only a number that nobody asked for yet."""
    try:
        return ") Z" not in Path(f"/proc/{process}/stat").read_text(encoding="utf-8")
    except OSError:
        return False


def test_an_interrupt_ends_the_work() -> None:
    """At once, with nobody left."""

    def interrupted(_: int, __: int | None) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        side_by_side(time.sleep, [60] * 9, workers=2, done=interrupted)
    assert not multiprocessing.active_children()


def test_beside_other_threads_nothing_is_forked() -> None:
    """A lock that another thread holds would be locked for ever in a child."""
    end = threading.Event()
    other = threading.Thread(target=end.wait)
    other.start()
    try:
        assert not may_fork()
        assert side_by_side(lambda _: os.getpid(), range(3), workers=3) == [os.getpid()] * 3
    finally:
        end.set()
        other.join()


def test_inside_other_parallel_work_nothing_is_forked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which has the processors already: in another thread, and in a process started for work."""
    with ThreadPoolExecutor(1) as pool:
        assert not pool.submit(may_fork).result()
    monkeypatch.setattr(multiprocessing, "parent_process", multiprocessing.current_process)
    assert not may_fork()
