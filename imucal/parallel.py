"""Work on several things at a time in child processes, with results as if done one after the other.

Threads would fight over the interpreter's lock: what is done with an axis holds it half of the time. A
child that is forked has everything its parent has without a copy, and sends back its result.
"""

import ctypes
import gc
import io
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, TypeVar

from imucal.child_process import leave_with

if TYPE_CHECKING:
    from multiprocessing.context import ForkProcess

T = TypeVar("T")
R = TypeVar("R")

#: The thread of `imucal.readers.checksums`.
CHECKSUMS = "imucal checksums"
#: Threads that hold no lock a child needs: ours, by its name, and that of rich's progress bars, by its class.
_HARMLESS = frozenset({CHECKSUMS, "_RefreshThread"})
#: Which warnings of children have been shown, as Python keeps it for each module.
_SEEN: dict[str | tuple[str, type[Warning], int], int] = {}
#: What Python 3.12 and later say of a fork beside threads, also those of libraries.
_FORK_WARNING = r".*multi-threaded, use of fork"


def may_fork() -> bool:
    """Whether child processes may be forked here.

    Not elsewhere than on Linux, where libraries do not bear it; in a child of `multiprocessing`; beside other
    threads of Python, whose locks a child would find locked for ever; under a debugger or a profiler.
    """
    if not sys.platform.startswith("linux") or sys.gettrace() or sys.getprofile():
        return False
    others = [thread for thread in threading.enumerate() if thread is not threading.main_thread()]
    return (
        multiprocessing.parent_process() is None
        and threading.current_thread() is threading.main_thread()
        and all(_HARMLESS & {thread.name, type(thread).__name__} for thread in others)
    )


def side_by_side(
    work: Callable[[T], R],
    items: Sequence[T],
    *,
    workers: int,
    done: Callable[[int, T | None], None] | None = None,
) -> list[R]:
    """Return what `work` makes of each item, in their order.

    Items are begun in their order, each in one of `workers` forked processes, or here one by one where
    none may be forked. Where one fails, or its process is killed, no other is begun there; that one and
    what is left are done here one by one, so that an error is raised as if all had been. No process
    outlives the call, nor this process.

    Parameters
    ----------
    workers
        Most items at a time.
    done
        Called with the number of items done and the first that is not done; None when all are.
    """
    found: dict[int, R] = {}

    def tell() -> None:
        if done:
            done(len(found), next((item for index, item in enumerate(items) if index not in found), None))

    if workers > 1 and len(items) > 1 and may_fork():
        _in_children(work, items, min(workers, len(items)), found, tell)
    for index, item in enumerate(items):
        if index not in found:
            tell()
            found[index] = work(item)
    tell()
    return [found[index] for index in range(len(items))]


def trim_memory() -> None:
    """Hand memory that was freed back to the system, where the C library keeps it (glibc).

    What stands free among what is in use counts as this process's, and again as each child's that writes
    to it.
    """
    if sys.platform.startswith("linux"):
        with suppress(AttributeError, OSError):
            ctypes.CDLL(None).malloc_trim(0)


def _in_children(
    work: Callable[[T], R], items: Sequence[T], workers: int, found: dict[int, R], tell: Callable[[], None]
) -> None:
    """Add the results of children to `found`, until all are there or one could not be made."""
    processes: list[ForkProcess] = []
    in_hand: dict[Connection, int] = {}
    trim_memory()
    try:
        for index in range(workers):
            pipe = _start(work, items, processes)
            if pipe is None:
                break
            _give(pipe, index, in_hand)
        todo = iter(range(len(in_hand), len(items)))
        while in_hand:
            tell()
            for pipe in [pipe for pipe in wait(list(in_hand)) if isinstance(pipe, Connection)]:
                index = in_hand.pop(pipe)
                if not _received(pipe, index, items, found):
                    todo = iter(())
                elif (following := next(todo, None)) is not None:
                    _give(pipe, following, in_hand)
            if len(found) == len(items):
                return
    finally:
        # They have nothing to tidy up.
        for process in processes:
            process.kill()
        for process in processes:
            process.join()


def _start(work: Callable[[T], R], items: Sequence[T], processes: "list[ForkProcess]") -> Connection | None:
    """Add a child to `processes` and return its pipe; None where the system gives no more."""
    context = multiprocessing.get_context("fork")
    # An interrupt waits until the child is known; the child never gets it, its parent ends it.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        ours, theirs = context.Pipe()
        with theirs, warnings.catch_warnings():
            warnings.filterwarnings("ignore", _FORK_WARNING, DeprecationWarning)
            process = context.Process(target=_serve, args=(work, items, theirs, os.getpid()), daemon=True)
            process.start()
        processes.append(process)
    except OSError:
        return None
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return ours


def _give(pipe: Connection, index: int, in_hand: dict[Connection, int]) -> None:
    """Hand out an item; that a child is gone is seen when its result is read."""
    in_hand[pipe] = index
    with suppress(OSError):
        pipe.send_bytes(b"%d" % index)


class _Sender(pickle.Pickler):
    """Packs a result; the item that it is of is named in it, not sent: the parent has it."""

    def __init__(self, file: io.BytesIO, item: object) -> None:
        super().__init__(file, protocol=5)
        self._item = item

    def persistent_id(self, obj: object) -> str | None:
        return "item" if obj is self._item else None


class _Receiver(pickle.Unpickler):
    """Unpacks what a `_Sender` has packed."""

    def __init__(self, file: io.BytesIO, item: object) -> None:
        super().__init__(file)
        self._item = item

    def persistent_load(self, pid: object) -> object:  # noqa: ARG002 - there is one
        return self._item


def _received(pipe: Connection, index: int, items: Sequence[T], found: dict[int, R]) -> bool:
    """Add a child's result to `found`, and show its warnings; False where it has ended without one."""
    try:
        found[index], caught = _Receiver(io.BytesIO(pipe.recv_bytes()), items[index]).load()
    except (EOFError, OSError):
        return False
    for message, category, file, line in caught:
        warnings.warn_explicit(message, category, file, line, registry=_SEEN)
    return True


def _serve(work: Callable[[T], R], items: Sequence[T], pipe: Connection, parent: int) -> None:
    """Send the result and the warnings of each item that is asked for: the child's side.

    Whatever fails ends the child without a word: its parent does the same again, and says it.
    """
    try:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        threading.Thread(target=leave_with, args=(parent,), daemon=True).start()
        # What is there stays: the collector would write to its pages, which parent and child share.
        gc.freeze()
        while True:
            index = int(pipe.recv_bytes())
            with warnings.catch_warnings(record=True) as caught:
                result = work(items[index])
            said = [(one.message, one.category, one.filename, one.lineno) for one in caught]
            packed = io.BytesIO()
            _Sender(packed, items[index]).dump((result, said))
            pipe.send_bytes(packed.getbuffer())
    finally:
        # At once: nothing that stands in buffers of the parent's is written twice.
        os._exit(1)
