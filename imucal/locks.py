"""Locks between processes that use the same file or folder."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["locked"]


@contextmanager
def locked(path: Path, *, wait: bool = True) -> Iterator[bool]:
    """Hold the lock of a folder, or of a file, which is created; yield whether it was acquired.

    Without `wait`, a lock that another process holds is not acquired. Where there are no locks (Windows, some
    network file systems), each is acquired. The holder of a lock may remove the file: processes that waited
    for it then lock the new one. Raises OSError if the file can't be opened.
    """
    while True:
        handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR | os.O_CREAT, 0o666)
        try:
            acquired = _acquire(handle, wait=wait)
            if not acquired or _is_at(handle, path):
                yield acquired
                return
        finally:
            os.close(handle)


def _acquire(handle: int, *, wait: bool) -> bool:
    try:
        import fcntl
    except ImportError:
        # Windows has no such module.
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        # This file system has no locks.
        return True
    return True


def _is_at(handle: int, path: Path) -> bool:
    """Return whether an open file is still the one at `path`."""
    with suppress(OSError):
        return os.path.samestat(os.fstat(handle), path.stat())
    return False
