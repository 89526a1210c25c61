"""Tests of the comparison of two calibrations."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import imucal
from imucal.calibration.comparison import compare_calibrations
from imucal.calibration.document import CalibrationDocument, from_document, to_document
from imucal.errors import DataError
from imucal.noise import NoiseModel
from tests.calibration.simulated import Truth, attitudes, log
from tests.cli.run import run
from tests.raising import raises

#: Noise of the accelerometer and of the gyroscope.
NOISE = (NoiseModel.parse("N=1e-3"), NoiseModel.parse("N=1e-4"))


def calibrated(truth: Truth, seed: int) -> CalibrationDocument:
    """Return the calibration of another session of a unit."""
    rng = np.random.default_rng(seed)
    session = log(truth, NOISE, attitudes(14, rng), rng)
    return from_document(to_document(imucal.calibrate(session.recording(), gravity=9.80665)))


def test_two_sessions_of_a_unit_agree_and_two_units_differ() -> None:
    """Scales and misalignments of two units differ."""
    rng = np.random.default_rng(8411)
    one, other = Truth.draw(rng), Truth.draw(rng)
    first, second, third = (
        calibrated(truth, seed) for truth, seed in ((one, 8412), (one, 8413), (other, 8414))
    )
    same = compare_calibrations(first, second)
    assert {each.outcome for each in same} <= {"same", "untested"}
    assert sum(each.outcome == "same" for each in same) >= 20
    differing = [each for each in compare_calibrations(first, third) if each.outcome == "differs"]
    assert len(differing) >= 12
    assert {each.sensor.short for each in differing} == {"accel", "gyro"}


def test_other_frames_and_units_are_refused() -> None:
    first = calibrated(Truth.draw(np.random.default_rng(8415)), 8416)
    with raises(DataError, "has the frame kalibr, .* the frame imu-tk"):
        compare_calibrations(first, replace(first, frame="imu-tk"))
    bias = first.accelerometer.parameters["bias_x"]
    counts = replace(
        first.accelerometer,
        parameters={**first.accelerometer.parameters, "bias_x": replace(bias, unit="raw")},
    )
    with raises(DataError, "is in m/s.2 in one and raw in the other"):
        compare_calibrations(first, replace(first, accelerometer=counts))


def test_the_command_prints_and_exits(tmp_path: Path) -> None:
    """0 without a difference; the schema tells programs which comparison it is."""
    poses = Path(__file__).parents[2] / "sample_logs" / "poses.mcap"
    assert run("calibrate", str(poses), "-o", "cal", "--no-html", "-q", cwd=tmp_path).returncode == 0
    done = run("compare", "cal", "cal/calibration.json", cwd=tmp_path)
    assert done.returncode == 0
    assert "accel scale x" in done.stdout
    assert done.stdout.endswith("no significant difference (alpha 0.05)\n")
    assert '"imucal/calibration-comparison/1"' in run("compare", "cal", "cal", "--json", cwd=tmp_path).stdout
    assert all(len(line) <= 80 for line in done.stdout.splitlines())


@pytest.mark.parametrize("alpha", [0.01, 0.2])
def test_a_smaller_alpha_finds_fewer_differences(alpha: float) -> None:
    rng = np.random.default_rng(8417)
    truth = Truth.draw(rng)
    first = calibrated(truth, 8418)
    moved = replace(
        first.accelerometer.parameters["scale_x"],
        value=(first.accelerometer.parameters["scale_x"].value or 0.0)
        + 2.5 * (first.accelerometer.parameters["scale_x"].half_width or 0.0),
    )
    other = replace(
        first,
        accelerometer=replace(
            first.accelerometer, parameters={**first.accelerometer.parameters, "scale_x": moved}
        ),
    )
    found = compare_calibrations(first, other, alpha=alpha)
    scale = next(one for one in found if (one.sensor.short, one.parameter) == ("accel", "scale_x"))
    assert (scale.outcome == "differs") == ((scale.p or 0.0) < alpha)
    assert 0.01 < (scale.p or 0.0) < 0.2
