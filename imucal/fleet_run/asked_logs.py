"""What a person asks for, logs with their labels -> entries of a manifest."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from imucal.errors import ManifestError
from imucal.fleet_run.log_list import find_logs
from imucal.fleet_run.manifest_file import LogEntry, label_of, read_manifest, shown_and_url, stored_entries
from imucal.fleet_run.path_labels import LabelPattern

if TYPE_CHECKING:
    import polars as pl

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
        As `imucal.fleet_run.log_list.find_logs` takes them.
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
        entry = _entry(name, labels)
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


def _entry(log: str, pattern: LabelPattern | None) -> LogEntry:
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
