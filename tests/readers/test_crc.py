"""The checksum of chunks: that of zlib, at the speed of memory where its wheel is installed."""

import subprocess
import sys
import zlib
from importlib.util import find_spec

import numpy as np
import pytest

from imucal.readers.compression import check_crc, crc32
from imucal.readers.files import DamagedError

#: Run with the fast package hidden.
WITHOUT = """
import sys, zlib
sys.modules["zlib_ng"] = None
from imucal.readers.compression import crc32
assert crc32 is zlib.crc32
"""


@pytest.mark.parametrize("size", [0, 1, 7, 8, 15, 16, 63, 64, 65, 255, 4096, 5120, 5121, 1_000_003])
def test_it_is_that_of_zlib(size: int) -> None:
    """Of any length, at any place in a buffer, and carried on from another."""
    data = np.random.default_rng(size + 20261122).integers(0, 256, size + 3, dtype=np.uint8).tobytes()
    for first in range(4):
        part = memoryview(data)[first : first + size]
        assert crc32(part) == zlib.crc32(part)
        assert crc32(part, crc32(b"before")) == zlib.crc32(b"before" + bytes(part))


def test_the_published_value() -> None:
    """The check value of CRC-32/ISO-HDLC; source: Williams, A painless guide to CRC error detection, 1993."""
    assert crc32(b"123456789") == 0xCBF43926


def test_a_flipped_bit_is_seen_and_no_checksum_is_none() -> None:
    """Zero says that none was stored."""
    data = bytearray(range(200))
    right = zlib.crc32(data)
    check_crc(memoryview(data), right)
    for bit in (0, 799, 1599):
        data[bit // 8] ^= 1 << bit % 8
        with pytest.raises(DamagedError, match="checksum"):
            check_crc(memoryview(data), right)
        check_crc(memoryview(data), 0)
        data[bit // 8] ^= 1 << bit % 8


def test_zlib_takes_its_place_where_it_is_missing() -> None:
    """No processor is left without."""
    subprocess.run([sys.executable, "-c", WITHOUT], check=True)  # noqa: S603 - our own text


@pytest.mark.skipif(find_spec("zlib_ng") is None, reason="no wheel for this processor")
def test_the_fast_one_is_used_where_it_is() -> None:
    assert crc32 is not zlib.crc32
