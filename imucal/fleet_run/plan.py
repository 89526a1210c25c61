"""The settings and the plan of a fleet run: the requested logs that the store does not contain yet."""

import csv
import hashlib
import json
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import field, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, TypeAlias

import polars as pl

from imucal._version import __version__
from imucal.errors import ArgumentError, Fix, ManifestError, ReadError
from imucal.fleet.store import LABELS, MANIFEST, FleetStore
from imucal.fleet_run.logs import Stamp, content_at, edge_at, find_logs, label_pattern, stamps_of
from imucal.frozen import frozen
from imucal.noise import parse_structure, structure_text
from imucal.recording import Sensor
from imucal.remote import is_url
from imucal.remote.addresses import shown
from imucal.resources import memory_there_is, threads
from imucal.units import parse_increment_unit, parse_sample_unit, time_unit_ns
from imucal.user_input import bytes_of

MODEL, LEVEL = "N + B + K", 0.95
#: Memory of the imported packages and a short log, in bytes.
MIN_MEMORY = 300 << 20
#: Time limit of a log in s: constant, and per megabyte (usual logs need 0.06 s).
PATIENCE, PATIENCE_PER_MB = 300.0, 3.0
#: `imucal.fitting.bins.PACKED_VERSION`, whose import is slow.
_BINS = 2
#: Final states: another attempt would have the same result.
_SETTLED = ("ok", "unreadable", "no-data")
_KNOWN = ("path", "key", "status", "content", "edge", "bytes", "mtime_ns")
#: Usual speed in bytes/s on one core, and additional seconds per log.
_BYTES_PER_S, _SECONDS = 17e6, 1.0
#: Fewest per worker, so that all end together; number in a long run, whose batches may last longer.
_MIN_BATCHES, _BATCHES, _LONGER = 4, 40, 10
_SEVERAL = ("topic", "fields", "message_definition")

#: Description for messages, parser of the text, and test of the parsed value.
Column: TypeAlias = tuple[str, Callable[[Any], Any], Callable[[Any], object]]
State: TypeAlias = Literal["run", "again", "done", "copy"]


@frozen
class LogTask:
    """A requested log and its state.

    `place` is the given path, relative to `FleetSettings.folder`, or a URL with its secrets, which is never
    stored. `reading` contains arguments of `imucal.read`. `size` is in bytes, 0 if
    unknown. A log of another shard is not `own`.

    A log is to ``run``, to run ``again`` after a failure, ``done``, or a ``copy`` of another log, `copy_of`.
    """

    place: str = field(repr=False)
    labels: Mapping[str, str | float] = field(default_factory=dict)
    reading: Mapping[str, Any] = field(default_factory=dict)
    size: int = 0
    state: State = "run"
    copy_of: str | None = None
    own: bool = True

    @property
    def path(self) -> str:
        """Its path, or its URL without secrets."""
        return shown(self.place)

    @property
    def seconds(self) -> float:
        return _SECONDS + self.size / _BYTES_PER_S


@frozen
class FleetSettings:
    """The settings of a run, from the arguments of `imucal.run_fleet`.

    `store` and `folder`, at which relative paths start, are absolute. All fits have the same `model`, because
    models chosen per log would differ although units do not.
    """

    store: str
    folder: str
    model: str = MODEL
    level: float = LEVEL
    reading: Mapping[str, Any] = field(default_factory=dict)
    labels: str | None = None
    jobs: int = 1
    scheduler: str | None = None
    shard: tuple[int, int] = (0, 1)
    memory: int
    timeout_s: float | None = None
    reports: str = "failed"
    fresh: bool = False

    def key(self, content: str, reading: Mapping[str, object]) -> str:
        text = json.dumps([content, self.model, self.level, reading, __version__, _BINS], sort_keys=True)
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    def patience(self, task: LogTask) -> float:
        return self.timeout_s or PATIENCE + PATIENCE_PER_MB * task.size / 1e6


def has_failed(status: object, verdict: object) -> bool:
    """Return whether a log has no usable numbers."""
    return status != "ok" or verdict == "not-noise"


@frozen
class FleetPlan:
    """All requested logs with their states."""

    logs: tuple[LogTask, ...]

    @property
    def tasks(self) -> list[LogTask]:
        return self.own("run", "again")

    def own(self, *states: str) -> list[LogTask]:
        return [log for log in self.logs if log.own and (not states or log.state in states)]

    def manifest(self) -> pl.DataFrame:
        free = sorted({name for log in self.logs for name in log.labels if name not in LABELS})
        reading = (json.dumps(log.reading, sort_keys=True) if log.reading else None for log in self.logs)
        rows = [
            {**log.labels, "path": log.path, "options": options, "copy_of": log.copy_of}
            for log, options in zip(self.logs, reading, strict=True)
        ]
        return pl.DataFrame(rows, schema={**MANIFEST, **dict.fromkeys(free, pl.String())})


def labels_in(path: str, pattern: str | None) -> dict[str, str | float]:
    """Return the labels in a path, or none; raises ManifestError for an invalid label."""
    found = label_pattern(pattern).match(path.replace("\\", "/")) if pattern else None
    columns = {name: _COLUMNS.get(name, _ANY) for name in LABELS}
    return {
        name: meant(columns.get(name, _ANY), text, f"labels: {path}: {name} is", ManifestError)
        for name, text in (found.groupdict() if found else {}).items()
    }


def read_manifest(file: Path) -> list[LogTask]:
    """Read a CSV table with headings and a column ``path``; relative paths start at its folder.

    Raises ManifestError if it can't be read, has no column ``path``, a log twice, or an invalid value.
    """
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            heading, *rows = [[cell.strip() for cell in row] for row in csv.reader(stream)] or [[]]
    except (OSError, UnicodeError, csv.Error) as error:
        problem = f"can't be read ({getattr(error, 'strerror', None) or error}); expected a CSV table"
        raise ManifestError(problem, place=file) from error
    logs: dict[str, LogTask] = {}
    line = 1
    try:
        found = ", ".join(heading) or "nothing"
        once = "path" in heading and len(set(heading)) == len(heading)
        _refuse_unless(once, f"the headings are {found}; expected each once, and 'path' among them")
        for line, row in enumerate(rows, 2):  # noqa: B007 - its errors have it
            if any(row):
                log = _of_row(heading, row, file.parent)
                first = logs.setdefault(log.path, log) is log
                _refuse_unless(first, f"{log.path} is duplicated; expected one row per log")
    except ValueError as error:
        raise ManifestError(f"{file}:{line}: {error}") from error
    return list(logs.values())


def _of_row(heading: Sequence[str], row: Sequence[str], folder: Path) -> LogTask:
    """Return the log of a manifest's row; raises ValueError for a wrong cell."""
    _refuse_unless(len(row) == len(heading), f"{len(row)} cells, expected {len(heading)} as in the headings")
    cells = ((name, text) for name, text in zip(heading, row, strict=True) if text)
    labels = {name: meant(_COLUMNS.get(name, _ANY), text, f"column {name!r} is") for name, text in cells}
    place = labels.pop("path", "")
    _refuse_unless(place, "no path; expected the path of a log")
    reading = {name: labels.pop(name) for name in _COLUMNS if name in labels and name not in LABELS}
    return LogTask(place=place if is_url(place) else str(folder / place), labels=labels, reading=reading)


def _refuse_unless(right: object, text: str) -> None:
    if not right:
        raise ValueError(text)


def meant(column: Column, text: Any, name: str, error: type[Exception] = ValueError) -> Any:  # noqa: ANN401
    """Return the parsed value; raise `error` with the name, the value and what was expected."""
    what, parse, fits = column
    with suppress(ValueError, KeyError, TypeError):
        if fits(value := parse(text)):
            return value
    raise error(f"{name} {text!r}, expected {what}")


def _unit_of(sensor: Sensor, such_as: str) -> Column:
    what = f"a unit of the {sensor}, such as {such_as}"
    return (
        what,
        str,
        lambda text: (parse_sample_unit(text) or parse_increment_unit(text) or (None,))[0] is sensor,
    )


_ANY: Column = ("text", str, bool)
_YES = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
#: Labels, then arguments of `imucal.read`.
_COLUMNS: dict[str, Column] = {
    "temperature_c": ("a number", float, math.isfinite),
    "started": ("a date such as 2026-01-31 or 2026-01-31T12:00:00Z", str, datetime.fromisoformat),
    **dict.fromkeys(("time", "columns"), _ANY),
    "topic": ("text", str.split, bool),
    **dict.fromkeys(("fields", "message_definition"), ("text", lambda text: [text], bool)),
    "time_unit": (
        "a unit such as s, ms, us, ns, min or 100ns",
        str,
        lambda text: time_unit_ns(text) is not None,
    ),
    "gyro_unit": _unit_of(Sensor.GYROSCOPE, "deg/s"),
    "accel_unit": _unit_of(Sensor.ACCELEROMETER, "g"),
    "strict": ("true or false", lambda text: _YES[text.lower()], lambda _: True),
    "skip_s": ("a time in s, 0 or more", float, lambda value: 0 <= value < math.inf),
    **dict.fromkeys(
        ("rate_hz", "gyro_scale", "accel_scale", "take_s"),
        ("a number above 0", float, lambda value: 0 < value < math.inf),
    ),
}


def as_json(reading: Mapping[str, object]) -> dict[str, object]:
    """Return arguments of `imucal.read` as JSON values for the key of a result, without empty values."""
    result: dict[str, Any] = {}
    for name, value in reading.items():
        plain: Any = str(value) if isinstance(value, Path) else value
        if name in _SEVERAL:
            several = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
            plain = [str(one) for one in several if one]
        if plain or (plain == 0 and plain is not False and name != "skip_s"):
            result[name] = plain
    return result


#: Share of the machine's memory for all workers; its memory in bytes if unknown.
_SHARE, _UNKNOWN = 0.8, 2 << 30
_ARGUMENTS: dict[str, Column] = {
    "model": ("terms, such as N + B + K: auto depends on the log", str, lambda model: model != "auto"),
    "level": ("one between 0 and 1, such as 0.95", float, lambda level: 0 < level < 1),
    "jobs": ("a number from 1", int, lambda jobs: jobs >= 1),
    "shard": ("(i, n) with i from 1 to n", tuple, lambda part: 1 <= part[0] <= part[1]),
    "memory": (
        f"a size such as 500M or 2G, {MIN_MEMORY >> 20}M or more",
        lambda size: bytes_of(str(size), least=MIN_MEMORY),
        bool,
    ),
    "timeout_s": ("seconds above 0", float, lambda seconds: 0 < seconds < math.inf),
    "reading": ("arguments of imucal.read", as_json, lambda _: True),
    "reports": ("one of none, failed, all", str, ("none", "failed", "all").__contains__),
}
ASKED = (*_ARGUMENTS, "labels", "scheduler", "fresh")


def fleet_settings(folder: str | Path, asked: Mapping[str, Any]) -> FleetSettings:
    """Return the settings of a run from the arguments of `run_fleet` and the settings of an existing fleet.

    Raises ArgumentError if an argument is invalid, or if the fleet has another model or level; StoreError if
    its settings are damaged.
    """
    given = {name: _meant(name, value) for name, value in asked.items() if value is not None}
    if "shard" in given and "scheduler" in given:
        raise ArgumentError("a shard works without a cluster; expected shard or scheduler, not both")
    store = FleetStore(Path(folder).absolute())
    kept = {} if given.get("fresh") else store.settings()
    for name in kept.keys() & {"model", "level"}:
        if given.setdefault(name, kept[name]) != kept[name]:
            problem = f"contains fits with {name} {kept[name]}, found {given[name]}"
            fix = Fix("choose another folder, or repeat all logs with --fresh")
            raise ArgumentError(problem, place=store.folder, fix=fix)
    given["jobs"] = 1 if "shard" in given else given.get("jobs") or threads()
    memory = int((memory_there_is() or _UNKNOWN) * _SHARE) // given["jobs"]
    return FleetSettings(**{"store": str(store.folder), "folder": str(Path.cwd()), "memory": memory, **given})


def _meant(name: str, value: Any) -> Any:  # noqa: ANN401 - of any argument
    if name == "labels":
        label_pattern(value)
    try:
        if name == "model" and value != "auto":
            return structure_text(parse_structure(value))
    except ValueError as error:
        raise ArgumentError(str(error)) from error
    return meant(_ARGUMENTS[name], value, name, ArgumentError) if name in _ARGUMENTS else value


def planned(
    settings: FleetSettings,
    names: Collection[str],
    *,
    manifest: Path | None = None,
    dry: bool = False,
    notify: Callable[[str], object] = lambda _: None,
) -> FleetPlan:
    """Return the plan for the logs of `names` (see `find_logs`) and of a `manifest`, which has priority.

    Without both, the logs of the store's manifest are used. Damaged parts of the store are removed; a `dry`
    run raises StoreError instead. Raises ReadError if there are no logs or no store; ManifestError if the
    manifest or a label is wrong.
    """
    store = FleetStore(settings.store)
    if not settings.fresh:
        if dry:
            store.refuse_damage()
        for part in store.mend():
            notify(f"{part}: is damaged; its logs are repeated")
    asked = {log.path: log for log in (read_manifest(manifest) if manifest else ())}
    named = (LogTask(place=name) for name in find_logs(names))
    unlike = 0
    for log in named if names or manifest else _stored_logs(store.manifest()):
        own = labels_in(log.path, settings.labels)
        unlike += not own
        first = asked.setdefault(log.path, replace(log, labels={**log.labels, **own}))
        if first.place != log.place != log.path:
            problem = "two URLs that differ only after the question mark; expected one"
            raise ManifestError(problem, place=log.path)
    if settings.labels and unlike:
        notify(f"{unlike} of {len(asked)} logs do not match {settings.labels}")
    return plan_fleet(asked.values(), settings)


def _stored_logs(manifest: pl.DataFrame) -> Iterator[LogTask]:
    for row in manifest.drop("copy_of").iter_rows(named=True):
        path, reading = row.pop("path"), json.loads(row.pop("options") or "{}")
        labels = {name: value for name, value in row.items() if value is not None}
        yield LogTask(place=path, labels=labels, reading=reading)


def plan_fleet(asked: Collection[LogTask], settings: FleetSettings) -> FleetPlan:
    """Return the plan for requested logs with different paths; raises StoreError.

    The logs of a shard do not depend on finished logs, so shards may start at any time.
    """
    known = [] if settings.fresh else FleetStore(settings.store).logs().select(_KNOWN).rows(named=True)
    settled = {log["key"]: log["path"] for log in known if log["content"] and log["status"] in _SETTLED}
    failed = {log["path"] for log in known}.difference(settled.values())
    places = {log.path: log.place for log in asked}
    stamps = stamps_of(places)
    contents = _contents(stamps, places, known)
    part, parts = settings.shard
    first: dict[str, str] = {}
    logs = []
    for number, (path, log) in enumerate(zip(places, asked, strict=True), 1):
        reading = {**settings.reading, **log.reading}
        # A log with unique content has a key from its path.
        key = settings.key(contents.get(path, f"path:{path}"), reading)
        other = settled.get(key) or first.setdefault(key, path)
        size, copy_of = stamps[path].size if path in stamps else 0, None if other == path else other
        to_do: State = "again" if path in failed else "run"
        state: State = "done" if key in settled else "copy" if copy_of else to_do
        own = (number - part) % parts == 0
        logs.append(replace(log, reading=reading, size=size, state=state, copy_of=copy_of, own=own))
    return FleetPlan(logs=tuple(logs))


def _contents(
    stamps: Mapping[str, Stamp], places: Mapping[str, str], known: Sequence[Mapping[str, Any]]
) -> dict[str, str]:
    """Return the known checksums, and those of logs that may be equal to others."""
    done = {(log["path"], log["bytes"], log["mtime_ns"]): log for log in known if log["content"]}
    found = {path: done.get((path, *stamp)) for path, stamp in stamps.items()}
    contents: dict[str, str] = {path: log["content"] for path, log in found.items() if log}
    new = [path for path in stamps if path not in contents]
    sizes = Counter([*(stamps[path].size for path in new), *{log["bytes"] for log in done.values()}])
    edges = {}
    for path in new:
        if sizes[stamps[path].size] > 1:
            with suppress(OSError, ReadError):
                edges[path] = edge_at(places[path])
    counts = Counter([*edges.values(), *{log["edge"] for log in done.values()}])
    for path, edge in edges.items():
        if counts[edge] > 1:
            with suppress(OSError, ReadError):
                contents[path] = content_at(places[path])
    return contents


def batches(tasks: Sequence[LogTask], *, workers: int, seconds: float) -> Iterator[list[LogTask]]:
    """Yield tasks in batches of about `seconds` each; shorter if workers would be idle otherwise."""
    total = sum(task.seconds for task in tasks)
    longer = min(total / (_BATCHES * workers), _LONGER * seconds)
    target = min(max(seconds, longer), total / (_MIN_BATCHES * workers))
    batch: list[LogTask] = []
    expected = 0.0
    for task in tasks:
        batch.append(task)
        expected += task.seconds
        if expected >= target or task is tasks[-1]:
            yield batch
            batch, expected = [], 0.0
