"""JSON messages of an MCAP channel, laid out as a ROS message would be."""

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from imucal.readers.column_store import Columns
from imucal.readers.containers import Batch, Loss
from imucal.readers.files import DamagedError
from imucal.readers.messages.message_types import ImuFields, Stamp, Vector
from imucal.recording import Sensor

#: What a JSON message of an IMU is taken to hold.
JSON_FIELDS = ImuFields(
    stamp=Stamp(sec="sec", nanosec="nanosec"),
    vectors=(
        Vector(sensor=Sensor.GYROSCOPE, paths=("angular_velocity",)),
        Vector(sensor=Sensor.ACCELEROMETER, paths=("linear_acceleration",)),
    ),
)

_STAMPS = ("stamp", "timestamp", "time")
_NANOSECONDS = ("nanosec", "nsec", "nanos", "nsecs")
_SECONDS = ("sec", "secs", "seconds")


class JsonDecoder:
    """Decodes JSON messages one by one: about 6 µs each."""

    def __init__(self, imu: ImuFields) -> None:
        self._imu = imu
        self.notes: list[Loss] = []

    def settle(self, batch: Batch) -> None:
        """JSON says what it is."""

    def fast(self, batch: Batch, columns: Columns, first: int) -> bool:
        """There is no fast way."""
        del batch, columns, first
        return False

    def slow(self, batch: Batch, columns: Columns, first: int) -> None:
        """Decode messages; raises DamagedError where one is not a JSON object with the vectors wanted."""
        starts = batch.payload()
        ends = starts + batch.sizes
        view = memoryview(batch.buffer)
        stamps = np.empty(batch.n, dtype=np.int64)
        values = np.empty((batch.n, 3 * len(self._imu.vectors)))
        for row, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
            try:
                message = json.loads(bytes(view[start:end]))
                stamps[row] = _stamp(message)
                values[row] = [
                    number for vector in self._imu.vectors for number in _vector(message, vector.paths[0])
                ]
            except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
                msg = f"a JSON message has no IMU sample: {type(error).__name__} {error}"
                raise DamagedError(msg) from error
        part = slice(first, first + batch.n)
        columns.log[part] = batch.log_ns
        columns.stamps[part] = stamps
        for index, vector in enumerate(self._imu.vectors):
            columns.vectors[vector.sensor][:, part] = values[:, 3 * index : 3 * index + 3].T


def _stamp(message: Mapping[str, Any]) -> int:
    """Return the stamp in ns; 0 where there is none."""
    owner = message.get("header", message)
    stamp = next((owner[name] for name in _STAMPS if name in owner), None)
    if stamp is None:
        return 0
    if isinstance(stamp, Mapping):
        sec = next((stamp[name] for name in _SECONDS if name in stamp), 0)
        rest = next((stamp[name] for name in _NANOSECONDS if name in stamp), 0)
        return int(sec) * 1_000_000_000 + int(rest)
    if isinstance(stamp, int):
        return stamp
    return 0


def _vector(message: Mapping[str, Any], name: str) -> tuple[float, float, float]:
    value = message[name]
    x, y, z = (value[axis] for axis in "xyz") if isinstance(value, Mapping) else value
    numbers = tuple(math.nan if number is None else float(number) for number in (x, y, z))
    return numbers[0], numbers[1], numbers[2]
