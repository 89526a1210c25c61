"""Columns that grow block by block: in memory up to a limit, in a temporary file above it."""

import os
import tempfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["GrowingColumn", "default_memory_limit"]


def default_memory_limit() -> int:
    """Return a quarter of the machine's memory, in bytes; 2 GiB where it can't be asked."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 4
    except (AttributeError, ValueError, OSError):
        return 2 << 30


class GrowingColumn:
    """Values of one column, appended block by block.

    Parameters
    ----------
    dtype
        ``int64`` or ``float64``.
    limit
        Bytes to hold in memory; beyond them the values go to a temporary file that vanishes with
        the array.
    """

    def __init__(self, dtype: type[np.generic], *, limit: int) -> None:
        self._dtype = np.dtype(dtype)
        self._limit = limit
        self._parts: list[NDArray[Any]] = []
        self._held = 0
        self._file: Any = None
        self.size = 0

    @property
    def is_integer(self) -> bool:
        """Whether all values so far are integers."""
        return self._dtype.kind == "i"

    def append(self, values: NDArray[Any]) -> None:
        """Append a block; a block of floats turns a column of integers into one of floats."""
        if self.is_integer and values.dtype.kind == "f":
            self._become_float()
        # A copy, because the parser's memory goes away with its block.
        part = np.array(values, dtype=self._dtype)
        self._parts.append(part)
        self._held += part.nbytes
        self.size += part.size
        if self._held > self._limit or self._file is not None:
            self._spill()

    def take(self) -> NDArray[Any]:
        """Return all values as one array, and forget them."""
        if self._file is not None:
            self._file.flush()
            array: NDArray[Any] = np.memmap(self._file, dtype=self._dtype, mode="r", shape=(self.size,))
            self._file.close()
            self._file = None
            return array
        if len(self._parts) == 1:
            return self._parts.pop()
        array = np.empty(self.size, dtype=self._dtype)
        place = 0
        self._parts.reverse()
        while self._parts:
            part = self._parts.pop()
            array[place : place + part.size] = part
            place += part.size
        return array

    def _spill(self) -> None:
        if self._file is None:
            # It has no name, so nothing is left behind whatever happens.
            self._file = tempfile.TemporaryFile(prefix="imucal-")  # noqa: SIM115 - lives as long as the column
        for part in self._parts:
            self._file.write(part)
        self._parts.clear()
        self._held = 0

    def _become_float(self) -> None:
        self._parts = [part.astype(np.float64) for part in self._parts]
        if self._file is not None and self.size:
            self._file.flush()
            written = self.size - sum(part.size for part in self._parts)
            old = np.memmap(self._file, dtype=self._dtype, mode="r", shape=(written,)).astype(np.float64)
            self._file.seek(0)
            self._file.write(old)
        self._dtype = np.dtype(np.float64)
