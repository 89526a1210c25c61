"""Files of chunks (MCAP and ROS 1 bags), and message indexes with the positions of messages in a chunk."""

from abc import abstractmethod
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from imucal.arrays import IntArray
from imucal.readers.compression import KINDS
from imucal.readers.containers.container import Batch, Loss, MessageFile, Task, no_messages
from imucal.readers.files import DamagedError, LogFile, refused


@dataclass
class Chunk:
    """A chunk's place in the file."""

    start: int
    end: int
    #: None for messages outside chunks.
    compression: str | None
    #: Channel with messages in the chunk -> position of its message index; None if it has no index.
    indexes: dict[int, int | None] = field(default_factory=dict)


class ChunkedFile(MessageFile):
    """A container of chunks; a chunk with a wrong or missing index is read record by record."""

    def __init__(self, path: Path) -> None:
        #: Channel -> its definition.
        self._defined: dict[int, Any] = {}
        self._chunks: list[Chunk] = []
        self._counts: Counter[int] = Counter()
        #: First and last log time by channel, in chunks without an index.
        self._times: dict[int, list[int]] = {}
        #: Whether no chunk without an index is damaged.
        self._is_counted = True
        super().__init__(path)

    @abstractmethod
    def _content(self, chunk: Chunk) -> memoryview:
        """Return the records of a chunk; raises DamagedError."""

    @abstractmethod
    def _entries(self, position: int, key: int) -> tuple[IntArray, IntArray]:
        """Return log times in ns, and positions in the chunk, from a message index; raises DamagedError."""

    @abstractmethod
    def _listed(self, raw: memoryview, key: int, log_ns: IntArray, positions: IntArray) -> Batch:
        """Return the messages at some positions of a chunk; raises DamagedError if others are there."""

    @abstractmethod
    def _walk(self, raw: memoryview) -> dict[int, Batch]:
        """Return the messages of each channel, up to the first damaged record of a chunk."""

    @abstractmethod
    def _define_all(self, raw: memoryview) -> None:
        """Add the channels that a chunk defines."""

    def _search_chunks(self) -> None:
        """Search the chunks that have no index, or messages of unknown channels."""
        damaged = []
        for chunk in self._chunks:
            if chunk.indexes and self._is_known(chunk):
                continue
            try:
                raw = self._content(chunk)
            except DamagedError:
                if not chunk.indexes:
                    damaged.append(chunk)
                continue
            self._define_all(raw)
            if not chunk.indexes or not self._is_known(chunk):
                self._add_messages(chunk, raw)
        for chunk in damaged:
            # Any channel may have messages in it; loading the chunk reports the loss.
            chunk.indexes = dict.fromkeys(self._defined)
            self._is_counted = False

    def _is_known(self, chunk: Chunk) -> bool:
        return all(key in self._defined for key in chunk.indexes)

    def _add_messages(self, chunk: Chunk, raw: memoryview) -> None:
        """Add the channels of a chunk that have no index."""
        for key, batch in self._walk(raw).items():
            if key in chunk.indexes:
                continue
            chunk.indexes[key] = None
            self._counts[key] += batch.n
            self._times.setdefault(key, []).extend((int(batch.log_ns.min()), int(batch.log_ns.max())))

    def _compressions(self, expected: str) -> str:
        """Return the compressions of chunks; raises ReadError if all are unknown, so that none is damage."""
        kinds = {chunk.compression or "none" for chunk in self._chunks}
        known = kinds & set(KINDS)
        if kinds and not known:
            raise refused(self.path, f"chunks are compressed by {min(kinds)!r}; expected {expected}")
        return ", ".join(sorted(known)) or "none"

    def _count(self, key: int) -> int | None:
        """Return the number of messages of a channel; None if a chunk without an index is damaged."""
        return self._counts[key] if self._is_counted else None

    def _spans(self) -> dict[int, tuple[int, int]]:
        """Return the first and last log time of channels, in ns, from their first and last chunk."""
        ends: dict[int, list[int]] = {}
        for chunk in self._chunks:
            for key, position in chunk.indexes.items():
                if position is not None:
                    ends.setdefault(key, [position, position])[1] = position
        spans = {}
        for key in ends.keys() | self._times.keys():
            times = list(self._times.get(key, []))
            with suppress(DamagedError):
                for position in set(ends.get(key, [])):
                    log_ns, _ = self._entries(position, key)
                    times += log_ns.tolist()
            if times:
                spans[key] = min(times), max(times)
        return spans

    def tasks(self, keys: frozenset[int]) -> Iterator[Task]:
        for chunk in self._chunks:
            wanted = keys & chunk.indexes.keys()
            if wanted:
                yield Task(chunk.end - chunk.start, wanted, partial(self._load, chunk, wanted))

    def _load(self, chunk: Chunk, keys: frozenset[int]) -> Iterator[tuple[int, Batch]]:
        raw = self._content(chunk)
        walked: dict[int, Batch] | None = None
        for key in keys:
            position = chunk.indexes[key]
            loss = None
            if position is not None:
                try:
                    batch = self._listed(raw, key, *self._entries(position, key))
                except DamagedError as error:
                    text = f"{error}; all records of its chunk were read instead"
                    loss = Loss("index", text)
                else:
                    yield key, batch
                    continue
            if walked is None:
                walked = self._walk(raw)
            yield key, replace(walked.get(key) or no_messages(), loss=loss)


def scan_text(file: LogFile, end: int) -> str:
    """Return the sentence about the bytes behind the last complete record; empty if there are none."""
    if end >= file.size:
        return ""
    return f" The last {file.size - end} of {file.size} bytes are cut off or damaged."
