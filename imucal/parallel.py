"""Work on several things at a time in threads, with results as if it had been done one after the other."""

import contextvars
import multiprocessing
import threading
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from typing import TypeVar, cast

from imucal.resources import threads

T = TypeVar("T")
R = TypeVar("R")


def own_workers() -> int:
    """Return how many things to do at a time where nobody says: all threads there may be, or 1.

    It is 1 inside other parallel work, which has taken the processors already: in a thread other than the
    main one, and in a process that another one started for its work.

    Raises
    ------
    SettingError
        If ``IMUCAL_THREADS`` is no positive number.
    """
    alone = threading.current_thread() is threading.main_thread() and multiprocessing.parent_process() is None
    return threads() if alone else 1


def side_by_side(
    work: Callable[[T], R],
    items: Sequence[T],
    *,
    workers: int,
    done: Callable[[int, T | None], None] | None = None,
) -> list[R]:
    """Return what `work` makes of each item, in their order.

    Items are begun in their order. Where one fails, no other is begun, and the error of the first item
    that failed is raised, whichever thread was quicker. An interrupt is raised at once; work that had
    begun ends by itself.

    Parameters
    ----------
    workers
        Most items at a time.
    done
        Called by the calling thread with the number of items done and the first that is not done; None
        when all are.
    """
    if workers < 2 or len(items) < 2:
        return _one_by_one(work, items, done)
    todo = iter(range(len(items)))
    lock, stop = threading.Lock(), threading.Event()
    outcomes: SimpleQueue[tuple[int, R | None, BaseException | None]] = SimpleQueue()

    def go() -> None:
        while True:
            with lock:
                index = None if stop.is_set() else next(todo, None)
            if index is None:
                return
            try:
                outcomes.put((index, work(items[index]), None))
            except BaseException as error:  # noqa: BLE001 - raised again where the results are wanted
                stop.set()
                outcomes.put((index, None, error))

    for _ in range(min(workers, len(items))):
        # A thread of its own kind dies with the program, so that an interrupt does not wait for it.
        threading.Thread(target=contextvars.copy_context().run, args=(go,), daemon=True).start()
    return _collected(items, outcomes, stop, done)


def _one_by_one(
    work: Callable[[T], R], items: Sequence[T], done: Callable[[int, T | None], None] | None
) -> list[R]:
    results = []
    for index, item in enumerate(items):
        if done:
            done(index, item)
        results.append(work(item))
    if done:
        done(len(items), None)
    return results


def _collected(
    items: Sequence[T],
    outcomes: "SimpleQueue[tuple[int, R | None, BaseException | None]]",
    stop: threading.Event,
    done: Callable[[int, T | None], None] | None,
) -> list[R]:
    """Return the results in order, telling how many there are; raise the first error in the items' order."""
    found: dict[int, R] = {}
    errors: dict[int, BaseException] = {}
    try:
        while len(found) < len(items):
            if done:
                first = next(index for index in range(len(items)) if index not in found)
                done(len(found), items[first])
            index, result, error = outcomes.get()
            if error is None:
                found[index] = cast("R", result)
            else:
                errors[index] = error
            # All before the one that failed had been begun, and end.
            if errors and all(index in found or index in errors for index in range(min(errors))):
                raise errors[min(errors)]
    finally:
        stop.set()
    if done:
        done(len(items), None)
    return [found[index] for index in range(len(items))]
