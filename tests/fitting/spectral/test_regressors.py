"""Tests of the removal of warm-up and temperature effects in the fit."""

import numpy as np
import pytest
from scipy.special import ndtr

from imucal.allan.dct import dct_bins, dct_ordinates
from imucal.arrays import FloatArray
from imucal.errors import ArgumentError, DataError
from imucal.fitting.regressors import (
    Bump,
    LevelChange,
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
from imucal.fitting.spectral.ordinates import FLICKER
from tests.fitting.fits import fitted, ordinates_of, simulated

N = 40_000


def codes(result_findings: tuple[object, ...]) -> set[str]:
    return {getattr(finding, "code", "") for finding in result_findings}


@pytest.mark.parametrize("place", [40.0, 251.3, 470.0])
@pytest.mark.parametrize("width", [3.0, 20.0, 150.0])
def test_changes_of_level_and_bumps_are_the_transform_of_mirrored_samples(place: float, width: float) -> None:
    """Both are mirrored at the ends of the record; a wide one has several images."""
    n = 500
    t = np.arange(n) + 0.5
    images = [(2 * n * turn + side * place, side) for turn in range(-3, 4) for side in (1, -1)]
    bump = sum(np.exp(-0.5 * ((t - at) / width) ** 2) for at, _ in images)
    # A step up at the place is a step down at its image.
    level = sum(side * ndtr((t - at) / width) for at, side in images)
    # Frequencies above a tenth of Nyquist depend on the sampling of narrow curves.
    shapes: tuple[tuple[Regressor, object], ...] = (
        (Bump(place=place, width=width), bump),
        (LevelChange(place=place, width=width), level),
    )
    for shape, samples in shapes:
        expected = dct_ordinates(np.asarray(samples))[:40]
        found = shape.ordinates(Stretch(n=n), 40)
        np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())


def test_the_samples_of_a_change_of_level_and_a_bump() -> None:
    """Half of the change is at its place; a bump has the height 1."""
    places = np.array([0.0, 90.0, 100.0, 110.0, 200.0])
    level = LevelChange(place=100.0, width=10.0).samples(places)
    np.testing.assert_allclose(level, [0, 0.158655, 0.5, 0.841345, 1], atol=1e-6)
    bump = Bump(place=100.0, width=10.0).samples(places)
    np.testing.assert_allclose(bump, [0, np.exp(-0.5), 1, np.exp(-0.5), 0], atol=1e-6)


def test_averaged_flicker_is_the_sum_of_its_aliases() -> None:
    """It equals a long sum at every bin, and 1/sqrt(lam) at low frequencies."""
    data = ordinates_of(simulated("N=1", 2000, 1))
    averaged = data.with_averaged_flicker()
    theta = np.pi * data.fraction
    turns = 2 * np.pi * np.arange(-2000, 2001)[:, np.newaxis]
    density = data.lam * np.sum(1 / np.abs(theta + turns) ** 3, axis=0)
    ratio = averaged.basis[FLICKER] / data.basis[FLICKER]
    np.testing.assert_allclose(ratio, density * np.sqrt(data.lam), rtol=1e-6)
    np.testing.assert_allclose(ratio[:20], 1, rtol=1e-3)
    assert ratio[-1] < 0.56
    others = [row for row in range(4) if row != FLICKER]
    np.testing.assert_array_equal(averaged.basis[others], data.basis[others])


def test_n_holds_if_the_samples_are_means_of_faster_ones() -> None:
    """Flicker as strong as the white noise, averaged from 20 to 2 Hz; the fit of plain flicker misses N."""
    held, narrow = 0, 0
    for seed in range(6):
        rng = np.random.default_rng([71, seed])
        fast = 1e-4 * np.sqrt(20) * rng.standard_normal(200_000)
        frequency = np.fft.rfftfreq(400_000, 1 / 20)
        frequency[0] = frequency[1]
        shaped = np.fft.rfft(np.sqrt(20) * rng.standard_normal(400_000)) / np.sqrt(2 * np.pi * frequency)
        fast += 1e-4 * np.fft.irfft(shaped)[:200_000]
        samples = fast.reshape(-1, 10).mean(axis=1)
        chosen = fitted(samples, rate_hz=2.0)["N"]
        held += chosen.low <= 1e-4 <= chosen.high
        given = fitted(samples, "N + B", rate_hz=2.0)["N"]
        narrow += given.low <= 1e-4 <= given.high
    assert held >= 5
    assert narrow <= 3


def test_a_logged_temperature_that_explains_the_drift_is_removed() -> None:
    """The drift is of the size of the noise; K does not show it."""
    removed = 0
    for seed in range(4):
        t = np.arange(36_000) / 10
        degrees = 25 - 4 * np.expm1(-t / 900) + 0.4 * np.sin(2 * np.pi * t / 1300 + seed)
        samples = simulated("N=1e-4 + B=3e-5", t.size, seed, rate_hz=10.0) + 1e-4 * (degrees - 25)
        fit = fitted(samples, rate_hz=10.0, temperature=degrees)
        removed += "temperature" in codes(fit.findings)
        assert fit["K"].low == 0
    assert removed >= 3


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
        ("level:20.5,3.0", LevelChange(place=20.5, width=3.0)),
        ("bump:20.5,3.0", Bump(place=20.5, width=3.0)),
    ],
)
def test_a_stored_name_returns_an_equal_regressor(name: str, regressor: Regressor) -> None:
    """Stored fits contain these names, so they must not change."""
    assert regressor.name == str(regressor) == name
    assert parse(name) == regressor


@pytest.mark.parametrize("name", ["", "square:3", "exp", "step:3.5", "cos:fast", "bump:3"])
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
