"""Warm-up and temperature are taken out with the fit."""

import numpy as np
import pytest

from imucal.allan.dct import dct_bins, dct_ordinates, ramp_ordinates
from imucal.arrays import FloatArray
from imucal.fitting.spectral import transform
from imucal.fitting.spectral.blocks import Block
from imucal.fitting.spectral.ordinates import exponential_ordinates
from imucal.fitting.spectral.transform import choose_regressors
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


def test_a_warm_up_is_found_and_k_keeps_its_size() -> None:
    """An exponential of ten times the walk's spread does not inflate K, and is reported."""
    samples = simulated("N=1 + K=5e-3", N, 1)
    plain = fitted(samples, "N + K")
    warm = fitted(samples + 10 * np.exp(-np.arange(N) / 3000), "N + K")
    assert "warm-up-fitted" in codes(warm.findings)
    assert "warm-up-fitted" not in codes(plain.findings)
    assert warm["K"].low < 5e-3 < warm["K"].high


def test_temperature_is_taken_out() -> None:
    """A linear effect of temperature is removed where the temperature is given."""
    samples = simulated("N=1 + K=2e-3", N, 2)
    temperature = 25 + 3 * np.sin(np.arange(N) / 4000)
    heated = samples + 0.5 * temperature
    without = fitted(heated, "N + K")
    result = fitted(heated, "N + K", temperature=temperature)
    assert "temperature" in codes(result.findings)
    assert result["K"].low < 2e-3 < result["K"].high
    assert (without["K"].value or 0.0) > 2 * (result["K"].value or 1.0)


@pytest.mark.parametrize("temperature", [np.full(N, 25.0), 25 + np.arange(N) * 1e-9])
def test_a_steady_temperature_changes_nothing(temperature: np.typing.NDArray[np.float64]) -> None:
    """A temperature that says nothing is not used."""
    samples = simulated("N=1", N, 3)
    result = fitted(samples, "N", temperature=temperature)
    assert "temperature" not in codes(result.findings)
    assert result["N"].value == pytest.approx(fitted(samples, "N")["N"].value, rel=1e-6)


def _block(temperature: FloatArray | None) -> Block:
    samples = simulated("N=1", 500, 4)
    heat = None if temperature is None else dct_ordinates(temperature)
    return Block(offset=70, bins=dct_bins(500), ordinates=dct_ordinates(samples), temperature=heat)


def test_a_block_has_its_regressors_by_name() -> None:
    """The ramp, the temperature and a decay that began before the block."""
    t = np.arange(500.0)
    block = _block(np.sin(t))
    np.testing.assert_allclose(block.regressor("R"), dct_ordinates(t), atol=1e-8)
    np.testing.assert_allclose(block.regressor("temperature"), dct_ordinates(np.sin(t)), atol=1e-12)
    decay = dct_ordinates(np.exp(-(t + 70) / 80))
    np.testing.assert_allclose(block.regressor("exp:80.0"), decay, atol=1e-10)


@pytest.mark.parametrize(
    ("heated", "warm", "chosen"),
    [
        (0.0, 0.0, ()),
        (-0.1, 0.0, ()),
        (0.1, 0.0, ("temperature",)),
        (-0.1, -0.1, ()),
        (-0.1, 0.1, ("exp",)),
        (0.1, 0.1, ("temperature", "exp")),
    ],
)
def test_a_regressor_gains_its_price_and_ten_more(
    heated: float, warm: float, chosen: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In twice the log-likelihood: log n for a temperature, twice that for a decay and its time; n = 570."""
    prices = (np.log(570) + 10, 2 * np.log(570) + 10)

    def objectives(_: object, sets: list[tuple[str, ...]]) -> list[float]:
        if len(sets) == 2:
            return [100.0, 100 - (prices[0] + heated) / 2]
        gains = [0.0] * (len(sets) - 1)
        gains[3] = (prices[1] + warm) / 2
        return [100.0, *(100 - gain for gain in gains)]

    monkeypatch.setattr(transform, "_objectives", objectives)
    found, findings = choose_regressors([_block(np.sin(np.arange(500.0)))], axis="gyro_x", tau0=0.01)
    assert tuple(name.partition(":")[0] for name in found) == chosen
    codes = {"temperature": "temperature", "exp": "warm-up-fitted"}
    assert [f.code for f in findings] == [codes[name] for name in chosen]
    if "exp" in chosen:
        seconds = float(np.geomspace(0.01, 0.3, 8)[3]) * 570 * 0.01
        assert float(found[-1].partition(":")[2]) == pytest.approx(100 * seconds)
        assert f"with a time constant of {seconds:.3g} s;" in findings[-1].text


@pytest.mark.parametrize("temperature", [None, np.full(500, 20.0)])
def test_without_a_temperature_that_varies_none_is_tried(
    temperature: FloatArray | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the decays are."""
    asked = []

    def objectives(_: object, sets: list[tuple[str, ...]]) -> list[float]:
        asked.append(len(sets))
        return [0.0] * len(sets)

    monkeypatch.setattr(transform, "_objectives", objectives)
    assert choose_regressors([_block(temperature)], axis="gyro_x", tau0=1.0) == ((), ())
    assert asked == [9]
