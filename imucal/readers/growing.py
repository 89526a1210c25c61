"""Columns to which blocks of samples are appended."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Initial capacity in values.
_FIRST = 1 << 16


class GrowingColumn:
    """A column of int64 or float64 to which blocks are appended.

    Memory is reserved for `expected` values; the system provides pages at the first use.
    """

    def __init__(self, dtype: type[np.generic], *, expected: int = 0) -> None:
        self._filled = 0
        self._held: NDArray[Any] = np.empty(max(expected, _FIRST), dtype)

    def append(self, values: NDArray[Any]) -> None:
        """Append a block; floats convert a column of integers."""
        size = self._held.size
        stop = self._filled + values.size
        floats = self._held.dtype.kind == "i" and values.dtype.kind == "f"
        if floats or stop > size:
            dtype = np.dtype(np.float64) if floats else self._held.dtype
            larger = np.empty(max(stop, 2 * size) if stop > size else size, dtype)
            larger[: self._filled] = self._held[: self._filled]
            self._held = larger
        self._held[self._filled : stop] = values
        self._filled = stop

    def take(self) -> NDArray[Any]:
        """Return the values and give up the memory."""
        array = self._held
        self._held = array[:0]
        # Shrinking releases pages without a copy.
        array.resize(self._filled, refcheck=False)
        return array
