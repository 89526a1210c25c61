"""The checksum of chunks equals that of zlib, and a faster package is used if it is installed."""

import subprocess
import sys
import zlib
from importlib.util import find_spec

import numpy as np
import pytest

from imucal.readers.compression import check_crc, crc32
from imucal.readers.files import DamagedError

#: Code that runs without the fast package.
WITHOUT = """
import sys, zlib
sys.modules["zlib_ng"] = None
from imucal.readers.compression import crc32
assert crc32 is zlib.crc32
"""


@pytest.mark.parametrize("size", [0, 1, 7, 8, 15, 16, 63, 64, 65, 255, 4096, 5120, 5121, 1_000_003])
def test_the_checksum_equals_that_of_zlib(size: int) -> None:
    """The data can have any length and offset, and the checksum can be continued."""
    data = np.random.default_rng(size + 20261122).integers(0, 256, size + 3, dtype=np.uint8).tobytes()
    for first in range(4):
        part = memoryview(data)[first : first + size]
        assert crc32(part) == zlib.crc32(part)
        assert crc32(part, crc32(b"before")) == zlib.crc32(b"before" + bytes(part))


def test_the_checksum_has_the_published_check_value() -> None:
    """The value is that of CRC-32/ISO-HDLC.

    Source: Williams, A painless guide to CRC error detection, 1993.
    """
    assert crc32(b"123456789") == 0xCBF43926


def test_a_flipped_bit_is_detected_and_a_checksum_of_zero_is_ignored() -> None:
    """Zero means that no checksum was stored."""
    data = bytearray(range(200))
    right = zlib.crc32(data)
    check_crc(memoryview(data), right)
    for bit in (0, 799, 1599):
        data[bit // 8] ^= 1 << bit % 8
        with pytest.raises(DamagedError, match="checksum"):
            check_crc(memoryview(data), right)
        check_crc(memoryview(data), 0)
        data[bit // 8] ^= 1 << bit % 8


def test_zlib_replaces_a_missing_fast_package() -> None:
    """The fast package does not exist for every processor."""
    subprocess.run([sys.executable, "-c", WITHOUT], check=True)  # noqa: S603 - our own text


@pytest.mark.skipif(find_spec("zlib_ng") is None, reason="no wheel for this processor")
def test_the_fast_package_is_used_if_installed() -> None:
    assert crc32 is not zlib.crc32
