"""Configs of filters are read back: correct ones pass, and each likely mistake is reported with a fix."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import get_args

import pytest

from imucal.checking import check_config
from imucal.checking.verdict import Row
from imucal.errors import LimitsError
from imucal.recording import Axis, Sensor
from imucal.report.exports import TARGETS, ExportOptions, render
from imucal.report.exports.config_numbers import read_options
from imucal.report.given import model_as_report
from imucal.report.result import Report
from imucal.units import G0
from tests.report.synthetic import axis_report
from tests.report.synthetic import consumer_report as make_consumer_report

GYRO, ACCEL = BOTH = tuple(Sensor)
RATE_HZ, ROOT = 200.0, math.sqrt(200.0)
#: Formats with one number per key, which the command reads back.
READ = [target.name for target in TARGETS.values() if target.keys and target.read_back]
DEGREE = math.pi / 180
#: White noise and walk alone, each in the middle of the band, are their own cover. The factors below are
#: therefore those of the file.
N, K = {GYRO: 1e-4, ACCEL: 1e-3}, {GYRO: 1e-6, ACCEL: 1e-5}
PAIR = model_as_report(
    {s: f"N={N[s]} + K={K[s]} + B={0.3 * math.sqrt(N[s] * K[s])}" for s in Sensor}, rate_hz=RATE_HZ
)
consumer_report = cache(make_consumer_report)


def read_back(folder: Path, text: str, report: Report = PAIR) -> dict[str, Row]:
    """Return the rows of a config by their key."""
    file = folder / "imu.cfg"
    file.write_text(text, encoding="utf-8")
    return {row.subject: row for row in check_config(file, report)}


def kalibr(gyro_n: float, gyro_k: float, accel_n: float = 1e-3, accel_k: float = 1e-5) -> str:
    """Return an imu.yaml in its usual form."""
    return (
        f"accelerometer_noise_density: {accel_n!r}   #Noise density\n"
        f"accelerometer_random_walk: {accel_k!r}\n"
        f"gyroscope_noise_density: {gyro_n!r}\n"
        f"gyroscope_random_walk: {gyro_k!r}\n"
        "rostopic: /imu0\nupdate_rate: 200\n"
    )


@pytest.mark.parametrize("name", READ)
def test_exported_files_pass(name: str, tmp_path: Path) -> None:
    """Every format passes with any options in its comment, and every key is read."""
    asked = render(
        consumer_report(),
        name,
        ExportOptions(inflate={"white": 3.0, "walk": 14.0}, horizon_s=1000.0, step_s=0.1, axis_policy="rms"),
    )
    for report, text in ((PAIR, render(PAIR, name)), (consumer_report(), asked)):
        rows = read_back(tmp_path, text, report)
        assert {row.verdict for row in rows.values()} == {"pass"}
        assert not any(row.instead for row in rows.values())
        wanted = sum(3 if key.each_axis else 1 for key in TARGETS[name].keys)
        assert len([row for row in rows.values() if row.where != "log"]) == wanted


#: Change of a number in a Kalibr file -> reported mistake, and the sensors to which it applies.
SLIPS: dict[str, tuple[Callable[[float], float], str, tuple[Sensor, ...]]] = {
    "per sample": (lambda c: c * ROOT, r"large: by sqrt\(f\) at 200 Hz: .\*sqrt\(f\), the dev", BOTH),
    "step": (lambda c: c / ROOT, r"small: by sqrt\(f\) at 200 Hz: ./sqrt\(f\), the step", BOTH),
    "f": (lambda c: c * RATE_HZ, "large: by f = 200 Hz: one factor of the rate too many", BOTH),
    "1/f": (lambda c: c / RATE_HZ, "small: by f = 200 Hz: one factor of the rate is missing", BOTH),
    "degrees": (lambda c: c / DEGREE, r"57.3 times too large: by 57.3: it is in deg/s/sqrt", (GYRO,)),
    "radians twice": (lambda c: c * DEGREE, "57.3 times too small: by 57.3: it was converted from", (GYRO,)),
    "deg/h": (lambda c: c / DEGREE * 3600, r"it is in deg/h/sqrt\(..?\)", (GYRO,)),
    "g": (lambda c: c / G0, r"9.81 times too small: by 9.81: it is in g/sqrt\(..?\), not in m/s", (ACCEL,)),
    "g twice": (lambda c: c * G0, "9.81 times too large: by 9.81: it was converted from g", (ACCEL,)),
    "mg": (lambda c: c / G0 * 1e3, r"102 times too large: it is in mg/sqrt\(..?\)", (ACCEL,)),
    "square": (lambda c: c * c, r".\^2, the square of the continuous density", BOTH),
    "variance": (lambda c: c * c * RATE_HZ, r".\^2\*f, the variance of one sample", BOTH),
    "zero": (lambda _: 0.0, "expected a positive number", BOTH),
    "negative": (lambda c: -c, "expected a positive number", BOTH),
    "tiny": (lambda _: 6.5e-15, "times too small, absurd: no sensor is this good", BOTH),
    "third": (lambda c: c / 3, "3 times too small: below the values that are enough", BOTH),
}


@pytest.mark.parametrize("symbol", "NK")
@pytest.mark.parametrize(
    ("slip", "sensor"), [(slip, s) for slip, (_, _, sensors) in SLIPS.items() for s in sensors]
)
def test_each_mistake_is_reported_with_a_fix(slip: str, sensor: Sensor, symbol: str, tmp_path: Path) -> None:
    """The row of the changed key reports it; the file passes with the proposed lines."""
    make, mistake, _ = SLIPS[slip]
    right = read_back(tmp_path, render(PAIR, "kalibr"))
    numbers = {key: row.measured.value for key, row in right.items() if row.measured is not None}
    key = f"{sensor}_{'noise_density' if symbol == 'N' else 'random_walk'}"
    wrong = make(numbers[key] or math.nan)
    text = "".join(f"{name}: {wrong if name == key else value!r}\n" for name, value in numbers.items())
    rows = read_back(tmp_path, text)
    # Users sometimes inflate numbers ten times on purpose.
    assert rows[key].verdict == ("undecided" if slip == "g twice" else "fail")
    assert re.search(mistake, rows[key].text), rows[key].text
    assert rows[key].text.startswith(f"{sensor.short}: imu.cfg:{list(numbers).index(key) + 1}: {key} is ")
    mended = "".join(f"{rows[name].instead or f'{name}: {value!r}'}\n" for name, value in numbers.items())
    assert {row.verdict for row in read_back(tmp_path, mended).values()} == {"pass"}


@pytest.mark.parametrize("name", READ)
def test_a_wrong_factor_of_the_rate_is_reported_in_every_format(name: str, tmp_path: Path) -> None:
    """The factor is the square root of the rate, in both directions and in the formula of each format."""
    for by, mistake in ((ROOT, "large: by sqrt(f)"), (1 / ROOT, "small: by sqrt(f)")):
        numbers = {
            key.name.format(i=1, axis="y"): key.formula.of(
                by * (N if key.symbol == "N" else K)[key.sensor], RATE_HZ
            )
            for key in TARGETS[name].keys
        }
        rows = read_back(tmp_path, "".join(f"{key}: {number!r}\n" for key, number in numbers.items()))
        assert rows.keys() == numbers.keys()
        for row in rows.values():
            assert row.verdict == "fail"
            assert mistake in row.text or "the continuous density" in row.text, row.text


def test_autoware_needs_n_of_the_fit_alone(tmp_path: Path) -> None:
    """It has no walk, so flicker does not raise the limit; its default of 0.03 rad/s is cautious."""
    report = model_as_report({GYRO: "N=1e-4 + B=2e-4 + K=1e-6", ACCEL: "N=1e-3 + K=1e-5"}, rate_hz=RATE_HZ)
    right = 1e-4 * ROOT
    text = (
        f"angular_velocity_stddev_xx: {right}\n"
        f"angular_velocity_stddev_yy: {right / 2}\n"
        "angular_velocity_stddev_zz: 0.03\n"
        "acceleration_stddev: 1e-3\n"
    )
    rows = read_back(tmp_path, text, report)
    assert rows["angular_velocity_stddev_xx"].verdict == "pass"
    below = rows["angular_velocity_stddev_yy"]
    assert below.verdict == "fail"
    assert below.limit == pytest.approx(right)
    assert "2 times too small: below N of the fit" in below.text
    assert rows["angular_velocity_stddev_zz"].verdict == "pass"
    assert "21.2 times too large: too cautious" in rows["angular_velocity_stddev_zz"].text
    density = rows["acceleration_stddev"]
    assert density.verdict == "fail"
    assert "14.1 times too small" in density.text
    assert "the continuous density" in density.text


def test_the_number_of_another_term_is_reported(tmp_path: Path) -> None:
    """K is replaced by B (bias instability in data sheets) or by N ("random walk" elsewhere)."""
    report = model_as_report({GYRO: "N=1e-4 + B=5e-5 + K=1e-8"}, rate_hz=RATE_HZ)
    rows = read_back(tmp_path, "gyroscope_noise_density: 2e-4\ngyroscope_random_walk: 1e-4\n", report)
    assert (
        "N, the angle random walk, in place of K, the rate random walk" in rows["gyroscope_random_walk"].text
    )
    report = model_as_report({GYRO: "N=1e-4 + B=5e-6 + K=1e-8"}, rate_hz=RATE_HZ)
    rows = read_back(tmp_path, "gyroscope_noise_density: 2e-4\ngyroscope_random_walk: 5e-6\n", report)
    assert rows["gyroscope_random_walk"].verdict == "fail"
    assert (
        "B, the bias instability, in place of K, the rate random walk" in rows["gyroscope_random_walk"].text
    )


def test_fitted_n_and_k_are_too_small_if_there_is_flicker(tmp_path: Path) -> None:
    """N and K of the fit leave flicker out; other pairs can cover it."""
    report = model_as_report({GYRO: "N=1e-4 + B=2e-5 + K=1e-7"}, rate_hz=RATE_HZ)
    rows = read_back(tmp_path, render(report, "kalibr", ExportOptions(numbers="as-fitted")), report)
    walk = rows["gyroscope_random_walk"]
    assert walk.verdict == "fail"
    assert "K of the fit alone is below the values that are enough for the fitted spectrum" in walk.text
    # Flicker is covered if N K >= B²/2; with three times the white noise, a third of the walk is enough.
    shared = "gyroscope_noise_density: 3e-4\ngyroscope_random_walk: 8e-7\n"
    rows = read_back(tmp_path, shared, report)
    assert {row.verdict for row in rows.values()} == {"pass"}
    assert "the file's other number makes up for it" in rows["gyroscope_random_walk"].text
    assert rows["gyroscope_random_walk"].limit is None
    assert (
        read_back(tmp_path, shared.replace("8e-7", "4e-7"), report)["gyroscope_random_walk"].verdict == "fail"
    )


def test_numbers_that_are_too_large_pass_with_a_comment(tmp_path: Path) -> None:
    """The comment appears from a factor of ten on, and is not reported as a mistake."""
    rows = read_back(tmp_path, kalibr(7e-4, 7e-6, 3e-2, 3e-4))
    assert {row.verdict for row in rows.values()} == {"pass"}
    assert "times too large: too cautious for a sensor at rest" in rows["accelerometer_noise_density"].text
    assert rows["accelerometer_noise_density"].instead
    assert not rows["gyroscope_noise_density"].instead


def test_a_term_with_only_a_bound_is_undecided(tmp_path: Path) -> None:
    """A walk below the bound may be right, because the record is too short to detect it."""
    bounds = {"K": 1e-5, "B": 1e-5}
    axes = tuple(axis_report(GYRO, axis, "N=1e-4", bounds=bounds) for axis in get_args(Axis))
    report = replace(consumer_report(), axes=axes, findings=())
    text = "gyroscope_noise_density: 1.1e-4\ngyroscope_random_walk: 3e-7\n"
    row = read_back(tmp_path, text, report)["gyroscope_random_walk"]
    assert row.verdict == "undecided"
    assert "unless a term is below its upper bound; record for longer" in row.text
    assert (
        read_back(tmp_path, text.replace("3e-7", "3e-13"), report)["gyroscope_random_walk"].verdict == "fail"
    )


#: Numbers of one sensor in each kind of file, among other keys.
SPELLINGS = {
    "OpenCV": """%YAML:1.0
---
IMU.NoiseGyro: 1.7e-3 # rad/s
IMU.GyroWalk: 1.0e-05
Camera.fx: 458.654
T: !!opencv-matrix
   rows: 1
   data: [0, 1,
     2]
""",
    "ROS 2": """/**:
  ros__parameters:
    mapping:
      gyr_cov: 0.1
      b_gyr_cov: 0.0001
""",
    "rosparam": "mapping/gyr_cov: 0.1\nmapping/b_gyr_cov: 0.0001\n",
    "GTSAM, a matrix": """gyroscopeCovariance: [1e-4, 0, 0, 0, 1e-4, 0,
   0, 0, 1e-4]
biasOmegaCovariance: [1e-8, 1e-8, 1e-8]
""",
    "GTSAM, OpenCV's matrix": """gyroscopeCovariance: !!opencv-matrix
  rows: 2
  data: [1e-4, 0, 0, 1e-4]
biasOmegaCovariance: 1e-8
""",
    "QGroundControl": """# Onboard parameters
1\t1\tEKF2_GYR_NOISE\t0.015\t9
1\t1\tEKF2_GYR_B_NOISE\t0.001\t9
1\t1\tEKF2_AID_MASK\t1\t6
""",
    "PX4 shell": "param set EKF2_GYR_NOISE 0.015\nparam set-default EKF2_GYR_B_NOISE 0.001\n",
    "ArduPilot": "EK3_GYRO_P_NSE 0.015\nEK3_GBIAS_P_NSE\t0.001\nGND_ALT_OFFSET 0\n",
    "Mission Planner": "EK3_GYRO_P_NSE,0.015\nEK3_GBIAS_P_NSE,0.001\n",
    "Python": "gyroscopeCovariance = 1e-4  # of mine\nbiasOmegaCovariance = 1e-8\n",
}


@pytest.mark.parametrize("kind", SPELLINGS)
def test_files_are_read_in_the_syntax_of_their_programs(kind: str, tmp_path: Path) -> None:
    """Large numbers pass. For numbers that are far too small, the proposed lines pass when read back."""
    text = SPELLINGS[kind]
    rows = read_back(tmp_path, text)
    assert {row.where for row in rows.values()} == {"gyro"}
    assert len(rows) == 2
    for row in rows.values():
        assert row.measured is not None
        assert row.measured.value is not None
        assert row.measured.value > (row.limit or math.inf)
    small = re.sub(
        r"(?<![\w.])(1e-4|1e-8|1\.7e-3|1\.0e-05|0\.1|0\.0001|0\.015|0\.001)(?![\w.])", "1e-30", text
    )
    wrong = read_back(tmp_path, small)
    assert {row.verdict for row in wrong.values()} == {"fail"}
    for row in wrong.values():
        (right,) = {value for value in re.findall(r"\d\.\d+(?:e-\d+)?", row.instead) if float(value)}
        assert float(right) == pytest.approx(row.limit, rel=1e-7)
    mended = "\n".join(row.instead for row in wrong.values())
    assert {row.verdict for row in read_back(tmp_path, mended).values()} == {"pass"}


def test_another_rate_is_undecided(tmp_path: Path) -> None:
    """Only the user knows the rate of the IMU in operation."""
    rows = read_back(
        tmp_path, render(PAIR, "orbslam3").replace("IMU.Frequency: 200.0", "IMU.Frequency: 400.0")
    )
    row = rows["IMU.Frequency"]
    assert row.verdict == "undecided"
    assert row.instead == "IMU.Frequency: 200.0"


def test_a_sensor_missing_in_the_report_is_undecided(tmp_path: Path) -> None:
    """The other sensor's numbers are judged."""
    report = model_as_report({GYRO: "N=1e-4 + K=1e-6"}, rate_hz=RATE_HZ)
    rows = read_back(tmp_path, kalibr(2e-4, 2e-6), report)
    assert rows["gyroscope_noise_density"].verdict == "pass"
    assert rows["accelerometer_noise_density"].verdict == "undecided"
    assert "the report has no accelerometer" in rows["accelerometer_noise_density"].text


def test_a_text_instead_of_a_number_fails(tmp_path: Path) -> None:
    """The row contains the line to write."""
    row = read_back(tmp_path, "gyroscope_noise_density: high\ngyroscope_random_walk:\n")[
        "gyroscope_noise_density"
    ]
    assert row.verdict == "fail"
    assert "is high; expected a positive number" in row.text
    assert row.instead.startswith("gyroscope_noise_density: 0.0001")


def test_other_files_are_refused(tmp_path: Path) -> None:
    """Cases: a missing file, a binary file, and a file without keys of a filter.

    The error contains the path, the content and the expected form.
    """
    with pytest.raises(LimitsError, match=r"no\.yaml: .*No such file"):
        check_config(tmp_path / "no.yaml", PAIR)
    (tmp_path / "b.yaml").write_bytes(b"\xff\xfe")
    with pytest.raises(LimitsError, match=r"b\.yaml: .*not UTF-8"):
        check_config(tmp_path / "b.yaml", PAIR)
    (tmp_path / "c.yaml").write_text("camera: 1\n", encoding="utf-8")
    with pytest.raises(LimitsError, match=r"c\.yaml: found no noise parameter"):
        check_config(tmp_path / "c.yaml", PAIR)


def test_one_mistake_of_all_numbers_is_preferred(tmp_path: Path) -> None:
    """Continuous densities in a VINS file: K in a unit of g gives nearly the same for one of them alone."""
    n, k = 1 / math.sqrt(2 * RATE_HZ), 1 / ROOT
    parts = (0.83 * n, 0.95 * n, k / 1.46, k / 1.81)
    rows = read_back(tmp_path, vins(*parts))
    assert {row.verdict for row in rows.values() if row.where != "log"} == {"fail"}
    for name in ("acc_n", "gyr_n", "acc_w", "gyr_w"):
        symbol = name[-1].replace("n", "N").replace("w", "K")
        assert f"{symbol}, the continuous density; write" in rows[name].text


def test_two_continuous_numbers_make_a_file_continuous(tmp_path: Path) -> None:
    """A file has one convention: the walk of the gyroscope alone would have no explanation."""
    n, k = 1 / math.sqrt(2 * RATE_HZ), 1 / ROOT
    rows = read_back(tmp_path, vins(n, n, 0.3 * k, 0.2 * k))
    for name in ("acc_n", "gyr_n", "acc_w", "gyr_w"):
        assert "the continuous density" in rows[name].text
    assert "as in the file's other numbers, and 4.28 times too small as such" in rows["gyr_w"].text
    assert "as in the file" not in rows["gyr_n"].text


def test_swapped_sensors_are_one_mistake(tmp_path: Path) -> None:
    """The accelerometer's numbers in the lines of the gyroscope, and the other way round."""
    rows = read_back(tmp_path, kalibr(N[ACCEL], K[ACCEL], N[GYRO], K[GYRO]))
    for name, symbol, sensors in (
        ("accelerometer_noise_density", "N", (GYRO, ACCEL)),
        ("accelerometer_random_walk", "K", (GYRO, ACCEL)),
        ("gyroscope_noise_density", "N", (ACCEL, GYRO)),
        ("gyroscope_random_walk", "K", (ACCEL, GYRO)),
    ):
        other, own = sensors
        assert rows[name].verdict == "fail"
        assert f"{symbol} of the {other}, in place of {symbol} of the {own}" in rows[name].text


def test_swapped_n_and_k_are_one_mistake(tmp_path: Path) -> None:
    """A data sheet's "random walk" is N."""
    rows = read_back(tmp_path, kalibr(K[GYRO], N[GYRO], K[ACCEL], N[ACCEL]))
    assert {row.verdict for row in rows.values() if row.where != "log"} == {"fail"}
    assert all("in place of" in row.text for row in rows.values() if row.where != "log")


def test_mistakes_that_fit_equally_are_all_reported(tmp_path: Path) -> None:
    """At 100 Hz, sqrt(f) is nearly 9.81."""
    report = model_as_report({s: f"N={N[s]} + K={K[s]}" for s in Sensor}, rate_hz=100.0)
    right = read_back(tmp_path, render(report, "kalibr"), report)["accelerometer_noise_density"].limit
    assert right is not None
    text = kalibr(1.1e-4, 1.1e-6, accel_n=9.9 * right, accel_k=1.1e-5)
    row = read_back(tmp_path, text, report)["accelerometer_noise_density"]
    assert row.verdict == "fail"
    assert "N*sqrt(f), the deviation of one sample" in row.text
    assert "by 9.81: it was converted from g into SI twice" in row.text


def vins(acc_n: float, gyr_n: float, acc_w: float, gyr_w: float) -> str:
    """Return a config of VINS whose numbers are the given parts of the right ones."""
    parts = {"acc_n": acc_n, "acc_w": acc_w, "gyr_n": gyr_n, "gyr_w": gyr_w}
    lines = render(PAIR, "vins").splitlines()
    for i, line in enumerate(lines):
        name, _, value = line.partition(":")
        if name in parts:
            lines[i] = f"{name}: {parts[name] * float(value.split()[0])!r}"
    return "\n".join(lines) + "\n"


def test_a_mistake_of_one_number_needs_no_other(tmp_path: Path) -> None:
    """The other numbers are right, so each row has its own explanation."""
    rows = read_back(tmp_path, kalibr(N[GYRO] / DEGREE, 1e-6))
    assert "times too large: by 57.3: it is in deg/s/sqrt" in rows["gyroscope_noise_density"].text
    assert {row.verdict for name, row in rows.items() if name != "gyroscope_noise_density"} == {"pass"}


def test_degrees_of_both_numbers_are_one_mistake(tmp_path: Path) -> None:
    """The other sensor is right: the mistake is shared by the numbers of the gyroscope."""
    rows = read_back(tmp_path, kalibr(0.9 * N[GYRO] / DEGREE, 0.8 * K[GYRO] / DEGREE))
    for name in ("gyroscope_noise_density", "gyroscope_random_walk"):
        assert "it is in deg/" in rows[name].text


@pytest.mark.parametrize("target", TARGETS)
def test_the_options_of_a_file_are_read_back_from_its_comment(target: str) -> None:
    """The line of JSON is in the comment of every format."""
    options = ExportOptions(
        axis_policy="rms", inflate={"white": 1.1, "flicker": 2.0}, step_s=0.2, horizon_s=700.5
    )
    assert read_options(render(consumer_report(), target, options)) == options
    assert read_options("gyroscope_noise_density: 1.0") == ExportOptions()


@pytest.mark.parametrize("line", ['{"axis": "worst"}', '{"axis": "w', '{"axis": 1, "inflate": 2}'])
def test_a_changed_line_of_options_is_an_error(line: str, tmp_path: Path) -> None:
    """The error has the file, and a way to fix it."""
    path = tmp_path / "imu.yaml"
    path.write_text(f"# imucal: {line}\ngyroscope_noise_density: 1.0\n", encoding="utf-8")
    with pytest.raises(LimitsError, match="options in a comment is not valid; remove the line") as caught:
        check_config(path, PAIR)
    assert caught.value.place == str(path)
