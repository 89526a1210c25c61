"""Tests of the exclusion of vibration in a frequency band."""

import math

import numpy as np
import pytest
from scipy import signal

from imucal.fitting.spectral.disturbances.hump import is_plateau, largest_run
from tests.fitting.fits import fitted, simulated
from tests.slow_cases import first_by_default


def test_the_largest_run_agrees_with_a_search_of_all_runs() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        values = rng.standard_normal(12)
        first, last, total = largest_run(values)
        every = {(i, j): values[i : j + 1].sum() for i in range(12) for j in range(i, 12)}
        assert total == pytest.approx(max(every.values()))
        assert every[first, last] == pytest.approx(total)


@pytest.mark.parametrize("times", [5, 26])
def test_a_hump_is_excluded(times: int) -> None:
    """N and B are those of the noise outside the vibration band, and a warning reports the band."""
    n, rate = 60_000, 100.0
    passed = signal.butter(1, (0.02, 0.05), "band")
    covered = {"N": 0, "B": 0}
    for seed in range(6):
        rng = np.random.default_rng([times, seed])
        vibration = signal.lfilter(*passed, rng.standard_normal(n)) * 1e-4 * math.sqrt(rate * (times - 1))
        fit = fitted(simulated("N=1e-4 + B=5e-5", n, seed, rate_hz=rate) + vibration, rate_hz=rate)
        covered["N"] += fit["N"].low <= 1e-4 <= fit["N"].high
        covered["B"] += fit["B"].low <= 5e-5 <= fit["B"].high
        (found,) = (finding for finding in fit.findings if finding.code in {"hump", "output-filter"})
        assert (found.code, found.level) == ("hump", "warning")
    assert covered["N"] >= 5
    assert covered["B"] >= 5


@pytest.mark.parametrize("seed", first_by_default(range(3), 1))
def test_noise_without_vibration_has_no_hump(seed: int) -> None:
    """Neither a Gauss-Markov term nor a low-pass filter is a hump."""
    samples = simulated("N=1e-4 + GM(sigma=5e-4, T=0.5) + K=1e-5", 60_000, seed, rate_hz=100.0)
    smooth = signal.lfilter([0.2], [1, -0.8], samples - samples[0])[200:]
    for own in (samples, smooth):
        assert all(finding.code != "hump" for finding in fitted(own, rate_hz=100.0).findings)


@pytest.mark.parametrize("times", [1, 15])
@pytest.mark.parametrize("seed", range(2))
def test_a_vibration_behind_a_filter_is_named(times: int, seed: int) -> None:
    """Half the power remains at Nyquist, with a vibration at 16 to 25 Hz; N is the plateau below both."""
    n, rate = 250_000, 100.0
    samples = simulated("N=7e-4 + B=1.5e-4", n, seed, rate_hz=rate)
    filtered = signal.lfilter([0.854, 0.146], [1.0], samples - samples[0])
    rng = np.random.default_rng([times, seed])
    passed = signal.butter(2, (0.32, 0.5), "band")
    vibration = signal.lfilter(*passed, rng.standard_normal(n)) * 7e-4 * math.sqrt(rate * (times - 1))
    fit = fitted(filtered + vibration, rate_hz=rate)
    assert ("hump" in {finding.code for finding in fit.findings}) == (times > 1)
    assert fit["N"].value == pytest.approx(7e-4, rel=0.02)


def test_a_plateau_has_no_lower_density_at_lower_frequencies() -> None:
    """A vibration band with a flat top has one, so it is a hump."""
    fraction = np.geomspace(1e-3, 1.0, 60)
    size = np.full(60, 500.0)
    plateau = np.where(fraction < 0.3, 2.0, 1.0)
    assert is_plateau(fraction[:50], size[:50], plateau[:50], plateau[20:50])
    band = np.where((fraction > 0.02) & (fraction < 0.3), 2.0, 1.0)
    assert not is_plateau(fraction[:50], size[:50], band[:50], band[26:50])
    slope = fraction**-0.5
    assert not is_plateau(fraction, size, slope, slope[:40])
