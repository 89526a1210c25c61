"""Tests of the drift of dead reckoning: closed forms, sums, the worst axis, bounds and coverage."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import imucal
from imucal.errors import DataError
from imucal.noise.model import NoiseModel
from imucal.prediction import Drift, DriftPoint
from imucal.recording import Sensor
from imucal.report.result import Report
from imucal.units import G0
from tests.benchmarks.drift import limits
from tests.report.synthetic import axis_report, consumer_report, shortest_report, small_report

T = np.array([1.0, 10.0, 60.0, 300.0])
GYRO, ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER


def points(found: Drift, name: str) -> tuple[DriftPoint, ...]:
    """Return the points of a quantity."""
    return next(one.points for one in found.quantities if one.name == name)


def values(found: Drift, name: str, what: str = "value") -> list[Any]:
    """Return one attribute of a quantity's points."""
    return [getattr(point, what) for point in points(found, name)]


def white(sensor: Sensor, integrals: int, rest_s: float) -> np.ndarray:
    """Return the deviation of unit white noise in closed form: √(∫w² + (∫w)²/W) of w = sⁿ⁻¹/(n-1)!."""
    n, factor = integrals, math.factorial(integrals - 1)
    square = T ** (2 * n - 1) / (2 * n - 1) / factor**2 + (T**n / n / factor) ** 2 / rest_s
    return np.sqrt(square) * (G0 if sensor is GYRO and n > 1 else 1.0)


@pytest.mark.parametrize(
    ("sensor", "name", "integrals"),
    [
        (GYRO, "angle", 1),
        (GYRO, "velocity through tilt", 2),
        (GYRO, "position through tilt", 3),
        (ACCEL, "velocity from the accelerometer", 1),
        (ACCEL, "position from the accelerometer", 2),
    ],
)
@pytest.mark.parametrize("rest_s", [60.0, 6000.0])
def test_the_drift_of_white_noise_has_a_closed_form(
    sensor: Sensor, name: str, integrals: int, rest_s: float
) -> None:
    """After a long rest an angle grows as √t, a velocity through tilt as √(t³/3), a position as √(t⁵/20)."""
    fit = axis_report(sensor, "x", "N=2e-3").fit
    found = imucal.drift(fit, T.tolist(), rest_s=rest_s)
    np.testing.assert_allclose(values(found, name), 2e-3 * white(sensor, integrals, rest_s), rtol=2e-3)
    assert {(point.term, point.share) for point in points(found, name)} == {("N", 1.0)}


def test_the_drift_scales_with_the_noise() -> None:
    """Three times the coefficients give three times the values and limits, with equal shares."""
    one, three = (
        imucal.drift(axis_report(ACCEL, "x", f"N={k}e-3 + B={2 * k}e-4", bounds={"K": k * 1e-6}).fit)
        for k in (1, 3)
    )
    for name in ("velocity from the accelerometer", "position from the accelerometer"):
        for what in ("value", "low", "high"):
            np.testing.assert_allclose(values(three, name, what), 3 * np.array(values(one, name, what)))
        np.testing.assert_allclose(values(three, name, "share"), values(one, name, "share"))


def test_two_parts_add_in_quadrature() -> None:
    """Values are exact; distances to the limits add in quadrature too."""
    found = imucal.drift(consumer_report())
    for kind in ("velocity", "position"):
        parts = [f"{kind} from the accelerometer", f"{kind} through tilt"]
        square = {
            what: np.square([values(found, name, what) for name in [*parts, f"{kind}, both"]])
            for what in ("low", "value", "high")
        }
        np.testing.assert_allclose(square["value"][2], square["value"][:2].sum(axis=0))
        for end in ("low", "high"):
            ways = np.abs(square[end] - square["value"])
            np.testing.assert_allclose(ways[2], np.hypot(*ways[:2]))
    both = points(found, "position, both")
    assert [point.axis for point in both][-1] == "accel_z gyro_x"
    assert [point.term for point in both][-1] == "gyro_x B"


def test_gravity_determines_tilt_but_not_heading() -> None:
    """One axis of the accelerometer must be along g, with g in total; otherwise there is only an angle."""
    report = consumer_report()
    assert imucal.drift(report).vertical == "z"
    assert {point.axis for point in points(imucal.drift(report), "heading")} == {"gyro_z"}
    assert "gyro_z" not in {point.axis for point in points(imucal.drift(report), "position through tilt")}

    def with_means(*means: float) -> Report:
        gyros = tuple(axis for axis in report.axes if axis.sensor is GYRO)
        accels = (axis for axis in report.axes if axis.sensor is ACCEL)
        found = (replace(axis, mean=mean) for axis, mean in zip(accels, means, strict=False))
        return replace(report, axes=(*gyros, *found))

    assert imucal.drift(with_means(-9.8, 0.3, 0.3)).vertical == "x"
    for means in ((5.7, 5.7, 5.7), (0.0, 0.0, 12.0), (0.0, 0.0, 0.0), (0.0, 9.8)):
        found = imucal.drift(with_means(*means))
        assert found.vertical == ""
        assert {one.name for one in found.quantities}.isdisjoint({"heading", "tilt"})


def test_the_worst_axis_may_change_with_time() -> None:
    """At each time it is the axis with the largest value; `each_axis` returns all axes."""
    axes = axis_report(GYRO, "x", "N=2e-3"), axis_report(GYRO, "y", "N=1e-3 + K=1e-4")
    report = replace(small_report(), axes=axes)
    assert values(imucal.drift(report), "angle", "axis") == ["gyro_x", "gyro_x", "gyro_y", "gyro_y"]
    each = [one for one in imucal.drift(report, each_axis=True).quantities if one.name == "angle"]
    assert [{point.axis for point in one.points} for one in each] == [{"gyro_x"}, {"gyro_y"}]


@pytest.mark.parametrize("symbol", ["K", "R"])
def test_a_bound_only_affects_the_upper_limit(symbol: str) -> None:
    """The value and the lower limit depend only on the estimated terms."""
    observed = axis_report(GYRO, "x", "N=1e-3").fit
    found, unbounded = (
        imucal.drift(axis_report(GYRO, "x", "N=1e-3", bounds=bounds).fit) for bounds in ({symbol: 1e-3}, {})
    )
    for what in ("value", "low"):
        assert values(found, "angle", what) == values(unbounded, "angle", what)
    assert np.all(np.array(values(found, "angle", "high")) > values(unbounded, "angle", "high"))
    unseen = (replace(observed["N"], status="bounded", value=None, low=0.0),)
    only = imucal.drift(replace(observed, model=NoiseModel(terms=()), estimates=unseen))
    assert {(p.value, p.low, p.term, p.share) for p in points(only, "angle")} == {(None, 0.0, "", 0.0)}
    assert np.all(np.array(values(only, "angle", "high")) > 0)


def test_a_bounded_term_of_the_model_may_dominate() -> None:
    """A model with K drifts by K, even if its interval includes zero and a table prints a bound."""
    fit = axis_report(GYRO, "x", "N=1e-3 + K=1e-3").fit
    bounded = replace(fit["K"], status="bounded", value=None, low=0.0)
    doubtful = replace(fit, estimates=(fit["N"], bounded))
    assert values(imucal.drift(doubtful), "angle", "term") == values(imucal.drift(fit), "angle", "term")
    assert values(imucal.drift(doubtful), "angle", "term")[-1] == "K"


def test_an_unknown_drift_has_an_infinite_limit() -> None:
    """Four samples bound no term."""
    found = imucal.drift(shortest_report(4))
    for one in found.quantities:
        assert {(point.value, point.low, point.high) for point in one.points} == {(None, 0.0, math.inf)}


def test_a_time_is_observed_if_the_record_is_five_times_as_long() -> None:
    """The rest counts; a model without a record has neither observed nor extrapolated times."""
    fit = axis_report(GYRO, "x", "N=1e-3", rate_hz=10.0, n=10 * 5 * (60 + 40)).fit
    observed = imucal.drift(fit, [1.0, 40.0, 41.0]).quantities[0].points
    assert [point.seen for point in observed] == [True, True, False]
    given = replace(fit, curve=replace(fit.curve, edf=np.full(fit.curve.tau.size, np.nan)))
    assert {point.seen for point in imucal.drift(given).quantities[0].points} == {None}


@pytest.mark.parametrize(
    ("times", "rest_s"), [([0.0], 60.0), ([1e-3], 60.0), ([1.0], 0.0), ([math.inf], 60.0)]
)
def test_invalid_times_are_rejected(times: list[float], rest_s: float) -> None:
    """They are shorter than a sample or infinite."""
    message = r"rest \S+ s and time \S+ s; expected at least a sample \(0.005 s\) each, and at most"
    with pytest.raises(ValueError, match=message):
        imucal.drift(small_report(), times, rest_s=rest_s)


def test_a_fit_of_an_unknown_sensor_is_rejected() -> None:
    """It may be a gyroscope or an accelerometer."""
    with pytest.raises(DataError, match="no axis of a known sensor"):
        imucal.drift(replace(small_report().axes[0].fit, sensor=None))


@pytest.mark.slow
def test_limits_have_the_nominal_coverage() -> None:
    """In 40 records the tolerance is three standard errors about 95 %, with the default fit."""
    text = "N=1e-3 + K=2e-5"
    model = axis_report(GYRO, "x", text, rate_hz=10.0).fit
    truth = {one.name: values(imucal.drift(model), one.name) for one in imucal.drift(model).quantities}
    found = [limits(text, 1200.0, (4301, record)) for record in range(40)]
    for name, true in truth.items():
        covered = np.mean([(low[name] <= true) & (true <= high[name]) for low, high in found], axis=0)
        assert np.all(covered >= 0.95 - 3 * math.sqrt(0.95 * 0.05 / 40)), (name, covered)
