"""What every container of messages offers: channels, and tasks that load chunks of them."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from imucal.findings import Finding
from imucal.readers.containers.batch import Batch
from imucal.readers.files import Scratch


@dataclass(frozen=True, slots=True, kw_only=True)
class Channel:
    """A stream of messages of one type.

    Attributes
    ----------
    key
        Number of the channel in its container.
    topic, type
        Such as ``/imu/data`` and ``sensor_msgs/msg/Imu``.
    encoding
        ``cdr``, ``ros1``, ``json``, or what the log says.
    definition, definition_kind
        The text of the message definition, or empty; ``ros2msg``, ``ros1msg``, …
    count
        Number of messages, or None where only reading tells; for SQLite it may be an upper bound.
    first_ns, last_ns
        When the first and the last message were recorded, in ns; None where the index doesn't say.
    """

    key: int
    topic: str
    type: str
    encoding: str
    definition: str = ""
    definition_kind: str = ""
    count: int | None = None
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
        """Yield the messages of each wanted channel.

        Raises
        ------
        DamagedError
            If the chunk can't be read.
        """


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
