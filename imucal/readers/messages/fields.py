"""Fields of messages -> columns: one gather a vector, whatever the layout."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.readers.column_store import Columns
from imucal.readers.containers import Bytes, gather
from imucal.readers.messages.message_types import ImuFields, Stamp, Vector
from imucal.readers.messages.walker import Place, Position


@dataclass(frozen=True, slots=True, eq=False)
class Messages:
    """Messages in a buffer: where each starts, shape (n,), and the place of each wanted field in it."""

    buffer: Bytes
    starts: IntArray
    places: dict[str, Place]

    def write(self, imu: ImuFields, columns: Columns, to: slice | IntArray) -> None:
        """Gather the wanted fields and write them to the columns."""
        columns.stamps[to] = 0 if imu.stamp is None else self._stamps(imu.stamp)
        for vector in imu.vectors:
            self.write_vector(vector, columns, to)
        self.write_temperature(imu, columns, to)

    def write_vector(self, vector: Vector, columns: Columns, to: slice | IntArray) -> None:
        """Gather x, y and z at once where they lie side by side, and turn increments into rates."""
        rows = columns.vectors[vector.sensor]
        if adjacent(self.places, vector):
            first = self.places[vector.paths[0]]
            size = np.dtype(first.dtype).itemsize
            values = gather(self.buffer, self.starts + first.at, 3 * size)
            rows[:, to] = values.view(first.dtype).reshape(-1, 3).T
        else:
            for row, path in zip(rows, vector.paths, strict=True):
                row[to] = self._field(path)
        if vector.divisor:
            seconds = self._field(vector.divisor).astype(np.float64) * 1e-6
            seconds[seconds == 0] = np.nan
            rows[:, to] /= seconds

    def write_temperature(self, imu: ImuFields, columns: Columns, to: slice | IntArray) -> None:
        """Write the temperature, where there is one."""
        if imu.temperature and columns.temperature is not None:
            columns.temperature[to] = self._field(imu.temperature)

    def _stamps(self, stamp: Stamp) -> IntArray:
        """Return stamps in ns, shape (n,)."""
        sec = self.places[stamp.sec]
        if not stamp.nanosec:
            return _scaled(self._field(stamp.sec), stamp.scale)
        nanosec = self.places[stamp.nanosec]
        if _apart(sec.at, nanosec.at, 4):
            both = gather(self.buffer, self.starts + sec.at, 8)
            seconds = np.ndarray(both.shape, sec.dtype, buffer=both, strides=(8,))
            rest = np.ndarray(both.shape, nanosec.dtype, buffer=both, offset=4, strides=(8,))
        else:
            seconds, rest = self._field(stamp.sec), self._field(stamp.nanosec)
        result = seconds.astype(np.int64)
        result *= 1_000_000_000
        result += rest
        return result

    def _field(self, path: str) -> NDArray[np.float64]:
        """Return one field of every message, shape (n,)."""
        place = self.places[path]
        dtype = np.dtype(place.dtype)
        values: NDArray[np.float64] = gather(self.buffer, self.starts + place.at, dtype.itemsize).view(dtype)
        return values


def _scaled(counts: NDArray[np.float64], scale: int) -> IntArray:
    """Return counts of `scale` ns as ns; floats are split first, so that nothing is lost."""
    if counts.dtype.kind != "f":
        return counts.astype(np.int64) * np.int64(scale)
    good = np.isfinite(counts) & (np.abs(counts) < float((1 << 62) // scale))
    whole = np.where(good, np.floor(counts), 0.0)
    rest = np.where(good, counts, 0.0) - whole
    return whole.astype(np.int64) * scale + np.round(rest * scale).astype(np.int64)


def adjacent(places: dict[str, Place], vector: Vector) -> bool:
    """Say whether the numbers of a vector lie side by side in every message."""
    if len(vector.axes) < 3:
        return False
    if len(vector.paths) == 1:
        return True
    x, y, z = (places[path] for path in vector.paths)
    size = np.dtype(x.dtype).itemsize
    return x.dtype == y.dtype == z.dtype and _apart(x.at, y.at, size) and _apart(y.at, z.at, size)


def _apart(first: Position, second: Position, size: int) -> bool:
    """Say whether `second` lies `size` bytes after `first` in every message."""
    return bool(np.all(np.asarray(second) - np.asarray(first) == size))
