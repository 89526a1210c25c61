"""Tests of windows: statistics by definition, and positions with gaps."""

from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest

from imucal.clock import Clock, Segment
from imucal.recording import AxisSeries, Sensor
from imucal.screening.windows import cut, quietest


def axis(samples: np.ndarray[tuple[int], np.dtype[np.float64]], clock: Clock | None = None) -> AxisSeries:
    clock = clock or Clock.even(samples.size, 100.0)
    return AxisSeries(sensor=Sensor.GYROSCOPE, axis="x", samples=samples, clock=clock)


def test_statistics_follow_the_definition() -> None:
    """Each column is computed from the samples of the window."""
    samples = np.random.default_rng(1).normal(size=4037)
    windows = cut(axis(samples))
    assert windows.width == 50
    for i, start in enumerate(windows.start.tolist()):
        part = samples[start : start + 50]
        npt.assert_allclose(windows.mean[i], part.mean(), rtol=1e-12)
        npt.assert_allclose(windows.variance[i], part.var(ddof=1), rtol=1e-12)
        npt.assert_allclose(windows.step_variance[i], np.mean(np.diff(part) ** 2) / 2, rtol=1e-12)
        assert (windows.low[i], windows.high[i]) == (part.min(), part.max())


def test_windows_contain_every_sample() -> None:
    """The last window ends with the record and overlaps the one before."""
    windows = cut(axis(np.arange(3230.0)))
    assert windows.start[-1] + windows.width == 3230
    assert np.all(np.diff(windows.start) <= windows.width)
    assert windows.repeats.sum() == 0


def test_an_offset_does_not_reduce_the_precision() -> None:
    """With a mean of 1e6 deviations, only the rounding of the samples changes the variance."""
    samples = np.random.default_rng(2).normal(size=4000)
    near, far = cut(axis(samples)), cut(axis(samples + 2.0**20))
    # Samples near 1e6 are rounded to 1.2e-10, with a variance near 1.
    npt.assert_allclose(far.variance, near.variance, atol=1e-8)


def test_windows_avoid_long_gaps_and_ignore_short_ones() -> None:
    """A window may contain a gap of up to a quarter of its length."""
    clock = Clock(
        source="test",
        rate_hz=100.0,
        segments=(
            Segment(start=0, stop=1010, offset=0),
            Segment(start=1010, stop=2000, offset=1015),
            Segment(start=2000, stop=3200, offset=9000),
        ),
    )
    windows = cut(axis(np.zeros(3200), clock))
    ends = windows.start + windows.width
    assert not np.any((windows.start < 2000) & (ends > 2000))
    assert np.any((windows.start < 1010) & (ends > 1010))
    npt.assert_allclose(windows.time_s[windows.start >= 2000][0], 90.0)
    npt.assert_allclose(windows.time_s[windows.start == 1050], 10.55)


def test_many_short_segments_have_windows_everywhere() -> None:
    """One sample in five is missing."""
    keep = np.arange(50_000) % 5 != 0
    series = axis(np.random.default_rng(3).normal(size=50_000)).keeping(keep)
    windows = cut(series)
    assert windows.size == pytest.approx(800, abs=1)


@pytest.mark.parametrize("n", [0, 1, 15, 16, 17])
def test_short_axes_have_few_windows(n: int) -> None:
    """Sixteen samples are one window."""
    assert cut(axis(np.arange(float(n)))).size == max(0, n - 15)


def test_a_mapped_file_has_the_same_windows(tmp_path: Path) -> None:
    """Mapped samples are read in blocks."""
    samples = np.random.default_rng(4).normal(size=300_000)
    path = tmp_path / "samples.f64"
    samples.tofile(path)
    mapped = np.memmap(path, dtype=np.float64, mode="r")
    npt.assert_array_equal(cut(axis(mapped)).variance, cut(axis(samples)).variance)


def test_the_quietest_part_is_contiguous() -> None:
    """Single quiet windows do not count, nor do constant ones."""
    variance = np.array([9.0, 1.0, 9.0, 1.0, 9.0, 2.0, 0.0, 2.0, 2.0, 9.0])
    assert quietest(variance, 3) == pytest.approx(2.0)
    assert quietest(variance, 20) == pytest.approx(2.0)
    assert quietest(np.zeros(4), 3) == 0.0
