"""Tones and roll-off: their figures against the truth, and what is no tone."""

import numpy as np
import pytest

from imucal.recording import AxisSeries
from imucal.screening.density import corner, likely_cause, tones
from imucal.screening.windows import density, profile
from tests.screening.still import KINDS

N, RATE = 60_000, 200.0
NONE = np.zeros(0, dtype=np.int64)


def axis(samples: np.ndarray[tuple[int], np.dtype[np.float64]]) -> AxisSeries:
    return AxisSeries.from_samples(samples, rate_hz=RATE)


@pytest.mark.parametrize("frequency", [3.0, 17.3, 41.9, 93.1])
@pytest.mark.parametrize("amplitude", [0.2, 1.0])
def test_frequency_and_amplitude(frequency: float, amplitude: float) -> None:
    """The frequency to a tenth of a bin, the amplitude to 5 %: a bin beside a Hann lobe loses no more."""
    rng = np.random.default_rng(1)
    samples = rng.standard_normal(N) + amplitude * np.sin(2 * np.pi * frequency * np.arange(N) / RATE + 1)
    spectrum = density(axis(samples), avoid=NONE, width=100)
    assert spectrum is not None
    (tone,) = tones(spectrum)
    assert tone.frequency_hz == pytest.approx(frequency, abs=0.1 * spectrum.spacing_hz)
    # The noise in the line's 7 bins adds its own error, below 5 % for the weaker one too.
    assert tone.amplitude == pytest.approx(amplitude, rel=0.08)


def test_hump_is_what_the_tone_adds_to_the_allan_variance() -> None:
    """The closed form of the peak against A^2 sin^4(x)/x^2 over tau, and the white noise there."""
    amplitude, frequency = 0.5, 10.0
    rng = np.random.default_rng(2)
    samples = rng.standard_normal(N) + amplitude * np.sin(2 * np.pi * frequency * np.arange(N) / RATE)
    spectrum = density(axis(samples), avoid=NONE, width=100)
    assert spectrum is not None
    (tone,) = tones(spectrum)
    tau = np.linspace(0.01, 0.1, 10_000)
    x = np.pi * frequency * tau
    avar = (amplitude * np.sin(x) ** 2 / x) ** 2
    top = int(avar.argmax())
    white = 1 / RATE / tau[top]
    assert tone.hump == pytest.approx(avar[top] / white, rel=0.15)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "rounded"])
def test_noise_is_no_tone(kind: str) -> None:
    """Neither slopes, nor filters, nor resonances are lines."""
    for seed in range(3):
        samples = KINDS[kind](N, np.random.default_rng(20 + seed))
        spectrum = density(axis(samples), avoid=NONE, width=100)
        assert spectrum is not None
        assert tones(spectrum) == ()


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
def test_likely_causes(frequency: float, rate: float, cause: str) -> None:
    """Mains also where the sampling folds them; else by the range of the frequency."""
    assert likely_cause(frequency, rate_hz=rate, resolution_hz=0.1) == cause


@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize("cutoff", [0.15, 0.3, 0.5])
def test_the_corner_of_a_filter(order: int, cutoff: float) -> None:
    """Half power of a Butterworth filter of known corner: to the width of a band or two.

    A one-pole filter falls within its plateau already, which puts the half of that further up.
    """
    from scipy.signal import butter, sosfilt

    samples = sosfilt(butter(order, cutoff, output="sos"), np.random.default_rng(3).standard_normal(4 * N))
    spectrum = density(axis(samples), avoid=NONE, width=100)
    assert spectrum is not None
    assert corner(spectrum) == pytest.approx(cutoff * RATE / 2, rel=0.25 if order == 1 else 0.12)


@pytest.mark.parametrize("kind", ["white", "flicker", "random walk", "strong random walk", "quantization"])
def test_noise_without_a_filter_has_no_corner(kind: str) -> None:
    """A density that is flat, or falls all the way, is no filter's."""
    for seed in range(5):
        spectrum = profile(axis(KINDS[kind](N, np.random.default_rng(40 + seed)))).density
        assert spectrum is not None
        assert corner(spectrum) is None


def test_density_of_white_noise_is_flat_and_two_sided() -> None:
    """Unit deviation at 200 Hz is 1/200 per Hz, each value with the spread its degrees of freedom say."""
    spectrum = density(axis(np.random.default_rng(5).standard_normal(N)), avoid=NONE, width=100)
    assert spectrum is not None
    inner = spectrum.psd[4:-4] * RATE
    assert inner.mean() == pytest.approx(1, abs=0.02)
    assert inner.var() == pytest.approx(2 / spectrum.edf, rel=0.2)


def test_density_avoids_disturbed_windows() -> None:
    """A stretch with a knock in it is left out."""
    samples = np.random.default_rng(6).standard_normal(N)
    samples[30_000:30_100] += 1000
    spectrum = density(axis(samples), avoid=np.array([30_000]), width=100)
    assert spectrum is not None
    assert spectrum.psd[4:-4].mean() * RATE == pytest.approx(1, abs=0.02)
