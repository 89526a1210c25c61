"""Logs asked for, less those that the store has -> what is to be done; equal contents are done once."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import polars as pl

from imucal.errors import ReadError
from imucal.fleet.store import MANIFEST, FleetStore
from imucal.fleet_run.log_identity import Stamp
from imucal.fleet_run.log_places import content_at, edge_at, stamps_of
from imucal.fleet_run.log_tasks import FleetSettings, LogTask
from imucal.fleet_run.manifest_file import LABELS, LogEntry

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
