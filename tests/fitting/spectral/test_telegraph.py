"""Two levels are told from Gaussian noise of the same spectrum."""

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.fitting.spectral.telegraph import find_telegraph, telegraph_finding
from imucal.noise.model import NoiseModel
from imucal.recording import AxisSeries
from tests.fitting.fits import fitted, simulated

N = 40_000


def telegraph(n: int, dwell: float, rng: np.random.Generator) -> FloatArray:
    """Return +1 and -1 in turn, each for an exponential time."""
    times = np.cumsum(rng.exponential(dwell, int(3 * n / dwell) + 20))
    return np.where(np.searchsorted(times, np.arange(n)) % 2, 1.0, -1.0)


@pytest.mark.parametrize(
    ("amplitude", "dwell", "text"),
    [
        (0.6, 800.0, "N=1"),
        (3.0, 300.0, "N=1"),
        (2.0, 1000.0, "N=1 + B=0.1 + K=2e-3"),
    ],
)
def test_two_levels_are_found(amplitude: float, dwell: float, text: str) -> None:
    """With their distance and the mean time between jumps, which a record of few jumps leaves open."""
    rng = np.random.default_rng(71)
    samples = simulated(text, N, 72) + amplitude * telegraph(N, dwell, rng)
    found = find_telegraph(AxisSeries.from_samples(1e-4 * samples, rate_hz=10.0))
    assert found is not None
    assert found.amplitude == pytest.approx(1e-4 * amplitude, rel=0.15)
    assert found.dwell_s == pytest.approx(dwell / 10, rel=0.5)
    assert not found.sawtooth


def test_the_finding_is_a_warning_and_no_step_is_taken_out() -> None:
    """A few steps out of fifty would leave the noise as it was."""
    samples = simulated("N=1", N, 73) + 2 * telegraph(N, 800.0, np.random.default_rng(74))
    fit = fitted(samples, rate_hz=10.0)
    (finding,) = [finding for finding in fit.findings if finding.code == "telegraph"]
    assert finding.level == "warning"
    assert finding.text.startswith("The level jumps between two values, ±")
    assert float(finding.text.partition("±")[2].split()[0]) == pytest.approx(2, rel=0.1)
    assert not any(finding.code == "step" for finding in fit.findings)
    assert fit.taken_out == {}


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_sawtooth_is_no_telegraph(way: float) -> None:
    """Ramps of unequal length and jumps back, up or down; a telegraph's jumps are as many up as down."""
    rng = np.random.default_rng(76)
    named = 0
    for seed in range(4):
        resets = np.cumsum([0.0, *rng.uniform(2000, 6000, 40)])
        ramp = np.arange(N) - resets[np.searchsorted(resets, np.arange(N), side="right") - 1]
        samples = simulated("N=1e-4 + B=1e-5 + K=1e-6", N, 77 + seed, rate_hz=20.0) + way * 5e-8 * ramp
        series = AxisSeries.from_samples(samples, rate_hz=20.0)
        found = find_telegraph(series)
        assert found is None or found.sawtooth
        if found is not None:
            named += 1
            (finding,) = telegraph_finding(found, series)
            assert (finding.level, finding.code) == ("warning", "sawtooth")
            assert finding.text.startswith("The level ramps and jumps back by about ")
    assert named >= 2


@pytest.mark.parametrize(
    "text",
    ["N=1", "N=1 + K=1e-2", "N=1 + B=0.3 + K=1e-3", "N=1 + GM(sigma=0.6, T=400)", "N=1 + GM(sigma=2, T=800)"],
)
def test_gaussian_noise_has_no_levels(text: str) -> None:
    """Of 4 records of each; also a Gauss-Markov process of the very spectrum of two levels."""
    for seed in range(80, 84):
        assert find_telegraph(AxisSeries.from_samples(simulated(text, N, seed), rate_hz=10.0)) is None


@pytest.mark.parametrize("steps", [1, 3])
def test_a_few_jumps_are_steps(steps: int) -> None:
    """A level that moves once or a few times in a record says nothing of a chance to jump."""
    place = np.arange(N) * (steps + 1) // N
    samples = simulated("N=1", N, 78) + 20 * (place % 2)
    assert find_telegraph(AxisSeries.from_samples(samples, rate_hz=10.0)) is None


def test_short_records_are_not_judged() -> None:
    """Fewer than 256 spans of 8 samples hold too few jumps."""
    samples = np.repeat([1.0, -1.0], 1000) + 0.1 * np.random.default_rng(75).standard_normal(2000)
    assert find_telegraph(AxisSeries.from_samples(samples, rate_hz=10.0)) is None


@pytest.mark.parametrize("seed", range(90, 95))
def test_weak_levels_are_found_beside_flicker_and_a_walk(seed: int) -> None:
    """Of less than a span's noise, every 40 s in 33 min; beside three times the flicker and walk in half."""
    text = "N=1e-4 + B=1e-5 + K=1e-6"
    samples = NoiseModel.parse(text).simulate(200_000, rate_hz=100.0, rng=np.random.default_rng(seed))
    samples = samples + 6e-5 * telegraph(200_000, 4000.0, np.random.default_rng([seed, 1]))
    found = find_telegraph(AxisSeries.from_samples(samples, rate_hz=100.0))
    assert found is not None
    assert found.amplitude == pytest.approx(6e-5, rel=0.3)


def test_a_cycle_is_no_telegraph() -> None:
    """It keeps to two sides of a mean too."""
    place = np.arange(N)
    for periods in (5.2, 13.1, 40.0):
        samples = simulated("N=1", N, 79) + 0.6 * np.sin(2 * np.pi * periods * place / N)
        assert find_telegraph(AxisSeries.from_samples(samples, rate_hz=10.0)) is None


def test_a_level_without_noise_is_judged() -> None:
    """Samples of two values alone."""
    samples = 1e-4 * telegraph(N, 800.0, np.random.default_rng(96))
    find_telegraph(AxisSeries.from_samples(samples, rate_hz=10.0))
