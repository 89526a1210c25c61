"""Room for what reading holds: in memory up to a limit of bytes, in temporary files above it.

A temporary file has no name, so nothing is left behind whatever happens. `Columns` are written at any place
by several threads, their number of samples known beforehand; a `GrowingColumn` takes block after block.
"""

import mmap
import os
import tempfile
from collections.abc import Callable, Sequence
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import BoolArray, FloatArray, IntArray, blocks, never_changes, release
from imucal.errors import ReadError
from imucal.recording import Sensor
from imucal.resources import column_limit

T = TypeVar("T", bound=np.generic)

#: The share of what may be held that one array may take: some ten are there at a time.
_SHARE = 16
#: Bytes written before their pages are given back to the system.
_FLUSH = 1 << 25
#: Bytes that wait for the temporary file.
_PIECE = 1 << 22
#: Values that a growing column has room for at first.
_FIRST = 1 << 16


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
        return self._gathered(keep, values.dtype, lambda part: values[part][keep[part]], values)

    def places(self, keep: BoolArray) -> IntArray:
        """Return the places where `keep` is true, in order."""
        return self._gathered(keep, np.int64, lambda part: np.flatnonzero(keep[part]) + part.start)

    def _gathered(
        self,
        keep: BoolArray,
        dtype: type[T] | np.dtype[T],
        of: Callable[[slice], Any],
        *sources: NDArray[Any],
    ) -> NDArray[T]:
        """Return what `of` gives of each block, one behind the other: a value for each place that is kept."""
        result = self.empty(count(keep), dtype)
        end = 0
        for part in blocks(keep.size, keep, *sources, result):
            some = of(part)
            result[end : end + some.size] = some
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


class Columns:
    """Stamps and samples of one topic, one contiguous row a quantity.

    Attributes
    ----------
    stamps, log
        Shape (n,), int64, in ns.
    vectors
        Sensor -> shape (3, n), float64; of a sensor with fewer axes a row for each.
    temperature
        Shape (n,), or None.
    """

    def __init__(
        self,
        n: int,
        sensors: tuple[Sensor, ...],
        *,
        temperature: bool,
        limit: int | None = None,
        axes: tuple[int, ...] = (),
    ) -> None:
        self._axes = axes or (3,) * len(sensors)
        shape = (2 + sum(self._axes) + int(temperature), n)
        size = 8 * shape[0] * n
        self._limit = limit
        self._map: mmap.mmap | None = None
        self._written = 0
        if size > (column_limit() if limit is None else limit):
            values, self._map = Spill().take(np.dtype(np.float64), size)
            self._data: FloatArray = values.reshape(shape)
        else:
            self._data = np.empty(shape)
        self._view(self._data, sensors, temperature=temperature)

    def _view(self, data: FloatArray, sensors: tuple[Sensor, ...], *, temperature: bool) -> None:
        self.stamps: IntArray = data[0].view(np.int64)
        self.log: IntArray = data[1].view(np.int64)
        ends = [2, *(2 + end for end in accumulate(self._axes))]
        self.vectors: dict[Sensor, FloatArray] = {
            sensor: data[first:stop] for sensor, (first, stop) in zip(sensors, pairwise(ends), strict=True)
        }
        self.temperature: FloatArray | None = data[-1] if temperature else None
        self.rows: list[FloatArray] = list(data)

    @property
    def n(self) -> int:
        """Number of samples."""
        return self.stamps.size

    def wrote(self, size: int) -> None:
        """Count bytes written; now and then hand the pages of a mapped file back to the system."""
        if self._map is None:
            return
        self._written += size
        if self._written >= _FLUSH:
            self._written = 0
            self.release()

    def release(self) -> None:
        """Hand the pages of a mapped file back to the system; they are read again when used."""
        if self._map is not None:
            release(self._data)

    def like(self, n: int, *, limit: int | None = None) -> "Columns":
        """Return columns for n samples of the same sensors."""
        return Columns(
            n,
            tuple(self.vectors),
            temperature=self.temperature is not None,
            limit=self._limit if limit is None else limit,
            axes=self._axes,
        )

    def joined(self, others: Sequence["Columns"]) -> "Columns":
        """Return these samples and those of others behind them."""
        parts = [part for part in (self, *others) if part.n]
        whole = self.like(sum(part.n for part in parts))
        start = 0
        for part in parts:
            for row, values in zip(whole.rows, part.rows, strict=True):
                copy_to(row[start : start + part.n], values)
            start += part.n
        return whole

    def keep_spans(self, spans: list[tuple[int, int]]) -> None:
        """Keep the samples of some spans (start, stop), in order, in place."""
        end = 0
        for start, stop in spans:
            if start != end:
                for row in self.rows:
                    # Forward moves of overlapping ranges: NumPy copies through a buffer where they overlap.
                    copy_to(row[end : end + stop - start], row[start:stop])
            end += stop - start
        if end != self.n:
            self._view(self._data[:, :end], tuple(self.vectors), temperature=self.temperature is not None)

    def reorder(self, first: int, order: IntArray) -> None:
        """Put the samples from `first` on in another order, in place, row by row; `order` counts from it."""
        for row in self.rows:
            part = row[first : first + order.size]
            part[:] = part[order]


def copy_to(target: NDArray[Any], source: NDArray[Any]) -> None:
    """Copy an array block by block; the pages of mapped ones are handed back."""
    for part in blocks(source.size, target, source):
        target[part] = source[part]


def map_stream(stream: BinaryIO, size: int) -> mmap.mmap:
    """Return `size` bytes of a stream, mapped from a temporary file.

    Raises
    ------
    ValueError
        If the stream ends before.
    ReadError
        If there is no room for the file.
    """
    spill, left = Spill(), size
    while left:
        piece = stream.read(min(left, _FLUSH))
        if not piece:
            msg = f"an array ends after {size - left} of {size} bytes"
            raise ValueError(msg)
        spill.write(np.frombuffer(piece, dtype=np.uint8))
        left -= len(piece)
    return spill.take(np.dtype(np.uint8))[1]


def join_rows(pieces: Sequence[Sequence[FloatArray]], *, limit: int | None = None) -> list[FloatArray]:
    """Return rows of samples, each made of its pieces one behind the other.

    They lie in a temporary file where all together are more than `limit` bytes.
    """
    rows = [sum(piece.size for piece in row) for row in pieces]
    size = 8 * sum(rows)
    spilled = size > (column_limit() if limit is None else limit)
    held = Spill().take(np.dtype(np.float64), size)[0] if spilled else np.empty(sum(rows))
    joined, start = [], 0
    for row, n in zip(pieces, rows, strict=True):
        joined.append(held[start : start + n])
        for piece in row:
            copy_to(held[start : start + piece.size], piece)
            start += piece.size
    return joined


class GrowingColumn:
    """Values of one column, appended block by block.

    Parameters
    ----------
    dtype
        ``int64`` or ``float64``.
    limit
        Bytes to hold in memory; beyond them the values go to a temporary file.
    expected
        Values to make room for; memory that is never filled is never taken.
    """

    def __init__(self, dtype: type[np.generic], *, limit: int, expected: int = 0) -> None:
        self._limit = limit
        room = min(max(expected, _FIRST), limit // 8 + _FIRST)
        self._held: NDArray[Any] = np.empty(room, dtype=dtype)
        self._filled = 0
        self._file: Spill | None = None

    def append(self, values: NDArray[Any]) -> None:
        """Append a block; a block of floats turns a column of integers into one of floats."""
        if self._held.dtype.kind == "i" and values.dtype.kind == "f":
            self._held = self._held.astype(np.float64)
            if self._file is not None:
                self._file.become_float()
        stop = self._filled + values.size
        if stop > self._held.size:
            larger = np.empty(max(stop, 2 * self._held.size), dtype=self._held.dtype)
            larger[: self._filled] = self._held[: self._filled]
            self._held = larger
        self._held[self._filled : stop] = values
        self._filled = stop
        if self._filled * self._held.itemsize > self._limit:
            self._file = self._file or Spill()
            self._spill(self._file)
            # What follows need not wait in memory.
            self._limit = min(self._limit, _PIECE)
            self._held = self._held[: self._limit // 8 + _FIRST].copy()

    def take(self) -> NDArray[Any]:
        """Return all values as one array, and forget them."""
        if self._file is None:
            array, self._held = self._held, np.empty(0, dtype=self._held.dtype)
            # Shrinking gives pages back and copies nothing.
            array.resize(self._filled, refcheck=False)
            return array
        self._spill(self._file)
        values, _ = self._file.take(self._held.dtype)
        self._file = None
        return values

    def _spill(self, file: Spill) -> None:
        file.write(self._held[: self._filled])
        self._filled = 0


def is_constant(rows: NDArray[Any]) -> bool:
    """Say whether no row of samples ever changes; the first block mostly tells."""
    return all(never_changes(row) for row in rows if row.size)
