"""Columns of numbers while a log is read: in memory, or in a temporary file above a limit of bytes.

`Columns` are written at any place by several threads, their number of samples known beforehand; a
`GrowingColumn` takes block after block. The file has no name, so nothing is left behind whatever happens.
"""

import mmap
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray
from imucal.errors import ReadError
from imucal.recording import Sensor
from imucal.resources import memory_limit

#: Bytes written before their pages are given back to the system.
_FLUSH = 1 << 25
#: Values that a growing column has room for at first.
_FIRST = 1 << 16


class _Spill:
    """The temporary file of some columns."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(prefix="imucal-")  # noqa: SIM115 - closed when it is mapped
        self._size = 0

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
            self._file.write(integers.astype(np.float64).data)

    def take(self, dtype: np.dtype[Any], size: int = 0) -> tuple[NDArray[Any], mmap.mmap]:
        """Return an array of all that was written, or of `size` bytes; the file vanishes with it."""
        try:
            if size:
                self._size = size
                self._file.truncate(size)
            return self._map(dtype)
        except OSError as error:
            raise self._full(error) from error
        finally:
            self._file.close()

    def _map(self, dtype: type[Any] | np.dtype[Any]) -> tuple[NDArray[Any], mmap.mmap]:
        self._file.flush()
        held = mmap.mmap(self._file.fileno(), self._size)
        return np.frombuffer(held, dtype=dtype), held

    def _full(self, error: OSError) -> ReadError:
        where = Path(tempfile.gettempdir())
        return ReadError(
            f"{where}: no room for {self._size / 1e9:.1f} GB of samples: {error.strerror or error}"
        )


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
        self._map: mmap.mmap | None = None
        self._written = 0
        if size > (memory_limit() if limit is None else limit):
            values, self._map = _Spill().take(np.dtype(np.float64), size)
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
        if self._map is not None and hasattr(self._map, "madvise"):
            self._map.madvise(mmap.MADV_DONTNEED)

    def joined(self, other: "Columns") -> "Columns":
        """Return these samples and those of `other` behind them."""
        both = Columns(self.n + other.n, tuple(self.vectors), temperature=self.temperature is not None)
        for row, first, second in zip(both.rows, self.rows, other.rows, strict=True):
            row[: self.n], row[self.n :] = first, second
        return both

    def keep_spans(self, spans: list[tuple[int, int]]) -> None:
        """Keep the samples of some spans (start, stop), in order, in place."""
        end = 0
        for start, stop in spans:
            if start != end:
                for row in self.rows:
                    # Forward moves of overlapping ranges: NumPy copies through a buffer where they overlap.
                    row[end : end + stop - start] = row[start:stop]
            end += stop - start
        self._keep_first(end)

    def reorder(self, order: IntArray) -> None:
        """Take the samples in another order, row by row."""
        for row in self.rows:
            row[: order.size] = row[order]
        self._keep_first(order.size)

    def _keep_first(self, n: int) -> None:
        if n != self.n:
            self._view(self._data[:, :n], tuple(self.vectors), temperature=self.temperature is not None)


def map_stream(stream: BinaryIO, size: int) -> mmap.mmap:
    """Return `size` bytes of a stream, mapped from a temporary file.

    Raises
    ------
    ValueError
        If the stream ends before.
    ReadError
        If there is no room for the file.
    """
    spill, left = _Spill(), size
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
    spilled = size > (memory_limit() if limit is None else limit)
    held = _Spill().take(np.dtype(np.float64), size)[0] if spilled else np.empty(sum(rows))
    joined, start = [], 0
    for row, n in zip(pieces, rows, strict=True):
        joined.append(np.concatenate(row, out=held[start : start + n]) if n else held[start:start])
        start += n
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
        self._file: _Spill | None = None

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
            self._file = self._file or _Spill()
            self._spill(self._file)

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

    def _spill(self, file: _Spill) -> None:
        file.write(self._held[: self._filled])
        self._filled = 0


def is_constant(rows: FloatArray) -> bool:
    """Say whether no row of samples ever changes; the first thousand mostly tell."""
    return all(bool(_same(row[:1000]).all()) and bool(_same(row).all()) for row in rows if row.size)


def _same(row: FloatArray) -> NDArray[np.bool_]:
    """Return where a row is what it is at first."""
    return np.isnan(row) if np.isnan(row[0]) else row == row[0]
