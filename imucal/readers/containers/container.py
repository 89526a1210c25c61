"""Interface of containers: channels, and tasks that load batches of messages."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.findings import Finding
from imucal.readers.files import LogFile, damaged_if
from imucal.readers.read_options import Progress

Bytes: TypeAlias = bytes | bytearray | memoryview


@dataclass(frozen=True)
class Loss:
    """A damaged part of a log; `messages` is the number of lost ones, None if unknown."""

    code: str
    text: str
    messages: int | None = 0


@dataclass(frozen=True, eq=False)
class Batch:
    """Messages of one channel: start and size of each payload in a buffer, and recording time in ns."""

    buffer: Bytes
    #: Shape (n,) each.
    starts: IntArray
    sizes: IntArray
    log_ns: IntArray
    #: Damage found by the container.
    loss: Loss | None = None

    @property
    def n(self) -> int:
        return self.starts.size

    def part(self, chosen: IntArray | slice) -> "Batch":
        return Batch(self.buffer, self.starts[chosen], self.sizes[chosen], self.log_ns[chosen])

    def messages(self) -> Iterator[memoryview]:
        view = memoryview(self.buffer)
        for start, size in zip(self.starts.tolist(), self.sizes.tolist(), strict=True):
            yield view[start : start + size]


def no_messages() -> Batch:
    """Return a batch without messages."""
    nothing = np.zeros(0, np.int64)
    return Batch(b"", nothing, nothing, nothing)


def gather(buffer: Bytes, at: IntArray, width: int) -> NDArray[np.void]:
    """Copy `width` bytes from each position in `at`, shape (n,), into an array of n items.

    Raises DamagedError if a position is outside the buffer.
    """
    count = max(len(buffer) - width + 1, 0)
    # As unsigned numbers, negative positions are too large.
    beyond = at.size and int(at.view(np.uint64).max()) >= count
    damaged_if(beyond, "a message extends beyond its chunk")
    view: NDArray[np.void] = np.ndarray((count,), f"V{width}", buffer=buffer, strides=(1,))
    return view[at]


def cells(rows: NDArray[np.void], at: int, dtype: str) -> NDArray[Any]:
    """Return the number at byte `at` of each gathered row, without a copy."""
    cell = np.dtype({"names": ["cell"], "formats": [dtype], "offsets": [at], "itemsize": rows.itemsize})
    numbers: NDArray[Any] = rows.view(cell)["cell"]
    return numbers


@dataclass(frozen=True, kw_only=True)
class Channel:
    """A stream of messages of one type."""

    key: int
    topic: str
    type: str
    #: ``cdr``, ``ros1``, ``json`` or another name in the log.
    encoding: str
    #: Text of the message definition, or empty.
    definition: str = ""
    definition_kind: str = ""
    #: Definition in bytes if it is not text.
    schema: bytes = b""
    #: None if unknown before reading.
    count: int | None = None
    #: Recording times of the first and last message, in ns; None if not in the index.
    first_ns: int | None = None
    last_ns: int | None = None


class Task(NamedTuple):
    """A part of a file, loaded by one thread."""

    #: Bytes of the file, for progress.
    size: int
    #: Wanted channels with messages in it.
    keys: frozenset[int]
    #: Yields the messages of each channel; raises DamagedError if the part can't be read.
    load: Callable[[], Iterable[tuple[int, Batch]]]


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
    parallel: bool = True

    @abstractmethod
    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        """Yield the chunks with messages of some channels."""

    @abstractmethod
    def close(self) -> None:
        """Close the file."""


OpenFiles: TypeAlias = Callable[[Path, Progress | None], tuple[list[Container], str]]


class MessageFile(Container):
    """A container read from the file at `path`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.findings = []
        self._file = LogFile(path)
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
