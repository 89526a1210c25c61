"""Tests of the search for noise whose variance changes within a segment."""

import numpy as np
import pytest

from imucal.fitting.homogeneity import find_variance_change
from imucal.recording import AxisSeries

RATE_HZ = 100.0


def series(samples: np.ndarray) -> AxisSeries:
    """Return an axis at 100 Hz."""
    return AxisSeries.from_samples(samples, rate_hz=RATE_HZ)


@pytest.mark.parametrize("period_s", [20.0, 100.0, 300.0])
def test_a_swing_is_found_with_its_period(period_s: float) -> None:
    """White noise swings by 80 % over several periods."""
    n = 120_000
    swing = 1 + 0.8 * np.sin(2 * np.pi * np.arange(n) / RATE_HZ / period_s)
    found = find_variance_change(series(np.random.default_rng(21).standard_normal(n) * swing))
    assert found is not None
    assert found.period_s == pytest.approx(period_s, rel=0.05)
    assert found.low < 0.5
    assert found.high > 1.3


def test_a_jump_is_found_without_a_period() -> None:
    """The second half of the record is four times as loud."""
    n = 60_000
    loud = np.where(np.arange(n) < n // 2, 1.0, 4.0)
    found = find_variance_change(series(np.random.default_rng(22).standard_normal(n) * loud))
    assert found is not None
    assert found.period_s is None


def test_the_unit_does_not_matter() -> None:
    """Scores and quantiles are relative."""
    n = 40_000
    samples = np.random.default_rng(23).standard_normal(n) * np.where(np.arange(n) < n // 2, 1.0, 2.0)
    one, other = find_variance_change(series(samples)), find_variance_change(series(2.0**-40 * samples))
    assert one is not None
    assert other is not None
    assert (one.low, one.high, one.score) == pytest.approx((other.low, other.high, other.score), rel=1e-9)


def test_stationary_noise_has_no_variance_change() -> None:
    """White, heavy-tailed and filtered noise and a random walk have 30 records each."""
    rng = np.random.default_rng(24)
    n = 20_000
    for _ in range(30):
        white = rng.standard_normal(n)
        kinds = (
            white,
            rng.standard_t(4, n),
            np.convolve(white, np.ones(5), "same"),
            white + np.cumsum(white),
        )
        assert all(find_variance_change(series(kind)) is None for kind in kinds)


def test_short_and_constant_records_are_not_tested() -> None:
    """A short record has too few windows; samples without noise have no variance to compare."""
    assert find_variance_change(series(np.random.default_rng(25).standard_normal(3000))) is None
    half = np.concatenate([np.zeros(10_000), np.random.default_rng(26).standard_normal(10_000)])
    assert find_variance_change(series(half)) is None
    assert find_variance_change(series(np.arange(10_000.0))) is None
