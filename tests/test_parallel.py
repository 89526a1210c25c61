"""Several things at a time, with results as if it had been done one after the other."""

import multiprocessing
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from imucal.parallel import own_workers, side_by_side

WORKERS = [1, 2, 3, 9]


@pytest.mark.parametrize("workers", WORKERS)
def test_results_stand_in_the_order_of_the_items(workers: int) -> None:
    """Also where the first takes longest."""

    def work(item: int) -> int:
        time.sleep(0.002 * (6 - item))
        return item * item

    assert side_by_side(work, range(6), workers=workers) == [0, 1, 4, 9, 16, 25]
    assert side_by_side(work, [], workers=workers) == []


@pytest.mark.parametrize("workers", WORKERS)
def test_what_is_done_is_told_by_the_calling_thread(workers: int) -> None:
    """With the first item that is not done; it rises one by one, and ends with all."""
    told: list[tuple[int, str | None]] = []
    callers = set()

    def done(count: int, following: str | None) -> None:
        told.append((count, following))
        callers.add(threading.current_thread())

    side_by_side(str.upper, list("abcd"), workers=workers, done=done)
    assert [count for count, _ in told] == [0, 1, 2, 3, 4]
    assert told[0] == (0, "a")
    assert told[-1] == (4, None)
    assert callers == {threading.current_thread()}


def test_so_many_are_at_work_at_a_time() -> None:
    """Never more than the workers, and at least once all of them."""
    at_work, most, lock = 0, 0, threading.Lock()
    both = threading.Barrier(2, timeout=10)

    def work(item: int) -> None:
        nonlocal at_work, most
        with lock:
            at_work += 1
            most = max(most, at_work)
        if item < 2:
            both.wait()
        with lock:
            at_work -= 1

    side_by_side(work, range(8), workers=2)
    assert most == 2


@pytest.mark.parametrize("workers", WORKERS)
def test_the_first_error_in_their_order_is_raised_and_no_other_work_begun(workers: int) -> None:
    """Though the second item fails at once and the first one later."""
    begun = []

    def work(item: int) -> None:
        begun.append(item)
        time.sleep(0.05 if item == 0 else 0.0)
        msg = f"item {item}"
        raise ArithmeticError(msg)

    with pytest.raises(ArithmeticError, match=r"^item 0$"):
        side_by_side(work, range(50), workers=workers)
    time.sleep(0.1)
    assert len(begun) <= workers


def test_an_interrupt_does_not_wait_for_the_work() -> None:
    """What had begun ends by itself, and nothing else is begun."""
    begun, go_on = [], threading.Event()

    def work(item: int) -> None:
        begun.append(item)
        go_on.wait(10)

    def interrupted(_: int, __: int | None) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        side_by_side(work, range(9), workers=2, done=interrupted)
    go_on.set()
    time.sleep(0.1)
    assert len(begun) <= 2


def test_other_parallel_work_has_the_processors_already(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the main thread of a program all threads there may be; in another thread or a child process, 1."""
    monkeypatch.setenv("IMUCAL_THREADS", "5")
    monkeypatch.setattr(multiprocessing, "parent_process", lambda: None)
    assert own_workers() == 5
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(own_workers).result() == 1
    monkeypatch.setattr(multiprocessing, "parent_process", multiprocessing.current_process)
    assert own_workers() == 1
