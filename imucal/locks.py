"""Locks between processes that use the same file or folder."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["locked"]


@contextmanager
def locked(path: Path, *, shared: bool = False, wait: bool = True) -> Iterator[bool]:
    """Hold the lock of a folder, or of a file, which is created; yield whether it was acquired.

    Several processes can hold a `shared` lock. Without `wait`, a lock that another process holds is not
    acquired. Where there are no locks (Windows, some network file systems), each is acquired. The holder of
    an exclusive lock may remove the file: processes that waited for it then lock the new one. Raises OSError
    if the file can't be opened.
    """
    while True:
        handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR | os.O_CREAT, 0o666)
        try:
            acquired = _acquire(handle, shared=shared, wait=wait)
            if not acquired or _is_at(handle, path):
                yield acquired
                return
        finally:
            os.close(handle)


def _acquire(handle: int, *, shared: bool, wait: bool) -> bool:
    try:
        import fcntl
    except ImportError:
        # Windows has no such module.
        return True
    kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
    try:
        fcntl.flock(handle, kind if wait else kind | fcntl.LOCK_NB)
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
