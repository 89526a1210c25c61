"""Messages that are read one by one into a tree: JSON, protobuf, and ROS messages with lists in them."""

import json
import math
import re
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np

from imucal.readers.column_store import Columns
from imucal.readers.containers import Batch, Loss
from imucal.readers.files import DamagedError
from imucal.readers.messages.message_types import ImuFields, Stamp, Vector
from imucal.recording import Sensor

#: Bytes of a message -> its tree: mappings, lists and numbers, or objects with attributes.
Parse: TypeAlias = Callable[[bytes], Any]

#: What a JSON message of an IMU is taken to hold, where the user names no fields.
JSON_FIELDS = ImuFields(
    stamp=Stamp(sec="", nanosec=""),
    vectors=(
        Vector(sensor=Sensor.GYROSCOPE, paths=("angular_velocity",)),
        Vector(sensor=Sensor.ACCELEROMETER, paths=("linear_acceleration",)),
    ),
)

_STAMPS = ("stamp", "timestamp", "time")
_NANOSECONDS = ("nanosec", "nsec", "nanos", "nsecs")
_SECONDS = ("sec", "secs", "seconds")

_STEP = re.compile(r"\[(\d+)\]|([^.\[\]]+)")


class TreeDecoder:
    """Decodes messages one by one: about 6 µs each for JSON, more for others.

    Parameters
    ----------
    imu
        What to take.
    parse
        Turns a message into its tree.
    kind
        What the messages are, for an error.
    """

    def __init__(self, imu: ImuFields, parse: Parse = json.loads, kind: str = "JSON") -> None:
        self._imu = imu
        self._parse = parse
        self._kind = kind
        self._vectors = [[_steps(path) for path in vector.paths] for vector in imu.vectors]
        stamp = imu.stamp
        self._stamp = None if stamp is None else [_steps(path) for path in (stamp.sec, stamp.nanosec) if path]
        self._temperature = _steps(imu.temperature) if imu.temperature else None
        self.notes: list[Loss] = []

    def settle(self, batch: Batch) -> None:
        """Do nothing: a tree says what it is."""

    def fast(self, batch: Batch, columns: Columns, first: int) -> bool:
        """There is no fast way."""
        del batch, columns, first
        return False

    def slow(self, batch: Batch, columns: Columns, first: int) -> None:
        """Decode messages; raises DamagedError where one can't be read, or has not the fields wanted."""
        starts = batch.payload()
        ends = starts + batch.sizes
        view = memoryview(batch.buffer)
        stamps = np.empty(batch.n, dtype=np.int64)
        values = np.empty((batch.n, 3 * len(self._vectors)))
        warmth = np.empty(batch.n)
        for row, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
            try:
                tree = self._parse(bytes(view[start:end]))
                stamps[row] = self._time(tree)
                values[row] = [number for paths in self._vectors for number in _vector(tree, paths)]
                warmth[row] = _number(_follow(tree, self._temperature)) if self._temperature else math.nan
            except Exception as error:
                # The packages that parse have error classes of their own.
                msg = f"a {self._kind} message has no IMU sample: {type(error).__name__} {error}"
                raise DamagedError(msg) from error
        part = slice(first, first + batch.n)
        columns.log[part] = batch.log_ns
        columns.stamps[part] = stamps
        if columns.temperature is not None:
            columns.temperature[part] = warmth
        for index, vector in enumerate(self._imu.vectors):
            columns.vectors[vector.sensor][:, part] = values[:, 3 * index : 3 * index + 3].T

    def _time(self, tree: Any) -> int:  # noqa: ANN401 - any tree
        """Return the stamp in ns; 0 where there is none."""
        if self._stamp is None or self._imu.stamp is None:
            return 0
        if not self._stamp:
            return stamp_of(tree)
        parts = [_follow(tree, steps) for steps in self._stamp]
        if len(parts) == 2:
            return int(parts[0]) * 1_000_000_000 + int(parts[1])
        count, scale = parts[0], self._imu.stamp.scale
        if isinstance(count, float):
            whole = math.floor(count)
            return whole * scale + round((count - whole) * scale)
        return int(count) * scale


def _steps(path: str) -> tuple[str | int, ...]:
    """Return the names and indices of a path such as ``imus[1].gyro.x``."""
    return tuple(int(index) if index else name for index, name in _STEP.findall(path))


def _follow(tree: Any, steps: tuple[str | int, ...]) -> Any:  # noqa: ANN401 - any tree
    for step in steps:
        tree = tree[step] if isinstance(step, int) or isinstance(tree, Mapping) else getattr(tree, step)
    return tree


def stamp_of(message: Mapping[str, Any]) -> int:
    """Return the stamp of a JSON message in ns; 0 where there is none."""
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


def _vector(tree: Any, paths: list[tuple[str | int, ...]]) -> tuple[float, float, float]:  # noqa: ANN401
    """Return three numbers: at three paths, or of the mapping or list at one."""
    values = [_follow(tree, steps) for steps in paths]
    if len(paths) == 1:
        value = values[0]
        values = [value[axis] for axis in "xyz"] if isinstance(value, Mapping) else list(value)
    x, y, z = values
    return _number(x), _number(y), _number(z)


def _number(value: Any) -> float:  # noqa: ANN401 - whatever stands in a tree
    return math.nan if value is None else float(value)
