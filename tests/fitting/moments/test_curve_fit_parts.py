"""Tests of the parts of a curve fit: points, limits, slopes, floors and findings."""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import numpy.testing as npt
import pytest

from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray
from imucal.fitting import FitSettings
from imucal.fitting.moments import fit_slope
from imucal.fitting.moments.gmwm import _eta3_widths, _findings, _with_edf
from imucal.fitting.moments.points import AvarPoints, _excess_kurtosis, avar_points, columns, unit_terms
from imucal.fitting.moments.search import (
    Solution,
    all_terms,
    best_fit,
    goodness,
    limits,
    time_grid,
    whitening,
)
from imucal.fitting.moments.slope import LogCurve, Reading, _floor, _line, _variance_next_to, read_term
from imucal.fitting.noise_fit import Goodness
from imucal.recording import AxisSeries
from tests.fitting.moments.curves import simulated_curve


def _curve(avar: FloatArray, m: list[int], *, n: int = 10_000, tau0: float = 1.0) -> AllanCurve:
    factors = np.array(m)
    return AllanCurve(tau=factors * tau0, m=factors, avar=avar, edf=np.full(factors.size, np.nan), n=n)


def _points(avar: FloatArray, *, n: int = 10_000) -> AvarPoints:
    return avar_points(None, _curve(avar, (2 ** np.arange(avar.size)).tolist(), n=n))


def test_points_are_a_factor_of_1_9_apart_and_have_a_positive_variance() -> None:
    """The variances are in units of their geometric mean; tau0 is 0.5 s."""
    curve = _curve(np.array([4.0, 3.0, 2.0, np.nan, 0.0, 8.0]), [10, 18, 19, 40, 50, 60], tau0=0.5)
    points = avar_points(None, curve)
    npt.assert_array_equal(points.used, [0, 2, 5])
    npt.assert_array_equal(points.m, [10, 19, 60])
    assert points.scale == pytest.approx(4.0)
    npt.assert_allclose(points.avar, [1.0, 0.5, 2.0])
    assert points.tau0 == pytest.approx(0.5)
    assert points.overlapping
    npt.assert_array_equal(points.within(1).used, [2, 5])


@pytest.mark.parametrize(("n", "known"), [(0, False), (119, False), (120, True)])
def test_a_record_too_short_for_its_curve_has_an_unknown_length(n: int, *, known: bool) -> None:
    """A record has at least twice the longest averaging time."""
    points = avar_points(None, _curve(np.ones(2), [10, 60], n=n))
    assert points.known_n == known
    assert points.n == 120


@pytest.mark.parametrize(("size", "heavy"), [(100, False), (101, True)])
def test_tails_need_a_hundred_differences(size: int, *, heavy: bool) -> None:
    """The excess of the samples is twice that of their differences; fewer differences do not determine it."""
    samples = np.zeros(size)
    samples[50] = 1.0
    steps = np.diff(samples)
    excess = np.mean(np.square(steps**2 / np.mean(steps**2))) - 3
    points = avar_points(AxisSeries.from_samples(samples, rate_hz=1.0), _curve(np.ones(2), [1, 2]))
    assert points.excess == pytest.approx(2 * excess if heavy else 0.0)


def test_an_excess_within_chance_is_zero() -> None:
    """The limit is four standard errors of the differences' excess, sqrt(36/n) each."""
    normal = np.random.default_rng(1).standard_normal(5000)
    points = avar_points(AxisSeries.from_samples(normal, rate_hz=1.0), _curve(np.ones(2), [1, 2]))
    assert points.excess == 0.0


@pytest.mark.parametrize(("value", "low", "high"), [(5.0, 3.0, 7.0), (2.0, 0.0, 4.0), (0.0, 0.0, 2.0)])
def test_limits_with_a_constant_spread_are_wald_limits(value: float, low: float, high: float) -> None:
    """They are the estimate ± two standard errors, or zero if zero is inside."""
    assert limits(value, lambda _: 1.0, 4.0) == pytest.approx((low, high), rel=1e-5)


def test_limits_with_a_proportional_spread_are_symmetric_in_the_logarithm() -> None:
    """(1 - v)² = q s² v has two roots with product 1; if the spread grows faster, the limit is infinite."""
    low, high = limits(1.0, lambda v: 0.5 * v, 4.0)
    assert low * high == pytest.approx(1.0, rel=1e-4)
    assert (high - 1) ** 2 == pytest.approx(high, rel=1e-4)
    assert limits(1.0, lambda v: 0.5 + v**3, 4.0)[1] == np.inf


def test_the_misfit_is_wilson_and_hilfertys_score() -> None:
    """It standardises the cube roots of independent ratios; without degrees of freedom it is NaN."""
    points = _points(np.array([1.3, 0.5, 0.2, 0.14]))
    solution = Solution(terms=unit_terms("N"), variances=np.ones(1))
    model = 1 / points.m
    edf = np.array([100.0, 40.0, 20.0, 8.0])
    third = 2 / (9 * edf)
    score = (np.cbrt(points.avar / model) - (1 - third)) / np.sqrt(third)
    found = goodness(points, solution, np.diag(2 * model**2 / edf))
    assert found.chi2_per_bin == pytest.approx(score @ score / 3)
    assert found.tau_s == (1.0, 8.0)
    full = Solution(terms=unit_terms("QNBK"), variances=np.ones(4))
    assert np.isnan(goodness(points, full, np.eye(4)).statistic)
    none = replace(solution, variances=np.zeros(1))
    assert np.isnan(goodness(points, none, np.eye(4)).statistic)


def test_a_score_is_continuous_beyond_the_smallest_probability() -> None:
    """It is the normal quantile down to 1e-15, then Wilson and Hilferty's score, at most 1 higher."""
    points = _points(np.ones(4))
    solution = Solution(terms=unit_terms("N"), variances=np.ones(1))
    scores, beyond = [], 0
    for factor in np.geomspace(0.1, 0.4, 60).tolist():
        found = goodness(points, solution, factor * np.diag(1.0 / points.m**2))
        expected = -NormalDist().inv_cdf(found.p_value)
        if found.p_value < 1e-15:
            beyond += 1
            expected = (np.cbrt(found.chi2_per_bin) - 1 + 2 / 27) / np.sqrt(2 / 27)
        assert found.statistic == pytest.approx(expected, rel=1e-6)
        scores.append(found.statistic)
    assert 10 < beyond < 50
    assert np.diff(scores).max() < 1


def test_eta3_widths_use_at_least_one_degree_of_freedom() -> None:
    """(n - 2m + 1) / 2m gives 99.5 and 0.57 for n = 200 at m = 1 and 64; the second becomes 1."""
    from scipy.special import chdtri

    points = avar_points(None, _curve(np.ones(2), [1, 64], n=200))
    expected = [edf * (1 / chdtri(edf, 0.975) - 1 / chdtri(edf, 0.025)) for edf in (99.5, 1.0)]
    npt.assert_allclose(_eta3_widths(points), expected)


def test_missing_degrees_of_freedom_are_computed_from_the_model() -> None:
    """They are 2 avar² over its variance, at least 1; a curve that has some keeps them."""
    curve = _curve(np.array([1.0, 0.5, 0.25]), [1, 2, 4])
    points = replace(avar_points(None, curve), scale=1.0, avar=curve.avar)
    solution = Solution(terms=unit_terms("N"), variances=np.ones(1))
    model = 1 / curve.m
    covariance = np.diag(2 * model**2 / np.array([50.0, 20.0, 0.5]))
    found = _with_edf(curve, points, solution, covariance)
    npt.assert_allclose(found.edf, [50.0, 20.0, 1.0])
    assert found.edf_method == "model"
    given = replace(curve, edf=np.array([np.nan, 3.0, np.nan]))
    assert _with_edf(given, points, solution, covariance) is given


def _texts(*, known: bool = True, dropped: int = 0, statistic: float = 0.0) -> list[str]:
    points = replace(_points(np.ones(3)), known_n=known)
    fit = Goodness(statistic=statistic, p_value=0.5, chi2_per_bin=7.25, tau_s=(2.0, 4.0))
    return [f.text for f in _findings(None, points, fit, dropped, "N + K") if f.code != "narrow-intervals"]


def test_each_finding_of_a_curve_is_separate() -> None:
    """A curve of known length that fits the model has no finding."""
    assert _texts(statistic=2.99) == []
    assert _texts(known=False) == [
        (
            "The length of the record is unknown. The intervals assume 8 s, the shortest that allows the "
            "longest averaging time."
        )
    ]
    assert _texts(dropped=1) == [
        ("No model describes averaging times below 2 s, as with an output filter; the fit starts there.")
    ]
    assert _texts(statistic=3.0) == ["N + K does not describe the curve: its misfit is 7.2, expected 1."]


def test_correlation_times_of_a_grid_span_the_curve() -> None:
    """They span 0.7 of the shortest to 1.5 of the longest averaging time, three per decade, at least two."""
    points = avar_points(None, _curve(np.ones(2), [1, 1000]))
    grid = time_grid(points)
    assert (grid[0], grid[-1], grid.size) == (pytest.approx(0.7), pytest.approx(1500), 10)
    assert time_grid(replace(points, m=np.array([1, 1]))).size == 2


def _logs(avar: FloatArray, variance: float | FloatArray = 1e-4) -> LogCurve:
    return LogCurve(_points(avar), np.diag(np.broadcast_to(variance, avar.size)))


def test_a_line_is_the_longest_run_on_a_slope() -> None:
    """A line has at least three points; of equally long runs, the one with the smaller variance is used."""
    avar = 2.0 ** np.array([0.0, -1.0, -2.0, -3.0, -3.0, -3.0, -4.0, -5.0, -6.0, -7.0])
    surer = np.where(np.arange(10) < 4, 1e-5, 1e-4)
    npt.assert_array_equal(_line(_logs(avar, surer), -0.5), [5, 6, 7, 8, 9])
    npt.assert_array_equal(_line(_logs(avar[:9], surer[:9]), -0.5), [0, 1, 2, 3])
    npt.assert_array_equal(_line(_logs(avar[:9], surer[8::-1]), -0.5), [5, 6, 7, 8])
    assert not _line(_logs(avar), 0.5).size
    assert not _line(_logs(avar[:2]), -0.5).size


def test_a_reading_is_the_weighted_mean_of_its_points() -> None:
    """Points N² = avar m are weighted by their inverse variances, which also give the spread."""
    variance = np.array([1e-4, 4e-4, 2e-4, 1e-4])
    curve = _logs(np.array([1.0, 0.52, 0.26, 0.12]), variance)
    reading = read_term(curve, "N", {"N": (2.0, 8.0)})
    assert reading is not None
    npt.assert_array_equal(reading.places, [1, 2, 3])
    weights = 1 / variance[1:] / np.sum(1 / variance[1:])
    logs = np.log(curve.points.avar[1:] * curve.points.m[1:]) / 2
    assert reading.log_value == pytest.approx(weights @ logs)
    assert reading.variance == pytest.approx(np.exp(2 * weights @ logs))
    assert reading.spread == pytest.approx(np.sum(1 / variance[1:]) ** -0.5)


@pytest.mark.parametrize(
    ("adev", "places"),
    [
        ([3.0, 1.04, 1.0, 1.06, 3.0], [1, 2]),
        ([3.0, 1.06, 1.0, 1.04, 3.0], [2, 3]),
        ([1.0, 1.04, 1.2, 1.3], []),
        ([3.0, 2.0, 1.5, 1.0], []),
        ([3.0, 1.0], []),
        ([3.0, 1.0, 2.0], [1]),
        ([1.04, 1.0, 1.03], [0, 1, 2]),
    ],
)
def test_a_floor_has_a_rise_on_both_sides(adev: list[float], places: list[int]) -> None:
    """Its points are within a factor of 1.05 of the lowest."""
    npt.assert_array_equal(_floor(_logs(np.square(adev))), places)


def test_points_with_fewer_than_three_degrees_of_freedom_are_excluded() -> None:
    """The variance of their logarithm is 1/6 or more."""
    assert _logs(np.ones(4), np.array([0.1, 1 / 6 - 1e-9, 1 / 6, 0.5])).sure == 2


def test_whitening_divides_independent_values_by_their_deviations() -> None:
    """The tolerance allows for the nugget that keeps the factorisation stable."""
    npt.assert_allclose(whitening(np.diag([4.0, 16.0])), np.diag([0.5, 0.25]), rtol=1e-5)


def test_the_search_keeps_the_terms_of_the_curve() -> None:
    """It keeps all five terms of an exact sum of five, and only N of a line of white noise."""
    m = 2 ** np.arange(14)
    variances = {"Q": 1e4, "N": 1.0, "B": 1e-2, "K": 1e-4, "R": 1e-8}
    avar = columns(m, unit_terms("QNBKR")) @ np.array(list(variances.values()))
    settings = FitSettings(method="gmwm", max_gm=0, criterion="bic", weights="eta3")
    points = _points(avar, n=40_000)
    found = best_fit(points, np.diag(1 / (1e-3 * points.avar)), settings)
    assert "".join(found.solution.symbols) == "QNBKR"
    expected = np.array(list(variances.values())) / points.scale
    npt.assert_allclose(found.solution.variances, expected, rtol=1e-6)
    white = _points(1.0 / m, n=40_000)
    found = best_fit(white, np.diag(1 / (1e-3 * white.avar)), settings)
    assert found.solution.symbols == ("N",)
    deltas = [delta for delta, _ in found.ranking]
    assert deltas[0] == 0.0
    assert min(deltas[1:]) > 0


@pytest.mark.parametrize("size", [3, 6, 12])
def test_the_largest_model_has_fewer_parameters_than_points(size: int) -> None:
    """Each Gauss-Markov term has two parameters."""
    symbols = all_terms(_points(np.ones(size)), 2)
    assert len(symbols) + symbols.count("GM") < size
    assert "N" in symbols


def test_an_interval_of_a_line_is_a_normal_quantile_of_its_spread() -> None:
    """White noise on a given window has one and two standard errors at 68.27 and 95.45 %."""
    curve = simulated_curve("N=1", 4000, np.random.default_rng(3))
    highs = []
    for level in (0.6826894921, 0.9544997361):
        estimate = fit_slope(None, curve, FitSettings(model="N", level=level), windows={"N": (1, 8)})["N"]
        assert estimate.value is not None
        assert estimate.low < estimate.value < estimate.high
        highs.append(np.log(estimate.high / estimate.value))
    assert highs[1] == pytest.approx(2 * highs[0], rel=1e-6)


@pytest.mark.parametrize(("size", "known"), [(2, False), (3, True)])
def test_a_second_term_is_estimated_from_three_points(size: int, *, known: bool) -> None:
    """Two points do not determine it; the result includes two standard errors."""
    plain = _logs(np.ones(4))
    white, walk = plain.shape("N"), plain.shape("K")
    avar = white + 0.01 * walk
    curve = LogCurve(replace(plain.points, avar=avar), plain.covariance)
    weights = np.where(np.arange(4) < size, 1 / size, 0.0)
    found = _variance_next_to(curve, Reading(symbol="N", weights=weights, log_value=0.0, spread=0.01), "K")
    if not known:
        assert found == np.inf
        return
    # The logarithm of a deviation scatters by 0.01, and a variance by 2 %.
    design = (np.stack([white, walk], axis=1) / avar[:, np.newaxis])[:size]
    spread = np.linalg.inv(design.T @ design) * 4e-4
    assert found == pytest.approx(0.01 + 2 * np.sqrt(spread[1, 1]))


def test_the_kurtosis_of_white_noise_is_estimated_from_its_samples() -> None:
    """The uniform law is the lower limit; a straight line or 100 samples do not determine it."""
    coin = np.random.default_rng(1).choice([-1.0, 1.0], 100_000)
    assert _excess_kurtosis(AxisSeries.from_samples(coin, rate_hz=1.0)) == -1.2
    assert _excess_kurtosis(AxisSeries.from_samples(np.arange(200.0), rate_hz=1.0)) == 0.0
    normal = np.random.default_rng(2).standard_normal(100_000)
    assert _excess_kurtosis(AxisSeries.from_samples(normal, rate_hz=1.0)) == 0.0
    for n, determined in ((100, False), (101, True)):
        wild = np.zeros(n)
        wild[50] = 1.0
        assert (_excess_kurtosis(AxisSeries.from_samples(wild, rate_hz=1.0)) > 0) == determined
