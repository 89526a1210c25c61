"""Tests of exact variances: slow references, published values, invariances and errors."""

import json

import allantools
import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucal.allan.variance import sum_of_squares, variances
from imucal.arrays import FloatArray
from tests.allan.witness import exact_avar, literal_moav, naive_moav
from tests.real_data import real_data

RNG = np.random.default_rng(4)
NOISE = RNG.standard_normal(400) + np.cumsum(RNG.standard_normal(400)) * 0.1 + 9.8


def _of(samples: FloatArray, m: list[int]) -> FloatArray:
    return variances(samples, np.array(m))


def test_the_overlapping_variance_agrees_with_its_definition() -> None:
    """It is half the mean square of all n - 2m + 1 differences between adjacent means."""
    m = [1, 2, 3, 7, 64, 133, 199, 200]
    npt.assert_allclose(_of(NOISE, m), [naive_moav(NOISE, k) for k in m], rtol=1e-11)


def test_the_variance_agrees_with_its_published_sum() -> None:
    """The reference implements NIST SP 1065 literally, up to the largest possible factor."""
    m = [1, 2, 3, 10, 57, 199, 200]
    npt.assert_allclose(_of(NOISE, m), [literal_moav(NOISE, k) for k in m], rtol=1e-9)


def test_blocks_do_not_change_the_variances() -> None:
    """A series of several blocks agrees with AllanTools at factors near all block boundaries."""
    samples = np.random.default_rng(1).standard_normal(100_003) + 9.8
    m = np.array([1, 2, 5, 63, 1000, 8191, 8192, 8193, 16384, 20_000, 32_768, 32_769, 33_000])
    centred = samples - samples.mean()
    _, deviation, _, _ = allantools.oadev(centred, rate=1.0, data_type="freq", taus=m.astype(float))
    npt.assert_allclose(np.sqrt(variances(samples, m)), deviation, rtol=1e-9)


@pytest.mark.parametrize(("series", "file"), [("nbs14_9pt", "nbs14_9pt"), ("nist_1000pt", "nist_1000pt")])
def test_published_values_agree_in_every_printed_digit(series: str, file: str) -> None:
    """NIST SP 1065 (2008), sec. 12.4, tables 30 and 31: seven digits each."""
    folder = real_data("reference", "nist_sp1065")
    published = json.loads((folder / "expected.json").read_text(encoding="utf-8"))[series]
    samples = np.loadtxt(folder / f"{file}_frequency.csv", skiprows=1)
    got = np.sqrt(_of(samples, published["tau"]))
    for value, printed in zip(got, published["oadev"], strict=True):
        assert f"{value:.7g}" == f"{printed:.7g}"


def test_the_nbs14_series_has_its_published_deviations() -> None:
    """NIST SP 1065, p. 107: the overlapping Allan deviations of the nine-point series."""
    nbs14 = np.array([892, 809, 823, 798, 671, 644, 883, 903, 677], dtype=np.float64)
    npt.assert_allclose(np.sqrt(_of(nbs14, [1, 2])), [91.22945, 85.95287], rtol=1e-7)


def test_the_thousand_point_series_has_its_published_deviations() -> None:
    """NIST SP 1065, p. 108 and table 31: n(i+1) = 16807 n(i) mod 2147483647 from 1234567890."""
    state, values = 1234567890, []
    for _ in range(1000):
        values.append(state / 2147483647)
        state = 16807 * state % 2147483647
    deviations = np.sqrt(_of(np.array(values), [1, 10, 100]))
    assert [f"{value:.7g}" for value in deviations] == ["0.2922319", "0.09159953", "0.03241343"]


@pytest.mark.parametrize("mean", [0, 9_800_000])
def test_the_relative_error_is_below_1e_12(mean: int) -> None:
    """White noise of sigma 1000 with a mean of 0 and 9.8e6 is integrated exactly as integers."""
    rng = np.random.default_rng(2)
    whole = np.rint(rng.standard_normal(300_000) * 1000).astype(np.int64) + mean
    m = [1, 2, 30, 1000, 8192, 8193, 60_000, 150_000]
    exact = [exact_avar(whole, k) for k in m]
    npt.assert_allclose(_of(whole.astype(np.float64), m), exact, rtol=1e-12)


def test_the_relative_error_of_a_random_walk_is_below_1e_12() -> None:
    """It is the worst case, because the integral is much larger than its differences."""
    rng = np.random.default_rng(3)
    whole = np.cumsum(np.rint(rng.standard_normal(300_000) * 100)).astype(np.int64)
    m = [1, 3, 100, 8193, 100_000]
    npt.assert_allclose(_of(whole.astype(np.float64), m), [exact_avar(whole, k) for k in m], rtol=1e-12)


@given(offset=st.floats(-1e3, 1e3), gain=st.floats(1e-3, 1e3))
@settings(max_examples=20, deadline=None)
def test_offsets_have_no_effect_and_gains_are_squared(offset: float, gain: float) -> None:
    before = _of(NOISE, [1, 4, 50])
    npt.assert_allclose(_of(offset + gain * NOISE, [1, 4, 50]), gain**2 * before, rtol=1e-6)


def test_a_drift_gives_half_its_square() -> None:
    """A ramp of R per sample has the Allan variance R² m² / 2."""
    ramp = 3e-4 * np.arange(50_000.0)
    m = [1, 10, 9000, 25_000]
    npt.assert_allclose(_of(ramp, m), [(3e-4 * k) ** 2 / 2 for k in m], rtol=1e-9)


def test_a_reversed_series_has_the_same_variances() -> None:
    """Squared differences do not depend on the direction of time."""
    m = [1, 17, 120]
    npt.assert_allclose(_of(NOISE[::-1].copy(), m), _of(NOISE, m), rtol=1e-11)


@pytest.mark.parametrize("size", [0, 1, 8191, 8192, 8193, 20_000])
def test_the_sum_of_squares_is_right_for_any_length(size: int) -> None:
    """Rows and the remainder add up to the total."""
    values = np.random.default_rng(size).standard_normal(size)
    assert sum_of_squares(values) == pytest.approx(float(np.sum(values**2)), rel=1e-13)


@pytest.mark.parametrize("m", [0, 201])
def test_a_factor_out_of_range_is_rejected(m: int) -> None:
    """The error contains the valid range."""
    with pytest.raises(ValueError, match=r"averaging factors must be in 1\.\.200 for 400 samples"):
        _of(NOISE, [m])
