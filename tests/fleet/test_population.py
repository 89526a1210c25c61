"""Tests of the population of a fleet: exact limits, coverage, odd units and two groups."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtr, ndtri

from imucal.fleet.groups import find_groups
from imucal.fleet.population import membership, population
from imucal.fleet.tolerance import tolerance_factor
from imucal.fleet.values import LogValue
from imucal.multiple_tests import holm
from tests.fleet.simulated import strong_fleet, two_batches, weak_fleet


@pytest.mark.parametrize("units", [3, 5, 20])
def test_exact_units_have_the_noncentral_t_bound(units: int) -> None:
    """For exact units, the bound is the mean plus k standard deviations; the median uses Student's t."""
    logs = strong_fleet(np.random.default_rng(units), units=units, tau=0.02, error=1e-6)
    y = np.log([log.value or math.nan for log in logs])
    mean, sd = float(y.mean()), float(y.std(ddof=1))
    found = population(logs)
    factor = stats.nct.ppf(0.95, units - 1, ndtri(0.95) * math.sqrt(units)) / math.sqrt(units)
    assert math.log(found.tolerance or 0.0) == pytest.approx(mean + factor * sd, rel=1e-6)
    half = stats.t.ppf(0.975, units - 1) * sd / math.sqrt(units)
    assert math.log(found.median.high) == pytest.approx(mean + half, rel=1e-6)
    assert math.log(found.median.low) == pytest.approx(mean - half, rel=1e-6)
    assert found.prediction is not None
    reach = stats.t.ppf(0.975, units - 1) * sd * math.sqrt(1 + 1 / units)
    assert math.log(found.prediction[1]) == pytest.approx(mean + reach, rel=1e-6)


def test_published_factors_of_a_tolerance_bound() -> None:
    """Source: ISO 16269-6:2014, table of one-sided factors with unknown deviation (95 %, 95 %)."""
    published = {5: 4.203, 10: 2.911, 20: 2.396, 50: 2.065}
    for n, factor in published.items():
        assert tolerance_factor(n, n - 1, 0.95, 0.95) == pytest.approx(factor, abs=6e-4)


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


@pytest.mark.parametrize(
    ("units", "logs", "tau", "error", "omega"),
    [(10, 3, 0.2, 0.05, 0.1), (10, 1, 0.3, 0.02, 0.0), (5, 1, 0.3, 0.1, 0.0), (20, 2, 0.1, 0.1, 0.05)],
)
def test_intervals_have_the_nominal_coverage(
    units: int, logs: int, tau: float, error: float, omega: float
) -> None:
    """In 400 fleets, median, spreads, next unit and bound each cover in at least 95 %, within chance."""
    rng = np.random.default_rng([61130, units, logs])
    covered = []
    for _ in range(400):
        found = population(strong_fleet(rng, units=units, logs=logs, tau=tau, error=error, omega=omega))
        assert found.spread is not None
        assert found.prediction is not None
        low, high = np.log(np.maximum(found.prediction, 1e-99)) / tau
        covered.append(
            [
                found.median.low <= 1 <= found.median.high,
                found.spread.low <= tau <= found.spread.high,
                found.within is None or found.within.low <= omega <= found.within.high,
                (found.tolerance or 0.0) >= math.exp(ndtri(0.95) * tau),
                ndtr(high) - ndtr(low),
            ]
        )
    least = 0.95 - 3 * math.sqrt(0.95 * 0.05 / 400)
    # The interval of the spread takes the errors of the units as known.
    assert np.all(np.mean(covered, axis=0) > [least, 0.87, least, least, least])


def test_a_few_bounded_units_count_at_their_limit() -> None:
    """A fifth of the units only bound the term, and median and bound still cover."""
    rng = np.random.default_rng(61131)
    covered = []
    for _ in range(200):
        found = population(weak_fleet(rng, units=12, tau=0.3, error=0.35))
        if found.bounded:
            continue
        covered.append(
            [
                found.median.low <= 1 <= found.median.high,
                (found.tolerance or 0) >= math.exp(ndtri(0.95) * 0.3),
            ]
        )
    assert len(covered) > 100
    assert np.all(np.mean(covered, axis=0) > 0.9)


@pytest.mark.parametrize(
    ("units", "logs", "tau", "error"),
    [(6, 2, 0.1, 5.0), (10, 1, 0.3, 2.0), (24, 3, 0.3, 8.0), (20, 1, 0.3, 0.8)],
)
def test_a_mostly_bounded_term_has_valid_bounds(units: int, logs: int, tau: float, error: float) -> None:
    """They are for median, next unit and tolerance; fleets that detect the term by chance also cover."""
    rng = np.random.default_rng([61132, units])
    found = [population(weak_fleet(rng, units=units, logs=logs, tau=tau, error=error)) for _ in range(200)]
    bounded = [f for f in found if f.bounded]
    assert len(bounded) > 150
    assert all(f.median.low == 0 and f.spread is None and f.within is None for f in bounded)
    assert all(f.prediction is not None and f.prediction[0] == 0 for f in bounded)
    assert {x.code for f in bounded for x in f.findings} == {"weak-term"}
    least = 0.95 - 3 * math.sqrt(0.95 * 0.05 / 200)
    assert np.mean([f.median.low <= 1 <= f.median.high for f in found]) > least
    assert np.mean([(f.tolerance or 0) >= math.exp(ndtri(0.95) * tau) for f in found]) > least


def test_only_the_odd_unit_is_found() -> None:
    """It is six spreads away, also in a fleet of mostly bounded units; other fleets have no odd unit."""
    rng = np.random.default_rng(61133)
    for logs, factor in (
        (strong_fleet(rng, units=20, tau=0.1, error=0.02), math.exp(0.6)),
        (weak_fleet(rng, units=20, tau=0.2, error=0.8), 10.0),
    ):
        assert not any(u.odd for u in population(logs).units)
        odd = LogValue(unit="odd", value=factor, low=0.9 * factor, high=1.1 * factor)
        found = population([*logs, odd])
        assert [u.unit for u in found.units if u.odd] == ["odd"]


def test_each_unit_is_compared_with_the_others_by_students_t() -> None:
    logs = strong_fleet(np.random.default_rng(61134), units=7, tau=0.2, error=1e-6)
    y = np.log([log.value or math.nan for log in logs])
    others = np.delete(y, 2)
    t = (y[2] - others.mean()) / (others.std(ddof=1) * math.sqrt(1 + 1 / 6))
    assert population(logs).units[2].p_value == pytest.approx(2 * stats.t.sf(abs(t), 5), rel=1e-6)


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


@pytest.mark.parametrize("uneven", [False, True])
def test_the_false_alarm_rate_is_five_per_cent(*, uneven: bool) -> None:
    """Units may be known to 1 to 25 % by one to eight logs."""
    rng = np.random.default_rng(61135)
    fleets = 300

    def fleet() -> list[LogValue]:
        return _uneven_fleet(rng, 0.0) if uneven else strong_fleet(rng, units=10, tau=0.2, error=0.02)

    alarms = [any(unit.odd for unit in population(fleet()).units) for _ in range(fleets)]
    assert np.mean(alarms) <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / fleets)
    odd = [unit.unit for unit in population(_uneven_fleet(rng, 1.5)).units if unit.odd]
    assert odd == ["u4"]


@pytest.mark.parametrize(("units", "least"), [(10, 0.84), (30, 0.93)])
def test_the_bound_covers_two_batches(units: int, least: float) -> None:
    """A fifth of the units is 1.8 times larger. Of ten units, 11 % of the fleets contain none of these."""
    rng = np.random.default_rng([61136, units])
    truth = math.exp(float(np.quantile(two_batches(np.random.default_rng(1), 1_000_000), 0.95)))
    covered = []
    for _ in range(300):
        logs = [
            LogValue(unit=f"u{number}", value=value, low=0.98 * value, high=1.02 * value)
            for number, value in enumerate(np.exp(two_batches(rng, units)).tolist())
        ]
        covered.append((population(logs).tolerance or 0.0) >= truth)
    assert np.mean(covered) > least


def test_two_groups_are_named() -> None:
    """The limits of the next unit contain both groups, and a log of either is a member."""
    rng = np.random.default_rng(61137)
    small = np.exp(0.05 * rng.standard_normal(12)).tolist()
    large = np.exp(0.6 + 0.05 * rng.standard_normal(4)).tolist()
    logs = [
        LogValue(unit=f"{batch}{number}", value=value, low=0.99 * value, high=1.01 * value)
        for batch, values in (("a", small), ("b", large))
        for number, value in enumerate(values)
    ]
    found = population(logs)
    assert found.groups == (tuple(f"a{i}" for i in range(12)), tuple(f"b{i}" for i in range(4)))
    (finding,) = found.findings
    assert (finding.level, finding.code) == ("warning", "two-groups")
    assert "b0, b1, b2, b3, which are 1.8" in finding.text
    assert found.prediction is not None
    assert found.prediction[0] < min(small) < max(large) < found.prediction[1] < 3
    assert found.median.low <= 1 <= found.median.high
    members = [LogValue(unit="new", value=v, low=0.99 * v, high=1.01 * v) for v in (1.0, math.exp(0.6), 1.35)]
    near, large_one, between = (membership(found, log) for log in members)
    assert near > 0.2
    assert large_one > 0.2
    assert between < 1e-3


def test_normal_values_seldom_form_two_groups() -> None:
    """The rate is two in a thousand; groups need at least two values each."""
    rng = np.random.default_rng(61138)
    alarms = sum(
        find_groups(rng.standard_normal(n)) is not None for n in (6, 10, 20, 50) for _ in range(1000)
    )
    assert alarms <= 8 + 3 * math.sqrt(8)
    assert find_groups(np.array([0.0, 0.1, 0.2, 0.3, 5.0])) is None
    assert find_groups(np.ones(8)) is None
    assert find_groups(np.array([0.0, 9.0])) is None


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


def test_two_bounded_units_have_a_bound() -> None:
    found = population([LogValue(unit=u, value=None, low=0.0, high=h) for u, h in (("a", 2.0), ("b", 3.0))])
    assert found.bounded
    assert found.median.value == found.median.high == pytest.approx(3.0, rel=0.01)


def test_membership_is_the_t_test_of_one_more_unit() -> None:
    """Spread of the units, scatter of logs and the log's own error add up."""
    fleet = strong_fleet(np.random.default_rng(61139), units=7, tau=0.2, error=1e-6)
    y = np.log([log.value or math.nan for log in fleet])
    found = population(fleet)
    for far in (-1.2, 0.0, 0.3, 0.9):
        value = math.exp(far)
        new = LogValue(unit="new", value=value, low=value * math.exp(-0.196), high=value * math.exp(0.196))
        scale = math.sqrt(float(y.var(ddof=1)) * (1 + 1 / 7) + 0.1**2)
        exact = 2 * stats.t.sf(abs(far - y.mean()) / scale, 6)
        assert membership(found, new) == pytest.approx(exact, rel=1e-3)
    assert membership(found, replace(new, value=None, low=0.0)) == 1.0
    with pytest.raises(ValueError, match="at least 3 units, got 2"):
        membership(population(fleet[:2]), new)


@pytest.mark.parametrize("logs", [2, 5])
def test_limits_of_a_unit_cover_it(logs: int) -> None:
    """Its logs scatter by their errors, or by three times as much."""
    rng = np.random.default_rng([61140, logs])
    for factor in (1.0, 3.0):
        covered = []
        for _ in range(400):
            squares = 1 + 0.1 * factor * rng.standard_normal(logs)
            values = [
                LogValue(unit="u", value=1.0, low=0.9, high=1.1, variance=float(v), variance_sd=0.1)
                for v in squares
            ]
            (unit,) = population(values).units
            covered.append(unit.low <= 1 <= unit.high)
        assert np.mean(covered) > (0.93 if factor == 1 else 0.7)


def test_limits_of_other_levels_are_converted() -> None:
    """A log at the level of one standard error has the same limits as one at 95 %."""
    narrow = LogValue(unit="u", value=1.0, low=math.exp(-0.1), high=math.exp(0.1), level=2 * ndtr(1.0) - 1)
    (unit,) = population([narrow]).units
    assert unit.high == pytest.approx(math.exp(0.1959964))
    assert unit.low == pytest.approx(math.exp(-0.1959964))


@pytest.mark.parametrize(("omega", "error"), [(0.0, 0.05), (0.1, 0.03), (0.2, 0.1)])
def test_logs_of_a_unit_seldom_differ_by_chance(omega: float, error: float) -> None:
    """At most 7 % of 200 fleets of ten units have a false alarm, also if logs scatter."""
    rng = np.random.default_rng([61141, round(100 * omega)])
    alarms = 0
    for _ in range(200):
        fleet = strong_fleet(rng, units=10, logs=3, tau=0.2, error=error, omega=omega)
        p_values = [unit.p_logs or 0.0 for unit in population(fleet).units]
        alarms += min(holm(p_values)) <= 0.05
    assert alarms <= 14


@pytest.mark.parametrize("omega", [0.0, 0.02])
def test_a_log_that_differs_is_found(omega: float) -> None:
    """It is 30 % larger than the other logs of its unit, and only this unit is found."""
    rng = np.random.default_rng([61142, round(100 * omega)])
    found = []
    for _ in range(20):
        *fleet, last = strong_fleet(rng, units=10, logs=3, tau=0.2, error=0.02, omega=omega)
        larger = replace(last, value=1.3 * (last.value or 0), low=1.3 * last.low, high=1.3 * last.high)
        units = population([*fleet, larger]).units
        p_values = holm([unit.p_logs or 0.0 for unit in units])
        found.append([unit.unit for unit, p in zip(units, p_values, strict=True) if p <= 0.05])
    assert sum("u9" in units for units in found) >= 19
    assert sum(len(units) > 1 for units in found) <= 3


def test_logs_of_few_units_are_compared_by_their_errors() -> None:
    """For fewer than four degrees of freedom of other units, it is Cochran's test of equal squares."""
    rng = np.random.default_rng(61143)
    squares = 1 + 0.1 * rng.standard_normal(6)
    logs = [
        LogValue(unit=f"u{i // 3}", value=1.0, low=0.9, high=1.1, variance=float(square), variance_sd=0.1)
        for i, square in enumerate(squares)
    ]
    for number, unit in enumerate(population(logs).units):
        own = squares[3 * number : 3 * number + 3]
        exact = stats.chi2.sf(float(np.sum((own - own.mean()) ** 2)) / 0.1**2, 2)
        assert unit.p_logs == pytest.approx(exact, rel=1e-9)
    assert population([logs[0], *logs[3:]]).units[0].p_logs is None
    odd = replace(logs[0], variance=2.0)
    first, second = population([odd, *logs[1:]]).units
    assert (first.p_logs or 1.0) < 1e-6
    assert second.p_logs == population(logs).units[1].p_logs


def test_logs_are_compared_with_those_of_other_units() -> None:
    """For exact logs, it is the F test of the scatter in a unit and in all other units."""
    fleet = strong_fleet(np.random.default_rng(61144), units=6, logs=3, tau=0.2, error=1e-7, omega=0.1)
    y = np.log([log.value or math.nan for log in fleet]).reshape(6, 3)
    squares = np.sum((y - y.mean(axis=1, keepdims=True)) ** 2, axis=1)
    for unit, own in zip(population(fleet).units, squares, strict=True):
        others = float(squares.sum() - own) / 10
        assert unit.p_logs == pytest.approx(stats.f.sf(float(own) / 2 / others, 2, 10), rel=1e-5)
