"""Tests of the removal of warm-up and temperature effects in the fit."""

import numpy as np
import pytest

from imucal.allan.dct import dct_bins, dct_ordinates
from imucal.arrays import FloatArray
from imucal.errors import ArgumentError, DataError
from imucal.fitting.regressors import (
    Ramp,
    Regressor,
    Step,
    Stretch,
    TemperatureEffect,
    WarmUp,
    Wave,
    lagged,
    parse,
)
from imucal.fitting.spectral.blocks import Block
from tests.fitting.fits import fitted, simulated

N = 40_000


def codes(result_findings: tuple[object, ...]) -> set[str]:
    return {getattr(finding, "code", "") for finding in result_findings}


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


def test_a_block_returns_the_ordinates_of_regressors() -> None:
    """They are the ramp, the temperature and a decay that began before the block."""
    t = np.arange(500.0)
    block = _block(np.sin(t))
    np.testing.assert_allclose(block.ordinates_of(Ramp()), dct_ordinates(t), atol=1e-8)
    np.testing.assert_allclose(block.ordinates_of(TemperatureEffect()), dct_ordinates(np.sin(t)), atol=1e-12)
    decay = dct_ordinates(np.exp(-(t + 70) / 80))
    np.testing.assert_allclose(block.ordinates_of(WarmUp(time_constant=80.0)), decay, atol=1e-10)


#: The last wave has the frequency of an ordinate.
CLOSED_FORMS: tuple[Regressor, ...] = (
    Ramp(),
    WarmUp(time_constant=3.0),
    WarmUp(time_constant=80.0),
    WarmUp(time_constant=4000.0),
    Step(place=71),
    Step(place=300),
    Step(place=569),
    *Wave.pair(0.0311),
    Wave(frequency=0.5, quadrature=True),
    Wave(frequency=np.pi * 7 / 500),
)


@pytest.mark.parametrize("regressor", CLOSED_FORMS, ids=str)
@pytest.mark.parametrize("offset", [0, 70])
def test_closed_forms_are_transforms_of_the_samples(regressor: Regressor, offset: int) -> None:
    """The block may begin later than the record; a part has the same values as the whole."""
    stretch = Stretch(n=500, offset=offset)
    ordinates = regressor.ordinates(stretch, 499)
    samples = regressor.samples(offset + np.arange(500.0))
    np.testing.assert_allclose(ordinates, dct_ordinates(samples), atol=1e-8)
    part = regressor.parts(stretch, 499)(slice(100, 120))
    np.testing.assert_allclose(part, ordinates[100:120], rtol=1e-12)


@pytest.mark.parametrize("place", [0, -3, 500])
def test_a_step_outside_a_block_is_zero(place: int) -> None:
    """It is constant in the block."""
    assert not Step(place=place).ordinates(Stretch(n=500), 499).any()


@pytest.mark.parametrize(
    ("name", "regressor"),
    [
        ("R", Ramp()),
        ("exp:1234.5", WarmUp(time_constant=1234.5)),
        ("step:77", Step(place=77)),
        ("cos:0.0123", Wave(frequency=0.0123)),
        ("sin:0.0123", Wave(frequency=0.0123, quadrature=True)),
        ("temperature", TemperatureEffect()),
        ("temperature:3.2", TemperatureEffect(lag=3.2)),
    ],
)
def test_a_stored_name_returns_an_equal_regressor(name: str, regressor: Regressor) -> None:
    """Stored fits contain these names, so they must not change."""
    assert regressor.name == str(regressor) == name
    assert parse(name) == regressor


@pytest.mark.parametrize("name", ["", "square:3", "exp", "step:3.5", "cos:fast"])
def test_an_unknown_name_is_rejected(name: str) -> None:
    with pytest.raises(DataError, match="fit the log again"):
        parse(name)


def test_a_lag_is_a_first_order_filter() -> None:
    """The filter is at rest before the first sample; a lag of 0 returns the input."""
    x = np.random.default_rng(5).normal(size=300)
    expected, state = [], x[0]
    for value in x:
        state += (1 - np.exp(-1 / 12.0)) * (value - state)
        expected.append(state)
    np.testing.assert_allclose(lagged(x, 12.0), expected, rtol=1e-12)
    assert lagged(x, 0.0) is x
    np.testing.assert_allclose(TemperatureEffect(lag=12.0).samples(np.arange(300.0), x), expected)


@pytest.mark.parametrize("lag", [0.0, 300.0])
def test_the_lowest_ordinates_of_a_temperature_may_use_means(lag: float) -> None:
    """Means of a 25th of the samples agree with all samples to 1 % of the largest ordinate."""
    t = np.arange(20_000.0)
    warm = 25 + np.sin(t / 2500) + 1e-3 * np.random.default_rng(6).normal(size=t.size)
    effect, stretch = TemperatureEffect(lag=lag), Stretch(n=t.size, temperature=warm)
    quick = effect.ordinates(stretch, 200)
    every = effect.ordinates(stretch, t.size - 1)[:200]
    np.testing.assert_allclose(quick, every, atol=0.01 * np.abs(every).max())


def test_a_missing_temperature_is_rejected() -> None:
    effect = TemperatureEffect(lag=3.0)
    with pytest.raises(ArgumentError, match=r"'temperature:3\.0'"):
        effect.ordinates(Stretch(n=500), 499)
    with pytest.raises(ArgumentError, match=r"'temperature:3\.0'"):
        effect.samples(np.arange(500.0))
