"""Some logs, one after the other, each in a child process with its time and memory -> one part of the store.

This runs in a worker, or in the process of a shard. What hangs, dies or takes too much memory is the child:
the worker stays, and knows which log it was.
"""

import atexit
import os
import signal
import threading
from collections.abc import Sequence
from functools import partial
from typing import cast

from imucal.child_process import Answer, ChildProcess
from imucal.fleet.store import FleetStore
from imucal.fleet_run.log_tasks import FleetSettings, LogDone, LogTask
from imucal.fleet_run.work import LogRows, enter, first_row, memory_reason, work_on
from imucal.resources import MEMORY, POOLS, THREADS

#: How often a log is tried whose process ends: another one may have ended it.
_ATTEMPTS = 2
#: What Rust and C++ write where an allocation fails, before they end the process.
_NO_MEMORY = ("memory allocation of", "bad_alloc", "out of memory", "Cannot allocate memory")
#: The share of its memory that one step of reading a log may take.
_SHARE = 4

_children = threading.local()


def work_on_batch(tasks: Sequence[LogTask], settings: FleetSettings) -> list[LogDone]:
    """Do some logs and commit them, all or none.

    Raises
    ------
    WriteError
        If the store can't be written: then these logs are not done.
    """
    rows = [_work_in_child(task, settings) for task in tasks]
    commit(rows, settings)
    return [done_of(row) for row in rows]


def commit(rows: Sequence[LogRows], settings: FleetSettings) -> None:
    """Write the rows of some logs into the store."""
    FleetStore(settings.store).commit(
        [row.log for row in rows],
        [result for row in rows for result in row.results],
        [bins for row in rows for bins in row.bins],
        shard=settings.shard,
    )


def failure(task: LogTask, settings: FleetSettings, status: str, reason: str) -> LogRows:
    """Return the rows of a log of which nothing is known but how it failed."""
    return LogRows(log={**first_row(task, settings), "status": status, "reason": reason})


def done_of(rows: LogRows) -> LogDone:
    """Return how a log ended."""
    log = rows.log
    return LogDone(
        path=str(log["path"]),
        size=cast("int", log["bytes"]),
        status=str(log["status"]),
        reason=str(log["reason"]),
        verdict=str(log.get("verdict") or ""),
    )


def _work_in_child(task: LogTask, settings: FleetSettings) -> LogRows:
    seconds = settings.patience(task)
    for _ in range(_ATTEMPTS):
        try:
            answer = _child(settings).ask(
                partial(_enter_and_work, task, settings), seconds=seconds, memory=settings.memory
            )
        except OSError as error:
            why = f"its process can't be started ({error.strerror or error}), as when a machine is full"
            return failure(task, settings, "crash", f"{task.path}: {why}; run again where there is room")
        if answer.outcome == "done":
            return cast("LogRows", answer.value)
        if answer.outcome == "late" or _took_memory(answer):
            break
    status, reason = _why(answer, settings, seconds)
    return failure(task, settings, status, f"{task.path}: {reason}")


def _why(answer: Answer, settings: FleetSettings, seconds: float) -> tuple[str, str]:
    if answer.outcome == "late":
        return "timeout", f"it took more than {seconds:.4g} s; give it more time, or a part of the log"
    if _took_memory(answer):
        return "memory", memory_reason(settings)
    if answer.outcome == "failed":
        return "crash", f"internal error ({answer.words}); please report it"
    how = signal.Signals(-answer.code).name if answer.code < 0 else f"exit code {answer.code}"
    return "crash", f"its process ended {_ATTEMPTS} times ({how}), as when the machine has no memory left"


def _took_memory(answer: Answer) -> bool:
    if answer.outcome == "failed":
        return answer.words.startswith("MemoryError")
    return answer.outcome == "ended" and any(words in answer.words for words in _NO_MEMORY)


def _enter_and_work(task: LogTask, settings: FleetSettings) -> LogRows:
    enter(settings.folder)
    return work_on(task, settings)


def _child(settings: FleetSettings) -> ChildProcess:
    """Return the child of this thread; a forked process gets one of its own."""
    known = _known()
    which = (os.getpid(), settings.memory)
    if which not in known:
        end_child()
        known[which] = ChildProcess(environment=_environment(settings), counted="data")
        atexit.register(known[which].end)
    return known[which]


def end_child() -> None:
    """End this thread's child: what comes later may have another environment, such as other credentials."""
    known = _known()
    for child in known.values():
        child.end()
    known.clear()


def _known() -> dict[tuple[int, int], ChildProcess]:
    known: dict[tuple[int, int], ChildProcess] = _children.__dict__.setdefault("known", {})
    return known


def _environment(settings: FleetSettings) -> dict[str, str | None]:
    """Return variables by which a child takes one thread, in all libraries, and its share of memory."""
    return {
        # Dask has its workers give back all memory at once; to take it again costs a fifth of a fit.
        "MALLOC_TRIM_THRESHOLD_": None,
        **dict.fromkeys((THREADS, *POOLS), "1"),
        MEMORY: str(settings.memory // _SHARE),
        "MPLBACKEND": "agg",
    }
