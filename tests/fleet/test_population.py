"""Tests of the population of a fleet: exact limits, the posterior, coverage and odd units."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats
from scipy.special import ndtr, ndtri

from imucal.fleet import LogValue, population
from imucal.fleet.population import (
    MeanSquare,
    leave_one_out,
    membership,
)
from imucal.fleet.posterior import Posterior, UnitLikelihoods
from imucal.fleet.values import LogValues, Squares
from tests.fleet.simulated import strong_fleet, weak_fleet


@pytest.mark.parametrize("units", [3, 5, 20])
def test_exact_units_have_the_noncentral_t_bound(units: int) -> None:
    """For exact units, the bound is the mean plus k standard deviations; the median uses Student's t."""
    logs = strong_fleet(np.random.default_rng(units), units=units, tau=0.02, error=1e-6)
    y = np.log([log.value or math.nan for log in logs])
    mean, sd = float(y.mean()), float(y.std(ddof=1))
    found = population(logs)
    factor = stats.nct.ppf(0.95, units - 1, ndtri(0.95) * math.sqrt(units)) / math.sqrt(units)
    assert math.log(found.tolerance or 0.0) == pytest.approx(mean + factor * sd, abs=0.02 * factor * sd)
    half = stats.t.ppf(0.975, units - 1) * sd / math.sqrt(units)
    assert math.log(found.median.high) == pytest.approx(mean + half, abs=0.02 * half)
    assert math.log(found.median.low) == pytest.approx(mean - half, abs=0.02 * half)
    assert found.prediction is not None
    reach = stats.t.ppf(0.975, units - 1) * sd * math.sqrt(1 + 1 / units)
    assert math.log(found.prediction[1]) == pytest.approx(mean + reach, abs=0.03 * reach)


def _slow_log_posterior(values: LogValues, omega: float, tau: float, mu: float) -> float:
    """Return the log-posterior from nested quadrature over the effects of units and logs."""
    units = UnitLikelihoods(values, omega)
    s2 = units.deviation**2
    jeffreys = 2 * math.log(tau) + 0.5 * math.log(sum(1 / (s + tau**2) ** 2 for s in s2))
    usual = math.log(tau) - (tau**2 + omega**2) / (2 * 0.25)
    uninformative = sum((s / (s + 0.25)) ** 2 for s in s2) / s2.size
    total = float((1 - uninformative) * jeffreys + uninformative * usual)
    # A weak unit's error of the median at mu is that of its square, equal for all weak units.
    weak = 1 / (np.mean(1 / s2[~units.normal]) * math.exp(4 * (mu - values.middle)))
    informative = sum(1 / (s + 0.25) for s in s2[units.normal])
    count = int(np.sum(~units.normal))
    total += 0.5 * math.log((informative + count / (weak + 0.25)) / (informative + count / 0.25))
    theta = np.linspace(mu - 6 - 3 * tau, mu + 3 + 4 * tau, 2401)
    # Simpson's weights for all effects of a log.
    weights = np.resize([2.0, 4.0], theta.size) * (theta[1] - theta[0]) / 3
    weights[[0, -1]] /= 2
    scatter = _normal(theta[:, None] - theta, omega) * weights if omega else None
    for unit in range(len(values.names)):
        likelihood = np.ones(theta.size)
        for row in np.exp(values.take(values.unit == unit).log_likelihood(theta)):
            likelihood *= row if scatter is None else scatter @ row
        total += math.log(integrate.simpson(likelihood * _normal(theta - mu, tau), x=theta))
    return total


def _normal(x: np.ndarray, sd: float) -> np.ndarray:
    return np.exp(-0.5 * (x / sd) ** 2) / (sd * math.sqrt(2 * math.pi))


@pytest.mark.slow
@pytest.mark.parametrize("omega", [0.0, 0.2])
def test_the_posterior_agrees_with_nested_quadrature(omega: float) -> None:
    """Differences over mu and tau are compared for a fleet of precise, weak and bounded units."""
    rng = np.random.default_rng(41)
    informative = strong_fleet(rng, units=2, logs=2, tau=0.3, error=0.05, omega=0.2)
    weak = weak_fleet(rng, units=3, tau=0.3, error=0.8)
    values = LogValues.of([*informative, *(replace(log, unit=f"w{log.unit}") for log in weak)])
    found = Posterior(values, np.array([omega]))
    tau, mu, weight = found.tau.ravel(), found.mu[0], found.weight[0]
    # The density is per mu, and each tau has its own grid. Some medians have a spread that exceeds
    # the grid of the unit likelihoods.
    fast = np.log(weight / (mu[:, 1] - mu[:, 0])[:, None])
    points = [(t, m) for t in (0, 20, 35, 47) for m in (10, 25, 30, 50)]
    slow = [_slow_log_posterior(values, omega, float(tau[t]), float(mu[t, m])) for t, m in points]
    differences = np.array([fast[point] for point in points]) - slow
    assert mu[47, 50] + tau[47] > 2
    assert np.ptp(differences) < 0.03


def test_the_median_is_near_the_estimated_units() -> None:
    """Four units are known to three to five standard errors, so no limit is far from them."""
    logs = [
        LogValue(unit=f"u{i}", value=None, low=0.0, high=9.0, variance=v, variance_sd=sd, variance_growth=0.1)
        for i, (v, sd) in enumerate(((4.6, 0.9), (2.3, 0.5), (2.1, 0.8), (1.8, 0.6)))
    ]
    found = population(logs)
    assert not found.bounded
    assert 1.0 < found.median.low < found.median.high < 2.5


@pytest.mark.parametrize("factor", [1e-6, 1e3])
def test_the_unit_of_measurement_does_not_matter(factor: float) -> None:
    """The spread stays the same, and all other numbers scale."""
    logs = strong_fleet(np.random.default_rng(43), units=8, logs=2, tau=0.2, error=0.05, omega=0.1)
    scaled = [
        replace(log, value=(log.value or 0.0) * factor, low=log.low * factor, high=log.high * factor)
        for log in logs
    ]
    one, other = population(logs), population(scaled)
    assert one.spread is not None
    assert other.spread is not None
    assert other.median.value == pytest.approx((one.median.value or 0.0) * factor, rel=1e-6)
    assert other.spread.value == pytest.approx(one.spread.value, rel=1e-6)
    assert other.tolerance == pytest.approx((one.tolerance or 0.0) * factor, rel=1e-6)


def test_the_order_of_the_logs_does_not_matter() -> None:
    """Shuffled logs give the same numbers, with the units in their new order."""
    rng = np.random.default_rng(44)
    logs = weak_fleet(rng, units=6, logs=2, tau=0.3, error=0.5)
    one, other = population(logs), population(logs[::-1])
    assert other.tolerance == pytest.approx(one.tolerance, rel=1e-9)
    assert [u.unit for u in other.units] == [u.unit for u in one.units][::-1]


def test_intervals_have_the_nominal_coverage() -> None:
    """In 20 fleets of 10 units with 3 logs, median, spreads and bound each cover in about 95 %."""
    rng = np.random.default_rng(4501)
    tau, omega = 0.2, 0.1
    covered = np.zeros(4)
    for _ in range(20):
        found = population(strong_fleet(rng, units=10, logs=3, tau=tau, error=0.05, omega=omega))
        assert found.spread is not None
        assert found.within is not None
        covered += [
            found.median.low <= 1 <= found.median.high,
            found.spread.low <= tau <= found.spread.high,
            found.within.low <= omega <= found.within.high,
            (found.tolerance or 0.0) >= math.exp(ndtri(0.95) * tau),
        ]
    assert (covered >= 16).all()


@pytest.mark.slow
def test_a_weak_term_is_pooled_without_bias() -> None:
    """Two thirds of the units only bound it, but their likelihoods determine the median and the spread."""
    rng = np.random.default_rng(4502)
    found = [population(weak_fleet(rng, units=20, tau=0.3, error=0.8)) for _ in range(6)]
    assert np.mean([f.median.low <= 1 <= f.median.high for f in found]) > 0.6
    assert np.mean([math.log(f.median.value or math.nan) for f in found]) == pytest.approx(0, abs=0.15)
    assert np.mean([u.value is None for f in found for u in f.units]) > 0.5
    assert all(any(x.code == "weak-term" for x in f.findings) for f in found[:1])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("units", "logs", "tau", "error"), [(6, 2, 0.1, 5.0), (10, 1, 0.3, 2.0), (24, 3, 0.3, 8.0)]
)
def test_a_bounded_term_has_valid_bounds(units: int, logs: int, tau: float, error: float) -> None:
    """They are for median, next unit and tolerance; fleets that detect the term by chance also cover."""
    rng = np.random.default_rng(4505)
    found = [population(weak_fleet(rng, units=units, logs=logs, tau=tau, error=error)) for _ in range(6)]
    bounded = [f for f in found if f.bounded]
    assert len(bounded) >= 3
    assert all(f.median.low == 0 and f.spread is None and f.within is None for f in bounded)
    assert all(f.prediction is not None and f.prediction[0] == 0 for f in bounded)
    assert {x.code for f in bounded for x in f.findings} == {"weak-term"}
    assert sum(f.median.low <= 1 <= f.median.high for f in found) >= 5
    assert sum((f.tolerance or 0) >= math.exp(ndtri(0.95) * tau) for f in found) >= 5


def test_a_bound_follows_from_the_mean_square() -> None:
    """SciPy's truncated normal law is the reference; the worst lognormal law reaches the bound of a share."""
    logs = [
        LogValue(unit=f"u{i}", value=None, low=0.0, high=3.0, variance=v, variance_sd=2.0)
        for i, v in enumerate((0.5, -0.3, 1.0, 0.2))
    ]
    values = LogValues.of(logs)
    square = MeanSquare(values)
    assert not square.shows
    law = stats.truncnorm(-0.35, math.inf, loc=0.35, scale=1.0)
    assert square.bound(0.9) ** 2 == pytest.approx(law.ppf(0.9), rel=1e-4)
    spreads = np.linspace(0, 3, 3001)
    worst = np.max(np.exp(ndtri(0.95) * spreads - spreads**2))
    assert square.share_bound(0.95, 0.9) == pytest.approx(square.bound(0.9) * worst, rel=1e-6)
    # Units with more scatter than their errors widen it; one unit alone does not make the term detected.
    wide = MeanSquare(LogValues.of([replace(log, variance=10 * (log.variance or 0.0)) for log in logs]))
    scale = math.sqrt(89 / (4 * 3))
    law = stats.truncnorm(-3.5 / scale, math.inf, loc=3.5, scale=scale)
    assert wide.bound(0.9) ** 2 == pytest.approx(law.ppf(0.9), rel=1e-4)
    assert not MeanSquare(LogValues.of([*logs, replace(logs[0], unit="one", variance=9.0)])).shows
    assert MeanSquare(LogValues.of([replace(log, variance=6.0) for log in logs])).shows


def test_only_the_odd_unit_is_found() -> None:
    """It is six spreads away, also in a fleet of mostly bounded units; other fleets have no odd unit."""
    rng = np.random.default_rng(46)
    for logs, factor in (
        (strong_fleet(rng, units=20, tau=0.1, error=0.02), math.exp(0.6)),
        (weak_fleet(rng, units=20, tau=0.2, error=0.8), 10.0),
    ):
        assert not any(u.odd for u in population(logs).units)
        odd = LogValue(unit="odd", value=factor, low=0.9 * factor, high=1.1 * factor)
        found = population([*logs, odd])
        assert [u.unit for u in found.units if u.odd] == ["odd"]


def test_leave_one_out_agrees_with_the_t_test() -> None:
    """With equal weights, each unit is compared with the mean and standard deviation of the others."""
    y = np.random.default_rng(47).standard_normal(7)
    p = leave_one_out(y, np.full(7, 1e-9), 1.0)
    others = np.delete(y, 2)
    t = (y[2] - others.mean()) / (others.std(ddof=1) * math.sqrt(1 + 1 / 6))
    assert p[2] == pytest.approx(2 * stats.t.sf(abs(t), 5), rel=1e-6)


def _uneven_fleet(rng: np.random.Generator, odd: float) -> list[LogValue]:
    """Return ten units of one, two or eight logs, known to 1, 10 or 25 %; the fifth is off by `odd`."""
    logs = []
    for unit in range(10):
        own = 0.1 * rng.standard_normal() + (odd if unit == 4 else 0.0)
        for _ in range((1, 2, 8)[unit % 3]):
            error = (0.01, 0.1, 0.25)[unit % 3]
            value = float(np.exp(own + (error**2 + 0.1**2) ** 0.5 * rng.standard_normal()))
            half = 1.959964 * error
            low, high = value * math.exp(-half), value * math.exp(half)
            logs.append(LogValue(unit=f"u{unit}", value=value, low=low, high=high))
    return logs


@pytest.mark.slow
def test_the_false_alarm_rate_of_unequal_units_is_five_per_cent() -> None:
    """The spreads between and within units are unknown in these 25 fleets."""
    rng = np.random.default_rng(4503)
    alarms = [any(u.odd for u in population(_uneven_fleet(rng, 0.0)).units) for _ in range(25)]
    assert np.mean(alarms) <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / 25)
    odd = [u.unit for u in population(_uneven_fleet(rng, 1.2)).units if u.odd]
    assert odd == ["u4"]


def test_scatter_of_logs_makes_a_unit_less_odd() -> None:
    """The reference p-value is from draws with the spread, the scatter and the error."""
    rng = np.random.default_rng(4504)
    values = LogValues.of(strong_fleet(rng, units=30, tau=0.2, error=0.01))
    posterior = Posterior(values, np.zeros(1))
    squares = Squares(np.array([2.5, 2.5]), np.array([0.1, 0.1]), np.zeros(2))
    narrow, wide = posterior.p_values(squares, np.array([0.0, 0.3]))
    draws = rng.choice(posterior.prediction((np.arange(4000) + 0.5) / 4000), 400_000)
    square = np.exp(2 * (draws + 0.3 * rng.standard_normal(draws.size))) + 0.1 * rng.standard_normal(
        draws.size
    )
    assert wide == pytest.approx(2 * np.mean(square > 2.5), rel=0.1)
    assert narrow < wide / 2


def test_two_units_have_no_spread_but_a_finding() -> None:
    """The median is still estimated."""
    found = population(strong_fleet(np.random.default_rng(49), units=2, tau=0.1, error=0.1))
    assert found.spread is None
    assert found.tolerance is None
    assert found.prediction is None
    (finding,) = found.findings
    assert finding.text.startswith("2 units: the spread between units")
    assert found.median.value is not None
    assert found.median.low < found.median.value < found.median.high


def test_a_prediction_contains_the_next_unit() -> None:
    """The mean probability content of the intervals equals the level."""
    rng = np.random.default_rng(50)
    inside = []
    for _ in range(25):
        found = population(strong_fleet(rng, units=8, tau=0.2, error=0.02))
        assert found.prediction is not None
        low, high = np.log(found.prediction) / 0.2
        inside.append(ndtr(high) - ndtr(low))
    assert np.mean(inside) == pytest.approx(0.95, abs=0.03)


@pytest.mark.parametrize(
    "wrong",
    [
        {"value": 2.0},
        {"low": -1.0},
        {"high": math.inf},
        {"value": 0.0, "low": 0.0},
        {"variance": 1.0},
        {"variance": 1.0, "variance_sd": 0.0},
        {"level": 1.0},
    ],
)
def test_impossible_values_are_rejected(wrong: dict[str, float]) -> None:
    """The error contains the unit."""
    with pytest.raises(ValueError, match="u1: "):
        LogValue(unit="u1", **({"value": 1.0, "low": 0.5, "high": 1.5} | wrong))


def test_no_logs_and_impossible_shares_are_rejected() -> None:
    with pytest.raises(ValueError, match="at least one log"):
        population([])
    logs = strong_fleet(np.random.default_rng(51), units=3, tau=0.1, error=0.1)
    with pytest.raises(ValueError, match="between 0 and 1, got 95"):
        population(logs, content=95)


def test_an_undetected_term_is_bounded() -> None:
    """Each log's error of the square is 8, so the median unit and the spread are unknown.

    The limits still cover the truth: in five fleets, one miss may be chance, but not three.
    """
    covered = []
    for seed in range(5):
        found = population(weak_fleet(np.random.default_rng([81, seed]), units=8, logs=2, tau=0.3, error=8.0))
        assert found.bounded
        assert found.spread is None
        assert found.within is None
        assert found.median.low == 0.0
        assert found.median.value == found.median.high
        assert found.prediction is not None
        assert found.prediction[0] == 0.0
        assert [finding.code for finding in found.findings] == ["weak-term"]
        covered.append(found.median.high >= 1 and (found.tolerance or 0.0) >= math.exp(1.645 * 0.3))
    assert sum(covered) >= 3


@pytest.mark.slow
def test_limits_of_a_weak_median_cover_it() -> None:
    """Ten units have an error of the square of 0.8; the posterior's tail to zero does not bias the limits."""
    found = [
        population(weak_fleet(np.random.default_rng([82, seed]), units=10, tau=0.3, error=0.8))
        for seed in range(8)
    ]
    assert sum(one.median.low <= 1 <= one.median.high for one in found) >= 6
    informative = [math.log(one.median.value) for one in found if not one.bounded]
    assert abs(np.mean(informative)) < 0.25


def test_two_bounded_units_have_a_bound() -> None:
    found = population([LogValue(unit=u, value=None, low=0.0, high=h) for u, h in (("a", 2.0), ("b", 3.0))])
    assert found.bounded
    assert found.median.value == found.median.high == pytest.approx(3.0, rel=0.01)


@pytest.mark.parametrize("logs", [1, 3])
@pytest.mark.parametrize("error", [0.004, 0.1])
def test_membership_agrees_with_the_full_posterior(logs: int, error: float) -> None:
    """The law of the next log at 801 points gives the same p-values as a sum over the posterior."""
    rng = np.random.default_rng(4711)
    fleet = strong_fleet(rng, units=7, logs=logs, tau=0.2, error=error)
    values = LogValues.of(fleet)
    posterior, found = Posterior.whole(values), population(fleet)
    for far in (-1.2, -0.5, 0.0, 0.3, 0.9):
        value = found.median.value * math.exp(far)
        new = LogValue(
            unit="new", value=value, low=value * math.exp(-1.96 * error), high=value * math.exp(1.96 * error)
        )
        exact = posterior.p_value(LogValues.of([new]))
        # The points are 0.015 deviations apart; probabilities below 1e-7 are omitted.
        assert membership(found, new) == pytest.approx(exact, rel=0.01, abs=1e-5)


def test_the_law_of_the_next_log_agrees_with_the_posterior() -> None:
    """Nearly equal normal laws are merged, which changes probabilities by less than 2e-5."""
    values = LogValues.of(weak_fleet(np.random.default_rng(31), units=12, logs=2, tau=0.3, error=0.3))
    posterior = Posterior.whole(values)
    assert len(posterior.omega) > 1
    law, wide = posterior.next_log(), np.hypot(posterior.tau, posterior.omega)
    for point, below in list(zip(law.points, law.below, strict=True))[::40]:
        exact = float(np.sum(posterior.weight * ndtr((point - posterior.mu) / wide)))
        assert below == pytest.approx(exact, abs=2e-5)
