"""Where a log is: a file of this machine, or a URL, which is asked for and fetched where it is read."""

import functools
import hashlib
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from imucal.errors import ReadError
from imucal.fleet_run.log_identity import Stamp, content_of, edge_from, edge_of, stamp_of
from imucal.readers.remote_logs import LocalLogs, local_logs
from imucal.remote import RemoteLog, fetched, identify, is_url
from imucal.remote.stores import store_of

#: Stores that are asked at the same time: each answer takes a while, and little of this machine.
_AT_ONCE = 32


def stamps_of(places: Mapping[str, str]) -> dict[str, Stamp | None]:
    """Return what file systems and stores say of logs: path -> place becomes path -> stamp."""
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        remote = {path: pool.submit(_asked, place) for path, place in places.items() if is_url(place)}
        return {
            path: remote[path].result() if path in remote else stamp_of(Path(place))
            for path, place in places.items()
        }


def edge_at(place: str) -> str:
    """Return the checksum of the edges of a log's files, of a remote one by ranges.

    Raises
    ------
    OSError, ReadError
        If they can't be read.
    """
    if not is_url(place):
        return edge_of(Path(place))
    files = identify(place).files
    if any(file.size is None or not file.ranges for file in files):
        msg = "its store gives no parts"
        raise ReadError(msg)
    store = store_of(place)
    return edge_from((file.size or 0, functools.partial(store.read, file)) for file in files)


def content_at(place: str) -> str:
    """Return the checksum of the content of a log's files; a remote one is fetched for it.

    Raises
    ------
    OSError, ReadError
        If they can't be read.
    """
    if not is_url(place):
        return content_of(Path(place))
    with fetched(place) as copy:
        return content_of(copy.path)


@contextmanager
def at_hand(place: str) -> Iterator[tuple[LocalLogs, Stamp | None]]:
    """Lend a log as files of this machine, with its stamp; what was fetched goes after use.

    Raises
    ------
    ReadError
        If it can't be fetched.
    """
    log = identify(place, keep=False) if is_url(place) else place
    with local_logs([log]) as logs:
        yield logs, stamp_of(logs.paths[0]) if isinstance(log, str) else _stamp(log)


def _asked(place: str) -> Stamp | None:
    try:
        return _stamp(identify(place))
    except ReadError:
        # As of a file that is not there: reading it will say why.
        return None


def _stamp(log: RemoteLog) -> Stamp | None:
    """Return a stamp whose time is a number made of the ETag: it changes when the object does."""
    if not log.etag or log.size is None:
        return None
    digest = hashlib.blake2b(log.etag.encode(), digest_size=8).digest()
    return Stamp(size=log.size, mtime_ns=int.from_bytes(digest, "little") >> 1)
