"""Copies of remote logs on this machine: each whole or not at all, lent while it is used, kept in a cache.

The cache has a folder for each; the least recently used goes first. Its locks between processes are those
that the system takes back when their holder dies.

::

    KEY.lock     held by whoever reads the copy (shared) or makes and removes it (alone); its time is that of
                 the last use
    KEY/         the copy: a file, or the folder of a bag, under the log's own name
    KEY.part/    a copy on its way
"""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TypeAlias
from uuid import uuid4

from imucal.errors import ReadError
from imucal.frozen import frozen
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

try:
    import fcntl
except ImportError:  # Windows: an open file can't be removed there, which protects what is in use
    fcntl = None  # type: ignore[assignment]


@contextmanager
def locked(path: Path, *, shared: bool = False, wait: bool = True) -> Iterator[bool]:
    """Hold the lock that is the file `path`; yield whether it was had, which only `wait=False` leaves open.

    Whoever holds it alone may remove the file: those who wait for it then take the new one.
    """
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            had = True
            if fcntl is not None:
                kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
                try:
                    fcntl.flock(file, kind if wait else kind | fcntl.LOCK_NB)
                except BlockingIOError:
                    had = False
            # Whether the open file is still the one of that name.
            same = not had
            with suppress(OSError):
                same = same or os.path.samestat(os.fstat(file), path.stat())
            if same:
                yield had
                return
        finally:
            os.close(file)


FOLDER, SIZE = "IMUCAL_CACHE", "IMUCAL_CACHE_SIZE"
#: Bytes that copies may take together, where nothing else is said.
_DEFAULT_SIZE = 10 << 30
#: Left free on the disk beside a copy, in bytes: others write too.
_MARGIN = 1 << 24


@dataclass(frozen=True, slots=True)
class Entry:
    """The place of a log in the cache."""

    root: Path
    key: str

    @property
    def lock(self) -> Path:
        """The file that is locked."""
        return self.root / f"{self.key}.lock"

    @property
    def whole(self) -> Path:
        """Where the copy is."""
        return self.root / self.key

    @property
    def part(self) -> Path:
        """Where it is made."""
        return self.root / f"{self.key}.part"

    def path(self, log: RemoteLog) -> Path:
        """Return the file or folder of the copy."""
        return self.whole / log.name

    def files(self, log: RemoteLog, within: Path) -> list[Path]:
        """Return the files of a copy that is in a folder, in the order of the log's."""
        if not log.folder:
            return [within / log.name]
        return [within / log.name / name_of(file.url) for file in log.files]

    def is_whole(self, log: RemoteLog) -> bool:
        """Return whether the copy is there, each file with its size."""
        try:
            sizes = [path.stat().st_size for path in self.files(log, self.whole)]
        except OSError:
            return False
        return all(file.size in {None, size} for file, size in zip(log.files, sizes, strict=True))

    def remove(self) -> bool:
        """Remove the copy, unless somebody uses it; return whether it is gone."""
        try:
            with locked(self.lock, wait=False) as had:
                if not had:
                    return False
                # Renamed at first: half a copy never stands in its place.
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
        """Return the bytes that it takes, of a copy on its way too."""
        return sum(_size(path) for folder in (self.whole, self.part) for path in folder.rglob("*"))


def _size(path: Path) -> int:
    try:
        return path.stat().st_size if path.is_file() else 0
    except OSError:
        return 0


def cache_folder() -> Path:
    """Return the folder of the copies: ``IMUCAL_CACHE``, or the user's own for caches.

    Raises ReadError if it can't be made or written to.
    """
    asked = os.environ.get(FOLDER, "").strip()
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    root = Path(asked) if asked else (Path(base) if base else Path.home() / ".cache") / "imucal"
    try:
        root.mkdir(parents=True, exist_ok=True, mode=0o700)
        if not os.access(root, os.W_OK):
            raise PermissionError(13, os.strerror(13))
    except OSError as error:
        why = error.strerror or error
        msg = f"{root}: the cache of remote logs can't be used: {why}; set {FOLDER} to a folder that you own"
        raise ReadError(msg) from error
    return root.resolve()


def cache_size() -> int:
    """Return how many bytes copies may take together: ``IMUCAL_CACHE_SIZE``, or 10 GB; 0 keeps none.

    Raises SettingError if it is no size.
    """
    size = size_setting(SIZE, least=0)
    return _DEFAULT_SIZE if size is None else size


def entry_of(log: RemoteLog) -> Entry:
    """Return the place of a log in the cache."""
    return Entry(cache_folder(), log.key)


def make_room(root: Path, wanted: int, *, most: int) -> None:
    """Remove copies that nobody uses, the least recently used first.

    Until all together take `most` bytes, and `wanted` bytes are free on the disk.

    Raises ReadError if the disk has not so many bytes even then.
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
        msg = (
            f"{root}: no space for a remote log of {wanted / 1e9:.3g} GB: {free / 1e9:.3g} GB are free; "
            f"free some space, or set {FOLDER} to a folder on another disk"
        )
        raise ReadError(msg)


def _lacks(root: Path, wanted: int) -> bool:
    return wanted > 0 and shutil.disk_usage(root).free < wanted + _MARGIN


#: Called with bytes done and bytes in all (0 where nobody knows).
Progress: TypeAlias = Callable[[int, int], None]

#: An object that changes so often while it is read is being written.
_MOST_CHANGES = 3


@frozen
class LocalCopy:
    """The copy of a remote log."""

    #: What it is a copy of.
    log: RemoteLog
    #: The file, or the folder of a bag; valid inside the ``with`` block.
    path: Path
    #: Its files, in the order of `log.files`.
    files: tuple[Path, ...]


@contextmanager
def fetched(
    log: RemoteLog | str, *, progress: Progress | None = None, exact: bool = True
) -> Iterator[LocalCopy]:
    """Lend a copy of a remote log, from the cache or downloaded; nobody removes it meanwhile.

    After use it stays in the cache as far as there is room, unless `RemoteLog.keep` is false or nothing
    tells whether the object has changed. With `exact` a `RemoteLog` that changed is refused, as its results
    would go under the name of another; without it the new one is taken.

    Raises ReadError if there is no such log, it can't be fetched, the disk is full, or it is another than
    `log` by now.
    """
    asked = identify(log) if isinstance(log, str) else log
    for _ in range(_MOST_CHANGES):
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
    """Hold a copy, which is made where there is none."""
    while True:
        with locked(entry.lock, shared=True):
            if entry.is_whole(log):
                # The time of its last use.
                with suppress(OSError):
                    os.utime(entry.lock)
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
            f"{log.shown}: can't write a copy to {entry.root}: {error.strerror or error}; free some space, "
            f"or set {FOLDER} to a folder on another disk"
        )
        raise ReadError(msg) from error
    finally:
        shutil.rmtree(entry.part, ignore_errors=True)


def _download(file: RemoteFile, out: IO[bytes], tell: Callable[[int], None]) -> None:
    """Write an object into an open file; goes on where a connection broke off.

    What came before is no progress: a server that gives no parts and ends early is given up, too.
    """
    store = store_of(file.url)
    attempts = Attempts(file.url)
    done = farthest = 0
    while True:
        try:
            for block in store.blocks(file, done):
                out.write(block)
                done += len(block)
                tell(len(block))
                if done > farthest:
                    farthest = done
                    attempts.went_on()
            if file.size is None or done == file.size:
                return
            if done > file.size:
                raise ChangedError
            attempts.wait(PassingError(f"the connection ended after {done} of {file.size} bytes"))
        except PassingError as error:
            attempts.wait(error)
        if not file.ranges:
            out.seek(0)
            out.truncate()
            tell(-done)
            done = 0
