"""Messages that are read one by one into a tree: JSON, protobuf, and ROS messages with lists in them.

A message is one sample, or each element of a list in it is one, at its own time or spread over the message's.
A driver that reads its sensor's buffer sends some samples at once. Where they carry no stamps of their own,
the message's is that of the last one, which was taken just before it was sent; the others lie before it, as
far apart as samples usually are: the median over all messages of the time since the message before, divided
by the number of its elements. So a message that is missing leaves a gap.
"""

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, TypeAlias, TypeVar

import numpy as np

from imucal.arrays import IntArray, blocks
from imucal.readers.containers import Batch
from imucal.readers.files import DamagedError
from imucal.readers.messages.message_types import ImuFields, Stamp, Vector
from imucal.readers.store import Block
from imucal.recording import Sensor

#: Bytes of a message -> its tree: mappings, lists and numbers, or objects with attributes.
Parse: TypeAlias = Callable[[bytes], Any]
Result = TypeVar("Result")

#: What a JSON message of an IMU is taken to hold, where the user names no fields.
JSON_FIELDS = ImuFields(
    stamp=Stamp("", ""),
    vectors=(
        Vector(Sensor.GYROSCOPE, ("angular_velocity",)),
        Vector(Sensor.ACCELEROMETER, ("linear_acceleration",)),
    ),
)

_STAMPS = ("stamp", "timestamp", "time")
_NANOSECONDS = ("nanosec", "nsec", "nanos", "nsecs")
_SECONDS = ("sec", "secs", "seconds")

_STEP = re.compile(r"\[(\d*)\]|([^.\[\]]+)")

#: A path into one element of a list of structures.
_ONE = re.compile(r"([^\[\]]+)\[\d+\]\.")

#: The steps of a path: names, indices, and None for each element of a list.
Steps: TypeAlias = tuple[str | int | None, ...]
#: A sample: its stamp in ns, its numbers, and the temperature.
Sample: TypeAlias = tuple[int, list[float], float]


class TreeDecoder:
    """Decodes messages one by one: about 6 µs each for JSON, more for others.

    `imu` says what to take of the tree that `parse` makes of a message; `kind` names it in an error.
    """

    def __init__(self, imu: ImuFields, parse: Parse = json.loads, kind: str = "JSON") -> None:
        self.imu = imu
        self._parse = parse
        self._kind = kind
        self._vectors = [[_steps(path) for path in vector.paths] for vector in imu.vectors]
        stamp = imu.stamp
        self._stamp = None if stamp is None else [_steps(path) for path in (stamp.sec, stamp.nanosec) if path]
        self._temperature = _steps(imu.temperature) if imu.temperature else None
        #: Lists of which one element is read.
        self._lists = [match[1] for match in map(_ONE.match, imu.wanted) if match]

    def lengths(self, message: bytes) -> dict[str, int]:
        """Return the length of each list of which one element is read; nothing for a damaged message."""

        def count(tree: Any) -> dict[str, int]:  # noqa: ANN401 - any tree
            return {name: len(_follow(tree, _steps(name))) for name in self._lists}

        with suppress(DamagedError):
            return self._parsed(message, count) if self._lists else {}
        return {}

    def decode(self, batch: Batch) -> Block:
        """Return the samples of messages; raises DamagedError if one is damaged or lacks a wanted field."""
        found = [self._parsed(data, self._samples) for data in batch.messages()]
        samples = [sample for some in found for sample in some]
        stamps, values, warmth = zip(*samples, strict=True) if samples else ((), (), ())
        log = np.repeat(batch.log_ns, [len(some) for some in found])
        width = sum(len(vector.axes) for vector in self.imu.vectors)
        axes = np.array(values, np.float64).reshape(len(samples), width).T
        temperature = [np.array(warmth, np.float64)] if self._temperature else []
        return [np.array(stamps, np.int64), log, *axes, *temperature]

    def _parsed(self, data: bytes | memoryview, take: Callable[[Any], Result]) -> Result:
        """Return what is taken from a message; raises DamagedError where that can't be read."""
        try:
            return take(self._parse(bytes(data)))
        except Exception as error:
            # The packages that parse have error classes of their own.
            msg = f"a {self._kind} message has no IMU sample: {type(error).__name__} {error}"
            raise DamagedError(msg) from error

    def _samples(self, tree: Any) -> list[Sample]:  # noqa: ANN401 - any tree
        """Return the samples in a message: one, or those of a list."""
        numbers = [number for paths in self._vectors for number in _vector(tree, paths)]
        warmth = _number(_follow(tree, self._temperature)) if self._temperature else math.nan
        # A stamp beyond 64 bits is damage, to be found while the message is still known.
        return [(int(np.int64(self._time_of(tree))), numbers, warmth)]

    def _time_of(self, tree: Any) -> int:  # noqa: ANN401 - any tree
        """Return the stamp of a message in ns; 0 where there is none."""
        if self._stamp is None:
            return 0
        return self._ns_of([_follow(tree, steps) for steps in self._stamp]) if self._stamp else stamp_of(tree)

    def _ns_of(self, parts: Sequence[Any]) -> int:
        """Return the ns of a time: of seconds and nanoseconds, or of a count of its own unit."""
        if len(parts) == 2:
            return int(parts[0]) * 1_000_000_000 + int(parts[1])
        count, scale = parts[0], self.imu.stamp.scale if self.imu.stamp is not None else 1
        if isinstance(count, float):
            whole = math.floor(count)
            return whole * scale + round((count - whole) * scale)
        return int(count) * scale


class ListDecoder(TreeDecoder):
    """Decodes messages of which each element of a list is a sample."""

    def _samples(self, tree: Any) -> list[Sample]:  # noqa: ANN401 - any tree
        """Return the samples in a message."""
        columns = [_each(tree, steps) for paths in self._vectors for steps in paths]
        n = len(columns[0])
        if any(len(column) != n for column in columns):
            raise ValueError(f"lists of {', '.join(str(len(column)) for column in columns)} elements")
        rows = [[_number(value) for value in row] for row in zip(*columns, strict=True)]
        warmth = [math.nan] * n
        if self._temperature:
            warmth = [_number(value) for value in _for_each(tree, self._temperature, n)]
        if self._stamp:
            parts = [_for_each(tree, steps, n) for steps in self._stamp]
            times = [self._ns_of(time) for time in zip(*parts, strict=True)]
        else:
            times = [self._time_of(tree)] * n
        return list(zip(np.array(times, np.int64).tolist(), rows, warmth, strict=True))


def tree_decoder(imu: ImuFields, parse: Parse = json.loads, kind: str = "JSON") -> TreeDecoder:
    """Return what decodes messages by their trees: a sample each, or one of each element."""
    return (ListDecoder if imu.lists else TreeDecoder)(imu, parse, kind)


def _steps(path: str) -> Steps:
    """Return the names and indices of a path such as ``imus[1].gyro.x``."""
    return tuple(name or (int(index) if index else None) for index, name in _STEP.findall(path))


def _follow(tree: Any, steps: Steps) -> Any:  # noqa: ANN401 - any tree
    """Return what a path leads to, which has no None among its steps."""
    for step in steps:
        tree = tree[step] if isinstance(step, int) or isinstance(tree, Mapping) else getattr(tree, str(step))
    return tree


def _each(tree: Any, steps: Steps) -> list[Any]:  # noqa: ANN401 - any tree
    """Return what a path leads to in each element of its list."""
    at = steps.index(None)
    return [_follow(element, steps[at + 1 :]) for element in _follow(tree, steps[:at])]


def _for_each(tree: Any, steps: Steps, n: int) -> list[Any]:  # noqa: ANN401 - any tree
    """Return what a path leads to in each of n elements, or n times what it leads to in the message."""
    return _each(tree, steps) if None in steps else [_follow(tree, steps)] * n


def stamp_of(message: Mapping[str, Any]) -> int:
    """Return the stamp of a JSON message in ns; 0 where there is none."""
    owner = message.get("header", message)
    stamp = next((owner[name] for name in _STAMPS if name in owner), None)
    if isinstance(stamp, Mapping):
        sec = next((stamp[name] for name in _SECONDS if name in stamp), 0)
        rest = next((stamp[name] for name in _NANOSECONDS if name in stamp), 0)
        return int(sec) * 1_000_000_000 + int(rest)
    return stamp if isinstance(stamp, int) else 0


def _vector(tree: Any, paths: Sequence[Steps]) -> list[float]:  # noqa: ANN401 - any tree
    """Return the numbers at some paths, or the three of the mapping or list at one."""
    values = [_follow(tree, steps) for steps in paths]
    if len(paths) == 1 and not (values[0] is None or isinstance(values[0], int | float | np.number)):
        value = values[0]
        values = [value[axis] for axis in "xyz"] if isinstance(value, Mapping) else list(value)
        if len(values) != 3:
            raise ValueError(f"a vector of {len(values)} numbers")
    return [_number(value) for value in values]


def _number(value: Any) -> float:  # noqa: ANN401 - whatever stands in a tree
    """Return a value as a float; NaN of the null that stands for it."""
    return math.nan if value is None else float(value)


def spread_times(times: IntArray, messages: Sequence[IntArray]) -> None:
    """Put the elements of each message before its time, in ns, shape (n,), in place.

    Elements whose `messages`, shape (n,) each, are the same as those of the one before are of one message.
    """
    found = [_firsts(messages, part) for part in blocks(times.size, *messages)]
    firsts = np.concatenate([*found, [times.size]])
    counts = np.diff(firsts)
    if not np.any(counts > 1):
        return
    ends = times[firsts[:-1]]
    step = np.diff(ends) / counts[1:]
    forward = step[step > 0]
    if not forward.size:
        return
    tau = float(np.median(forward))
    for part in blocks(times.size, times):
        place = np.arange(part.start, part.stop)
        last = firsts[np.searchsorted(firsts, place, side="right")] - 1
        times[part] -= np.round((last - place) * tau).astype(np.int64)


def _firsts(messages: Sequence[IntArray], part: slice) -> IntArray:
    """Return the first elements of the messages that begin in a block."""
    before = max(part.start - 1, 0)
    new = np.zeros(part.stop - max(part.start, 1), np.bool_)
    for column in messages:
        new |= np.diff(column[before : part.stop]) != 0
    firsts = np.flatnonzero(new) + max(part.start, 1)
    return np.concatenate([[0], firsts]) if part.start == 0 else firsts
