"""A ROS 2 bag's database: topics and counts, ranges of rows, and what only SQLite can read."""

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from functools import partial
from itertools import pairwise
from pathlib import Path
from threading import Lock

import numpy as np
import pytest

from imucal.readers.containers import sqlite
from imucal.readers.containers.container import Batch
from imucal.readers.containers.sqlite import SqliteFile, SqliteTask, batch_of_blobs, fetched
from imucal.readers.files import DamagedError, Scratch

TABLES = (
    "create table topics(id integer primary key, name text, type text, serialization_format text)",
    "create table message_definitions(topic_type text, encoding text, encoded_message_definition text)",
)
MESSAGES = "id integer primary key, topic_id integer, timestamp integer, data blob"
#: Id, topic, time, data.
Row = tuple[int, int, int, bytes | str | None]
ROWS: list[Row] = [(i, 1 + i % 2, 100 + i, b"m%d" % i) for i in range(1, 11)]


def database(folder: Path, rows: Sequence[Row] = ROWS, columns: str = MESSAGES, topics: int = 2) -> Path:
    """Return a bag of a few messages."""
    path = folder / "log.db3"
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("pragma synchronous=off")
        for statement in (*TABLES, f"create table messages({columns})"):
            base.execute(statement)
        for key in range(1, topics + 1):
            base.execute("insert into topics values (?, ?, 'p/msg/M', 'cdr')", (key, f"/t{key}"))
        base.execute("insert into message_definitions values ('p/msg/M', 'ros2msg', 'int8 x')")
        base.executemany("insert into messages(id, topic_id, timestamp, data) values (?, ?, ?, ?)", rows)
    return path


def messages(file: SqliteFile, *keys: int) -> list[tuple[int, int, bytes]]:
    """Return topic, time and data of all messages of some topics."""
    found = []
    for task in file.tasks(frozenset(keys)):
        for key, batch in task.load(Scratch()):
            found += [(key, time, data) for time, data in payloads(batch)]
    return found


def payloads(batch: Batch) -> list[tuple[int, bytes]]:
    """Return time and data of each message."""
    sizes = np.broadcast_to(batch.sizes, batch.n).tolist()
    data = [
        bytes(batch.buffer[at : at + size]) for at, size in zip(batch.starts.tolist(), sizes, strict=True)
    ]
    return list(zip(batch.log_ns.tolist(), data, strict=True))


def of(*keys: int) -> list[tuple[int, int, bytes]]:
    """Return what messages of some topics there are."""
    return [(topic, time, data) for key in keys for _, topic, time, data in ROWS if topic == key]  # type: ignore[misc]


def test_topics_and_their_counts(tmp_path: Path) -> None:
    """With their definition, and the times of the whole file."""
    with closing(SqliteFile(database(tmp_path))) as file:
        first, second = file.channels
        assert (first.key, first.topic, first.type, first.encoding) == (1, "/t1", "p/msg/M", "cdr")
        assert (first.definition, first.definition_kind) == ("int8 x", "ros2msg")
        assert (first.count, second.count) == (5, 5)
        assert {(c.first_ns, c.last_ns) for c in file.channels} == {(101, 110)}
        assert (file.start_ns, file.end_ns, file.first_id, file.last_id) == (101, 110, 1, 10)
        assert (file.compression, file.findings, file.parallel) == ("none", [], True)
        assert messages(file, 1, 2, 3) == of(1, 2)
        assert file.parallel
        assert messages(file, 2) == of(2)
        assert list(file.tasks(frozenset({3}))) == []
        assert file.sample() == b"m1"


def test_counts_that_are_known_are_not_counted_again(tmp_path: Path) -> None:
    """The metadata's, if they name every topic; of one topic the ids; else messages, unless millions."""
    path = database(tmp_path)

    def counts(known: dict[str, int] | None) -> list[int | None]:
        with closing(SqliteFile(path, known)) as file:
            return [channel.count for channel in file.channels]

    assert counts({"/t1": 70, "/t2": 0}) == [70, 0]
    assert counts({"/t1": 70}) == [5, 5]
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sqlite, "_COUNTED", 10)
        assert counts(None) == [5, 5]
        patched.setattr(sqlite, "_COUNTED", 9)
        assert counts(None) == [None, None]
    assert sqlite._COUNTED == 2_000_000
    with closing(SqliteFile(path, {"/t1": 70, "/t2": 0})) as file:
        assert list(file.tasks(frozenset({2}))) == []
    path.unlink()
    path = database(tmp_path, [(i + 3, 1, i, b"") for i in range(4)], topics=1)
    assert counts(None) == [4]
    path.unlink()
    path = database(tmp_path, [], topics=1)
    assert counts(None) == [0]
    with closing(SqliteFile(path)) as file:
        assert (file.start_ns, file.end_ns, messages(file, 1), file.sample()) == (None, None, [], b"")


@pytest.mark.parametrize(
    ("columns", "by_sqlite"),
    [
        (MESSAGES, False),
        ("id integer primary key, timestamp integer, topic_id integer, data blob", True),
        (MESSAGES + ", more integer", True),
    ],
)
def test_columns_in_another_order_are_left_to_sqlite(columns: str, by_sqlite: bool, tmp_path: Path) -> None:  # noqa: FBT001
    """It takes a lock, so that there is one thread; the messages are the same."""
    with closing(SqliteFile(database(tmp_path, columns=columns))) as file:
        assert messages(file, 1, 2) == of(1, 2)
        assert file.parallel != by_sqlite
        assert all(isinstance(task, SqliteTask) == by_sqlite for task in file.tasks(frozenset({1})))


def test_a_write_ahead_log_is_left_to_sqlite(tmp_path: Path) -> None:
    """An empty one holds nothing."""
    path = database(tmp_path)
    log = path.with_name("log.db3-wal")
    for content, parallel in ((b"", True), (b"?", False)):
        log.write_bytes(content)
        with closing(SqliteFile(path)) as file:
            assert messages(file, 1) == of(1)
            assert file.parallel == parallel
            log.write_bytes(content)
            assert file._needs_sqlite() != parallel


def test_ranges_hold_every_row_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of so many, its size a part of the file's. Ids far apart make longer ranges, not more."""
    monkeypatch.setattr(sqlite, "_RANGE", 4)
    with closing(SqliteFile(database(tmp_path))) as file:
        assert [rows for rows, _ in file._ranges()] == [(1, 4), (5, 8), (9, 10)]
        assert {size for _, size in file._ranges()} == {file.size // 2}
        file.last_id = file.size // 32
        assert file._ranges()[0][0] == (1, 4)
        file.last_id = 10**9
        ranges = [rows for rows, _ in file._ranges()]
        assert len(ranges) <= file.size // (32 * 4)
        assert (ranges[0][0], ranges[-1][1]) == (1, 10**9)
        assert all(after[0] == before[1] + 1 for before, after in pairwise(ranges))
        assert {size for _, size in file._ranges()} == {max(file.size // (10**9 // (ranges[0][1])), 1)}
        file.last_id = 1
        assert file._ranges() == [((1, 1), file.size)]


def test_a_range_has_room_for_each_of_its_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever their topic; they come in the order of their ids, however many are fetched at once."""
    monkeypatch.setattr(sqlite, "_FETCH", 2)
    with closing(sqlite3.connect(database(tmp_path))) as base:
        task = SqliteTask(partial(fetched, base, Lock()), [1, 2], (3, 9), 77)
        assert (task.counts, task.size) == ({1: 7, 2: 7}, 77)
        found = {key: payloads(batch) for key, batch in task.load(Scratch())}
        assert found == {
            1: [(104, b"m4"), (106, b"m6"), (108, b"m8")],
            2: [(103, b"m3"), (105, b"m5"), (107, b"m7"), (109, b"m9")],
        }


def test_rows_of_other_types_are_damage(tmp_path: Path) -> None:
    """A text has a length too, but is no message; nothing has none."""
    for wrong in (None, "text"):
        path = database(tmp_path, [*ROWS, (11, 1, 5, wrong)])
        with closing(sqlite3.connect(path)) as base:
            with pytest.raises(DamagedError, match="the SQLite database is damaged"):
                fetched(base, Lock(), 1, 1, 11)
            assert fetched(base, Lock(), 1, 1, 10).n == 5
        path.unlink()


def test_rows_over_several_pages_are_fetched_one_by_one(tmp_path: Path) -> None:
    """Time and data; of a row that is gone, or of another topic, there is nothing."""
    long = b"x" * 9000
    path = database(tmp_path, [*ROWS, (11, 1, 5, long)])
    with closing(SqliteFile(path)) as file:
        assert (1, 5, long) in messages(file, 1)
    with closing(sqlite3.connect(path)) as base:
        assert payloads(fetched(base, Lock(), 1, 11, 11)) == [(5, long)]
        assert fetched(base, Lock(), 2, 11, 11).n == fetched(base, Lock(), 1, 99, 99).n == 0
    with pytest.raises(DamagedError, match="the SQLite database is damaged"):
        fetched(base, Lock(), 1, 11, 11)


@pytest.mark.parametrize("lost", [1, 4096])
def test_a_cut_file_is_scanned(lost: int, tmp_path: Path) -> None:
    """By its pages; it is said."""
    rows: list[Row] = [(i, 1, i, b"%d" % i * 300) for i in range(1, 80)]
    path = database(tmp_path, rows, topics=1)
    data = path.read_bytes()
    path.write_bytes(data[:-lost])
    with closing(SqliteFile(path)) as file:
        found = [time for _, time, _ in messages(file, 1)]
        assert found == sorted(found)
        assert 0 < len(found) < 80
        assert [finding.code for finding in file.findings] == ["truncated"]
    path.write_bytes(data)
    with closing(SqliteFile(path)) as file:
        assert file.findings == []


def test_messages_that_lie_apart_become_one_batch() -> None:
    """One behind the other."""
    batch = batch_of_blobs([b"ab", b"", b"cde"], [5, 6, 7])
    assert payloads(batch) == [(5, b"ab"), (6, b""), (7, b"cde")]
    assert batch_of_blobs([b"ab", b"cd"], [1, 2]).sizes == 2
    assert batch_of_blobs([], []).n == 0
