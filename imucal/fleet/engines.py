"""Do the logs of a fleet in processes of their own, with limits of time and memory: on this machine.

A log that hangs, crashes or needs too much memory costs only its own process.
"""

import signal
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import TypeAlias, cast

from imucal.child_process import Answer, ChildProcess
from imucal.fleet.logs import LogTask
from imucal.fleet.plan import FleetSettings
from imucal.fleet.store import LogRow
from imucal.fleet.work import first_row, memory_reason, work_on
from imucal.resources import MEMORY, POOLS, THREADS

#: The system may have killed a process because of another log.
_ATTEMPTS = 2
#: Exit code of a process in which an allocation of Rust or C++ failed.
_ABORTED = -signal.SIGABRT
#: Reading a log may use the memory of its process divided by this.
_READING_SHARE = 4
#: Seconds between looks for an interrupt: polars continues a wait after one.
_LOOK_S = 0.1
#: Imports that each log needs; the process from which the others are forked does them once.
PRELOADED = ("imucal.fleet.preloaded",)

#: A log and its row.
Done: TypeAlias = tuple[LogTask, LogRow]


def on_this_machine(tasks: Iterable[LogTask], settings: FleetSettings) -> Iterator[Done]:
    """Yield logs with their rows as they are finished, at most `settings.jobs` at a time.

    No process remains: a later run may have another environment, such as other credentials.
    """
    waiting = iter(tasks)
    children = [child_process(settings, preloaded=PRELOADED) for _ in range(settings.jobs)]
    free = [*children]
    hands: dict[Future[LogRow], tuple[LogTask, ChildProcess]] = {}
    with ThreadPoolExecutor(settings.jobs) as pool:
        try:
            while True:
                while free and (task := next(waiting, None)) is not None:
                    child = free.pop()
                    hands[pool.submit(row_of, task, settings, child)] = task, child
                if not hands:
                    return
                for future in wait(hands, timeout=_LOOK_S, return_when=FIRST_COMPLETED).done:
                    task, child = hands.pop(future)
                    free.append(child)
                    yield task, future.result()
        finally:
            for child in children:
                child.close()
            pool.shutdown(cancel_futures=True)
            for child in children:
                child.end()


def child_process(settings: FleetSettings, *, preloaded: tuple[str, ...] = ()) -> ChildProcess:
    """Return a child process with one thread in all libraries and its share of memory."""
    # Dask makes its workers return all memory at once; to allocate it again costs a fifth of a fit.
    environment = {
        "MALLOC_TRIM_THRESHOLD_": None,
        **dict.fromkeys((THREADS, *POOLS), "1"),
        MEMORY: str(settings.memory // _READING_SHARE),
        "MPLBACKEND": "agg",
    }
    folder = settings.folder if Path(settings.folder).is_dir() else None
    return ChildProcess(environment=environment, counted="data", folder=folder, preloaded=preloaded)


def row_of(task: LogTask, settings: FleetSettings, child: ChildProcess) -> LogRow:
    """Return the row of a log from a child process; what ends the process is a reason in the row."""
    seconds = settings.patience(task)
    for _ in range(_ATTEMPTS):
        try:
            answer = child.ask(work_on, task, settings, seconds=seconds, memory=settings.memory)
        except OSError as error:
            start = f"its process can't be started ({error.strerror or error}), as on an overloaded machine"
            return _failure(task, settings, "crash", f"{start}; run again when it is less loaded")
        if answer.outcome == "done":
            return cast("LogRow", answer.value)
        if answer.outcome == "late":
            late = f"it took more than {seconds:.4g} s; give it more time, or a part of the log"
            return _failure(task, settings, "timeout", late)
        if answer.outcome == "no-memory" or answer.code == _ABORTED:
            return _failure(task, settings, "memory", memory_reason(settings))
    return _failure(task, settings, "crash", _end_of(answer))


def _end_of(answer: Answer) -> str:
    if answer.outcome == "failed":
        return f"internal error ({answer.words}); please report it"
    how = signal.Signals(-answer.code).name if answer.code < 0 else f"exit code {answer.code}"
    return f"its process ended {_ATTEMPTS} times ({how}), as when the machine has no memory left"


def _failure(task: LogTask, settings: FleetSettings, status: str, reason: str) -> LogRow:
    row = first_row(task, settings, status=status, reason=reason)
    # Limits may differ between logs, but their excess is one kind of failure.
    return row | {"code": status if status in {"memory", "timeout"} else ""}
