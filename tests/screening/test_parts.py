"""Tests of small parts of the screening: resolution, limits of chance and texts."""

import numpy as np
import pytest
from scipy import stats

from imucal.recording import AxisSeries, Sensor
from imucal.screening.windows import amount, name_list, resolution, span, variance_limit


@pytest.mark.parametrize("lsb", [1.0, 1 / 131, 2.0**-14 * 9.80665, 1e-3])
@pytest.mark.parametrize("noise", [0.3, 1.0, 5.0, 60.0])
def test_resolution_is_the_lsb(lsb: float, noise: float) -> None:
    """All values between the extremes may occur, or only one in ten."""
    rng = np.random.default_rng(1)
    samples = np.round(500.4 + noise * rng.standard_normal(20_000)) * lsb
    found = resolution(AxisSeries.from_samples(samples, rate_hz=100.0))
    assert found == pytest.approx(lsb, rel=1e-6)


def test_resolution_is_found_in_single_precision() -> None:
    """Rounding to 32 bits near 9.8 does not hide an LSB of half a milli-g."""
    rng = np.random.default_rng(2)
    samples = (np.round(2000 + 5 * rng.standard_normal(20_000)) * 0.0049).astype(np.float32).astype(float)
    assert resolution(AxisSeries.from_samples(samples, rate_hz=100.0)) == pytest.approx(0.0049, rel=1e-4)


def test_continuous_values_have_no_resolution() -> None:
    """Noise with sixteen digits is not on a grid."""
    samples = np.random.default_rng(3).standard_normal(20_000)
    assert resolution(AxisSeries.from_samples(samples, rate_hz=100.0)) is None


def test_a_constant_has_no_resolution() -> None:
    assert resolution(AxisSeries.from_samples(np.ones(100), rate_hz=100.0)) is None


@pytest.mark.parametrize("edf", [2, 5, 15, 49, 200])
@pytest.mark.parametrize("p_above", [1e-5, 1e-7])
def test_the_limit_is_above_the_chi_square_quantile(edf: int, p_above: float) -> None:
    """For windows of white noise, it exceeds the quantile by at most a factor of 2.5."""
    variances = np.random.default_rng(4).chisquare(edf, 20_000) / edf
    limit = variance_limit(variances, p_above)
    exact = stats.chi2.isf(p_above, edf) / edf
    # With two degrees of freedom both are equal; the median of 20 000 is known to 1 %.
    assert 0.97 * exact < limit < 2.5 * exact


def test_the_limit_allows_for_a_random_walk() -> None:
    """Variances in windows of a random walk have a heavy tail but rarely exceed the limit."""
    steps = np.random.default_rng(5).standard_normal((20_000, 50)).cumsum(axis=1)
    variances = steps.var(axis=1)
    assert np.mean(variances > variance_limit(variances[:400], 1e-3)) < 4e-3


def test_the_limit_is_robust_to_motion() -> None:
    """Four of ten windows move by ten deviations, and the limit is still below them."""
    variances = np.random.default_rng(6).chisquare(49, 1000) / 49
    variances[:400] *= 100
    assert variance_limit(variances, 1e-7) < 30


def test_amounts_contain_the_data_sheet_unit() -> None:
    """Both units avoid exponents where possible."""
    assert amount(0.0012, Sensor.GYROSCOPE) == "0.0012 rad/s (0.0688 deg/s)"
    assert amount(19.6, Sensor.ACCELEROMETER) == "19.6 m/s^2 (1999 mg)"


def test_the_texts_of_lists_and_spans() -> None:
    assert [name_list(list("abc"[:k])) for k in range(4)] == ["", "a", "a and b", "a, b and c"]
    assert span(1.04, 2.0) == "1.0 to 2.0 s"
