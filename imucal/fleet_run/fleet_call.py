"""A fleet run by a call: what `imucal fleet run` does, without its lines."""

import json
import math
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import polars as pl

from imucal.errors import ArgumentError, ManifestError
from imucal.fleet.store import FleetStore
from imucal.fleet_report import Fleet, load_fleet
from imucal.fleet_run.logs import find_logs, label_pattern
from imucal.fleet_run.on_dask import unprotected
from imucal.fleet_run.plan import (
    LEAST_MEMORY,
    REPORTS,
    Column,
    FleetPlan,
    FleetSettings,
    LogTask,
    as_json,
    labels_in,
    meant,
    plan_fleet,
    read_manifest,
)
from imucal.fleet_run.running import asking, run_plan
from imucal.noise import parse_structure, structure_text
from imucal.resources import memory_there_is, parse_size, threads

#: The share of the machine's memory that all workers may take, and what is taken where none is known.
_SHARE, _UNKNOWN = 0.8, 2 << 30
#: What is expected of an argument, what it means, and whether that may be.
_ARGUMENTS: dict[str, Column] = {
    "model": ("terms, such as N + B + K: auto would choose by the log", str, lambda model: model != "auto"),
    "level": ("one between 0 and 1, such as 0.95", float, lambda level: 0 < level < 1),
    "jobs": ("a number from 1", int, lambda jobs: jobs >= 1),
    "shard": ("(i, n) with i from 1 to n", tuple, lambda part: 1 <= part[0] <= part[1]),
    "memory": (
        f"a size such as 500M or 2G, {LEAST_MEMORY >> 20}M or more",
        lambda size: parse_size(str(size), least=LEAST_MEMORY),
        bool,
    ),
    "timeout_s": ("seconds above 0", float, lambda seconds: 0 < seconds < math.inf),
    "reading": ("arguments of imucal.read", as_json, lambda _: True),
    "reports": (f"one of {', '.join(REPORTS)}", str, REPORTS.__contains__),
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
    names = [str(logs)] if isinstance(logs, str | Path) else [str(log) for log in logs or ()]
    if not names and logs is not None and manifest is None:
        # A pattern that matched nothing, say: it must not become all that the folder has.
        msg = f"logs {logs!r}, expected some; leave them out to go on with those of the folder"
        raise ArgumentError(msg)
    asked = {
        "labels": labels,
        "model": model,
        "level": level,
        "jobs": jobs,
        "scheduler": scheduler,
        "shard": shard,
        "memory": memory,
        "timeout_s": timeout_s,
        "reports": reports,
        "fresh": fresh,
        "reading": reading,
    }
    settings = fleet_settings(folder, asked)
    plan = planned(settings, names, manifest=None if manifest is None else Path(manifest))
    prepare(plan, settings)
    if said := unprotected(scheduler):
        warnings.warn(said, stacklevel=2)
    tell = progress or (lambda _, __: None)
    run_plan(plan, settings, tell=lambda count: tell(count.done, count.logs))
    return load_fleet(folder, ask=asking(settings))


def fleet_settings(folder: str | Path, asked: Mapping[str, Any]) -> FleetSettings:
    """Return the settings of a run: arguments of `run_fleet` by their names, and what holds without them.

    Model and level are those of the fleet that is there, or the usual ones; each worker has its share of the
    memory. A shard does one log at a time.

    Raises
    ------
    ArgumentError
        If one can't be meant, or the fleet has another model or level: it has one for all of its logs.
    StoreError
        If the settings of the fleet that is there are damaged.
    """
    given = {name: _meant(name, value) for name, value in asked.items() if value is not None}
    if "shard" in given and "scheduler" in given:
        msg = "a shard works without a cluster; expected shard or scheduler, not both"
        raise ArgumentError(msg)
    store = FleetStore(Path(folder).absolute())
    kept = {} if given.get("fresh") else store.settings()
    for name in kept.keys() & {"model", "level"}:
        if given.setdefault(name, kept[name]) != kept[name]:
            said = f"holds fits with {name} {kept[name]}, found {given[name]}"
            msg = f"{store.folder}: {said}; choose another folder, or do all logs anew, with --fresh"
            raise ArgumentError(msg)
    given["jobs"] = 1 if "shard" in given else given.get("jobs") or threads()
    memory = int((memory_there_is() or _UNKNOWN) * _SHARE) // given["jobs"]
    return FleetSettings(**{"store": str(store.folder), "folder": str(Path.cwd()), "memory": memory, **given})


def _meant(name: str, said: Any) -> Any:  # noqa: ANN401 - of any argument
    """Return what an argument means."""
    try:
        if name == "model" and said != "auto":
            return structure_text(parse_structure(said))
        if name == "labels":
            label_pattern(said)
    except ValueError as error:
        raise ArgumentError(str(error)) from error
    try:
        return meant(_ARGUMENTS[name], said) if name in _ARGUMENTS else said
    except ValueError as error:
        msg = f"{name} {said!r}, expected {error}"
        raise ArgumentError(msg) from error


def planned(
    settings: FleetSettings,
    names: Collection[str],
    *,
    manifest: Path | None = None,
    dry: bool = False,
    say: Callable[[str], object] = lambda _: None,
) -> FleetPlan:
    """Return what is to be done of the logs that names and a manifest stand for.

    `names` are those of `imucal.fleet_run.logs.find_logs`, `manifest` is a table of logs; what it says of one
    that is named, too, holds. Without both they are the logs that the store's own manifest asks for. Labels
    in the paths of logs that are named, or in the store, go before others that these have.

    What of the store is damaged is removed; a `dry` run refuses it. `say` is told so, and how many paths do
    not fit the labels.

    Raises
    ------
    ReadError
        If wildcards match nothing, a folder holds no log, or there is no store to ask.
    ManifestError
        If the manifest is wrong, or a label is.
    StoreError
        If the store is damaged.
    """
    store = FleetStore(settings.store)
    if not settings.fresh:
        if dry:
            store.refuse_damage()
        for part in store.mend():
            say(f"{part}: is damaged; what it held is done again")
    asked = {log.path: log for log in (read_manifest(manifest) if manifest else ())}
    named = (LogTask(place=name) for name in find_logs(names))
    unlike = 0
    for log in named if names or manifest else _stored_logs(store.manifest()):
        own = labels_in(log.path, settings.labels)
        unlike += not own
        first = asked.setdefault(log.path, replace(log, labels={**log.labels, **own}))
        if first.place != log.place != log.path:
            msg = f"{log.path}: two URLs that differ behind the question mark alone; expected one"
            raise ManifestError(msg)
    if settings.labels and unlike:
        say(f"{unlike} of {len(asked)} logs do not fit {settings.labels}")
    return plan_fleet(asked.values(), settings)


def _stored_logs(manifest: pl.DataFrame) -> Iterator[LogTask]:
    """Yield the logs of a store's manifest."""
    for row in manifest.drop("copy_of").iter_rows(named=True):
        path, reading = row.pop("path"), json.loads(row.pop("options") or "{}")
        labels = {name: value for name, value in row.items() if value is not None}
        yield LogTask(place=path, labels=labels, reading=reading)


def prepare(plan: FleetPlan, settings: FleetSettings) -> None:
    """Make the store, and write down what is asked for.

    Raises
    ------
    WriteError
        If it can't be written.
    """
    store, kept = FleetStore(settings.store), {"model": settings.model, "level": settings.level}
    if settings.fresh and store.exists:
        # They tell whose folder it is, once it has no manifest.
        store.keep_settings(kept)
        store.clear()
    store.create()
    store.keep_settings(kept)
    store.add_to_manifest(plan.manifest())
