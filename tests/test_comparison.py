"""Tests of compare: false alarm rate, bounds, and terms of only one report."""

import math
from dataclasses import replace

import numpy as np
import pytest

from imucal.comparison import compare
from imucal.errors import DataError
from imucal.fitting.noise_fit import Estimate
from imucal.recording import Sensor
from imucal.report.result import Report
from tests.report.synthetic import axis_report, consumer_report, small_report

GYRO = Sensor.GYROSCOPE
BASE = small_report()


def _estimate(key: str, value: float, deviation: float) -> Estimate:
    """Return an estimate whose logarithm has this standard error, with its 95 % interval."""
    wide = math.exp(1.96 * deviation)
    return Estimate(key=key, symbol=key, status="estimated", value=value, low=value / wide, high=value * wide)


def _bound(key: str, high: float) -> Estimate:
    return Estimate(key=key, symbol=key, status="bounded", value=None, low=0.0, high=high)


def _report(*estimates: Estimate) -> Report:
    """Return a report of one axis with these estimates."""
    (axis,) = BASE.axes
    return replace(BASE, axes=(replace(axis, fit=replace(axis.fit, estimates=estimates)),))


def test_a_report_does_not_differ_from_itself() -> None:
    """Bounds are not compared, and correlation times are separate terms."""
    result = compare(consumer_report(), consumer_report())
    assert result.significant == ()
    assert {d.outcome for d in result.differences} == {"same", "bounded"}
    assert {d.key for d in result.differences if d.axis == "gyro_z"} == {
        "N", "B", "K", "GM1", "GM1.T", "GM2", "GM2.T",
    }  # fmt: skip
    assert result.tested == sum(d.p is not None for d in result.differences) == 21


@pytest.mark.parametrize(("first", "second"), [(0.002, 0.002), (0.05, 0.2), (0.3, 0.3)])
def test_the_false_alarm_rate_of_one_term_is_alpha(first: float, second: float) -> None:
    """Without a change p is uniform: 5 % of records are below 0.05.

    It is exact for narrow intervals. With 30 % wide ones, the lower limit of a ratio scale is nearer than in
    normal theory, so the score is slightly conservative or liberal (within 1.5 %).
    """
    rng = np.random.default_rng(7)
    replications = 4000
    draws = np.exp(rng.standard_normal((replications, 2)) * [first, second])
    small = 0
    for a, b in draws.tolist():
        (difference,) = compare(
            _report(_estimate("N", a, first)), _report(_estimate("N", b, second))
        ).differences
        assert difference.p is not None
        small += difference.p < 0.05
    # Four standard errors of a proportion of 0.05, plus the approximation above.
    assert small / replications == pytest.approx(
        0.05, abs=4 * math.sqrt(0.05 * 0.95 / replications) + (0.015 if second > 0.1 else 0)
    )


def test_the_false_alarm_rate_of_many_terms_is_alpha() -> None:
    """With Holm's adjustment, at most 5 % of comparisons of 18 unchanged terms report a difference."""
    rng = np.random.default_rng(8)
    keys = [f"GM{i}" for i in range(1, 19)]
    replications, any_difference = 1000, 0
    for _ in range(replications):
        a, b = (
            _report(
                *(
                    replace(_estimate("GM", value, 0.05), key=key)
                    for key, value in zip(keys, np.exp(0.05 * rng.standard_normal(18)).tolist(), strict=True)
                )
            )
            for _ in range(2)
        )
        any_difference += bool(compare(a, b).significant)
    # Four standard errors of a proportion of 0.05.
    assert any_difference / replications <= 0.05 + 4 * math.sqrt(0.05 * 0.95 / replications)


def test_holms_adjustment_agrees_with_a_manual_calculation() -> None:
    """The p-values 0.01, 0.02 and 0.04 become 0.03, 0.04 and 0.04 (Holm 1979)."""
    scores = {"N": 2.5758, "B": 2.3263, "K": 2.0537}
    a = _report(
        *(Estimate(key=k, symbol=k, status="estimated", value=1.0, low=1.0, high=1.0) for k in scores)
    )
    b = _report(
        *(
            Estimate(
                key=k,
                symbol=k,
                status="estimated",
                value=1 + z / 10,
                low=1 + z / 10 - 0.1 * 1.959964,
                high=9.0,
            )
            for k, z in scores.items()
        )
    )
    adjusted = {d.key: d.p_adjusted for d in compare(a, b).differences}
    assert adjusted["N"] == pytest.approx(0.03, rel=2e-3)
    assert adjusted["B"] == pytest.approx(0.04, rel=2e-3)
    assert adjusted["K"] == pytest.approx(0.04, rel=2e-3)


def test_the_score_changes_sign_with_the_order() -> None:
    a, b = _report(_estimate("N", 1.0, 0.1)), _report(_estimate("N", 1.3, 0.2))
    (forth,), (back,) = compare(a, b).differences, compare(b, a).differences
    assert forth.z is not None
    assert back.z is not None
    assert forth.z == pytest.approx(-back.z)
    assert forth.z > 0
    assert forth.p == pytest.approx(back.p)


def test_a_bound_is_tested_against_a_value() -> None:
    """K differs if the other record's bound is below it, but not if the bound is above."""
    found = _report(_estimate("K", 1.0, 0.05))
    (low,) = compare(_report(_bound("K", 0.2)), found).differences
    (high,) = compare(_report(_bound("K", 1.5)), found).differences
    assert (low.outcome, high.outcome) == ("differs", "same")
    assert low.z is not None
    assert low.z > 0
    assert low.ratio is None


def test_an_estimate_whose_interval_reaches_zero_is_tested() -> None:
    """A lower limit of 0 must not give an infinite score."""
    vague = _report(Estimate(key="K", symbol="K", status="estimated", value=1.0, low=0.0, high=3.0))
    (difference,) = compare(vague, _report(_estimate("K", 1.5, 0.05))).differences
    assert difference.outcome == "same"


def test_a_tolerance_ignores_small_significant_differences() -> None:
    """A difference of 2 % is thirty standard errors here; a tolerance of 5 % ignores it, but not 10 %."""
    a = _report(_estimate("N", 1.0, 0.0005))
    b, c = _report(_estimate("N", 1.02, 0.0005)), _report(_estimate("N", 1.1, 0.0005))
    assert compare(a, b).significant
    assert not compare(a, b, tolerance=0.05).significant
    assert compare(a, c, tolerance=0.05).significant


def test_terms_and_axes_of_only_one_report_are_listed() -> None:
    """They are not tested."""
    a = replace(consumer_report(), axes=(axis_report(GYRO, "x", "N=1e-4 + B=1e-5 + K=1e-6"),))
    b = replace(
        consumer_report(),
        axes=(axis_report(GYRO, "x", "Q=1e-6 + N=1e-4 + B=1e-5 + K=1e-6"), consumer_report().axes[3]),
    )
    outcome = {(d.axis, d.key): d.outcome for d in compare(a, b).differences}
    assert outcome["gyro_x", "Q"] == "only-b"
    assert outcome["gyro_x", "N"] == "same"
    assert outcome["accel_x", "N"] == "only-b"
    assert compare(b, a).differences[0].outcome == "only-a"


def test_different_settings_of_reports_are_noted() -> None:
    """Another method or rate may cause a difference."""
    a = small_report()
    b = replace(a, axes=(axis_report(GYRO, "x", "N=1e-3", bounds={"B": 1e-4, "K": 1e-4}, rate_hz=100.0),))
    assert compare(a, b).notes == (
        "A was sampled at 200 Hz, B sampled at 100 Hz; this may cause differences",
    )
    assert compare(a, a).notes == ()


def test_reports_without_a_common_axis_are_rejected() -> None:
    """The error lists the axes of both."""
    a = small_report()
    b = replace(consumer_report(), axes=consumer_report().axes[3:])
    with pytest.raises(DataError) as error:
        compare(a, b)
    assert str(error.value) == (
        "logs/still_night.mcap and logs/still_night.mcap have no axis in common: the first has gyro_x, "
        "the second accel_x, accel_y, accel_z; compare logs of the same sensor"
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"alpha": 0.0}, "alpha must be between 0 and 1, got 0.0"),
        ({"tolerance": -1.0}, "tolerance must be 0 or more, got -1.0"),
    ],
)
def test_invalid_options_are_rejected(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        compare(consumer_report(), consumer_report(), **options)
