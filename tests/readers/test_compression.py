"""Sizes that compressed chunks declare are compared with those of their containers."""

from pathlib import Path

import lz4.frame
import pytest
import zstandard

from imucal.errors import ReadError
from imucal.readers.compression import decompress, unpack_file
from imucal.readers.files import DamagedError
from tests.raising import raises

RAW = bytes(range(256)) * 40


def framed(data: bytes) -> memoryview:
    """Return an LZ4 frame whose header contains the size."""
    return memoryview(lz4.frame.compress(data, store_size=True))


def test_an_lz4_frame_larger_than_its_chunk_is_damaged() -> None:
    """The size is checked before unpacking, because a wrong size could use any amount of memory."""
    with pytest.raises(DamagedError, match=f"an lz4 frame states {len(RAW)} bytes, its chunk 100"):
        decompress("lz4", framed(RAW), 100)


def test_an_lz4_chunk_of_several_frames_is_joined() -> None:
    """Each frame declares fewer bytes than the chunk."""
    frames = memoryview(bytes(framed(RAW[:5000])) + bytes(framed(RAW[5000:])))
    assert bytes(decompress("lz4", frames, len(RAW))) == RAW


@pytest.mark.parametrize("stated", [True, False])
def test_a_file_that_unpacks_to_too_much_is_refused(stated: bool, tmp_path: Path) -> None:  # noqa: FBT001
    """A file of 200 kB could fill a disk; the head may state the size."""
    path = tmp_path / "log.db3.zstd"
    zeros = bytes((1 << 26) + 1)
    path.write_bytes(zstandard.ZstdCompressor(write_content_size=stated).compress(zeros))
    with (tmp_path / "log.db3").open("wb") as target:
        with raises(ReadError, "more than 67108864 bytes", place="log.db3.zstd"):
            unpack_file(path, target, lambda _: None)
        assert target.tell() <= (0 if stated else 1 << 26)
    path.write_bytes(zstandard.ZstdCompressor().compress(zeros[:-1]))
    with (tmp_path / "log.db3").open("wb") as target:
        unpack_file(path, target, lambda _: None)
        assert target.tell() == 1 << 26
