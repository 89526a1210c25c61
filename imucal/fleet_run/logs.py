"""What a person names -> logs; what a log is, whatever it is called; and its labels from its path.

The size and both edges of a file cost two small reads and tell nearly all logs apart; the whole content is
read only where these are the same. Of a folder, which is a bag, all files count, but not their names. A log
behind a URL is asked for by ranges, and fetched where it is read.
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
from imucal.remote.addresses import has_wildcards, name_of
from imucal.remote.copies import fetched
from imucal.remote.stores import expand, identify, store_of

#: Endings that files have which are no logs: a folder's files of these are not taken unless they are named.
_VAGUE = (".txt", ".log", ".dat")
#: What compressed tables and logs end in besides.
_PACKED = ("", ".gz", ".bz2", ".xz", ".zst", ".zstd", ".zip", ".lz4")
_ENDINGS = tuple(
    ending + packed for form in FORMATS for ending in {*form.suffixes} - {*_VAGUE} for packed in _PACKED
)
#: Bytes at the beginning and at the end of a file that make its edge.
_EDGE = 1 << 16
#: Bytes read at once. Their CRCs make the checksum: with another size every content would have a new one.
_BLOCK = 1 << 20
#: Stores that are asked at the same time: each answer takes a while, and little of this machine.
_AT_ONCE = 32


def find_logs(names: Iterable[str]) -> list[str]:
    """Return the logs that some names stand for, each once, in the order of the names.

    They are files, folders, URLs, or names with wildcards (``*``, ``?``, ``[…]``, and ``**`` for folders of
    any depth). It is a ReadError if wildcards match nothing, a folder holds no log, or a name is neither a
    file nor a log's.
    """
    return list(dict.fromkeys(log for name in names for log in _logs_of(name)))


def _logs_of(name: str) -> list[str]:
    # What is called as a log is taken as one: a store is not asked for each of a million, and a file that is
    # missing is a log that can't be read, as any other.
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
        raise ReadError(f"{name}: {found}")
    return logs


def _matches(name: str) -> Iterator[str]:
    """Yield the logs that a name with wildcards stands for."""
    suffix = Path(name).suffix
    # Of *.txt all are meant; of a bare star only what can be a log.
    endings = ("",) if suffix and not glob.has_magic(suffix) else _ENDINGS
    found = glob.glob(name.removesuffix("**"), recursive=True)  # noqa: PTH207 - as it was typed
    for match in sorted(found, key=lambda match: [natural(Path(part)) for part in Path(match).parts]):
        if os.path.isdir(match):  # noqa: PTH112
            yield from _walk(match)
        elif match.lower().endswith(endings):
            yield match


def _walk(folder: str, above: frozenset[str] = frozenset()) -> Iterator[str]:
    """Yield the logs in a folder: bags, which are folders, and files by their endings.

    A link to a folder that it stands in, one `above`, leads nowhere.
    """
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
    """What the file system says of a log: the bytes of all its files, and when the newest was written.

    `mtime_ns`, in ns since 1970, tells of the log with this size and path whether the content is still the
    same. Of a remote log it is a number made of its ETag.
    """

    size: int
    mtime_ns: int


def stamps_of(places: Mapping[str, str]) -> dict[str, Stamp]:
    """Return what file systems and stores say of logs: path -> place becomes path -> stamp.

    One of which they say nothing, or that can't be read twice, is left out: reading it will say why.
    """
    urls = [path for path, place in places.items() if is_url(place)]
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        asked = dict(zip(urls, pool.map(stamp_of, map(places.__getitem__, urls)), strict=True))
    found = ((path, asked[path] if path in asked else stamp_of(place)) for path, place in places.items())
    return {path: stamp for path, stamp in found if stamp}


def stamp_of(log: str | RemoteLog) -> Stamp | None:
    """Return the stamp of a log; None where nothing is said of it, or it can't be read twice."""
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
    """Return a checksum of the sizes, beginnings and ends of a log's files, of a remote one by ranges.

    It is an OSError or a ReadError if they can't be read.
    """
    machine = hashlib.blake2b(digest_size=16)
    for file in identify(place).files if is_url(place) else _files(Path(place)):
        if isinstance(file, Path):
            size, read = file.stat().st_size, functools.partial(_part, file)
        elif file.size is None or not file.ranges:
            raise ReadError("its server sends no parts of files")
        else:
            size, read = file.size, functools.partial(store_of(place).read, file)
        machine.update(size.to_bytes(8, "little") + read(0, min(_EDGE, size)))
        machine.update(read(max(size - _EDGE, 0), size))
    return machine.hexdigest()


def _part(file: Path, start: int, stop: int) -> bytes:
    with file.open("rb") as stream:
        stream.seek(start)
        return stream.read(stop - start)


def content_at(place: str) -> str:
    """Return a checksum of the content of a log's files: BLAKE2b of their sizes and of each block's CRC-32.

    A remote one is fetched for it. It is an OSError or a ReadError if they can't be read.

    It tells logs apart and guards against nobody: a CRC runs at the speed of memory, while a checksum
    against forgers of all bytes took 3 to 5 % of the time of an uncompressed log.
    """
    if is_url(place):
        with fetched(place) as copy:
            return content_at(str(copy.path))
    machine = hashlib.blake2b(digest_size=16)
    block = memoryview(bytearray(_BLOCK))
    for file in _files(Path(place)):
        # Buffered, as a file system may return less than was asked for, which would move the blocks.
        with file.open("rb") as stream:
            machine.update(file.stat().st_size.to_bytes(8, "little"))
            while count := stream.readinto(block):
                machine.update(crc32(block[:count]).to_bytes(4, "little"))
    return machine.hexdigest()


def _files(path: Path) -> list[Path]:
    return sorted(entry for entry in path.rglob("*") if entry.is_file()) if path.is_dir() else [path]


#: Parts of a pattern: plain text, labels, and wildcards as in the names of files.
_PART = re.compile(r"\{(?P<label>[^{}]*)\}|(?P<wild>\*\*/?|[*?])|(?P<brace>[{}])|(?P<text>[^{}*?]+)")
_LABEL = re.compile(r"(?!(?:path|options|copy_of)$)[A-Za-z_][A-Za-z0-9_]*")
_WILD = {"**/": ".*", "**": ".*", "*": "[^/]*", "?": "[^/]"}
_SUCH = "write for example '{model}/{unit}/*.mcap'"


@functools.cache
def label_pattern(pattern: str) -> re.Pattern[str]:
    """Return what finds labels in paths by a pattern such as ``{model}/{unit}/{temperature_c}C/*.mcap``.

    It is held against the end of a path, from any folder on; a label is as short as it can be. A pattern
    without a label, with one twice, or with a brace alone is an ArgumentError.
    """
    parts, slip, body = [*_PART.finditer(pattern)], "", ""
    labels = [part["label"] for part in parts if part["label"] is not None]
    for part in parts:
        label = part["label"]
        if part["brace"]:
            slip = f"an unmatched brace; {_SUCH}"
        elif label is None:
            body += re.escape(part["text"]) if part["text"] else _WILD[part["wild"]]
        elif not _LABEL.fullmatch(label):
            slip = f"{label!r} is not a label name; write for example {{unit}}"
        elif labels.count(label) > 1:
            slip = f"{label!r} is duplicated; give each label its own name"
        else:
            body += f"(?P<{label}>[^/]+?)"
    if slip or not labels:
        raise ArgumentError(f"labels {pattern!r}: {slip or f'no label; {_SUCH}'}")
    return re.compile(f"(?:^|.*/){body}$")
