"""Columns of numbers while a log is read: in memory, or in a temporary file above a limit of bytes.

`Columns` are written at any place by several threads, their number of samples known beforehand; a
`GrowingColumn` takes block after block.
"""

import mmap
from collections.abc import Sequence
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray
from imucal.mapped import blocks, release
from imucal.readers.room import Spill
from imucal.recording import Sensor
from imucal.resources import column_limit

#: Bytes written before their pages are given back to the system.
_FLUSH = 1 << 25
#: Bytes that wait for the temporary file.
_PIECE = 1 << 22
#: Values that a growing column has room for at first.
_FIRST = 1 << 16


class Columns:
    """Stamps and samples of one topic, one contiguous row a quantity.

    Attributes
    ----------
    stamps, log
        Shape (n,), int64, in ns.
    vectors
        Sensor -> shape (3, n), float64.
    temperature
        Shape (n,), or None.
    """

    def __init__(
        self, n: int, sensors: tuple[Sensor, ...], *, temperature: bool, limit: int | None = None
    ) -> None:
        shape = (2 + 3 * len(sensors) + int(temperature), n)
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
        self.vectors: dict[Sensor, FloatArray] = {
            sensor: data[2 + 3 * i : 5 + 3 * i] for i, sensor in enumerate(sensors)
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

    def joined(self, other: "Columns") -> "Columns":
        """Return these samples and those of `other` behind them."""
        both = Columns(
            self.n + other.n,
            tuple(self.vectors),
            temperature=self.temperature is not None,
            limit=self._limit,
        )
        for row, first, second in zip(both.rows, self.rows, other.rows, strict=True):
            copy_to(row[: self.n], first)
            copy_to(row[self.n :], second)
        return both

    def keep_spans(self, spans: list[tuple[int, int]]) -> None:
        """Keep the samples of some spans (start, stop), in order, in place."""
        end = 0
        for start, stop in spans:
            if start != end:
                for row in self.rows:
                    # Forward moves of overlapping ranges: NumPy copies through a buffer where they overlap.
                    copy_to(row[end : end + stop - start], row[start:stop])
            end += stop - start
        self._keep_first(end)

    def reorder(self, first: int, order: IntArray) -> None:
        """Put the samples from `first` on in another order, in place, row by row; `order` counts from it."""
        for row in self.rows:
            part = row[first : first + order.size]
            part[:] = part[order]

    def _keep_first(self, n: int) -> None:
        if n != self.n:
            self._view(self._data[:, :n], tuple(self.vectors), temperature=self.temperature is not None)


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
    return all(_same(row) for row in rows if row.size)


def _same(row: NDArray[Any]) -> bool:
    """Return whether a row is always what it is at first."""
    first = row[0]
    parts = (row[part] for part in blocks(row.size, row, size=_FIRST))
    return all(bool((np.isnan(part) if np.isnan(first) else part == first).all()) for part in parts)
