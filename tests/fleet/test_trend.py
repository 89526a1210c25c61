"""Drift and temperature over a fleet: known slopes, their coverage, and what is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest

from imucal.errors import DataError
from imucal.fleet import LogValue, trend


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
