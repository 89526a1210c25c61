"""Messages that are read one by one into a tree: JSON, protobuf, and ROS messages with lists in them.

Messages that hold lists of samples: each element is one, at its own time or spread over the message's.

A driver that reads its sensor's buffer sends some samples at once. Where they carry no stamps of their own,
the message's is that of the last one, which was taken just before it was sent; the others lie before it, as
far apart as samples usually are: the median over all messages of the time since the message before, divided
by the number of its elements. So a message that is missing leaves a gap.
"""

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, TypeAlias, TypeVar

import numpy as np

from imucal.arrays import FloatArray, IntArray, blocks
from imucal.readers.containers import Batch, Loss
from imucal.readers.files import DamagedError
from imucal.readers.messages.message_types import ImuFields, Stamp, Vector
from imucal.readers.store import Columns
from imucal.recording import Sensor

#: Bytes of a message -> its tree: mappings, lists and numbers, or objects with attributes.
Parse: TypeAlias = Callable[[bytes], Any]
Result = TypeVar("Result")

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

_STEP = re.compile(r"\[(\d*)\]|([^.\[\]]+)")

#: A path into one element of a list of structures.
_ONE = re.compile(r"([^\[\]]+)\[\d+\]\.")

#: The steps of a path: names, indices, and None for each element of a list.
Steps: TypeAlias = tuple[str | int | None, ...]


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
        self.imu = imu
        self._parse = parse
        self._kind = kind
        self.vectors = [[_steps(path) for path in vector.paths] for vector in imu.vectors]
        stamp = imu.stamp
        self.stamp = None if stamp is None else [_steps(path) for path in (stamp.sec, stamp.nanosec) if path]
        self.temperature = _steps(imu.temperature) if imu.temperature else None
        self.notes: list[Loss] = []
        #: List of which one element is read -> how many it has in the first message.
        self.lengths: dict[str, int] = {}

    def settle(self, batch: Batch) -> None:
        """Count the elements of lists of which one is read, in the first message; before all others."""
        lists = [match[1] for match in map(_ONE.match, self.imu.wanted) if match]
        if not lists or self.lengths:
            return
        with suppress(DamagedError):
            few = batch.checked()
            for data in messages_in(few.part(np.arange(min(few.n, 1)))):
                self.lengths = self.parsed(data, lambda tree: {name: _length(tree, name) for name in lists})

    def fast(self, batch: Batch, columns: Columns, first: int) -> bool:
        """There is no fast way."""
        del batch, columns, first
        return False

    def slow(self, batch: Batch, columns: Columns, first: int) -> None:
        """Decode messages; raises DamagedError where one can't be read, or has not the fields wanted."""
        stamps = np.empty(batch.n, dtype=np.int64)
        values = np.empty((batch.n, sum(len(vector.axes) for vector in self.imu.vectors)))
        warmth = np.empty(batch.n)
        for row, data in enumerate(messages_in(batch)):
            stamps[row], values[row], warmth[row] = self.parsed(data, self._sample)
        part = slice(first, first + batch.n)
        write_samples(columns, part, values, stamps, warmth)
        columns.log[part] = batch.log_ns

    def parsed(self, data: bytes, take: Callable[[Any], Result]) -> Result:
        """Return what is taken from a message; raises DamagedError where that can't be read."""
        try:
            return take(self._parse(data))
        except Exception as error:
            # The packages that parse have error classes of their own.
            msg = f"a {self._kind} message has no IMU sample: {type(error).__name__} {error}"
            raise DamagedError(msg) from error

    def _sample(self, tree: Any) -> tuple[int, list[float], float]:  # noqa: ANN401 - any tree
        numbers = [number for paths in self.vectors for number in _vector(tree, paths)]
        warmth = number_of(follow(tree, self.temperature)) if self.temperature else math.nan
        return self.time_of(tree), numbers, warmth

    def time_of(self, tree: Any) -> int:  # noqa: ANN401 - any tree
        """Return the stamp in ns; 0 where there is none."""
        if self.stamp is None:
            return 0
        return self.ns_of([follow(tree, steps) for steps in self.stamp]) if self.stamp else stamp_of(tree)

    def ns_of(self, parts: Sequence[Any]) -> int:
        """Return the ns of a time: of seconds and nanoseconds, or of a count of its own unit."""
        if len(parts) == 2:
            return int(parts[0]) * 1_000_000_000 + int(parts[1])
        count, scale = parts[0], self.imu.stamp.scale if self.imu.stamp is not None else 1
        if isinstance(count, float):
            whole = math.floor(count)
            return whole * scale + round((count - whole) * scale)
        return int(count) * scale


def messages_in(batch: Batch) -> Iterator[bytes]:
    """Yield the bytes of each message."""
    starts = batch.payload()
    ends = starts + batch.sizes
    view = memoryview(batch.buffer)
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        yield bytes(view[start:end])


def write_samples(
    columns: Columns, part: slice, values: FloatArray, stamps: IntArray, warmth: FloatArray
) -> None:
    """Write samples, shape (n, axes) of all sensors in their order, to some rows of the columns."""
    columns.stamps[part] = stamps
    if columns.temperature is not None:
        columns.temperature[part] = warmth
    for row, axis in zip([row for rows in columns.vectors.values() for row in rows], values.T, strict=True):
        row[part] = axis


def _steps(path: str) -> Steps:
    """Return the names and indices of a path such as ``imus[1].gyro.x``."""
    return tuple(name or (int(index) if index else None) for index, name in _STEP.findall(path))


def _length(tree: Any, name: str) -> int:  # noqa: ANN401 - any tree
    return len(follow(tree, _steps(name)))


def follow(tree: Any, steps: Steps) -> Any:  # noqa: ANN401 - any tree
    """Return what a path leads to, which has no None among its steps."""
    for step in steps:
        tree = tree[step] if isinstance(step, int) or isinstance(tree, Mapping) else getattr(tree, str(step))
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


def _vector(tree: Any, paths: Sequence[Steps]) -> list[float]:  # noqa: ANN401 - any tree
    """Return the numbers at some paths, or the three of the mapping or list at one."""
    values = [follow(tree, steps) for steps in paths]
    if len(paths) == 1 and not is_number(values[0]):
        value = values[0]
        values = [value[axis] for axis in "xyz"] if isinstance(value, Mapping) else list(value)
        if len(values) != 3:
            msg = f"a vector of {len(values)} numbers"
            raise ValueError(msg)
    return [number_of(value) for value in values]


def is_number(value: Any) -> bool:  # noqa: ANN401 - whatever stands in a tree
    """Return whether a value is one number, or the null that stands for NaN."""
    return value is None or isinstance(value, int | float | np.number)


def number_of(value: Any) -> float:  # noqa: ANN401 - whatever stands in a tree
    """Return a value as a float; NaN of none."""
    return math.nan if value is None else float(value)


def tree_decoder(imu: ImuFields, parse: Parse = json.loads, kind: str = "JSON") -> TreeDecoder:
    """Return what decodes messages by their trees: a sample each, or one of each element."""
    return (ListDecoder if imu.lists else TreeDecoder)(imu, parse, kind)


class ListDecoder(TreeDecoder):
    """Decodes messages of which each element of a list is a sample."""

    def elements(self, batch: Batch, like: Columns) -> tuple[Columns, list[Loss]]:
        """Return the samples of some messages in columns of their own, and which messages were lost."""
        stamps: list[int] = []
        values: list[list[float]] = []
        warmth: list[float] = []
        log: list[int] = []
        losses = []
        for data, log_ns in zip(
            messages_in(batch), np.broadcast_to(batch.log_ns, batch.n).tolist(), strict=True
        ):
            try:
                times, rows, warm = self.parsed(data, self._samples)
            except DamagedError as error:
                losses.append(Loss(code=error.code, text=str(error), messages=1))
                continue
            stamps += times
            values += rows
            warmth += warm
            log += [log_ns] * len(rows)
        columns = like.like(len(log))
        columns.log[:] = log
        width = sum(len(vector.axes) for vector in self.imu.vectors)
        write_samples(
            columns,
            slice(0, len(log)),
            np.array(values, dtype=np.float64).reshape(-1, width),
            np.array(stamps, dtype=np.int64),
            np.array(warmth, dtype=np.float64),
        )
        return columns, losses

    def _samples(self, tree: Any) -> tuple[list[int], list[list[float]], list[float]]:  # noqa: ANN401 - any tree
        """Return the stamps, the numbers and the temperatures of the elements in a message."""
        columns = [_each(tree, steps) for paths in self.vectors for steps in paths]
        n = len(columns[0])
        if any(len(column) != n for column in columns):
            msg = f"lists of {', '.join(str(len(column)) for column in columns)} elements"
            raise ValueError(msg)
        rows = [[number_of(value) for value in row] for row in zip(*columns, strict=True)]
        warmth = [math.nan] * n
        if self.temperature:
            warmth = [number_of(value) for value in self._for_each(tree, self.temperature, n)]
        if not self.stamp:
            return [self.time_of(tree)] * n, rows, warmth
        parts = [self._for_each(tree, steps, n) for steps in self.stamp]
        return [self.ns_of(time) for time in zip(*parts, strict=True)], rows, warmth

    @staticmethod
    def _for_each(tree: Any, steps: Steps, n: int) -> list[Any]:  # noqa: ANN401 - any tree
        """Return what a path leads to in each of n elements, or n times what it leads to in the message."""
        return _each(tree, steps) if None in steps else [follow(tree, steps)] * n


def _each(tree: Any, steps: Steps) -> list[Any]:  # noqa: ANN401 - any tree
    """Return what a path leads to in each element of its list."""
    at = steps.index(None)
    return [follow(element, steps[at + 1 :]) for element in follow(tree, steps[:at])]


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
    new = np.zeros(part.stop - max(part.start, 1), dtype=np.bool_)
    for column in messages:
        new |= np.diff(column[before : part.stop]) != 0
    firsts = np.flatnonzero(new) + max(part.start, 1)
    return np.concatenate([[0], firsts]) if part.start == 0 else firsts
