"""Process the logs of a fleet on this machine or on a cluster, and commit the results.

In a cluster, each worker has one child process; the logs of a lost batch are repeated one by one.
"""

import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import cast

from imucal.arguments import takes
from imucal.errors import ArgumentError
from imucal.fleet.store import FleetStore
from imucal.fleet_report import Fleet, load_fleet
from imucal.fleet_report.answers import Ask, Question, answer_texts
from imucal.fleet_run.log_work import child_process, commit, first_row, work_on_batch
from imucal.fleet_run.on_dask import Lost, R, T, dask_workers, unprotected
from imucal.fleet_run.plan import (
    ASKED,
    PATIENCE,
    FleetPlan,
    FleetSettings,
    LogTask,
    batches,
    fleet_settings,
    planned,
)
from imucal.processes import ChildProcess

#: Length of a batch in s, longer on a cluster, where distributing it takes time.
BATCH_S, OWN_BATCH_S = 30.0, 10.0
_LOOK_S = 0.1
_QUESTIONS = 4


@dataclass(slots=True)
class RunCount:
    """The progress of a run: numbers of logs, and sizes in bytes; `failed` logs have no usable numbers."""

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

    This is ``imucal fleet run``: finished logs are kept, and the same call continues with the others. Logs
    that fail are in `Fleet.failures` and raise no error.

    Child processes do not import the calling script, so it needs no ``if __name__ == "__main__"``.

    Parameters
    ----------
    logs
        One or several files, folders, names with wildcards, or URLs; by default the logs of the `manifest`
        or the folder.
    folder
        Created if it does not exist.
    labels
        Pattern of the labels in the paths, such as ``{model}/{unit}/*.mcap``.
    manifest
        A table of logs (CSV) with a column ``path``.
    model, level
        Terms, and confidence level of all intervals; by default the folder's, or ``N + B + K`` and 0.95.
    jobs
        Number of logs at a time, each in its own process; by default one per processor.
    scheduler
        Address of a Dask scheduler; a warning follows if others can reach it.
    shard
        ``(i, n)``: process part i of n, from 1, one log at a time.
    memory
        Memory limit of a log in bytes, or a text such as ``2GB``; by default the workers share 80 % of the
        machine's memory.
    timeout_s
        Time limit of a log in s; by default 300 and 3 for each MB.
    reports
        Logs with their own report: ``none``, ``failed`` or ``all``.
    fresh
        Discard the results in the folder.
    reading
        Arguments of `imucal.read` for every log.
    progress
        Called with the numbers of finished logs and of all logs to process.

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
        # An empty list must not mean all logs of the folder.
        raise ArgumentError(f"logs {logs!r}, expected at least one; omit them to continue the folder's logs")
    settings = fleet_settings(folder, {name: asked[name] for name in ASKED})
    plan = planned(settings, names, manifest=None if manifest is None else Path(manifest))
    prepare(plan, settings)
    if warning := unprotected(scheduler):
        warnings.warn(warning, stacklevel=2)
    done = progress or (lambda _, __: None)
    run_plan(plan, settings, progress=lambda count: done(count.done, count.logs))
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
    plan: FleetPlan, settings: FleetSettings, *, progress: Callable[[RunCount], object] = lambda _: None
) -> RunCount:
    """Process the logs of a plan and commit them; `progress` is called whenever the count changes.

    Raises WriteError, and EngineError if the workers of a cluster can't be reached or ended.
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
            progress(count)
        return batch

    progress(count)
    for batch, failed in outcomes(take, partial(work_on_batch, settings), settings):
        count.running -= len(batch)
        if isinstance(failed, Lost):
            # Another log may be the cause: repeat each alone, and a single log once.
            (task, *others) = batch
            if others or task.path not in lost:
                lost |= set() if others else {task.path}
                alone.extend([one] for one in batch)
                continue
            row = first_row(task, settings, status="crash", reason=failed.reason)
            failed = commit([row], settings)  # noqa: PLW2901
        count.done += len(batch)
        count.done_size += sum(task.size for task in batch)
        count.failed += failed
        progress(count)
    return count


def asking(settings: FleetSettings) -> Ask:
    """Return a function that lets the workers answer the questions of a fleet; None for no answer."""

    def ask(questions: Sequence[Question]) -> list[str | None]:
        groups = [questions[i : i + _QUESTIONS] for i in range(0, len(questions), _QUESTIONS)]
        done = outcomes(partial(next, iter(groups), None), partial(_answered, settings), settings)
        texts = {id(group): answers for group, answers in done if not isinstance(answers, Lost)}
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
    """Yield batches with the result of `work(batch, child)`, which can be pickled, when they are finished.

    `take` returns the next batch, or None. Raises EngineError if the workers of a cluster can't be reached or
    ended.
    """
    if settings.scheduler:
        with dask_workers(settings.scheduler, partial(_on_worker, work, settings)) as workers:
            yield from workers.outcomes(take)
    else:
        yield from _here(take, work, settings)


def _here(
    take: Callable[[], T | None], work: Callable[[T, ChildProcess], R], settings: FleetSettings
) -> Iterator[tuple[T, R]]:
    """Yield batches like `outcomes`, with threads that ask child processes.

    No child remains: a later run may have another environment, such as other credentials.
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
            for child in children:
                child.close()
            pool.shutdown(cancel_futures=True)
            for child in children:
                child.end()


def _on_worker(work: Callable[[T, ChildProcess], R], settings: FleetSettings, batch: T) -> R:
    child = child_process(settings)
    try:
        return work(batch, child)
    finally:
        child.end()
