"""Arrays in memory up to a limit of bytes, in nameless temporary files above it."""

import mmap
import os
import tempfile
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import BoolArray, FloatArray, IntArray, blocks, never_changes, release
from imucal.readers.files import refusing
from imucal.resources import column_limit

#: Columns of messages, shape (n,) each: log times in ns, then the requested numbers.
Block: TypeAlias = Sequence[NDArray[Any]]

T = TypeVar("T", bound=np.generic)

#: About ten arrays exist at a time.
_SHARE = 16
#: Bytes written before their pages are released.
_FLUSH = 1 << 25
#: Initial capacity of a growing column.
_FIRST = 1 << 16


def allocated(n: int, dtype: type[T] | np.dtype[T], most: int) -> NDArray[T]:
    """Return an array of n unset values, in a temporary file above `most` bytes.

    Raises ReadError if the disk has too little space: a later failure would kill the process.
    """
    size = n * np.dtype(dtype).itemsize
    if size <= most or not size:
        return np.empty(n, dtype)
    text = f"no space for {size / 1e9:.1f} GB of samples"
    with refusing(tempfile.gettempdir(), text), tempfile.TemporaryFile(prefix="imucal-") as file:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, size)
        else:
            file.truncate(size)
        return np.frombuffer(mmap.mmap(file.fileno(), size), dtype=dtype)


class Room:
    """Allocates and computes arrays block by block.

    An array above a sixteenth of `limit`, in bytes, is in a temporary file.
    """

    def __init__(self, limit: int | None = None) -> None:
        self._most = (column_limit() if limit is None else limit) // _SHARE

    def empty(self, n: int, dtype: type[T] | np.dtype[T]) -> NDArray[T]:
        return allocated(n, dtype, self._most)

    def made(
        self, n: int, dtype: type[T] | np.dtype[T], of: Callable[[slice], Any], *sources: NDArray[Any]
    ) -> NDArray[T]:
        """Return an array of n values; `of` computes each block."""
        result = self.empty(n, dtype)
        for part in blocks(n, result, *sources):
            result[part] = of(part)
        return result

    def copied(self, values: NDArray[T]) -> NDArray[T]:
        return self.made(values.size, values.dtype, lambda part: values[part], values)

    def taken(self, values: NDArray[T], order: IntArray) -> NDArray[T]:
        return self.made(order.size, values.dtype, lambda part: values[order[part]], values, order)

    def chosen(self, values: NDArray[T], keep: BoolArray) -> NDArray[T]:
        return self._gathered(keep, values.dtype, lambda part: values[part][keep[part]], values)

    def places(self, keep: BoolArray) -> IntArray:
        return self._gathered(keep, np.int64, lambda part: np.flatnonzero(keep[part]) + part.start)

    def _gathered(
        self,
        keep: BoolArray,
        dtype: type[T] | np.dtype[T],
        of: Callable[[slice], Any],
        *sources: NDArray[Any],
    ) -> NDArray[T]:
        result = self.empty(count(keep), dtype)
        end = 0
        for part in blocks(keep.size, keep, *sources, result):
            some = of(part)
            result[end : end + some.size] = some
            end += some.size
        return result


def count(keep: BoolArray) -> int:
    """Return the number of true values."""
    return sum(int(np.count_nonzero(keep[part])) for part in blocks(keep.size, keep))


def extremes(values: NDArray[Any]) -> tuple[Any, Any]:
    """Return the smallest and the largest of at least one value."""
    found = [(values[part].min(), values[part].max()) for part in blocks(values.size, values)]
    return min(low for low, _ in found), max(high for _, high in found)


def equal(first: NDArray[Any], second: NDArray[Any]) -> bool:
    """Return whether two arrays of the same size are equal."""
    return all(bool((first[part] == second[part]).all()) for part in blocks(first.size, first, second))


def copy_to(target: NDArray[Any], source: NDArray[Any]) -> None:
    """Copy an array block by block, releasing mapped pages."""
    for part in blocks(source.size, target, source):
        target[part] = source[part]


def join_rows(pieces: Sequence[Sequence[FloatArray]], *, limit: int | None = None) -> list[FloatArray]:
    """Return joined rows; in a temporary file above `limit` bytes in total."""
    rows = [sum(piece.size for piece in row) for row in pieces]
    held = allocated(sum(rows), np.float64, column_limit() if limit is None else limit)
    joined, start = [], 0
    for row, n in zip(pieces, rows, strict=True):
        joined.append(held[start : start + n])
        for piece in row:
            copy_to(held[start : start + piece.size], piece)
            start += piece.size
    return joined


class GrowingColumn:
    """A column of int64 or float64 to which blocks are appended, in a temporary file above `limit` bytes.

    Memory is reserved for `expected` values; unused pages take none.
    """

    def __init__(self, dtype: type[np.generic], *, limit: int, expected: int = 0) -> None:
        self._limit = limit
        self._filled = 0
        self._held: NDArray[Any] = allocated(max(expected, _FIRST), dtype, limit)

    def append(self, values: NDArray[Any]) -> None:
        """Append a block; floats convert a column of integers."""
        size, stop = self._held.size, self._filled + values.size
        floats = self._held.dtype.kind == "i" and values.dtype.kind == "f"
        if floats or stop > size:
            dtype = np.dtype(np.float64) if floats else self._held.dtype
            larger = allocated(max(stop, 2 * size) if stop > size else size, dtype, self._limit)
            copy_to(larger[: self._filled], self._held[: self._filled])
            self._held = larger
        self._held[self._filled : stop] = values
        if self._filled * 8 // _FLUSH != stop * 8 // _FLUSH:
            release(self._held)
        self._filled = stop

    def take(self) -> NDArray[Any]:
        array, self._held = self._held, self._held[:0]
        if array.flags.owndata:
            # Shrinking releases pages without a copy.
            array.resize(self._filled, refcheck=False)
        return array[: self._filled]


def is_constant(rows: Sequence[NDArray[Any]] | NDArray[Any]) -> bool:
    """Return whether every row of samples is constant."""
    return all(never_changes(row) for row in rows if row.size)
