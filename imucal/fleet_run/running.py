"""Process the logs of a fleet on this machine or on a cluster, and commit the results.

`run_fleet` is `imucal fleet run` without its output.

Each log is read and characterised in a child process with limits of time and memory. If a log hangs, crashes
or needs too much memory, only the child ends, and the log is known. On this machine, children communicate
with this process through private pipes. In a cluster, each worker has one child; the logs of a lost batch are
repeated one by one.
"""

import math
import signal
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias, cast

from imucal._version import __version__
from imucal.arguments import takes
from imucal.errors import ArgumentError, DataError, ImucalError, WriteError
from imucal.fleet.store import LABELS, OF_VALUE, FleetStore
from imucal.fleet_report import Fleet, load_fleet
from imucal.fleet_report.answers import Ask, Question, answer_texts
from imucal.fleet_run.logs import content_at, edge_at, stamp_of
from imucal.fleet_run.on_dask import Lost, R, T, dask_workers, unprotected
from imucal.fleet_run.plan import (
    ASKED,
    PATIENCE,
    FleetPlan,
    FleetSettings,
    LogTask,
    batches,
    fleet_settings,
    has_failed,
    planned,
)
from imucal.processes import ChildProcess
from imucal.readers.remote_logs import LocalLogs, local_logs
from imucal.recording import Recording
from imucal.remote import is_url
from imucal.remote.stores import identify
from imucal.resources import MEMORY, POOLS, THREADS

#: Length of a batch in s: on a cluster, where it costs time to distribute it, and on this machine.
BATCH_S, OWN_BATCH_S = 30.0, 10.0
#: Seconds between checks for an interrupt.
_LOOK_S = 0.1
#: Number of questions per batch.
_QUESTIONS = 4
#: Attempts for a log whose process ends: another log may have been the cause.
_ATTEMPTS = 2
#: Texts that Rust and C++ print if an allocation fails, before the process ends.
_NO_MEMORY = ("memory allocation of", "bad_alloc", "out of memory", "Cannot allocate memory")
#: One step of reading a log may use the memory of the child divided by this.
_SHARE = 4
#: A first stamp is a date if it is after 1999: clocks that start with the sensor begin in 1970.
_FIRST_DATE_NS = 946_684_800 * 10**9

#: A row of the store's table of logs, with the log's rows of the tables ``results`` and ``bins``.
LogRow: TypeAlias = dict[str, Any]


@dataclass(slots=True)
class RunCount:
    """Progress of a run: number of `logs` and of `done` logs, with their sizes in bytes.

    `failed` of the done logs have no usable numbers; `running` logs are being processed.
    """

    logs: int
    size: int
    done: int = 0
    failed: int = 0
    running: int = 0
    done_size: int = 0


@takes('imucal.run_fleet("logs", "fleet")', logs=(str, Path, Iterable, type(None)), folder=(str, Path))
def run_fleet(
    logs: str | Path | Iterable[str | Path] | None = None,
    folder: str | Path = "fleet",
    *,
    labels: str | None = None,
    manifest: str | Path | None = None,
    model: str | None = None,
    level: float | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    shard: tuple[int, int] | None = None,
    memory: int | str | None = None,
    timeout_s: float | None = None,
    reports: str = "failed",
    fresh: bool = False,
    reading: Mapping[str, object] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Fleet:
    """Fit the same noise model to many logs, and keep the results in a folder.

    This is ``imucal fleet run``, with the same folder and results: finished logs are kept, and the same call
    continues with the others. It returns the fleet as `imucal.load_fleet` does. Logs that fail are in
    `Fleet.failures` and raise no error.

    Logs are processed in child processes that import imucal but not the calling script. So a script needs no
    ``if __name__ == "__main__"``, and this function works in a notebook.

    Parameters
    ----------
    logs
        One or several files, folders of any depth, names with wildcards, or URLs. If this and `manifest` are
        None: the logs of the folder's manifest.
    folder
        The folder of the fleet; created if it does not exist.
    labels
        Pattern of the labels in the paths, such as ``{model}/{unit}/*.mcap``.
    manifest
        A table of logs (CSV) with a column ``path``.
    model, level
        Terms, and confidence level of all intervals: by default those of the folder, otherwise
        ``N + B + K`` and 0.95.
    jobs
        Number of logs at a time, each in its own process; by default one per processor.
    scheduler
        Address of a Dask scheduler whose workers process the logs; a warning follows if others can reach
        it.
    shard
        ``(i, n)``: process part i of n, from 1, one log at a time; ``(1, 1)`` is everything.
    memory
        Memory limit of a log in bytes, or a text such as ``2GB``; by default 80 % of the machine's memory,
        shared by the workers.
    timeout_s
        Time limit of a log in s; by default 300 and 3 for each MB.
    reports
        Logs with their own report: ``none``, ``failed`` or ``all``.
    fresh
        Discard the results in the folder.
    reading
        Arguments of `imucal.read`, and ``skip_s`` and ``take_s``, for every log.
    progress
        Called with the number of finished logs and the number of all logs to process.

    Raises
    ------
    ValueError
        If an argument is invalid, or the folder contains fits of another model or level.
    ReadError
        If no log has this name.
    ManifestError
        If the manifest, or a label in a path, is wrong.
    StoreError, WriteError
        If the manifest or the settings in the folder are damaged; if the folder can't be written.
    EngineError
        If the workers of a `scheduler` can't be reached or ended; finished logs are kept.
    DataError
        If no log was processed.
    """
    asked = locals()
    names = [str(logs)] if isinstance(logs, str | Path) else [str(log) for log in logs or ()]
    if not names and logs is not None and manifest is None:
        # An empty list, for example from a pattern without a match, must not mean all logs of the folder.
        raise ArgumentError(f"logs {logs!r}, expected at least one; omit them to continue the folder's logs")
    settings = fleet_settings(folder, {name: asked[name] for name in ASKED})
    plan = planned(settings, names, manifest=None if manifest is None else Path(manifest))
    prepare(plan, settings)
    if said := unprotected(scheduler):
        warnings.warn(said, stacklevel=2)
    tell = progress or (lambda _, __: None)
    run_plan(plan, settings, tell=lambda count: tell(count.done, count.logs))
    return load_fleet(folder, ask=asking(settings))


def prepare(plan: FleetPlan, settings: FleetSettings) -> None:
    """Create the store and write its settings and manifest; raises WriteError if this fails."""
    store, kept = FleetStore(settings.store), {"model": settings.model, "level": settings.level}
    if settings.fresh and store.exists:
        # The settings mark the folder as ours while it has no manifest.
        store.keep_settings(kept)
        store.clear()
    store.create()
    store.keep_settings(kept)
    store.add_to_manifest(plan.manifest())


def run_plan(
    plan: FleetPlan, settings: FleetSettings, *, tell: Callable[[RunCount], object] = lambda _: None
) -> RunCount:
    """Process the logs of a plan and commit them to the store; `tell` is called whenever the count changes.

    Raises WriteError if the store can't be written, and EngineError if the workers of a cluster can't be
    reached or ended.
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
            # Another log may be the cause: repeat each alone. A log that was alone gets one more attempt,
            # because its worker may be the cause.
            (task, *others) = batch
            if others or task.path not in lost:
                lost |= set() if others else {task.path}
                alone.extend([one] for one in batch)
                continue
            reason = f"{task.path}: {failed.reason}"
            failed = commit([first_row(task, settings, status="crash", reason=reason)], settings)  # noqa: PLW2901
        count.done += len(batch)
        count.done_size += sum(task.size for task in batch)
        count.failed += failed
        tell(count)
    return count


def asking(settings: FleetSettings) -> Ask:
    """Return a function that lets the workers answer the questions of a fleet; None for no answer."""

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
    """Yield batches with the result of `work(batch, child)` when they are finished.

    `take` returns the next batch, or None if there is none at present; lost batches may be repeated later.
    `work` can be pickled. Raises EngineError if the workers of a cluster can't be reached or ended.
    """
    if settings.scheduler:
        with dask_workers(settings.scheduler, partial(_on_worker, work, settings)) as workers:
            yield from workers.outcomes(take)
    else:
        yield from _here(take, work, settings)


def _here(
    take: Callable[[], T | None], work: Callable[[T, ChildProcess], R], settings: FleetSettings
) -> Iterator[tuple[T, R]]:
    """Yield batches like `outcomes`, with threads that ask child processes of this one.

    No child remains in any case: a later run may have another environment, such as other credentials.
    """
    children = [child_process(settings) for _ in range(settings.jobs)]
    free, hands = [*children], {}
    with ThreadPoolExecutor(settings.jobs) as pool:
        try:
            while True:
                while free and (batch := take()) is not None:
                    child = free.pop()
                    hands[pool.submit(work, batch, child)] = batch, child
                if not hands:
                    return
                # Polars continues a wait after an interrupt, so check for one regularly.
                for future in wait(hands, timeout=_LOOK_S, return_when=FIRST_COMPLETED).done:
                    batch, child = hands.pop(future)
                    free.append(child)
                    yield batch, future.result()
        finally:
            # End the waiting of threads for an answer.
            for child in children:
                child.close()
            pool.shutdown(cancel_futures=True)
            for child in children:
                child.end()


def _on_worker(work: Callable[[T, ChildProcess], R], settings: FleetSettings, batch: T) -> R:
    """Process a batch in a worker of a cluster."""
    child = child_process(settings)
    try:
        return work(batch, child)
    finally:
        child.end()


def work_on_batch(settings: FleetSettings, tasks: Sequence[LogTask], child: ChildProcess) -> int:
    """Process logs in a child process and commit all or none of them; return how many failed.

    Raises WriteError if the store can't be written; then these logs are not done.
    """
    return commit([_work_in_child(task, settings, child) for task in tasks], settings)


def commit(rows: Sequence[LogRow], settings: FleetSettings) -> int:
    """Write the rows of logs into the store; return how many have no usable numbers."""
    results, bins = ([one for row in rows for one in row.get(name, ())] for name in ("results", "bins"))
    FleetStore(settings.store).commit(rows, results, bins, shard=str(settings.shard[0]))
    return sum(has_failed(row["status"], row.get("verdict")) for row in rows)


def first_row(task: LogTask, settings: FleetSettings, *, status: str = "", reason: str = "") -> LogRow:
    """Return the row of a log before it is read, with a key from its path."""
    return {
        "key": settings.key(f"path:{task.path}", task.reading),
        "content": "",
        "path": task.path,
        **{name: task.labels.get(name) for name in LABELS},
        "status": status,
        "reason": reason,
        "findings": [],
        "bytes": task.size,
        "finished": time.time(),
        "report": "",
        "version": __version__,
    }


def _memory_reason(settings: FleetSettings) -> str:
    return f"it takes more than {settings.memory / 1e9:.3g} GB of memory; give it more, or a part of the log"


def child_process(settings: FleetSettings) -> ChildProcess:
    """Return a child process for logs, with one thread in all libraries and its share of memory."""
    # Dask makes its workers return all memory at once; to allocate it again costs a fifth of a fit.
    environment = {
        "MALLOC_TRIM_THRESHOLD_": None,
        **dict.fromkeys((THREADS, *POOLS), "1"),
        MEMORY: str(settings.memory // _SHARE),
        "MPLBACKEND": "agg",
    }
    # Relative paths start at the folder of the run, if this machine has it.
    folder = settings.folder if Path(settings.folder).is_dir() else None
    return ChildProcess(environment=environment, counted="data", folder=folder)


def _work_in_child(task: LogTask, settings: FleetSettings, child: ChildProcess) -> LogRow:
    seconds, status = settings.patience(task), "crash"
    for _ in range(_ATTEMPTS):
        try:
            answer = child.ask(work_on, task, settings, seconds=seconds, memory=settings.memory)
        except OSError as error:
            said = f"its process can't be started ({error.strerror or error}), as on an overloaded machine"
            why = f"{said}; run again when it is less loaded"
            break
        if answer.outcome == "done":
            return cast("LogRow", answer.value)
        if answer.outcome == "late":
            status = "timeout"
            why = f"it took more than {seconds:.4g} s; give it more time, or a part of the log"
            break
        raised = answer.outcome == "failed"
        if answer.words.startswith("MemoryError") if raised else any(map(answer.words.count, _NO_MEMORY)):
            status, why = "memory", _memory_reason(settings)
            break
        if raised:
            if answer.words.startswith(f"{WriteError.__name__}: "):
                raise WriteError(answer.words.partition(": ")[2])
            why = f"internal error ({answer.words}); please report it"
        else:
            how = signal.Signals(-answer.code).name if answer.code < 0 else f"exit code {answer.code}"
            why = f"its process ended {_ATTEMPTS} times ({how}), as when the machine has no memory left"
    return first_row(task, settings, status=status, reason=f"{task.path}: {why}")


def work_on(task: LogTask, settings: FleetSettings) -> LogRow:
    """Read and characterise a log in the child process; its row contains any error."""
    log = first_row(task, settings)
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        place = identify(task.place, keep=False) if is_url(task.place) else task.place
        # A downloaded file is removed after use.
        with local_logs([place]) as logs:
            if (stamp := stamp_of(place)) is not None:
                path = str(logs.paths[0])
                content = content_at(path)
                log |= {"bytes": stamp.size, "mtime_ns": stamp.mtime_ns, "edge": edge_at(path)}
                log |= {"content": content, "key": settings.key(content, task.reading)}
            log |= _characterised(task, settings, logs, key=log["key"])
        ended = "ok", ""
    except MemoryError:
        ended = "memory", _memory_reason(settings)
    except DataError as error:
        ended = "no-data", str(error)
    except WriteError:
        # The report can't be written: this is not an error of the log.
        raise
    except (ImucalError, ValueError) as error:
        ended = "unreadable", str(error)
    except OSError as error:
        ended = "unreadable", f"{task.path}: {error.strerror or error}"
    except Exception as error:  # noqa: BLE001 - one log's fault must not cost the others their results
        what = f"{type(error).__name__}: {error}"
        ended = "crash", f"{task.path}: internal error ({what}); please report it"
    log |= {"status": ended[0], "reason": ended[1], "finished": time.time()}
    log |= {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    return log


def _characterised(task: LogTask, settings: FleetSettings, logs: LocalLogs, *, key: str) -> LogRow:
    """Return the entries of a log's row that follow from its samples."""
    from imucal.fitting.bins import pack
    from imucal.fleet import log_values
    from imucal.noise.terms import TERMS
    from imucal.pipeline import Settings, characterize
    from imucal.readers import read

    # Arguments of `imucal.read`, and the part to use.
    reading = dict(task.reading)
    skip_s, take_s = reading.pop("skip_s", 0.0), reading.pop("take_s", math.inf)
    recording: Recording = read(logs.paths[0], **reading)
    if skip_s or take_s < math.inf:
        recording = recording.between(skip_s, skip_s + take_s)
    recording = logs.named(recording)
    wanted = Settings(
        model=settings.model, level=settings.level, bins=True, reading={**task.reading, "path": task.path}
    )
    # One axis at a time: other processors work on other logs.
    report = characterize(recording, wanted, workers=1)
    results, bins, name = [], [], ""
    for axis in report.axes:
        where = {"key": key, "sensor": axis.sensor.value, "axis": axis.axis}
        if axis.fit.bins is not None:
            bins.append({**where, "bins": pack(axis.fit.bins)})
        values = log_values("", axis.fit, model=settings.model, level=settings.level)
        for term, value in values.items():
            told = {field: getattr(value, field) for field in OF_VALUE}
            unit = TERMS[axis.fit[term].symbol].unit(axis.sensor)
            results.append({**where, "term": term, "unit_si": unit, **told})
    if settings.reports == "all" or (settings.reports == "failed" and has_failed("ok", report.verdict.grade)):
        from imucal.report import write_report

        name = f"reports/{key}"
        write_report(report, Path(settings.store) / name, formats=())
    return {
        "verdict": report.verdict.grade,
        "findings": sorted({finding.code for finding in report.all_findings if finding.level != "info"}),
        "samples": max(axis.samples for axis in report.axes),
        "seconds": max(axis.duration_s for axis in report.axes),
        "rate_hz": report.axes[0].rate_hz,
        "started": task.labels.get("started") or _started(recording),
        "report": name,
        "results": results,
        "bins": bins,
    }


def _started(recording: Recording) -> str | None:
    """Return the time of the first sample in ISO 8601; None if the stamps are not dates."""
    stamps = [series.clock.start_ns for series in recording.series if series.clock.start_ns is not None]
    if not stamps or min(stamps) < _FIRST_DATE_NS:
        return None
    return datetime.fromtimestamp(min(stamps) // 10**9, tz=UTC).isoformat()
