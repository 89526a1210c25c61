"""Vibration in a band of frequencies is left out of the fit, and nothing else is taken for it."""

import numpy as np
import pytest
from scipy import signal

from imucal.fitting.spectral.hump import largest_run
from tests.fitting.fits import fitted, simulated


def test_the_largest_run_is_that_of_all_pairs() -> None:
    """First, last and sum, against a search through all runs."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        values = rng.standard_normal(12)
        first, last, total = largest_run(values)
        every = {(i, j): values[i : j + 1].sum() for i in range(12) for j in range(i, 12)}
        assert total == pytest.approx(max(every.values()))
        assert every[first, last] == pytest.approx(total)


@pytest.mark.parametrize("times", [5, 26])
def test_a_hump_is_left_out(times: int) -> None:
    """N and B are those of the noise below and above a band of vibration, which a warning names."""
    n, rate = 60_000, 100.0
    passed = signal.butter(1, (0.02, 0.05), "band")
    held = {"N": 0, "B": 0}
    for seed in range(6):
        rng = np.random.default_rng([times, seed])
        vibration = signal.lfilter(*passed, rng.standard_normal(n)) * 1e-4 * np.sqrt(rate * (times - 1))
        fit = fitted(simulated("N=1e-4 + B=5e-5", n, seed, rate_hz=rate) + vibration, rate_hz=rate)
        held["N"] += fit["N"].low <= 1e-4 <= fit["N"].high
        held["B"] += fit["B"].low <= 5e-5 <= fit["B"].high
        (found,) = (finding for finding in fit.findings if finding.code in {"hump", "output-filter"})
        assert (found.code, found.level) == ("hump", "warning")
    assert held["N"] >= 5
    assert held["B"] >= 5


@pytest.mark.parametrize("seed", range(3))
def test_noise_without_vibration_has_no_hump(seed: int) -> None:
    """Neither a Gauss-Markov term nor a low-pass filter is one."""
    samples = simulated("N=1e-4 + GM(sigma=5e-4, T=0.5) + K=1e-5", 60_000, seed, rate_hz=100.0)
    smooth = signal.lfilter([0.2], [1, -0.8], samples - samples[0])[200:]
    for own in (samples, smooth):
        assert all(finding.code != "hump" for finding in fitted(own, rate_hz=100.0).findings)
