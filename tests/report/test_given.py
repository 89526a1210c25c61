"""Models in the form of a report: what takes the report of a log takes them."""

import math
from pathlib import Path

import pytest

import imucal
from imucal.recording import Sensor
from imucal.report.exports import TARGETS, ExportOptions, export, render
from imucal.report.given import model_as_report
from imucal.units import G0
from tests.report.downstream import READERS

GYRO, ACCEL = Sensor
SHEET = {GYRO: "N=0.3deg/sqrt(h) + B=5deg/h + K=1deg/h/sqrt(h)", ACCEL: "N=60ug/sqrt(Hz) + B=0.04mg + K=1e-6"}
WANTED = {
    ("gyro", "N"): math.radians(0.3) / 60,
    ("gyro", "K"): math.radians(1) / 3600 / 60,
    ("accel", "N"): 60e-6 * G0,
    ("accel", "K"): 1e-6,
}


@pytest.mark.parametrize("target", [name for name in READERS if name not in ("kalibr", "openvins", "dlio")])
def test_a_consumer_reads_the_numbers_of_the_sheet(target: str, tmp_path: Path) -> None:
    """As fitted, its own parser gets N and K of the data sheet, in SI."""
    (path,) = export(
        model_as_report(SHEET, rate_hz=200.0), target, tmp_path, ExportOptions(numbers="as-fitted")
    )
    read = READERS[target](path)
    for (name, symbol), value in read.items():
        if symbol in "NK":
            assert value == pytest.approx(WANTED[name.split("_")[0], symbol], rel=1e-7)
    assert read


@pytest.mark.parametrize("target", [name for name, each in TARGETS.items() if each.covers])
def test_a_filter_gets_a_pair_though_the_sheet_has_no_walk(target: str) -> None:
    """White noise and flicker are all that most data sheets have."""
    text = render(imucal.model_as_report({GYRO: "N=0.3deg/sqrt(h) + B=5deg/h"}, rate_hz=200.0), target)
    assert "N=0.3deg/sqrt(h) + B=5deg/h (gyroscope) (a model as given, no log" in text
    assert "f = 200 Hz (given by the user), nothing recorded" in text
    assert "not detected" not in text
    assert "K <" not in text


def test_the_pair_of_a_sheet_is_that_of_its_model() -> None:
    """N K >= B²/2 where there is no walk: flicker is touched at one frequency."""
    report = model_as_report({GYRO: "N=1e-4 + B=2e-5"}, rate_hz=200.0)
    pair = imucal.filter_numbers([axis.fit for axis in report.axes])
    assert pair.white**2 > 1e-8
    assert (pair.white**2 - 1e-8) * pair.walk**2 == pytest.approx((2e-5**2 / 2) ** 2, rel=0.02)


def test_what_a_model_lacks_is_zero_and_known() -> None:
    """Axes share one fit; there is nothing recorded, and no interval."""
    report = model_as_report({ACCEL: "N=1e-3 + GM(sigma=1e-4, T=50s)"}, rate_hz=100.0)
    assert [axis.name for axis in report.axes] == ["accel_x", "accel_y", "accel_z"]
    fit = report.axes[0].fit
    assert str(fit.model) == "N + GM"
    assert (fit["K"].value, fit["K"].high) == (None, 0.0)
    assert (fit["N"].low, fit["N"].value, fit["N"].high) == (1e-3, 1e-3, 1e-3)
    assert fit["GM"].correlation_time is not None
    assert fit["GM"].correlation_time.value == 50
    assert {axis.samples for axis in report.axes} == {0}
    assert "±" not in report.verdict.sentence


def test_a_plan_has_a_sheets_sensor_once() -> None:
    """Three axes of one model would need the same three times; a log of it has no length."""
    plan = imucal.plan(model_as_report(SHEET, rate_hz=200.0))
    assert [axis.axis for axis in plan.axes] == ["gyro", "accel"]
    assert {axis.duration_s for axis in plan.axes} == {None}
    alone = imucal.plan(imucal.NoiseModel.parse(SHEET[GYRO]), rate_hz=200.0)
    assert plan.axes[0].needs == alone.axes[0].needs


def test_a_sheet_that_is_silent_of_a_term_is_not_compared() -> None:
    """No K in a data sheet does not say that there is none."""
    sheet, own = (model_as_report({GYRO: text}, rate_hz=200.0) for text in ("N=1e-4", "N=1e-4 + K=1e-6"))
    result = imucal.compare(own, sheet)
    assert {(row.key, row.outcome) for row in result.differences} == {("N", "same"), ("K", "only-a")}
    assert result.notes == ()
