"""Exact degrees of freedom: the sum over all lags, published values, a Monte Carlo, limits."""

import allantools
import numpy as np
import pytest

from imucal.allan import intervals
from imucal.allan.intervals import GenericModel, model_edf
from imucal.allan.variance import ESTIMATORS, Estimator, variances
from imucal.arrays import FloatArray
from imucal.noise import NoiseModel
from imucal.powerlaw import PowerLaw

OVERLAPPING = ESTIMATORS["overlapping"]
SINGLES = [GenericModel(variances=tuple(float(law is one) for law in PowerLaw)) for one in PowerLaw]
MIXED = GenericModel(variances=(3.0, 1.0, 0.01, 1e-4))


def _every_lag(model: GenericModel, m: int, terms: int) -> float:
    """Sum the squared autocovariance over every lag, from V(n) word for word."""
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
def test_the_graded_sum_is_the_sum_over_all_lags(model: GenericModel, n: int, m: int) -> None:
    """To 2e-4 of the degrees of freedom, which is far below what an interval can tell."""
    terms = OVERLAPPING.terms(n, m)
    assert model_edf(model, m, terms, OVERLAPPING) == pytest.approx(_every_lag(model, m, terms), rel=2e-4)


@pytest.mark.parametrize("model", [*SINGLES, MIXED])
def test_one_difference_has_one_degree_of_freedom(model: GenericModel) -> None:
    """At m = n/2 there is a single term."""
    assert model_edf(model, 50, 1, OVERLAPPING) == pytest.approx(1.0)


def test_the_last_octaves_of_white_noise_are_whole_numbers() -> None:
    """White noise at m = n/4 has four degrees of freedom (exact for a large n), a walk 2.24."""
    assert model_edf(SINGLES[1], 25_000, OVERLAPPING.terms(100_000, 25_000), OVERLAPPING) == pytest.approx(
        4.0, rel=2e-4
    )
    assert model_edf(SINGLES[3], 25_000, OVERLAPPING.terms(100_000, 25_000), OVERLAPPING) == pytest.approx(
        2.24, rel=2e-3
    )


@pytest.mark.parametrize(("law", "alpha"), [(1, 0), (2, -1), (3, -2)])
@pytest.mark.parametrize(
    ("name", "d", "overlapping"), [("overlapping", 2, True), ("standard", 2, False), ("hadamard", 3, True)]
)
def test_agrees_with_greenhall_and_riley(
    law: int, alpha: int, name: str, d: int, *, overlapping: bool
) -> None:
    """Their degrees of freedom are those of continuous noise; at m = 50 they agree to 3 %."""
    n, m = 10_000, 50
    peer = allantools.edf_greenhall(alpha=alpha, d=d, m=m, N=n + 1, overlapping=overlapping, modified=False)
    table = ESTIMATORS[name]
    assert model_edf(SINGLES[law], m, table.terms(n, m), table) == pytest.approx(peer, rel=0.03)


@pytest.mark.parametrize(("law", "alpha"), [(0, 2), (1, 0), (2, -1), (3, -2)])
@pytest.mark.parametrize("m", [20, 200])
def test_the_modified_estimator_agrees_with_greenhall_and_riley(law: int, alpha: int, m: int) -> None:
    """Also above m = 32, where the shape of m = 32 is scaled."""
    n, table = 20_000, ESTIMATORS["modified"]
    peer = allantools.edf_greenhall(alpha=alpha, d=2, m=m, N=n + 1, overlapping=True, modified=True)
    assert model_edf(SINGLES[law], m, table.terms(n, m), table) == pytest.approx(peer, rel=0.05)


def _spread(samples: list[FloatArray], m: int, table: Estimator) -> float:
    values = np.array([variances(one, np.array([m]), table)[0] for one in samples])
    return float(2 * values.mean() ** 2 / values.var())


@pytest.mark.parametrize("name", ESTIMATORS)
def test_is_what_a_thousand_series_show(name: str) -> None:
    """2 mean² / variance of 1000 simulated values, within four of its standard errors."""
    rng, table = np.random.default_rng(8), ESTIMATORS[name]
    text = NoiseModel.parse("Q=1 + N=1 + B=0.3 + K=0.05")
    model = GenericModel(variances=(1.0, 1.0, 0.09, 0.0025))
    samples = [text.simulate(600, rate_hz=1.0, rng=rng) for _ in range(1000)]
    for m in (1, 8, 40):
        expected = model_edf(model, m, table.terms(600, m), table)
        # The relative error of a variance of 1000 chi-squared values with few dof.
        error = np.sqrt((2 + 12 / expected) / 1000)
        assert _spread(samples, m, table) == pytest.approx(expected, rel=4 * error)


def test_a_drift_makes_values_surer() -> None:
    """The mean of a difference has no variance of its own: with drift the degrees of freedom rise."""
    plain = GenericModel(variances=(0.0, 1.0, 0.0, 0.0))
    drifting = GenericModel(variances=(0.0, 1.0, 0.0, 0.0), drift=1e-2)
    rng = np.random.default_rng(9)
    ramp = 1e-2 * np.arange(600.0)
    samples = [rng.standard_normal(600) + ramp for _ in range(1000)]
    expected = model_edf(drifting, 40, OVERLAPPING.terms(600, 40), OVERLAPPING)
    assert expected > model_edf(plain, 40, OVERLAPPING.terms(600, 40), OVERLAPPING)
    assert _spread(samples, 40, OVERLAPPING) == pytest.approx(expected, rel=0.25)


def test_the_scale_of_the_model_does_not_matter() -> None:
    """Only ratios of the terms count."""
    large = GenericModel(variances=tuple(1e12 * v for v in MIXED.variances))
    assert model_edf(large, 30, 900, OVERLAPPING) == pytest.approx(model_edf(MIXED, 30, 900, OVERLAPPING))


def test_nothing_at_all_counts_as_white_noise() -> None:
    """A constant series has no spectrum to go by."""
    nothing = GenericModel(variances=(0.0, 0.0, 0.0, 0.0))
    assert model_edf(nothing, 4, 90, OVERLAPPING) == model_edf(SINGLES[1], 4, 90, OVERLAPPING)


def test_strided_differences_count_fewer_lags() -> None:
    """Every 8-th start at m = 256 loses less than half a percent; every 128-th loses more."""
    full = model_edf(SINGLES[1], 256, 10_000, OVERLAPPING)
    assert model_edf(SINGLES[1], 256, 1250, OVERLAPPING, stride=8) == pytest.approx(full, rel=5e-3)
    assert model_edf(SINGLES[1], 256, 10_000 / 128, OVERLAPPING, stride=128) < 0.95 * full


@pytest.mark.parametrize("model", [*SINGLES, MIXED], ids=lambda model: str(model.variances))
def test_beyond_32_the_modified_variance_has_the_shape_it_has_there(
    model: GenericModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At m = 64 within 2 % of what the sum at m = 64 itself gives, of each law and of all together."""
    modified = ESTIMATORS["modified"]
    terms = modified.terms(4000, 64)
    quick = model_edf(model, 64, terms, modified)
    monkeypatch.setattr(intervals, "_MODIFIED_LIMIT", 64)
    assert quick == pytest.approx(model_edf(model, 64, terms, modified), rel=0.02)


@pytest.mark.parametrize("law", PowerLaw)
@pytest.mark.parametrize("m", [1, 7])
def test_the_covariance_at_lag_zero_is_the_allan_variance(law: PowerLaw, m: int) -> None:
    found = intervals._covariance(law, np.zeros(1), m, OVERLAPPING)
    assert found[0] == pytest.approx(float(law.avar(np.array([float(m)]))[0]), rel=1e-9)
