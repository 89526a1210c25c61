"""Tests of goodness of fit, heavy tails and agreement with the exact likelihood."""

import numpy as np
import pytest

from imucal.fitting.robust import heavy_tails
from imucal.fitting.spectral.likelihood import evaluate
from imucal.fitting.spectral.maximum import misfit
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
