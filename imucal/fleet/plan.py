"""The settings and the plan of a fleet run: the requested logs that the store does not contain yet."""

import hashlib
import json
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from imucal._version import __version__
from imucal.errors import ArgumentError, Fix, ManifestError, StoreError
from imucal.fleet.identity import identities_of
from imucal.fleet.logs import LogTask, State, find_logs, label_pattern
from imucal.fleet.manifest import Column, labels_in, meant, read_manifest
from imucal.fleet.store import SCHEMA, AskedLog, Stored, is_fleet, read_store
from imucal.noise import parse_structure, structure_text
from imucal.resources import memory_there_is, threads
from imucal.user_input import bytes_of

#: Terms of all fits by default.
MODEL = "N + B + K"
#: Confidence level of all intervals by default.
LEVEL = 0.95
#: Memory of the imported packages and a short log, in bytes.
MIN_MEMORY = 300 << 20
#: Time limit of any log, in s.
_PATIENCE_S = 300.0
#: Additional time per megabyte, in s; usual logs need 0.06 s.
_PATIENCE_S_PER_MB = 3.0
#: Share of the machine's memory for all workers.
_MEMORY_SHARE = 0.8
#: Memory of a machine whose memory is unknown, in bytes.
_UNKNOWN_MEMORY = 2 << 30
#: Final states: another attempt would have the same result.
_SETTLED = ("ok", "unreadable", "no-data")
#: Arguments of `imucal.read` that are lists.
_SEVERAL = ("topic", "fields", "message_definition")


@dataclass(frozen=True, kw_only=True)
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

    @property
    def of_fits(self) -> dict[str, object]:
        """The settings that all fits of a store share."""
        return {"model": self.model, "level": self.level}

    def key(self, content: str, reading: Mapping[str, object]) -> str:
        """Return the key of a result: a digest of the content of the log, the settings and the version."""
        text = json.dumps([content, self.model, self.level, reading, __version__, SCHEMA], sort_keys=True)
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    def patience(self, task: LogTask) -> float:
        """Return the time limit of a log in s."""
        return self.timeout_s or _PATIENCE_S + _PATIENCE_S_PER_MB * task.size / 1e6


def has_failed(status: object, verdict: object) -> bool:
    """Return whether a log has no usable numbers."""
    return status != "ok" or verdict == "not-noise"


@dataclass(frozen=True, kw_only=True)
class FleetPlan:
    """All requested logs with their states, and the store without them; `stored` is None for a new fleet."""

    logs: tuple[LogTask, ...]
    stored: Stored | None = None

    @property
    def tasks(self) -> list[LogTask]:
        return self.own("run", "again")

    def own(self, *states: str) -> list[LogTask]:
        return [log for log in self.logs if log.own and (not states or log.state in states)]

    def asked(self) -> list[AskedLog]:
        """Return the requested logs that are new to the store, or have other labels."""
        rows = (
            AskedLog(path=log.path, labels=log.labels, reading=log.reading, copy_of=log.copy_of)
            for log in self.logs
        )
        known = self.stored.asked if self.stored else {}
        return [row for row in rows if known.get(row.path) != row]


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
    store = Path(folder).absolute()
    kept = {} if given.get("fresh") or not is_fleet(store) else read_store(store).settings
    for name in kept.keys() & {"model", "level"}:
        if given.setdefault(name, kept[name]) != kept[name]:
            problem = f"contains fits with {name} {kept[name]}, found {given[name]}"
            fix = Fix("choose another folder, or repeat all logs with --fresh")
            raise ArgumentError(problem, place=store, fix=fix)
    given["jobs"] = 1 if "shard" in given else given.get("jobs") or threads()
    memory = int((memory_there_is() or _UNKNOWN_MEMORY) * _MEMORY_SHARE) // given["jobs"]
    return FleetSettings(**{"store": str(store), "folder": str(Path.cwd()), "memory": memory, **given})


def _meant(name: str, value: Any) -> Any:  # noqa: ANN401 - of any argument
    if name == "labels":
        label_pattern(value)
    if name == "model" and value != "auto":
        return structure_text(parse_structure(value))
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

    Without both, the logs of the store are used. The logs of damaged lines are repeated; a `dry` run raises
    StoreError instead. Raises ReadError if there are no logs or no store; ManifestError if the manifest or a
    label is wrong.
    """
    given = bool(names or manifest)
    stored = None
    if not settings.fresh and (is_fleet(settings.store) or not given):
        stored = _known(settings, given=given, dry=dry, notify=notify)
    asked = {log.path: log for log in (read_manifest(manifest) if manifest else ())}
    unlike = 0
    for log in _named_logs(names, None if given else stored):
        own = labels_in(log.path, settings.labels)
        unlike += not own
        known = stored.asked[log.path].labels if stored and log.path in stored.asked else {}
        first = asked.setdefault(log.path, replace(log, labels={**known, **log.labels, **own}))
        if first.place != log.place != log.path:
            problem = "two URLs that differ only after the question mark; expected one"
            raise ManifestError(problem, place=log.path)
    if settings.labels and unlike:
        notify(f"{unlike} of {len(asked)} logs do not match {settings.labels}")
    return plan_fleet(asked.values(), settings, stored)


def _known(settings: FleetSettings, *, given: bool, dry: bool, notify: Callable[[str], object]) -> Stored:
    """Return the content of the store; `given` is whether logs are named."""
    stored = read_store(settings.store)
    if dry:
        stored.refuse_damage()
    if not given:
        _refuse_unknown_logs(stored)
    for line in stored.damaged:
        notify(f"{line}: is damaged; its logs are repeated")
    return stored


def _named_logs(names: Collection[str], stored: Stored | None) -> Iterator[LogTask]:
    """Yield the logs of names, or of the store."""
    if stored is not None:
        yield from _stored_logs(stored)
        return
    for name in find_logs(names):
        yield LogTask(place=name)


def _refuse_unknown_logs(stored: Stored) -> None:
    """Raise StoreError if a list of requested logs, which is the first line of a file, is damaged."""
    for line in stored.damaged:
        if line.endswith(":1"):
            problem = "is damaged, and contained names of logs"
            fix = Fix("give the logs again: finished logs are kept")
            raise StoreError(problem, place=f"{stored.folder}/{line}", fix=fix)


def _stored_logs(stored: Stored) -> Iterator[LogTask]:
    for log in stored.asked.values():
        yield LogTask(place=log.path, labels=log.labels, reading=log.reading)


def plan_fleet(
    asked: Collection[LogTask], settings: FleetSettings, stored: Stored | None = None
) -> FleetPlan:
    """Return the plan for requested logs with different paths.

    The logs of a shard do not depend on finished logs, so shards may start at any time.
    """
    rows = stored.logs() if stored else []
    settled = {row["key"]: row["path"] for row in rows if row["identity"] and row["status"] in _SETTLED}
    failed = {row["path"] for row in rows}.difference(settled.values())
    places = {log.path: log.place for log in asked}
    identities = identities_of(places)
    part, parts = settings.shard
    first: dict[str, str] = {}
    logs = []
    for number, (path, log) in enumerate(zip(places, asked, strict=True), 1):
        reading = {**settings.reading, **log.reading}
        identity = identities.get(path)
        # A log that can't be identified is not equal to another.
        key = settings.key(identity.digest if identity else f"path:{path}", reading)
        other = settled.get(key) or first.setdefault(key, path)
        copy_of = None if other == path else other
        to_do: State = "again" if path in failed else "run"
        state: State = "done" if key in settled else "copy" if copy_of else to_do
        own = (number - part) % parts == 0
        size = identity.size if identity else 0
        logs.append(replace(log, reading=reading, size=size, state=state, copy_of=copy_of, own=own))
    return FleetPlan(logs=tuple(logs), stored=stored)
