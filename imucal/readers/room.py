"""Room for what reading holds: in memory up to a limit of bytes, in temporary files above it.

A temporary file has no name, so nothing is left behind whatever happens.
"""

import mmap
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import BoolArray, IntArray
from imucal.errors import ReadError
from imucal.mapped import blocks
from imucal.resources import column_limit

T = TypeVar("T", bound=np.generic)

#: The share of what may be held that one array may take: some ten are there at a time.
_SHARE = 16


class Spill:
    """A temporary file of values."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(prefix="imucal-")  # noqa: SIM115 - closed when it is mapped
        self._size = 0

    def __del__(self) -> None:
        """Close the file of a log whose reading was given up."""
        self._file.close()

    def write(self, values: NDArray[Any]) -> None:
        """Append values."""
        self._size += values.nbytes
        try:
            self._file.write(values.data)
        except OSError as error:
            raise self._full(error) from error

    def become_float(self) -> None:
        """Turn the integers written so far into floats, which take as many bytes."""
        if self._size:
            integers, _ = self._map(np.int64)
            self._file.seek(0)
            for part in blocks(integers.size, integers):
                self._file.write(integers[part].astype(np.float64).data)

    def take(self, dtype: np.dtype[Any], size: int = 0) -> tuple[NDArray[Any], mmap.mmap]:
        """Return an array of all that was written, or of `size` bytes; the file vanishes with it."""
        try:
            if size:
                self._size = size
                self._reserve(size)
            return self._map(dtype)
        except OSError as error:
            raise self._full(error) from error
        finally:
            self._file.close()

    def _reserve(self, size: int) -> None:
        """Make room for bytes that are written through a map: what is missing then ends the process."""
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(self._file.fileno(), 0, size)
        else:
            self._file.truncate(size)

    def _map(self, dtype: type[Any] | np.dtype[Any]) -> tuple[NDArray[Any], mmap.mmap]:
        self._file.flush()
        held = mmap.mmap(self._file.fileno(), self._size)
        return np.frombuffer(held, dtype=dtype), held

    def _full(self, error: OSError) -> ReadError:
        where = Path(tempfile.gettempdir())
        return ReadError(
            f"{where}: no room for {self._size / 1e9:.1f} GB of samples: {error.strerror or error}"
        )


class Room:
    """Where arrays are made, block by block.

    Parameters
    ----------
    limit
        Bytes that may be held; an array of more than a sixteenth of them lies in a temporary file. None for
        `imucal.resources.column_limit`.
    """

    def __init__(self, limit: int | None = None) -> None:
        self._most = (column_limit() if limit is None else limit) // _SHARE

    def empty(self, n: int, dtype: type[T] | np.dtype[T]) -> NDArray[T]:
        """Return an array of n values that are not set."""
        size = n * np.dtype(dtype).itemsize
        if size <= self._most or not size:
            return np.empty(n, dtype=dtype)
        values: NDArray[T] = Spill().take(np.dtype(dtype), size)[0]
        return values

    def made(
        self, n: int, dtype: type[T] | np.dtype[T], of: Callable[[slice], Any], *sources: NDArray[Any]
    ) -> NDArray[T]:
        """Return an array of n values of which `of` gives each block, from the `sources`."""
        result = self.empty(n, dtype)
        for part in blocks(n, result, *sources):
            result[part] = of(part)
        return result

    def copied(self, values: NDArray[T]) -> NDArray[T]:
        """Return a copy of an array of shape (n,)."""
        return self.made(values.size, values.dtype, lambda part: values[part], values)

    def taken(self, values: NDArray[T], order: IntArray) -> NDArray[T]:
        """Return the values at some places, in their order."""
        return self.made(order.size, values.dtype, lambda part: values[order[part]], values, order)

    def chosen(self, values: NDArray[T], keep: BoolArray) -> NDArray[T]:
        """Return the values where `keep` is true."""
        result = self.empty(count(keep), values.dtype)
        end = 0
        for part in blocks(keep.size, keep, values, result):
            some = values[part][keep[part]]
            result[end : end + some.size] = some
            end += some.size
        return result

    def places(self, keep: BoolArray) -> IntArray:
        """Return the places where `keep` is true, in order."""
        result = self.empty(count(keep), np.int64)
        end = 0
        for part in blocks(keep.size, keep, result):
            some = np.flatnonzero(keep[part])
            result[end : end + some.size] = some
            result[end : end + some.size] += part.start
            end += some.size
        return result


def count(keep: BoolArray) -> int:
    """Return at how many places `keep` is true."""
    return sum(int(np.count_nonzero(keep[part])) for part in blocks(keep.size, keep))


def extremes(values: NDArray[Any]) -> tuple[Any, Any]:
    """Return the lowest and the highest of some values, of which there is one at least."""
    found = [(values[part].min(), values[part].max()) for part in blocks(values.size, values)]
    return min(low for low, _ in found), max(high for _, high in found)


def equal(first: NDArray[Any], second: NDArray[Any]) -> bool:
    """Return whether two arrays of one size hold the same."""
    return all(bool((first[part] == second[part]).all()) for part in blocks(first.size, first, second))
