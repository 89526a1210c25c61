"""The merging filter beside sums over all courses of the level, and dense Gaussian likelihoods."""

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.fitting.spectral.telegraph import _LEAST, Mixtures, _filtered, log_likelihoods
from imucal.noise.terms import GaussMarkov

N = 10


def mixtures(rows: int = 1, **changed: float) -> Mixtures:
    """Return `rows` mixtures, all the same."""
    values = {"white": 0.5, "flicker": 0.02, "walk": 0.01, "markov": 0.8, "time": 3.0} | changed
    return Mixtures(**{name: np.full(rows, value) for name, value in values.items()})


def dense(n: int, total: float, m: Mixtures, *, markov: bool) -> FloatArray:
    """Return the covariance of n samples of a mixture, whose walk begins as the filter's does."""
    t = np.arange(n)
    apart = np.abs(t[:, None] - t)
    both = np.minimum(t[:, None], t)
    start = max(total - float(m.markov[0]), _LEAST * total)
    found = m.white[0] * np.eye(n) + start + m.walk[0] * both
    for term in GaussMarkov.bank(1.0, 0.5, n / 3, 1.0):
        found = found + m.flicker[0] * term.sigma**2 * np.exp(-apart / term.T)
    return np.asarray(found + (m.markov[0] * np.exp(-apart / m.time[0]) if markov else 0.0))


def log_density(x: FloatArray, covariance: FloatArray) -> float:
    """Return the log density of a normal of mean 0."""
    factor = np.linalg.cholesky(covariance)
    whitened = np.linalg.solve(factor, x)
    return float(-0.5 * (whitened @ whitened + x.size * np.log(2 * np.pi)) - np.log(np.diag(factor)).sum())


def test_without_levels_it_is_the_gaussian_likelihood() -> None:
    """Of noise whose covariance is written out."""
    samples = np.random.default_rng(201).standard_normal(40)
    m = mixtures()
    found = _filtered(samples[:, None], m, np.array([False])).sum()
    assert found == pytest.approx(
        log_density(samples, dense(40, float(samples.var()), m, markov=True)), rel=1e-9
    )


def test_with_levels_it_is_the_sum_over_all_courses() -> None:
    """Of 2^10 courses, where a sample after a jump lies anywhere between the levels; merging costs little."""
    m = mixtures()
    size = float(np.sqrt(m.markov[0]))
    stay = 0.5 * (1 + np.exp(-1 / m.time[0]))
    rng = np.random.default_rng(211)
    differences = []
    for _ in range(8):
        level = size * np.repeat(rng.choice([-1.0, 1.0], 3), [4, 3, 3])
        samples = level + np.sqrt(0.5) * rng.standard_normal(N)
        covariance = dense(N, float(samples.var()), m, markov=False)
        exact = -np.inf
        # The level before the first sample is as likely either, and may have jumped.
        for course in np.ndindex(*(2,) * (N + 1)):
            levels = np.array(course)
            jumps = np.diff(levels) != 0
            chance = 0.5 * np.prod(np.where(jumps, 1 - stay, stay))
            mean = np.where(jumps, 0.0, size * (2 * levels[1:] - 1))
            own = covariance + np.diag(np.where(jumps, size**2 / 3, 0.0))
            exact = np.logaddexp(exact, np.log(chance) + log_density(samples - mean, own))
        differences.append(float(_filtered(samples[:, None], m, np.array([True])).sum()) - exact)
    assert np.max(np.abs(differences)) < 0.3
    assert abs(np.mean(differences)) < 0.1


def test_rows_are_judged_each_by_itself() -> None:
    """Two levels and Gaussian noise side by side."""
    samples = np.random.default_rng(221).standard_normal(300)
    alone = [float(log_likelihoods(samples, mixtures(), np.array([kind]))[0]) for kind in (True, False)]
    together = log_likelihoods(samples, mixtures(2), np.array([True, False]))
    np.testing.assert_allclose(together, alone, rtol=1e-12)


def test_pieces_lose_little() -> None:
    """Eight pieces, each judged after 64 samples, beside one filter of the whole."""
    rng = np.random.default_rng(222)
    samples = rng.standard_normal(1024) + np.repeat(rng.choice([-1.0, 1.0], 64), 16)
    both = np.array([True, False])
    whole = _filtered(np.repeat(samples[:, None], 2, axis=1), mixtures(2), both).sum(axis=0)
    parts = log_likelihoods(samples, mixtures(2), both)
    assert parts[0] - parts[1] == pytest.approx(whole[0] - whole[1], abs=2.0)


def test_it_scales() -> None:
    """Samples of twice the size in four times the variance lose log 2 each."""
    samples = np.random.default_rng(223).standard_normal(200)
    double = mixtures(white=2.0, flicker=0.08, walk=0.04, markov=3.2)
    one = _filtered(samples[:, None], mixtures(), np.array([True])).sum()
    two = _filtered(2 * samples[:, None], double, np.array([True])).sum()
    assert two == pytest.approx(one - 200 * np.log(2), rel=1e-12)
