"""A remote log on this machine: downloaded once, whole or not at all, and lent while it is used."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TypeAlias
from uuid import uuid4

from imucal.errors import ReadError
from imucal.remote.failures import Attempts, ChangedError, PassingError
from imucal.remote.file_locks import locked
from imucal.remote.listing import identify
from imucal.remote.log_cache import FOLDER, Entry, cache_folder, cache_size, make_room
from imucal.remote.remote_log import RemoteFile, RemoteLog
from imucal.remote.stores import store_of

#: Called with bytes done and bytes in all (0 where nobody knows).
Progress: TypeAlias = Callable[[int, int], None]

#: An object that changes so often while it is read is being written.
_MOST_CHANGES = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalCopy:
    """The copy of a remote log.

    Attributes
    ----------
    log
        What it is a copy of.
    path
        The file, or the folder of a bag; valid inside the ``with`` block.
    files
        Its files, in the order of `log.files`.
    """

    log: RemoteLog
    path: Path
    files: tuple[Path, ...]


@contextmanager
def fetched(
    log: RemoteLog | str, *, progress: Progress | None = None, exact: bool = True
) -> Iterator[LocalCopy]:
    """Lend a copy of a remote log, from the cache or downloaded; nobody removes it meanwhile.

    After use it stays in the cache as far as there is room, unless `RemoteLog.keep` is false or nothing
    tells whether the object has changed. With `exact` a `RemoteLog` that changed is refused, as its results
    would go under the name of another; without it the new one is taken.

    Raises
    ------
    ReadError
        If there is no such log, it can't be fetched, the disk is full, or it is another than `log` by now.
    """
    asked = identify(log) if isinstance(log, str) else log
    for _ in range(_MOST_CHANGES):
        entry = Entry(cache_folder(), asked.key if asked.etag else f"{asked.key}-{uuid4().hex}")
        try:
            with _made(asked, entry, progress) as copy:
                yield copy
        except ChangedError:
            if exact and not isinstance(log, str):
                msg = f"{asked.shown}: it has changed since it was looked at; look again"
                raise ReadError(msg) from None
            asked = identify(asked.url, keep=asked.keep)
        else:
            return
        finally:
            _tidy(asked, entry)
    msg = f"{asked.shown}: it changes while it is read; wait until it is written"
    raise ReadError(msg)


@contextmanager
def _made(log: RemoteLog, entry: Entry, progress: Progress | None) -> Iterator[LocalCopy]:
    """Hold a copy, which is made where there is none."""
    while True:
        with locked(entry.lock, shared=True):
            if entry.is_whole(log):
                entry.used()
                files = tuple(entry.files(log, entry.whole))
                yield LocalCopy(log=log, path=entry.path(log), files=files)
                return
        with locked(entry.lock):
            # Another process may have made it while this one waited.
            if not entry.is_whole(log):
                _make(log, entry, progress)


def _make(log: RemoteLog, entry: Entry, progress: Progress | None) -> None:
    size, most = log.size or 0, cache_size()
    make_room(entry.root, size, most=most - size if size <= most else most)
    done = 0

    def tell(count: int) -> None:
        nonlocal done
        done += count
        if progress:
            progress(done, size)

    try:
        for folder in (entry.part, entry.whole):
            if folder.exists():
                # Left by a process that was killed, or touched by somebody.
                shutil.rmtree(folder)
        for file, path in zip(log.files, entry.files(log, entry.part), strict=True):
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("xb") as out:
                _download(file, out, tell)
                out.flush()
                os.fsync(out.fileno())
        entry.part.replace(entry.whole)
    except OSError as error:
        msg = (
            f"{log.shown}: no copy can be written to {entry.root}: {error.strerror or error}; "
            f"free some space, or set {FOLDER} to a folder on another disk"
        )
        raise ReadError(msg) from error
    finally:
        shutil.rmtree(entry.part, ignore_errors=True)


def _download(file: RemoteFile, out: IO[bytes], tell: Callable[[int], None]) -> None:
    """Write an object into an open file; goes on where a connection broke off."""
    store = store_of(file.url)
    attempts = Attempts(file.url)
    done = 0
    while True:
        try:
            for block in store.blocks(file, done):
                out.write(block)
                done += len(block)
                tell(len(block))
                attempts.went_on()
        except PassingError as error:
            attempts.wait(error)
        else:
            if file.size is None or done >= file.size:
                break
            attempts.wait(PassingError(f"the connection ended after {done} of {file.size} bytes"))
        if not file.ranges:
            out.seek(0)
            out.truncate()
            tell(-done)
            done = 0
    if file.size is not None and done != file.size:
        raise ChangedError


def _tidy(log: RemoteLog, entry: Entry) -> None:
    """Remove what is not to be kept."""
    if not (log.keep and log.etag and entry.whole.exists()):
        entry.remove()
    else:
        make_room(entry.root, 0, most=cache_size())
