"""Columns that grow block by block: in memory up to a limit, in a temporary file above it."""

import tempfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Values that a column has room for at first.
_FIRST = 1 << 16


class GrowingColumn:
    """Values of one column, appended block by block.

    Parameters
    ----------
    dtype
        ``int64`` or ``float64``.
    limit
        Bytes to hold in memory; beyond them the values go to a temporary file that vanishes with
        the array.
    expected
        Values to make room for; memory that is never filled is never taken.
    """

    def __init__(self, dtype: type[np.generic], *, limit: int, expected: int = 0) -> None:
        self._limit = limit
        room = min(max(expected, _FIRST), limit // 8 + _FIRST)
        self._held: NDArray[Any] = np.empty(room, dtype=dtype)
        self._filled = 0
        self._file: Any = None
        self.size = 0

    @property
    def is_integer(self) -> bool:
        """Whether all values so far are integers."""
        return self._held.dtype.kind == "i"

    def append(self, values: NDArray[Any]) -> None:
        """Append a block; a block of floats turns a column of integers into one of floats."""
        if self.is_integer and values.dtype.kind == "f":
            self._become_float()
        stop = self._filled + values.size
        if stop > self._held.size:
            larger = np.empty(max(stop, 2 * self._held.size), dtype=self._held.dtype)
            larger[: self._filled] = self._held[: self._filled]
            self._held = larger
        self._held[self._filled : stop] = values
        self._filled = stop
        self.size += values.size
        if self._filled * self._held.itemsize > self._limit:
            self._spill()

    def take(self) -> NDArray[Any]:
        """Return all values as one array, and forget them."""
        if self._file is None:
            array, self._held = self._held, np.empty(0, dtype=self._held.dtype)
            # Shrinking gives pages back and copies nothing.
            array.resize(self._filled, refcheck=False)
            return array
        self._spill()
        self._file.flush()
        mapped: NDArray[Any] = np.memmap(self._file, dtype=self._held.dtype, mode="r", shape=(self.size,))
        self._file.close()
        self._file = None
        return mapped

    def _spill(self) -> None:
        if self._file is None:
            # It has no name, so nothing is left behind whatever happens.
            self._file = tempfile.TemporaryFile(prefix="imucal-")  # noqa: SIM115 - lives as long as the column
        self._file.write(self._held[: self._filled])
        self._filled = 0

    def _become_float(self) -> None:
        self._held = self._held.astype(np.float64)
        written = self.size - self._filled
        if self._file is not None and written:
            self._file.flush()
            old = np.memmap(self._file, dtype=np.int64, mode="r", shape=(written,)).astype(np.float64)
            self._file.seek(0)
            self._file.write(old)
