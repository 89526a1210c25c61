"""Logs asked for, less those that the store has -> what is to be done; equal contents are done once.

The manifest of a fleet, a table of text: one row a log, with its labels and how to read it.

What a person asks for, logs with their labels -> entries of a manifest.

What is to be done of a fleet: one log each, and what holds for all of them.
"""

import csv
import hashlib
import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

import polars as pl

from imucal._version import __version__
from imucal.errors import ManifestError, ReadError
from imucal.fleet.store import MANIFEST, FleetStore
from imucal.fleet_run.logs import LabelPattern, Stamp, content_at, edge_at, find_logs, stamps_of
from imucal.recording import Sensor
from imucal.remote import is_url
from imucal.remote.addresses import shown
from imucal.units import parse_sample_unit

#: Labels that mean something; other columns are kept as text.
LABELS = ("model", "unit", "temperature_c", "started")


@dataclass(frozen=True, slots=True, kw_only=True)
class LogEntry:
    """A log that is asked for.

    Attributes
    ----------
    path
        Of the log; of a URL what may be shown of it.
    labels
        Its own ones (`LABELS`) and free ones; what is not known is missing.
    reading
        How to read it, where that differs from the other logs.
    url
        Where it is, if that is more than the path may show: a URL with its query, which is never stored.
    """

    path: str
    labels: Mapping[str, str | float] = field(default_factory=dict)
    reading: Mapping[str, object] = field(default_factory=dict)
    url: str = field(default="", repr=False)

    @property
    def place(self) -> str:
        """Where it is: a path, or a URL with its secrets."""
        return self.url or self.path


def shown_and_url(name: str) -> tuple[str, str]:
    """Return what may be shown of a log's name, and the URL where that is more."""
    return shown(name), name if shown(name) != name else ""


def read_manifest(file: Path) -> list[LogEntry]:
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
    entries: dict[str, LogEntry] = {}
    for line, row in enumerate(rows[1:], 2):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(heading):
            msg = f"{file}:{line}: {len(row)} cells, expected {len(heading)} as in the headings"
            raise ManifestError(msg)
        values = {name: cell.strip() for name, cell in zip(heading, row, strict=True) if cell.strip()}
        entry = _entry(values, file, line)
        if entry.path in entries:
            msg = f"{file}:{line}: {entry.path} stands twice; expected one row a log"
            raise ManifestError(msg)
        entries[entry.path] = entry
    return list(entries.values())


def stored_entries(manifest: "pl.DataFrame") -> list[LogEntry]:
    """Return the logs that a store's manifest asks for."""
    entries = []
    for row in manifest.iter_rows(named=True):
        path, options = row.pop("path"), row.pop("options")
        row.pop("copy_of")
        labels = {name: value for name, value in row.items() if value is not None}
        entries.append(LogEntry(path=path, labels=labels, reading=json.loads(options or "{}")))
    return entries


def label_of(name: str, text: str) -> str | float:
    """Return a label as a value.

    Raises
    ------
    ValueError
        If it can't be meant; says what is expected.
    """
    return _VALUES.get(name, str)(text)


def _entry(values: dict[str, str], file: Path, line: int) -> LogEntry:
    if "path" not in values:
        msg = f"{file}:{line}: no path; expected that of a log"
        raise ManifestError(msg)
    path, url = shown_and_url(values.pop("path"))
    if not is_url(path):
        path = str(file.parent / path)
    labels: dict[str, str | float] = {}
    reading: dict[str, object] = {}
    for name, text in values.items():
        try:
            if name in _READING:
                reading[name] = _READING[name](text)
            else:
                labels[name] = label_of(name, text)
        except ValueError as error:
            msg = f"{file}:{line}: column {name!r} is {text!r}, expected {error}"
            raise ManifestError(msg) from error
    return LogEntry(path=path, labels=labels, reading=reading, url=url)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        msg = "a number"
        raise ValueError(msg)
    return value


def _positive(text: str) -> float:
    value = _number(text)
    if value <= 0:
        msg = "a number above 0"
        raise ValueError(msg)
    return value


def _duration(text: str) -> float:
    value = _number(text)
    if value < 0:
        msg = "a time in s, 0 or more"
        raise ValueError(msg)
    return value


def _date(text: str) -> str:
    try:
        datetime.fromisoformat(text)
    except ValueError:
        msg = "a date such as 2026-01-31 or 2026-01-31T12:00:00Z"
        raise ValueError(msg) from None
    return text


def _yes(text: str) -> bool:
    known = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
    if text.lower() not in known:
        msg = "true or false"
        raise ValueError(msg)
    return known[text.lower()]


def _unit_of(sensor: Sensor) -> Callable[[str], str]:
    def check(text: str) -> str:
        found = parse_sample_unit(text)
        if found is None or found[0] is not sensor:
            msg = f"a unit of the {sensor}, such as {'deg/s' if sensor is Sensor.GYROSCOPE else 'g'}"
            raise ValueError(msg)
        return text

    return check


def _time_unit(text: str) -> str:
    if text not in {"s", "ms", "us", "ns"}:
        msg = "s, ms, us or ns"
        raise ValueError(msg)
    return text


#: Column -> what its text means as an argument of `imucal.read`.
_READING: dict[str, Callable[[str], object]] = {
    "topic": str.split,
    "time": str,
    "time_unit": _time_unit,
    "rate_hz": _positive,
    "gyro_unit": _unit_of(Sensor.GYROSCOPE),
    "accel_unit": _unit_of(Sensor.ACCELEROMETER),
    "gyro_scale": _positive,
    "accel_scale": _positive,
    "columns": str,
    "fields": lambda text: [text],
    "message_definition": lambda text: [text],
    "strict": _yes,
    "skip_s": _duration,
    "take_s": _positive,
}
_VALUES: dict[str, Callable[[str], str | float]] = {"temperature_c": _number, "started": _date}


#: Arguments of `imucal.read` that may be several texts.
_SEVERAL = ("topic", "fields", "message_definition")


@dataclass(frozen=True, slots=True, kw_only=True)
class AskedLogs:
    """Logs asked for.

    Attributes
    ----------
    entries
        Each path once: those of the manifest, then those that were named.
    unlike
        How many of those that were named, or stored where none is, the pattern of labels does not fit.
    """

    entries: tuple[LogEntry, ...]
    unlike: int = 0


def asked_logs(
    names: Iterable[str],
    *,
    listed: Iterable[str] = (),
    manifest: Path | None = None,
    labels: LabelPattern | None = None,
) -> AskedLogs:
    """Return the logs that names and a manifest stand for, with their labels.

    Parameters
    ----------
    names, listed
        As `imucal.fleet_run.logs.find_logs` takes them.
    manifest
        A table of logs; what it says of one that is named, too, holds.
    labels
        Where labels stand in the paths of those that are named.

    Raises
    ------
    ReadError
        If wildcards match nothing, or a folder holds no log.
    ManifestError
        If the manifest is wrong, or a label is.
    """
    found = {entry.path: entry for entry in (read_manifest(manifest) if manifest else [])}
    unlike = 0
    for name in find_logs(names, listed):
        entry = _asked_logs_entry(name, labels)
        unlike += labels is not None and not entry.labels
        if found.setdefault(entry.path, entry).url != entry.url and entry.url:
            msg = f"{entry.path}: two URLs that differ behind the question mark alone; expected one"
            raise ManifestError(msg)
    return AskedLogs(entries=tuple(found.values()), unlike=unlike)


def stored_logs(manifest: "pl.DataFrame", labels: LabelPattern | None = None) -> AskedLogs:
    """Return the logs that a store's manifest asks for; labels in their paths go before those that it has.

    Raises
    ------
    ManifestError
        If a label is wrong.
    """
    found = [(entry, _labels(entry.path, labels)) for entry in stored_entries(manifest)]
    return AskedLogs(
        entries=tuple(replace(entry, labels={**entry.labels, **own}) for entry, own in found),
        unlike=sum(labels is not None and not own for _, own in found),
    )


def as_json(reading: Mapping[str, object]) -> dict[str, object]:
    """Return arguments of `imucal.read` as JSON values, as the key of a result has them.

    What is empty, off, or skips nothing is left out: it is as if it were not said. Any other 0 stays, which
    reading refuses.
    """
    texts = {name: _values(name, value) for name, value in reading.items()}
    return {name: value for name, value in texts.items() if _is_said(name, value)}


def _is_said(name: str, value: object) -> bool:
    nought = isinstance(value, int | float) and not isinstance(value, bool) and value == 0
    return bool(value) or (nought and name != "skip_s")


def _values(name: str, value: object) -> object:
    if name in _SEVERAL:
        several = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
        return [str(one) for one in several if one]
    return str(value) if isinstance(value, Path) else value


def _asked_logs_entry(log: str, pattern: LabelPattern | None) -> LogEntry:
    path, url = shown_and_url(log)
    return LogEntry(path=path, labels=_labels(path, pattern), url=url)


def _labels(path: str, pattern: LabelPattern | None) -> dict[str, str | float]:
    labels = {}
    for name, text in ((pattern.of(path) if pattern else None) or {}).items():
        try:
            labels[name] = label_of(name, text)
        except ValueError as error:
            msg = f"labels: {path}: {name} is {text!r}, expected {error}"
            raise ManifestError(msg) from error
    return labels


#: Model and level of a fleet that says nothing else.
MODEL, LEVEL = "N + B + K", 0.95
#: Which logs get a report of their own.
REPORTS = ("none", "failed", "all")
#: Bytes that the packages take which read and fit a log, and a short log.
LEAST_MEMORY = 300 << 20
#: Seconds that a log may take, and more for each megabyte; usual ones take 0.06 s for each.
PATIENCE, PATIENCE_PER_MB = 300.0, 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LogTask:
    """One log to do.

    Attributes
    ----------
    path
        Of the log, as it was given; relative to `FleetSettings.folder`.
    size
        Bytes; 0 where it is not known.
    labels
        Columns of the manifest: model, unit, temperature_c, started.
    reading
        How to read it: arguments of `imucal.read`, ``skip_s`` and ``take_s``; JSON values.
    url
        Where it is, if that is more than the path may show: a URL with its query, which is never stored.
    """

    path: str
    url: str = field(default="", repr=False)
    size: int = 0
    labels: Mapping[str, str | float | None] = field(default_factory=dict)
    reading: Mapping[str, object] = field(default_factory=dict)

    @property
    def place(self) -> str:
        """Where it is: a path, or a URL with its secrets."""
        return self.url or self.path


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSettings:
    """What holds for every log of a fleet.

    Attributes
    ----------
    store
        The store's folder, absolute.
    folder
        Where relative paths begin, absolute.
    model, level
        Terms and confidence level of every fit: one structure for all, as one chosen by the log would
        make the logs differ where the units do not.
    memory
        Bytes that a log may take.
    timeout
        Seconds that a log may take; None for a time by its size.
    reports
        One of `REPORTS`.
    shard
        Stands in the names of the parts.
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
    """How a log ended, for those who count.

    Attributes
    ----------
    path, size
        Of the log; in bytes.
    status, reason, verdict
        As in the store.
    """

    path: str
    size: int
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


#: How logs end for good: another try would end the same, as their content, settings and version do.
_SETTLED = ("ok", "unreadable", "no-data")
#: Usual bytes of a log a second on one core, and seconds that each takes besides.
_BYTES_PER_S, _SECONDS = 17e6, 1.0
#: Batches of each worker: at least so many, so that all workers end together; and so many in a long run,
#: for which a batch may last `_LONGER` times as long.
_LEAST_BATCHES, _BATCHES, _LONGER = 4, 40, 10


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetPlan:
    """What is to be done.

    Attributes
    ----------
    entries
        The logs asked for.
    tasks
        Those to do.
    done
        Paths of those that the store has.
    again
        Paths of those to do that failed before, as by time or memory.
    copies
        Path of a log -> path of the one with the same content, which is done or to do.
    own
        Paths of the logs that this run answers for: all of them, or those of its shard.
    """

    entries: tuple[LogEntry, ...]
    tasks: tuple[LogTask, ...]
    done: tuple[str, ...]
    again: tuple[str, ...]
    copies: dict[str, str]
    own: tuple[str, ...]

    def manifest(self) -> pl.DataFrame:
        """Return the rows for the store's manifest."""
        free = sorted({name for e in self.entries for name in e.labels if name not in LABELS})
        rows = [
            [
                entry.path,
                *(entry.labels.get(name) for name in LABELS),
                json.dumps(entry.reading, sort_keys=True) if entry.reading else None,
                self.copies.get(entry.path),
                *(entry.labels.get(name) for name in free),
            ]
            for entry in self.entries
        ]
        schema = {**MANIFEST, **dict.fromkeys(free, pl.String())}
        return pl.DataFrame(rows, schema=schema, orient="row")

    def shard(self, number: int, of: int) -> "FleetPlan":
        """Return the part number 1 … `of` of the logs.

        Which these are does not change with what is done, so that shards may start at any time.
        """
        own = dict.fromkeys(entry.path for entry in self.entries[number - 1 :: of])
        return replace(
            self,
            own=tuple(own),
            tasks=tuple(task for task in self.tasks if task.path in own),
            done=tuple(path for path in self.done if path in own),
            again=tuple(path for path in self.again if path in own),
        )

    def seconds(self) -> float:
        """Return how long the tasks usually take on one core, in s."""
        return sum(expected_seconds(task) for task in self.tasks)


def plan_fleet(
    entries: Sequence[LogEntry],
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
    ReadError
        If the store is damaged.
    """
    entries = [replace(entry, reading={**(reading or {}), **entry.reading}) for entry in entries]
    stamps = stamps_of({entry.path: entry.place for entry in entries})
    known = _Known(store.logs() if store and store.exists else None)
    keys = _keys(entries, stamps, known, settings)
    done = tuple(path for path, key in keys.items() if key in known.settled)
    copies = _copies(keys, known)
    out = {*done, *copies}
    tasks = tuple(_task(entry, stamps[entry.path]) for entry in entries if entry.path not in out)
    return FleetPlan(
        entries=tuple(entries),
        tasks=tasks,
        done=done,
        again=tuple(task.path for task in tasks if task.path in known.failed),
        copies=copies,
        own=tuple(stamps),
    )


def _keys(
    entries: Sequence[LogEntry], stamps: Mapping[str, Stamp | None], known: "_Known", settings: FleetSettings
) -> dict[str, str]:
    """Return the key of each log; of one whose content is like no other's a key of its path."""
    places = {entry.path: entry.place for entry in entries}
    there = {path: stamp for path, stamp in stamps.items() if stamp is not None}
    contents = _contents(there, places, known)
    return {e.path: settings.key(contents.get(e.path, f"path:{e.path}"), e.reading) for e in entries}


def _copies(keys: Mapping[str, str], known: "_Known") -> dict[str, str]:
    """Return logs that have the key of one that is done, or that comes before them: path -> its path."""
    first: dict[str, str] = {}
    counted = {path: known.settled.get(key) or first.setdefault(key, path) for path, key in keys.items()}
    return {path: other for path, other in counted.items() if other != path}


def _task(entry: LogEntry, stamp: Stamp | None) -> LogTask:
    labels = {name: entry.labels.get(name) for name in LABELS}
    size = stamp.size if stamp else 0
    return LogTask(path=entry.path, url=entry.url, size=size, labels=labels, reading=entry.reading)


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
        if expected >= target:
            yield batch
            batch, expected = [], 0.0
    if batch:
        yield batch


class _Known:
    """What the store knows: contents by path, size and time; keys that are settled; what failed."""

    def __init__(self, logs: pl.DataFrame | None) -> None:
        self.contents: dict[tuple[str, int, int], str] = {}
        self.settled: dict[str, str] = {}
        self.failed: set[str] = set()
        self.sizes: set[int] = set()
        self.edges: set[str] = set()
        if logs is None:
            return
        columns = ("path", "key", "status", "content", "edge", "bytes", "mtime_ns")
        for path, key, status, content, edge, size, mtime in logs.select(columns).iter_rows():
            if content:
                self.contents[path, size, mtime] = content
                self.sizes.add(size)
                self.edges.add(edge)
            if content and status in _SETTLED:
                self.settled[key] = path
            else:
                self.failed.add(path)


def _contents(stamps: Mapping[str, Stamp], places: Mapping[str, str], known: _Known) -> dict[str, str]:
    """Return checksums of the contents that are known, or that may be those of other logs."""
    contents = {}
    for path, stamp in stamps.items():
        content = known.contents.get((path, stamp.size, stamp.mtime_ns))
        if content is not None:
            contents[path] = content
    new = [path for path in stamps if path not in contents]
    sizes = Counter(stamps[path].size for path in new)
    edges = {}
    for path in new:
        size = stamps[path].size
        if sizes[size] > 1 or size in known.sizes:
            with suppress(OSError, ReadError):
                edges[path] = edge_at(places[path])
    alike = Counter(edges.values())
    for path, edge in edges.items():
        if alike[edge] > 1 or edge in known.edges:
            with suppress(OSError, ReadError):
                contents[path] = content_at(places[path])
    return contents
