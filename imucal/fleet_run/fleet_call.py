"""A fleet run by a call: what `imucal fleet run` does, without its lines."""

import math
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from imucal.fleet.store import FleetStore
from imucal.fleet_report import Fleet, load_fleet
from imucal.fleet_run.logs import LabelPattern
from imucal.fleet_run.on_dask import unprotected
from imucal.fleet_run.plan import (
    LEAST_MEMORY,
    LEVEL,
    MODEL,
    REPORTS,
    FleetPlan,
    FleetSettings,
    as_json,
    asked_logs,
    plan_fleet,
)
from imucal.fleet_run.running import asking, run_plan
from imucal.noise import parse_structure, structure_text
from imucal.resources import memory_there_is, parse_size, threads

#: The share of the machine's memory that all workers may take, and what is taken where none is known.
_SHARE, _UNKNOWN = 0.8, 2 << 30
#: Argument -> which numbers it may be, in code and in words.
_NUMBERS: dict[str, tuple[Callable[[float], bool], str]] = {
    "level": (lambda level: 0 < level < 1, "one between 0 and 1, such as 0.95"),
    "jobs": (lambda jobs: jobs >= 1, "a number from 1"),
    "timeout_s": (lambda seconds: 0 < seconds < math.inf, "seconds above 0"),
}


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
    """Fit the same noise model to every one of many logs, and keep the results in a folder.

    It does what ``imucal fleet run`` does, to the same folder with the same results: what is done is kept,
    the same call again does what is left. Logs that fail are in `Fleet.failures`; they raise nothing.

    Parameters
    ----------
    logs
        Files, folders of any depth, names with wildcards, URLs: one, or several. None, where `manifest` is
        None too: the logs that the folder's manifest asks for.
    folder
        Of the fleet; made where it is missing.
    labels
        Where labels stand in the paths, such as ``{model}/{unit}/*.mcap``.
    manifest
        A table of logs (CSV) with a column ``path``.
    model, level
        Terms, and confidence level of every interval: by default those that the folder has, else
        ``N + B + K`` and 0.95.
    jobs
        How many logs are done at a time, each in a process of its own; by default one a processor.
    scheduler
        Address of a Dask scheduler, whose workers are taken instead; a warning says where others may
        reach it.
    shard
        ``(i, n)``: do part i of n, from 1, log by log; ``(1, 1)`` is all of it.
    memory
        Bytes that a log may take, or a text such as ``2GB``; by default 80 % of the machine's, shared by
        the workers.
    timeout_s
        Seconds that a log may take; by default 300 and 3 for each MB.
    reports
        Which logs get a report of their own: ``none``, ``failed`` or ``all``.
    fresh
        Forget what the folder has.
    reading
        Arguments of `imucal.read`, and ``skip_s`` and ``take_s``, for every log.
    progress
        Called with the number of logs done, and of all to do.

    Returns
    -------
    Fleet
        As `imucal.load_fleet` returns it.

    Raises
    ------
    ValueError
        If an argument can't be meant, or the folder holds fits of another model or level.
    ReadError
        If no log has such a name.
    StoreError
        If what the folder has to be done, its manifest or its settings, is damaged.
    ManifestError
        If the manifest, or a label in a path, is wrong.
    EngineError
        If the workers of a `scheduler` can't be reached or are gone; what is done is kept.
    WriteError
        If the folder can't be written.
    DataError
        If no log was done.

    Notes
    -----
    Logs are done in processes of their own, which load imucal and not the script that calls: so a script
    needs no ``if __name__ == "__main__"``, and a notebook may call this.
    """
    _refuse_slips(reports, level=level, jobs=jobs, timeout_s=timeout_s)
    _refuse_shard(shard, scheduler)
    store = FleetStore(Path(folder).absolute())
    workers = 1 if shard else jobs or threads()
    settings = fleet_settings(
        store,
        model=model and structure_text(parse_structure(model)),
        level=level,
        fresh=fresh,
        workers=workers,
        memory=_memory(memory),
        timeout=timeout_s,
        reports=reports,
        shard=shard,
    )
    if not fresh:
        store.mend()
    asked, _ = asked_logs(
        store,
        _names(logs, needed=logs is not None and manifest is None),
        manifest=None if manifest is None else Path(manifest),
        labels=None if labels is None else LabelPattern(labels),
    )
    plan = plan_fleet(asked, settings, None if fresh else store, reading=as_json(reading or {}))
    plan = plan.shard(*shard) if shard else plan
    prepare(store, plan, settings, fresh=fresh)
    if said := unprotected(scheduler):
        warnings.warn(said, stacklevel=2)
    tell = progress or (lambda _, __: None)
    run_plan(
        plan,
        settings,
        workers=workers,
        scheduler=scheduler,
        tell=lambda count: tell(count.done, count.logs),
    )
    return load_fleet(folder, ask=asking(settings, workers=workers, scheduler=scheduler))


def _refuse_slips(reports: str, **given: float | None) -> None:
    if reports not in REPORTS:
        msg = f"reports {reports!r}, expected one of {', '.join(REPORTS)}"
        raise ValueError(msg)
    for name, number in given.items():
        fits, expected = _NUMBERS[name]
        if number is not None and not fits(number):
            msg = f"{name} {number}, expected {expected}"
            raise ValueError(msg)


def _refuse_shard(shard: tuple[int, int] | None, scheduler: str | None) -> None:
    if shard and not 1 <= shard[0] <= shard[1]:
        msg = f"shard {shard} is no part; expected (i, n) with i from 1 to n"
        raise ValueError(msg)
    if shard and scheduler:
        msg = "a shard works without a cluster; expected shard or scheduler, not both"
        raise ValueError(msg)


def _names(logs: str | Path | Iterable[str | Path] | None, *, needed: bool) -> list[str]:
    names = [str(logs)] if isinstance(logs, str | Path) else [str(log) for log in logs or ()]
    if needed and not names:
        # A pattern that matched nothing, say: it must not become all that the folder has.
        msg = f"logs {logs!r}, expected some; leave them out to go on with those of the folder"
        raise ValueError(msg)
    return names


def _memory(asked: int | str | None) -> int | None:
    """Return bytes, as they are asked for or as a text says them."""
    if asked is None:
        return None
    try:
        return parse_size(str(asked), least=LEAST_MEMORY)
    except ValueError as error:
        msg = f"memory {asked!r}, expected {error}, {LEAST_MEMORY >> 20}M or more"
        raise ValueError(msg) from error


def fleet_settings(
    store: FleetStore,
    *,
    model: str | None,
    level: float | None,
    fresh: bool,
    workers: int,
    memory: int | None,
    timeout: float | None,
    reports: str,
    shard: tuple[int, int] | None,
) -> FleetSettings:
    """Return what holds for every log.

    Where they are not said, model and level are those of the fleet that is there, or the usual ones, and
    each worker has its share of the memory.

    Raises
    ------
    ValueError
        If the fleet that is there has another model or level: it has one structure for all of its logs.
    """
    kept = {} if fresh else store.settings()
    asked = {"model": model, "level": level}
    given = {name: value for name, value in asked.items() if value is not None}
    for name, value in given.items():
        if kept.get(name, value) != value:
            msg = f"{store.folder}: holds fits with {name} {kept[name]}, found {value}"
            raise ValueError(msg)
    every: dict[str, object] = {"model": MODEL, "level": LEVEL, **kept, **given}
    return FleetSettings(
        store=str(store.folder),
        folder=str(Path.cwd()),
        model=str(every["model"]),
        level=float(str(every["level"])),
        memory=memory or int((memory_there_is() or _UNKNOWN) * _SHARE) // workers,
        timeout=timeout,
        reports=reports,
        shard=str(shard[0]) if shard else "0",
    )


def prepare(store: FleetStore, plan: FleetPlan, settings: FleetSettings, *, fresh: bool) -> None:
    """Make the store, and write down what is asked for.

    Raises
    ------
    WriteError
        If it can't be written.
    """
    kept: dict[str, object] = {"model": settings.model, "level": settings.level}
    if fresh and store.exists:
        # They tell whose folder it is, once it has no manifest.
        store.keep_settings(kept)
        store.clear()
    store.create()
    store.keep_settings(kept)
    store.add_to_manifest(plan.manifest())
