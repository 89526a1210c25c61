"""Arrays in memory and in temporary files, processed in blocks of any size, are equal."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.testing as npt
import pytest

from imucal import arrays
from imucal.arrays import IntArray, blocks, release
from imucal.errors import ReadError
from imucal.readers.clocks.from_stamps import _filled
from imucal.readers.message_samples import steps_back, unsorted
from imucal.readers.store import Room, copy_to, count, equal, extremes, is_constant
from imucal.readers.tables.dates import DAY
from imucal.readers.tables.stamps import pair_stamps, rolled, to_ns, unwrapped

pytestmark = pytest.mark.usefixtures("block_size")

RNG = np.random.default_rng(2026)
VALUES = RNG.integers(-1000, 1000, 500)
KEEP = RNG.random(500) < 0.3


@pytest.fixture(params=[1 << 18, 1, 7, 500])
def block_size(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Process arrays in blocks of this many values."""
    monkeypatch.setattr(arrays, "BLOCK", request.param)
    monkeypatch.setattr(arrays, "_HELD", 20)


@pytest.fixture(params=[None, 0])
def room(request: pytest.FixtureRequest) -> Room:
    return Room(request.param)


def test_arrays_equal_those_of_numpy(room: Room) -> None:
    """NumPy processes each array at once."""
    npt.assert_array_equal(room.copied(VALUES), VALUES)
    order = RNG.permutation(500)[:300]
    npt.assert_array_equal(room.taken(VALUES, order), VALUES[order])
    npt.assert_array_equal(room.chosen(VALUES, KEEP), VALUES[KEEP])
    npt.assert_array_equal(room.places(KEEP), np.flatnonzero(KEEP))
    assert count(KEEP) == np.count_nonzero(KEEP)
    assert extremes(VALUES) == (VALUES.min(), VALUES.max())
    assert room.empty(0, np.int64).size == 0
    other = room.copied(VALUES)
    assert equal(VALUES, other)
    other[499] += 1
    assert not equal(VALUES, other)


def test_a_large_array_is_in_a_temporary_file() -> None:
    """The limit is a sixteenth of the memory limit; values survive the release of their pages."""
    small, large = Room(16 * 800).empty(100, np.float64), Room(16 * 800).empty(101, np.float64)
    assert small.flags.owndata
    assert not large.flags.owndata
    large[:] = np.arange(101)
    release(large, large[3:], small)
    npt.assert_array_equal(large, np.arange(101))


def test_pages_of_mapped_arrays_are_released_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages are released after each block and at the end."""
    seen: list[int] = []
    monkeypatch.setattr(arrays, "_hand_back", lambda held: seen.extend(map(len, held)))
    held = Room(0).empty(100, np.float64)
    parts = list(blocks(100, held, held[50:], np.zeros(100), size=10))
    assert parts == [slice(i, i + 10) for i in range(0, 100, 10)]
    assert seen == [800] * 6
    assert list(blocks(0, held)) == []


def test_a_full_disk_is_reported_before_writing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error contains the folder and the required size."""

    def full(*_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("imucal.readers.store.os.posix_fallocate", full)
    with pytest.raises(ReadError, match=r"8\.0 GB of samples: No space left on device"):
        Room(0).empty(10**9, np.float64)


def test_copies_of_overlapping_parts() -> None:
    """The copy moves values towards the start, as if samples were removed."""
    for shift in (1, 3, 100):
        values = np.arange(500)
        copy_to(values[: 500 - shift], values[shift:])
        npt.assert_array_equal(values[: 500 - shift], np.arange(shift, 500))


@pytest.mark.parametrize(("changed", "constant"), [([], True), ([0], False), ([499], False)])
@pytest.mark.parametrize("value", [3.0, np.nan])
def test_constant_rows_are_found(changed: list[int], value: float, *, constant: bool) -> None:
    """The value can be anything, including NaN."""
    rows = np.full((2, 500), value)
    rows[1, changed] = 7.0
    assert is_constant(rows) is constant


def wraps(values: IntArray, period: int) -> IntArray:
    """Return an unwrapped counter by its definition: add a period at each step back."""
    turns, result = 0, []
    for before, value in zip([values[0], *values], values, strict=False):
        turns += int(value < before)
        result.append(int(value) + turns * period)
    return np.array(result)


def test_counters_and_times_of_day_are_unwrapped(room: Room) -> None:
    """A wrap can be anywhere, including the end of a block."""
    counts = np.arange(37, 537) % 256
    found, times = unwrapped(counts, room)
    assert times == 2
    npt.assert_array_equal(found, wraps(counts, 256))
    day = (np.arange(500) * (DAY // 100) + DAY // 3) % DAY
    npt.assert_array_equal(rolled(day, DAY, room), wraps(day, DAY))


@pytest.mark.parametrize(
    "made",
    [
        lambda room: to_ns(VALUES, 1000, room),
        lambda room: to_ns(VALUES / 7, 10**9, room),
        lambda room: to_ns(VALUES + (1 << 61), 1000, room),
        lambda room: pair_stamps(np.arange(500), VALUES + 1000, 1, room),
        lambda room: _filled(np.where(KEEP, 0, np.arange(500) ** 2), room),
        lambda room: _filled(np.where(np.arange(500) % 490 < 6, 0, np.arange(500) * 3), room),
    ],
)
def test_stamps_do_not_depend_on_blocks(made: Callable[[Room], Any], room: Room) -> None:
    """Results in files and in small blocks equal those of one block in memory."""
    mapped_block, arrays.BLOCK = arrays.BLOCK, 1 << 18
    expected = made(Room())
    arrays.BLOCK = mapped_block
    npt.assert_array_equal(made(room), expected)


def logs() -> Iterator[IntArray]:
    """Yield increasing, locally disordered, two-part, decreasing and repeated times."""
    rng = np.random.default_rng(77)
    even = np.arange(300)
    yield even
    yield even + rng.integers(0, 4, 300)
    yield np.where(rng.random(300) < 0.02, even - 9, even)
    yield np.concatenate([even[::2], even[1::2]])
    yield even[::-1].copy()
    yield even // 5
    yield np.concatenate([even[:100] + 3, even[100:]])
    yield even[:1]


@pytest.mark.parametrize("times", list(logs()))
def test_only_disordered_parts_are_sorted(times: IntArray) -> None:
    """Sorting these parts gives the same order as a stable sort of all values."""
    order = np.arange(times.size)
    end = 0
    for start, stop in unsorted(times):
        assert start >= end
        assert stop - start > 1
        assert np.any(np.diff(times[start:stop]) < 0)
        # The part can't be divided into smaller ones.
        highest = np.maximum.accumulate(times)
        lowest = np.minimum.accumulate(times[::-1])[::-1]
        assert all(highest[k - 1] > lowest[k] for k in range(start + 1, stop))
        order[start:stop] = start + np.argsort(times[start:stop], kind="stable")
        end = stop
    npt.assert_array_equal(order, np.argsort(times, kind="stable"))
    assert steps_back(times) == np.count_nonzero(np.diff(times) < 0)
