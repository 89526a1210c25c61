"""Cache of remote logs: complete copies only, locked during use.

The least recently used copy is removed first. ``KEY.lock`` is the lock for reading (shared) or changing
(exclusive) a copy, and its time is the last use. ``KEY.part/`` is an unfinished copy.
"""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TypeAlias
from uuid import uuid4

from imucal.errors import ReadError
from imucal.frozen import frozen
from imucal.locks import locked
from imucal.remote.addresses import (
    Attempts,
    ChangedError,
    PassingError,
    RemoteFile,
    RemoteLog,
    name_of,
    refused,
)
from imucal.remote.stores import identify, store_of
from imucal.resources import size_setting

#: Environment variables of the cache: its folder, and its size in bytes.
FOLDER = "IMUCAL_CACHE"
SIZE = "IMUCAL_CACHE_SIZE"
#: Default size in bytes.
_DEFAULT_SIZE = 10 << 30
#: Bytes left free.
_MARGIN = 1 << 24


class Entry:
    """The paths of a log in the cache."""

    def __init__(self, root: Path, key: str) -> None:
        self.root = root
        self.lock, self.whole, self.part = root / f"{key}.lock", root / key, root / f"{key}.part"

    def path(self, log: RemoteLog) -> Path:
        return self.whole / log.name

    def files(self, log: RemoteLog, within: Path) -> list[Path]:
        if not log.folder:
            return [within / log.name]
        return [within / log.name / name_of(file.url) for file in log.files]

    def is_whole(self, log: RemoteLog) -> bool:
        try:
            sizes = [path.stat().st_size for path in self.files(log, self.whole)]
        except OSError:
            return False
        return all(file.size in {None, size} for file, size in zip(log.files, sizes, strict=True))

    def remove(self) -> bool:
        try:
            with locked(self.lock, wait=False) as had:
                if not had:
                    return False
                # A partly removed copy must never be used.
                with suppress(FileNotFoundError):
                    shutil.rmtree(self.part)
                with suppress(FileNotFoundError):
                    self.whole.replace(self.part)
                    shutil.rmtree(self.part)
                self.lock.unlink(missing_ok=True)
        except OSError:
            return False
        return not self.whole.exists()

    def size(self) -> int:
        return sum(_size(path) for folder in (self.whole, self.part) for path in folder.rglob("*"))


def _size(path: Path) -> int:
    try:
        return path.stat().st_size if path.is_file() else 0
    except OSError:
        return 0


def cache_folder() -> Path:
    """Return ``IMUCAL_CACHE``, or the user's cache folder; raises ReadError."""
    asked = os.environ.get(FOLDER, "").strip()
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    root = Path(asked) if asked else (Path(base) if base else Path.home() / ".cache") / "imucal"
    try:
        root.mkdir(parents=True, exist_ok=True, mode=0o700)
        if not os.access(root, os.W_OK):
            raise PermissionError(13, os.strerror(13))
    except OSError as error:
        why = error.strerror or error
        text = f"the cache of remote logs can't be used: {why}; set {FOLDER} to a folder that you own"
        raise ReadError(text, place=root) from error
    return root.resolve()


def cache_size() -> int:
    """Return ``IMUCAL_CACHE_SIZE`` in bytes, or 10 GB; 0 keeps no copies. Raises SettingError."""
    size = size_setting(SIZE, least=0)
    return _DEFAULT_SIZE if size is None else size


def entry_of(log: RemoteLog) -> Entry:
    """Return the cache entry of a log."""
    return Entry(cache_folder(), log.key)


def make_room(root: Path, wanted: int, *, most: int) -> None:
    """Remove unused copies until the cache takes at most `most` bytes and `wanted` bytes are free.

    Raises ReadError if fewer are free at the end.
    """
    used: list[tuple[float, str]] = []
    for path in root.glob("*.lock"):
        with suppress(OSError):
            used.append((path.stat().st_mtime, path.stem))
    entries = [Entry(root, key) for _, key in sorted(used)]
    sizes = [entry.size() for entry in entries]
    total = sum(sizes)
    for entry, size in zip(entries, sizes, strict=True):
        crowded = size > 0 and (total > most or _lacks(root, wanted))
        if (crowded or not size) and entry.remove():
            total -= size
    if _lacks(root, wanted):
        free = shutil.disk_usage(root).free
        text = (
            f"no space for a remote log of {wanted / 1e9:.3g} GB: {free / 1e9:.3g} GB are free; "
            f"free some space, or set {FOLDER} to a folder on another disk"
        )
        raise ReadError(text, place=root)


def _lacks(root: Path, wanted: int) -> bool:
    return wanted > 0 and shutil.disk_usage(root).free < wanted + _MARGIN


#: Called with the bytes done and the total (0 if unknown).
Progress: TypeAlias = Callable[[int, int], None]

#: Most changes of an object during reading; with more it is still being written.
_MAX_CHANGES = 3


@frozen
class LocalCopy:
    """The copy of a remote log."""

    log: RemoteLog
    #: File, or folder of a bag; valid inside the ``with`` block.
    path: Path
    files: tuple[Path, ...]


@contextmanager
def fetched(
    log: RemoteLog | str, *, progress: Progress | None = None, exact: bool = True
) -> Iterator[LocalCopy]:
    """Yield a copy of a remote log, from the cache or downloaded; it is not removed during use.

    It stays in the cache unless `RemoteLog.keep` is false or the ETag is empty. With `exact`, a changed
    object is refused, because results would be stored under the wrong key. Raises ReadError if the log is
    missing, can't be fetched or has changed, or if the disk is full.
    """
    asked = identify(log) if isinstance(log, str) else log
    for _ in range(_MAX_CHANGES):
        entry = Entry(cache_folder(), asked.key if asked.etag else f"{asked.key}-{uuid4().hex}")
        try:
            with _made(asked, entry, progress) as copy:
                yield copy
        except ChangedError:
            if exact and not isinstance(log, str):
                raise refused(
                    asked.shown, "it has changed since the first look; run the command again"
                ) from None
            asked = identify(asked.url, keep=asked.keep)
        else:
            return
        finally:
            if asked.keep and asked.etag and entry.whole.exists():
                make_room(entry.root, 0, most=cache_size())
            else:
                entry.remove()
    raise refused(asked.shown, "it changed during reading; wait until it is complete")


@contextmanager
def _made(log: RemoteLog, entry: Entry, progress: Progress | None) -> Iterator[LocalCopy]:
    while True:
        with locked(entry.lock, shared=True):
            if entry.is_whole(log):
                with suppress(OSError):
                    os.utime(entry.lock)
                files = tuple(entry.files(log, entry.whole))
                yield LocalCopy(log=log, path=entry.path(log), files=files)
                return
        with locked(entry.lock):
            # Another process may have made the copy meanwhile.
            if not entry.is_whole(log):
                _make(log, entry, progress)


def _make(log: RemoteLog, entry: Entry, progress: Progress | None) -> None:
    size, most = log.size or 0, cache_size()
    make_room(entry.root, size, most=most - size if size <= most else most)
    done = 0

    # Without a cache, a copy is kept during its use.
    limit = most or _DEFAULT_SIZE

    def count_bytes(count: int) -> None:
        nonlocal done
        done += count
        if log.size is None and done > limit:
            advice = f"its server does not report its size; download it, or set {SIZE} to more"
            raise refused(log.shown, f"it is larger than the cache, {limit / 1e9:.3g} GB; {advice}")
        if progress:
            progress(done, size)

    try:
        for folder in (entry.part, entry.whole):
            if folder.exists():
                # Left by a killed process, or modified.
                shutil.rmtree(folder)
        for file, path in zip(log.files, entry.files(log, entry.part), strict=True):
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("xb") as out:
                _download(file, out, count_bytes)
                out.flush()
                os.fsync(out.fileno())
        entry.part.replace(entry.whole)
    except OSError as error:
        text = (
            f"can't write a copy to {entry.root}: {error.strerror or error}; free some space, "
            f"or set {FOLDER} to a folder on another disk"
        )
        raise ReadError(text, place=log.shown) from error
    finally:
        shutil.rmtree(entry.part, ignore_errors=True)


def _download(file: RemoteFile, out: IO[bytes], count_bytes: Callable[[int], None]) -> None:
    """Write an object to an open file; resume after a broken connection.

    Repeated bytes do not count as progress: a server without parts could end early forever.
    """
    store = store_of(file.url)
    attempts = Attempts(file.url)
    done = farthest = 0
    while True:
        try:
            for block in store.blocks(file, done):
                out.write(block)
                done += len(block)
                count_bytes(len(block))
                if file.size is not None and done > file.size:
                    raise ChangedError
                if done > farthest:
                    farthest = done
                    attempts.reset()
            if file.size is None or done == file.size:
                return
            attempts.wait(PassingError(f"the connection ended after {done} of {file.size} bytes"))
        except PassingError as error:
            attempts.wait(error)
        if not file.ranges:
            out.seek(0)
            out.truncate()
            count_bytes(-done)
            done = 0
