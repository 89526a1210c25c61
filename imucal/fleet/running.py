"""Run a fleet: plan it, do its logs on this machine or on a cluster, and append their rows to the store."""

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from imucal.errors import ArgumentError
from imucal.fleet.engines import Done, on_this_machine
from imucal.fleet.logs import LogTask
from imucal.fleet.on_dask import on_dask, unprotected
from imucal.fleet.plan import ASKED, FleetPlan, FleetSettings, fleet_settings, has_failed, planned
from imucal.fleet.store import RunFile
from imucal.fleet.summary import Fleet, load_fleet


@dataclass
class RunCount:
    """The progress of a run: numbers of logs, and sizes in bytes; `failed` logs have no usable numbers."""

    logs: int
    size: int
    done: int = 0
    failed: int = 0
    running: int = 0
    done_size: int = 0


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
    if warning := unprotected(scheduler):
        warnings.warn(warning, stacklevel=2)
    done = progress or (lambda _, __: None)
    run_plan(plan, settings, progress=lambda count: done(count.done, count.logs))
    return load_fleet(folder)


def run_plan(
    plan: FleetPlan, settings: FleetSettings, *, progress: Callable[[RunCount], object] = lambda _: None
) -> RunCount:
    """Do the logs of a plan and append them to the store; `progress` is called whenever the count changes.

    Raises WriteError, and EngineError if the workers of a cluster can't be reached or ended.
    """
    tasks = plan.tasks
    count = RunCount(logs=len(tasks), size=sum(task.size for task in tasks))

    def started() -> Iterator[LogTask]:
        for task in tasks:
            count.running += 1
            progress(count)
            yield task

    with run_file(plan, settings) or nullcontext() as file:
        if file is None or not tasks:
            return count
        progress(count)
        done: Iterator[Done]
        done = on_dask(tasks, settings) if settings.scheduler else on_this_machine(started(), settings)
        for task, row in done:
            file.add(row)
            count.running = max(count.running - 1, 0)
            count.done += 1
            count.done_size += task.size
            count.failed += has_failed(row["status"], row["verdict"])
            progress(count)
    return count


def run_file(plan: FleetPlan, settings: FleetSettings) -> RunFile | None:
    """Return the new file of a run with its first line; None if the store needs none. Raises WriteError."""
    stored = plan.stored
    asked = plan.asked()
    folder = Path(settings.store)
    if stored is not None and not (asked or plan.tasks or stored.damaged):
        return None
    file = RunFile(folder, settings.of_fits, asked, stored.damaged if stored else ())
    if settings.fresh:
        file.forget_others()
    return file
