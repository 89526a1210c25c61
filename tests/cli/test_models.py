"""A model in place of a report: the text of a data sheet wherever a report is taken."""

import json
import re
from pathlib import Path

import pytest
import yaml

from tests.cli.reports import write_report
from tests.cli.run import run
from tests.report.synthetic import consumer_report

GYRO, ACCEL = "N=0.3deg/sqrt(h) + B=5deg/h", "N=60ug/sqrt(Hz) + B=0.04mg"


def test_a_config_follows_from_a_data_sheet(tmp_path: Path) -> None:
    """Both sensors, however they are given; the file can be checked against the sheet."""
    typed = (GYRO, "--accel", ACCEL), ("--gyro", GYRO, "--accel", ACCEL)
    texts = []
    for how in typed:
        done = run("export", *how, "--rate", "200", "--to", "kalibr", "-o", "-", cwd=tmp_path)
        assert done.returncode == 0
        texts.append(done.stdout)
    assert texts[0] == texts[1]
    data = yaml.safe_load(texts[0])
    assert data["update_rate"] == 200
    assert 8.73e-5 < data["gyroscope_noise_density"] < 1.1e-4
    (tmp_path / "imu.yaml").write_text(texts[0], encoding="utf-8")
    checked = run("check", *typed[0], "--rate", "200", "--config", "imu.yaml", cwd=tmp_path)
    assert checked.returncode == 0, checked.stdout


def test_one_sensor_is_enough(tmp_path: Path) -> None:
    """Its half of the file, as of a log of one sensor."""
    done = run("export", "--accel", ACCEL, "--rate", "200", "--to", "px4", "-o", "-", cwd=tmp_path)
    assert done.returncode == 0
    assert "EKF2_ACC_NOISE 0.01" in done.stdout
    assert "EKF2_GYR_NOISE" not in done.stdout


def test_a_report_is_compared_with_its_data_sheet(tmp_path: Path) -> None:
    """By the report's own intervals; either may come first."""
    write_report(tmp_path, "still")
    (axis,) = (axis for axis in consumer_report().axes if axis.name == "gyro_x")
    own = f"N={axis.fit['N'].value}"
    for typed in (("still", own), (own, "still"), ("still", "--gyro", own)):
        done = run("compare", *typed, "--json", "-q", cwd=tmp_path)
        rows = {(row["axis"], row["term"]): row["outcome"] for row in json.loads(done.stdout)["differences"]}
        assert rows["gyro_x", "N"] == "same"
        assert rows["gyro_y", "N"] == "differs"
        assert done.returncode == 1
    worse = run("compare", "still", "N=3deg/sqrt(h)", "--accel", "N=3mg/sqrt(Hz)", cwd=tmp_path)
    assert worse.returncode == 1
    assert "6 of 6 terms differ" in worse.stdout


def test_a_plan_is_made_of_both_sensors(tmp_path: Path) -> None:
    """Each once, in units of data sheets."""
    done = run("plan", GYRO, "--accel", ACCEL, "--rate", "200", cwd=tmp_path)
    lines = done.stdout.splitlines()
    assert [line for line in lines if "at 200 Hz" in line] == ["gyro  at 200 Hz", "accel  at 200 Hz"]
    assert any(line.split()[:3] == ["N", "0.3", "deg/sqrt(h)"] for line in lines)


def test_a_log_is_simulated_of_a_data_sheet(tmp_path: Path) -> None:
    """A model in units of one sensor is not the other's."""
    arguments = ("--duration", "10s", "-o", "sheet.csv", "--json", "-q")
    done = run("simulate", GYRO, "--accel", "N=60ug/sqrt(Hz)", *arguments, cwd=tmp_path)
    assert json.loads(done.stdout)["accelerometer"]["model"].startswith("N=0.000588")
    alone = run("simulate", GYRO, *arguments, cwd=tmp_path)
    assert alone.returncode == 2
    assert "Invalid value for '--accel': '0.3deg/sqrt(h)'" in alone.stderr


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        (("export", "--to", "px4"), "Missing argument 'REPORT'"),
        (("export", GYRO, "--to", "px4"), "a model has no sampling rate; give one, such as"),
        (("export", GYRO, "--gyro", GYRO, "--to", "px4"), "is a gyroscope model, and --gyro is another"),
        (("export", GYRO, "log.mcap", "--to", "px4"), "is a model; give one model, one report, or"),
        (("export", GYRO, "--rate", "9", "--topic", "/a", "--to", "px4"), "is a model, and topic applies"),
        (("export", "N=5", "--accel", "N=3furlongs", "--to", "px4"), "value for '--accel': '3furlongs'"),
        (("export", "a=b.mcap", "--to", "px4"), "'a=b.mcap' is neither a file, a folder nor a gyroscope"),
        (("compare", GYRO), "Missing argument 'B'"),
        (("plan",), "Missing argument"),
    ],
)  # fmt: skip
def test_invalid_models_are_reported(typed: tuple[str, ...], said: str, tmp_path: Path) -> None:
    """Usage, exit code 2, in one sentence."""
    done = run(*typed, cwd=tmp_path)
    assert done.returncode == 2
    assert said in " ".join(done.stderr.split())


def test_a_file_whose_name_looks_like_a_model_is_a_file(tmp_path: Path) -> None:
    """An existing file takes precedence."""
    write_report(tmp_path, "N=1e-3")
    done = run("export", "N=1e-3", "--to", "px4", "-o", "-", "-q", cwd=tmp_path)
    assert done.returncode == 0
    assert "still_night.mcap" in done.stdout


@pytest.mark.parametrize("command", ["plan", "drift", "compare", "check", "export"])
def test_the_models_that_help_shows_are_understood(command: str, tmp_path: Path) -> None:
    """Each option's own example, typed with it."""
    text = " ".join(run(command, "--help", cwd=tmp_path).stdout.split())
    shown = dict(re.findall(r'--(gyro|accel) MODEL .*?such as "([^"]*)"', text))
    assert set(shown) == {"gyro", "accel"}
    for sensor, model in shown.items():
        done = run("plan", f"--{sensor}", model, "--rate", "200", "-q", cwd=tmp_path)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("numbers", [(), ("--as-fitted",)])
def test_a_model_without_slow_noise_gets_no_invented_walk(tmp_path: Path, numbers: tuple[str, ...]) -> None:
    """A data sheet often has N alone; a filter needs a walk, and imucal does not know one."""
    models = ("N=0.014deg/s/sqrt(Hz)", "--accel", "N=175ug/sqrt(Hz)", "--rate", "200")
    options = ("--to", "kalibr", "-o", "-", *numbers)
    refused = run("export", *models, *options, cwd=tmp_path)
    assert (refused.returncode, refused.stdout) == (4, "")
    assert "the model of the gyroscope has no slow noise" in refused.stderr
    added = (f"{models[0]} + B=10deg/h", "--accel", f"{models[2]} + B=40ug", "--rate", "200")
    if not numbers:
        assert "gyroscope_random_walk" in run("export", *added, *options, cwd=tmp_path).stdout
