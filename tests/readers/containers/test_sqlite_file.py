"""The database of a ROS 2 bag: topics, counts, row ranges, write-ahead logs, and damage."""

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest

from imucal.errors import ReadError
from imucal.readers.containers import sqlite
from imucal.readers.containers.container import Batch, Loss
from imucal.readers.containers.sqlite import SqliteFile, batch_of_blobs
from tests.raising import raises

TABLES = (
    "create table topics(id integer primary key, name text, type text, serialization_format text)",
    "create table message_definitions(topic_type text, encoding text, encoded_message_definition text)",
)
MESSAGES = "id integer primary key, topic_id integer, timestamp integer, data blob"
#: Id, topic, time, data.
Row = tuple[int, int, int | float | str, bytes | str | None]
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
        for key, batch in task.load():
            found += [(key, time, data) for time, data in payloads(batch)]
    return found


def payloads(batch: Batch) -> list[tuple[int, bytes]]:
    """Return time and data of each message."""
    data = [bytes(message) for message in batch.messages()]
    return list(zip(batch.log_ns.tolist(), data, strict=True))


def losses(file: SqliteFile, *keys: int) -> list[Loss]:
    """Return the losses of some topics."""
    tasks = file.tasks(frozenset(keys))
    found = [batch.loss for task in tasks for _, batch in task.load()]
    return [loss for loss in found if loss is not None]


def of(*keys: int) -> list[tuple[int, int, bytes]]:
    """Return the expected messages of some topics."""
    return [(topic, time, data) for key in keys for _, topic, time, data in ROWS if topic == key]  # type: ignore[misc]


def test_topics_have_counts_and_definitions(tmp_path: Path) -> None:
    """The times are those of the complete file."""
    with closing(SqliteFile(database(tmp_path))) as file:
        first, second = file.channels
        assert (first.key, first.topic, first.type, first.encoding) == (1, "/t1", "p/msg/M", "cdr")
        assert (first.definition, first.definition_kind) == ("int8 x", "ros2msg")
        assert (first.count, second.count) == (5, 5)
        assert {(c.first_ns, c.last_ns) for c in file.channels} == {(101, 110)}
        assert (file.start_ns, file.end_ns) == (101, 110)
        assert (file.compression, file.findings, file.parallel) == ("none", [], False)
        assert messages(file, 1, 2, 3) == of(1, 2)
        assert messages(file, 2) == of(2)
        assert list(file.tasks(frozenset({3}))) == []
        assert file.sample() == b"m1"


def test_messages_are_counted_or_the_count_is_that_of_the_metadata(tmp_path: Path) -> None:
    """The counts of the metadata are used if their sum is right, or there are millions of messages."""
    path = database(tmp_path)

    def counts(known: dict[str, int] | None) -> list[int | None]:
        with closing(SqliteFile(path, known)) as file:
            return [channel.count for channel in file.channels]

    assert counts({"/t1": 70, "/t2": 0}) == [5, 5]
    # Counting by topic takes 0.6 us a row, so counts with the right sum are used.
    assert counts({"/t1": 4, "/t2": 6}) == [4, 6]
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sqlite, "_COUNTED", 10)
        assert counts(None) == [5, 5]
        patched.setattr(sqlite, "_COUNTED", 9)
        assert counts(None) == [None, None]
        assert counts({"/t1": 70}) == [None, None]
        assert counts({"/t1": 70, "/t2": 6}) == [70, 6]
    assert sqlite._COUNTED == 2_000_000
    path.unlink()
    path = database(tmp_path, [(i + 3, 1, i, b"") for i in (0, 1, 3)], topics=1)
    assert counts(None) == [3]
    path.unlink()
    path = database(tmp_path, [], topics=1)
    assert counts(None) == [0]
    with closing(SqliteFile(path)) as file:
        assert (file.start_ns, file.end_ns, messages(file, 1), file.sample()) == (None, None, [], b"")


ENDLESS = "with recursive c(x) as (select 1 union all select x + 1 from c)"


@pytest.mark.parametrize(
    ("statements", "found"),
    [
        (
            (
                "drop table messages",
                f"create view messages as {ENDLESS} select x id, 1 topic_id, x timestamp, x data from c",  # noqa: S608 - a constant
            ),
            "messages is a view",
        ),
        (
            ("alter table topics rename to t", "create view TOPICS as select * from t"),
            "TOPICS is a view",
        ),
        (
            ("drop table messages", "create virtual table messages using fts5(data)"),
            "messages is a virtual table",
        ),
        (
            (
                "drop table messages",
                "create table messages(id, topic_id, timestamp, data blob as (zeroblob(1000000000)))",
            ),
            "column data of messages is computed",
        ),
    ],
)
def test_views_and_computed_columns_are_refused(
    statements: Sequence[str], found: str, tmp_path: Path
) -> None:
    """They may have rows without end, or rows of gigabytes."""
    path = database(tmp_path)
    with closing(sqlite3.connect(path)) as base, base:
        for statement in statements:
            base.execute(statement)
    with raises(ReadError, f"{found}; expected a table that ROS wrote", place="log.db3"):
        SqliteFile(path)


def test_a_query_that_takes_too_long_is_refused(tmp_path: Path) -> None:
    path = database(tmp_path, [(i, 1, i, b"") for i in range(1, 3000)], topics=1)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sqlite, "patience", lambda _: -1.0)
        patched.setattr(sqlite, "_INSTRUCTIONS", 10)
        with raises(ReadError, "a query takes too long", place="log.db3"):
            SqliteFile(path)


def lost_page(folder: Path) -> Path:
    """Return a bag with an index of times, whose table lacks the messages of some pages."""
    rows: list[Row] = [(i, 1, i, b"%03d" % i * 300) for i in range(1, 160)]
    path = database(folder, rows, topics=1)
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("create index timestamp_idx on messages (timestamp asc)")
        (root,) = base.execute("select rootpage from sqlite_master where name = 'messages'").fetchone()
    data = bytearray(path.read_bytes())
    # An inner page of a table: number of children, last child, and pointers to the cells of the others.
    at, kept = (root - 1) * 4096, 20
    assert data[at] == 5
    cell = at + int.from_bytes(data[at + 12 + 2 * kept : at + 14 + 2 * kept], "big")
    data[at + 3 : at + 5] = kept.to_bytes(2, "big")
    data[at + 8 : at + 12] = data[cell : cell + 4]
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("checked", [1 << 24, 0])
def test_messages_that_only_the_index_lists_are_damage(checked: int, tmp_path: Path) -> None:
    """Large files are not checked page by page, but their counts are compared."""
    path = lost_page(tmp_path)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sqlite, "_CHECKED_BYTES", checked)
        with closing(SqliteFile(path)) as file:
            assert [channel.count for channel in file.channels] == [159]
            (finding,) = file.findings
            n = len(messages(file, 1))
    assert 0 < n < 159
    assert (finding.level, finding.code) == ("warning", "damaged")
    assert f"the table has {n} messages and its index 159" in finding.text


@pytest.mark.parametrize(
    "columns",
    [
        "id integer primary key, timestamp integer, topic_id integer, data blob",
        "id integer, topic_id integer, timestamp integer, data blob",
        MESSAGES + ", more integer",
    ],
)
def test_columns_of_the_database_can_have_any_order(columns: str, tmp_path: Path) -> None:
    """A table without a primary key is read by its row numbers."""
    with closing(SqliteFile(database(tmp_path, columns=columns))) as file:
        assert messages(file, 1, 2) == of(1, 2)


@pytest.mark.parametrize("name", ["a?b#c.db3", "50%.db3", "%41.db3", "f\u00fcr \u65e5.db3", "file:x.db3"])
def test_file_names_can_contain_special_characters(name: str, tmp_path: Path) -> None:
    path = database(tmp_path).rename(tmp_path / name)
    with closing(SqliteFile(path)) as file:
        assert messages(file, 1) == of(1)


def test_ranges_contain_every_row_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The size of a range is its share of the file. Sparse ids give longer ranges, not more ranges."""
    monkeypatch.setattr(sqlite, "_ROWS", 4)
    path = database(tmp_path)
    monkeypatch.setattr(sqlite, "_PART", path.stat().st_size // 5)
    with closing(SqliteFile(path)) as file:
        tasks = list(file.tasks(frozenset({1, 2})))
        assert [task.keys for task in tasks] == [{1, 2}] * 3
        assert sum(task.size for task in tasks) == pytest.approx(file.size, abs=3)
        assert messages(file, 1) == of(1)
    path.unlink()
    far: list[Row] = [*ROWS, (2**63 - 1, 1, 111, b"far")]
    monkeypatch.setattr(sqlite, "_PART", path.stat().st_size if path.exists() else 4096)
    with closing(SqliteFile(database(tmp_path, far))) as file:
        tasks = list(file.tasks(frozenset({1})))
        assert len(tasks) <= file.size // 4096 + 1
        assert messages(file, 1) == [*of(1), (1, 111, b"far")]


def test_topics_keep_the_order_of_their_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The number of rows per fetch does not matter."""
    monkeypatch.setattr(sqlite, "_FETCH", 2)
    with closing(SqliteFile(database(tmp_path))) as file:
        (task,) = file.tasks(frozenset({1, 2}))
        found = {key: payloads(batch) for key, batch in task.load()}
        assert found == {key: [row[1:] for row in of(key)] for key in (1, 2)}
        times = [time for _, time in sorted((key, batch.log_ns[0]) for key, batch in task.load())]
        assert times == [102, 101]
        assert all(after > before for before, after in pairwise(row[1] for row in of(1)))


@pytest.mark.parametrize(
    "wrong",
    [(30, 1, 5, None), (30, 1, 5, "text"), (30, 1, 5.5, b"data"), (30, 1, "noon", b"data")],
    ids=["nothing", "text", "float time", "text time"],
)
def test_rows_of_wrong_types_are_lost(wrong: Row, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only a few neighbouring rows are lost with them."""
    monkeypatch.setattr(sqlite, "_MIN_RANGE", 1)
    rows: list[Row] = [(i, 1 + i % 2, 100 + i, b"m%d" % i) for i in range(1, 60) if i != 30]
    with closing(SqliteFile(database(tmp_path, [*rows, wrong]))) as file:
        assert [time for _, time, _ in messages(file, 1)] == [100 + i for i in range(2, 60, 2) if i != 30]
        (loss,) = losses(file, 1)
        assert (loss.code, loss.messages) == ("damaged", 1)
        assert loss.text.startswith("the SQLite database can't be read at rows from 30 on: ")
        assert losses(file, 2) == []


def big(folder: Path) -> tuple[Path, bytes]:
    """Return a bag of 40 pages, and its content."""
    rows: list[Row] = [(i, 1, i, b"%03d" % i * 300) for i in range(1, 160)]
    path = database(folder, rows, topics=1)
    return path, path.read_bytes()


@pytest.mark.parametrize("topics", [1, 2])
def test_rows_of_a_damaged_page_are_lost(topics: int, tmp_path: Path) -> None:
    """The other rows are read. Counting the messages of two topics does not raise an error."""
    path, data = big(tmp_path)
    if topics == 2:
        with closing(sqlite3.connect(path)) as base, base:
            base.execute("insert into topics values (2, '/t2', 'p/msg/M', 'cdr')")
        data = path.read_bytes()
    at = data.index(b"080" * 300) // 4096 * 4096
    path.write_bytes(data[:at] + bytes(4096) + data[at + 4096 :])
    with closing(SqliteFile(path)) as file:
        assert [channel.count for channel in file.channels] == ([159] if topics == 1 else [None, None])
        found = messages(file, 1)
        assert all(data == b"%03d" % time * 300 for _, time, data in found)
        (loss,) = losses(file, 1)
        assert loss.messages == 159 - len(found)
        assert 4 <= loss.messages <= 40
        assert loss.text.endswith("database disk image is malformed")


@pytest.mark.parametrize("lost", [1, 4096, 100_000])
def test_a_cut_file_is_refused(lost: int, tmp_path: Path) -> None:
    """The error explains how to recover it."""
    path, data = big(tmp_path)
    path.write_bytes(data[:-lost])
    with pytest.raises(ReadError) as caught:
        SqliteFile(path)
    assert str(caught.value) == (
        f"{path}: the SQLite database can't be read: it has {len(data) - lost} of {len(data)} bytes; "
        "expected a ROS 2 bag; copy it again, or recover it with "
        "`sqlite3 log.db3 .recover | sqlite3 recovered.db3` "
        "(use sqlite3 from sqlite.org if yours prints an SQL error)"
    )


@pytest.mark.parametrize("size", [0, 15, 16, 18, 19, 99, 100, 200])
def test_the_start_of_a_file_is_refused(size: int, tmp_path: Path) -> None:
    path, data = big(tmp_path)
    path.write_bytes(data[:size])
    with raises(ReadError, "SQLite database", place="log.db3"):
        SqliteFile(path)


def test_an_encrypted_file_is_refused(tmp_path: Path) -> None:
    """Some programs do not encrypt the first 16 bytes."""
    path, data = big(tmp_path)
    path.write_bytes(data[:16] + bytes(value ^ 0x5A for value in data[16:]))
    with raises(ReadError, r"`sqlite3 log.db3 \.recover \| sqlite3", place="log.db3"):
        SqliteFile(path)


def test_another_database_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "contacts.db3"
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("create table people(name text)")
    with raises(ReadError, "there is no table messages", place="contacts.db3"):
        SqliteFile(path)


def test_a_locked_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The lock is set before or during reading."""
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", partial(connect, timeout=0.01))
    path = database(tmp_path)
    advice = "database is locked; expected a ROS 2 bag; stop the recorder, or copy the bag and read the copy"
    with closing(connect(path, isolation_level=None)) as recorder, closing(SqliteFile(path)) as file:
        recorder.execute("begin exclusive")
        with raises(ReadError, advice, place="log.db3"):
            SqliteFile(path)
        with raises(ReadError, advice, place="log.db3"):
            messages(file, 1)
        recorder.execute("rollback")
        assert messages(file, 1) == of(1)


def unfinished(folder: Path) -> Path:
    """Return a bag whose last messages are only in its write-ahead log."""
    path = folder / "killed.db3"
    complete = database(folder)
    with closing(sqlite3.connect(complete)) as base:
        base.execute("pragma journal_mode=wal")
        base.execute("delete from messages where id > 8")
        base.commit()
        for suffix in ("", "-wal"):
            path.with_name(path.name + suffix).write_bytes(
                complete.with_name(complete.name + suffix).read_bytes()
            )
    complete.unlink()
    return path


def test_a_write_ahead_log_is_read(tmp_path: Path) -> None:
    path = unfinished(tmp_path)
    log = path.with_name("killed.db3-wal")
    before = path.read_bytes(), log.read_bytes()
    with closing(SqliteFile(path)) as file:
        assert messages(file, 1) == of(1)[:4]
        assert file.findings == []
    assert (path.read_bytes(), log.read_bytes()) == before


@pytest.mark.parametrize("damage", ["no log", "refused"])
def test_an_unreadable_write_ahead_log_is_reported(
    damage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SQLite opens no log if it can't create files, and silently ignores a damaged log."""
    path = unfinished(tmp_path)
    if damage == "no log":
        path.with_name("killed.db3-wal").write_bytes(b"no write-ahead log" * 100)
    else:
        query_only = SqliteFile._query_only

        def refused(file: SqliteFile, options: str) -> sqlite3.Connection:
            if "immutable" not in options:
                raise sqlite3.OperationalError("unable to open database file")
            return query_only(file, options)

        monkeypatch.setattr(SqliteFile, "_query_only", refused)
    with closing(SqliteFile(path)) as file:
        assert messages(file, 1) == of(1)
        (finding,) = file.findings
        assert (finding.level, finding.code) == ("warning", "wal-ignored")
        assert finding.text == "killed.db3-wal can't be read; messages that are only in it are missing."
        assert finding.advice == "Copy the bag to a folder with write permission."


@pytest.mark.parametrize("log", [None, b""])
def test_reading_creates_no_files(log: bytes | None, tmp_path: Path) -> None:
    """A closed database with `journal_mode=wal` needs no log; an empty log contains no messages."""
    path = database(tmp_path)
    with closing(sqlite3.connect(path)) as base:
        base.execute("pragma journal_mode=wal")
    if log is not None:
        path.with_name("log.db3-wal").write_bytes(log)
    before = sorted(tmp_path.iterdir())
    with closing(SqliteFile(path)) as file:
        assert messages(file, 1) == of(1)
        assert file.findings == []
        assert sorted(tmp_path.iterdir()) == before


def test_rows_over_several_pages_are_read(tmp_path: Path) -> None:
    long = b"x" * 9000
    with closing(SqliteFile(database(tmp_path, [*ROWS, (11, 1, 5, long)]))) as file:
        assert messages(file, 1) == [*of(1), (1, 5, long)]


def test_separate_messages_become_one_batch() -> None:
    batch = batch_of_blobs([b"ab", b"", b"cde"], [5, 6, 7])
    assert payloads(batch) == [(5, b"ab"), (6, b""), (7, b"cde")]
    assert batch_of_blobs([], []).n == 0


def test_a_table_without_a_column_of_a_bag_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "old.db3"
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("create table messages(topic_id integer, timestamp integer)")
        base.execute("create table topics(id integer, name text, type text, serialization_format text)")
    with pytest.raises(ReadError, match="table messages has no column data; expected a ROS 2 bag"):
        SqliteFile(path)
