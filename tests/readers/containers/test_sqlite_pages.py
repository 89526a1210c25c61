"""The pages of a SQLite file: real ones as SQLite itself reads them, and damaged ones byte by byte."""

import sqlite3
import struct
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest

from imucal.findings import Finding
from imucal.readers.containers import sqlite
from imucal.readers.containers.container import Batch
from imucal.readers.containers.sqlite import (
    Leaves,
    PageTask,
    _integers,
    _joined,
    batch_of_blobs,
    connect_alone,
    find_leaves,
    page_size,
    parse_rows,
    scan_leaves,
)
from imucal.readers.files import DamagedError, LogFile, Scratch

Held = Callable[..., LogFile]
PAGE = 512
LEAF, INTERIOR = 13, 5


def head(page: int = PAGE, reserved: int = 0) -> bytes:
    """Return the hundred bytes a database begins with."""
    data = bytearray(b"SQLite format 3\0".ljust(100, b"\0"))
    struct.pack_into(">H", data, 16, 1 if page == 65536 else page)
    data[20] = reserved
    return bytes(data)


def interior(children: list[tuple[int, int]], last: int, kind: int = INTERIOR) -> bytes:
    """Return an interior page: child and largest row of each cell, and the child behind them."""
    data, at = bytearray(PAGE), PAGE
    data[0] = kind
    struct.pack_into(">H", data, 3, len(children))
    struct.pack_into(">I", data, 8, last)
    for number, (child, key) in enumerate(children):
        at -= 5
        struct.pack_into(">IB", data, at, child, key)
        struct.pack_into(">H", data, 12 + 2 * number, at)
    return bytes(data)


def leaf(cells: int = 0) -> bytes:
    """Return a leaf page that says how many cells it has."""
    data = bytearray(PAGE)
    data[0] = LEAF
    struct.pack_into(">H", data, 3, cells)
    return bytes(data)


@pytest.mark.parametrize(("size", "reserved"), [(512, 0), (4096, 12), (65536, 255)])
def test_the_size_of_a_page(size: int, reserved: int, held: Held) -> None:
    """A power of two from 512 on; 65536 is written as 1. Some bytes of each may be reserved."""
    assert page_size(held(head(size, reserved))) == (size, size - reserved)


@pytest.mark.parametrize("size", [0, 256, 511, 513, 1000])
def test_other_sizes_are_damage(size: int, held: Held) -> None:
    with pytest.raises(DamagedError, match=r"^the page size is damaged$"):
        page_size(held(head(size)))


def pages_of(held: Held, *pages: bytes) -> LogFile:
    """Return a file of a first page and others."""
    return held(head().ljust(PAGE, b"\0"), *pages)


def test_leaves_come_in_the_order_of_their_rows(held: Held) -> None:
    """Two levels of interior pages; the last child of each has the rows up to the bound above."""
    file = pages_of(
        held,
        interior([(3, 20)], 4),  # 2: the root
        interior([(7, 5), (6, 11)], 5),  # 3: rows up to 20
        interior([(8, 30)], 9),  # 4: the rest
        *[leaf()] * 5,
    )
    found = find_leaves(file, 2, 1, 99)
    assert found.pages.tolist() == [7, 6, 5, 8, 9]
    assert found.last_ids.tolist() == [5, 11, 20, 30, 99]
    assert found.first_id == 1
    alone = find_leaves(file, 9, 4, 7)
    assert (alone.pages.tolist(), alone.last_ids.tolist(), alone.first_id) == ([9], [7], 4)


@pytest.mark.parametrize(
    ("pages", "reason"),
    [
        ([interior([(0, 1)], 3), leaf()], "a page number is damaged"),
        ([interior([(1, 1)], 3), leaf()], "a page number is damaged"),
        ([interior([(3, 1)], 1), interior([], 4), leaf()], "a page number is damaged"),
        ([interior([], 2)], "the tree of pages is damaged"),
        ([interior([(2, 1)], 2)], "the tree of pages is damaged"),
        ([interior([(3, 1)], 3), interior([], 3, kind=2)], "an interior page is damaged"),
        ([b"\x05\0\0\0\xfb".ljust(PAGE, b"\0")], "an interior page is damaged"),
        ([interior([(3, 1)], 3)[:12] + struct.pack(">H", PAGE - 4) + bytes(PAGE - 14)], "an interior page"),
        ([interior([(9, 1)], 3), leaf()], "beyond the end of the file"),
    ],
)
def test_a_damaged_tree_is_found_out(pages: list[bytes], reason: str, held: Held) -> None:
    """Pages that are none, or that lead in circles; then all leaves are looked for instead."""
    with pytest.raises(DamagedError, match=reason):
        find_leaves(pages_of(held, *pages), 2, 1, 9)


def test_the_last_place_of_a_cell(held: Held) -> None:
    """Five bytes at least: a page number and a row."""
    page = bytearray(interior([(3, 7)], 4))
    assert struct.unpack_from(">H", page, 12) == (PAGE - 5,)
    assert find_leaves(pages_of(held, bytes(page), leaf(), leaf()), 2, 1, 9).pages.tolist() == [3, 4]
    struct.pack_into(">H", page, 12, PAGE - 4)
    with pytest.raises(DamagedError, match="an interior page is damaged"):
        find_leaves(pages_of(held, bytes(page), leaf(), leaf()), 2, 1, 9)


def test_pages_are_numbered_by_four_bytes(held: Held) -> None:
    """A file of terabytes has so many."""
    numbers = [0x01020304, 0x05060708, 0x7FFFFFFF]
    page = interior([(numbers[0], 5), (numbers[1], 9)], numbers[2])
    pages, rows = sqlite._children(pages_of(held, page), 2, PAGE, 99)
    assert (pages.tolist(), rows.tolist()) == (numbers, [5, 9, 99])


@pytest.mark.parametrize("group", [2, 3, 512])
def test_groups_bound_their_rows(group: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the largest row of their last page, from the first row on; in sum there are no more."""
    monkeypatch.setattr(sqlite, "_GROUP", group)
    leaves = Leaves(pages=np.arange(2, 7), last_ids=np.array([10, 20, 30, 40, 55]), first_id=4)
    groups = [(pages.tolist(), most) for pages, most in leaves.groups()]
    expected = {2: [([2, 3], 17), ([4, 5], 20), ([6], 15)], 3: [([2, 3, 4], 27), ([5, 6], 25)]}
    assert groups == expected.get(group, [([2, 3, 4, 5, 6], 52)])
    # Rows in another order are damage: no fewer than none.
    wrong = Leaves(pages=np.arange(2), last_ids=np.array([1, 1]), first_id=9)
    assert [most for _, most in wrong.groups()] == [0]


@pytest.mark.parametrize("group", [1, 2, 512])
def test_all_leaves_are_looked_for(group: int, held: Held, monkeypatch: pytest.MonkeyPatch) -> None:
    """By their first byte, among whole pages; a page of 512 bytes holds 32 messages at most."""
    monkeypatch.setattr(sqlite, "_GROUP", group)
    file = pages_of(held, leaf(3), interior([], 2), leaf(300), leaf(5)[:-1])
    groups = scan_leaves(file)
    assert [page for pages, _ in groups for page in pages.tolist()] == [2, 4]
    assert sum(most for _, most in groups) == 3 + 32


def bag(folder: Path, rows: list[tuple[int, int, int, bytes]], page: int = PAGE) -> Path:
    """Return a database with a table of messages: id, topic, time and data."""
    path = folder / "log.db3"
    with closing(sqlite3.connect(path, isolation_level=None)) as base:
        base.execute(f"pragma page_size={page}")
        base.execute("pragma synchronous=off")
        base.execute(
            "create table messages(id integer primary key, topic_id integer not null,"
            " timestamp integer not null, data blob not null)"
        )
        base.execute("begin")
        base.executemany("insert into messages values (?, ?, ?, ?)", rows)
        base.execute("commit")
    return path


VALUES = [0, 1, 127, 128, -1, -129, 1 << 20, -(1 << 30), 1 << 40, 1 << 62, 255, 1 << 15]


def test_numbers_of_every_size_are_those_of_sqlite(tmp_path: Path) -> None:
    """Topics and times of one to eight bytes, ids beyond one; data of any length, of none too."""
    rows = [
        (7 + 90 * i, abs(value) % 70_000, value, bytes([i]) * (5 * i + 3)) for i, value in enumerate(VALUES)
    ]
    rows.insert(5, (8, 1, 1 << 40, b""))
    path = bag(tmp_path, sorted(rows), page=4096)
    file = LogFile(path)
    try:
        buffer = memoryview(file.read(4096, 4096))
        found = parse_rows(buffer, 4096, 4096)
        assert (found.damaged, found.long_ids.size) == (0, 0)
        data = [bytes(buffer[at : at + size]) for at, size in zip(found.starts, found.sizes, strict=True)]
        table = list(zip(found.topics.tolist(), found.times.tolist(), data, strict=True))
        assert table == [row[1:] for row in sorted(rows)]
    finally:
        file.close()


def tasks_of(file: LogFile, rows: int, keys: list[int], **options: object) -> list[PageTask]:
    """Return what loads the messages of some topics."""
    leaves = find_leaves(file, 2, 1, rows)
    return [PageTask(file, pages, keys, most, options.get("fetch")) for pages, most in leaves.groups()]  # type: ignore[arg-type]


def test_messages_of_each_topic_in_their_order(tmp_path: Path) -> None:
    """Over many pages, and pages that do not lie side by side."""
    rows = [(i + 1, 1 + i % 3, 1000 + i, bytes([i % 256]) * (20 + i % 7)) for i in range(200)]
    file = LogFile(bag(tmp_path, rows))
    try:
        (task,) = tasks_of(file, 200, [1, 3])
        assert task.counts == {1: 200, 3: 200}
        assert task.size % PAGE == 0
        found = dict(task.load(Scratch()))
        for key, batch in found.items():
            own = [row for row in rows if row[1] == key]
            assert batch.log_ns.tolist() == [row[2] for row in own]
            sizes = np.broadcast_to(batch.sizes, batch.n).tolist()
            data = [bytes(batch.buffer[a : a + s]) for a, s in zip(batch.starts.tolist(), sizes, strict=True)]
            assert data == [row[3] for row in own]
            assert batch.loss is None
        backwards = PageTask(file, task._pages[::-1].copy(), [1], 5, None)
        assert backwards.counts == {1: 5}
        ((_, batch),) = backwards.load(Scratch())
        assert sorted(batch.log_ns.tolist()) == [row[2] for row in rows if row[1] == 1]
    finally:
        file.close()


@pytest.mark.parametrize("size", [469, 470, 471, 472, 600])
def test_what_a_page_can_not_hold_is_fetched(size: int, tmp_path: Path) -> None:
    """A record of up to 477 bytes lies in a page of 512; a longer one reaches over several."""
    rows = [(1, 1, 5, b"short"), (2, 1, 6, b"x" * size), (3, 2, 7, b"y" * size), (4, 1, 8, b"end")]
    asked: list[tuple[int, int, int]] = []

    def fetch(key: int, first: int, last: int) -> Batch:
        asked.append((key, first, last))
        return batch_of_blobs([rows[first - 1][3]], [rows[first - 1][2]])

    file = LogFile(bag(tmp_path, rows))
    try:
        found = [pair for task in tasks_of(file, 4, [1], fetch=fetch) for pair in task.load(Scratch())]
        messages = []
        for _, batch in found:
            sizes = np.broadcast_to(batch.sizes, batch.n).tolist()
            data = [bytes(batch.buffer[a : a + s]) for a, s in zip(batch.starts.tolist(), sizes, strict=True)]
            messages += list(zip(batch.log_ns.tolist(), data, strict=True))
            assert batch.loss is None
        assert sorted(messages) == [(5, b"short"), (6, b"x" * size), (8, b"end")]
        # The head of the record has six bytes, the time one, and topic 1 none.
        assert bool(asked) == (size + 7 > PAGE - 35)
        assert all(question == (1, 2, 2) for question in asked)
    finally:
        file.close()


def test_damaged_rows_are_counted_where_sqlite_knows_better(tmp_path: Path) -> None:
    """Once, with the first topic; in a cut file they belong to other tables."""
    rows = [(i + 1, 1 + i % 2, i, b"abc") for i in range(6)]
    path = bag(tmp_path, rows)
    data = bytearray(path.read_bytes())
    place = struct.unpack_from(">H", data, PAGE + 8)[0]
    data[PAGE + place + 2] = 99
    path.write_bytes(data)
    file = LogFile(path)
    try:
        for fetch, lost in ((lambda *_: batch_of_blobs([], []), 1), (None, None)):
            (task,) = tasks_of(file, 6, [1, 2], fetch=fetch)
            (_, first), (_, second) = task.load(Scratch())
            assert (first.log_ns.tolist(), second.log_ns.tolist()) == ([2, 4], [1, 3, 5])
            assert (first.loss.messages if first.loss else None, second.loss) == (lost, None)
            if first.loss:
                assert (first.loss.code, first.loss.text) == ("damaged", "rows of the database are damaged")
    finally:
        file.close()


def test_further_messages_take_their_place_in_time() -> None:
    """Those of the pages keep theirs where times are equal."""
    batch = Batch.of(b"abcdef", np.array([0, 3]), np.array([3, 3]), np.array([10, 30]))
    whole = _joined([batch, batch_of_blobs([b"xy", b"", b"z"], [20, 30, 5])])
    assert whole.log_ns.tolist() == [5, 10, 20, 30, 30]
    sizes = np.broadcast_to(whole.sizes, whole.n).tolist()
    data = [bytes(whole.buffer[a : a + s]) for a, s in zip(whole.starts.tolist(), sizes, strict=True)]
    assert (data, whole.header) == ([b"z", b"abc", b"xy", b"def", b""], 0)
    npt.assert_array_equal(sizes, [1, 3, 2, 3, 0])


@pytest.mark.parametrize("log", [b"", b"rows", None])
def test_a_write_ahead_log_that_has_to_be_left_out_is_said(log: bytes | None, tmp_path: Path) -> None:
    """One that is empty or missing holds nothing."""
    path = bag(tmp_path, [(1, 1, 1, b"abc")])
    if log is not None:
        path.with_name("log.db3-wal").write_bytes(log)
    findings = list[Finding]()
    with closing(connect_alone(path, findings)) as base:
        assert base.execute("select count(*) from messages").fetchone() == (1,)
    assert [(found.code, found.text.partition(" ")[0]) for found in findings] == (
        [("wal-ignored", "log.db3-wal")] if log else []
    )


def test_integers_of_every_type_and_of_none() -> None:
    """Beside each other; a type that is none gives zero, a negative one too."""
    data = np.arange(0x70, 0xB0, dtype=np.uint8)
    kinds = np.array([1, 2, 3, 4, 5, 6, 0, 8, 9, -3])
    # Behind the head of a page, which has eight bytes.
    places = np.arange(kinds.size) * 3 + 8
    widths = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}
    expected = [
        int.from_bytes(data[at : at + widths[kind]].tobytes(), "big", signed=True)
        if kind in widths
        else int(kind == 9)
        for at, kind in zip(places.tolist(), kinds.tolist(), strict=True)
    ]
    assert _integers(data, places, kinds).tolist() == expected
    for kind, at, value in zip(kinds.tolist(), places.tolist(), expected, strict=True):
        assert _integers(data, np.array([at, at]), np.array([kind, kind])).tolist() == [value, value]
