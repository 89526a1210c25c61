"""Covariance of means: against matrices, spectra and drawn records."""

import numpy as np
import pytest

from imucal.calibration.mean_covariance import mean_covariance, white_model
from imucal.noise import NoiseModel

SPANS = np.array([[0, 40], [60, 90], [90, 155], [200, 240]])
SAMPLES, RATE = 240, 10.0


def averages() -> np.ndarray:
    """Return the weights of each span's mean, shape (4, 240)."""
    weights = np.zeros((len(SPANS), SAMPLES))
    for row, (first, end) in zip(weights, SPANS, strict=True):
        row[first:end] = 1 / (end - first)
    return weights


def contrasts() -> np.ndarray:
    """Return the weights of each span's mean minus the mean over the log, shape (4, 240)."""
    return averages() - 1 / SAMPLES


def test_white_noise_and_walk_against_their_matrices() -> None:
    """Independent samples with variance N² rate; cumulative sums of steps with variance K² / rate.

    The mean of the walk over the log is part of the bias, the mean of white noise is not.
    """
    n = np.arange(SAMPLES) + 1.0
    white = 0.3**2 * RATE * averages() @ averages().T
    walk = 0.02**2 / RATE * contrasts() @ np.minimum.outer(n, n) @ contrasts().T
    found = mean_covariance(NoiseModel.parse("N=0.3 + K=0.02"), SPANS, rate_hz=RATE, samples=SAMPLES)
    np.testing.assert_allclose(found, white + walk, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("text", ["B=0.1", "GM(sigma=0.2, T=3)", "Q=0.01"])
def test_other_terms_against_their_spectrum(text: str) -> None:
    """The variance of a contrast is the integral of the spectrum times its squared transform."""
    model = NoiseModel.parse(text)
    length = 1 << 20
    f = np.arange(1, length) * RATE / length
    transforms = np.fft.fft(contrasts(), length)[:, 1:]
    power = model.psd(np.minimum(f, RATE - f), rate_hz=RATE) * RATE / length
    expected = ((transforms * power) @ transforms.conj().T).real
    found = mean_covariance(model, SPANS, rate_hz=RATE, samples=SAMPLES)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-5 * expected.max())


def test_drawn_records_have_this_covariance() -> None:
    """2 000 draws of white noise, flicker and walk."""
    white, slow = NoiseModel.parse("N=0.1"), NoiseModel.parse("B=0.1 + K=0.02")
    rng = np.random.default_rng(6101)
    draws = np.array(
        [
            averages() @ white.simulate(SAMPLES, rate_hz=RATE, rng=rng)
            + contrasts() @ slow.simulate(SAMPLES, rate_hz=RATE, rng=rng)
            for _ in range(2000)
        ]
    )
    found = mean_covariance(NoiseModel.parse("N=0.1 + B=0.1 + K=0.02"), SPANS, rate_hz=RATE, samples=SAMPLES)
    error = np.sqrt(np.outer(np.diag(found), np.diag(found)) / 1000)
    assert np.all(np.abs(draws.T @ draws / 2000 - found) < 5 * error)


def test_the_mean_over_the_log_deviates_from_the_bias_by_white_noise_only() -> None:
    """N²/T; slow noise is part of the bias."""
    whole = np.array([[0, SAMPLES]])
    found = mean_covariance(NoiseModel.parse("N=0.2 + K=1 + B=1"), whole, rate_hz=RATE)
    assert found[0, 0] == pytest.approx(0.2**2 * RATE / SAMPLES, rel=1e-6)


@pytest.mark.parametrize("spans", [[[5, 5]], [[-1, 4]], [[0, 300]]])
def test_impossible_spans_are_refused(spans: list[list[int]]) -> None:
    """Empty, or outside the log."""
    with pytest.raises(ValueError, match="non-empty parts"):
        mean_covariance(NoiseModel.parse("N=1"), np.array(spans), rate_hz=RATE, samples=SAMPLES)


def test_white_model_has_the_deviation_of_its_samples() -> None:
    """A single sample has that variance."""
    model = white_model(0.5, RATE)
    assert model.sum_variance(np.array([1.0]), rate_hz=RATE)[0] == pytest.approx(0.25)
