"""Rows of the `messages` table from leaf pages of SQLite, all at once.

Source: https://www.sqlite.org/fileformat2.html, sections 1.6 (b-tree pages) and 2.1 (records).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.readers.containers.container import gather

#: Type of a page that holds rows of a table.
LEAF = 0x0D
#: Bytes of a column by its serial type, up to 9; blobs and texts have 12 and more.
_SIZES = np.array([0, 1, 2, 3, 4, 6, 8, 8, 0, 0, 0, 0], dtype=np.int64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows:
    """Rows of `messages`.

    Attributes
    ----------
    topics, times, starts, sizes
        Topic, time in ns, and where the data lie, of each row that a page holds whole, shape (n,).
    long_ids, long_topics
        Row and topic of those that reach over several pages.
    damaged
        Number of rows that can't be parsed.
    """

    topics: IntArray
    times: IntArray
    starts: IntArray
    sizes: IntArray
    long_ids: IntArray
    long_topics: IntArray
    damaged: int


def parse_rows(buffer: memoryview, page: int, usable: int) -> Rows:
    """Parse the cells of leaf pages: payload size, row, then a record of id, topic, time and data."""
    data = np.frombuffer(buffer, dtype=np.uint8)
    cells, ends, wrong = _cells(data, page)
    size, at = varint(data, cells)
    ids, record = varint(data, at)
    head, at = varint(data, record)
    kinds = []
    for _ in range(4):
        kind, at = varint(data, at)
        kinds.append(kind)
    identity, topic, time, blob = kinds
    known = (at == record + head) & (identity <= 6) & (topic <= 9) & (time <= 9) & (blob >= 12)
    known &= (blob & 1 == 0) & (blob >> 1 <= size + 6) & (size >= head) & (cells < ends - 8)
    columns = [record + head]
    for kind in (identity, topic, time):
        columns.append(columns[-1] + _SIZES.take(kind, mode="clip"))
    sizes = (blob - 12) >> 1
    known &= columns[3] + sizes == record + size
    long = known & (size > usable - 35)
    whole = np.flatnonzero(known & ~long & (record + size <= ends))
    apart = np.flatnonzero(long & (columns[2] <= ends))
    return Rows(
        topics=_integers(data, columns[1][whole], topic[whole]),
        times=_integers(data, columns[2][whole], time[whole]),
        starts=columns[3][whole],
        sizes=sizes[whole],
        long_ids=ids[apart],
        long_topics=_integers(data, columns[1][apart], topic[apart]),
        damaged=cells.size - whole.size - apart.size + wrong,
    )


def _cells(data: NDArray[np.uint8], page: int) -> tuple[IntArray, IntArray, int]:
    """Return where the cells of leaf pages start, where the page of each ends, and pages that are none."""
    pages = data.reshape(-1, page)
    counts = (pages[:, 3].astype(np.int64) << 8) | pages[:, 4]
    wrong = (pages[:, 0] != LEAF) | (counts > (page - 8) // 2)
    counts[wrong] = 0
    firsts = np.arange(counts.size, dtype=np.int64) * page
    total = int(counts.sum())
    within = np.arange(total) - np.repeat(np.cumsum(counts) - counts, counts)
    base = np.repeat(firsts, counts)
    words = base + 8 + 2 * within
    within_page = (data[words].astype(np.int64) << 8) | data[words + 1]
    return base + within_page, base + page, int(np.count_nonzero(wrong))


def varint(data: NDArray[np.uint8], at: IntArray) -> tuple[IntArray, IntArray]:
    """Return the big-endian variable-length integers at `at`, and where each ends."""
    byte = data.take(at, mode="clip")
    value = (byte & 0x7F).astype(np.int64)
    end = at + 1
    more = np.flatnonzero(byte > 0x7F)
    for step in range(1, 9):
        if not more.size:
            break
        byte = data.take(at[more] + step, mode="clip")
        whole = step == 8
        value[more] = (value[more] << (8 if whole else 7)) | (byte if whole else byte & 0x7F)
        end[more] += 1
        if whole:
            break
        more = more[byte > 0x7F]
    return value, end


def _integers(data: NDArray[np.uint8], at: IntArray, kinds: IntArray) -> IntArray:
    """Return integer columns of the given serial types, shape (n,)."""
    result = np.zeros(at.size, dtype=np.int64)
    same = bool((kinds == kinds[:1]).all())
    # There are ten types: a count of each is quicker than a search. Negative ones are damage.
    for kind in (kinds[:1] if same else np.flatnonzero(np.bincount(np.maximum(kinds, 0)))).tolist():
        chosen = slice(None) if same else kinds == kind
        if kind == 9:
            result[chosen] = 1
        elif 1 <= kind <= 6:
            size = int(_SIZES[kind])
            words = gather(data.data, at[chosen], size)
            if size in {1, 2, 4, 8}:
                result[chosen] = words.view(f">i{size}")
                continue
            raw = words.view(np.uint8).reshape(-1, size)
            value = raw[:, 0].astype(np.int8).astype(np.int64)
            for column in range(1, size):
                value = (value << 8) | raw[:, column]
            result[chosen] = value
    return result
