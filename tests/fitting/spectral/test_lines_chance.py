"""Tests of the false alarm rate of spectral lines, and of the detection of weak ones."""

import numpy as np
import pytest

from imucal.allan.dct import dct_bins, dct_ordinates
from imucal.fitting.spectral.disturbances.lines import find_lines
from imucal.noise import NoiseModel


@pytest.mark.parametrize("text", ["N=1e-3", "N=1e-4 + K=2e-5", "N=1e-3 + B=5e-4"])
@pytest.mark.parametrize("n", [2_000, 16_000])
def test_the_false_alarm_rate_of_lines_is_one_per_cent(text: str, n: int) -> None:
    """The limit of 4 % is three standard errors above, for 150 records."""
    bins, model = dct_bins(n), NoiseModel.parse(text)
    found = 0
    for seed in range(150):
        samples = model.simulate(n, rate_hz=100.0, rng=np.random.default_rng([n, seed]))
        _, lines = find_lines(dct_ordinates(samples - samples.mean()), bins, scale=1.0, rate_hz=100.0)
        found += bool(lines)
    assert found / 150 <= 0.04


@pytest.mark.parametrize("frequency", [0.1, 0.565, 12.3])
def test_a_sine_as_large_as_the_noise_density_is_found(frequency: float) -> None:
    """The frequency is exact to one ordinate, the amplitude to 10 % because neighbours are omitted."""
    n, rate_hz = 100_000, 100.0
    seconds = np.arange(n) / rate_hz
    noise = NoiseModel.parse("N=1e-3").simulate(n, rate_hz=rate_hz, rng=np.random.default_rng(1))
    ordinates = dct_ordinates(noise + 1e-3 * np.sin(2 * np.pi * frequency * seconds))
    kept, lines = find_lines(ordinates, dct_bins(n), scale=1.0, rate_hz=rate_hz)
    assert kept is not None
    assert len(lines) == 1
    assert lines[0].frequency_hz == pytest.approx(frequency, abs=rate_hz / n)
    assert lines[0].amplitude == pytest.approx(1e-3, rel=0.1)
