"""The requested logs: files, folders, wildcards and URLs -> tasks with labels from the paths."""

import functools
import glob
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias

from imucal.errors import ArgumentError, ReadError
from imucal.readers import FORMATS
from imucal.readers.containers.rosbag2_folder import METADATA, natural
from imucal.readers.foreign import FLEET_FILES
from imucal.remote import is_url
from imucal.remote.addresses import has_wildcards, name_of, shown
from imucal.remote.stores import expand

#: In a folder, files with these common endings are used only if they are named.
_VAGUE = (".txt", ".log", ".dat")
_PACKED = ("", ".gz", ".bz2", ".xz", ".zst", ".zstd", ".zip", ".lz4")
_ENDINGS = tuple(
    ending + packed for form in FORMATS for ending in {*form.suffixes} - {*_VAGUE} for packed in _PACKED
)
#: Usual speed of a fit on one core, in bytes/s.
_BYTES_PER_S = 17e6
#: Usual time of a fit without its samples, in s.
_LEAST_S = 1.0

State: TypeAlias = Literal["run", "again", "done", "copy"]


@dataclass(frozen=True, kw_only=True)
class LogTask:
    """A requested log and its state.

    `place` is the given path, relative to the working folder, or a URL with its secrets, which is never
    stored. `reading` contains arguments of `imucal.read`. `size` is in bytes, 0 if unknown. A log of another
    shard is not `own`.

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
        """The usual time of its fit in s."""
        return _LEAST_S + self.size / _BYTES_PER_S


def find_logs(names: Iterable[str]) -> list[str]:
    """Return the logs of some names, each once, in the order of the names.

    Names are files, folders, URLs, or contain wildcards. Raises ReadError if wildcards match nothing, a
    folder contains no log, or a name is neither a file nor has the ending of a log.
    """
    return list(dict.fromkeys(log for name in names for log in _logs_of(name)))


def _logs_of(name: str) -> list[str]:
    # A store is not asked about each of a million logs.
    if is_url(name):
        plain = not has_wildcards(name) and name_of(name).lower().endswith(_ENDINGS)
        return [name] if plain else expand(name)
    if os.path.isdir(name):  # noqa: PTH112 - a name stays as it was typed
        found = "no log in this folder; expected files that end in .mcap, .bag, .db3, .csv or others"
        logs = [*_walk(name)]
    elif os.path.lexists(name) or (not glob.has_magic(name) and name.lower().endswith(_ENDINGS)):
        return [name]
    elif glob.has_magic(name):
        found = "no log has this name; expected files, or folders with logs"
        logs = [*_matches(name)]
    else:
        found, logs = "no such file or folder; expected logs, or folders with logs", []
    if not logs:
        raise ReadError(found, place=name)
    return logs


def _matches(name: str) -> Iterator[str]:
    suffix = Path(name).suffix
    # A star alone matches only files with the ending of a log.
    endings = ("",) if suffix and not glob.has_magic(suffix) else _ENDINGS
    found = glob.glob(name.removesuffix("**"), recursive=True)  # noqa: PTH207 - as it was typed
    for match in sorted(found, key=lambda match: [natural(Path(part)) for part in Path(match).parts]):
        if os.path.isdir(match):  # noqa: PTH112
            yield from _walk(match)
        elif match.lower().endswith(endings):
            yield match


def _walk(folder: str, above: frozenset[str] = frozenset()) -> Iterator[str]:
    """Yield the logs in a folder: bags, which are folders, and files; ignore fleets, and links to `above`."""
    real = os.path.realpath(folder)
    if real in above or any(Path(folder).glob(FLEET_FILES)):
        return
    if os.path.exists(os.path.join(folder, METADATA)):  # noqa: PTH110, PTH118 - a name stays as it was typed
        yield folder
        return
    for entry in sorted(Path(folder).iterdir(), key=natural):
        name = os.path.join(folder, entry.name)  # noqa: PTH118
        if entry.name.startswith("."):
            continue
        if entry.is_dir():
            yield from _walk(name, above | {real})
        elif entry.name.lower().endswith(_ENDINGS):
            yield name


_PART = re.compile(r"\{(?P<label>[^{}]*)\}|(?P<wild>\*\*/?|[*?])|(?P<brace>[{}])|(?P<text>[^{}*?]+)")
_LABEL = re.compile(r"(?!(?:path|options|copy_of)$)[A-Za-z_][A-Za-z0-9_]*")
_WILD = {"**/": ".*", "**": ".*", "*": "[^/]*", "?": "[^/]"}
_SUCH = "write for example '{model}/{unit}/*.mcap'"


@functools.cache
def label_pattern(pattern: str) -> re.Pattern[str]:
    """Return the regular expression of a pattern such as ``{model}/{unit}/{temperature_c}C/*.mcap``.

    It matches the end of a path. Raises ArgumentError for a pattern without a label, with a label twice, or
    with an unmatched brace.
    """
    parts, mistake, body = [*_PART.finditer(pattern)], "", ""
    labels = [part["label"] for part in parts if part["label"] is not None]
    for part in parts:
        label = part["label"]
        if part["brace"]:
            mistake = f"an unmatched brace; {_SUCH}"
        elif label is None:
            body += re.escape(part["text"]) if part["text"] else _WILD[part["wild"]]
        elif not _LABEL.fullmatch(label):
            mistake = f"{label!r} is not a label name; write for example {{unit}}"
        elif labels.count(label) > 1:
            mistake = f"{label!r} is duplicated; give each label its own name"
        else:
            body += f"(?P<{label}>[^/]+?)"
    if mistake or not labels:
        raise ArgumentError(f"labels {pattern!r}: {mistake or f'no label; {_SUCH}'}")
    return re.compile(f"(?:^|.*/){body}$")
