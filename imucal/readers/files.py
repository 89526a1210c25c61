"""Bytes of a log file, read at any place by any thread, and the buffers each thread keeps."""

import os
import threading
from pathlib import Path
from typing import TypeVar

from imucal.errors import ImucalError, ReadError
from imucal.findings import Finding

Refusal = TypeVar("Refusal", bound=ImucalError)


def refused(where: object, text: str, kind: type[Refusal] = ReadError) -> Refusal:  # type: ignore[assignment]
    """Return the error of a log that is not read: `where`, and what was found, expected and to be done."""
    return kind(f"{where}: {text}")


class DamagedError(Exception):
    """A part of a log can't be decoded; `code` is the finding it leads to. Never leaves the readers."""

    def __init__(self, text: str, code: str = "damaged") -> None:
        super().__init__(text)
        self.code = code


def damaged_if(wrong: object, text: str, code: str = "damaged") -> None:
    """Raise a DamagedError where something is wrong."""
    if wrong:
        raise DamagedError(text, code)


def first_bytes(path: Path, size: int) -> bytes:
    """Return the first bytes of a file; a ReadError if it can't be opened."""
    try:
        with path.open("rb") as file:
            return file.read(size)
    except OSError as error:
        raise refused(path, f"can't be opened: {error.strerror or error}") from error


class LogFile:
    """A file read by absolute position; safe to share between threads.

    Positioned reads into a buffer that is used again beat a memory map for uncompressed logs, keep the
    file's pages out of the process, and can't raise SIGBUS on a file that is cut while it is read.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._file = path.open("rb", buffering=0)
            self.size = path.stat().st_size
        except OSError as error:
            raise refused(path, f"can't be opened: {error.strerror or error}") from error
        self.path = path
        self._lock = threading.Lock()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def scan_finding(self, reason: DamagedError, end: int) -> Finding:
        """Return the finding of a file whose records were scanned up to `end`, as its index has damage."""
        text = f"The index can't be used ({reason}); all records were scanned instead."
        if end < self.size:
            text += f" The last {self.size - end} of {self.size} bytes are cut off or damaged."
        code = "truncated" if end < self.size else reason.code
        return Finding("warning", code, text)

    def into(self, position: int, view: memoryview) -> None:
        """Fill `view` with the bytes from `position` on.

        Raises DamagedError if the file ends before.
        """
        damaged_if(
            position < 0 or position + len(view) > self.size,
            f"bytes {position} to {position + len(view)} are beyond the end of the file",
            "truncated",
        )
        self._fill(position, view)

    def _fill(self, position: int, view: memoryview) -> None:
        done = 0
        while done < len(view):
            count = self._read_some(position + done, view[done:])
            damaged_if(not count, f"the file ended at byte {position + done} during reading", "truncated")
            done += count

    def read(self, position: int, size: int) -> bytearray:
        """Return `size` bytes from `position` on; raises DamagedError if the file ends before."""
        beyond = size < 0 or position + size > self.size
        damaged_if(beyond, f"{size} bytes at byte {position} are beyond the end of the file", "truncated")
        data = bytearray(size)
        self.into(position, memoryview(data))
        return data

    def _read_some(self, position: int, view: memoryview) -> int:
        try:
            if hasattr(os, "preadv"):
                return os.preadv(self._file.fileno(), [view], position)
            with self._lock:
                self._file.seek(position)
                return self._file.readinto(view) or 0
        except OSError as error:
            msg = f"{self.path}: can't be read at byte {position}: {error.strerror or error}"
            raise ReadError(msg) from error


class Scratch:
    """The buffer of one thread, used again for every chunk so that memory is touched once."""

    def __init__(self) -> None:
        self._held = bytearray()

    def buffer(self, size: int) -> memoryview:
        """Return a buffer of `size` bytes; its content is that of the last use."""
        if len(self._held) < size:
            self._held = bytearray(size + size // 8)
        return memoryview(self._held)[:size]
