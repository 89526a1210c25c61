"""A plan -> its logs done, by whoever does the work; logs of a lost batch are tried by themselves."""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial

from imucal.fleet_run.batch_work import commit, done_of, end_child, failure, work_on_batch
from imucal.fleet_run.dask_cluster import Engine
from imucal.fleet_run.dask_engine import Lost, outcomes
from imucal.fleet_run.fleet_plan import FleetPlan, batches
from imucal.fleet_run.log_tasks import FleetSettings, LogDone, LogTask

#: Seconds of work that a batch has, so that handing it out costs little; and one of this process's own.
BATCH_S, OWN_BATCH_S = 30.0, 10.0
#: Seconds after the time of its logs in which a worker must have committed a batch.
_MARGIN_S = 60.0


@dataclass(slots=True)
class RunCount:
    """How far a run is.

    Attributes
    ----------
    logs, size
        To do: number and bytes.
    done, failed, running
        Logs that are done, of them those without numbers that may be used, and those in hand.
    done_size
        Bytes of the logs that are done.
    workers
        How many work.
    reasons
        Of the failures, by path.
    """

    logs: int
    size: int
    done: int = 0
    failed: int = 0
    running: int = 0
    done_size: int = 0
    workers: int = 1
    reasons: dict[str, str] = field(default_factory=dict)

    def add(self, log: LogDone, task_size: int) -> None:
        """Count a log that is done."""
        self.done += 1
        self.done_size += task_size
        if log.failed:
            self.failed += 1
            self.reasons[log.path] = log.reason or "not noise"


def run_plan(
    plan: FleetPlan,
    settings: FleetSettings,
    *,
    engine: Engine | None,
    tell: Callable[[RunCount], None] = lambda _: None,
) -> RunCount:
    """Do what a plan has to do, and commit it to the store.

    Parameters
    ----------
    plan, settings
        What, and how.
    engine
        Who does it; None for this process, log by log.
    tell
        Called with the count whenever it changes.

    Raises
    ------
    WriteError
        If the store can't be written.
    EngineError
        If the workers can't be reached, or are gone.
    """
    tasks = plan.tasks
    count = RunCount(logs=len(tasks), size=sum(task.size for task in tasks))
    workers = 1 if engine is None else engine.jobs
    waiting = batches(tasks, workers=workers, seconds=BATCH_S if engine else OWN_BATCH_S)
    alone: deque[list[LogTask]] = deque()
    lost: set[str] = set()

    def take() -> list[LogTask] | None:
        batch = alone.popleft() if alone else next(waiting, None)
        if batch is not None:
            count.running += len(batch)
            tell(count)
        return batch

    def told(at_work: int) -> None:
        count.workers = at_work
        tell(count)

    tell(count)
    work = partial(work_on_batch, settings=settings)
    found: Iterator[tuple[list[LogTask], list[LogDone] | Lost]] = (
        _here(take, work)
        if engine is None
        else outcomes(take, work, engine=engine, patience=partial(_patience, settings), told=told)
    )
    for batch, outcome in found:
        count.running -= len(batch)
        if isinstance(outcome, Lost) and (len(batch) > 1 or batch[0].path not in lost):
            _try_alone(batch, alone, lost)
            continue
        logs = _given_up(batch, outcome, settings) if isinstance(outcome, Lost) else outcome
        for task, log in zip(batch, logs, strict=True):
            count.add(log, task.size)
        tell(count)
    return count


def _try_alone(batch: list[LogTask], alone: deque[list[LogTask]], lost: set[str]) -> None:
    """Let the logs of a lost batch be done by themselves: it may have been another's fault.

    One that was alone is noted as lost and gets one more try: it may have been its worker's fault.
    """
    if len(batch) == 1:
        lost.add(batch[0].path)
    alone.extend([task] for task in batch)


def _given_up(batch: list[LogTask], lost: Lost, settings: FleetSettings) -> list[LogDone]:
    """Commit that a batch could not be done."""
    rows = [failure(task, settings, lost.status, f"{task.path}: {lost.reason}") for task in batch]
    commit(rows, settings)
    return [done_of(row) for row in rows]


def _here(
    take: Callable[[], list[LogTask] | None], work: Callable[[list[LogTask]], list[LogDone]]
) -> Iterator[tuple[list[LogTask], list[LogDone] | Lost]]:
    """Yield batches as this process does them, one after the other."""
    try:
        while (batch := take()) is not None:
            yield batch, work(batch)
    finally:
        end_child()


def _patience(settings: FleetSettings, batch: list[LogTask]) -> float:
    # A log whose process ends is tried twice.
    return _MARGIN_S + 2 * sum(settings.patience(task) for task in batch)
