"""Fields of messages -> columns: one gather a vector, whatever the layout."""

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.readers.column_store import Columns
from imucal.readers.containers import Bytes, gather
from imucal.readers.messages.message_types import ImuFields, Stamp, Vector
from imucal.readers.messages.walker import Place, Position


def write_fields(  # noqa: PLR0917 - what lies where, and where it goes
    buffer: Bytes,
    starts: IntArray,
    places: dict[str, Place],
    imu: ImuFields,
    columns: Columns,
    to: slice | IntArray,
) -> None:
    """Gather the wanted fields and write them to the columns."""
    if imu.stamp is None:
        columns.stamps[to] = 0
    else:
        columns.stamps[to] = _stamps(buffer, starts, places, imu.stamp)
    for vector in imu.vectors:
        write_vector(buffer, starts, places, vector, columns, to)
    write_temperature(buffer, starts, places, imu, columns, to)


def write_vector(  # noqa: PLR0917 - as `write_fields`
    buffer: Bytes,
    starts: IntArray,
    places: dict[str, Place],
    vector: Vector,
    columns: Columns,
    to: slice | IntArray,
) -> None:
    """Gather x, y and z at once where they lie side by side, and turn increments into rates."""
    rows = columns.vectors[vector.sensor]
    if adjacent(places, vector):
        first = places[vector.paths[0]]
        size = np.dtype(first.dtype).itemsize
        values = gather(buffer, starts + first.at, 3 * size).view(first.dtype).reshape(-1, 3)
        rows[:, to] = values.T
    else:
        for row, path in zip(rows, vector.paths, strict=True):
            row[to] = _column(buffer, starts, places[path])
    if vector.divisor:
        seconds = _column(buffer, starts, places[vector.divisor]).astype(np.float64) * 1e-6
        seconds[seconds == 0] = np.nan
        rows[:, to] /= seconds


def write_temperature(  # noqa: PLR0917 - as `write_fields`
    buffer: Bytes,
    starts: IntArray,
    places: dict[str, Place],
    imu: ImuFields,
    columns: Columns,
    to: slice | IntArray,
) -> None:
    """Write the temperature, where there is one."""
    if imu.temperature and columns.temperature is not None:
        columns.temperature[to] = _column(buffer, starts, places[imu.temperature])


def adjacent(places: dict[str, Place], vector: Vector) -> bool:
    """Say whether the numbers of a vector lie side by side in every message."""
    if len(vector.paths) == 1:
        return True
    x, y, z = (places[path] for path in vector.paths)
    size = np.dtype(x.dtype).itemsize
    return x.dtype == y.dtype == z.dtype and _apart(x.at, y.at, size) and _apart(y.at, z.at, size)


def _stamps(buffer: Bytes, starts: IntArray, places: dict[str, Place], stamp: Stamp) -> IntArray:
    """Return stamps in ns, shape (n,)."""
    sec = places[stamp.sec]
    if not stamp.nanosec:
        return _column(buffer, starts, sec).astype(np.int64) * np.int64(stamp.scale)
    nanosec = places[stamp.nanosec]
    if _apart(sec.at, nanosec.at, 4):
        both = gather(buffer, starts + sec.at, 8)
        seconds = np.ndarray((starts.size,), sec.dtype, buffer=both, strides=(8,))
        rest = np.ndarray((starts.size,), nanosec.dtype, buffer=both, offset=4, strides=(8,))
    else:
        seconds, rest = _column(buffer, starts, sec), _column(buffer, starts, nanosec)
    result = seconds.astype(np.int64)
    result *= 1_000_000_000
    result += rest
    return result


def _column(buffer: Bytes, starts: IntArray, place: Place) -> NDArray[np.float64]:
    """Return one field of every message, shape (n,)."""
    dtype = np.dtype(place.dtype)
    values: NDArray[np.float64] = gather(buffer, starts + place.at, dtype.itemsize).view(dtype)
    return values


def _apart(first: Position, second: Position, size: int) -> bool:
    """Say whether `second` lies `size` bytes after `first` in every message."""
    return bool(np.all(np.asarray(second) - np.asarray(first) == size))
