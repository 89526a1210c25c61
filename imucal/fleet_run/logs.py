"""Find the logs of given names, recognise equal logs, and read labels from paths.

Size and both ends of a file distinguish nearly all logs; the whole content is read only if they are equal.
"""

import functools
import glob
import hashlib
import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from imucal.errors import ArgumentError, ReadError
from imucal.readers import FORMATS
from imucal.readers.compression import crc32
from imucal.readers.containers.rosbag2_folder import METADATA, natural
from imucal.remote import RemoteLog, is_url
from imucal.remote.addresses import has_wildcards, name_of, shown
from imucal.remote.copies import fetched
from imucal.remote.stores import Store, expand, identify

#: In a folder, files with these common endings are used only if they are named.
_VAGUE = (".txt", ".log", ".dat")
_PACKED = ("", ".gz", ".bz2", ".xz", ".zst", ".zstd", ".zip", ".lz4")
_ENDINGS = tuple(
    ending + packed for form in FORMATS for ending in {*form.suffixes} - {*_VAGUE} for packed in _PACKED
)
#: Bytes at each end of a file in its edge checksum.
_EDGE = 1 << 16
#: Block size in bytes. The checksum of a log depends on it.
_BLOCK = 1 << 20
#: Requests to stores wait most of the time.
_AT_ONCE = 32


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
    """Yield the logs in a folder: bags, which are folders, and files; ignore links to a folder `above`."""
    real = os.path.realpath(folder)
    if real in above:
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


class Stamp(NamedTuple):
    """Size of a log in bytes, and time of its newest file in ns since 1970; both identify its content.

    A URL has a number from its ETag as its time.
    """

    size: int
    mtime_ns: int


def stamps_of(places: Mapping[str, str]) -> dict[str, Stamp]:
    """Return path -> stamp, from path -> place, without logs that have no stamp."""
    urls = [path for path, place in places.items() if is_url(place)]
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        asked = dict(zip(urls, pool.map(stamp_of, map(places.__getitem__, urls)), strict=True))
    found = ((path, asked[path] if path in asked else stamp_of(place)) for path, place in places.items())
    return {path: stamp for path, stamp in found if stamp}


def stamp_of(log: str | RemoteLog) -> Stamp | None:
    """Return the stamp of a log; None if there is none, or if the log can't be read twice."""
    try:
        known = identify(log) if isinstance(log, str) and is_url(log) else log
        if isinstance(known, RemoteLog):
            if not known.etag or known.size is None:
                return None
            digest = hashlib.blake2b(known.etag.encode(), digest_size=8).digest()
            return Stamp(size=known.size, mtime_ns=int.from_bytes(digest, "little") >> 1)
        infos = [file.stat() for file in _files(Path(known))]
    except (OSError, ReadError):
        return None
    if not infos or not all(stat.S_ISREG(info.st_mode) for info in infos):
        return None
    return Stamp(size=sum(info.st_size for info in infos), mtime_ns=max(info.st_mtime_ns for info in infos))


def edge_at(place: str) -> str:
    """Return a checksum of the sizes, beginnings and ends of a log's files; fetch only these from a store.

    Raises OSError or ReadError if they can't be read.
    """
    machine = hashlib.blake2b(digest_size=16)
    for file in identify(place).files if is_url(place) else _files(Path(place)):
        if isinstance(file, Path):
            size, read = file.stat().st_size, functools.partial(_part, file)
        elif file.size is None:
            raise ReadError("its server does not report its size", place=shown(place))
        else:
            size, read = file.size, functools.partial(Store(place).read, file)
        machine.update(size.to_bytes(8, "little") + read(0, min(_EDGE, size)))
        machine.update(read(max(size - _EDGE, 0), size))
    return machine.hexdigest()


def _part(file: Path, start: int, stop: int) -> bytes:
    with file.open("rb") as stream:
        stream.seek(start)
        return stream.read(stop - start)


def content_at(place: str) -> str:
    """Return a checksum of the content of a log's files: BLAKE2b of their sizes and of each block's CRC-32.

    A remote log is downloaded. Raises OSError or ReadError. A cryptographic checksum of all bytes, against
    forgery, would be slow.
    """
    if is_url(place):
        with fetched(identify(place)) as copy:
            return content_at(str(copy.path))
    machine = hashlib.blake2b(digest_size=16)
    block = memoryview(bytearray(_BLOCK))
    for file in _files(Path(place)):
        # Buffered, because a short read would shift the blocks.
        with file.open("rb") as stream:
            machine.update(file.stat().st_size.to_bytes(8, "little"))
            while count := stream.readinto(block):
                machine.update(crc32(block[:count]).to_bytes(4, "little"))
    return machine.hexdigest()


def _files(path: Path) -> list[Path]:
    return sorted(entry for entry in path.rglob("*") if entry.is_file()) if path.is_dir() else [path]


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
