"""A report against a data sheet: ratios, findings, and the unit that the steps reveal."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import imucal
from imucal.arrays import FloatArray
from imucal.errors import DataError, Fix
from imucal.findings import Finding
from imucal.noise.model import NoiseModel
from imucal.pipeline import Settings, characterize
from imucal.recording import AXES, AxisSeries, Recording, Sensor, Source
from imucal.report import Report
from imucal.report.figure import axis_figure
from imucal.report.given import part_as_report
from imucal.sensors import find_sensor
from imucal.sheet_comparison import compared_with_sheet, sheet_ratios
from imucal.units import G0
from tests.report.synthetic import axis_report, consumer_report

#: N of the BMI088 in rad/s/sqrt(Hz).
SHEET = 0.00024435
#: Steps of the MPU-6050 at 250 deg/s and 2 g, in SI.
#: Step of the MPU-6050 in its range of 250 deg/s, in rad/s.
GYRO_STEP = np.radians(1 / 131)
#: Step of the MPU-6050 in its range of 2 g, in m/s^2.
ACCEL_STEP = G0 / 16384


def _recording(gyro: FloatArray, accel: FloatArray, values: dict[str, str] | None = None) -> Recording:
    """Return a recording of samples in SI, shape (n, 3), at 200 Hz."""
    series = [
        AxisSeries.from_samples(samples[:, column], rate_hz=200.0, sensor=sensor, axis=axis)
        for sensor, samples in ((Sensor.GYROSCOPE, gyro), (Sensor.ACCELEROMETER, accel))
        for column, axis in enumerate(AXES)
    ]
    return Recording(series=tuple(series), source=Source(path="log.csv", format="csv", values=values or {}))


def _samples() -> tuple[FloatArray, FloatArray]:
    """Return noise of an MPU-6050 in its steps."""
    rng = np.random.default_rng(1)
    gyro = rng.normal(0, 0.0027, (4000, 3))
    accel = rng.normal(0, 0.05, (4000, 3)) + np.array([0, 0, G0])
    return np.round(gyro / GYRO_STEP) * GYRO_STEP, np.round(accel / ACCEL_STEP) * ACCEL_STEP


def _with_white(factor: float, part_report: Report) -> Report:
    """Return a report whose gyro_x has a multiple of the N of the BMI088."""
    first, *others = part_report.axes
    model = f"N={factor * SHEET} + B=2.4e-5 + K=1.1e-6"
    louder = axis_report(first.sensor, "x", model, relative_error=0.2)
    return replace(part_report, axes=(louder, *others))


def _codes(findings: Sequence[Finding]) -> list[tuple[str | None, str]]:
    wanted = {"unit-of-sensor", "above-data-sheet"}
    return [(finding.axis, finding.code) for finding in findings if finding.code in wanted]


@pytest.mark.parametrize(("factor", "found"), [(1.0, False), (2.9, False), (3.05, False), (3.9, True)])
def test_only_a_certain_excess_is_reported(factor: float, found: bool) -> None:  # noqa: FBT001 - a case
    """The lower limit of N, some percent below it, must be above 3 times the typical value."""
    report = compared_with_sheet(
        _with_white(factor, consumer_report()), _recording(*_samples()), find_sensor("BMI088")
    )
    assert _codes(report.all_findings) == ([("gyro_x", "above-data-sheet")] if found else [])
    assert report.settings["sensor"] == "BMI088"


def test_a_maximum_allows_twice_its_value() -> None:
    """HG1700 prints a maximum of 0.125 deg/√h, 3.6e-5 rad/s/√Hz."""
    for white, found in ((7.0e-5, []), (7.6e-5, [("gyro_x", "above-data-sheet")])):
        axis = axis_report(Sensor.GYROSCOPE, "x", f"N={white} + B=2.4e-5 + K=1.1e-6")
        report = replace(consumer_report(), axes=(axis,))
        checked = compared_with_sheet(report, _recording(*_samples()), find_sensor("HG1700"))
        assert _codes(checked.all_findings) == found


def test_the_ratio_of_each_term() -> None:
    """Over all axes; a term that the sheet lacks has none."""
    report = consumer_report()
    (gyro, accel) = sheet_ratios(report, find_sensor("BMI088"))
    values = [axis["N"].value or 0.0 for axis in report.axes if axis.sensor is Sensor.GYROSCOPE]
    assert (gyro.low, gyro.high) == pytest.approx((min(values) / SHEET, max(values) / SHEET))
    assert "the data sheet's typical value (BMI088, 0.014 deg/s/√Hz)" in gyro.text()
    assert "190 ug/sqrt(Hz)" in accel.text(plain=True)
    symbols = [ratio.term.symbol for ratio in sheet_ratios(report, find_sensor("ADIS16448"))]
    assert symbols == ["N", "B", "N", "B"]


def test_a_term_that_is_only_bounded() -> None:
    axis = axis_report(Sensor.GYROSCOPE, "x", "N=1.9e-4", bounds={"B": 1.06e-4, "K": 1e-6})
    report = replace(consumer_report(), axes=(axis,))
    (_, flicker) = sheet_ratios(report, find_sensor("ADIS16448"))
    assert flicker.text().startswith("gyro B was not detected: at most 1.00 times the data sheet's typical")


def test_both_figures_of_the_mpu_6050_are_named() -> None:
    gyro, _ = sheet_ratios(consumer_report(), find_sensor("MPU-6050"))
    assert "0.011 deg/s/√Hz; its noise density is 0.005 deg/s/√Hz" in gyro.text()


@pytest.mark.parametrize(
    ("gyro_factor", "accel_factor", "axis", "unit"),
    [
        (np.degrees(1), 1.0, "gyro", "deg/s"),
        (1e3 * np.degrees(1), 1.0, "gyro", "mdeg/s"),
        (np.radians(1), 1.0, "gyro", "rad/s"),
        (1.0, 1 / G0, "accel", "g"),
        (1.0, 1e3 / G0, "accel", "mg"),
        (1.0, G0, "accel", "m/s^2"),
    ],
)
def test_steps_in_another_unit_are_named(
    gyro_factor: float, accel_factor: float, axis: str, unit: str
) -> None:
    """With the unit to give; N of this sensor is not reported in addition."""
    gyro, accel = _samples()
    recording = _recording(gyro * gyro_factor, accel * accel_factor)
    report = _with_white(9.0, consumer_report()) if axis == "gyro" else consumer_report()
    checked = compared_with_sheet(report, recording, find_sensor("MPU-6050"))
    assert _codes(checked.all_findings) == [(axis, "unit-of-sensor")]
    (finding,) = [each for each in checked.findings if each.code == "unit-of-sensor"]
    assert finding.fix == Fix("", f"{axis}_unit", unit)


def test_right_steps_and_no_steps_give_no_finding() -> None:
    """The true unit, another range, a rounded text, floats, and a unit that the log states."""
    gyro, accel = _samples()
    part = find_sensor("MPU-6050")
    rng = np.random.default_rng(2)
    logs = [
        _recording(gyro, accel),
        _recording(4 * gyro, accel),
        _recording(np.round(gyro, 4), np.round(accel, 3)),
        _recording(rng.normal(0, 0.0027, (4000, 3)), rng.normal(0, 0.05, (4000, 3))),
        # As if deg/s were rad/s, but the log was read as mdeg/s.
        _recording(np.degrees(gyro), accel, {"gyroscope unit": "mdeg/s"}),
    ]
    for log in logs:
        assert _codes(compared_with_sheet(consumer_report(), log, part).all_findings) == []


def test_decimal_steps_are_no_evidence() -> None:
    """The BNO055 has 1 mg per count, and texts in m/s² are often rounded to 0.001."""
    rng = np.random.default_rng(3)
    accel = np.round(rng.normal(0, 0.05, (4000, 3)) + np.array([0, 0, G0]), 3)
    log = _recording(rng.normal(0, 0.0027, (4000, 3)), accel)
    assert _codes(compared_with_sheet(consumer_report(), log, find_sensor("BNO055")).all_findings) == []


def test_the_picture_has_a_line_of_the_data_sheet() -> None:
    """Grey, with a label, for each of N and B that the sheet prints."""
    report = consumer_report()
    axis = report.axes[0]
    marked = replace(report, settings={**report.settings, "sensor": "ADIS16448"})
    labels = [str(line.get_label()) for line in axis_figure(marked, axis).axes[0].get_lines()]
    assert "N of the data sheet, ADIS16448" in labels
    assert "B of the data sheet, ADIS16448" in labels
    plain = [str(line.get_label()) for line in axis_figure(report, axis).axes[0].get_lines()]
    assert not [label for label in plain if "data sheet" in label]
    unknown = replace(report, settings={**report.settings, "sensor": "no such part"})
    assert axis_figure(unknown, axis).axes


def test_a_data_sheet_as_a_report() -> None:
    """For `imucal.compare` and `imucal.export`; its numbers are those of the sheet."""
    sheet = part_as_report(find_sensor("ADIS16448"), rate_hz=200.0)
    assert [axis.name for axis in sheet.axes][:3] == ["gyro_x", "gyro_y", "gyro_z"]
    white = sheet["gyro_x"]["N"]
    assert (white.value, white.origin) == (0.00019199, "from the data sheet, not measured")
    compared = imucal.compare(consumer_report(), sheet)
    assert {difference.key for difference in compared.differences if difference.p is not None} >= {"N", "B"}
    with pytest.raises(DataError, match="prints no N"):
        part_as_report(find_sensor("M-G365"), rate_hz=200.0)


def test_a_fit_of_simulated_noise_of_the_part() -> None:
    """N of the simulated sheet comes back with the ratio 1."""
    part = find_sensor("BMI088")
    recording = imucal.simulate(
        NoiseModel.parse(f"N={SHEET}"), NoiseModel.parse("N=0.0018633", Sensor.ACCELEROMETER), rate_hz=100.0
    )
    report = characterize(recording, Settings(model="N", method="slope"))
    for ratio in sheet_ratios(report, part, forced=True):
        assert (ratio.low + ratio.high) / 2 == pytest.approx(1, abs=0.05)
