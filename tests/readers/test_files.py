"""Reading parts of a file: all requested bytes, or an error with the position of the end."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from imucal.errors import ReadError
from imucal.readers.files import DamagedError, LogFile


class Failing:
    """A file on a broken disk."""

    def seek(self, position: int) -> None:
        del position
        raise OSError(5, "Input/output error")


@pytest.fixture
def file(tmp_path: Path) -> Iterator[LogFile]:
    path = tmp_path / "log.bin"
    path.write_bytes(bytes(range(20)))
    opened = LogFile(path)
    yield opened
    opened.close()


def test_any_part_of_a_file_is_read(file: LogFile) -> None:
    """The part can end at the last byte, or be empty."""
    assert file.size == 20
    assert file.read(0, 20) == bytes(range(20))
    assert file.read(18, 2) == b"\x12\x13"
    assert file.read(20, 0) == b""


@pytest.mark.parametrize(("position", "size"), [(0, 21), (19, 2), (21, 0), (5, -1), (-1, 4)])
def test_reading_beyond_the_end_is_reported(file: LogFile, position: int, size: int) -> None:
    with pytest.raises(DamagedError) as caught:
        file.read(position, size)
    assert caught.value.code == "truncated"
    assert str(caught.value) == f"{size} bytes at byte {position} are beyond the end of the file"


def test_truncation_during_reading_is_reported(file: LogFile, monkeypatch: pytest.MonkeyPatch) -> None:
    """The error contains the position of the end; an error of the disk stops the program."""
    file.path.write_bytes(bytes(range(7)))
    with pytest.raises(DamagedError, match=r"^the file ended at byte 7 during reading$") as caught:
        file.read(2, 11)
    assert caught.value.code == "truncated"

    with monkeypatch.context() as broken:
        broken.setattr(file, "_file", Failing())
        with pytest.raises(ReadError) as stopped:
            file.read(2, 3)
    assert str(stopped.value) == f"{file.path}: can't be read at byte 2: Input/output error"
