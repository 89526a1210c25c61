"""Tests of the log-binned power spectral density."""

import numpy as np
import pytest

from imucal.allan import spectrum
from imucal.errors import DataError
from imucal.noise import NoiseModel
from imucal.recording import AxisSeries


def _series(samples: np.ndarray[tuple[int], np.dtype[np.float64]], rate_hz: float = 200.0) -> AxisSeries:
    return AxisSeries.from_samples(samples, rate_hz=rate_hz)


def test_the_density_of_white_noise_is_the_square_of_its_coefficient() -> None:
    """It is N² in U²/Hz, two-sided, at every frequency; the scatter of a bin depends on its count."""
    model = NoiseModel.parse("N=2e-3")
    samples = model.simulate(200_000, rate_hz=200.0, rng=np.random.default_rng(0))
    psd = spectrum(_series(samples))
    score = (psd.psd / (2e-3) ** 2 - 1) * np.sqrt(psd.count / 2)
    wide = psd.count > 100
    # Four standard errors for about sixty bins.
    assert np.all(np.abs(score[wide]) < 4)
    assert psd.count.sum() == 199_999
    assert psd.frequency[0] == pytest.approx(0.5 / 1000)
    assert psd.frequency[-1] < 100.0


def test_power_adds_up_to_the_variance() -> None:
    """The integral of the two-sided density is the variance."""
    samples = np.random.default_rng(1).standard_normal(10_000)
    psd = spectrum(_series(samples, 50.0))
    assert float(psd.psd @ psd.count) * 50.0 / 10_000 == pytest.approx(samples.var(), rel=1e-9)


def test_a_random_walk_does_not_leak() -> None:
    """Leakage makes raw periodograms of a random walk twice too high; the DCT's density is right."""
    model, rng = NoiseModel.parse("K=1"), np.random.default_rng(2)
    ratios = []
    for _ in range(40):
        psd = spectrum(_series(model.simulate(4096, rate_hz=1.0, rng=rng), 1.0), per_octave=96)
        ratio = psd.psd / model.psd(psd.frequency, rate_hz=1.0)
        ratios.append(np.average(ratio, weights=psd.count))
    # Four standard errors of a mean of 40 * 4095 squared normal values.
    assert np.mean(ratios) == pytest.approx(1.0, abs=4 * np.sqrt(2 / (40 * 4095)))


def test_runs_between_gaps_are_averaged_by_bins() -> None:
    """Every run contributes its own ordinates, and no sample is invented."""
    samples = np.random.default_rng(3).standard_normal(30_000)
    keep = np.ones(30_000, dtype=bool)
    keep[5000:6000] = keep[20_000] = False
    samples[100] = np.nan
    psd = spectrum(_series(samples).keeping(keep))
    assert psd.count.sum() == 30_000 - 1000 - 1 - 1 - 4
    assert np.average(psd.psd, weights=psd.count) == pytest.approx(1 / 200, rel=0.03)


def test_a_series_without_adjacent_samples_is_rejected() -> None:
    """The error contains the required number."""
    with pytest.raises(DataError) as caught:
        spectrum(_series(np.array([1.0, np.nan, 2.0])))
    assert str(caught.value) == "gyro_x: a spectrum needs at least 2 neighbouring samples, got 2 samples"


def test_the_lowest_eight_frequencies_have_their_own_bins() -> None:
    """With one bin per octave, each higher bin is an octave from the ninth frequency."""
    samples = np.random.default_rng(2).standard_normal(100)
    psd = spectrum(_series(samples), per_octave=1)
    assert psd.count.tolist() == [1.0] * 8 + [9.0, 18.0, 36.0, 28.0]
