"""Locks between processes that the system takes back when their holder dies."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: an open file can't be removed there, which protects what is in use
    fcntl = None  # type: ignore[assignment]


@contextmanager
def locked(path: Path, *, shared: bool = False, wait: bool = True) -> Iterator[bool]:
    """Hold the lock that is the file `path`; yield whether it was had, which only `wait=False` leaves open.

    Whoever holds it alone may remove the file: those who wait for it then take the new one.
    """
    held = _acquire(path, shared=shared, wait=wait)
    try:
        yield held is not None
    finally:
        if held is not None:
            os.close(held)


def _acquire(path: Path, *, shared: bool, wait: bool) -> int | None:
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            if fcntl is not None:
                kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
                fcntl.flock(file, kind if wait else kind | fcntl.LOCK_NB)
            if _is_at(file, path):
                return file
        except BlockingIOError:
            os.close(file)
            return None
        except BaseException:
            os.close(file)
            raise
        os.close(file)


def _is_at(file: int, path: Path) -> bool:
    """Return whether an open file is still the one of that name."""
    try:
        there = path.stat()
    except OSError:
        return False
    return os.path.samestat(os.fstat(file), there)
