"""Places of samples on the grid: limits for missing, doubled and wrong stamps and for clock resets."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal.arrays import IntArray
from imucal.clock import Segment
from imucal.readers.clocks import estimate_period, placing
from imucal.readers.clocks.evened import evened
from imucal.readers.clocks.from_stamps import _believable, _filled, _segments
from imucal.readers.clocks.period import Period
from imucal.readers.clocks.placing import (
    NO_BREAKS,
    Breaks,
    _extreme,
    _lowest_after,
    find_breaks,
    fit_period,
    step_statistics,
)

TAU = 1000
EVEN = np.arange(200, dtype=np.int64) * TAU
NONE = np.zeros(0, dtype=np.int64)
PERIOD = Period(tau_ns=float(TAU), jitter=0.0, burst=1, resolution_ns=1)


def late(at: int, by: int) -> IntArray:
    """Return even stamps that are later by `by` from sample `at` on."""
    return EVEN + (np.arange(EVEN.size) >= at) * by


@pytest.mark.parametrize("block", [1 << 16, 64])
@pytest.mark.parametrize(
    ("stamps", "expected"),
    [
        (EVEN, (0, 0, [], True)),
        (EVEN[:1], (0, 0, [], True)),
        # Steps within half a period of the expected one are even; a nanosecond more is not.
        (late(100, -500), (0, 0, [], True)),
        (late(100, -501), (0, 0, [], False)),
        (late(100, 500), (0, 0, [], True)),
        (late(100, 501), (0, 0, [], False)),
        (late(100, -1000), (1, 0, [], False)),
        # A step back of less than half a period is jitter.
        (late(100, -1001), (0, 1, [], False)),
        (late(100, -1500), (0, 1, [], False)),
        (late(100, -10_000), (0, 1, [100], False)),
        (late(2, -10_000), (0, 1, [2], False)),
        (late(198, -10_000), (0, 1, [198], False)),
        (late(199, -10_000), (0, 1, [199], False)),
        (late(100, -10_000) - (np.arange(200) > 100) * 600, (0, 1, [100], False)),
        # A clock that is set back by five samples has caught up after five.
        (late(100, -5_000), (0, 1, [], False)),
        (late(100, -5_001), (0, 1, [100], False)),
        # A single wrong stamp is no reset.
        (late(100, 50_000) - (np.arange(200) > 100) * 50_000, (0, 1, [], False)),
        (late(64, -10_000) + (np.arange(200) >= 128) * -10_000, (0, 2, [64, 128], False)),
    ],
)
def test_steps_are_classified_the_same_in_blocks_of_any_size(
    stamps: IntArray,
    expected: tuple[int, int, list[int], bool],
    block: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Steps are equal, out of order, or permanent resets of the clock."""
    monkeypatch.setattr(placing, "BLOCK", block)
    found = step_statistics(stamps, float(TAU))
    assert (found.same, found.back, found.resets.tolist(), found.even) == expected


@pytest.mark.parametrize("block", [1 << 16, 32])
@pytest.mark.parametrize(
    ("stamps", "expected"),
    [
        (EVEN, [[], [], []]),
        (late(100, 500), [[], [], []]),
        (late(100, 501), [[100], [1], []]),
        (late(100, 1499), [[100], [1], []]),
        (late(100, 1501), [[100], [2], []]),
        (late(1, 7000), [[1], [7], []]),
        (late(199, 7000), [[199], [7], []]),
        (late(50, 3000) + (np.arange(200) >= 150) * 2000, [[50, 150], [3, 2], []]),
        (late(100, -500), [[], [], []]),
        (late(100, -501), [[], [], [100]]),
        (late(100, -1000), [[], [], [100]]),
        (late(50, -1000) + (np.arange(200) >= 150) * -1000, [[], [], [50, 150]]),
        (late(50, 1000) + (np.arange(200) >= 150) * -1000, [[50], [1], [150]]),
        # One stamp is late; the next one is on time.
        (EVEN + (np.arange(200) == 100) * 900, [[], [], []]),
        (EVEN - (np.arange(200) == 100) * 900, [[], [], []]),
    ],
)
def test_a_permanent_shift_of_half_a_period_is_a_break(
    stamps: IntArray,
    expected: list[list[int]],
    block: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The result does not depend on the size of the blocks."""
    monkeypatch.setattr(placing, "BLOCK", block)
    monkeypatch.setattr(placing, "REACH", min(block, 1 << 13))
    found = find_breaks(stamps, PERIOD)
    assert [found.at.tolist(), found.missing.tolist(), found.doubled.tolist()] == expected


@pytest.mark.parametrize(
    ("jitter", "early", "by", "missing"),
    [
        (0.08, 300, 1230, 1),
        (0.089, 300, 1230, 1),
        (0.091, 300, 1230, 2),
        # The allowance for jitter is at most 0.3 samples.
        (0.2, 300, 1210, 2),
        (0.2, 330, 1190, 1),
    ],
)
def test_jitter_hides_some_missing_samples(jitter: float, early: int, by: int, missing: int) -> None:
    """A gap after an early stamp looks too long, so three times the jitter is subtracted."""
    stamps = late(100, by)
    stamps[99] -= early
    found = find_breaks(stamps, Period(tau_ns=float(TAU), jitter=jitter, burst=1, resolution_ns=1))
    assert (found.at.tolist(), found.missing.tolist()) == ([100], [missing])


@pytest.mark.parametrize(("lost", "missing"), [(1, []), (2, [3]), (3, [4]), (6, [7])])
def test_gaps_between_bursts_are_accurate_to_one_sample(lost: int, missing: list[int]) -> None:
    """Samples arrive in threes, so a stamp may be one sample late."""
    stamps = np.repeat(np.arange(100, dtype=np.int64) * 3 * TAU, 3)
    stamps[150:] += lost * TAU
    period = Period(tau_ns=float(TAU), burst=3, pause_ns=1.5 * TAU, loose=1.0)
    evenly = evened(stamps, period)
    assert np.diff(evenly[:150]).tolist() == [TAU] * 149
    found = find_breaks(evenly, period)
    assert found.doubled.tolist() == []
    assert found.at.tolist() == [150] * len(missing)
    assert [size - lost in {0, 1} for size in found.missing.tolist()] == [True] * len(missing)


def test_running_extremes_exclude_the_current_value() -> None:
    x = np.array([5.0, 1.0, 4.0, 2.0, 3.0, 0.0])
    for width in range(1, 6):
        for better, best in ((np.maximum, max), (np.minimum, min)):
            expected = [x[0], *(best(x[max(i - width, 0) : i]) for i in range(1, x.size))]
            assert _extreme(x, better, width).tolist() == expected


def test_the_minimum_covers_a_power_of_two_of_values() -> None:
    """The number of values is rounded up to a power of two; the range ends with the data."""
    x = np.array([5.0, 4.0, 6.0, 2.0, 3.0, 0.0])
    reach = [0, 1, 2, 3, 4, 5]
    found = [_lowest_after(x, np.array([0]), np.array([n])).tolist() for n in reach]
    assert found == [[5.0], [5.0], [4.0], [2.0], [2.0], [0.0]]
    assert _lowest_after(x, np.array([1, 4]), np.array([1, 9])).tolist() == [4.0, 0.0]


def test_short_gaps_contribute_to_the_period() -> None:
    """Longer gaps, doubled samples and resets start a new run."""
    true = np.arange(400, dtype=np.int64) * 1010
    kept = np.delete(true, [*range(100, 103), *range(200, 260)])
    breaks = Breaks(at=np.array([100, 197]), missing=np.array([3, 60]), doubled=NONE)
    for longest in (2, 3, 59, 60):
        assert fit_period(kept, 1000.0, breaks, NONE, longest=longest) == pytest.approx(
            (1010.0, 0.0), abs=1e-4
        )
    # A wrong size of the longer gap matters only if `longest` includes the gap.
    wrong = Breaks(at=breaks.at, missing=np.array([3, 50]), doubled=NONE)
    assert fit_period(kept, 1000.0, wrong, NONE, longest=49)[0] == pytest.approx(1010.0)
    assert fit_period(kept, 1000.0, wrong, NONE, longest=50)[0] > 1020
    reset = np.where(np.arange(400) < 150, true, true - 90_000)
    assert fit_period(reset, 1000.0, NO_BREAKS, np.array([150]), longest=10)[0] == pytest.approx(1010.0)
    doubled = np.insert(true, 77, true[77])
    again = Breaks(at=NONE, missing=NONE, doubled=np.array([78]))
    assert fit_period(doubled, 1000.0, again, NONE, longest=10)[0] == pytest.approx(1010.0)


def test_the_jitter_is_the_standard_deviation_of_the_residuals() -> None:
    """The degrees of freedom are samples minus runs; a single sample has no deviation."""
    stamps = EVEN + np.where(np.arange(200) % 2, 30, -30)
    tau, jitter = fit_period(stamps, 1000.0, NO_BREAKS, NONE, longest=10)
    assert tau == pytest.approx(1000.0, abs=0.01)
    assert jitter == pytest.approx(30 * np.sqrt(200 / 199), rel=1e-4)
    assert fit_period(EVEN[:2], 990.0, NO_BREAKS, NONE, longest=10) == (1000.0, 0.0)
    assert fit_period(EVEN[:1], 1000.0, NO_BREAKS, NONE, longest=10) == (1000.0, 0.0)


def test_an_outlier_stamp_has_no_weight() -> None:
    """One outlier among 200 stamps changes neither the period nor the jitter."""
    stamps = EVEN + np.where(np.arange(200) % 2, 30, -30)
    expected = fit_period(stamps, 1000.0, NO_BREAKS, NONE, longest=10)
    for by in (10**9, -(10**9)):
        wrong = stamps + (np.arange(200) == 20) * by
        assert fit_period(wrong, 1000.0, NO_BREAKS, NONE, longest=10) == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize(
    ("stamps", "filled"),
    [
        ([10, 0, 30], [10, 20, 30]),
        ([0, 20, 30, 0, 0], [10, 20, 30, 40, 50]),
        ([10, 0, 0, 40, 60], [10, 20, 30, 40, 60]),
        ([0, 7, 0], [7, 7, 7]),
        ([0, 10, 30], [-10, 10, 30]),
    ],
)
def test_zero_stamps_are_interpolated(stamps: list[int], filled: list[int]) -> None:
    """At both ends they are extrapolated with the period."""
    assert _filled(np.array(stamps, dtype=np.int64)).tolist() == filled


DAY = 86_400 * 10**9


@pytest.mark.parametrize(
    ("step", "missing", "log_step", "expected"),
    [
        # Without log time: the limits are one day and ten times the duration of the log.
        (DAY, 1000, None, None),
        (DAY + 1, 1000, None, 1),
        (DAY + 1, 9, None, None),
        (DAY + 1, 10, None, 1),
        # With log time: the limits are half of the stamps' step and one second.
        (10**9 + 1, 100, 50 * TAU, 49),
        (10**9, 100, 50 * TAU, None),
        (10**9 + 1, 100, 51 * TAU, None),
        (10**9 + 1, 100, TAU, 1),
        (10**9 + 1, 9, TAU, None),
        (DAY + 1, 100, 101 * TAU, None),
    ],
)
def test_a_step_of_the_stamps_is_a_gap_unless_the_clock_was_set(
    step: int, missing: int, log_step: int | None, expected: int | None
) -> None:
    """The clock was set if the log time, or an implausible duration, contradicts the step."""
    stamps = late(100, step - TAU)
    log = None if log_step is None else late(100, log_step - TAU)
    breaks = Breaks(at=np.array([100]), missing=np.array([missing]), doubled=NONE)
    found, jumps = _believable(stamps, log, breaks, NONE, float(TAU))
    assert found.tolist() == [missing if expected is None else expected]
    assert jumps == ({} if expected is None else {100: expected})
    npt.assert_array_equal(breaks.missing, [missing])


def test_a_long_log_can_have_long_gaps() -> None:
    """The limit is ten times the duration of the log if that is more than a day."""
    tau = float(DAY)
    breaks = Breaks(at=np.array([2]), missing=np.array([29]), doubled=NONE)
    for more, wrong in ((0, False), (1, True)):
        stamps = np.array([0, 1, 31], dtype=np.int64) * DAY + np.array([0, 0, more])
        assert _believable(stamps, None, breaks, NONE, tau)[1] == ({2: 1} if wrong else {})


def test_log_time_gives_the_missing_samples_at_a_reset() -> None:
    """Without log time, exactly one sample is missing; with it, at least one."""
    reset = np.array([100])
    assert _believable(EVEN, None, NO_BREAKS, reset, float(TAU))[1] == {100: 1}
    assert _believable(EVEN, EVEN, NO_BREAKS, reset, float(TAU))[1] == {100: 1}
    assert _believable(EVEN, late(100, 4 * TAU), NO_BREAKS, reset, float(TAU))[1] == {100: 4}


def test_segments_are_between_breaks() -> None:
    """A segment counts the kept samples; its offset counts all samples of the grid."""
    breaks = Breaks(at=np.array([3, 8]), missing=np.array([2, 5]), doubled=np.array([6, 1]))
    assert _segments(12, breaks, breaks.missing, {10: 4}) == (
        Segment(start=0, stop=2, offset=0),
        Segment(start=2, stop=6, offset=4),
        Segment(start=6, stop=8, offset=13),
        Segment(start=8, stop=10, offset=19),
    )
    # A doubled sample right after a break leaves an empty segment, which is omitted.
    one = Breaks(at=np.array([1, 2]), missing=np.array([3, 4]), doubled=np.array([1]))
    assert _segments(3, one, one.missing, {}) == (
        Segment(start=0, stop=1, offset=0),
        Segment(start=1, stop=2, offset=8),
    )


def test_stretches_between_clock_settings_are_searched_separately() -> None:
    """A setting is no break, and the found places refer to the complete log."""
    first = late(50, 3000)
    second = late(150, -1000) - 10**9
    both = np.concatenate([first, second])
    found = find_breaks(both, PERIOD, np.array([200]))
    assert [found.at.tolist(), found.missing.tolist(), found.doubled.tolist()] == [[50], [3], [350]]


@pytest.mark.parametrize("longest", [2, 3])
def test_a_period_is_the_slope_of_the_stamps(longest: int) -> None:
    """Gaps of up to `longest` samples have their known size; longer ones start a new level."""
    places = np.arange(200) + 3 * (np.arange(200) >= 50)
    stamps = np.round(places * 1003.5).astype(np.int64)
    breaks = Breaks(at=np.array([50]), missing=np.array([3]), doubled=NONE)
    tau, deviation = fit_period(stamps, float(TAU), breaks, NONE, longest=longest)
    assert tau == pytest.approx(1003.5, abs=1e-2)
    assert deviation < 1
    shifted = stamps + 400 * (np.arange(200) >= 50)
    free, _ = fit_period(shifted, float(TAU), breaks, NONE, longest=longest)
    assert (abs(free - 1003.5) < 1e-2) == (longest == 2)


@pytest.mark.parametrize("step", [-500_000_000, 0])
def test_batches_with_constant_or_decreasing_stamps_have_no_period(step: int) -> None:
    """Damaged files can contain such stamps."""
    starts = step * np.repeat(np.arange(20), 10)
    stamps = starts + 1_000_000 * np.tile(np.arange(10), 20)
    period = estimate_period(stamps)
    assert period is None or period.tau_ns > 0
