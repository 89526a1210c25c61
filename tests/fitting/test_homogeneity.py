"""Tests of imucal.fitting.homogeneity: Cochran's Q, the Birge ratio, wider intervals and the finding."""

from dataclasses import replace

import numpy as np
import numpy.testing as npt
import pytest
from scipy.stats import bartlett, chi2

from imucal.fitting.homogeneity import (
    bartlett_correction,
    cochran_q,
    homogeneity,
    nonstationary_finding,
    widened,
    widened_covariance,
)
from imucal.fitting.noise_fit import CHANCE, Estimate, Interval, Segments, TermHomogeneity


def spans(count: int) -> np.ndarray:
    """Return segments of 100 s."""
    edges = 100.0 * np.arange(count + 1)
    return np.stack([edges[:-1], edges[1:]], axis=1)


def term(key: str, statistic: float, *, dof: int = 7) -> TermHomogeneity:
    """Return the test of a term with this Q."""
    logs = np.arange(dof + 1.0)
    return homogeneity(key, statistic, logs, np.ones(dof + 1), spans(dof + 1))


def segments(*terms: TermHomogeneity) -> Segments:
    """Return eight segments of 100 s with these tests and no traces."""
    start, end = spans(8).T
    return Segments(start_s=start, end_s=end, white=None, floor=None, floor_tau_s=np.nan, terms=terms)


def estimate(key: str, value: float, low: float, high: float) -> Estimate:
    """Return an estimated term."""
    symbol = key.rstrip("0123456789")
    return Estimate(key=key, symbol=symbol, status="estimated", value=value, low=low, high=high)


def test_cochran_q_is_the_weighted_sum_of_squares_about_the_weighted_mean() -> None:
    """By hand: the values 0 and 1 with weights 1 and 3 have the mean 3/4, so Q = 9/16 + 3/16."""
    assert cochran_q(np.array([0.0, 1.0]), np.array([1.0, 3.0])) == pytest.approx(0.75)


def test_q_does_not_depend_on_the_unit_or_the_order() -> None:
    """A change of unit shifts all logarithms; Q is invariant under a shift and a permutation."""
    rng = np.random.default_rng(11)
    logs, weight = rng.standard_normal(8), rng.uniform(1, 5, 8)
    order = rng.permutation(8)
    q = cochran_q(logs, weight)
    assert cochran_q(logs + np.log(1e-7), weight) == pytest.approx(q, rel=1e-9)
    assert cochran_q(logs[order], weight[order]) == pytest.approx(q)


def test_bartlett_correction_agrees_with_scipy() -> None:
    """The corrected likelihood ratio of equal variances equals Bartlett's statistic of the same samples."""
    rng = np.random.default_rng(12)
    sizes = (4, 6, 9, 12)
    samples = [rng.standard_normal(size) * scale for size, scale in zip(sizes, (1, 2, 1, 3), strict=True)]
    freedom = np.array(sizes) - 1.0
    variance = np.array([sample.var(ddof=1) for sample in samples])
    pooled = np.average(variance, weights=freedom)
    ratio = float(np.sum(freedom * np.log(pooled / variance)))
    assert ratio / bartlett_correction(freedom / 2) == pytest.approx(bartlett(*samples).statistic)


def test_the_factor_is_the_birge_ratio_only_if_q_is_significant() -> None:
    """The factor is sqrt(Q/dof) above the quantile of CHANCE and 1 below; the p-value is from chi-squared."""
    limit = float(chi2.isf(CHANCE, 7))
    assert term("N", 1.001 * limit).factor == pytest.approx(np.sqrt(1.001 * limit / 7))
    assert term("N", 0.999 * limit).factor == 1.0
    assert term("N", 20.0).p_value == pytest.approx(chi2.sf(20.0, 7))


def test_spread_excludes_the_measurement_errors() -> None:
    """The method of moments recovers the spread 0.3 of values with measurement errors of 0.1."""
    rng = np.random.default_rng(13)
    found = []
    for _ in range(200):
        logs = 0.3 * rng.standard_normal(8) + 0.1 * rng.standard_normal(8)
        weight = np.full(8, 1 / 0.1**2)
        found.append(homogeneity("N", cochran_q(logs, weight), logs, weight, spans(8)).spread ** 2)
    # The variance of eight has relative error sqrt(2/7); the mean of 200 of them, in four standard errors.
    assert np.mean(found) == pytest.approx(0.3**2, rel=4 * np.sqrt(2 / 7 / 200) * 0.1 / 0.09)


def test_the_spans_of_the_largest_and_smallest_value_are_reported() -> None:
    found = homogeneity("N", 99.0, np.array([0.0, 2.0, -1.0]), np.ones(3), spans(3))
    assert found.highest_s == (100.0, 200.0)
    assert found.lowest_s == (200.0, 300.0)


def test_a_narrow_interval_is_widened_about_the_logarithm() -> None:
    """Both limits move by the factor in the logarithm, so neither reaches zero."""
    (found,) = widened([estimate("N", 1.0, 0.99, 1.02)], segments(term("N", 700.0)))
    assert found.low == pytest.approx(0.99**10)
    assert found.high == pytest.approx(1.02**10)
    assert found.widening == pytest.approx(10.0)
    assert found.value == 1.0


def test_a_wide_interval_is_widened_about_the_value_and_may_reach_zero() -> None:
    """If the lower limit reaches zero, the term becomes an upper bound with the wider limit."""
    four = segments(term("K", 28.0))
    (found,) = widened([estimate("K", 1.0, 0.7, 1.5)], four)
    npt.assert_allclose([found.low, found.high], [0.4, 2.0])
    (gone,) = widened([estimate("K", 1.0, 0.4, 1.5)], four)
    assert gone.status == "bounded"
    npt.assert_allclose([gone.low, gone.high, gone.widening], [0.0, 2.0, 2.0])


def test_white_noise_keeps_its_value_however_much_it_changes() -> None:
    """A large change of the noise widens N's interval but never turns N into a bound."""
    (found,) = widened([estimate("N", 1.0, 0.7, 1.4)], segments(term("N", 7000.0)))
    assert found.value == 1.0
    npt.assert_allclose([found.low, found.high], [0.7 ** np.sqrt(1000), 1.4 ** np.sqrt(1000)])


def test_an_upper_bound_is_multiplied_by_the_factor() -> None:
    (found,) = widened([Estimate.bounded("K", "K", 3.0)], segments(term("K", 28.0)))
    assert (found.low, found.high, found.widening) == (0.0, 6.0, 2.0)


def test_slow_terms_are_widened_together_and_white_noise_by_itself() -> None:
    """Segments cannot separate the slow terms, so all get the same factor; white noise has its own."""
    terms = [estimate(key, 1.0, 0.9, 1.1) for key in ("N", "B", "GM1", "K", "R")]
    found = {e.key: e.widening for e in widened(terms, segments(term("N", 1.0), term("B", 28.0)))}
    assert found == {"N": 1.0, "B": 2.0, "GM1": 2.0, "K": 2.0, "R": 2.0}


def test_correlation_time_is_widened_too() -> None:
    """The limits of the correlation time are widened in the logarithm by the term's factor."""
    time = Interval(value=10.0, low=5.0, high=20.0)
    given = Estimate(
        key="GM", symbol="GM", status="estimated", value=1.0, low=0.9, high=1.1, correlation_time=time
    )
    (found,) = widened([given], segments(term("GM", 28.0)))
    assert found.correlation_time is not None
    npt.assert_allclose([found.correlation_time.low, found.correlation_time.high], [2.5, 40.0])


def test_the_larger_factor_of_segments_and_misfit_applies() -> None:
    """The factors are not multiplied, because a change over time also causes a misfit."""
    terms = [estimate(key, 1.0, 0.9, 1.1) for key in ("N", "B")]
    changing = segments(term("N", 28.0), term("B", 28.0))
    found = {e.key: e.widening for e in widened(terms, changing, {"N": 1.5, "B": 3.0})}
    assert found == {"N": 2.0, "B": 3.0}
    assert [e.widening for e in widened(terms, None, {"B": 3.0})] == [1.0, 3.0]
    covariance = widened_covariance(("N", "B"), np.eye(2), changing, {"N": 1.5, "B": 3.0})
    npt.assert_allclose(covariance, np.diag([4.0, 9.0]))


def test_a_limit_beyond_the_largest_float_is_infinite() -> None:
    """A wide interval with a large factor must not raise OverflowError."""
    (found,) = widened([estimate("N", 1.0, 1e-3, 1e3)], None, {"N": 200.0})
    assert (found.low, found.high, found.widening) == (0.0, np.inf, 200.0)
    time = Interval(value=1.0, low=1e-3, high=1e3)
    (found,) = widened([replace(estimate("N", 1.0, 0.9, 1.1), correlation_time=time)], None, {"N": 200.0})
    assert found.correlation_time is not None
    assert (found.correlation_time.low, found.correlation_time.high) == (0.0, np.inf)


def test_covariance_is_scaled_like_the_intervals() -> None:
    """Standard errors grow by the factors and the correlations stay the same."""
    covariance = np.array([[4.0, 1.0], [1.0, 9.0]])
    found = widened_covariance(("N", "GM2.T"), covariance, segments(term("N", 63.0), term("GM2", 28.0)))
    npt.assert_allclose(found, covariance * np.outer([3, 2], [3, 2]))


def test_stationary_or_missing_segments_change_nothing() -> None:
    """The limits and the covariance stay the same, and there is no finding."""
    given = (estimate("N", 1.0, 0.9, 1.1),)
    for found in (None, segments(term("N", 3.0))):
        assert widened(given, found) == given
        npt.assert_array_equal(widened_covariance(("N",), np.eye(1), found), np.eye(1))
        assert nonstationary_finding(found, "gyro_x") == ()


def test_the_finding_contains_term_factor_and_times() -> None:
    (found,) = nonstationary_finding(segments(term("N", 700.0)), "gyro_x")
    assert (found.code, found.axis, found.level) == ("nonstationary", "gyro_x", "warning")
    assert "largest from 11.7 to 13.3 min, smallest from 0 to 100 s" in found.text
    assert "The intervals are wider to allow for it: N 10 times." in found.text


def test_a_small_spread_is_reported_without_a_warning() -> None:
    """A significant but small change widens the interval, yet its finding has the level info."""
    logs = 0.01 * np.array([0, 1, 0, 1, 0, 1, 0, 1.0])
    weight = np.full(8, 1e6)
    small = homogeneity("N", cochran_q(logs, weight), logs, weight, spans(8))
    (found,) = nonstationary_finding(segments(small), "gyro_x")
    assert found.level == "info"


def test_the_error_for_an_unknown_key_lists_the_tested_terms() -> None:
    found = segments(term("N", 1.0), term("B", 1.0))
    assert found["B"].key == "B"
    with pytest.raises(KeyError, match="N, B"):
        found["K"]


LEVELS = np.array([0, 0, 0, 0.3, 1, 1, 1, 1]) * np.log(1.3)


@pytest.mark.parametrize(
    ("logs", "shifts"),
    [
        (LEVELS, True),
        (-LEVELS, True),
        (LEVELS[::-1], True),
        (np.linspace(0, 0.3, 8), False),  # a trend
        (0.2 * np.sin(np.arange(8)), False),  # to and fro
        (np.where(np.arange(8) == 3, 0.3, 0.0), False),  # comes and goes
        (np.zeros(8), False),
    ],
)
def test_only_one_shift_between_two_levels_is_reported(logs: np.ndarray, *, shifts: bool) -> None:
    """A shift has two levels and at most one segment between them; other changes have no shift."""
    weight = np.full(8, 1e4)
    noisy = logs + 0.01 * np.random.default_rng(5).standard_normal(8)
    found = homogeneity("N", cochran_q(noisy, weight), noisy, weight, spans(8))
    assert (found.shift is not None) == shifts
    if found.shift:
        time, factor = found.shift
        assert factor == pytest.approx(np.exp(logs[-1] - logs[0]), rel=0.02)
        (finding,) = nonstationary_finding(segments(found), "gyro_x")
        assert f"N shifts once, at about {time / 60:.3g} min, to {factor:.3g} times" in finding.text


def test_the_time_of_a_shift_is_interpolated_in_its_segment() -> None:
    """The segment's variance is the mean of both levels by duration: 30 of its 100 s precede the shift."""
    logs = np.log(np.array([1, 1, 1, 0.3 + 0.7 * 4, 4, 4, 4, 4])) / 2
    weight = np.full(8, 1e4)
    found = homogeneity("N", cochran_q(logs, weight), logs, weight, spans(8))
    assert found.shift is not None
    assert found.shift == pytest.approx((330.0, 2.0))


def test_a_weak_term_has_no_shift() -> None:
    """If single segments estimate the term poorly, the change is no evidence of a shift."""
    assert homogeneity("B", 60.0, 3 * LEVELS, np.full(8, 40.0), spans(8)).shift is None
