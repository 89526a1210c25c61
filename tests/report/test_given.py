"""Models as reports: all users of a log's report accept them."""

import math
from pathlib import Path

import pytest

import imucal
from imucal.prediction import filter_numbers
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
def test_as_fitted_exports_contain_the_numbers_of_the_data_sheet(target: str, tmp_path: Path) -> None:
    """The target's parser gets N and K of the data sheet in SI."""
    (path,) = export(
        model_as_report(SHEET, rate_hz=200.0), target, tmp_path, ExportOptions(numbers="as-fitted")
    )
    read = READERS[target](path)
    for (name, symbol), value in read.items():
        if symbol in "NK":
            assert value == pytest.approx(WANTED[name.split("_")[0], symbol], rel=1e-7)
    assert read


@pytest.mark.parametrize("target", [name for name, each in TARGETS.items() if each.covers])
def test_a_data_sheet_without_a_walk_gives_white_noise_and_walk(target: str) -> None:
    """Most data sheets contain only white noise and flicker."""
    text = render(model_as_report({GYRO: "N=0.3deg/sqrt(h) + B=5deg/h"}, rate_hz=200.0), target)
    assert "N=0.3deg/sqrt(h) + B=5deg/h (gyroscope) (a model as given, no log" in text
    assert "f = 200 Hz (given by the user), nothing recorded" in text
    assert "not detected" not in text
    assert "K <" not in text


def test_the_pair_covers_the_flicker_of_the_data_sheet() -> None:
    """Without a walk, N K >= B²/2 covers flicker at the frequency where the two curves touch."""
    report = model_as_report({GYRO: "N=1e-4 + B=2e-5"}, rate_hz=200.0)
    pair = filter_numbers([axis.fit for axis in report.axes])
    assert pair.white**2 > 1e-8
    assert (pair.white**2 - 1e-8) * pair.walk**2 == pytest.approx((2e-5**2 / 2) ** 2, rel=0.02)


def test_terms_missing_in_a_model_are_zero() -> None:
    """The axes share one fit without intervals, and the report contains no recording."""
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


def test_a_plan_for_a_data_sheet_has_one_row_per_sensor() -> None:
    """Three axes with the same model need the same time. There is no duration of a log."""
    plan = imucal.plan(model_as_report(SHEET, rate_hz=200.0))
    assert [axis.axis for axis in plan.axes] == ["gyro", "accel"]
    assert {axis.duration_s for axis in plan.axes} == {None}
    alone = imucal.plan(imucal.NoiseModel.parse(SHEET[GYRO]), rate_hz=200.0)
    assert plan.axes[0].needs == alone.axes[0].needs


def test_a_term_missing_in_a_data_sheet_is_not_compared() -> None:
    """A data sheet without K does not mean that K is zero."""
    sheet, own = (model_as_report({GYRO: text}, rate_hz=200.0) for text in ("N=1e-4", "N=1e-4 + K=1e-6"))
    result = imucal.compare(own, sheet)
    assert {(row.key, row.outcome) for row in result.differences} == {("N", "same"), ("K", "only-a")}
    assert result.notes == ()
