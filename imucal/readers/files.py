"""Read bytes of a log file from any thread."""

import stat
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from imucal.errors import Fix, ImucalError, ReadError

#: Name of standard input in messages.
STANDARD_INPUT = "standard input"

Refusal = TypeVar("Refusal", bound=ImucalError)


def refused(
    where: object,
    problem: str,
    kind: type[Refusal] = ReadError,  # type: ignore[assignment]
    *fixes: Fix,
    code: str = "",
) -> Refusal:
    """Return the error for a log that can't be read; one of the fixes is enough."""
    return kind(problem, place=where, fixes=fixes, code=code)


@contextmanager
def refusing(where: object, text: str) -> Iterator[None]:
    """Convert errors of the operating system to ReadError; `text` is such as ``can't be opened``."""
    try:
        yield
    except OSError as error:
        raise refused(where, f"{text}: {error.strerror or error}") from error


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Add the path of a log to errors whose place is not within it."""
    try:
        yield
    except ReadError as error:
        # The place may be a file in a folder.
        if error.place.startswith((str(path), STANDARD_INPUT)):
            raise
        raise error.within(path) from error


class DamagedError(Exception):
    """A part of a log can't be decoded; `code` is the finding's code. Caught within the readers."""

    def __init__(self, text: str, code: str = "damaged") -> None:
        super().__init__(text)
        self.code = code


def damaged_if(wrong: object, text: str, code: str = "damaged") -> None:
    """Raise DamagedError if `wrong`."""
    if wrong:
        raise DamagedError(text, code)


def require_file(path: Path) -> None:
    """Raise ReadError unless a path is a regular file, or a link to one.

    Reading a pipe may wait forever, and devices such as /dev/zero have no end.
    """
    with refusing(path, "can't be opened"):
        mode = path.stat().st_mode
    if not stat.S_ISREG(mode):
        kinds = {stat.S_IFIFO: "a pipe", stat.S_IFDIR: "a folder", stat.S_IFSOCK: "a socket"}
        found = kinds.get(stat.S_IFMT(mode), "a device")
        raise refused(path, f"{found}; expected a regular file, copy the data to one")


def first_bytes(path: Path, size: int) -> bytes:
    """Return the first bytes of a file; raises ReadError if it can't be opened."""
    with refusing(path, "can't be opened"), path.open("rb") as file:
        return file.read(size)


class LogFile:
    """A file read by absolute position; thread-safe."""

    def __init__(self, path: Path) -> None:
        with refusing(path, "can't be opened"):
            self._file = path.open("rb")
            self.size = path.stat().st_size
        self.path = path
        self._lock = threading.Lock()

    def close(self) -> None:
        self._file.close()

    def read(self, position: int, size: int) -> bytes:
        """Return bytes from a position; raises DamagedError if the file ends earlier."""
        beyond = min(position, size) < 0 or position + size > self.size
        damaged_if(beyond, f"{size} bytes at byte {position} are beyond the end of the file", "truncated")
        data = self._bytes(position, size)
        end = position + len(data)
        damaged_if(len(data) < size, f"the file ended at byte {end} during reading", "truncated")
        return data

    def _bytes(self, position: int, size: int) -> bytes:
        # A scan calls this for each record, so it does not use `refusing`.
        try:
            with self._lock:
                self._file.seek(position)
                return self._file.read(size)
        except OSError as error:
            text = f"can't be read at byte {position}: {error.strerror or error}"
            raise refused(self.path, text) from error
