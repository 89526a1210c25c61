"""Tests of lines, filters and drifts that are found without a fit."""

import numpy as np
import pytest

from imucal.fitting.spectral.disturbances.lines import likely_cause
from imucal.fitting.spectral.disturbances.not_noise import not_noise
from imucal.recording import AxisSeries
from imucal.screening.motion import density_at_rest
from imucal.screening.windows import profile
from tests.screening.still import KINDS

N, RATE = 60_000, 200.0


def axis(samples: np.ndarray[tuple[int], np.dtype[np.float64]]) -> AxisSeries:
    return AxisSeries.from_samples(samples, rate_hz=RATE)


@pytest.mark.parametrize("amplitude", [0.08, 0.1, 0.5])
def test_a_tone_is_a_warning_if_it_bends_the_curve(amplitude: float) -> None:
    """The peak of A^2 sin^4(x)/x^2 over tau exceeds a tenth of the white noise there."""
    frequency = 10.0
    rng = np.random.default_rng(2)
    samples = rng.standard_normal(N) + amplitude * np.sin(2 * np.pi * frequency * np.arange(N) / RATE)
    (found,) = (f for f in not_noise(axis(samples)) if f.code == "tone")
    tau = np.linspace(0.01, 0.1, 10_000)
    x = np.pi * frequency * tau
    avar = (amplitude * np.sin(x) ** 2 / x) ** 2
    top = int(avar.argmax())
    bends = avar[top] > 0.1 / (RATE * tau[top])
    assert found.level == ("warning" if bends else "info")
    assert ("which bends the Allan curve" in found.text) == bends
    assert "Hz, perhaps the swaying of a building or table" in found.text
    frequency_hz = float(found.text.split(" Hz")[0].split()[-1])
    assert frequency_hz == pytest.approx(frequency, abs=RATE / N)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "rounded"])
def test_noise_is_not_a_tone(kind: str) -> None:
    """Neither slopes, nor filters, nor resonances are lines."""
    for seed in range(3):
        samples = KINDS[kind](N, np.random.default_rng(20 + seed))
        assert "tone" not in {f.code for f in not_noise(axis(samples))}


@pytest.mark.parametrize(
    ("frequency", "rate", "cause"),
    [
        (50.02, 200.0, "50 Hz mains"),
        (60.0, 400.0, "60 Hz mains"),
        (100.0, 1000.0, "50 Hz mains, harmonic 2"),
        (40.0, 160.0, "60 Hz mains, harmonic 2, folded by the sampling"),
        (49.0, 99.0, "50 Hz mains, folded by the sampling"),
        (50.0, 99.9, "50 Hz mains, folded by the sampling"),
        (62.5, 250.0, "the sampling rate over 4: the timing of the logger or the sensor"),
        (0.3, 200.0, "a beat of two clocks, or a heating or cooling cycle"),
        (7.0, 200.0, "the swaying of a building or table, or a folded higher tone"),
        (37.0, 200.0, "a fan or motor at 2220 rpm, or a folded higher tone"),
        (310.0, 1000.0, "electronics, or a resonance"),
    ],
)
def test_likely_causes_of_a_tone(frequency: float, rate: float, cause: str) -> None:
    """Mains may be folded by the sampling; other causes depend on the frequency range."""
    assert likely_cause(frequency, rate_hz=rate, resolution_hz=0.1) == cause


@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize("cutoff", [0.15, 0.3, 0.5])
def test_the_corner_of_a_filter_is_found(order: int, cutoff: float) -> None:
    """The half-power frequency of a Butterworth filter is right to 5 %; a steep filter may end below."""
    from scipy.signal import butter, sosfilt

    samples = sosfilt(butter(order, cutoff, output="sos"), np.random.default_rng(3).standard_normal(4 * N))
    (found,) = (f for f in not_noise(axis(samples)) if f.code == "roll-off")
    ratio = float(found.text.split("ear ")[1].split(" Hz")[0]) / (cutoff * RATE / 2)
    assert 0.95 < ratio < 1.05 if "falls to half" in found.text else 0.3 < ratio < 1.05


@pytest.mark.parametrize("kind", ["white", "flicker", "random walk", "strong random walk", "quantization"])
def test_noise_without_a_filter_has_no_corner(kind: str) -> None:
    """A flat or steadily falling density is not that of a filter."""
    for seed in range(5):
        found = not_noise(axis(KINDS[kind](N, np.random.default_rng(40 + seed))))
        assert "roll-off" not in {f.code for f in found}


def test_too_short_an_axis_has_no_finding() -> None:
    """It has fewer samples than a noise model needs."""
    assert not_noise(axis(np.arange(10.0))) == ()


def test_density_of_white_noise_is_flat_and_two_sided() -> None:
    """A unit deviation at 200 Hz is 1/200 per Hz."""
    psd = density_at_rest(profile(axis(np.random.default_rng(5).standard_normal(N))))
    assert psd is not None
    assert psd[4:-4].mean() * RATE == pytest.approx(1, abs=0.02)


def test_density_avoids_disturbed_windows() -> None:
    """A part with a knock is omitted."""
    samples = np.random.default_rng(6).standard_normal(N)
    samples[30_000:30_100] += 1000 * np.sin(np.arange(100))
    psd = density_at_rest(profile(axis(samples)))
    assert psd is not None
    assert psd[4:-4].mean() * RATE == pytest.approx(1, abs=0.02)
