"""Work on several items at a time, in forked children.

Threads would wait for the interpreter's lock. A forked child sees the data of its parent without a copy.
"""

import ctypes
import gc
import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from typing import Any, TypeVar

from imucal.child_process import FORK_WARNING, end_with_parent

__all__ = ["CHECKSUMS", "DOWNLOADS", "may_fork", "side_by_side"]

#: Name of the thread of `imucal.readers.checksums`.
CHECKSUMS = "imucal checksums"
#: Start of the names of fsspec's threads, which are idle after a download.
DOWNLOADS = "fsspecIO"
#: Threads without locks that a child needs: ours, the class of rich's progress bars, and fsspec's.
_HARMLESS = frozenset({CHECKSUMS, "_RefreshThread", DOWNLOADS})

T = TypeVar("T")
R = TypeVar("R")
#: In a child: the work and the items, which it inherits.
_inherited: list[Any] = []


def may_fork() -> bool:
    """Return whether this process can fork safely.

    It can't on other systems than Linux; in a child of `multiprocessing`; with other Python threads, whose
    locks would stay locked in the child; under a debugger or a profiler.
    """
    if not sys.platform.startswith("linux") or sys.gettrace() or sys.getprofile():
        return False
    others = [thread for thread in threading.enumerate() if thread is not threading.main_thread()]
    return (
        multiprocessing.parent_process() is None
        and threading.current_thread() is threading.main_thread()
        and all(_HARMLESS & {thread.name.partition("_")[0], type(thread).__name__} for thread in others)
    )


def side_by_side(
    work: Callable[[T], R],
    items: Sequence[T],
    *,
    workers: int,
    done: Callable[[int, T | None], None] | None = None,
) -> list[R]:
    """Return `work(item)` for each item, in their order.

    At most `workers` forked processes work at a time; if forking is not safe, this process does all items. If
    an item fails or its process is killed, this process does that item and the remaining ones, so an error is
    raised as in a loop. No child outlives the call. `done` is called with the number of finished items and
    the first unfinished item, or None.
    """
    found: dict[int, R] = {}

    def notify() -> None:
        if done:
            done(len(found), next((item for index, item in enumerate(items) if index not in found), None))

    if workers > 1 and len(items) > 1 and may_fork():
        _in_children(work, items, min(workers, len(items)), found, notify)
    for index, item in enumerate(items):
        if index not in found:
            notify()
            found[index] = work(item)
    notify()
    return [found[index] for index in range(len(items))]


def _in_children(
    work: Callable[[T], R],
    items: Sequence[T],
    workers: int,
    found: dict[int, R],
    notify: Callable[[], None],
) -> None:
    """Add results to `found`, until all are there or one fails."""
    _trim_memory()
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("fork")
    pool = ProcessPoolExecutor(workers, context, _inherit, (work, items, os.getpid()))
    try:
        futures = _submitted(pool, len(items))
        notify()
        for future in as_completed(futures):
            if future.exception() is not None:
                break
            found[futures[future]] = future.result()
            if len(found) < len(items):
                notify()
    except (OSError, BrokenProcessPool):
        # The system refuses another process, or has killed one.
        return
    finally:
        if len(found) < len(items):
            for process in set(multiprocessing.active_children()) - others:
                process.kill()
        pool.shutdown(cancel_futures=True)


def _submitted(pool: ProcessPoolExecutor, count: int) -> dict[Future[Any], int]:
    """Start the children and return the index of each item's future."""
    # An interrupt while children start would leave them without a parent that knows them.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", FORK_WARNING, DeprecationWarning)
            return {pool.submit(_work_on, index): index for index in range(count)}
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _inherit(work: Callable[[T], R], items: Sequence[T], parent: int) -> None:
    """Prepare a child. It ends with its parent, which also ends it after an interrupt."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent(parent)
    # Garbage collection would write to pages shared with the parent.
    gc.freeze()
    _inherited[:] = work, items


def _work_on(index: int) -> Any:  # noqa: ANN401 - what the work returns
    work, items = _inherited
    return work(items[index])


def _trim_memory() -> None:
    """Return freed memory to the system if the C library is glibc.

    Otherwise freed pages count for this process, and again for each child that writes to them.
    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)
