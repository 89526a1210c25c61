"""Tests of the covariance of Allan variances: against all lags, closed forms and simulation."""

from decimal import Decimal, localcontext
from itertools import product

import numpy as np
import numpy.testing as npt
import pytest

from imucal.arrays import FloatArray
from imucal.fitting.moments import points as module
from imucal.fitting.moments.points import avar_covariance, unit_terms
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import GaussMarkov
from tests.fitting.moments.curves import octave_curve

Q, N, B, K, R = unit_terms("QNBKR")


def _markov(time: float) -> GaussMarkov:
    return GaussMarkov(sigma=1.0, T=time)


TERMS = [Q, N, B, K, _markov(5.0), _markov(300.0)]


def _correlation(covariance: FloatArray) -> FloatArray:
    deviation = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(deviation, deviation))


def test_the_grid_of_lags_represents_all_lags(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sum on graded lags agrees with the sum over all lags to 1e-3 of the standard deviations."""
    m = 2 ** np.arange(11)
    quick = avar_covariance(m, 5_000, TERMS, overlapping=True)
    monkeypatch.setattr(module, "_ALL_LAGS", 10**9)
    module._computed.cache_clear()
    module._lag_products.cache_clear()
    every = avar_covariance(m, 5_000, TERMS, overlapping=True)
    module._computed.cache_clear()
    module._lag_products.cache_clear()
    for p in range(len(TERMS)):
        scale = np.sqrt(np.diag(every.quadratic[p, p]))
        difference = (quick.quadratic[p, p] - every.quadratic[p, p]) / np.outer(scale, scale)
        assert np.abs(difference).max() < 1e-3


def test_white_noise_at_the_shortest_time_has_a_closed_form() -> None:
    """At m = 1, d_t is a difference over √2: Var = 2/M (1 + 2 (1 - 1/M) / 4)."""
    n = 1000
    covariance = avar_covariance(np.array([1]), n, [N], overlapping=True).at(np.array([3.0]))
    terms = n - 1
    npt.assert_allclose(covariance, 9 * 2 / terms * (1 + (1 - 1 / terms) / 2), rtol=1e-12)


def test_adjacent_windows_of_white_noise_have_a_closed_form() -> None:
    """Standard Allan variances of white noise at m behave like n/m samples at m = 1."""
    m, n = 8, 800
    covariance = avar_covariance(np.array([m]), n, [N], overlapping=False).at(np.ones(1))
    terms = n // m - 1
    npt.assert_allclose(covariance, 2 / terms * (1 + (1 - 1 / terms) / 2) / m**2, rtol=1e-12)


@pytest.mark.parametrize("overlapping", [True, False])
@pytest.mark.parametrize(
    ("text", "terms", "variances"),
    [
        ("N=1 + K=2e-2", [N, K], [1.0, 4e-4]),
        (
            "Q=1.5 + N=1 + B=0.3",
            [Q, N, B],
            [2.25, 1, 0.09],
        ),
        ("N=1 + GM(sigma=0.3, T=20) + R=5e-4", [N, _markov(20.0), R], [1.0, 0.09, 2.5e-7]),
    ],
)
def test_simulated_curves_scatter_as_predicted(
    text: str, terms: list[NoiseTerm], variances: list[float], *, overlapping: bool
) -> None:
    """Over 800 records, variances agree to 5 standard errors (25 %) and correlations to 0.12."""
    rng = np.random.default_rng(2026)
    model, n = NoiseModel.parse(text), 1024
    curves = [
        octave_curve(model.simulate(n, rate_hz=1.0, rng=rng), overlapping=overlapping) for _ in range(800)
    ]
    seen = np.cov(np.array([curve.avar for curve in curves]).T)
    computed = avar_covariance(curves[0].m, n, terms, overlapping=overlapping)
    predicted = computed.at(np.array(variances, dtype=np.float64))
    npt.assert_allclose(np.diag(predicted) / np.diag(seen), 1.0, atol=0.25)
    npt.assert_allclose(_correlation(predicted), _correlation(seen), atol=0.12)


def test_the_covariance_is_quadratic_in_the_variances() -> None:
    """Doubling the noise multiplies variances by 4 and their covariances by 16."""
    found = avar_covariance(2 ** np.arange(8), 2000, [N, K, R], overlapping=True)
    npt.assert_allclose(found.at(np.array([4.0, 4e-3, 4e-6])), 16 * found.at(np.array([1.0, 1e-3, 1e-6])))


def test_an_averaging_factor_beyond_half_the_record_is_rejected() -> None:
    """The error states the valid range."""
    with pytest.raises(ValueError, match=r"averaging factors must be in 1\.\.50 for 100 samples"):
        avar_covariance(np.array([51]), 100, [N], overlapping=True)


@pytest.mark.parametrize(
    ("longest", "times", "reach"), [(4, [], 96), (4, [4.4], 96), (4, [4.41], 192), (4, [100.0, 5.0], 3072)]
)
def test_the_largest_lag_grows_by_powers_of_two(longest: int, times: list[float], reach: int) -> None:
    """It is 24 windows for flicker, doubled until it exceeds both windows by 20 correlation times."""
    assert module._reach(longest, [_markov(time) for time in times]) == reach


@pytest.mark.parametrize("overlapping", [True, False])
@pytest.mark.parametrize("term", [Q, N, B, K, _markov(4.0)])
def test_the_covariance_of_two_averaging_times_is_a_sum_over_all_pairs(
    term: NoiseTerm, *, overlapping: bool
) -> None:
    """The reference is a double loop over the differences, with covariances from V(n) by its definition.

    Adjacent windows of unequal length are only paired to the nearest integer at each lag.
    """
    n, mi, mj = 24, 2, 3
    starts = [range(0, n - 2 * m + 1, 1 if overlapping else m) for m in (mi, mj)]
    total = 0.0
    for t in starts[0]:
        for u in starts[1]:
            apart = 0.0
            for a, first in enumerate((1, -2, 1)):
                for b, second in enumerate((1, -2, 1)):
                    place = np.array([abs(float(u + b * mj - t - a * mi))])
                    apart += first * second * float(term.sum_variance(place, 1.0)[0])
            total += 2 * (apart / (-4 * mi * mj)) ** 2
    expected = total / (len(starts[0]) * len(starts[1]))
    found = avar_covariance(np.array([mi, mj]), n, [term], overlapping=overlapping).at(np.ones(1))
    assert found[0, 1] == pytest.approx(expected, rel=1e-9 if overlapping else 0.1)
    assert found[1, 0] == found[0, 1]


@pytest.mark.parametrize("term", [Q, N, K])
def test_disjoint_windows_of_these_terms_are_uncorrelated(term: NoiseTerm) -> None:
    """Windows of 2 × 12 and 2 × 20 samples give exactly zero at every distance, without rounding errors."""
    far = np.array([-(10**7), -41, 25, 200, 10**7 + 3])
    assert not module._lag_covariance(far, 12, 20, term).any()


@pytest.mark.parametrize("term", [B, _markov(300.0)])
def test_disjoint_windows_of_slow_terms_are_correlated(term: NoiseTerm) -> None:
    """The correlation of flicker and of a long Gauss-Markov term decreases with the distance."""
    near = module._lag_covariance(np.array([-41, -50, -100, -300]), 12, 20, term)
    assert np.all(near < 0)
    assert np.all(np.diff(near) > 0)


@pytest.mark.parametrize(("mi", "mj"), [(1, 1), (64, 1), (64, 64), (1024, 4)])
def test_a_slow_gauss_markov_term_keeps_its_precision(mi: int, mj: int) -> None:
    """T = 786432 samples; the reference sums V(n) with 60 digits at every lag of the grid.

    In double precision these sums would be 4e10 times too large at m = 1.
    """
    time = 786_432
    reach = module._reach(max(mi, mj), [_markov(time)])
    lags, weights, _ = module._lag_products(mi, mj, 4 * time, reach, overlapping=True)
    with localcontext(prec=60):
        phi = (Decimal(-1) / time).exp()

        def sum_of(n: int) -> Decimal:
            return (n * (1 - phi**2) - 2 * phi * (1 - (Decimal(-n) / time).exp())) / (1 - phi) ** 2

        expected = Decimal(0)
        for lag, weight in zip(lags.tolist(), weights.tolist(), strict=True):
            comb = Decimal(0)
            for a, b in product(range(3), repeat=2):
                comb += (1, -2, 1)[a] * (1, -2, 1)[b] * sum_of(abs(lag + b * mj - a * mi))
            expected += 2 * Decimal(weight) * (comb / (-4 * mi * mj)) ** 2
        found = avar_covariance(np.array([mi, mj]), 4 * time, [_markov(time)], overlapping=True)
        assert float(found.at(np.ones(1))[0, 1]) == pytest.approx(float(expected), rel=1e-6)
