"""Interface of containers of messages: channels, and tasks that load batches of messages."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.findings import Finding
from imucal.frozen import frozen, frozen_alone
from imucal.readers.files import LogFile, Scratch, damaged_if
from imucal.readers.read_options import Progress

#: A position from the start of a record, and the required bytes at that position.
Guard = tuple[int, bytes]


class Alike:
    """Bytes that all records of a kind have in common.

    Records are compared as adjacent words of up to eight bytes with a mask. A comparison of each guard would
    need one pass per guard, and raw bytes (``V11``) take a nanosecond per byte.

    Gathered records are `width` bytes wide; multiples of eight are fastest.
    """

    def __init__(self, guards: Iterable[Guard], width: int) -> None:
        mask, value = bytearray(width), bytearray(width)
        for at, part in guards:
            mask[at : at + len(part)] = b"\xff" * len(part)
            value[at : at + len(part)] = part
        self._dtype = next(f"u{size}" for size in (8, 4, 2, 1) if width % size == 0)
        self._one = np.frombuffer(mask, self._dtype), np.frombuffer(value, self._dtype)
        self._many = self._one

    def all(self, records: NDArray[np.void]) -> bool:
        """Return whether all records, shape (n,), have these bytes; overwrites the records."""
        words, mask, value = self._words(records)
        np.bitwise_and(words, mask, out=words)
        return bool((words == value).all())

    def each(self, records: NDArray[np.void]) -> NDArray[np.bool_]:
        """Return which of the records, shape (n,), have these bytes."""
        words, mask, value = self._words(records)
        same: NDArray[np.bool_] = np.all(
            ((words & mask) == value).reshape(records.size, self._one[0].size), axis=1
        )
        return same

    def _words(self, records: NDArray[np.void]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return records as words, with masks and values of the same length."""
        words = records.view(self._dtype).reshape(-1)
        mask, value = self._many
        if mask.size < words.size:
            # Threads may do this at once, with the same result.
            mask, value = (np.tile(part, records.size) for part in self._one)
            self._many = mask, value
        return words, mask[: words.size], value[: words.size]


Bytes: TypeAlias = bytes | bytearray | memoryview


@dataclass(frozen=True, slots=True)
class Loss:
    """A damaged part of a log: the finding's code, the reason and the number of lost messages."""

    code: str
    text: str
    messages: int | None = None


@frozen_alone
class Batch:
    """Messages of one channel."""

    #: Buffer with the messages; valid until the same thread loads the next chunk.
    buffer: Bytes
    #: Start of each record, shape (n,).
    starts: IntArray
    #: Bytes of a record before its payload.
    header: int
    #: Bytes of the payload: one for all messages, or one for each, shape (n,).
    sizes: IntArray | int
    #: Recording times, shape (n,), in ns; empty if `log_at` is used.
    log_ns: IntArray
    #: Position of that time in a record, as eight bytes, or None.
    log_at: int | None = None
    #: Guards that each record must match for `header` and `sizes` to be valid; empty if already checked.
    guards: tuple[Guard, ...] = ()
    #: Returns the same messages with each record checked; raises DamagedError.
    check: Callable[[], "Batch"] | None = None
    #: Damage found by the check.
    loss: Loss | None = None

    @classmethod
    def of(
        cls, buffer: Bytes, starts: IntArray, sizes: IntArray, log_ns: IntArray, *, header: int = 0
    ) -> "Batch":
        """Return a batch of checked positions and sizes; equal sizes become one number."""
        same = bool(sizes.size) and bool((sizes == sizes[0]).all())
        size = int(sizes[0]) if same else sizes
        return cls(buffer=buffer, starts=starts, header=header, sizes=size, log_ns=log_ns)

    @property
    def n(self) -> int:
        """Number of messages."""
        return self.starts.size

    def checked(self) -> "Batch":
        """Return the batch with positions and sizes checked for each record."""
        return self.check() if self.check is not None else self

    def part(self, chosen: IntArray) -> "Batch":
        """Return some messages of a checked batch."""
        sizes = self.sizes if isinstance(self.sizes, int) else self.sizes[chosen]
        return Batch(
            buffer=self.buffer,
            starts=self.starts[chosen],
            header=self.header,
            sizes=sizes,
            log_ns=self.log_ns[chosen],
        )

    def payload(self) -> IntArray:
        """Return the start of each payload, shape (n,)."""
        return self.starts + np.int64(self.header)

    def messages(self) -> Iterator[memoryview]:
        """Yield the payload of each message of a checked batch."""
        starts, view = self.payload(), memoryview(self.buffer)
        for start, end in zip(starts.tolist(), (starts + self.sizes).tolist(), strict=True):
            yield view[start:end]


def gather(buffer: Bytes, at: IntArray, width: int, offset: int = 0) -> NDArray[np.void]:
    """Copy `width` bytes, `offset` bytes after each position in `at`, shape (n,), into an array of n items.

    Item i of the view starts `offset` bytes after byte i, so indexing makes one copy per message at any
    alignment. (`take` would copy the whole view first.)

    Raises DamagedError if a position is outside the buffer.
    """
    count = max(len(buffer) - offset - width + 1, 0)
    # As unsigned numbers, negative positions are beyond any buffer.
    beyond = at.size and int(at.view(np.uint64).max()) >= count
    damaged_if(beyond, "a message extends beyond its chunk")
    view: NDArray[np.void] = np.ndarray((count,), f"V{width}", buffer=buffer, offset=offset, strides=(1,))
    return view[at]


def cells(rows: NDArray[np.void], at: int, dtype: str) -> NDArray[Any]:
    """Return the number at byte `at` of each gathered row, without a copy."""
    return np.ndarray(rows.shape, dtype, buffer=rows, offset=at, strides=rows.strides)


@frozen
class Channel:
    """A stream of messages of one type."""

    #: Number of the channel in its container.
    key: int
    #: Such as ``/imu/data`` and ``sensor_msgs/msg/Imu``.
    topic: str
    type: str
    #: ``cdr``, ``ros1``, ``json`` or another name in the log.
    encoding: str
    #: The text of the message definition, or empty; ``ros2msg``, ``ros1msg``, …
    definition: str = ""
    definition_kind: str = ""
    #: Bytes of the definition if it is not text.
    schema: bytes = b""
    #: Number of messages, or None if unknown before reading; for SQLite it may be an upper bound.
    count: int | None = None
    #: Recording times of the first and the last message, in ns; None if not in the index.
    first_ns: int | None = None
    last_ns: int | None = None


class Task(Protocol):
    """A chunk, loaded by one thread."""

    @property
    def counts(self) -> dict[int, int]:
        """Channel -> upper bound of the number of messages."""

    @property
    def size(self) -> int:
        """Bytes of the file, for progress."""

    def load(self, scratch: Scratch) -> Iterable[tuple[int, Batch]]:
        """Yield the messages of each wanted channel; raises DamagedError if the chunk can't be read."""


class Container(ABC):
    """A file of messages whose index was read."""

    path: Path
    format: str
    compression: str
    size: int
    channels: list[Channel]
    findings: list[Finding]
    #: First and last time of any message, in ns; None if unknown.
    start_ns: int | None = None
    end_ns: int | None = None
    #: Whether the tasks may run in several threads at once.
    parallel: bool = True

    @abstractmethod
    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        """Yield the chunks with messages of some channels."""

    @abstractmethod
    def close(self) -> None:
        """Close the file."""


#: Opens the files of a log; also returns the name of its format.
OpenFiles: TypeAlias = Callable[[Path, Progress | None], tuple[list[Container], str]]


class MessageFile(Container):
    """A container read from the bytes of one file, by default at `path`."""

    def __init__(self, path: Path, file: LogFile | None = None) -> None:
        self.path = path
        self.findings = []
        self._file = file or LogFile(path)
        self.size = self._file.size
        try:
            self._read_index()
        except BaseException:
            self.close()
            raise

    @classmethod
    def open_files(cls, path: Path, progress: Progress | None = None) -> tuple[list[Container], str]:
        """Open a file and return its format; raises ReadError if it can't be read."""
        del progress
        return [cls(path)], cls.format

    @abstractmethod
    def _read_index(self) -> None:
        """Read the index of the file."""

    def close(self) -> None:
        self._file.close()
