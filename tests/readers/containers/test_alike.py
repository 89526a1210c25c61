"""Records that must hold the same bytes: compared as words, with the answer of a loop over bytes."""

import numpy as np
import pytest
from numpy.typing import NDArray

from imucal.readers.containers import Alike
from imucal.readers.containers.container import Guard


def by_hand(records: list[bytes], guards: list[Guard]) -> list[bool]:
    return [all(data[at : at + len(part)] == part for at, part in guards) for data in records]


def gathered(records: list[bytes], width: int) -> NDArray[np.void]:
    return np.frombuffer(bytearray(b"".join(records)), f"V{width}")


@pytest.mark.parametrize("width", [1, 2, 3, 4, 6, 8, 12, 20, 31, 48, 80])
def test_it_finds_what_a_loop_over_bytes_finds(width: int) -> None:
    """Where guards overlap no word, cross words, or cover all; few values, so that many are alike."""
    rng = np.random.default_rng([20261122, width])
    for _ in range(20):
        data = rng.integers(0, 2, (40, width), dtype=np.uint8)
        data[rng.random(40) < 0.5] = data[0]
        guards: list[Guard] = []
        at = 0
        while at < width:
            size = int(rng.integers(1, width - at + 1))
            if rng.random() < 0.7:
                guards.append((at, data[0, at : at + size].tobytes()))
            at += size
        alike, expected = Alike(guards, width), by_hand([row.tobytes() for row in data], guards)
        records = gathered([row.tobytes() for row in data], width)
        assert alike.each(records).tolist() == expected
        right = records[expected]
        assert alike.each(right[:1]).all()
        assert alike.all(records) == all(expected)
        assert alike.all(right)


def test_one_bit_is_enough() -> None:
    """In any guarded byte, and in no other."""
    alike = Alike([(1, b"abc"), (9, b"defghijk")], 24)
    good = bytes(1) + b"abc" + bytes(5) + b"defghijk" + bytes(7)
    for place in range(24):
        for bit in range(8):
            other = bytearray(good)
            other[place] ^= 1 << bit
            guarded = 1 <= place < 4 or 9 <= place < 17
            assert alike.all(gathered([good, bytes(other)], 24)) != guarded
            assert alike.each(gathered([good, bytes(other)], 24)).tolist() == [True, not guarded]


def test_no_guard_is_kept_by_all_and_no_record_breaks_any() -> None:
    """Also after more records than ever before, and fewer again."""
    alike = Alike([(0, b"x")], 8)
    for n in (3, 1000, 0, 7):
        assert alike.all(gathered([b"x" + bytes(7)] * n, 8))
        assert alike.each(gathered([b"y" + bytes(7)] * n, 8)).tolist() == [False] * n
    assert Alike([], 8).all(gathered([b"y" + bytes(7)], 8))
