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
from imucal.readers.files import DamagedError, LogFile, Scratch, damaged_if
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """A part of a log that could not be read as it should: the finding's code, why, and messages lost."""

    code: str
    text: str
    messages: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
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

    def first(self) -> bytes:
        """Return the payload of the first message of a checked batch."""
        start = int(self.starts[0]) + self.header
        size = self.sizes if isinstance(self.sizes, int) else int(self.sizes[0])
        return bytes(memoryview(self.buffer)[start : start + size])


def gather(buffer: Bytes, at: IntArray, width: int) -> NDArray[np.void]:
    """Copy `width` bytes from each place in `at`, shape (n,), into one array of n items.

    Item i of the view below starts at byte i, so that indexing it is one copy per message, at any
    alignment. (`take` would copy the whole view first.)

    Raises
    ------
    DamagedError
        If a place lies outside the buffer.
    """
    count = len(buffer) - width + 1
    damaged_if(
        at.size and (count <= 0 or int(at.min()) < 0 or int(at.max()) >= count),
        "a message reaches beyond its chunk",
    )
    view: NDArray[np.void] = np.ndarray((max(count, 0),), f"V{width}", buffer=buffer, strides=(1,))
    return view[at]


@dataclass(frozen=True, slots=True, kw_only=True)
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


class Container(Protocol):
    """A file of messages, its index read."""

    path: Path
    format: str
    compression: str
    size: int
    channels: list[Channel]
    findings: list[Finding]
    #: First and last time of any message, in ns; None where unknown.
    start_ns: int | None
    end_ns: int | None
    #: Whether the tasks may run in several threads at once.
    parallel: bool

    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        """Yield the chunks that hold messages of some channels."""

    def close(self) -> None:
        """Close the file."""


class MessageFile(ABC):
    """A container that is read by the bytes of its one file: by default that at `path`."""

    format: str
    compression: str
    channels: list[Channel]
    start_ns: int | None = None
    end_ns: int | None = None
    parallel = True

    def __init__(self, path: Path, file: LogFile | None = None) -> None:
        self.path = path
        self.findings: list[Finding] = []
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
    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        """Yield the chunks that hold messages of some channels."""

    @abstractmethod
    def _read_index(self) -> None:
        """Read all that the file says of itself."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def scan_finding(reason: DamagedError, end: int, size: int) -> Finding:
    """Return the finding of a file of `size` bytes whose records were scanned up to `end`."""
    text = f"The index can't be used ({reason}); all records were scanned instead."
    if end < size:
        text += f" The last {size - end} of {size} bytes are cut or damaged."
    code = "truncated" if end < size else reason.code
    return Finding(level="warning", code=code, text=text)
