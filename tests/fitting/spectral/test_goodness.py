"""Tests of goodness of fit, heavy tails and agreement with the exact likelihood."""

import numpy as np
import pytest
from scipy import stats
from scipy.signal import butter, sosfilt

from imucal.fitting.robust import heavy_tails
from imucal.fitting.spectral.likelihood import evaluate
from imucal.fitting.spectral.maximum import UNLIKELY, misfit, octave_score
from imucal.fitting.spectral.models import models_of
from imucal.noise.model import parse_structure
from imucal.recording import AxisSeries
from tests.fitting.fits import fitted, ordinates_of, simulated
from tests.fitting.state_space import distances


def test_the_score_of_the_true_model_is_standard_normal() -> None:
    """Its mean is 0 and its standard deviation 1 over 300 records of white noise."""
    model = models_of([("N",)], ("R",))
    scores = []
    for seed in range(300):
        data = ordinates_of(np.random.default_rng(seed).standard_normal(3000))
        scores.append(misfit(data, evaluate(data, model, np.zeros((1, 4)))).statistic)
    # Three standard errors of a mean and of a standard deviation; the sum is slightly skewed.
    assert np.mean(scores) == pytest.approx(0, abs=3 / np.sqrt(300))
    assert np.std(scores) == pytest.approx(1, abs=0.2)


def test_the_octave_score_of_the_true_model_is_a_probability() -> None:
    """It is uniform over 400 records of white noise whose level is fitted."""
    scores = []
    for seed in range(400):
        samples = np.random.default_rng([62, seed]).standard_normal(5000)
        data = ordinates_of(samples)
        model = models_of([("N",)], ("R",))
        theta = np.zeros((1, 4))
        theta[0, 1] = np.log(np.mean(samples**2))
        scores.append(octave_score(data, evaluate(data, model, theta)))
    # Four standard errors of a proportion.
    for level in (0.01, 0.1, 0.5):
        allowed = 4 * np.sqrt(level * (1 - level) / 400)
        assert np.mean(np.array(scores) < level) == pytest.approx(level, abs=allowed)


def test_the_octave_score_agrees_with_a_sum_over_each_octave() -> None:
    """The slow way: for every octave with 60 ordinates or more, one chi-squared with its own scale."""
    data = ordinates_of(simulated("N=1 + K=0.05", 4000, 9))
    model = models_of([("N", "K")], ("R",))
    found = evaluate(data, model, np.array([[0.0, 0.1, 0.0, np.log(0.05**2)]]))
    squares, scores = data.rest(found.beta[0]) / found.spectrum[0], []
    for octave in range(-12, 1):
        inside = (data.fraction >= 2.0**octave) & (data.fraction < 2.0 ** (octave + 1))
        count = data.size[inside].sum()
        if count >= 60:
            scores.append((squares[inside].sum() - count) / np.sqrt(2 * count))
    free = int(found.models.free[0].sum())
    expected = stats.chi2.sf(np.sum(np.square(scores)), len(scores) - free)
    assert len(scores) > free + 2
    assert octave_score(data, found) == pytest.approx(expected)


def test_an_octave_that_is_a_little_too_high_shows_in_its_sum_only() -> None:
    """A band of two octaves with 16 % more density: the mean square of the residuals is that of noise."""
    model = models_of([("N",)], ("R",))
    squares, octaves = [], []
    for seed in range(20):
        samples = np.random.default_rng([63, seed]).standard_normal(40_000)
        band = butter(4, (0.04, 0.16), "band", output="sos")
        samples += 0.4 * sosfilt(band, np.random.default_rng([64, seed]).standard_normal(40_000))
        data = ordinates_of(samples)
        theta = np.zeros((1, 4))
        theta[0, 1] = np.log(np.mean(samples**2))
        found = evaluate(data, model, theta)
        squares.append(misfit(data, found).statistic < 3)
        octaves.append(octave_score(data, found) < UNLIKELY)
    assert sum(squares) >= 12
    assert sum(octaves) >= 16


def test_a_wrong_model_has_a_misfit() -> None:
    """White noise and quantization do not describe a Gauss-Markov term."""
    result = fitted(simulated("N=1 + GM(sigma=2, T=30)", 20_000, 1), "N + Q")
    assert result.goodness.statistic > 3
    assert result.goodness.p_value < 0.01
    texts = [f.text for f in result.findings if f.code == "model-misfit"]
    assert len(texts) == 1
    assert "does not describe this axis" in texts[0]


def test_normal_tails_do_not_widen_n() -> None:
    """The factor is exactly 1 unless the tails are heavier than chance."""
    assert heavy_tails(np.random.default_rng(1).standard_normal(20_000)) == 1.0


def test_heavy_tails_widen_n() -> None:
    """Laplace noise has excess kurtosis 3: the variance of its power is 1 + 3/2 that of normal noise."""
    factor = heavy_tails(np.random.default_rng(2).laplace(size=400_000))
    assert factor == pytest.approx(np.sqrt(2.5), rel=0.05)


@pytest.mark.slow
def test_the_interval_of_n_covers_laplace_noise() -> None:
    hits = 0
    for seed in range(60):
        samples = np.random.default_rng(seed).laplace(size=4000) / np.sqrt(2)
        result = fitted(samples, "N")
        hits += result["N"].low <= 1 <= result["N"].high
    # Three standard errors of a proportion of 0.95 in sixty records.
    assert hits / 60 >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / 60)


@pytest.mark.parametrize("text", ["N=1 + K=0.02", "Q=2 + N=1 + K=0.02", "N=1 + GM(sigma=0.5, T=50)"])
def test_the_maximum_agrees_with_the_exact_likelihood(text: str) -> None:
    """The maximum of the state-space likelihood is within 0.1 standard errors, or 0.2 with GM."""
    samples = simulated(text, 20_000, 5)
    structure = " + ".join(part.split("=")[0].split("(")[0] for part in text.split(" + "))
    result = fitted(samples, structure)
    series = AxisSeries.from_samples(samples, rate_hz=1.0)
    found = distances(series, result.model, result.parameters, result.covariance)
    assert parse_structure(structure) == tuple(term.symbol for term in result.model.terms)
    assert max(found.values()) < 0.2 if "GM" in text else max(found.values()) < 0.1
