"""`imucal sensor`: list, figures, JSON and exit codes."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from tests.cli.reports import write_report
from tests.cli.run import SAMPLE_LOGS, run


def test_the_list_fits_80_columns(tmp_path: Path) -> None:
    """At 40 columns the numbers remain."""
    done = run("sensor", "--list", cwd=tmp_path)
    lines = done.stdout.splitlines()
    assert (done.returncode, len(lines)) == (0, 70)
    assert max(map(len, lines)) <= 80
    assert "BMI088               0.014       190  Bosch Sensortec       manufacturer" in lines
    narrow = run("sensor", "--list", cwd=tmp_path, COLUMNS="40").stdout.splitlines()
    assert max(map(len, narrow)) <= 40
    assert narrow[2].startswith("BMI088               0.014       190")


def test_the_figures_of_a_part(tmp_path: Path) -> None:
    """In units of data sheets and SI, with the source."""
    done = run("sensor", "adis 16448", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "N = 0.66 deg/√h = 0.000192 rad/s/√Hz (typical, from the angle random walk)" in done.stdout
    assert "B = 21.84 deg/h = 0.0001059 rad/s (typical, from the bias instability / 0.664)" in done.stdout
    assert "1.23 times (gyroscope)" in done.stdout
    assert "Data Sheet, Rev. E" in done.stdout
    for columns in ("80", "40"):
        lines = run("sensor", "adis 16448", cwd=tmp_path, COLUMNS=columns).stdout.splitlines()
        assert max(map(len, lines)) <= int(columns)


def test_json_is_in_si(tmp_path: Path) -> None:
    """One part, or all."""
    document = json.loads(run("sensor", "mpu6050", "--json", cwd=tmp_path).stdout)
    assert (document["schema"], document["name"]) == ("imucal/sensor/1", "MPU-6050")
    white = document["gyroscope"]["terms"]["N"]
    assert (white["value"], white["alternative"], white["unit"]) == (8.7266e-05, 0.000192, "rad/s/sqrt(Hz)")
    every = json.loads(run("sensor", "--list", "--json", cwd=tmp_path).stdout)
    assert document in [{"schema": every["schema"], **part} for part in every["parts"]]


def test_exit_codes(tmp_path: Path) -> None:
    """2 for usage, 3 for an unknown part."""
    nothing = run("sensor", cwd=tmp_path)
    assert nothing.returncode == 2
    assert "imucal sensor --list" in nothing.stderr
    assert run("sensor", "BMI088", "--list", cwd=tmp_path).returncode == 2
    unknown = run("sensor", "BMI08", cwd=tmp_path)
    assert (unknown.returncode, unknown.stderr) == (3, "Error: no part 'BMI08'; did you mean BMI088?\n")


@pytest.mark.usefixtures("pictures_are_blank")
def test_fit_compares_with_the_part(tmp_path: Path) -> None:
    """A line per term after the table, and the name in the report; the export of the report works."""
    log = str(SAMPLE_LOGS / "consumer_mems.mcap")
    done = run("fit", log, "--take", "3min", "--model", "N", "--sensor", "bmi088", "-o", "r", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = " ".join(done.stdout.split("upper bound")[1].split())
    assert lines.startswith("gyro N is 0.6")
    assert "times the data sheet's typical value (BMI088, 0.014 deg/s/√Hz) accel N is 1.0" in lines
    assert json.loads((tmp_path / "r" / "report.json").read_text())["settings"]["sensor"] == "BMI088"
    compared = run("compare", "r", "--sensor", "BMI088", "--tolerance", "0.7", cwd=tmp_path)
    assert compared.returncode == 0, compared.stdout
    assert "B: BMI088" in compared.stderr
    strict = run("compare", "r", "--sensor", "BMI088", cwd=tmp_path)
    assert strict.returncode == 1
    assert "gyro_x  N     deg/sqrt(h)" in strict.stdout
    unknown = run("fit", log, "--sensor", "BMI08", cwd=tmp_path)
    assert (unknown.returncode, "did you mean BMI088?" in unknown.stderr) == (3, True)


def test_fit_names_a_wrong_unit(tmp_path: Path) -> None:
    """A log in deg/s whose header states rad/s."""
    rng = np.random.default_rng(5)
    gyro = np.round(rng.normal(0, 0.15, (4000, 3)) * 131) / 131
    accel = np.round((rng.normal(0, 0.005, (4000, 3)) + np.array([0, 0, 1])) * 16384) / 16384 * 9.80665
    units = {"gyro": "rad/s", "accel": "m/s^2"}
    names = [f"{sensor}_{axis} [{unit}]" for sensor, unit in units.items() for axis in "xyz"]
    rows = np.c_[np.arange(4000) / 200, gyro, accel]
    np.savetxt(
        tmp_path / "log.csv", rows, delimiter=",", header=",".join(["t [s]", *names]), comments="", fmt="%.9g"
    )
    ask = ("fit", "log.csv", "--no-report", "--json", "-q", "--model", "N", "--sensor", "mpu6050")
    findings = json.loads(run(*ask, cwd=tmp_path).stdout)["findings"]
    (finding,) = [each for each in findings if each["code"] == "unit-of-sensor"]
    assert finding["axis"] == "gyro"
    assert "was read as rad/s" in finding["text"]
    assert "those of the MPU-6050 in deg/s" in finding["text"]


def test_export_of_a_data_sheet_covers_its_bias(tmp_path: Path) -> None:
    """Each number is marked, and the walk is not invented."""
    done = run("export", "--sensor", "ADIS16448", "--rate", "200", "--to", "kalibr", "-o", "-", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = [
        line for line in done.stdout.splitlines() if "_noise_density:" in line or "_random_walk:" in line
    ]
    assert len(lines) == 4
    assert all(line.endswith("from the data sheet, not measured") for line in lines)
    assert "ADIS16448 (from the data sheet, not measured: Analog Devices ADIS16448 Data Sheet" in done.stdout
    assert "not measured" in done.stderr
    model = "N=0.00019199 + B=0.0001059"
    given = run("export", "--gyro", model, "--rate", "200", "--to", "kalibr", "-o", "-", cwd=tmp_path)
    (walk,) = [line.split()[1] for line in given.stdout.splitlines() if "gyroscope_random_walk" in line]
    (own,) = [line.split()[1] for line in lines if "gyroscope_random_walk" in line]
    assert float(own) == pytest.approx(float(walk), rel=1e-3)


def test_export_without_a_bias_instability_is_refused(tmp_path: Path) -> None:
    """The message contains a command with typical values, which works."""
    done = run("export", "--sensor", "BMI088", "--rate", "200", "--to", "kalibr", "-o", "-", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (4, "")
    assert "a guess within a factor of 4" in done.stderr
    command = done.stderr.split(": imucal ")[1].replace("…", "kalibr -o -")
    typed = run(*shlex.split(command), cwd=tmp_path)
    assert typed.returncode == 0
    assert "gyroscope_random_walk: 2.6" in typed.stdout
    module = run("export", "--sensor", "HG1700", "--rate", "200", "--to", "kalibr", "-o", "-", cwd=tmp_path)
    assert module.returncode == 4
    assert "guess" not in module.stderr


def test_the_option_has_two_meanings(tmp_path: Path) -> None:
    """A usage error explains what to leave out."""
    write_report(tmp_path, "a")
    for command, words in (
        (("export", "a", "--sensor", "BMI088", "--to", "kalibr"), "omit REPORT"),
        (("export", "--sensor", "BMI088", "--to", "kalibr"), "--rate 200"),
        (("export", "--sensor", "BMI088", "--rate", "200", "--median", "--to", "kalibr"), "omit --median"),
        (("export", "--sensor", "BMI088", "--rate", "200", "--skip", "1s", "--to", "kalibr"), "skip"),
        (("compare", "a", "a", "--sensor", "BMI088"), "omit --sensor"),
        (("check", "a", "--limits", "x.toml", "--sensor", "BMI088"), ""),
        (("check", "--sensor", "BMI088"), "--fleet"),
    ):
        done = run(*command, cwd=tmp_path)
        assert done.returncode == 2, command
        assert words in done.stderr


def test_limits_name_a_part(tmp_path: Path) -> None:
    """As a multiple of the data sheet's figure."""
    write_report(tmp_path, "a")
    limits = """
        gyroscope.N = { sensor = "bmi 088", max = 1.5 }
        accelerometer.N = { sensor = "BMI088", max = 0.1 }
    """
    (tmp_path / "limits.toml").write_text(limits, encoding="utf-8")
    done = run("check", "a", "--limits", "limits.toml", cwd=tmp_path)
    assert done.returncode == 1
    rows = [line.split() for line in done.stdout.splitlines()]
    assert ["pass", "gyro_x", "N", "<=", "1.5", "x", "BMI088"] in [row[:7] for row in rows]
    assert ["fail", "accel_x", "N", "<=", "0.1", "x", "BMI088"] in [row[:7] for row in rows]
