"""The `messages` table of a ROS 2 bag, read from the pages of the SQLite file.

Half the time of SQLite's own rows, in several threads, and what is left of a cut file can be read. What
does not fit (overflow pages, a write-ahead log) is left to SQLite.
Source: https://www.sqlite.org/fileformat2.html, sections 1.6 (b-tree pages) and 2.1 (records).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from imucal.arrays import IntArray
from imucal.readers.containers.container import Batch, Loss, gather
from imucal.readers.containers.sqlite_rows import LEAF, Rows, parse_rows, varint
from imucal.readers.files import DamagedError, LogFile, Scratch

_INTERIOR = 0x05
#: Leaf pages of one task: about 2 MB of the usual 4 kB pages.
_GROUP = 512
#: A b-tree deeper than this is damage.
_DEEP = 20
#: Smallest message with its head: what one page can hold is bounded by it, in bytes.
_SMALLEST = 16


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Leaves:
    """Leaf pages of a table, in the order of its rows.

    Attributes
    ----------
    pages
        Their numbers, from 1, shape (p,).
    last_ids
        The largest row that each may hold, shape (p,).
    first_id
        The smallest row of the first.
    """

    pages: IntArray
    last_ids: IntArray
    first_id: int

    def groups(self) -> Iterator[tuple[IntArray, int]]:
        """Yield pages that one task reads, and the rows they hold at most."""
        before = self.first_id - 1
        for start in range(0, self.pages.size, _GROUP):
            part = self.pages[start : start + _GROUP]
            last = int(self.last_ids[min(start + _GROUP, self.pages.size) - 1])
            yield part, max(last - before, 0)
            before = last


def page_size(file: LogFile) -> tuple[int, int]:
    """Return the size of a page, and how much of it holds data, in bytes."""
    head = file.read(0, 100)
    size = int.from_bytes(head[16:18], "big")
    size = 65536 if size == 1 else size
    if size < 512 or size & (size - 1):
        msg = "the page size is damaged"
        raise DamagedError(msg)
    return size, size - head[20]


def find_leaves(file: LogFile, root: int, first_id: int, last_id: int) -> Leaves:
    """Return the leaf pages of the table whose root page is `root`.

    Raises
    ------
    DamagedError
        If an interior page is damaged or missing.
    """
    size, _ = page_size(file)
    pages, ids = [np.array([root], dtype=np.int64)], [np.array([last_id], dtype=np.int64)]
    for _ in range(_DEEP):
        level, bounds = pages[-1], ids[-1]
        kinds = _kind(file, int(level[0]), size)
        if kinds == LEAF:
            return Leaves(pages=level, last_ids=bounds, first_id=first_id)
        children = [_children(file, page, size, bound) for page, bound in zip(level, bounds, strict=True)]
        pages.append(np.concatenate([child for child, _ in children]))
        ids.append(np.concatenate([bound for _, bound in children]))
        if pages[-1].size * size > file.size:
            break
    msg = "the tree of pages is damaged"
    raise DamagedError(msg)


def scan_leaves(file: LogFile) -> list[tuple[IntArray, int]]:
    """Return groups of all whole leaf pages of a file, and the cells they hold at most.

    Pages of other tables are among them: their rows do not look like messages.
    """
    size, _ = page_size(file)
    groups = []
    count = file.size // size
    for first in range(0, count, _GROUP):
        part = min(_GROUP, count - first)
        data = np.frombuffer(file.read(first * size, part * size), dtype=np.uint8).reshape(part, size)
        chosen = np.flatnonzero(data[:, 0] == LEAF)
        if chosen.size:
            cells = (data[chosen, 3].astype(np.int64) << 8) | data[chosen, 4]
            most = int(np.minimum(cells, size // _SMALLEST).sum())
            groups.append((chosen + first + 1, most))
    return groups


#: Fetches the rows of some topics that no page holds whole: (rows) -> (topic, time in ns, data).
Fetch: TypeAlias = Callable[[list[int]], list[tuple[int, int, bytes]]]


class PageTask:
    """A group of leaf pages to load.

    Parameters
    ----------
    most
        Rows they hold at most.
    fetch
        Asks SQLite for rows that reach over several pages; None where the file is cut, and rows that can't
        be parsed belong to other tables.
    """

    def __init__(
        self, file: LogFile, pages: IntArray, keys: Sequence[int], most: int, fetch: Fetch | None
    ) -> None:
        self._file = file
        self._pages = pages
        self._fetch = fetch
        self._page, self._usable = page_size(file)
        self.size = pages.size * self._page
        self.counts = dict.fromkeys(keys, min(most, self.size // _SMALLEST))

    def load(self, scratch: Scratch) -> Iterator[tuple[int, Batch]]:
        """Yield the messages of each wanted topic; see `Task`."""
        buffer = self._read(scratch)
        rows = parse_rows(buffer, self._page, self._usable)
        loss = None
        if rows.damaged and self._fetch is not None:
            text = "rows of the database are damaged"
            loss = Loss(code="damaged", text=text, messages=rows.damaged)
        long = self._long_rows(rows)
        for key in self.counts:
            chosen = np.flatnonzero(rows.topics == key)
            batch = Batch.of(buffer, rows.starts[chosen], rows.sizes[chosen], rows.times[chosen])
            batch = replace(batch, loss=loss)
            more = [(time, data) for topic, time, data in long if topic == key]
            loss = None
            yield key, _with(batch, more) if more else batch

    def _long_rows(self, rows: Rows) -> list[tuple[int, int, bytes]]:
        wanted = rows.long_ids[np.isin(rows.long_topics, list(self.counts))]
        return self._fetch(wanted.tolist()) if self._fetch is not None and wanted.size else []

    def _read(self, scratch: Scratch) -> memoryview:
        """Read the pages side by side into a buffer: in one go where they are neighbours."""
        buffer = scratch.buffer(self.size)
        steps = np.flatnonzero(np.diff(self._pages) != 1) + 1
        edges = [0, *steps.tolist(), self._pages.size]
        for first, last in pairwise(edges):
            position = (int(self._pages[first]) - 1) * self._page
            self._file.into(position, buffer[first * self._page : last * self._page])
        return buffer


def _with(batch: Batch, more: list[tuple[int, bytes]]) -> Batch:
    """Return a batch with further messages, in order of time."""
    sizes = np.broadcast_to(batch.sizes, batch.starts.shape)
    joined = bytes(batch.buffer) + b"".join(data for _, data in more)
    lengths = np.array([len(data) for _, data in more], dtype=np.int64)
    starts = np.concatenate([batch.starts, len(batch.buffer) + np.cumsum(lengths) - lengths])
    times = np.concatenate([batch.log_ns, np.array([time for time, _ in more], dtype=np.int64)])
    order = np.argsort(times, kind="stable")
    return Batch(
        buffer=joined,
        starts=starts[order],
        header=0,
        sizes=np.concatenate([sizes, lengths])[order],
        log_ns=times[order],
        loss=batch.loss,
    )


def _kind(file: LogFile, page: int, size: int) -> int:
    if page < 1:
        msg = "a page number is damaged"
        raise DamagedError(msg)
    return file.read((page - 1) * size + (100 if page == 1 else 0), 1)[0]


def _children(file: LogFile, page: int, size: int, bound: int) -> tuple[IntArray, IntArray]:
    """Return the children of an interior page, and the largest row of each."""
    if page <= 1:
        msg = "a page number is damaged"
        raise DamagedError(msg)
    data = np.frombuffer(file.read((page - 1) * size, size), dtype=np.uint8)
    count = int(data[3]) << 8 | int(data[4])
    if data[0] != _INTERIOR or 12 + 2 * count > size:
        msg = "an interior page is damaged"
        raise DamagedError(msg)
    words = data[12 : 12 + 2 * count].astype(np.int64).reshape(-1, 2)
    cells = (words[:, 0] << 8) | words[:, 1]
    if count and int(cells.max()) > size - 5:
        msg = "an interior page is damaged"
        raise DamagedError(msg)
    pages = gather(data.data, np.append(cells, 8), 4).view(">u4").astype(np.int64)
    keys, _ = varint(data, cells + 4)
    return pages, np.append(keys, bound)
