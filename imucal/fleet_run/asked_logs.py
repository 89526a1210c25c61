"""What a person asks for, logs with their labels -> entries of a manifest."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from imucal.errors import ManifestError
from imucal.fleet_run.log_list import find_logs
from imucal.fleet_run.manifest_file import LogEntry, label_of, read_manifest, shown_and_url
from imucal.fleet_run.path_labels import LabelPattern

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
        How many of those that were named the pattern of labels does not fit.
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


def as_json(reading: Mapping[str, object]) -> dict[str, object]:
    """Return arguments of `imucal.read` as JSON values, as the key of a result has them, but empty ones."""
    texts = {name: _values(name, value) for name, value in reading.items()}
    return {name: value for name, value in texts.items() if value}


def _values(name: str, value: object) -> object:
    if name in _SEVERAL:
        several = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
        return [str(one) for one in several if one]
    return str(value) if isinstance(value, Path) else value


def _entry(log: str, pattern: LabelPattern | None) -> LogEntry:
    path, url = shown_and_url(log)
    labels = {}
    for name, text in ((pattern.of(path) if pattern else None) or {}).items():
        try:
            labels[name] = label_of(name, text)
        except ValueError as error:
            msg = f"labels: {path}: {name} is {text!r}, expected {error}"
            raise ManifestError(msg) from error
    return LogEntry(path=path, labels=labels, url=url)
