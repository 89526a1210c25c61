"""Columns of samples, decoded straight into place: in memory, or in a temporary file above a limit."""

import mmap
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray, memory_limit
from imucal.errors import ReadError
from imucal.recording import Sensor

#: Bytes written before their pages are given back to the system.
_FLUSH = 1 << 25

_ROWS = ("stamp", "log")


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
        rows = len(_ROWS) + 3 * len(sensors) + int(temperature)
        limit = memory_limit() if limit is None else limit
        self._map: mmap.mmap | None = None
        self._written = 0
        if n * rows * 8 > limit:
            data, self._map = _mapped(rows, n)
        else:
            data = np.empty((rows, n))
        self._data = data
        self._view(data, sensors, temperature=temperature)

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

    @property
    def mapped(self) -> bool:
        """Whether a temporary file holds the samples."""
        return self._map is not None

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
        sensors, temperature = tuple(self.vectors), self.temperature is not None
        both = Columns(self.n + other.n, sensors, temperature=temperature)
        for row, first, second in zip(both.rows, self.rows, other.rows, strict=True):
            row[: self.n], row[self.n :] = first, second
        return both

    def keep(self, n: int) -> None:
        """Keep the first `n` samples."""
        if n != self.n:
            sensors = tuple(self.vectors)
            self._view(self._data[:, :n], sensors, temperature=self.temperature is not None)


def drop_rows(columns: Columns, spans: list[tuple[int, int]]) -> None:
    """Keep the samples of some spans (start, stop), in order, in place."""
    end = 0
    for start, stop in spans:
        if start != end:
            for row in columns.rows:
                # Forward moves of overlapping ranges: NumPy copies through a buffer where they overlap.
                row[end : end + stop - start] = row[start:stop]
        end += stop - start
    columns.keep(end)


def reorder(columns: Columns, order: IntArray) -> None:
    """Take the samples in another order, row by row."""
    for row in columns.rows:
        row[: order.size] = row[order]
    columns.keep(order.size)


def _mapped(rows: int, n: int) -> tuple[NDArray[np.float64], mmap.mmap]:
    """Return an array in a temporary file that vanishes with it."""
    size = rows * n * 8
    try:
        with tempfile.TemporaryFile() as file:
            file.truncate(size)
            held = mmap.mmap(file.fileno(), size)
    except OSError as error:
        where = Path(tempfile.gettempdir())
        msg = f"{where}: no room for {size / 1e9:.1f} GB of samples: {error.strerror or error}"
        raise ReadError(msg) from error
    return np.frombuffer(held, dtype=np.float64).reshape(rows, n), held
