"""Cache of remote logs: complete copies only; the least recently used copy is removed first.

``KEY/`` is a complete copy, and its time is the last use. ``KEY.….part/`` belongs to one process: a
download, or hard links to a copy. Readers use only such links, so a copy can be removed at any time.
"""

import os
import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeAlias
from uuid import uuid4

from imucal.errors import Fix, ReadError
from imucal.remote.addresses import RemoteLog, name_of, refused
from imucal.remote.stores import Store
from imucal.resources import size_setting

#: Environment variables of the cache: its folder, and its size in bytes.
FOLDER = "IMUCAL_CACHE"
SIZE = "IMUCAL_CACHE_SIZE"
#: Default size in bytes.
_DEFAULT_SIZE = 10 << 30
#: Bytes left free.
_MARGIN = 1 << 24
#: Other folders in the cache do not belong to imucal and are never removed.
_COPY = re.compile(r"[0-9a-f]{32}")
#: Name of a part: its copy, and the process that fetches it.
_PART = re.compile(r"[0-9a-f]{32}\.[0-9a-f]{32}\.part")
#: Age in s from which a part belongs to a process that was killed.
_ABANDONED_S = 86_400.0
#: What to do if the disk of the cache is full.
_OTHER_DISK = f"free some space, or set {FOLDER} to a folder on another disk"

#: Called with the bytes done and the total (0 if unknown).
Progress: TypeAlias = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class LocalCopy:
    """The copy of a remote log."""

    log: RemoteLog
    #: File, or folder of a bag; valid inside the ``with`` block.
    path: Path
    files: tuple[Path, ...]


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
        problem = f"the cache of remote logs can't be used: {error.strerror or error}"
        advice = Fix(f"set {FOLDER} to a folder that you own")
        raise ReadError(problem, place=root, fix=advice) from error
    return root.resolve()


def cache_size() -> int:
    """Return ``IMUCAL_CACHE_SIZE`` in bytes, or 10 GB; 0 keeps no copies. Raises SettingError."""
    size = size_setting(SIZE, least=0)
    return _DEFAULT_SIZE if size is None else size


@contextmanager
def fetched(log: RemoteLog, *, progress: Progress | None = None) -> Iterator[LocalCopy]:
    """Yield a copy of a remote log, from the cache or downloaded.

    It stays in the cache unless `RemoteLog.keep` is false, the ETag is empty, or it is larger than the cache.
    Raises ReadError if the log can't be fetched or has changed, or if the disk is full.
    """
    root = cache_folder()
    copy, own = root / log.key, _part_of(root, log.key)
    files = _files(log, own)
    try:
        if log.etag and _linked(copy, own) and _is_whole(log, files):
            with suppress(OSError):
                os.utime(copy)
        else:
            _remove(own)
            make_room(root, log.size or 0, most=cache_size())
            _download(log, files, progress)
            if log.keep and log.etag and (log.size or 0) <= cache_size():
                _publish(own, copy)
                make_room(root, 0, most=cache_size())
        yield LocalCopy(log=log, path=own / log.name, files=tuple(files))
    finally:
        shutil.rmtree(own, ignore_errors=True)


def _download(log: RemoteLog, files: list[Path], progress: Progress | None) -> None:
    before = 0
    try:
        for file, path in zip(log.files, files, strict=True):
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("xb") as out:
                Store(file.url).download(file, out, partial(_count, log, progress, before))
                before += out.tell()
                out.flush()
                os.fsync(out.fileno())
    except OSError as error:
        raise refused(log.url, f"can't write a copy: {error.strerror or error}", _OTHER_DISK) from error


def _count(log: RemoteLog, progress: Progress | None, before: int, done: int) -> None:
    """Report the bytes of a download; raises ReadError if a log of unknown size does not fit in the cache."""
    # Without a cache, a copy is kept during its use.
    limit = cache_size() or _DEFAULT_SIZE
    if log.size is None and before + done > limit:
        problem = f"it is larger than the cache, {limit / 1e9:.3g} GB; its server does not report its size"
        raise refused(log.url, problem, f"download it, or set {SIZE} to more")
    if progress:
        progress(before + done, log.size or 0)


def _part_of(root: Path, key: str) -> Path:
    return root / f"{key}.{uuid4().hex}.part"


def _files(log: RemoteLog, folder: Path) -> list[Path]:
    """Return the paths of a log's files in a folder of the cache."""
    if not log.folder:
        return [folder / log.name]
    return [folder / log.name / name_of(file.url) for file in log.files]


def _is_whole(log: RemoteLog, files: list[Path]) -> bool:
    try:
        sizes = [path.stat().st_size for path in files]
    except OSError:
        return False
    return all(file.size in {None, size} for file, size in zip(log.files, sizes, strict=True))


def _linked(source: Path, target: Path) -> bool:
    """Make hard links to all files of a folder; return whether that was possible."""
    try:
        shutil.copytree(source, target, copy_function=os.link)
        # The copied time of the folder would make it look abandoned.
        os.utime(target)
    except OSError:
        return False
    return True


def _publish(own: Path, copy: Path) -> None:
    """Add a complete copy to the cache; another process may do the same at the same time."""
    new = _part_of(copy.parent, copy.name)
    if _linked(own, new):
        _remove(copy)
        with suppress(OSError):
            new.rename(copy)
    shutil.rmtree(new, ignore_errors=True)


def _remove(folder: Path) -> None:
    """Remove a folder; it gets another name first, because a partly removed copy must not be used."""
    gone = _part_of(folder.parent, folder.name.partition(".")[0])
    with suppress(OSError):
        folder.rename(gone)
        shutil.rmtree(gone)


def make_room(root: Path, wanted: int, *, most: int) -> None:
    """Remove copies until the cache takes at most `most` bytes and `wanted` bytes are free.

    Raises ReadError if fewer are free at the end.
    """
    last_use: dict[Path, float] = {}
    for folder in root.iterdir():
        with suppress(OSError):
            if _COPY.fullmatch(folder.name):
                last_use[folder] = folder.stat().st_mtime
            elif _PART.fullmatch(folder.name) and _is_abandoned(folder):
                _remove(folder)
    copies = sorted(last_use, key=last_use.__getitem__)
    sizes = [sum(map(_size, folder.rglob("*"))) for folder in copies]
    total = sum(sizes)
    for folder, size in zip(copies, sizes, strict=True):
        if total > most or _lacks(root, wanted):
            _remove(folder)
            total -= size
    if _lacks(root, wanted):
        free = shutil.disk_usage(root).free / 1e9
        problem = f"no space for a remote log of {wanted / 1e9:.3g} GB: {free:.3g} GB are free"
        raise ReadError(problem, place=root, fix=Fix(_OTHER_DISK))


def _is_abandoned(folder: Path) -> bool:
    """Return whether nothing was written in a folder, or used from it, for a day."""
    newest = max(path.stat().st_mtime for path in (folder, *folder.rglob("*")))
    return newest < time.time() - _ABANDONED_S


def _size(path: Path) -> int:
    try:
        return path.stat().st_size if path.is_file() else 0
    except OSError:
        return 0


def _lacks(root: Path, wanted: int) -> bool:
    return wanted > 0 and shutil.disk_usage(root).free < wanted + _MARGIN
