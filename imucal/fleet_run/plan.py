"""The logs that are asked for, less those that the store has: what is to be done of a fleet.

They are named by hand, or by a manifest: a table of text, one row a log. Equal contents are done once.
"""

import csv
import hashlib
import itertools
import json
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any, TypeAlias

import polars as pl

from imucal._version import __version__
from imucal.errors import ManifestError, ReadError
from imucal.fleet.store import LABELS, MANIFEST, FleetStore
from imucal.fleet_run.logs import LabelPattern, Stamp, content_at, edge_at, find_logs, stamps_of
from imucal.recording import Sensor
from imucal.remote import is_url
from imucal.remote.addresses import shown
from imucal.units import parse_sample_unit

#: Model and level of a fleet that says nothing else.
MODEL, LEVEL = "N + B + K", 0.95
#: Which logs get a report of their own.
REPORTS = ("none", "failed", "all")
#: Bytes that the packages take which read and fit a log, and a short log.
LEAST_MEMORY = 300 << 20
#: Seconds that a log may take, and more for each megabyte; usual ones take 0.06 s for each.
PATIENCE, PATIENCE_PER_MB = 300.0, 3.0
#: How logs end for good: another try would end the same, as their content, settings and version do.
_SETTLED = ("ok", "unreadable", "no-data")
#: What is asked of the store about a log.
_KNOWN = ("path", "key", "status", "content", "edge", "bytes", "mtime_ns")
#: Usual bytes of a log a second on one core, and seconds that each takes besides.
_BYTES_PER_S, _SECONDS = 17e6, 1.0
#: Batches of each worker: at least so many, so that all workers end together; and so many in a long run,
#: for which a batch may last `_LONGER` times as long.
_LEAST_BATCHES, _BATCHES, _LONGER = 4, 40, 10
#: Arguments of `imucal.read` that may be several texts.
_SEVERAL = ("topic", "fields", "message_definition")


@dataclass(frozen=True, slots=True, kw_only=True)
class LogTask:
    """A log that is asked for.

    `place` is a path as it was given, relative to `FleetSettings.folder`, or a URL with its secrets, which is
    never stored. `labels` are those of the store and free ones, without what is not known. `reading` has
    arguments of `imucal.read`, ``skip_s`` and ``take_s`` as JSON values; `size` is in bytes, 0 where unknown.
    """

    place: str = field(repr=False)
    labels: Mapping[str, str | float] = field(default_factory=dict)
    reading: Mapping[str, object] = field(default_factory=dict)
    size: int = 0

    @property
    def path(self) -> str:
        """Its path; of a URL what may be shown of it."""
        return shown(self.place)


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSettings:
    """What holds for every log of a fleet.

    `store` is its folder, and relative paths begin at `folder`, both absolute. `model` and `level` are of
    every fit: a structure chosen by the log would make logs differ where units do not. A log may take
    `memory` bytes and `timeout` seconds, None for a time by its size. `reports` is one of `REPORTS`; `shard`
    stands in the names of the parts.
    """

    store: str
    folder: str
    model: str = MODEL
    level: float = LEVEL
    memory: int
    timeout: float | None = None
    reports: str = "failed"
    shard: str = "0"

    def key(self, content: str, reading: Mapping[str, object]) -> str:
        """Return the key of a result: it changes with the content, the settings and the version."""
        said = json.dumps([content, self.model, self.level, reading, __version__], sort_keys=True)
        return hashlib.blake2b(said.encode(), digest_size=16).hexdigest()

    def patience(self, task: LogTask) -> float:
        """Return how many seconds a log may take."""
        if self.timeout is not None:
            return self.timeout
        return PATIENCE + PATIENCE_PER_MB * task.size / 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class LogDone:
    """How a log ended, for those who count; as in the store."""

    path: str
    status: str
    reason: str = ""
    verdict: str = ""

    @property
    def failed(self) -> bool:
        """Whether it gave no numbers that may be used."""
        return has_failed(self.status, self.verdict)


def has_failed(status: str | None, verdict: str | None) -> bool:
    """Return whether a log gave no numbers that may be used: it could not be analysed, or is not noise."""
    return status != "ok" or verdict == "not-noise"


def asked_logs(
    store: FleetStore,
    names: Collection[str],
    *,
    listed: Iterable[str] = (),
    manifest: Path | None = None,
    labels: LabelPattern | None = None,
) -> tuple[list[LogTask], int]:
    """Return the logs that names and a manifest stand for, and how many names do not fit the labels.

    Each path stands there once: those of the manifest, then those that were named. Without names and
    manifest they are the logs that the store's own manifest asks for.

    Parameters
    ----------
    store
        Of the fleet.
    names, listed
        As `imucal.fleet_run.logs.find_logs` takes them.
    manifest
        A table of logs; what it says of one that is named, too, holds.
    labels
        Where labels stand in the paths of those that are named, or in the store.

    Raises
    ------
    ReadError
        If wildcards match nothing, a folder holds no log, or there is no store to ask.
    ManifestError
        If the manifest is wrong, or a label is.
    """
    if not names and manifest is None:
        return _stored_logs(store.manifest(), labels)
    found = {log.path: log for log in (read_manifest(manifest) if manifest else [])}
    unlike = 0
    for name in find_logs(names, listed):
        path = shown(name)
        log = LogTask(place=name, labels=_labels_in(path, labels))
        unlike += labels is not None and not log.labels
        if found.setdefault(path, log).place != name != path:
            msg = f"{path}: two URLs that differ behind the question mark alone; expected one"
            raise ManifestError(msg)
    return list(found.values()), unlike


def _stored_logs(manifest: pl.DataFrame, labels: LabelPattern | None) -> tuple[list[LogTask], int]:
    """Return a manifest's logs, and how many do not fit; labels in paths go before those that it has."""
    logs, unlike = [], 0
    for row in manifest.drop("copy_of").iter_rows(named=True):
        path, options = row.pop("path"), row.pop("options")
        own = _labels_in(path, labels)
        unlike += labels is not None and not own
        kept = {name: value for name, value in row.items() if value is not None}
        logs.append(LogTask(place=path, labels={**kept, **own}, reading=json.loads(options or "{}")))
    return logs, unlike


def _labels_in(path: str, pattern: LabelPattern | None) -> dict[str, str | float]:
    labels: dict[str, str | float] = {}
    for name, text in ((pattern.of(path) if pattern else None) or {}).items():
        try:
            labels[name] = _meant(name, text) if name in _OF_LABELS else text
        except ValueError as error:
            msg = f"labels: {path}: {name} is {text!r}, expected {error}"
            raise ManifestError(msg) from error
    return labels


def read_manifest(file: Path) -> list[LogTask]:
    """Read a manifest: comma-separated, with headings, of which ``path`` is needed.

    A relative path begins at the manifest's folder.

    Raises
    ------
    ManifestError
        If it can't be read, has no column ``path``, a log twice, or a value that can't be meant.
    """
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            rows = list(csv.reader(stream))
    except (OSError, UnicodeError, csv.Error) as error:
        msg = f"{file}: can't be read ({getattr(error, 'strerror', None) or error}); expected a CSV table"
        raise ManifestError(msg) from error
    heading = [name.strip() for name in rows[0]] if rows else []
    if "path" not in heading or len(set(heading)) < len(heading):
        found = ", ".join(heading) or "nothing"
        msg = f"{file}:1: the headings are {found}; expected each once, and 'path' among them"
        raise ManifestError(msg)
    logs: dict[str, LogTask] = {}
    for line, row in enumerate(rows[1:], 2):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(heading):
            msg = f"{file}:{line}: {len(row)} cells, expected {len(heading)} as in the headings"
            raise ManifestError(msg)
        log = _of_row(dict(zip(heading, map(str.strip, row), strict=True)), file, line)
        if log.path in logs:
            msg = f"{file}:{line}: {log.path} stands twice; expected one row a log"
            raise ManifestError(msg)
        logs[log.path] = log
    return list(logs.values())


def _of_row(cells: dict[str, str], file: Path, line: int) -> LogTask:
    place = cells.pop("path")
    if not place:
        msg = f"{file}:{line}: no path; expected that of a log"
        raise ManifestError(msg)
    said: dict[str, Any] = {}
    for name, text in cells.items():
        if text:
            try:
                said[name] = _meant(name, text)
            except ValueError as error:
                msg = f"{file}:{line}: column {name!r} is {text!r}, expected {error}"
                raise ManifestError(msg) from error
    place = place if is_url(place) else str(file.parent / place)
    reading = {name: said.pop(name) for name in _READING if name in said}
    return LogTask(place=place, labels=said, reading=reading)


def _meant(column: str, text: str) -> Any:  # noqa: ANN401 - what the column holds
    """Return a label, or an argument of `imucal.read`; raise ValueError with what is expected of it."""
    what, parse, fits = (_OF_LABELS | _READING).get(column, _ANY)
    with suppress(ValueError, KeyError):
        if fits(value := parse(text)):
            return value
    raise ValueError(what)


def _unit_of(sensor: Sensor, such_as: str) -> "_Column":
    what = f"a unit of the {sensor}, such as {such_as}"
    return what, str, lambda text: (parse_sample_unit(text) or (None,))[0] is sensor


#: What is expected of a column, what its text means, and whether that may be.
_Column: TypeAlias = tuple[str, Callable[[str], Any], Callable[[Any], bool]]
_ANY: _Column = ("text", str, bool)
_SEVERAL_TEXTS: _Column = ("text", lambda text: [text], bool)
_POSITIVE: _Column = ("a number above 0", float, lambda value: 0 < value < math.inf)
_YES = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
_OF_LABELS: dict[str, _Column] = {
    "temperature_c": ("a number", float, math.isfinite),
    "started": (
        "a date such as 2026-01-31 or 2026-01-31T12:00:00Z",
        str,
        lambda text: datetime.fromisoformat(text).year > 0,
    ),
}
#: Columns that are arguments of `imucal.read`.
_READING: dict[str, _Column] = {
    "topic": ("text", str.split, bool),
    "time": _ANY,
    "time_unit": ("s, ms, us or ns", str, {"s", "ms", "us", "ns"}.__contains__),
    "rate_hz": _POSITIVE,
    "gyro_unit": _unit_of(Sensor.GYROSCOPE, "deg/s"),
    "accel_unit": _unit_of(Sensor.ACCELEROMETER, "g"),
    "gyro_scale": _POSITIVE,
    "accel_scale": _POSITIVE,
    "columns": _ANY,
    "fields": _SEVERAL_TEXTS,
    "message_definition": _SEVERAL_TEXTS,
    "strict": ("true or false", lambda text: _YES[text.lower()], lambda _: True),
    "skip_s": ("a time in s, 0 or more", float, lambda value: 0 <= value < math.inf),
    "take_s": _POSITIVE,
}


def as_json(reading: Mapping[str, object]) -> dict[str, object]:
    """Return arguments of `imucal.read` as JSON values, as the key of a result has them.

    What is empty, off, or skips nothing is left out: it is as if it were not said. Any other 0 stays, which
    reading refuses.
    """
    said: dict[str, Any] = {}
    for name, value in reading.items():
        if name in _SEVERAL:
            several = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
            said[name] = [str(one) for one in several if one]
        else:
            said[name] = str(value) if isinstance(value, Path) else value
    return {
        name: value
        for name, value in said.items()
        if value or (value == 0 and value is not False and name != "skip_s")
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetPlan:
    """What is to be done: of the logs asked for, `entries`, those to do are `tasks`.

    By their paths, the store has those `done`; `again` are to do and failed before, as by time or memory;
    `copies` leads to the log with the same content, which is done or to do; for its `own` this run answers:
    all of them, or those of its shard.
    """

    entries: tuple[LogTask, ...]
    tasks: tuple[LogTask, ...]
    done: tuple[str, ...]
    again: tuple[str, ...]
    copies: dict[str, str]
    own: tuple[str, ...]

    def manifest(self) -> pl.DataFrame:
        """Return the rows for the store's manifest."""
        free = sorted({name for e in self.entries for name in e.labels if name not in LABELS})
        rows = [
            {
                **dict.fromkeys((*MANIFEST, *free)),
                **entry.labels,
                "path": entry.path,
                "options": json.dumps(entry.reading, sort_keys=True) if entry.reading else None,
                "copy_of": self.copies.get(entry.path),
            }
            for entry in self.entries
        ]
        return pl.DataFrame(rows, schema={**MANIFEST, **dict.fromkeys(free, pl.String())})

    def shard(self, number: int, of: int) -> "FleetPlan":
        """Return the part number 1 … `of` of the logs.

        Which these are does not change with what is done, so that shards may start at any time.
        """
        own = dict.fromkeys(entry.path for entry in self.entries[number - 1 :: of])
        done, again = (tuple(filter(own.__contains__, paths)) for paths in (self.done, self.again))
        tasks = tuple(task for task in self.tasks if task.path in own)
        return replace(self, own=tuple(own), tasks=tasks, done=done, again=again)

    def seconds(self) -> float:
        """Return how long the tasks usually take on one core, in s."""
        return sum(expected_seconds(task) for task in self.tasks)


def plan_fleet(
    entries: Sequence[LogTask],
    settings: FleetSettings,
    store: FleetStore | None,
    *,
    reading: Mapping[str, object] | None = None,
) -> FleetPlan:
    """Return what of some logs is to be done.

    Parameters
    ----------
    entries
        The logs asked for, each path once.
    settings, store
        Of the fleet; the store need not be there yet, and None has nothing.
    reading
        How to read every log, but for what its entry says.

    Raises
    ------
    StoreError
        If the store is damaged.
    """
    known = store.logs().select(_KNOWN).rows(named=True) if store else []
    logs, keys = _keyed(entries, reading, settings, known)
    settled = {log["key"]: log["path"] for log in filter(_is_settled, known)}
    failed = {log["path"] for log in itertools.filterfalse(_is_settled, known)}
    # The first of equal contents counts, if none is done.
    first: dict[str, str] = {}
    counted = {path: settled.get(key) or first.setdefault(key, path) for path, key in keys.items()}
    done = tuple(path for path, key in keys.items() if key in settled)
    copies = {path: other for path, other in counted.items() if other != path}
    out = {*done, *copies}
    tasks = tuple(task for path, task in logs.items() if path not in out)
    return FleetPlan(
        entries=tuple(logs.values()),
        tasks=tasks,
        done=done,
        again=tuple(task.path for task in tasks if task.path in failed),
        copies=copies,
        own=tuple(logs),
    )


def _is_settled(log: Mapping[str, Any]) -> bool:
    return bool(log["content"]) and log["status"] in _SETTLED


def _keyed(
    entries: Sequence[LogTask],
    reading: Mapping[str, object] | None,
    settings: FleetSettings,
    known: Sequence[Mapping[str, Any]],
) -> tuple[dict[str, LogTask], dict[str, str]]:
    """Return logs with their sizes and how to read them, and the keys of their results, by path."""
    places = {entry.path: entry.place for entry in entries}
    stamps = {path: stamp for path, stamp in stamps_of(places).items() if stamp}
    contents = _contents(stamps, places, known)
    logs, keys = {}, {}
    for entry in entries:
        path, own = entry.path, {**(reading or {}), **entry.reading}
        logs[path] = replace(entry, reading=own, size=stamps[path].size if path in stamps else 0)
        # A log whose content is like no other's has a key of its path.
        keys[path] = settings.key(contents.get(path, f"path:{path}"), own)
    return logs, keys


def _contents(
    stamps: Mapping[str, Stamp], places: Mapping[str, str], known: Sequence[Mapping[str, Any]]
) -> dict[str, str]:
    """Return checksums of the contents that are known, or that may be those of other logs."""
    done = {(log["path"], log["bytes"], log["mtime_ns"]): log for log in known if log["content"]}
    found = {path: done.get((path, stamp.size, stamp.mtime_ns)) for path, stamp in stamps.items()}
    contents: dict[str, str] = {path: log["content"] for path, log in found.items() if log}
    new = [path for path in stamps if path not in contents]
    sizes = Counter([*(stamps[path].size for path in new), *{log["bytes"] for log in done.values()}])
    edges = {}
    for path in new:
        if sizes[stamps[path].size] > 1:
            with suppress(OSError, ReadError):
                edges[path] = edge_at(places[path])
    alike = Counter([*edges.values(), *{log["edge"] for log in done.values()}])
    for path, edge in edges.items():
        if alike[edge] > 1:
            with suppress(OSError, ReadError):
                contents[path] = content_at(places[path])
    return contents


def expected_seconds(task: LogTask) -> float:
    """Return how long a log usually takes on one core, in s."""
    return _SECONDS + task.size / _BYTES_PER_S


def batches(tasks: Sequence[LogTask], *, workers: int, seconds: float) -> Iterator[list[LogTask]]:
    """Yield tasks in batches of about so many seconds each; of fewer where that would leave workers idle.

    In a long run they are longer: a batch is a part of the store, and all parts are read at its end.
    """
    total = sum(expected_seconds(task) for task in tasks)
    longer = min(total / (_BATCHES * workers), _LONGER * seconds)
    target = min(max(seconds, longer), total / (_LEAST_BATCHES * workers))
    batch: list[LogTask] = []
    expected = 0.0
    for task in tasks:
        batch.append(task)
        expected += expected_seconds(task)
        if expected >= target or task is tasks[-1]:
            yield batch
            batch, expected = [], 0.0
