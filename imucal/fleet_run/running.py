"""A plan -> its logs done and committed, by processes of this machine or the workers of a cluster.

Each log is read and characterised in a child process with its time and memory. What hangs, dies or takes too
much memory is the child: who started it stays, and knows which log it was. On this machine the children are
this process's own, and speak with it through pipes that nobody else can reach. Of a cluster each worker has
one; the logs of a batch that such a worker did not bring back are tried by themselves.
"""

import signal
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

from imucal._version import __version__
from imucal.errors import DataError, ImucalError, WriteError
from imucal.fleet.store import LABELS, OF_VALUE, FleetStore
from imucal.fleet_report.answers import Ask, Question, answer_texts
from imucal.fleet_run.logs import at_hand, content_at, edge_at
from imucal.fleet_run.on_dask import Lost, dask_workers
from imucal.fleet_run.plan import PATIENCE, FleetPlan, FleetSettings, LogTask, batches, has_failed
from imucal.processes import Answer, ChildProcess
from imucal.readers.remote_logs import LocalLogs
from imucal.recording import Recording
from imucal.resources import MEMORY, POOLS, THREADS

#: Seconds of work that a batch of a cluster has, so that handing it out costs little; and one done here.
BATCH_S, OWN_BATCH_S = 30.0, 10.0
#: Questions that are handed out at a time.
_QUESTIONS = 4
#: How often a log is tried whose process ends: another one may have ended it.
_ATTEMPTS = 2
#: What Rust and C++ write where an allocation fails, before they end the process.
_NO_MEMORY = ("memory allocation of", "bad_alloc", "out of memory", "Cannot allocate memory")
#: The share of its memory that one step of reading a log may take.
_SHARE = 4
#: A log's first stamp counts as a date from 2000 on: clocks that start with the sensor begin at 1970.
_FIRST_DATE_NS = 946_684_800 * 10**9

T = TypeVar("T")
R = TypeVar("R")


@dataclass(slots=True)
class RunCount:
    """How far a run is: of the `logs` to do, of `size` bytes, how many are `done`, and of what `done_size`.

    Of those that are done, the `failed` have no numbers that may be used; `running` are in hand.
    """

    logs: int
    size: int
    done: int = 0
    failed: int = 0
    running: int = 0
    done_size: int = 0


def run_plan(
    plan: FleetPlan, settings: FleetSettings, *, tell: Callable[[RunCount], object] = lambda _: None
) -> RunCount:
    """Do what a plan has to do, and commit it to the store; `tell` gets the count whenever it changes.

    Raises
    ------
    WriteError
        If the store can't be written.
    EngineError
        If the workers of a cluster can't be reached, or are gone.
    """
    tasks = plan.tasks
    count = RunCount(logs=len(tasks), size=sum(task.size for task in tasks))
    if not tasks:
        return count
    seconds = BATCH_S if settings.scheduler else OWN_BATCH_S
    waiting = batches(tasks, workers=settings.jobs, seconds=seconds)
    alone: deque[list[LogTask]] = deque()
    lost: set[str] = set()

    def take() -> list[LogTask] | None:
        batch = alone.popleft() if alone else next(waiting, None)
        if batch is not None:
            count.running += len(batch)
            tell(count)
        return batch

    tell(count)
    for batch, failed in outcomes(take, partial(work_on_batch, settings), settings):
        count.running -= len(batch)
        if isinstance(failed, Lost):
            # It may have been another log's fault: each is done by itself. One that was alone gets one more
            # try: it may have been its worker's fault.
            if len(batch) > 1 or batch[0].path not in lost:
                lost.update(task.path for task in batch[:1] if len(batch) == 1)
                alone.extend([task] for task in batch)
                continue
            reason = f"{batch[0].path}: {failed.reason}"
            failed = commit([failure(batch[0], settings, "crash", reason)], settings)  # noqa: PLW2901
        count.done += len(batch)
        count.done_size += sum(task.size for task in batch)
        count.failed += failed
        tell(count)
    return count


def asking(settings: FleetSettings) -> Ask:
    """Return what has a fleet's questions answered by those who did its logs.

    What they do not answer, as where a process ends, is left to who asked.
    """

    def ask(questions: Sequence[Question]) -> list[str | None]:
        groups = [questions[i : i + _QUESTIONS] for i in range(0, len(questions), _QUESTIONS)]
        done = outcomes(partial(next, iter(groups), None), partial(_answered, settings), settings)
        texts = {id(group): said for group, said in done if not isinstance(said, Lost)}
        return [text for group in groups for text in texts.get(id(group), [None] * len(group))]

    return ask


def _answered(
    settings: FleetSettings, questions: Sequence[Question], child: ChildProcess
) -> list[str] | Lost:
    seconds = PATIENCE * len(questions)
    answer = child.ask(answer_texts, questions, seconds=seconds, memory=settings.memory)
    return cast("list[str]", answer.value) if answer.outcome == "done" else Lost(reason=answer.outcome)


def outcomes(
    take: Callable[[], T | None], work: Callable[[T, ChildProcess], R], settings: FleetSettings
) -> Iterator[tuple[T, R | Lost]]:
    """Yield batches with what `work` makes of each with a child process, as they are done.

    Parameters
    ----------
    take
        Returns the next batch, or None where there is none now; more may come of those that were lost.
    work
        A function of a module, which may be a `functools.partial`.
    settings
        Who does it: processes of this machine, or the workers of a cluster.

    Raises
    ------
    EngineError
        If the workers of a cluster can't be reached, or are gone.
    """
    there = partial(_on_worker, work, settings)
    address = settings.scheduler
    with dask_workers(address, there) if address else OwnWorkers(work, settings) as workers:
        while True:
            while workers.room() > 0 and (batch := take()) is not None:
                workers.submit(batch)
            if not workers.hands:
                return
            yield from workers.ended()


class OwnWorkers(Generic[T, R]):
    """Threads of this process, each with a child process of its own.

    However a run ends, no child is left: what comes later may have another environment, such as other
    credentials.
    """

    def __init__(self, work: Callable[[T, ChildProcess], R], settings: FleetSettings) -> None:
        self.hands: dict[Future[R], tuple[T, ChildProcess]] = {}
        self._work, self._pool = work, ThreadPoolExecutor(settings.jobs)
        self._children = [child_process(settings) for _ in range(settings.jobs)]
        self._free = [*self._children]

    def __enter__(self) -> "OwnWorkers[T, R]":
        return self

    def __exit__(self, *_: object) -> None:
        # Threads that wait for an answer are told that there will be none.
        for child in self._children:
            child.close()
        self._pool.shutdown(cancel_futures=True)
        for child in self._children:
            child.end()

    def room(self) -> int:
        """Return how many more batches may be handed out."""
        return len(self._free)

    def submit(self, batch: T) -> None:
        """Hand out a batch."""
        child = self._free.pop()
        self.hands[self._pool.submit(self._work, batch, child)] = batch, child

    def ended(self) -> Iterator[tuple[T, R]]:
        """Wait, and yield batches with their results."""
        for future in wait(self.hands, return_when=FIRST_COMPLETED).done:
            batch, child = self.hands.pop(future)
            self._free.append(child)
            yield batch, future.result()


def _on_worker(work: Callable[[T, ChildProcess], R], settings: FleetSettings, batch: T) -> R:
    """Do a batch as a worker of a cluster."""
    child = child_process(settings)
    try:
        return work(batch, child)
    finally:
        child.end()


@dataclass(frozen=True, slots=True, kw_only=True)
class LogRows:
    """What is committed of a log: rows with the columns of `imucal.fleet.store`."""

    log: dict[str, object]
    results: list[dict[str, object]] = field(default_factory=list)
    bins: list[dict[str, object]] = field(default_factory=list)


def work_on_batch(settings: FleetSettings, tasks: Sequence[LogTask], child: ChildProcess) -> int:
    """Do some logs in a child process and commit them, all or none; return how many failed.

    Raises
    ------
    WriteError
        If the store can't be written: then these logs are not done.
    """
    return commit([_work_in_child(task, settings, child) for task in tasks], settings)


def commit(rows: Sequence[LogRows], settings: FleetSettings) -> int:
    """Write the rows of some logs into the store; return how many gave no numbers that may be used."""
    FleetStore(settings.store).commit(
        [row.log for row in rows],
        [result for row in rows for result in row.results],
        [bins for row in rows for bins in row.bins],
        shard=str(settings.shard[0]),
    )
    return sum(has_failed(row.log["status"], row.log.get("verdict")) for row in rows)


def first_row(task: LogTask, settings: FleetSettings) -> dict[str, object]:
    """Return what is known of a log before it is looked at; its key is then one of its path."""
    return {
        "key": settings.key(f"path:{task.path}", task.reading),
        "content": "",
        "path": task.path,
        **{name: task.labels.get(name) for name in LABELS},
        "reason": "",
        "findings": [],
        "bytes": task.size,
        "finished": time.time(),
        "report": "",
        "version": __version__,
    }


def failure(task: LogTask, settings: FleetSettings, status: str, reason: str) -> LogRows:
    """Return the rows of a log of which nothing is known but how it failed."""
    return LogRows(log={**first_row(task, settings), "status": status, "reason": reason})


def _memory_reason(settings: FleetSettings) -> str:
    return f"it takes more than {settings.memory / 1e9:.3g} GB of memory; give it more, or a part of the log"


def child_process(settings: FleetSettings) -> ChildProcess:
    """Return a child process for logs: of one thread, in all libraries, and its share of memory."""
    # Dask has its workers give back all memory at once; to take it again costs a fifth of a fit.
    environment = {
        "MALLOC_TRIM_THRESHOLD_": None,
        **dict.fromkeys((THREADS, *POOLS), "1"),
        MEMORY: str(settings.memory // _SHARE),
        "MPLBACKEND": "agg",
    }
    # Relative paths begin where the run was started, if this machine has the folder.
    folder = settings.folder if Path(settings.folder).is_dir() else None
    return ChildProcess(environment=environment, counted="data", folder=folder)


def _work_in_child(task: LogTask, settings: FleetSettings, child: ChildProcess) -> LogRows:
    seconds, status = settings.patience(task), "crash"
    for _ in range(_ATTEMPTS):
        try:
            answer = child.ask(work_on, task, settings, seconds=seconds, memory=settings.memory)
        except OSError as error:
            why = f"its process can't be started ({error.strerror or error}), as when a machine is full"
            return failure(task, settings, "crash", f"{task.path}: {why}; run again where there is room")
        if answer.outcome == "done":
            return cast("LogRows", answer.value)
        if answer.outcome == "late":
            status = "timeout"
            why = f"it took more than {seconds:.4g} s; give it more time, or a part of the log"
            break
        if _took_memory(answer):
            status, why = "memory", _memory_reason(settings)
            break
        if answer.outcome == "failed":
            why = f"internal error ({answer.words}); please report it"
        else:
            how = signal.Signals(-answer.code).name if answer.code < 0 else f"exit code {answer.code}"
            why = f"its process ended {_ATTEMPTS} times ({how}), as when the machine has no memory left"
    if answer.outcome == "failed" and answer.words.startswith(f"{WriteError.__name__}: "):
        raise WriteError(answer.words.partition(": ")[2])
    return failure(task, settings, status, f"{task.path}: {why}")


def _took_memory(answer: Answer) -> bool:
    if answer.outcome == "failed":
        return answer.words.startswith("MemoryError")
    return answer.outcome == "ended" and any(words in answer.words for words in _NO_MEMORY)


def work_on(task: LogTask, settings: FleetSettings) -> LogRows:
    """Read and characterise a log, in the child process; whatever goes wrong with it is in its row."""
    log = first_row(task, settings)
    wall, cpu = time.perf_counter(), time.process_time()
    rows = LogRows(log=log)
    try:
        with at_hand(task.place) as (logs, stamp):
            if stamp is not None:
                path = str(logs.paths[0])
                content = content_at(path)
                log |= {"bytes": stamp.size, "mtime_ns": stamp.mtime_ns, "edge": edge_at(path)}
                log |= {"content": content, "key": settings.key(content, task.reading)}
            rows = _characterised(task, settings, log, logs)
        ended = "ok", ""
    except MemoryError:
        ended = "memory", _memory_reason(settings)
    except DataError as error:
        ended = "no-data", str(error)
    except WriteError:
        # Of its report: no fault of the log.
        raise
    except (ImucalError, ValueError) as error:
        ended = "unreadable", str(error)
    except OSError as error:
        ended = "unreadable", f"{task.path}: {error.strerror or error}"
    except Exception as error:  # noqa: BLE001 - one log's fault must not cost the others their results
        what = f"{type(error).__name__}: {error}"
        ended = "crash", f"{task.path}: internal error ({what}); please report it"
    log["status"], log["reason"] = ended
    log["wall_s"], log["cpu_s"] = time.perf_counter() - wall, time.process_time() - cpu
    log["finished"] = time.time()
    return rows


def _characterised(
    task: LogTask, settings: FleetSettings, log: dict[str, object], logs: LocalLogs
) -> LogRows:
    from imucal.fitting.bins import pack
    from imucal.fleet import log_values
    from imucal.noise.terms import TERMS
    from imucal.pipeline import Settings, characterize

    recording = logs.named(_read(logs.paths[0], task.reading))
    wanted = Settings(
        model=settings.model, level=settings.level, bins=True, reading={**task.reading, "path": task.path}
    )
    # One axis at a time: the other processors have other logs.
    report = characterize(recording, wanted, workers=1)
    log |= {
        "verdict": report.verdict.grade,
        "findings": sorted({finding.code for finding in report.all_findings if finding.level != "info"}),
        "samples": max(axis.samples for axis in report.axes),
        "seconds": max(axis.duration_s for axis in report.axes),
        "rate_hz": report.axes[0].rate_hz,
        "started": log["started"] or _started(recording),
    }
    rows = LogRows(log=log)
    for axis in report.axes:
        where = {"key": log["key"], "sensor": axis.sensor.value, "axis": axis.axis}
        if axis.fit.bins is not None:
            rows.bins.append({**where, "bins": pack(axis.fit.bins)})
        values = log_values("", axis.fit, model=settings.model, level=settings.level)
        for term, value in values.items():
            told = {name: getattr(value, name) for name in OF_VALUE}
            unit = TERMS[axis.fit[term].symbol].unit(axis.sensor)
            rows.results.append({**where, "term": term, "unit_si": unit, **told})
    if settings.reports == "all" or (settings.reports == "failed" and has_failed("ok", report.verdict.grade)):
        from imucal.report import write_report

        name = f"reports/{log['key']}"
        write_report(report, Path(settings.store) / name, formats=())
        log["report"] = name
    return rows


def _read(path: Path, reading: Mapping[str, object]) -> Recording:
    """Read a log with arguments of `imucal.read`, and leave out what ``skip_s`` and ``take_s`` say."""
    from imucal.readers import read

    arguments: dict[str, Any] = dict(reading)
    skip, take = float(arguments.pop("skip_s", 0.0)), arguments.pop("take_s", None)
    recording: Recording = read(path, **arguments)
    if not skip and take is None:
        return recording
    return recording.between(skip, float("inf") if take is None else skip + float(take))


def _started(recording: Recording) -> str | None:
    """Return the time of the first sample, in ISO 8601; None where the log has no calendar's clock."""
    stamps = [series.clock.start_ns for series in recording.series if series.clock.start_ns is not None]
    if not stamps or min(stamps) < _FIRST_DATE_NS:
        return None
    return datetime.fromtimestamp(min(stamps) // 10**9, tz=UTC).isoformat()
