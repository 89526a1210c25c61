"""What every container of messages offers: channels, and tasks that load batches of their messages."""

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

#: A position from the start of a record, and the bytes that every record has there.
Guard = tuple[int, bytes]


class Alike:
    """Bytes that all records of a kind have in common.

    Records are compared as words of up to eight bytes with a mask, side by side as they lie in memory: a
    comparison of each guard on its own would pass over all records once for each, and one of raw bytes
    (``V11``) takes a nanosecond for every byte.

    Records are `width` bytes wide, as they were gathered; fastest where that is a multiple of eight.
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
        """Say whether every one of the records, shape (n,), has these bytes; writes to the records."""
        words, mask, value = self._words(records)
        np.bitwise_and(words, mask, out=words)
        return bool((words == value).all())

    def each(self, records: NDArray[np.void]) -> NDArray[np.bool_]:
        """Say which of the records, shape (n,), have these bytes."""
        words, mask, value = self._words(records)
        same: NDArray[np.bool_] = np.all(
            ((words & mask) == value).reshape(records.size, self._one[0].size), axis=1
        )
        return same

    def _words(self, records: NDArray[np.void]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return records as words, and mask and value of as many."""
        words = records.view(self._dtype).reshape(-1)
        mask, value = self._many
        if mask.size < words.size:
            # Threads may do so at once: each result is right.
            mask, value = (np.tile(part, records.size) for part in self._one)
            self._many = mask, value
        return words, mask[: words.size], value[: words.size]


Bytes: TypeAlias = bytes | bytearray | memoryview


@dataclass(frozen=True, slots=True)
class Loss:
    """A part of a log that could not be read as it should: the finding's code, why, and messages lost."""

    code: str
    text: str
    messages: int | None = None


@frozen_alone
class Batch:
    """Messages of one channel."""

    #: What they lie in; valid until the next chunk is loaded by the same thread.
    buffer: Bytes
    #: Where each record starts, shape (n,).
    starts: IntArray
    #: Bytes of a record before its payload.
    header: int
    #: Bytes of the payload: one for all messages, or one for each, shape (n,).
    sizes: IntArray | int
    #: When each was recorded, shape (n,), in ns; empty where `log_at` tells.
    log_ns: IntArray
    #: Where in a record that time stands as eight bytes, or None.
    log_at: int | None = None
    #: What must be true of every record for `header` and `sizes` to hold; empty where it was checked.
    guards: tuple[Guard, ...] = ()
    #: Returns the same messages with every record checked on its own; raises DamagedError.
    check: Callable[[], "Batch"] | None = None
    #: What was found wrong while checking.
    loss: Loss | None = None

    @classmethod
    def of(
        cls, buffer: Bytes, starts: IntArray, sizes: IntArray, log_ns: IntArray, *, header: int = 0
    ) -> "Batch":
        """Return a batch whose positions and sizes were checked; one size stands for all that are equal."""
        same = bool(sizes.size) and bool((sizes == sizes[0]).all())
        size = int(sizes[0]) if same else sizes
        return cls(buffer=buffer, starts=starts, header=header, sizes=size, log_ns=log_ns)

    @property
    def n(self) -> int:
        """Number of messages."""
        return self.starts.size

    def checked(self) -> "Batch":
        """Return a batch whose positions and sizes were checked record by record."""
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
        """Return where each payload starts, shape (n,)."""
        return self.starts + np.int64(self.header)

    def messages(self) -> Iterator[memoryview]:
        """Yield the payload of each message of a checked batch."""
        starts, view = self.payload(), memoryview(self.buffer)
        for start, end in zip(starts.tolist(), (starts + self.sizes).tolist(), strict=True):
            yield view[start:end]


def gather(buffer: Bytes, at: IntArray, width: int, offset: int = 0) -> NDArray[np.void]:
    """Copy `width` bytes from `offset` behind each place in `at`, shape (n,), into one array of n items.

    Item i of the view below starts `offset` behind byte i, so that indexing it is one copy per message, at
    any alignment. (`take` would copy the whole view first.)

    Raises DamagedError if a place lies outside the buffer.
    """
    count = max(len(buffer) - offset - width + 1, 0)
    # As unsigned numbers, negative ones lie beyond any buffer.
    beyond = at.size and int(at.view(np.uint64).max()) >= count
    damaged_if(beyond, "a message extends beyond its chunk")
    view: NDArray[np.void] = np.ndarray((count,), f"V{width}", buffer=buffer, offset=offset, strides=(1,))
    return view[at]


def cells(rows: NDArray[np.void], at: int, dtype: str) -> NDArray[Any]:
    """Return the number that stands `at` so many bytes in each row that was gathered; copies nothing."""
    return np.ndarray(rows.shape, dtype, buffer=rows, offset=at, strides=rows.strides)


@frozen
class Channel:
    """A stream of messages of one type."""

    #: Number of the channel in its container.
    key: int
    #: Such as ``/imu/data`` and ``sensor_msgs/msg/Imu``.
    topic: str
    type: str
    #: ``cdr``, ``ros1``, ``json``, or what the log says.
    encoding: str
    #: The text of the message definition, or empty; ``ros2msg``, ``ros1msg``, …
    definition: str = ""
    definition_kind: str = ""
    #: Its bytes, where it is no text.
    schema: bytes = b""
    #: Number of messages, or None where only reading tells; for SQLite it may be an upper bound.
    count: int | None = None
    #: When the first and the last message were recorded, in ns; None where the index doesn't say.
    first_ns: int | None = None
    last_ns: int | None = None


class Task(Protocol):
    """A chunk that one thread loads at a time."""

    @property
    def counts(self) -> dict[int, int]:
        """Channel -> number of messages at most."""

    @property
    def size(self) -> int:
        """Bytes of the file, for progress."""

    def load(self, scratch: Scratch) -> Iterable[tuple[int, Batch]]:
        """Yield the messages of each wanted channel; raises DamagedError if the chunk can't be read."""


class Container(ABC):
    """A file of messages, its index read."""

    path: Path
    format: str
    compression: str
    size: int
    channels: list[Channel]
    findings: list[Finding]
    #: First and last time of any message, in ns; None where unknown.
    start_ns: int | None = None
    end_ns: int | None = None
    #: Whether the tasks may run in several threads at once.
    parallel: bool = True

    @abstractmethod
    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        """Yield the chunks that hold messages of some channels."""

    @abstractmethod
    def close(self) -> None:
        """Close the file."""


#: Opens the files of a log; also returns the name of its format.
OpenFiles: TypeAlias = Callable[[Path, Progress | None], tuple[list[Container], str]]


class MessageFile(Container):
    """A container that is read by the bytes of its one file: by default that at `path`."""

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
        """Open a file, and name its format; raises ReadError if it can't be read."""
        del progress
        return [cls(path)], cls.format

    @abstractmethod
    def _read_index(self) -> None:
        """Read all that the file says of itself."""

    def close(self) -> None:
        self._file.close()
