"""Tests of exact degrees of freedom: sums over all lags, published values, simulation and limits."""

import allantools
import numpy as np
import pytest

from imucal.allan import intervals
from imucal.allan.intervals import GenericModel, model_edf
from imucal.allan.variance import variances
from imucal.arrays import FloatArray
from imucal.noise import NoiseModel
from imucal.powerlaw import PowerLaw

SINGLES = [GenericModel(variances=tuple(float(law is one) for law in PowerLaw)) for one in PowerLaw]
MIXED = GenericModel(variances=(3.0, 1.0, 0.01, 1e-4))


def _every_lag(model: GenericModel, m: int, terms: int) -> float:
    """Return the degrees of freedom from squared autocovariances at every lag, by the definition of V(n)."""
    k = np.arange(terms, dtype=np.float64)
    s = np.zeros(terms)
    for law, variance in zip(PowerLaw, model.variances, strict=True):
        V = law.sum_variance
        comb = -6 * V(k) + 4 * V(k - m) + 4 * V(k + m) - V(k - 2 * m) - V(k + 2 * m)
        inside = (k <= 2 * m) | (law is PowerLaw.FLICKER)
        s += variance * np.where(inside, comb, 0.0) / (4 * m * m)
    weighted = (1 - k / terms) * s**2
    return float(terms * s[0] ** 2 / (2 * weighted.sum() - weighted[0]))


@pytest.mark.parametrize("model", [*SINGLES, MIXED], ids=lambda model: str(model.variances))
@pytest.mark.parametrize(
    ("n", "m"), [(100, 1), (4096, 3), (4096, 100), (4096, 1024), (60_000, 700), (60_000, 15_000)]
)
def test_the_graded_sum_agrees_with_the_sum_over_all_lags(model: GenericModel, n: int, m: int) -> None:
    """The tolerance of 2e-4 is far below the effect on an interval."""
    terms = n + 1 - 2 * m
    assert model_edf(model, m, terms) == pytest.approx(_every_lag(model, m, terms), rel=2e-4)


@pytest.mark.parametrize("model", [*SINGLES, MIXED])
def test_one_difference_has_one_degree_of_freedom(model: GenericModel) -> None:
    """At m = n/2 there is a single term."""
    assert model_edf(model, 50, 1) == pytest.approx(1.0)


def test_the_degrees_of_freedom_at_a_quarter_of_the_record() -> None:
    """At m = n/4, white noise has 4 (exact for large n) and a random walk 2.24."""
    assert model_edf(SINGLES[1], 25_000, 50_001) == pytest.approx(4.0, rel=2e-4)
    assert model_edf(SINGLES[3], 25_000, 50_001) == pytest.approx(2.24, rel=2e-3)


@pytest.mark.parametrize(("law", "alpha"), [(1, 0), (2, -1), (3, -2)])
def test_degrees_of_freedom_agree_with_greenhall_and_riley(law: int, alpha: int) -> None:
    """Their values are for continuous noise, so they agree to 3 % at m = 50."""
    n, m = 10_000, 50
    peer = allantools.edf_greenhall(alpha=alpha, d=2, m=m, N=n + 1, overlapping=True, modified=False)
    assert model_edf(SINGLES[law], m, n + 1 - 2 * m) == pytest.approx(peer, rel=0.03)


def _spread(samples: list[FloatArray], m: int) -> float:
    values = np.array([variances(one, np.array([m]))[0] for one in samples])
    return float(2 * values.mean() ** 2 / values.var())


def test_degrees_of_freedom_agree_with_simulated_series() -> None:
    """2 mean² / variance of 1000 simulated values agrees within four of its standard errors."""
    rng = np.random.default_rng(8)
    noise = NoiseModel.parse("Q=1 + N=1 + B=0.3 + K=0.05")
    model = GenericModel(variances=(1.0, 1.0, 0.09, 0.0025))
    samples = [noise.simulate(600, rate_hz=1.0, rng=rng) for _ in range(1000)]
    for m in (1, 8, 40):
        expected = model_edf(model, m, 601 - 2 * m)
        # Relative error of the variance of 1000 chi-squared values with few degrees of freedom.
        error = np.sqrt((2 + 12 / expected) / 1000)
        assert _spread(samples, m) == pytest.approx(expected, rel=4 * error)


def test_a_drift_increases_the_degrees_of_freedom() -> None:
    """The mean of a difference has no variance."""
    plain = GenericModel(variances=(0.0, 1.0, 0.0, 0.0))
    drifting = GenericModel(variances=(0.0, 1.0, 0.0, 0.0), drift=1e-2)
    rng = np.random.default_rng(9)
    ramp = 1e-2 * np.arange(600.0)
    samples = [rng.standard_normal(600) + ramp for _ in range(1000)]
    expected = model_edf(drifting, 40, 521)
    assert expected > model_edf(plain, 40, 521)
    assert _spread(samples, 40) == pytest.approx(expected, rel=0.25)


def test_the_scale_of_the_model_does_not_matter() -> None:
    """Only ratios of the terms count."""
    large = GenericModel(variances=tuple(1e12 * v for v in MIXED.variances))
    assert model_edf(large, 30, 900) == pytest.approx(model_edf(MIXED, 30, 900))


def test_a_model_without_noise_counts_as_white_noise() -> None:
    """A constant series has no spectrum."""
    nothing = GenericModel(variances=(0.0, 0.0, 0.0, 0.0))
    assert model_edf(nothing, 4, 90) == model_edf(SINGLES[1], 4, 90)


@pytest.mark.parametrize("law", PowerLaw)
@pytest.mark.parametrize("m", [1, 7])
def test_the_covariance_at_lag_zero_is_the_allan_variance(law: PowerLaw, m: int) -> None:
    found = intervals._covariance(law, np.zeros(1), m)
    assert found[0] == pytest.approx(float(law.avar(np.array([float(m)]))[0]), rel=1e-9)
