"""Bytes of a file at any place: all of them, or an error that says where they end."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from imucal.errors import ReadError
from imucal.readers.files import DamagedError, LogFile, Scratch


@pytest.fixture
def file(tmp_path: Path) -> Iterator[LogFile]:
    path = tmp_path / "log.bin"
    path.write_bytes(bytes(range(20)))
    opened = LogFile(path)
    yield opened
    opened.close()


def test_any_part_of_a_file_is_read(file: LogFile) -> None:
    """Up to its last byte, and nothing of it too."""
    assert file.size == 20
    assert file.read(0, 20) == bytes(range(20))
    assert file.read(18, 2) == b"\x12\x13"
    assert file.read(20, 0) == b""


@pytest.mark.parametrize(("position", "size"), [(0, 21), (19, 2), (21, 0), (5, -1)])
def test_what_lies_beyond_the_end_is_said(file: LogFile, position: int, size: int) -> None:
    with pytest.raises(DamagedError) as caught:
        file.read(position, size)
    assert caught.value.code == "truncated"
    assert str(caught.value) == f"{size} bytes at byte {position} are beyond the end of the file"


@pytest.mark.parametrize("position", [-1, 17])
def test_a_buffer_is_filled_from_within_the_file(file: LogFile, position: int) -> None:
    with pytest.raises(DamagedError) as caught:
        file.into(position, memoryview(bytearray(4)))
    assert caught.value.code == "truncated"
    assert str(caught.value) == f"bytes {position} to {position + 4} are beyond the end of the file"


def test_a_system_that_reads_piece_by_piece_gives_the_same(
    file: LogFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may return fewer bytes than were asked for, as often as it likes."""
    read = os.preadv
    monkeypatch.setattr(os, "preadv", lambda number, views, at: read(number, [views[0][:3]], at))
    assert file.read(2, 11) == bytes(range(2, 13))


def test_a_system_without_positioned_reads_gives_the_same(
    file: LogFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows has none."""
    monkeypatch.delattr(os, "preadv")
    assert file.read(2, 11) == bytes(range(2, 13))
    assert file.read(0, 20) == bytes(range(20))


def test_a_file_that_is_cut_while_it_is_read_is_told(file: LogFile, monkeypatch: pytest.MonkeyPatch) -> None:
    """At the byte where it ends; an error of the disk stops the program."""
    file.path.write_bytes(bytes(range(7)))
    with pytest.raises(DamagedError, match=r"^the file ended at byte 7 during reading$") as caught:
        file.read(2, 11)
    assert caught.value.code == "truncated"

    def fail(*_: Any) -> int:  # noqa: ANN401
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "preadv", fail)
    with pytest.raises(ReadError) as stopped:
        file.read(2, 3)
    assert str(stopped.value) == f"{file.path}: can't be read at byte 2: Input/output error"


def test_a_buffer_is_used_again() -> None:
    """Until it is too small; then it has an eighth to spare."""
    scratch = Scratch()
    first = scratch.buffer(80)
    first[:] = b"a" * 80
    assert bytes(scratch.buffer(8)) == b"a" * 8
    assert bytes(scratch.buffer(90))[:80] == b"a" * 80
    assert bytes(scratch.buffer(91)) == bytes(91)
