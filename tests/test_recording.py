"""Tests of recordings: clocks with gaps, series and cuts."""

from dataclasses import replace

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucal.clock import Clock, Gap, Segment
from imucal.errors import DataError
from imucal.recording import AxisSeries, Recording, Sensor, Source

KEEP = st.lists(st.booleans(), min_size=1, max_size=60).filter(any)


def test_a_clock_reports_its_gaps() -> None:
    """Two segments four samples apart miss four samples."""
    segments = (Segment(start=0, stop=10, offset=0), Segment(start=10, stop=15, offset=14))
    clock = Clock(source="test", rate_hz=2.0, segments=segments)
    assert clock.n == 15
    assert clock.grid_size == 19
    assert clock.duration_s == 9.5
    assert clock.gaps == (Gap(start_s=5.0, missing=4, duration_s=2.0),)
    assert clock.missing == 4


@pytest.mark.parametrize(
    "segments",
    [
        (Segment(start=1, stop=3, offset=0),),
        (Segment(start=0, stop=0, offset=0),),
        (Segment(start=0, stop=5, offset=0), Segment(start=5, stop=6, offset=4)),
    ],
)
def test_overlapping_or_incomplete_segments_are_rejected(segments: tuple[Segment, ...]) -> None:
    """Segments contain every sample once, in order."""
    with pytest.raises(ValueError, match="segments must follow each other and not overlap"):
        Clock(source="test", rate_hz=1.0, segments=segments)


def test_an_invalid_rate_is_rejected() -> None:
    """A rate is positive and finite."""
    with pytest.raises(ValueError, match="rate_hz must be positive and finite, got 0"):
        Clock.even(3, 0.0)


@given(keep=KEEP)
def test_omitted_samples_become_gaps(keep: list[bool]) -> None:
    """The other samples keep their place on the grid."""
    mask = np.array(keep)
    series = AxisSeries.from_samples(np.arange(mask.size, dtype=float), rate_hz=10.0)
    kept = series.keeping(mask)
    first = int(np.argmax(mask))
    npt.assert_array_equal(kept.clock.grid() + first, np.flatnonzero(mask))
    npt.assert_array_equal(kept.samples, np.flatnonzero(mask))
    assert kept.clock.missing == kept.clock.grid_size - mask.sum()
    started = replace(series.clock, start_ns=7).keeping(mask)
    assert started.start_ns == 7 + first * 100_000_000
    for place in range(mask.size + 2):
        assert kept.clock.index_from(place) == np.searchsorted(kept.clock.grid(), place)


@given(keep=KEEP, start=st.floats(-1, 8), length=st.floats(0, 8))
def test_a_cut_in_time_contains_the_samples_of_that_time(
    keep: list[bool], start: float, length: float
) -> None:
    """`between` agrees with a comparison of every sample's time."""
    mask = np.array(keep)
    series = AxisSeries.from_samples(np.arange(mask.size, dtype=float), rate_hz=10.0).keeping(mask)
    seconds = series.clock.grid() * series.tau0
    # A time within rounding of the grid may be on either side.
    if np.any(np.abs(np.subtract.outer(seconds, [start, start + length])) < 1e-6):
        return
    expected = series.samples[(seconds >= start) & (seconds < start + length)]
    npt.assert_array_equal(series.between(start, start + length).samples, expected)


def test_a_cut_in_time_copies_nothing() -> None:
    """A cut of a day of samples must not copy them."""
    series = AxisSeries.from_samples(np.arange(100.0), rate_hz=10.0)
    assert np.shares_memory(series.between(1, 5).samples, series.samples)


def test_non_finite_samples_become_gaps() -> None:
    """NaN and infinity are never filled."""
    series = AxisSeries.from_samples(np.array([1.0, np.nan, 3.0, np.inf, 5.0]), rate_hz=1.0)
    assert series.finite().samples.tolist() == [1.0, 3.0, 5.0]
    assert series.finite().clock.grid().tolist() == [0, 2, 4]


def test_a_series_is_read_only_and_one_dimensional() -> None:
    series = AxisSeries.from_samples(np.zeros(3), rate_hz=1.0)
    with pytest.raises(ValueError, match="read-only"):
        series.samples[0] = 1.0
    with pytest.raises(ValueError, match=r"samples must have shape \(n,\), got \(2, 2\)"):
        AxisSeries(sensor=Sensor.GYROSCOPE, axis="x", samples=np.zeros((2, 2)), clock=Clock.even(4, 1.0))


def test_a_recording_lists_its_axes() -> None:
    """The error for a missing axis lists the available ones."""
    series = AxisSeries.from_samples(np.zeros(3), rate_hz=1.0, sensor="accelerometer", axis="z")
    recording = Recording(source=Source(path="a.csv", format="csv"), series=(series,))
    assert recording.axis("accelerometer", "z") is series
    with pytest.raises(DataError) as caught:
        recording.axis("gyroscope", "x")
    assert str(caught.value) == "a.csv: no axis gyroscope x; found accel_z"


def test_a_cut_beyond_the_end_reports_the_duration() -> None:
    """It is an error."""
    series = AxisSeries.from_samples(np.zeros(30), rate_hz=10.0)
    recording = Recording(source=Source(path="a.csv", format="csv"), series=(series,))
    with pytest.raises(DataError) as caught:
        recording.between(60.0, 90.0)
    assert str(caught.value) == "a.csv: no samples from 60 s to 90 s; it lasts 3 s"
    with pytest.raises(DataError, match="no samples from 60 s on; it lasts 3 s"):
        recording.between(60, float("inf"))
    assert recording.between(1.0, 2.0).series[0].n == 10


def test_finite_samples_are_checked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A series that is known to be finite is not checked again; other samples are checked."""
    series = AxisSeries.from_samples(np.arange(5.0), rate_hz=1.0)
    assert series.finite() is series
    other = replace(series, samples=np.array([0.0, 1.0, np.nan, 3.0, 4.0]))
    assert other.finite().n == 4
    monkeypatch.setattr("imucal.recording._sane", None)
    assert series.finite() is series


def test_absurdly_large_samples_become_gaps() -> None:
    """Their squares would overflow."""
    samples = np.array([0.0, 1.0, np.nan, 1e308, -np.inf, 2.0, 3.0])
    series = AxisSeries.from_samples(samples, rate_hz=10.0).finite()
    assert series.samples.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert series.clock.missing == 3


def test_axes_with_a_common_clock_share_its_part() -> None:
    """The identity of the clock shows that axes were sampled together."""
    one = AxisSeries.from_samples(np.zeros(30), rate_hz=10.0, axis="x")
    two = replace(one, axis="y")
    recording = Recording(source=Source(path="a.csv", format="csv"), series=(one, two))
    first, second = recording.between(1.0, 2.0).series
    assert first.clock is second.clock
    assert first.n == 10
