"""Recognise equal logs: by size and both ends of their files, or by the ETag of a URL.

Reading whole logs would take longer than the fit. A change in the middle that keeps the size is not seen.
"""

import functools
import hashlib
import stat
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from imucal.errors import ReadError
from imucal.remote import RemoteLog, is_url
from imucal.remote.stores import Store, identify

#: Bytes at each end of a file that identify it: more than any format's header.
_EDGE = 1 << 16
#: Logs that are looked at in parallel: stores and network drives wait most of the time.
_AT_ONCE = 32


@dataclass(frozen=True, kw_only=True)
class LogIdentity:
    """The identity of a log's content: a digest of 32 hexadecimal digits, and the size in bytes."""

    digest: str
    size: int


def identities_of(places: Mapping[str, str]) -> dict[str, LogIdentity]:
    """Return path -> identity, from path -> place, without logs that can't be identified."""
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        found = dict(zip(places, pool.map(identity_of, places.values()), strict=True))
    return {path: identity for path, identity in found.items() if identity is not None}


def identity_of(place: str | RemoteLog) -> LogIdentity | None:
    """Return the identity of a log; None if it can't be read, or is no regular file."""
    try:
        if isinstance(place, RemoteLog) or is_url(place):
            return _of_remote(identify(place) if isinstance(place, str) else place)
        return _of_files(Path(place))
    except (OSError, ReadError):
        return None


def _of_remote(log: RemoteLog) -> LogIdentity | None:
    if log.size is None:
        return None
    machine = hashlib.blake2b(digest_size=16)
    store = Store(log.url)
    for file in log.files:
        if log.etag:
            machine.update(f"{file.etag} {file.size}".encode())
        else:
            read = functools.partial(store.read, file)
            size = file.size or 0
            machine.update(size.to_bytes(8, "little") + read(0, min(_EDGE, size)))
            machine.update(read(max(size - _EDGE, 0), size))
    return LogIdentity(digest=machine.hexdigest(), size=log.size)


def _of_files(path: Path) -> LogIdentity | None:
    files = sorted(entry for entry in path.rglob("*") if entry.is_file()) if path.is_dir() else [path]
    machine = hashlib.blake2b(digest_size=16)
    total = 0
    for file in files:
        info = file.stat()
        if not stat.S_ISREG(info.st_mode):
            return None
        total += info.st_size
        with file.open("rb") as stream:
            machine.update(info.st_size.to_bytes(8, "little") + stream.read(_EDGE))
            stream.seek(max(info.st_size - _EDGE, 0))
            machine.update(stream.read(_EDGE))
    return LogIdentity(digest=machine.hexdigest(), size=total) if files else None
