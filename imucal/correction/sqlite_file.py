"""Rewrite a SQLite file of a ROS 2 bag: the messages of some topics change, all other rows stay."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from imucal.correction.job import MARK, AlreadyCorrectedError, Job, Patch
from imucal.readers.containers.sqlite import batch_of_blobs

#: Rows that are changed at once.
_ROWS = 1024
#: Pages that are copied between two calls of the progress.
_PAGES = 4096


def rewrite_sqlite(source: Path, target: Path, job: Job, *, zstd: bool = False) -> None:
    """Copy a database with changed messages of some topics, also messages that are only in its log.

    With `zstd` each message is compressed. Raises sqlite3.Error, and AlreadyCorrectedError.
    """
    size = source.stat().st_size
    with (
        closing(sqlite3.connect(f"{source.absolute().as_uri()}?mode=ro", uri=True)) as old,
        closing(sqlite3.connect(target)) as new,
    ):
        if old.execute("select 1 from sqlite_master where name = ?", (MARK,)).fetchone():
            raise AlreadyCorrectedError

        def copied(_: int, left: int, total: int) -> None:
            job.progress(size * (total - left) // max(total, 1))

        old.backup(new, pages=_PAGES, progress=copied)
        with new:
            for key in sorted(job.keys):
                _change_topic(new, key, job.patch, zstd=zstd)
            new.execute(f'create table "{MARK}" (corrected text)')
            new.execute(f'insert into "{MARK}" values (?)', (job.mark,))  # noqa: S608 - our own name


def _change_topic(base: sqlite3.Connection, key: int, patch: Patch, *, zstd: bool) -> None:
    for rows in _rows(base, key):
        blobs = [bytes(row[2]) for row in rows]
        batch = batch_of_blobs(_unpacked(blobs) if zstd else blobs, [row[1] for row in rows])
        buffer = bytearray(batch.buffer)
        patch(key, replace(batch, buffer=buffer))
        ends = zip(batch.starts.tolist(), batch.sizes.tolist(), strict=True)
        changed = [bytes(buffer[start : start + length]) for start, length in ends]
        if zstd:
            changed = _packed(changed)
        numbers = (row[0] for row in rows)
        base.executemany("update messages set data = ? where rowid = ?", zip(changed, numbers, strict=True))


def _rows(base: sqlite3.Connection, key: int) -> Iterator[list[tuple[int, int, bytes]]]:
    """Yield rowid, time and data of the messages of a topic."""
    last = -(1 << 63)
    query = (
        "select rowid, timestamp, data from messages where topic_id = ? and rowid > ? order by rowid limit ?"
    )
    while rows := base.execute(query, (key, last, _ROWS)).fetchall():
        last = rows[-1][0]
        yield rows


def _unpacked(blobs: list[bytes]) -> list[bytes]:
    import zstandard

    machine = zstandard.ZstdDecompressor()
    return [machine.decompress(blob) for blob in blobs]


def _packed(blobs: list[bytes]) -> list[bytes]:
    import zstandard

    machine = zstandard.ZstdCompressor()
    return [machine.compress(blob) for blob in blobs]
