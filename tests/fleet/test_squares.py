"""Tests of estimates of squared coefficients, compared with SciPy's gamma law."""

import numpy as np
import numpy.testing as npt
import pytest
from scipy import stats

from imucal.arrays import FloatArray
from imucal.fleet.values import Squares

GRID = np.linspace(0.0, 6.0, 61)


def _squares(growth: float) -> Squares:
    return Squares(np.array([-0.4, 0.3, 2.5]), np.array([0.5, 0.5, 0.8]), np.full(3, growth))


def _exact(squares: Squares) -> dict[str, FloatArray]:
    """Return the gamma parameters for each square of the grid plus its background, minus the background."""
    background, growth = (squares.sd / squares.growth)[:, None], squares.growth[:, None]
    return {"a": growth**-2.0, "loc": -background, "scale": (GRID + background) * growth**2}


@pytest.mark.parametrize("growth", [0.05, 0.3, 0.7])
def test_the_law_is_a_chi_square_on_a_background(growth: float) -> None:
    """Likelihood, probability, mean and standard deviation agree with SciPy."""
    squares = _squares(growth)
    law, estimate = _exact(squares), squares.estimate[:, None]
    npt.assert_allclose(stats.gamma.mean(**law), np.broadcast_to(GRID, (3, 61)), atol=1e-12)
    deviations = np.array([squares.deviation(square) for square in GRID.tolist()]).T
    npt.assert_allclose(stats.gamma.std(**law), deviations)
    ours, exact = squares.log_likelihood(GRID), np.asarray(stats.gamma.logpdf(estimate, **law))
    npt.assert_allclose(ours - ours[:, :1], exact - exact[:, :1], atol=1e-7)
    # Far below, the law has a longer tail because other coefficients are unknown.
    normal = stats.norm.cdf((estimate - GRID) / deviations)
    chance = stats.gamma.cdf(estimate, **law)
    exact = np.where(estimate < GRID, np.maximum(normal, chance), chance)
    npt.assert_allclose(squares.below(GRID), exact, atol=0.006)


def test_a_constant_deviation_gives_a_normal_law() -> None:
    """A deviation that hardly grows is nearly normal, without a jump between the two."""
    plain, nearly = _squares(0.0), _squares(1.01e-4)
    exact = np.asarray(stats.norm.logpdf(plain.estimate[:, None], GRID, plain.sd[:, None]))
    ours = plain.log_likelihood(GRID)
    npt.assert_allclose(ours - ours[:, :1], exact - exact[:, :1], atol=1e-9)
    chance = np.asarray(stats.norm.cdf(plain.estimate[:, None], GRID, plain.sd[:, None]))
    npt.assert_allclose(plain.below(GRID), chance)
    npt.assert_allclose(nearly.log_likelihood(GRID), ours, rtol=3e-3, atol=1e-5)
    npt.assert_allclose(nearly.below(GRID), plain.below(GRID), atol=2e-4)


@pytest.mark.parametrize("growth", [0.0, 0.5])
def test_the_most_likely_square_is_the_estimate(growth: float) -> None:
    """For a negative estimate it is zero; the maximum is 1, also for an impossible estimate."""
    squares = Squares(np.array([2.0, -0.3, -5.0]), np.full(3, 0.5), np.full(3, growth))
    height = squares.log_likelihood(np.linspace(0, 8, 801))
    assert height.argmax(axis=1).tolist() == [200, 0, 0]
    npt.assert_allclose(height.max(axis=1), 0.0, atol=1e-12)
    assert np.isfinite(height).all()
    assert np.isfinite(squares.below(GRID)).all()


def test_the_mean_of_a_group_has_the_error_of_independent_estimates() -> None:
    """Weights are optimal at the given square; n equal estimates have the deviation over sqrt(n)."""
    squares = Squares(np.array([1.0, 3.0, 2.0]), np.array([0.6, 0.6, 0.1]), np.array([0.4, 0.4, 0.2]))
    found = squares.mean_by(np.array([0, 0, 1]), 2.0)
    npt.assert_allclose(found.estimate, [2.0, 2.0])
    npt.assert_allclose(found.sd, [0.6 / np.sqrt(2), 0.1])
    npt.assert_allclose(found.growth, [0.4 / np.sqrt(2), 0.2])
    at_zero = squares.mean_by(np.array([0, 0, 1]), 0.0)
    npt.assert_allclose(at_zero.growth, found.growth, rtol=1e-6)
    one = squares.mean_by(np.zeros(3, dtype=np.int64), 2.0)
    weight = squares.deviation(2.0) ** -2.0
    npt.assert_allclose(one.estimate, np.average(squares.estimate, weights=weight))
    npt.assert_allclose(one.deviation(2.0), weight.sum() ** -0.5)


def test_a_pooled_square_is_unbiased_with_wrong_deviations() -> None:
    """Weights at one common square do not depend on the draws: 4000 draws with wrong deviations."""
    rng = np.random.default_rng(77)
    truth, sd, growth = 1.0, 0.2, 0.5
    background = sd / growth
    draws = rng.gamma(growth**-2.0, (truth + background) * growth**2, size=4000) - background
    wrong = Squares(draws, rng.choice([0.1, 0.3], 4000), rng.choice([0.3, 0.6], 4000))
    found = wrong.mean_by(np.zeros(4000, dtype=np.int64), truth)
    assert abs(found.estimate[0] - truth) < 3 * (sd + growth * truth) / np.sqrt(2000)
