"""Times of tables in ns: limits for wraps, midnight, and rates that determine a unit."""

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.readers.tables.dates import DAY, NO_STAMP, parse_texts
from imucal.readers.tables.stamps import (
    infer_time_unit,
    rolled,
    to_ns,
    typical_step,
    unwrapped,
)

SECOND = 10**9


def times(step: float, start: float = 0.0) -> FloatArray:
    return start + step * np.arange(10.0)


@pytest.mark.parametrize(
    ("step", "fits"),
    [
        # The limits are 1 Hz and 20 kHz, with a tolerance of two percent.
        (1.0, ("s", "ms")),
        (1.02, ("s", "ms")),
        (1.03, ("ms",)),
        (50.0, ("ms", "us")),
        (49.1, ("ms", "us")),
        (48.9, ("ms",)),
        (0.0001, ("s",)),
        (0.00001, ()),
        (1e10, ()),
    ],
)
def test_a_unit_that_gives_the_rate_of_an_imu_is_used(step: float, fits: tuple[str, ...]) -> None:
    """If several units fit, none is used."""
    unit, found = infer_time_unit(times(step))
    assert sorted(found) == sorted(fits)
    assert unit == (fits[0] if len(fits) == 1 else None)


@pytest.mark.parametrize(
    ("start", "unit"), [(0.9e15, None), (1.1e15, "us"), (3.9e15, "us"), (4.1e15, None), (1.1e12, "ms")]
)
def test_a_time_since_1970_determines_its_unit(start: float, unit: str | None) -> None:
    """The time must be between 2001 and 2096, and the step fits several units."""
    assert infer_time_unit(times(100.0, start))[0] == unit


@pytest.mark.parametrize(
    ("values", "step"),
    [
        ([0, 1, 2, 3], 1.0),
        ([5, 5, 5], 0.0),
        ([3, 2, 1], 0.0),
        ([], 0.0),
        # Stamps repeat, so the mean step is used.
        ([0, 0, 0, 3], 1.0),
        ([0, 0, 0, 0, 0, 10], 2.0),
        ([*np.repeat(np.arange(40), 25)], 1 / 25),
        # A buffer of 25 samples is read every 250 ms, with stamps 1 ms apart.
        ([250 * (k // 25) + k % 25 for k in range(2000)], 10.0),
        # The same in s; without a known unit, steps within a batch can't be recognised.
        ([0.25 * (k // 25) + 0.001 * (k % 25) for k in range(2000)], 0.01),
    ],
)
def test_the_typical_step_is_the_sampling_period(values: list[float], step: float) -> None:
    """If the clock is ambiguous, it is the mean step."""
    assert typical_step(np.array(values)) == pytest.approx(step, rel=0.02)


@pytest.mark.parametrize(
    ("counts", "turns"),
    [
        ([250, 253, 0, 3], 1),
        ([250, 255, 0], 1),
        ([250, 256, 0], 0),
        ([65_000, 65_500, 10, 500], 1),
        ([20_000, 20_001, 20_000], 0),
        ([-1, 250, 3], 0),
        ([7], 0),
        ([1, 2, 3], 0),
        ([250, 253, 1, 128, 255, 2], 2),
        # At the wrap, a hundred steps or 1/64 of the range may be missing.
        ([65_534, 65_535, 1_023], 1),
        ([65_534, 65_535, 1_024], 0),
        ([65_515, 65_535, 1_999], 1),
        ([65_515, 65_535, 2_000], 0),
    ],
)
def test_a_counter_wraps_from_the_end_to_the_start_of_its_range(counts: list[int], turns: int) -> None:
    values, found = unwrapped(np.array(counts, dtype=np.int64))
    assert found == turns
    if turns == 0:
        assert values.tolist() == counts
    else:
        assert (np.diff(values) > 0).all()
        assert set((values - counts) % 256) == {0}


@pytest.mark.parametrize(
    ("stamps", "expected"),
    [
        ([DAY - 1, 0, 1], [DAY - 1, DAY, DAY + 1]),
        ([DAY - 1, DAY // 2 - 1], [DAY - 1, DAY // 2 - 1]),
        ([DAY - 1, DAY // 2 - 2], [DAY - 1, DAY + DAY // 2 - 2]),
        ([DAY, 0], [DAY, 0]),
        ([-1, 5], [-1, 5]),
        ([], []),
        ([DAY - 1, 0, DAY - 1, 5], [DAY - 1, DAY, 2 * DAY - 1, 2 * DAY + 5]),
    ],
)
def test_a_time_of_day_that_falls_by_half_a_day_is_the_next_day(
    stamps: list[int], expected: list[int]
) -> None:
    assert rolled(np.array(stamps, dtype=np.int64), DAY).tolist() == expected


@pytest.mark.parametrize(
    ("cell", "ns"),
    [
        ("1970-01-01 02:30:00-0130", 4 * 3600 * SECOND),
        ("1970-01-01 02:30:00+01:30", 3600 * SECOND),
        ("01:02:03", 3723 * SECOND),
        ("'01:02:03.000000001999'", 3723 * SECOND + 1),
        ("1970-13-01 00:00:00", NO_STAMP),
    ],
)
def test_times_with_zones_are_parsed_to_ns(cell: str, ns: int) -> None:
    """Digits beyond ns are cut off."""
    assert parse_texts([cell]).tolist() == [ns]


def test_counts_beyond_int64_start_at_zero() -> None:
    """Integers are counted from their first value; floats become zero."""
    most = (1 << 62) // 1000
    assert to_ns(np.array([most, most - 1]), 1000).tolist() == [most * 1000, (most - 1) * 1000]
    assert to_ns(np.array([most + 1, most + 2]), 1000).tolist() == [0, 1000]
    assert to_ns(np.array([-most - 1, -most]), 1000).tolist() == [0, 1000]
    assert to_ns(np.array([1e30, 2.5]), 1000).tolist() == [0, 2500]


def test_a_repeated_count_is_not_a_wrap() -> None:
    """The steps are so large that a wrap could skip a complete period."""
    counts = np.array([0, 3, 6, 6, 9], dtype=np.int64)
    found, wraps = unwrapped(counts)
    assert (found.tolist(), wraps) == (counts.tolist(), 0)
    # The same count next to a wrap.
    found, wraps = unwrapped(np.array([250, 253, 253, 0, 3], dtype=np.int64))
    assert (found.tolist(), wraps) == ([250, 253, 253, 256, 259], 1)


@pytest.mark.parametrize(("still", "step"), [(10_000, 1.0), (20_000, 0.0)])
def test_the_first_times_determine_the_step(still: int, step: float) -> None:
    """Only the first 20 000 times count."""
    values = np.concatenate([np.zeros(still), np.arange(60_000.0)])
    assert typical_step(values) == step
