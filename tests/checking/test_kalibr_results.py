"""Kalibr's residuals have an expectation, and each number of imu.yaml a factor: against known truth."""

import contextlib
import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest

from imucal.checking.kalibr_results import are_results, check_numbers, check_residuals
from imucal.checking.residuals import Expected, verdict_of
from imucal.checking.verdict import Row
from imucal.errors import LimitsError
from imucal.recording import Sensor
from imucal.report.given import model_as_report
from tests.checking.kalibr_output import GIVEN, RATE_HZ, results
from tests.cli.run import run

#: The truth is the noise that the simulated calibration was given.
TRUTH = model_as_report(
    {Sensor.GYROSCOPE: "N=1e-4 + K=1e-6", Sensor.ACCELEROMETER: "N=1e-3 + K=1e-5"}, rate_hz=RATE_HZ
)
MODELS = ["--gyro", "N=1e-4 + K=1e-6", "--accel", "N=1e-3 + K=1e-5", "--rate", "200"]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "results-imucam.txt"


def rows(file: Path, text: str) -> dict[str, Row]:
    file.write_text(text, encoding="utf-8")
    return {row.where: row for row in check_residuals(file).rows}


@pytest.mark.parametrize(
    ("dimension", "mean", "median", "std"), [(3, 1.596, 1.538, 0.673), (2, 1.253, 1.177, 0.655)]
)
def test_expectations_are_those_of_the_chi_distribution(
    dimension: int, mean: float, median: float, std: float
) -> None:
    """Published values of the Maxwell and the Rayleigh distribution."""
    expected = Expected.of(dimension)
    assert (expected.mean, expected.median, expected.std) == pytest.approx((mean, median, std), abs=5e-4)


def test_right_noise_passes(file: Path) -> None:
    found = rows(file, results())
    assert list(found) == ["cam0 corners", "imu0 gyro", "imu0 accel"]
    assert {row.verdict for row in found.values()} == {"pass"}


@pytest.mark.parametrize(
    ("factor", "verdict", "words"),
    [
        (1 / 13, "undecided", "too large"),
        (1 / 50, "fail", "too large"),
        (5.0, "fail", "too small"),
    ],
)
def test_the_factor_of_wrong_noise(file: Path, factor: float, verdict: str, words: str) -> None:
    """The factor is found to 2 % from 20 000 residuals."""
    row = rows(file, results(gyro=[factor]))["imu0 gyro"]
    assert row.verdict == verdict
    match = re.search(r"the noise is ([\d.]+) times (too \w+)", row.found)
    assert match is not None
    assert match[2] == words
    assert float(match[1]) == pytest.approx(max(factor, 1 / factor), rel=0.02)


def test_a_few_outliers_do_not_change_the_factor(file: Path) -> None:
    row = rows(file, results(outliers=500))["imu0 gyro"]
    assert row.verdict == "undecided"
    assert "right within a factor of 2" in row.found
    assert "outliers" in row.found


@pytest.mark.parametrize("factor", [1e-6, 1e-10, 0.0])
def test_no_data_is_not_a_good_result(file: Path, factor: float) -> None:
    found = rows(file, results(gyro=[factor], accel=[1.0]))
    assert found["imu0 gyro"].verdict == "fail"
    assert "not a good result" in found["imu0 gyro"].found
    assert found["imu0 accel"].verdict == "pass"


@pytest.mark.parametrize("number", ["nan", "inf", "-1", "?"])
def test_a_mean_that_is_no_number_is_not_a_good_result(file: Path, number: str) -> None:
    text = re.sub(
        r"(Gyroscope error .imu0.: +mean )\S+, median [^,]+",
        rf"\g<1>{number}, median {number}",
        results(),
        count=1,
    )
    assert rows(file, text)["imu0 gyro"].verdict == "fail"


def test_a_camera_without_corners_fails(file: Path) -> None:
    assert rows(file, results(camera=None))["cam0 corners"].verdict == "fail"


@pytest.mark.parametrize(("factor", "verdict"), [(0.1, "pass"), (1.0, "pass"), (4.0, "fail")])
def test_corners_may_be_better_than_assumed(file: Path, factor: float, verdict: str) -> None:
    assert rows(file, results(camera=factor))["cam0 corners"].verdict == verdict


@pytest.mark.parametrize("key", GIVEN)
@pytest.mark.parametrize(("factor", "verdict"), [(1.05, "pass"), (1 / 40, "fail"), (200.0**0.5, "fail")])
def test_each_number_of_imu_yaml_has_its_factor(file: Path, key: str, factor: float, verdict: str) -> None:
    """The number is named, with the line to write; √f is recognised as a likely mistake."""
    file.write_text(results(given=[{**GIVEN, key: GIVEN[key] * factor}]), encoding="utf-8")
    found = {row.subject: row for row in check_numbers(file, TRUTH)}
    wrong = {subject for subject, row in found.items() if row.verdict != "pass"}
    assert wrong == ({key} if verdict != "pass" else set())
    if verdict != "pass":
        assert found[key].verdict == verdict
        written, _, value = found[key].instead.partition(": ")
        assert written == key
        assert float(value) == pytest.approx(GIVEN[key], rel=0.1)
    if factor > 2:
        assert "sqrt" in found[key].found or "√" in found[key].found


def test_the_noise_that_kalibr_saw_is_compared_with_the_noise_at_rest(file: Path) -> None:
    file.write_text(results(gyro=[4.0], accel=[1.0]), encoding="utf-8")
    seen = {row.where: row for row in check_numbers(file, TRUTH) if row.subject == "noise in Kalibr"}
    assert {where: row.measured and row.measured.value for where, row in seen.items()} == pytest.approx(
        {"imu0 gyro": 4e-4, "imu0 accel": 1e-3}, rel=0.02
    )
    assert "vibration" in seen["imu0 gyro"].found
    assert "vibration" not in seen["imu0 accel"].found


def test_the_residuals_after_the_optimization_count(file: Path) -> None:
    """What Kalibr prints on the terminal has two tables."""
    found = rows(file, results(gyro=[400.0], accel=[400.0]) + results())
    assert {row.verdict for row in found.values()} == {"pass"}


def test_another_rate_than_the_log_is_doubtful(file: Path) -> None:
    file.write_text(results().replace("Update rate: 200.0", "Update rate: 100.0"), encoding="utf-8")
    found = {row.subject: row for row in check_numbers(file, TRUTH)}
    assert found["update_rate"].verdict == "undecided"


def test_several_imus_need_a_choice(file: Path) -> None:
    wrong = {**GIVEN, "gyroscope_noise_density": 1e-6}
    file.write_text(results(gyro=[1, 1], accel=[1, 1], given=[GIVEN, wrong]), encoding="utf-8")
    with pytest.raises(LimitsError, match=r"2 IMUs.*--imu 0 or 1"):
        check_numbers(file, TRUTH)
    verdicts = {imu: {row.verdict for row in check_numbers(file, TRUTH, imu)} for imu in (0, 1)}
    assert verdicts == {0: {"pass"}, 1: {"pass", "fail"}}
    with pytest.raises(LimitsError, match="no IMU7; found IMU0, IMU1"):
        check_numbers(file, TRUTH, 7)


@pytest.mark.parametrize("cut", range(0, 2000, 97))
def test_a_cut_file_is_an_error_or_has_fewer_rows(file: Path, cut: int) -> None:
    file.write_text(results()[:cut], encoding="utf-8")
    if not are_results(file):
        return
    with contextlib.suppress(LimitsError):
        assert 1 <= len(check_residuals(file).rows) <= 3
    with contextlib.suppress(LimitsError):
        assert {row.subject for row in check_numbers(file, TRUTH)} <= {
            *GIVEN,
            "update_rate",
            "noise in Kalibr",
        }


def test_another_file_is_not_taken_for_results(tmp_path: Path) -> None:
    (tmp_path / "other.txt").write_text("Residuals\n", encoding="utf-8")
    assert not are_results(tmp_path / "other.txt")
    assert not are_results(tmp_path)
    assert not are_results(tmp_path / "missing")


def test_the_command_has_the_returncodes_of_check(file: Path) -> None:
    file.write_text(results(), encoding="utf-8")
    good = run("check", file.name, cwd=file.parent)
    assert good.returncode == 0
    assert "imucal check REPORT --config" in good.stderr
    file.write_text(results(accel=[5.0]), encoding="utf-8")
    bad = run("check", file.name, "--json", cwd=file.parent)
    assert bad.returncode == 1
    document = json.loads(bad.stdout)
    assert document["counts"] == {"pass": 2, "fail": 1, "undecided": 0}
    assert document["rows"][2]["value"] == pytest.approx(5 * 1.596, rel=0.02)


def test_the_command_compares_each_number_with_the_report(file: Path) -> None:
    file.write_text(results(given=[{**GIVEN, "gyroscope_noise_density": 1e-6}]), encoding="utf-8")
    found = run("check", *MODELS, "--config", file.name, cwd=file.parent)
    assert found.returncode == 1
    line = re.search(r"gyroscope_noise_density: (\S+)", found.stdout)
    assert line is not None
    assert float(line[1]) == pytest.approx(1e-4, rel=0.01)
    assert run("check", file.name, "--config", file.name, cwd=file.parent).returncode == 2
    assert run("check", *MODELS, "--config", file.name, "--imu", "3", cwd=file.parent).returncode == 2
    assert run("check", *MODELS, "--imu", "0", "--limits", file.name, cwd=file.parent).returncode == 2


def test_verdicts_change_at_their_limits() -> None:
    steps = np.geomspace(1e-3, 1e2, 400)
    words = [verdict_of(float(step))[0] for step in steps]
    changes = [(a, b) for a, b in itertools.pairwise(words) if a != b]
    assert changes == [("fail", "undecided"), ("undecided", "pass"), ("pass", "fail")]
