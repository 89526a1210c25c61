"""Warm-up and temperature are taken out with the fit."""

import numpy as np
import pytest

from imucal.allan.dct import dct_ordinates, ramp_ordinates
from imucal.fitting.spectral.ordinates import exponential_ordinates
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
