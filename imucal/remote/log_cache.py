"""The cache of remote logs: a folder for each, whole or not at all; the least recently used goes first.

::

    KEY.lock     held by whoever reads the copy (shared) or makes and removes it (alone); its time is that of
                 the last use
    KEY/         the copy: a file, or the folder of a bag, under the log's own name
    KEY.part/    a copy on its way
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from imucal.errors import ReadError
from imucal.remote.addresses import name_of
from imucal.remote.file_locks import locked
from imucal.remote.remote_log import RemoteLog
from imucal.resources import size_setting

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

    def used(self) -> None:
        """Note that the copy is used now."""
        with suppress(OSError):
            os.utime(self.lock)

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

    Raises
    ------
    ReadError
        If it can't be made or written to.
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
        msg = f"{root}: the cache of remote logs can't be used: {why}; set {FOLDER} to a folder of yours"
        raise ReadError(msg) from error
    return root.resolve()


def cache_size() -> int:
    """Return how many bytes copies may take together: ``IMUCAL_CACHE_SIZE``, or 10 GB; 0 keeps none.

    Raises
    ------
    SettingError
        If it is no size.
    """
    size = size_setting(SIZE, least=0)
    return _DEFAULT_SIZE if size is None else size


def entry_of(log: RemoteLog) -> Entry:
    """Return the place of a log in the cache."""
    return Entry(cache_folder(), log.key)


def forget(log: RemoteLog) -> bool:
    """Remove the copy of a log, unless somebody uses it; return whether none is left."""
    return entry_of(log).remove()


def make_room(root: Path, wanted: int, *, most: int) -> None:
    """Remove copies that nobody uses, the least recently used first.

    Until all together take `most` bytes, and `wanted` bytes are free on the disk.

    Raises
    ------
    ReadError
        If the disk has not so many bytes even then.
    """
    entries = list(_by_last_use(root))
    sizes = [entry.size() for entry in entries]
    total = sum(sizes)
    for entry, size in zip(entries, sizes, strict=True):
        crowded = size > 0 and (total > most or _lacks(root, wanted))
        if (crowded or not size) and entry.remove():
            total -= size
    if _lacks(root, wanted):
        free = shutil.disk_usage(root).free
        msg = (
            f"{root}: no room for a remote log of {wanted / 1e9:.3g} GB: {free / 1e9:.3g} GB are free; "
            f"free some space, or set {FOLDER} to a folder on another disk"
        )
        raise ReadError(msg)


def _lacks(root: Path, wanted: int) -> bool:
    return wanted > 0 and shutil.disk_usage(root).free < wanted + _MARGIN


def _by_last_use(root: Path) -> Iterator[Entry]:
    used: list[tuple[float, str]] = []
    for path in root.glob("*.lock"):
        with suppress(OSError):
            used.append((path.stat().st_mtime, path.stem))
    return (Entry(root, key) for _, key in sorted(used))
