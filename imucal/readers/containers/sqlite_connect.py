"""Connections to a SQLite file that is only read: with its write-ahead log, without, or its start."""

import os
import sqlite3
import tempfile
from pathlib import Path
from urllib.parse import quote

from imucal.findings import Finding
from imucal.readers.files import LogFile

#: A bag's topics and definitions are written first: they lie in the first pages, in bytes.
_START = 1 << 22
#: Longest file that a cut database is made up to, in bytes; it is sparse.
_LONGEST = 1 << 40


def connect(path: Path, findings: list[Finding]) -> sqlite3.Connection:
    """Open a database for reading; its write-ahead log is read too where it lies beside it."""
    uri = "file:" + quote(os.fsencode(path.absolute()))
    base = _open(uri + "?mode=ro")
    try:
        _look(base)
    except sqlite3.OperationalError:
        base.close()
        return _connect_alone(uri, path, findings)
    except sqlite3.Error:
        base.close()
        raise
    return base


def connect_to_start(file: LogFile) -> sqlite3.Connection:
    """Return a database in memory with the tables that the first pages of a cut file hold.

    SQLite refuses a file that is shorter than its first page says. So the start is copied to a sparse
    file of the right length, and the small tables are taken from there.
    """
    head = file.read(0, min(_START, file.size))
    pages, size = int.from_bytes(head[28:32], "big"), int.from_bytes(head[16:18], "big")
    size = 65536 if size == 1 else size
    result = sqlite3.connect(":memory:", check_same_thread=False)
    try:
        with tempfile.TemporaryDirectory(prefix="imucal-") as folder:
            copy = Path(folder) / "start.db3"
            with copy.open("wb") as target:
                target.write(head)
                target.truncate(max(min(pages * size, _LONGEST), len(head)))
            source = _open("file:" + quote(os.fsencode(copy)) + "?mode=ro&immutable=1")
            try:
                _copy_tables(source, result)
            finally:
                source.close()
    except BaseException:
        result.close()
        raise
    return result


def _copy_tables(source: sqlite3.Connection, target: sqlite3.Connection) -> None:
    """Copy topics and definitions."""
    columns = "id, name, type, serialization_format"
    rows = source.execute(f"select {columns} from topics").fetchall()  # noqa: S608 - our own constant
    target.execute(f"create table topics({columns})")
    target.executemany("insert into topics values (?, ?, ?, ?)", rows)
    columns = "topic_type, encoding, encoded_message_definition"
    target.execute(f"create table message_definitions({columns})")
    try:
        rows = source.execute(f"select {columns} from message_definitions").fetchall()  # noqa: S608
    except sqlite3.DatabaseError:
        return
    target.executemany("insert into message_definitions values (?, ?, ?)", rows)


def _open(uri: str) -> sqlite3.Connection:
    return sqlite3.connect(uri, uri=True, check_same_thread=False)


def _look(base: sqlite3.Connection) -> None:
    base.execute("select count(*) from sqlite_master").fetchone()


def _connect_alone(uri: str, path: Path, findings: list[Finding]) -> sqlite3.Connection:
    """Open a database where no file may be made beside it: without its write-ahead log."""
    base = _open(uri + "?mode=ro&immutable=1")
    try:
        _look(base)
    except sqlite3.Error:
        base.close()
        raise
    wal = path.with_name(path.name + "-wal")
    if wal.exists() and wal.stat().st_size:
        text = f"{wal.name} can't be read here, so messages that are only in it are left out."
        advice = "Copy the bag to a folder that can be written to."
        findings.append(Finding(level="warning", code="wal-ignored", text=text, advice=advice))
    return base
