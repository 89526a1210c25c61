"""Clocks from stamps with the faults of real logs: the rate is right and the finding names the fault."""

import re

import numpy as np
import numpy.testing as npt
import pytest

from imucal.arrays import FloatArray, IntArray
from imucal.errors import ChoiceError, DataError
from imucal.readers.clocks import repeats
from imucal.readers.clocks.from_stamps import ClockReading, clock_from_stamps
from tests.raising import raises

N = 20_000
TAU = 5_000_000
START = 1_700_000_000_000_000_000
PLACE = np.arange(N, dtype=np.int64)
EVEN = START + PLACE * TAU


def read(stamps: IntArray, log: IntArray | None = None, rate: float | None = None) -> ClockReading:
    """Return the clock of stamps, which are rounded to ns."""
    rounded = np.round(stamps).astype(np.int64) if stamps.dtype != np.int64 else stamps
    return clock_from_stamps(rounded, source="header stamp", log_ns=log, rate_hz=rate)


def codes(reading: ClockReading) -> list[str]:
    """Return the codes of the findings."""
    return [finding.code for finding in reading.findings]


def shifted(by: FloatArray) -> IntArray:
    """Return even stamps with an offset in whole ns added."""
    return EVEN + by.astype(np.int64)


def test_even_stamps_are_one_segment() -> None:
    """Even stamps cause no finding."""
    reading = read(EVEN)
    assert reading.clock.rate_hz == pytest.approx(200, rel=1e-12)
    assert [(s.start, s.stop, s.offset) for s in reading.clock.segments] == [(0, N, 0)]
    assert reading.clock.start_ns == START
    assert reading.clock.jitter_s == pytest.approx(0, abs=1e-12)
    assert reading.order is None
    assert reading.findings == ()


@pytest.mark.parametrize("share", [0.001, 0.05, 0.2, 0.5])
def test_jitter_changes_neither_rate_nor_gaps(share: float) -> None:
    """The jitter is white, up to half a period; its standard deviation is measured."""
    jitter = np.random.default_rng(1).normal(0, share * TAU, N)
    reading = read(shifted(jitter))
    # The slope of least squares over n samples has the error sigma sqrt(12) / n^1.5 periods; times four.
    tolerance = 4 * share * np.sqrt(12) / N**1.5
    assert reading.clock.rate_hz == pytest.approx(200, rel=max(tolerance, 1e-12))
    assert reading.clock.missing == 0
    assert reading.clock.n == N
    # The relative standard error of a standard deviation of n values is 1 / sqrt(2 n).
    assert reading.clock.jitter_s == pytest.approx(share * TAU / 1e9, rel=4 / np.sqrt(2 * N))


@pytest.mark.parametrize("jitter", [0.0, 0.02, 0.1])
def test_gaps_are_found_at_their_places(jitter: float) -> None:
    """The gaps have 100, 1 and 2 samples."""
    noise = np.random.default_rng(2).normal(0, jitter * TAU, N)
    kept = np.delete(shifted(noise), [*range(1000, 1100), 5000, 9000, 9001])
    reading = read(kept)
    assert reading.clock.rate_hz == pytest.approx(200, rel=1e-6)
    assert [gap.missing for gap in reading.clock.gaps] == [100, 1, 2]
    npt.assert_allclose([gap.start_s for gap in reading.clock.gaps], [5.0, 25.0, 45.0], rtol=1e-6)
    assert [s.size for s in reading.clock.segments] == [1000, 3900, 3999, N - 9002]
    (finding,) = reading.findings
    assert finding.code == "gaps"
    assert finding.text.startswith("103 samples (0.0052 of all) are missing in 3 gaps; the longest is 0.5 s")


@pytest.mark.parametrize("share", [0.05, 0.3, 0.5])
@pytest.mark.parametrize("jitter", [0.0, 0.02])
def test_random_losses_do_not_lower_the_rate(share: float, jitter: float) -> None:
    """Even if half of the samples are lost, the period is the sensor's and all losses are counted."""
    rng = np.random.default_rng(3)
    kept = rng.random(N) > share
    kept[[0, -1]] = True
    reading = read(shifted(rng.normal(0, jitter * TAU, N))[kept])
    assert reading.clock.rate_hz == pytest.approx(200, rel=1e-4)
    assert reading.clock.missing == N - kept.sum()
    npt.assert_array_equal(reading.clock.grid(), np.flatnonzero(kept))


@pytest.mark.parametrize(("size", "inner"), [(5, 1_000_000), (10, 100_000), (5, 0), (20, 0), (2, 100_000)])
def test_bursts_are_spread_evenly(size: int, inner: int) -> None:
    """If samples arrive together the median step is wrong, but the rate is right."""
    stamps = START + PLACE // size * size * TAU + PLACE % size * inner
    reading = read(stamps)
    assert reading.clock.rate_hz == pytest.approx(200, rel=1e-5)
    assert len(reading.clock.segments) == 1
    assert reading.clock.n == N
    assert "bursts" in codes(reading)


def test_a_gap_between_bursts_is_found() -> None:
    """The gap is a thousand samples, accurate to one burst."""
    stamps = START + PLACE // 10 * 10 * TAU + PLACE % 10 * 100_000
    reading = read(np.delete(stamps, np.s_[8000:9000]))
    assert reading.clock.rate_hz == pytest.approx(200, rel=1e-4)
    (gap,) = reading.clock.gaps
    # The position of a sample within a burst is unknown.
    assert gap.missing == pytest.approx(1000, abs=10)


def test_a_stall_that_catches_up_is_not_a_gap() -> None:
    """Two hundred samples arrive late and at once, but none is missing."""
    stamps = EVEN.copy()
    stamps[3000:3200] = EVEN[3200] - np.arange(200)[::-1] * 10_000
    reading = read(stamps)
    assert reading.clock.n == N
    assert reading.clock.missing == 0


def test_samples_with_a_repeated_stamp_are_dropped() -> None:
    """A sample with the stamp of its predecessor has no place on the grid."""
    doubled = np.sort(np.random.default_rng(4).choice(np.arange(10, N, 40), 50, replace=False))
    stamps = np.insert(EVEN, doubled, EVEN[doubled])
    reading = read(stamps)
    assert reading.clock.n == N
    assert reading.clock.rate_hz == pytest.approx(200, rel=1e-9)
    assert reading.order is not None
    npt.assert_array_equal(stamps[reading.order], EVEN)
    assert "duplicate-stamps" in codes(reading)


def test_repeated_messages_are_read_once() -> None:
    """Every message is repeated; the reader passes the information that the values repeat too."""
    stamps = np.repeat(EVEN, 2)
    repeated = np.arange(2 * N) % 2 == 1
    reading = clock_from_stamps(stamps, source="header stamp", repeated=repeated)
    assert reading.clock.rate_hz == pytest.approx(200, rel=1e-9)
    npt.assert_array_equal(reading.order, np.arange(0, 2 * N, 2))
    assert codes(reading) == ["duplicate-stamps"]
    text = f"{N} of {2 * N} samples repeat the previous time stamp and values; they are dropped."
    assert reading.findings[0].text == text


@pytest.mark.parametrize("jump_s", [-3600, 3600, -0.5, 1.6e9])
def test_setting_the_clock_is_not_a_gap(jump_s: float) -> None:
    """The log time shows that no sample is missing. The two parts become two segments."""
    stamps = EVEN + (PLACE >= N // 2) * int(jump_s * 1e9)
    reading = read(stamps, EVEN + 1000)
    assert reading.clock.rate_hz == pytest.approx(200, rel=1e-9)
    assert [s.size for s in reading.clock.segments] == [N // 2, N // 2]
    assert reading.clock.missing == 1
    jump = next(finding for finding in reading.findings if finding.code == "clock-jump")
    assert f"once, at most by {jump_s + 0.005:+.6g} s at sample {N // 2}" in jump.text


def test_without_log_time_a_jump_of_years_is_not_a_gap() -> None:
    """The clock jumps from 1970 to the current time in the middle of the log."""
    reading = read(EVEN - START + TAU + (PLACE >= N // 2) * START)
    assert "clock-jump" in codes(reading)
    assert reading.clock.duration_s < 101


@pytest.mark.parametrize("value", [0, 5])
def test_constant_stamps_are_replaced_by_log_time(value: int) -> None:
    """The source of the clock and a finding report the replacement."""
    reading = read(np.full(N, value), EVEN)
    assert reading.clock.source == "log time"
    assert reading.clock.rate_hz == pytest.approx(200, rel=1e-12)
    assert codes(reading) == ["log-time-used"]
    what = "are all zero" if value == 0 else "are all the same"
    text = f"The time stamps (header stamp) {what}; the recording time of the messages is used instead."
    assert reading.findings[0].text == text


def test_two_percent_of_zero_stamps_switch_to_log_time() -> None:
    """The limit is one percent."""
    stamps = np.where(PLACE % 50 == 0, 0, EVEN)
    assert read(stamps, EVEN).clock.source == "log time"


def test_one_percent_of_zero_stamps_is_interpolated() -> None:
    """Above that share, the log time is used instead."""
    stamps = EVEN[:200].copy()
    stamps[[5, 6]] = 0
    assert codes(read(stamps, EVEN[:200])) == ["zero-stamps"]
    stamps[7] = 0
    assert codes(read(stamps, EVEN[:200])) == ["log-time-used"]


def test_decreasing_stamps_are_replaced_by_log_time() -> None:
    """A single sample has no direction and is refused."""
    reading = read(EVEN[:9][::-1], EVEN[:9])
    assert [note.text.partition(";")[0] for note in reading.findings] == [
        "The time stamps (header stamp) do not increase"
    ]
    assert reading.clock.rate_hz == pytest.approx(200)
    with raises(DataError, "one sample", argument="rate_hz"):
        read(EVEN[:1], EVEN[:1])


def test_single_zero_stamps_are_interpolated() -> None:
    """The samples with a stamp of zero are kept."""
    stamps = EVEN.copy()
    stamps[[0, 77]] = 0
    reading = read(stamps, EVEN)
    assert reading.clock.source == "header stamp"
    assert reading.clock.rate_hz == pytest.approx(200, rel=1e-7)
    assert reading.clock.missing == 0
    assert codes(reading) == ["zero-stamps"]


@pytest.mark.parametrize("offset", [1e12, -1e12, 1e18])
def test_a_single_wrong_stamp_changes_neither_rate_nor_places(offset: float) -> None:
    stamps = EVEN.copy()
    stamps[4000] += int(offset)
    reading = read(stamps)
    assert reading.clock.rate_hz == pytest.approx(200, rel=1e-6)
    assert reading.clock.missing == 0
    assert reading.clock.n == N


@pytest.mark.parametrize("rate", [200, 300, 400, 600, 700, 1000, 1600, 3200])
def test_millisecond_stamps_give_the_rate(rate: int) -> None:
    """Several samples can share one stamp in whole ms."""
    stamps = START + (PLACE * 1000 // rate) * 1_000_000
    reading = read(stamps)
    # The stamps are rounded to 1 ms; the rate averages over the complete log.
    assert reading.clock.rate_hz == pytest.approx(rate, rel=2e-6 * rate / 200)
    assert reading.clock.missing == 0
    assert reading.clock.n == N
    if 1000 % rate:
        assert "coarse-stamps" in codes(reading)


def test_swapped_stamps_keep_the_order_of_the_log() -> None:
    """Samples are not sorted by stamps, because stamps have jitter."""
    stamps = EVEN.copy()
    stamps[100::50], stamps[101::50] = EVEN[101::50], EVEN[100::50]
    reading = read(stamps)
    assert reading.order is None
    assert reading.clock.missing == 0
    assert codes(reading) == ["stamps-out-of-order"]


def test_a_throttled_topic_has_a_third_missing() -> None:
    """The topic contains two of three samples of a 200 Hz sensor, as would a clock with ticks of 5 ms."""
    stamps = EVEN[PLACE % 3 != 2]
    with raises(ChoiceError, "200 Hz with 33% of the samples missing, or 133.33", argument="rate_hz"):
        read(stamps)
    reading = read(stamps, rate=200.0)
    assert reading.clock.missing == len(EVEN[PLACE % 3 == 2]) - (N % 3 == 0)
    assert "rate-given" not in codes(reading)


def test_a_given_rate_is_used_and_a_wrong_one_reported() -> None:
    """The user's rate is used; the finding reports the rate of the stamps."""
    reading = read(EVEN, rate=100.0)
    assert reading.clock.rate_hz == 100.0
    assert (
        reading.findings[0].text
        == "The given rate, 100 Hz, differs from the rate of the time stamps, 200 Hz."
    )


def test_a_given_rate_replaces_missing_stamps() -> None:
    reading = read(np.zeros(10, dtype=np.int64), rate=50.0)
    assert reading.clock.rate_hz == 50.0
    assert reading.clock.source == "given rate"


@pytest.mark.parametrize("n", [2, 3, 10, 31])
def test_two_samples_give_a_rate(n: int) -> None:
    assert read(EVEN[:n]).clock.rate_hz == pytest.approx(200)


def test_stamps_without_a_rate_are_refused() -> None:
    """Cases: no sample, one sample, and constant stamps."""
    with pytest.raises(
        DataError, match=re.escape("no samples to take the header stamp of; expected at least two")
    ):
        read(EVEN[:0])
    message = "one sample (header stamp); expected increasing time stamps; give the sampling rate"
    with raises(DataError, re.escape(message), argument="rate_hz"):
        read(EVEN[:1])
    message = "9 samples whose time stamps do not increase (header stamp); expected increasing time stamps"
    with raises(DataError, re.escape(message), argument="rate_hz"):
        read(np.zeros(9, dtype=np.int64))


def test_random_stamps_are_refused() -> None:
    stamps = START + np.random.default_rng(5).integers(0, 10**15, N)
    with pytest.raises(DataError, match="expected a clock"):
        read(stamps)


def test_a_slow_drift_of_the_clock_is_not_a_gap() -> None:
    """The drift is 10 ppm over the log."""
    wander = np.cumsum(TAU * 1e-5 * np.sin(PLACE / 3000))
    reading = read(shifted(wander))
    assert reading.clock.missing == 0
    assert reading.clock.rate_hz == pytest.approx(200, rel=2e-5)


def test_gaps_are_found_in_logs_of_several_blocks() -> None:
    n = 300_000
    stamps = START + np.arange(n) * TAU + np.random.default_rng(6).normal(0, 0.05 * TAU, n).astype(np.int64)
    lost = [*range(65_530, 65_540), 131_072, 200_000]
    reading = read(np.delete(stamps, lost))
    assert [gap.missing for gap in reading.clock.gaps] == [10, 1, 1]


def test_a_repeated_sample_has_the_stamp_and_all_values_of_its_predecessor() -> None:
    """A stamp of zero is missing and proves no repetition."""
    stamps = np.array([1, 1, 2, 2, 3, 3, 0, 0])
    rows = np.array([[5.0, 5, 6, 6, 7, 7, 8, 8], [1.0, 1, 1, 2, 2, 2, 2, 2]])
    found = repeats(stamps, rows)
    assert found is not None
    assert np.flatnonzero(found).tolist() == [1, 5]
    assert repeats(stamps[1:5], rows[:, 1:5]) is None


@pytest.mark.parametrize("unit", [10**9, 10**6])
def test_stamps_that_most_samples_share_give_no_clock(unit: int) -> None:
    """Times since 1970 as float32 have steps of 128 s, in s or in ms: only 3 stamps for 24 000 samples."""
    seconds = 1.7e9 + np.arange(24_000) / 100
    rounded = (seconds * 1e9 / unit).astype(np.float32).astype(np.float64)
    stamps = (rounded * unit).astype(np.int64)
    distinct = np.unique(stamps).size
    with pytest.raises(ChoiceError) as caught:
        clock_from_stamps(stamps, source="column t")
    step = np.ptp(stamps) / 1e9 / (distinct - 1)
    assert str(caught.value) == (
        f"the 24000 samples have only {distinct} different time stamps (column t), {step:.4g} s apart, which "
        "is the resolution of float32; expected one per sample; save the times as float64, or give the "
        "sampling rate"
    )
    reading = clock_from_stamps(stamps, source="column t", rate_hz=100.0)
    assert (reading.clock.rate_hz, reading.clock.n, reading.order) == (100.0, 24_000, None)
    assert len(reading.clock.segments) == 1
    assert codes(reading) == ["time-unused"]


def _on_ticks(rng: np.random.Generator, rate_hz: float, *, n: int, tick_ns: int, lost: float) -> IntArray:
    """Return the stamps of a sensor on a clock with ticks of `tick_ns` ns; a share of the samples is lost."""
    kept = rng.random(n) >= lost
    kept[[0, -1]] = True
    times = (rng.random() + np.arange(n)[kept]) * 1e9 / rate_hz
    return START + np.floor(times / tick_ns).astype(np.int64) * tick_ns


@pytest.mark.parametrize("rate_hz", [417.3, 833.1, 957.4])
def test_losses_of_samples_that_share_a_tick_are_found(rate_hz: float) -> None:
    """Of 3000 samples, 2 % are lost, so the mean rate is too low; without losses it is right."""
    rng = np.random.default_rng([61141, round(rate_hz)])
    for _ in range(20):
        whole = _on_ticks(rng, rate_hz, n=3000, tick_ns=10_000_000, lost=0.0)
        assert not [x for x in read(whole).findings if x.level == "warning"]
        reading = read(_on_ticks(rng, rate_hz, n=3000, tick_ns=10_000_000, lost=0.02))
        assert "uneven-stamps" in codes(reading)


def test_random_losses_hide_the_difference_of_tick_and_period() -> None:
    """The warning contains the largest error of the rate; many samples, or a given rate, need none."""
    rng = np.random.default_rng(61142)
    limits = 0
    for rate_hz in rng.uniform(992, 1008, 30).tolist():
        stamps = _on_ticks(rng, rate_hz, n=3000, tick_ns=1_000_000, lost=0.3)
        reading = read(stamps)
        found = [x.text for x in reading.findings if x.code == "uneven-stamps"]
        off = abs(reading.clock.rate_hz / rate_hz - 1)
        assert off < 0.015
        if off > 0.005:
            (text,) = found
            for limit in re.findall(r"may be wrong by up to ([0-9.]+)%", text):
                assert 100 * off < float(limit)
                limits += 1
        given = read(stamps, rate=rate_hz)
        assert not [x for x in given.findings if "may be wrong by up to" in x.text]
    assert limits > 2
    many = _on_ticks(rng, 1000.0, n=60_000, tick_ns=1_000_000, lost=0.1)
    assert "uneven-stamps" not in codes(read(many))


def test_jitter_on_a_tick_of_half_a_period_is_not_half_of_the_samples() -> None:
    """Of 3000 samples, 0.1 % are lost; a weak line due to jitter would give twice the rate."""
    rng = np.random.default_rng(61143)
    for _ in range(40):
        tau = 1e9 / rng.uniform(204, 210)
        times = np.cumsum(np.where(rng.random(3000) < 0.001, 2, 1)) * tau + rng.normal(0, 0.1 * tau, 3000)
        reading = read(START + np.floor(times / 2_500_000).astype(np.int64) * 2_500_000)
        assert reading.clock.rate_hz == pytest.approx(1e9 / tau, rel=0.005)
