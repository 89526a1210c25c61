"""Tests of the removal of warm-up and temperature effects in the fit."""

import numpy as np
import pytest

from imucal.allan.dct import dct_bins, dct_ordinates, ramp_ordinates
from imucal.arrays import FloatArray
from imucal.fitting.spectral.blocks import Block
from imucal.fitting.spectral.ordinates import (
    exponential_ordinates,
    lagged,
    regressor_ordinates,
    regressor_samples,
)
from tests.fitting.fits import fitted, simulated

N = 40_000


def codes(result_findings: tuple[object, ...]) -> set[str]:
    return {getattr(finding, "code", "") for finding in result_findings}


def test_ramp_and_exponential_are_the_transform_of_their_samples() -> None:
    """The closed forms agree with the DCT of the samples."""
    t = np.arange(500.0)
    np.testing.assert_allclose(ramp_ordinates(500, 499), dct_ordinates(t), atol=1e-8)
    for time in (3.0, 80.0, 4000.0):
        expected = dct_ordinates(np.exp(-(t + 70) / time))
        np.testing.assert_allclose(exponential_ordinates(500, 499, time, 70), expected, atol=1e-10)


def test_a_warm_up_is_found_and_k_is_not_inflated() -> None:
    """The exponential is ten times the spread of the random walk."""
    samples = simulated("N=1 + K=5e-3", N, 1)
    plain = fitted(samples, "N + K")
    warm = fitted(samples + 10 * np.exp(-np.arange(N) / 3000), "N + K")
    assert "warm-up-fitted" in codes(warm.findings)
    assert "warm-up-fitted" not in codes(plain.findings)
    assert warm["K"].low < 5e-3 < warm["K"].high


def test_a_linear_effect_of_temperature_is_removed() -> None:
    samples = simulated("N=1 + K=2e-3", N, 2)
    # The temperature is a random walk, because a slow cycle would be found without a thermometer.
    temperature = 25 + 0.02 * np.cumsum(np.random.default_rng(3).standard_normal(N))
    heated = samples + 0.5 * temperature
    without = fitted(heated, "N + K")
    result = fitted(heated, "N + K", temperature=temperature)
    assert "temperature" in codes(result.findings)
    assert result["K"].low < 2e-3 < result["K"].high
    assert (without["K"].value or 0.0) > 2 * (result["K"].value or 1.0)


@pytest.mark.parametrize("temperature", [np.full(N, 25.0), 25 + np.arange(N) * 1e-9])
def test_a_constant_temperature_is_not_used(temperature: np.typing.NDArray[np.float64]) -> None:
    samples = simulated("N=1", N, 3)
    result = fitted(samples, "N", temperature=temperature)
    assert "temperature" not in codes(result.findings)
    assert result["N"].value == pytest.approx(fitted(samples, "N")["N"].value, rel=1e-6)


def _block(temperature: FloatArray | None) -> Block:
    samples = simulated("N=1", 500, 4)
    return Block(offset=70, bins=dct_bins(500), ordinates=dct_ordinates(samples), temperature=temperature)


def test_a_block_returns_regressors_by_name() -> None:
    """They are the ramp, the temperature and a decay that began before the block."""
    t = np.arange(500.0)
    block = _block(np.sin(t))
    np.testing.assert_allclose(block.regressor("R"), dct_ordinates(t), atol=1e-8)
    np.testing.assert_allclose(block.regressor("temperature"), dct_ordinates(np.sin(t)), atol=1e-12)
    decay = dct_ordinates(np.exp(-(t + 70) / 80))
    np.testing.assert_allclose(block.regressor("exp:80.0"), decay, atol=1e-10)


@pytest.mark.parametrize(
    "name", ["R", "exp:80.0", "step:71", "step:300", "step:569", "cos:0.0311", "sin:0.0311", "sin:0.5"]
)
@pytest.mark.parametrize("offset", [0, 70])
def test_closed_forms_are_transforms_of_the_samples(name: str, offset: int) -> None:
    """The block may begin later than the record, and the frequency may be that of an ordinate."""
    samples = regressor_samples(name, offset + np.arange(500.0))
    found = regressor_ordinates(name, 500, 499, offset=offset)
    np.testing.assert_allclose(found, dct_ordinates(samples), atol=1e-8)
    name = f"cos:{np.pi * 7 / 500!r}"
    found = regressor_ordinates(name, 500, 499, offset=offset)
    np.testing.assert_allclose(
        found, dct_ordinates(regressor_samples(name, offset + np.arange(500.0))), atol=1e-8
    )


@pytest.mark.parametrize("place", [0.0, -3.0, 500.0])
def test_a_step_outside_a_block_is_zero(place: float) -> None:
    """It is constant in the block."""
    assert not regressor_ordinates(f"step:{place}", 500, 499).any()


def test_a_lag_is_a_first_order_filter() -> None:
    """The filter is at rest before the first sample; a lag of 0 returns the input."""
    x = np.random.default_rng(5).normal(size=300)
    expected, state = [], x[0]
    for value in x:
        state += (1 - np.exp(-1 / 12.0)) * (value - state)
        expected.append(state)
    np.testing.assert_allclose(lagged(x, 12.0), expected, rtol=1e-12)
    assert lagged(x, 0.0) is x
    np.testing.assert_allclose(regressor_samples("temperature:12.0", np.arange(300.0), x), expected)


@pytest.mark.parametrize("lag", ["", ":300.0"])
def test_the_lowest_ordinates_of_a_temperature_may_use_means(lag: str) -> None:
    """Means of a 25th of the samples agree with all samples to 1 % of the largest ordinate."""
    t = np.arange(20_000.0)
    warm = 25 + np.sin(t / 2500) + 1e-3 * np.random.default_rng(6).normal(size=t.size)
    quick = regressor_ordinates(f"temperature{lag}", t.size, 200, temperature=warm)
    every = regressor_ordinates(f"temperature{lag}", t.size, t.size - 1, temperature=warm)[:200]
    np.testing.assert_allclose(quick, every, atol=0.01 * np.abs(every).max())


def test_a_missing_temperature_is_rejected() -> None:
    with pytest.raises(ValueError, match="'temperature:3'"):
        regressor_ordinates("temperature:3", 500, 499)
