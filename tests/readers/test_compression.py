"""Sizes that compressed chunks declare are compared with those of their containers."""

import lz4.frame
import pytest

from imucal.readers.compression import decompress
from imucal.readers.files import DamagedError

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
