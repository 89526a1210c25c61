"""Drift and temperature over a fleet: known slopes, their coverage, and what is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest

from imucal.errors import DataError
from imucal.fleet import LogValue, trend
from imucal.fleet.trend import SlopePosterior, adjust, labelled_logs
from imucal.fleet.values import LogValues
from tests.benchmarks.fleet_trends import make_fleet, said


def _fleet(
    rng: np.random.Generator, *, beta: float, gamma: float, spread: float = 0.0, units: int = 8
) -> list[LogValue]:
    """Return units at five temperatures over two years, each measured to 3 %, scattering by 5 %."""
    logs = []
    for unit in range(units):
        level, own = 0.2 * rng.standard_normal(), beta + spread * rng.standard_normal()
        for i, celsius in enumerate((-10.0, 10.0, 25.0, 40.0, 60.0)):
            days = 730 * ((i * 3) % 5) / 4
            y = level + own * (celsius - 25) + gamma * days / 365.25 + 0.058 * rng.standard_normal()
            value = math.exp(y)
            logs.append(
                LogValue(
                    unit=str(unit),
                    value=value,
                    low=value * math.exp(-0.0588),
                    high=value * math.exp(0.0588),
                    temperature_c=celsius,
                    days=days,
                )
            )
    return logs


def test_known_slopes_are_covered() -> None:
    """Forty fleets whose units differ in their slopes: about 95 % of the intervals hold the truth."""
    rng = np.random.default_rng(61)
    held = np.zeros(2)
    for _ in range(40):
        found = trend(_fleet(rng, beta=0.004, gamma=0.1, spread=0.002))
        assert found.temperature is not None
        assert found.drift is not None
        held += [
            found.temperature.low <= 0.004 <= found.temperature.high,
            found.drift.low <= 0.1 <= found.drift.high,
        ]
    assert (held >= 34).all()


def test_exact_logs_give_exact_slopes() -> None:
    """An interval of nearly no width about the slope, which does not depend on the units' levels."""
    logs = [
        LogValue(unit=u, value=v, low=v * 0.9999, high=v * 1.0001, temperature_c=t)
        for u, level in (("a", 1.0), ("b", 3.0), ("c", 0.2))
        for t in (15.0, 25.0, 45.0)
        for v in (level * math.exp(0.01 * (t - 25)),)
    ]
    found = trend(logs)
    assert found.drift is None
    assert found.units == 3
    assert found.temperature is not None
    assert found.temperature.value == pytest.approx(0.01, rel=1e-6)
    assert found.temperature.high - found.temperature.low < 1e-4


def test_one_temperature_a_unit_is_refused() -> None:
    """Units that differ in temperature tell nothing of what temperature does to a unit."""
    logs = [
        LogValue(unit=str(i), value=1.0, low=0.9, high=1.1, temperature_c=20.0 + i, days=1.0)
        for i in range(5)
    ]
    with pytest.raises(DataError, match="two temperatures"):
        trend([*logs, *logs])


def test_logs_without_labels_and_bounds_are_left_out() -> None:
    """What has no temperature, or no estimate, does not change the slope."""
    logs = [
        LogValue(unit="a", value=v, low=0.99 * v, high=1.01 * v, temperature_c=t)
        for t, v in ((0.0, 1.0), (20.0, 1.2), (40.0, 1.4))
    ]
    extra = [
        LogValue(unit="a", value=9.0, low=8.0, high=10.0),
        LogValue(unit="a", value=None, low=0.0, high=1.0, temperature_c=90.0),
    ]
    assert trend([*logs, *extra]) == trend(logs)


def test_as_many_logs_as_slopes_leave_no_scatter_to_judge() -> None:
    """Three logs of three temperatures and days: the slopes are exact, and the scatter is none."""
    logs = [
        LogValue(unit=u, value=v, low=v / 1.01, high=v * 1.01, temperature_c=t, days=d)
        for u, level in (("a", 1.0), ("b", 2.0), ("c", 0.7))
        for t, d in ((10.0, 0.0), (25.0, 365.25), (45.0, 800.0))
        for v in (level * math.exp(0.01 * (t - 25) + 0.1 * d / 365.25),)
    ]
    found = trend(logs)
    assert found.temperature is not None
    assert found.temperature.value == pytest.approx(0.01, rel=1e-6)
    assert found.drift is not None
    assert found.drift.value == pytest.approx(0.1, rel=1e-6)


def test_a_unit_that_drifts_alone_is_found() -> None:
    """One of eight moves by 60 % a year where the others move by 10 %; without it none is odd."""
    rng = np.random.default_rng(62)
    logs = _fleet(rng, beta=0.004, gamma=0.1)
    assert not any(slope.odd for slope in trend(logs).slopes)
    moved = [
        replace(log, value=log.value * f, low=log.low * f, high=log.high * f)
        if log.unit == "3" and log.value
        else log
        for log in logs
        for f in (math.exp(0.5 * log.days / 365.25),)
    ]
    found = trend(moved)
    assert [(s.unit, s.label) for s in found.slopes if s.odd] == [("3", "days")]
    assert len(found.slopes) == 16


def test_as_many_logs_as_unknowns_leave_no_scatter_to_judge() -> None:
    """Three logs a unit, at three temperatures on three days since 1970: the slopes are exact."""
    days = 20_454.0
    logs = []
    for unit in range(6):
        for celsius, day in ((15.0, 0.0), (25.0, 1.0), (45.0, 2.0)):
            value = 1e-4 * math.exp(0.1 * unit + 0.01 * celsius + 0.5 * day / 365.25)
            log = LogValue(unit=str(unit), value=value, low=value * 0.9, high=value * 1.1)
            logs.append(replace(log, temperature_c=celsius, days=days + day))
    found = trend(logs)
    assert found.temperature is not None
    assert found.drift is not None
    assert found.temperature.value == pytest.approx(0.01, rel=1e-6)
    assert found.drift.value == pytest.approx(0.5, rel=1e-6)
    # The day from which days are counted is nothing to the slopes.
    moved = trend([replace(log, days=log.days - days) for log in logs])
    assert moved.drift is not None
    assert moved.drift.value == pytest.approx(found.drift.value, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "error", "omega"), [((10, 4), 0.006, 0.15), ((12, 2), 0.006, 0.15), ((8, 5), -0.8, 0.0)]
)
def test_units_without_a_trend_are_seldom_said_to_move(
    shape: tuple[int, int], error: float, omega: float
) -> None:
    """Ten fleets of four terms, at random days and temperatures: two of ten would be chance, four not.

    Logs of a unit scatter by 15 %, far beyond their errors, of two logs too, whose scatter no unit shows by
    itself; the weak term is bounded by two logs of three. Where 5 % alarm falsely, four of ten do so once
    in a thousand times.
    """
    rng = np.random.default_rng([63, *shape])
    found = np.array([said(make_fleet(rng, shape, error, omega)) for _ in range(10)])
    alone, _, fleet, held, own = found.sum(axis=0)
    assert alone < 4
    assert fleet < 4
    assert held >= 8.5
    assert own >= 8.5


@pytest.mark.parametrize(("label", "by"), [("day", 0.1 / 100), ("celsius", 0.01)])
def test_what_moves_by_ten_per_cent_is_found(label: str, by: float) -> None:
    """10 % in 100 days of one unit, or 1 % a °C of all, beside errors of 5 %."""
    rng = np.random.default_rng(64)
    alone = label == "day"
    _, of_unit, of_fleet, *_ = said(make_fleet(rng, (10, 6), 0.05, 0.0, alone=alone, **{label: by}))
    assert of_unit if alone else of_fleet


def test_terms_that_were_looked_at_together_share_their_false_alarms() -> None:
    """Beside nine terms that do not move, a unit must move by more to be named."""
    rng = np.random.default_rng(62)
    moving = trend(_fleet(rng, beta=0.004, gamma=0.1))
    still = [trend(_fleet(rng, beta=0.0, gamma=0.0)) for _ in range(3)]
    together = adjust([moving, *still])
    assert together[0].temperature == moving.temperature
    for one, alone in zip(together, [moving, *still], strict=True):
        for slope, before in zip((*one.means, *one.slopes), (*alone.means, *alone.slopes), strict=True):
            assert slope.p_value == before.p_value
            assert slope.p_odd >= slope.p_value
    assert adjust(together) == together


def test_temperature_and_time_that_move_together_are_refused() -> None:
    """Every unit was warmer by 10 °C a year later: which of the two moves it, nobody knows."""
    logs = [
        LogValue(
            unit=u, value=1.0 + late, low=0.9, high=1.3, temperature_c=15.0 + 10 * late, days=365.0 * late
        )
        for u in "abcd"
        for late in (0, 0.1, 0.2)
    ]
    with pytest.raises(DataError, match="changed together in every unit"):
        trend(logs)


def test_a_unit_that_alone_tells_of_temperature_is_not_judged_by_the_others() -> None:
    """It drifts away, but for all that the others tell it was the warmth."""
    rng = np.random.default_rng(66)
    logs = [
        LogValue(unit=str(u), value=v, low=0.95 * v, high=1.05 * v, temperature_c=20 + t * (u == 0), days=d)
        for u in range(6)
        for t, d in ((0.0, 0.0), (10.0, 100.0), (5.0, 200.0), (20.0, 300.0), (3.0, 400.0))
        for v in (math.exp(0.05 * rng.standard_normal() + 0.01 * d * (u == 0)),)
    ]
    found = trend(logs)
    assert not any(slope.odd for slope in found.slopes)
    assert {mean.label for mean in found.means} == {"temperature_c", "days"}


def test_bounds_with_a_variance_count_and_an_absent_term_is_refused() -> None:
    """A weak log tells by its squared coefficient; where all of them are zero, there is no slope."""
    logs = [
        LogValue(
            unit=u, value=None, low=0.0, high=2.0, variance=2.0 + 0.8 * heat, variance_sd=0.5,
            temperature_c=25 + 10 * heat,
        )
        for u in "abcdef"
        for heat in (-1.0, 0.0, 1.0)
    ]  # fmt: skip
    found = trend(logs)
    assert found.temperature is not None
    # Of the square, 0.8 in 2 over 10 °C; of the coefficient, half of it.
    assert found.temperature.value == pytest.approx(0.5 * 0.4 / 10, rel=1e-3)
    with pytest.raises(DataError, match="only bound this term"):
        trend([replace(log, variance=0.1) for log in logs])


def test_the_posterior_is_that_of_dense_matrices() -> None:
    """Weights and mean slopes at points of the grid, against covariances of all logs written out."""
    rng = np.random.default_rng(65)
    logs, _ = labelled_logs(_fleet(rng, beta=0.004, gamma=0.1, spread=0.002, units=4))
    posterior = SlopePosterior(logs)
    points = np.argsort(posterior.weight)[[-1, -5, -40]]
    heights = []
    for point in points:
        height, mean, covariance = _dense(logs, float(posterior.omega[point]), posterior.tau[point])
        heights.append(height)
        assert mean == pytest.approx(posterior.mean[point], rel=1e-7)
        assert covariance == pytest.approx(posterior.covariance[point], rel=1e-7)
    expected = np.log(posterior.weight[points])
    assert np.diff(heights) == pytest.approx(np.diff(expected), rel=1e-6)


def _dense(logs: LogValues, omega: float, tau: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return log-posterior, mean slopes and covariance by generalized least squares, levels beside slopes."""
    same = logs.unit[:, None] == logs.unit
    cover = np.diag(logs.deviation**2 + omega**2) + same * ((logs.labels * tau**2) @ logs.labels.T)
    design = np.column_stack([logs.labels, np.eye(int(logs.unit[-1]) + 1)[logs.unit]])
    inverse = np.linalg.inv(cover)
    covariance = np.linalg.inv(design.T @ inverse @ design)
    beta = covariance @ design.T @ inverse @ logs.centre
    rest = logs.centre - design @ beta
    prior = math.log(omega**2 * np.sqrt(np.sum((logs.deviation**2 + omega**2) ** -2.0)))
    for x, t in zip(logs.labels.T, tau, strict=True):
        weight = 1 / (logs.deviation**2 + omega**2)
        error2 = [
            1 / np.sum(w * (own - np.average(own, weights=w)) ** 2)
            for unit in range(int(logs.unit[-1]) + 1)
            for own, w in ((x[logs.unit == unit], weight[logs.unit == unit]),)
        ]
        prior += math.log(t**2 * np.sqrt(np.sum((np.array(error2) + t**2) ** -2.0)))
    height = prior - 0.5 * (
        rest @ inverse @ rest + np.linalg.slogdet(cover)[1] - np.linalg.slogdet(covariance)[1]
    )
    labels = logs.labels.shape[1]
    return float(height), beta[:labels], covariance[:labels, :labels]
