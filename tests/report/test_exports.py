"""Exports are read back by parsers of the target programs, and their comments explain the numbers."""

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from imucal.errors import DataError, WriteError
from imucal.findings import Finding
from imucal.fitting.noise_fit import Estimate
from imucal.noise.model import NoiseModel
from imucal.noise.terms import TERMS, BiasInstability, GaussMarkov
from imucal.prediction import filter_numbers
from imucal.recording import Axis, Sensor, Source
from imucal.report.exports import TARGETS, export, find_target, render
from imucal.report.exports.config_numbers import AxisPolicy, ExportOptions, Numbers
from imucal.report.exports.target import comment, decimal, quoted, real
from imucal.report.given import model_as_report
from imucal.report.json_file import from_document, to_document
from imucal.report.result import AxisReport, Report
from imucal.report.typed_json import dumps
from tests.report.downstream import READERS, Recovered, opencv
from tests.report.synthetic import axis_report, small_report
from tests.report.synthetic import consumer_report as make_consumer_report

GYRO, ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER
_AXES: tuple[Axis, ...] = ("x", "y", "z")
#: Reports are immutable, so one of each kind is enough.
consumer_report = cache(make_consumer_report)
#: N and K of the fit, instead of the numbers that cover the spectrum.
fitted = partial(ExportOptions, numbers="as-fitted")


@cache
def _plain_report() -> Report:
    """Return six axes of N + B + K, all estimated, some small enough for numbers with an exponent."""
    scales: dict[Axis, float] = {"x": 1.0, "y": 2.0, "z": 3.0}
    axes = tuple(
        axis_report(sensor, axis, f"N={n * scale!r} + B=1e-5 + K={k * scale!r}")
        for sensor, n, k in ((GYRO, 1e-5, 1e-7), (ACCEL, 1e-3, 1e-5))
        for axis, scale in scales.items()
    )
    return replace(consumer_report(), axes=axes, findings=())


def _expected(report: Report, key: str, symbol: str) -> float:
    """Return the largest value of the sensor for ``gyro``, the axis's own for ``gyro_x``; bounds count."""
    found = [axis.fit[symbol] for axis in report.axes if axis.name.startswith(key)]
    return max(estimate.high if estimate.value is None else estimate.value for estimate in found)


#: Symbols of formats that do not have N and K.
_SYMBOLS = {"ros": {"N"}, "autoware": {"N"}, "carla": {"N"}, "dlio": {"N~"}}


def _agree(report: Report, recovered: Recovered) -> None:
    """Compare recovered values with the report, up to rounding; those in comments have three digits."""
    for (key, symbol), value in recovered.items():
        if symbol != "T":
            rel = 1e-7 if symbol.isalpha() else 6e-3
            assert value == pytest.approx(_expected(report, key, symbol[0]), rel=rel), (key, symbol)


@pytest.mark.parametrize("make", [_plain_report, consumer_report])
@pytest.mark.parametrize("target", READERS)
def test_as_fitted_exports_contain_n_and_k_of_the_fit(
    target: str, make: Callable[[], Report], tmp_path: Path
) -> None:
    """The target's parser recovers them up to rounding."""
    report = make()
    (path,) = export(report, target, tmp_path, fitted())
    assert path == tmp_path / TARGETS[target].file_name
    recovered = READERS[target](path)
    _agree(report, recovered)
    assert {key.split("_")[0] for key, _ in recovered} == (
        {"gyro"} if target == "dlio" else {"gyro", "accel"}
    )
    assert {symbol for _, symbol in recovered} >= _SYMBOLS.get(target, {"N", "K"})


@pytest.mark.parametrize("target", TARGETS)
def test_every_file_explains_its_numbers(target: str) -> None:
    """A comment contains tool, version, log, rate, kind, formula, axes and inflation."""
    text = render(consumer_report(), target, ExportOptions(inflate={"white": 2, "walk": 10}))
    for part in (
        "imucal 0.1.0",
        "logs/still_night.mcap",
        "f = 200 Hz (measured)",
        "kind:",
        "formula:",
        "axes:",
        "white (N) x 2, walk (K) x 10; ALREADY in the numbers",
        "it warns of: tone, warm-up",
    ):
        assert part in text
    assert re.search(r"kind: .*(continuous|discrete)", text)


@pytest.mark.parametrize("target", READERS)
def test_inflation_multiplies_n_and_k(target: str, tmp_path: Path) -> None:
    """``white=2, walk=10`` doubles N and multiplies K by ten, in every format."""
    report = _plain_report()
    (path,) = export(report, target, tmp_path, fitted(inflate={"white": 2.0, "walk": 10.0}))
    for (key, symbol), value in READERS[target](path).items():
        factor = {"N": 2.0, "K": 10.0}.get(symbol)
        if factor:
            assert value == pytest.approx(factor * _expected(report, key, symbol), rel=1e-7)


@pytest.mark.parametrize(("policy", "scale"), [("worst", 3.0), ("rms", math.sqrt(14 / 3)), ("y", 2.0)])
def test_the_axis_policy_chooses_or_averages(policy: AxisPolicy, scale: float) -> None:
    """``rms`` averages variances: (1 + 4 + 9)/3; averaging deviations would give 2."""
    data = yaml.safe_load(render(_plain_report(), "kalibr", fitted(axis_policy=policy)))
    assert data["gyroscope_noise_density"] == pytest.approx(scale * 1e-5)
    assert data["accelerometer_random_walk"] == pytest.approx(scale * 1e-5)


def test_the_upper_bound_of_an_undetected_term_is_written() -> None:
    """A comment explains that the number is an upper bound."""
    text = render(consumer_report(), "kalibr", fitted(axis_policy="y"))
    assert yaml.safe_load(text)["gyroscope_random_walk"] == 4.1e-7
    assert "K of gyro_y, UPPER BOUND (95%): not detected" in text
    assert "not detected, so the 95% upper bound is written: K of accel_y, K of gyro_y" in text


def test_a_bound_is_compared_with_the_measured_curve() -> None:
    """The largest K under the curve is computed by hand: its line touches the curve at the closest point."""
    report = consumer_report()
    curve = report.axes[1].fit.curve
    exact = (2 * curve.m.astype(float) ** 2 + 1) / (6 * curve.m * 200.0)
    largest = np.sqrt(np.min(curve.avar / exact))
    number = Numbers(report=report, options=ExportOptions(), target="x").of(report.axes[1], "K")
    assert number.excess == pytest.approx(4.1e-7 / largest)
    assert f"{4.1e-7 / largest:.2g} x the line that touches the measured curve" in number.note
    assert Numbers(report=report, options=ExportOptions(), target="x").of(report.axes[0], "K").excess is None


def test_a_comment_contains_interval_and_alternatives() -> None:
    """The limits of the fit are inflated like the number; "B or GM" follows the value."""
    report = _plain_report()
    axis = report.axes[2]
    estimates = tuple(
        replace(e, alternatives=("GM",)) if e.symbol == "B" else replace(e, low=2.5e-5, high=3.5e-5)
        for e in axis.fit.estimates
    )
    axes = (*report.axes[:2], replace(axis, fit=replace(axis.fit, estimates=estimates)), *report.axes[3:])
    doubtful = replace(report, axes=axes)
    assert "N of gyro_z, 95% 5e-05 to 7e-05" in render(doubtful, "kalibr", fitted(inflate={"white": 2.0}))
    assert "B of gyro_z, 95% " in render(doubtful, "matlab", fitted())
    assert "B or GM: this record can't distinguish them" in render(doubtful, "matlab", fitted())
    assert "or: [GM]" in render(doubtful, "yaml", fitted())


def test_refuse_makes_an_undetected_term_an_error() -> None:
    """The error contains the axis, the term, its bound and the solutions."""
    with pytest.raises(DataError) as error:
        render(consumer_report(), "kalibr", ExportOptions(unidentified="refuse"))
    assert str(error.value) == (
        "logs/still_night.mcap: accel_y: K was not detected (upper bound 5e-06 m/s^2/sqrt(s)), but kalibr "
        "needs a value; accept the bound, choose an axis on which it is detected, or record for longer"
    )
    assert render(consumer_report(), "kalibr", ExportOptions(unidentified="refuse", axis_policy="x"))


@pytest.mark.parametrize("sensor", list(Sensor))
@pytest.mark.parametrize("target", READERS)
def test_a_log_of_one_sensor_gives_half_of_the_file(target: str, sensor: Sensor, tmp_path: Path) -> None:
    """The target's parser reads only that sensor's numbers; the comment names the missing sensor."""
    complete = _plain_report()
    report = replace(complete, axes=tuple(axis for axis in complete.axes if axis.sensor is sensor))
    (path,) = export(report, target, tmp_path, fitted())
    recovered = READERS[target](path)
    _agree(report, recovered)
    nothing = target == "dlio" and sensor is ACCEL
    assert {key.split("_")[0] for key, _ in recovered} == (set() if nothing else {sensor.short})
    missing = next(other for other in Sensor if other is not sensor)
    assert f"NO {missing} in this log: its numbers are left out" in path.read_text()


@pytest.mark.parametrize("target", [name for name, target in TARGETS.items() if target.per_axis])
def test_a_missing_axis_is_an_error(target: str) -> None:
    """A format with a number per axis needs all three axes; the error lists the existing ones."""
    if target in {"gm", "yaml"}:  # these accept any axes
        assert "gyroscope" in render(small_report(), target)
        return
    with pytest.raises(DataError, match=rf"no gyro_y, which {target} needs"):
        render(small_report(), target)


def test_a_number_of_zero_is_refused() -> None:
    """Kalibr raises on zero, so no file may contain it."""
    axis = axis_report(GYRO, "x", "N=0.0 + B=1e-5 + K=1e-7")
    report = replace(consumer_report(), axes=(axis, *consumer_report().axes[3:]))
    with pytest.raises(DataError, match=r"gyro_x: N is 0\.0, but kalibr needs a positive number"):
        render(report, "kalibr", fitted(axis_policy="x"))


def test_all_writes_every_format(tmp_path: Path) -> None:
    """``all`` creates the folder, which then contains only these files."""
    folder = tmp_path / "a" / "b"
    written = export(consumer_report(), "all", folder)
    assert sorted(folder.iterdir()) == sorted(written)
    assert [path.name for path in written] == [target.file_name for target in TARGETS.values()]


def test_a_refusal_writes_nothing(tmp_path: Path) -> None:
    """Every text is rendered before the first file is written."""
    with pytest.raises(DataError):
        export(consumer_report(), "all", tmp_path / "out", ExportOptions(unidentified="refuse"))
    assert list(tmp_path.iterdir()) == []


def test_a_file_changed_by_hand_is_not_overwritten(tmp_path: Path) -> None:
    """A file written by imucal is replaced."""
    for target in TARGETS.values():
        (path,) = export(consumer_report(), target.name, tmp_path)
        assert export(consumer_report(), target.name, path) == (path,)
        path.write_text("tuned by hand")
        with pytest.raises(WriteError, match="exists and was not written by imucal"):
            export(consumer_report(), target.name, tmp_path)
        assert path.read_text() == "tuned by hand"


def test_one_file_changed_by_hand_stops_the_export_of_all(tmp_path: Path) -> None:
    """The check precedes the first write."""
    last = list(TARGETS.values())[-1].file_name
    (tmp_path / last).write_text("tuned by hand")
    with pytest.raises(WriteError, match=f"{re.escape(last)}: exists"):
        export(consumer_report(), "all", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [last]


def test_a_file_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    """The error names the missing folder, and nothing is left behind."""
    with pytest.raises(WriteError, match=r"imu\.yaml: .*No such file"):
        export(consumer_report(), "kalibr", tmp_path / "missing" / "imu.yaml")
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match="can't be created: "):
        export(consumer_report(), "all", tmp_path / "file")


@pytest.mark.parametrize(
    ("asked", "name"),
    [
        ("SDF", "gazebo"),
        ("VINS-Fusion", "vins"),
        ("orb_slam3", "orbslam3"),
        ("FAST-LIO2", "fast-lio"),
        ("nav2", "ros"),
        ("robot_localization", "ros"),
        ("imu_corrector", "autoware"),
        ("FusionCore", "fusioncore"),
    ],
)
def test_common_names_of_formats_are_accepted(asked: str, name: str) -> None:
    """Case, hyphens and underscores are ignored, and well-known aliases work."""
    assert find_target(asked).name == name


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("kalbir", "kalibr"),
        ("kalib", "kalibr"),
        ("gazeboo", "gazebo"),
        ("basald", "basalt"),
        ("ardupliot", "ardupilot"),
        ("openvisn", "openvins"),
    ],
)
def test_the_intended_name_is_suggested_for_a_typing_error(typed: str, meant: str) -> None:
    """Typing errors: a missing, additional, wrong or swapped letter."""
    with pytest.raises(
        ValueError, match=rf"no downstream format '{typed}'; did you mean {meant}\? choose one of"
    ):
        find_target(typed)


@pytest.mark.parametrize(
    "other",
    ["lvi-sam", "dlo", "orbslam2", "okvis", "fast-livo", "rtabmap", "vio", "openvslam", "px5", "isaac"],
)
def test_no_name_is_suggested_for_an_unsupported_program(other: str) -> None:
    """The error lists the formats and known facts about the name."""
    with pytest.raises(ValueError, match=f"'{other}'") as error:
        find_target(other)
    assert "did you mean" not in str(error.value)


def test_an_ambiguous_name_is_explained() -> None:
    """Isaac is the name of two programs."""
    with pytest.raises(
        ValueError, match="'isaac'; Isaac ROS is isaac-ros, Isaac Sim is isaac-sim; choose one of"
    ):
        find_target("isaac")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"axis_policy": "best"}, "axis policy 'best' is not one of worst, rms, x, y, z"),
        ({"inflate": {"pink": 2}}, "inflation 'pink' is not one of white, walk, flicker"),
        ({"numbers": "both"}, "choice of numbers 'both' is not one of covered, as-fitted"),
        ({"horizon_s": 1.0}, "the horizon must be longer than the step, got 1 s and 1 s"),
        ({"step_s": 0.0}, "the horizon must be longer than the step"),
        ({"inflate": {"walk": 0}}, "inflation of walk must be a positive number, got 0"),
        (
            {"unidentified": "zero"},
            "choice for unidentified terms 'zero' is not one of bound, refuse",
        ),
    ],
)
def test_wrong_options_are_refused(options: dict[str, object], message: str) -> None:
    """The library checks the options of its callers."""
    with pytest.raises(ValueError, match=message):
        render(consumer_report(), "kalibr", ExportOptions(**options))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("value", "text"),
    [(200, "200.0"), (1e-5, "1.0e-05"), (1.25e-7, "1.25e-07"), (1e16, "1.0e+16"), (0.0, "0.0")],
)
def test_written_numbers_have_a_decimal_point(value: float, text: str) -> None:
    """YAML 1.1 reads 1e-05 as a string, and OpenCV reads 200 as an integer."""
    assert real(value) == text
    assert yaml.safe_load(text) == value
    assert isinstance(yaml.safe_load(text), float)
    assert float(decimal(value)) == value
    assert "e" not in decimal(value)


def test_only_finite_numbers_are_written() -> None:
    with pytest.raises(ValueError, match="only finite numbers can be written, got nan"):
        real(math.nan)


def test_a_comment_stays_on_its_line() -> None:
    """A line break in a log's name must not add a key to the file."""
    assert comment(["log: a\nb: 1", "ok"]) == "# log: a b: 1\n# ok"


@pytest.mark.parametrize("target", READERS)
def test_a_hostile_log_name_breaks_no_file(target: str, tmp_path: Path) -> None:
    """The path contains quotes, hyphens, braces and line breaks."""
    source = Source(path='a--b"\n:{%\\.bag', format="rosbag1", topics=('/i"mu',), message_types=("x",))
    report = replace(_plain_report(), source=source)
    (path,) = export(report, target, tmp_path, ExportOptions(topic="/imu/data"))
    assert READERS[target](path)


def test_a_topic_is_given_or_reported_as_missing() -> None:
    """A table has no topic, so a comment asks the user to set it."""
    table = replace(_plain_report(), source=Source(path="a.csv", format="csv", topics=("gx", "gy")))
    assert 'rostopic: "/imu0"  # the log names no topic; set yours' in render(table, "kalibr")
    assert 'rostopic: "/my/imu"  # as given' in render(table, "kalibr", ExportOptions(topic="/my/imu"))


@cache
def _two_rates() -> Report:
    """Return a gyroscope at 200 Hz and an accelerometer at 100 Hz, as in a RealSense."""
    models = ("N=1e-3 + B=1e-5 + K=1e-5", "N=2e-3 + B=1e-5 + K=2e-5", "N=3e-3 + B=1e-5 + K=3e-5")
    slow = tuple(
        axis_report(ACCEL, axis, model, rate_hz=100.0) for axis, model in zip(_AXES, models, strict=True)
    )
    return replace(_plain_report(), axes=(*_plain_report().axes[:3], *slow))


@pytest.mark.parametrize("target", READERS)
def test_every_number_applies_to_the_rate_in_the_file(target: str, tmp_path: Path) -> None:
    """The target uses this single rate and recovers N and K of both sensors with it."""
    report = _two_rates()
    (path,) = export(report, target, tmp_path, fitted())
    _agree(report, READERS[target](path))
    own = "the rates differ: f is the rate of each sensor" in path.read_text()
    one = "the rates differ: every number is for one stream at f = 200 Hz" in path.read_text()
    assert (own, one) == (TARGETS[target].own_rates, not TARGETS[target].own_rates)
    assert "the rates differ" not in render(_plain_report(), target)


def _robot_report() -> Report:
    """Return N of 0.01, 0.02 and 0.03 deg/s/√Hz and K of 1e-6 rad/s/√s; 0.001 m/s²/√Hz and 1e-5 m/s²/√s."""
    degree = math.pi / 180
    axes = [
        axis_report(GYRO, axis, f"N={0.01 * i * degree!r} + K=1e-6", mean=-0.004 * i)
        for i, axis in enumerate(_AXES, 1)
    ]
    axes += [axis_report(ACCEL, axis, "N=0.001 + K=1e-5") for axis in _AXES]
    return replace(_plain_report(), axes=tuple(axes))


def test_autoware_gets_the_deviation_of_a_sample_and_the_mean() -> None:
    """At 200 Hz a sample has 14.142 times the density; Autoware subtracts the offset from a sample."""
    data = yaml.safe_load(render(_robot_report(), "autoware"))["/**"]["ros__parameters"]
    assert data == {
        "angular_velocity_offset_x": -0.004,
        "angular_velocity_offset_y": -0.008,
        "angular_velocity_offset_z": -0.012,
        "angular_velocity_stddev_xx": pytest.approx(0.0024682683),
        "angular_velocity_stddev_yy": pytest.approx(0.0049365366),
        "angular_velocity_stddev_zz": pytest.approx(0.0074048049),
        "acceleration_stddev": pytest.approx(0.014142136),
    }
    text = render(_robot_report(), "autoware", ExportOptions(axis_policy="rms"))
    assert "one number each; acceleration_stddev, rms: the root of the mean variance" in text
    sheet = render(model_as_report({GYRO: "N=1e-4", ACCEL: "N=1e-3"}, rate_hz=200.0), "autoware")
    assert "angular_velocity_offset_y: 0.0  # rad/s; unknown without a log" in sheet


def test_fusioncore_gets_the_variance_of_a_bias_per_sample() -> None:
    """(1e-6)²/200 = 5e-15 and (1e-5)²/200 = 5e-13; the noise of a sample stays a deviation."""
    report = _robot_report()
    data = yaml.safe_load(render(report, "fusioncore", fitted()))["fusioncore"]["ros__parameters"]
    assert data == {
        "imu.gyro_noise": pytest.approx(0.0074048049),
        "imu.accel_noise": pytest.approx(0.014142136),
        "ukf.q_gyro_bias": pytest.approx(5e-15),
        "ukf.q_accel_bias": pytest.approx(5e-13),
    }
    tripled = render(report, "fusioncore", fitted(inflate={"white": 3.0, "walk": 3.0}))
    data = yaml.safe_load(tripled)["fusioncore"]["ros__parameters"]
    assert data["imu.gyro_noise"] == pytest.approx(3 * 0.0074048049)
    assert data["ukf.q_gyro_bias"] == pytest.approx(9 * 5e-15)
    assert "ukf.q_gyro_bias: 5.0e-15  # (rad/s)^2; K of" in render(report, "fusioncore", fitted())


def test_some_formats_have_a_rate_for_each_sensor() -> None:
    """Computed by hand: the variance of a sample at its own rate, and the steps of a state space."""
    ros = yaml.safe_load(render(_two_rates(), "ros"))
    assert ros["angular_velocity_covariance"][0] == pytest.approx(1e-5**2 * 200)
    assert ros["linear_acceleration_covariance"][8] == pytest.approx(3e-3**2 * 100)
    assert yaml.safe_load(render(_two_rates(), "gm"))["axes"]["accel_x"]["rate_hz"] == 100
    fast = yaml.safe_load(render(_two_rates(), "fast-lio", fitted()))["mapping"]
    assert fast["acc_cov"] == pytest.approx(3e-3**2 * 200)


def test_one_axis_per_sensor_is_enough_if_one_is_requested() -> None:
    """If the rates of the axes differ, the rate of the first one is written."""
    axes = _plain_report().axes
    alone = replace(_plain_report(), axes=(axes[0], axes[3]))
    assert yaml.safe_load(render(alone, "kalibr", ExportOptions(axis_policy="x")))["update_rate"] == 200
    odd = replace(_plain_report(), axes=(replace(axes[0], rate_hz=200.02), *axes[1:]))
    assert yaml.safe_load(render(odd, "kalibr"))["update_rate"] == 200.02


def test_a_rate_given_by_the_user_is_reported_as_given() -> None:
    """The reader's finding contains this information."""
    finding = Finding(level="warning", code="rate-given", text="the rate is the one given")
    text = render(replace(_plain_report(), findings=(finding,)), "kalibr")
    assert "# gyroscope: f = 200 Hz (given by the user)" in text


def test_opencv_files_start_with_their_directive(tmp_path: Path) -> None:
    """OpenCV requires ``%YAML:1.0`` on the first line."""
    for target in ("openvins", "vins", "orbslam3"):
        text = render(consumer_report(), target)
        assert text.startswith("%YAML:1.0\n")
        (tmp_path / "a.yaml").write_text(text)
        opencv(tmp_path / "a.yaml")


def test_a_comment_contains_the_integer_rate_for_the_old_orbslam3(tmp_path: Path) -> None:
    """The old loader reads IMU.Frequency as an integer, the new one as a real."""
    text = render(_plain_report(), "orbslam3")
    (tmp_path / "new.yaml").write_text(text)
    new = opencv(tmp_path / "new.yaml")
    assert new.getNode("IMU.Frequency").isReal()
    lines = [line for line in text.splitlines() if not line.startswith("IMU.Frequency")]
    old = "\n".join(lines).replace("# IMU.Frequency: ", "IMU.Frequency: ")
    (tmp_path / "old.yaml").write_text(old)
    storage = opencv(tmp_path / "old.yaml")
    node = storage.getNode("IMU.Frequency")
    assert (node.isInt(), int(node.real())) == (True, 200)


@pytest.mark.parametrize("target", ["lio-sam", "fast-lio", "fast-livo2", "point-lio"])
def test_the_comment_mentions_the_ros_2_wrapper(target: str) -> None:
    """The wrapper expects the keys under the node's parameters."""
    assert "ROS 2: put" in render(_plain_report(), target)


def test_gazebo_gets_a_gauss_markov_term_if_there_is_no_walk(tmp_path: Path) -> None:
    """Gazebo's steady state is stddev * sqrt(T/2), so the file has sigma sqrt(2/T)."""
    sigma, time = 4e-5, 90.0
    slow = axis_report(GYRO, "x", f"N=1e-4 + GM(sigma={sigma}, T={time})", bounds={"B": 1e-6, "K": 1e-7})
    report = replace(_plain_report(), axes=(slow, *_plain_report().axes[1:]))
    (path,) = export(report, "gazebo", tmp_path, fitted())
    recovered = READERS["gazebo"](path)
    assert recovered["gyro_x", "T"] == time
    assert recovered["gyro_x", "K"] * math.sqrt(time / 2) == pytest.approx(sigma)
    assert recovered["gyro_y", "T"] == 3600
    (path,) = export(report, "gazebo", tmp_path, fitted(inflate={"flicker": 3.0, "white": 2.0}))
    recovered = READERS["gazebo"](path)
    assert recovered["gyro_x", "K"] * math.sqrt(time / 2) == pytest.approx(3 * sigma)

    assert "K of gyro_z, 95% 2.593e-07 to 3.47e-07; T is nominal; a Gauss-Markov term (T 1500 s) is left" in (
        render(consumer_report(), "gazebo", fitted())
    )


def _slow_report(gyro: str, accel: str) -> Report:
    """Return six axes of two models, with bounds for missing terms."""
    models = ((GYRO, gyro), (ACCEL, accel))
    bounds = {
        text: {symbol: bound for symbol, bound in (("B", 1e-6), ("K", 1e-7)) if f"{symbol}=" not in text}
        for _, text in models
    }
    axes = tuple(
        axis_report(sensor, axis, text, bounds=bounds[text]) for sensor, text in models for axis in _AXES
    )
    return replace(_plain_report(), axes=axes)


def test_kf_gins_gets_the_steady_state_of_gauss_markov_terms() -> None:
    """Keys: gbstd (deg/h) and abstd (mGal) contain the sigma of a term, corrtime (h) its T."""
    report = _slow_report("N=1e-4 + GM(sigma=4e-5, T=7200.0)", "N=1e-4 + GM(sigma=5e-4, T=7200.0)")
    data = yaml.safe_load(render(report, "kf-gins", fitted()))["imunoise"]
    assert data["corrtime"] == 2
    assert data["gbstd"] == pytest.approx([4e-5 * 180 / math.pi * 3600] * 3)
    assert data["abstd"] == pytest.approx([50.0] * 3)


def test_a_walk_explained_by_a_gauss_markov_term_is_written_once() -> None:
    """The state space has the Gauss-Markov state, the comment explains K, kf-gins gets sigma and T."""
    walk = 4e-5 * math.sqrt(2 / 7200)
    found = Estimate(
        key="K",
        symbol="K",
        status="estimated",
        value=walk,
        low=walk / 2,
        high=2 * walk,
        alternatives=("GM",),
        horizon_s=3600.0,
    )
    report = _slow_report("N=1e-4 + GM(sigma=4e-5, T=7200.0)", "N=1e-4 + GM(sigma=5e-4, T=7200.0)")

    def with_walk(axis: AxisReport) -> AxisReport:
        estimates = tuple(found if e.key == "K" else e for e in axis.fit.estimates)
        return replace(axis, fit=replace(axis.fit, estimates=estimates))

    report = replace(report, axes=tuple(map(with_walk, report.axes)))
    states = yaml.safe_load(render(report, "gm"))["axes"]["gyro_x"]["states"]
    assert [state["term"] for state in states] == ["GM"]
    text = render(report, "yaml", fitted())
    k = yaml.safe_load(text)["imu"]["gyroscope"]["x"]["K"]
    assert (k["part_of"], k["holds_to_s"], k["or"]) == ("GM", 3600, ["GM"])
    data = yaml.safe_load(render(report, "kf-gins", fitted()))["imunoise"]
    assert data["corrtime"] == 2
    assert data["gbstd"] == pytest.approx([4e-5 * 180 / math.pi * 3600] * 3)


def test_a_short_term_of_one_sensor_does_not_shorten_the_walk_of_the_other() -> None:
    """With T of the accelerometer's term, the gyroscope's bias would be 19 times too small."""
    report = _slow_report("N=1e-4 + K=1e-6", "N=1e-3 + GM(sigma=3e-4, T=10.0)")
    data = yaml.safe_load(render(report, "kf-gins", fitted()))["imunoise"]
    assert data["corrtime"] == 1
    assert data["gbstd"] == pytest.approx([1e-6 * math.sqrt(1800) * 180 / math.pi * 3600] * 3)


def _least_cover(report: Report, key: str, recovered: Recovered, horizon: float) -> float:
    """Return the minimum ratio of the file's spectrum to the models', over the frequencies of a filter."""
    white, walk, time = recovered[key, "N"], recovered[key, "K"], recovered.get((key, "T"))
    f = np.geomspace((0.01 if time is None else 0.5) / horizon, 0.5, 200)
    bias = TERMS["K"].of(walk) if time is None else GaussMarkov(sigma=walk * math.sqrt(time / 2), T=time)
    spectrum = white**2 + bias.psd(f, 1.0)
    axes = [axis for axis in report.axes if axis.name.startswith(key)]
    return min(float(np.min(spectrum / axis.fit.model.psd(f, rate_hz=1.0))) for axis in axes)


@pytest.mark.parametrize("make", [_plain_report, consumer_report])
@pytest.mark.parametrize("target", [name for name in READERS if TARGETS[name].covers])
def test_exported_numbers_cover_the_fitted_spectrum(
    target: str, make: Callable[[], Report], tmp_path: Path
) -> None:
    """White noise and walk, as recovered by the target's parser, are nowhere below the model of any axis."""
    report = make()
    (path,) = export(report, target, tmp_path)
    recovered = READERS[target](path)
    horizon = TARGETS[target].horizon_s
    sensors = {key for key, symbol in recovered if (key, "N") in recovered and (key, "K") in recovered}
    assert sensors
    for key in sensors:
        assert _least_cover(report, key, recovered, horizon) > 0.97, key
    text = path.read_text()
    assert f"every 1 s or slower, horizon {horizon:g} s" in text
    assert "x the model's error at 1, 10, 60" in text


@pytest.mark.parametrize(("policy", "count"), [("worst", 3), ("rms", 3), ("y", 1)])
def test_horizon_step_and_policy_determine_the_pair(policy: AxisPolicy, count: int) -> None:
    """One axis must be covered at every frequency, several axes in the mean."""
    report = _plain_report()
    text = render(report, "kalibr", ExportOptions(axis_policy=policy, horizon_s=600.0, step_s=0.2))
    fits = [axis.fit for axis in report.axes[:3]] if count == 3 else [report.axes[1].fit]
    pair = filter_numbers(fits, horizon_s=600.0, step_s=0.2, joined="rms" if policy == "rms" else "worst")
    data = yaml.safe_load(text)
    assert data["gyroscope_noise_density"] == pytest.approx(pair.white, rel=1e-7)
    assert data["gyroscope_random_walk"] == pytest.approx(pair.walk, rel=1e-7)
    assert "every 0.2 s or slower, horizon 600 s" in text
    assert ("fitted spectrum (80%)" in text) == (count == 1)


def test_inflation_multiplies_a_pair() -> None:
    """Each factor applies to its term. An inflated flicker is covered by larger white noise and walk."""
    plain = yaml.safe_load(render(_plain_report(), "kalibr"))
    text = render(_plain_report(), "kalibr", ExportOptions(inflate={"white": 2.0, "walk": 10.0}))
    raised = yaml.safe_load(render(_plain_report(), "kalibr", ExportOptions(inflate={"flicker": 10.0})))
    for key, factor in (("gyroscope_noise_density", 2), ("accelerometer_random_walk", 10)):
        assert yaml.safe_load(text)[key] == pytest.approx(factor * plain[key])
        assert raised[key] > 1.1 * plain[key]


def test_inflation_of_flicker_applies_to_a_bounded_term() -> None:
    """The model's value is used and inflated like its bound, so the pair is ten times larger."""
    axis = axis_report(GYRO, "x", "N=1e-9 + B=1e-5", bounds={"K": 1e-14})
    bounded = replace(axis.fit["B"], status="bounded", value=None, low=0.0)
    estimates = tuple(bounded if e.key == "B" else e for e in axis.fit.estimates)
    axis = replace(axis, fit=replace(axis.fit, estimates=estimates))
    report = replace(consumer_report(), axes=(axis, *consumer_report().axes[3:]))
    plain, raised = (
        yaml.safe_load(render(report, "kalibr", ExportOptions(axis_policy="x", inflate={"flicker": factor})))
        for factor in (1.0, 10.0)
    )
    for key in ("gyroscope_noise_density", "gyroscope_random_walk"):
        assert raised[key] == pytest.approx(10 * plain[key], rel=0.01)


def test_the_comment_lists_effects_that_two_numbers_do_not_cover() -> None:
    """Rounding adds a step to an angle, and a tone moves it by 2A/omega.

    The comment also contains N and K of the fit.
    """
    text = render(consumer_report(), "px4")
    assert "accel_x: quantization adds up to sqrt(2) Q = 2.83e-06" in text
    assert f"the tone of 12.5 Hz is not included; it adds {1.2e-5 / (math.pi * 12.5):.3g}" in text
    assert "; fit: N 0.00013 (" in text
    assert "not detected, so the 95% upper bound is included in part: K of accel_y, K of gyro_y" in text


def test_kf_gins_and_okvis2_get_the_measured_correlation_time() -> None:
    """A bias with a correlation time of 20 s is no walk, so its T fits better than a long one."""
    models = ((GYRO, "N=1e-4 + GM(sigma=4e-5, T=20.0)"), (ACCEL, "N=1e-3 + GM(sigma=5e-4, T=20.0)"))
    bounds = {"B": 1e-8, "K": 1e-10}
    axes = [axis_report(sensor, axis, text, bounds=bounds) for sensor, text in models for axis in _AXES]
    report = replace(_plain_report(), axes=tuple(axes))
    data = yaml.safe_load(render(report, "kf-gins"))["imunoise"]
    assert data["corrtime"] == pytest.approx(20 / 3600)
    assert data["gbstd"] == pytest.approx([4e-5 * 180 / math.pi * 3600] * 3, rel=0.1)
    text = render(report, "okvis2").removeprefix("%YAML:1.0")
    assert yaml.safe_load(text)["imu_parameters"]["tau"] == 20
    assert "as fitted" in render(report, "okvis2", fitted())


def test_a_walk_gets_a_long_correlation_time() -> None:
    """The time is the longer of ten horizons and the record, so that the term remains a walk."""
    report = _slow_report("N=1e-4 + K=1e-6", "N=1e-3 + K=1e-5")
    assert yaml.safe_load(render(report, "kf-gins"))["imunoise"]["corrtime"] == 3
    data = yaml.safe_load(render(report, "kf-gins", ExportOptions(horizon_s=3600.0)))["imunoise"]
    assert data["corrtime"] == 10


def test_px4_numbers_outside_its_range_are_reported() -> None:
    """A good accelerometer at rest is below the range; the ground station's warning gives no reason."""
    assert "EKF2_ACC_NOISE: 0.003 is outside the range that PX4 documents, 0.01 to 1" in render(
        replace(
            _plain_report(),
            axes=tuple(
                axis_report(sensor, axis, "N=3e-4 + B=1e-5 + K=1e-6")
                for sensor in (GYRO, ACCEL)
                for axis in ("x", "y", "z")
            ),
        ),
        "px4",
        fitted(),
    )


def test_the_bias_of_gazebo_equals_the_walk_in_each_step() -> None:
    """Gazebo's step is sigma_b sqrt(-T/2 expm1(-2 dt/T)), which equals K sqrt(dt) up to dt/T."""
    driving, time, dt = 3e-6, 3600.0, 1 / 200
    step = driving * math.sqrt(-time / 2 * math.expm1(-2 * dt / time))
    assert step == pytest.approx(driving * math.sqrt(dt), rel=dt / time)
    assert GaussMarkov(sigma=driving * math.sqrt(time / 2), T=time).q(dt) == pytest.approx(step, rel=1e-12)


@pytest.mark.parametrize("target", TARGETS)
def test_a_report_read_from_its_file_gives_the_same_text(target: str) -> None:
    """``imucal export`` of a folder and of its log must agree."""
    report = consumer_report()
    again = from_document(json.loads(dumps(to_document(report))))
    assert render(again, target) == render(report, target)


@given(value=st.floats(1e-300, 1e300))
def test_numbers_are_read_back_with_eight_digits(value: float) -> None:
    """Readers: Python and YAML 1.1, with and without an exponent."""
    read = float(real(value))
    assert read == yaml.safe_load(real(value)) == float(decimal(value)) == pytest.approx(value, rel=6e-8)
    assert len(real(value).partition("e")[0].replace(".", "").strip("0")) <= 8 or 0.9 < value < 1


def test_a_bank_of_states_has_the_spectrum_of_flicker() -> None:
    """Inside the bank the measured ripple is 0.7 % at 1.5 states per decade.

    Two decades from either end the missing tails are below 1 %.
    """
    bank = NoiseModel(terms=GaussMarkov.bank(1e-4, 1e-1, 1e7, 1.5))
    flicker = NoiseModel(terms=(BiasInstability(value=1e-4),))
    f = np.geomspace(1 / (2 * np.pi * 1e5), 1 / (2 * np.pi * 10), 50)
    ratio = bank.psd(f, rate_hz=100.0) / flicker.psd(f, rate_hz=100.0)
    np.testing.assert_allclose(ratio, 1, atol=0.017)


def test_the_state_space_has_the_fits_allan_curve() -> None:
    """The deviations agree to 8 % up to a tenth of the record."""
    report = _plain_report()
    axis = report.axes[0]
    states = yaml.safe_load(render(report, "gm"))["axes"]["gyro_x"]
    m = np.exp2(np.arange(0, 18, dtype=np.float64))
    avar = states["white"] ** 2 / m
    for state in states["states"]:
        if state["phi"] == 1:
            avar += state["q"] ** 2 * (2 * m**2 + 1) / (6 * m)
        else:
            term = GaussMarkov.bank(1.0, state["T"], 2 * state["T"], 1.5)[0]
            avar += (state["sigma"] / term.sigma) ** 2 * term.avar(m, 1 / 200)
            assert state["phi"] == pytest.approx(math.exp(-1 / (200 * state["T"])), rel=1e-8)
    expected = axis.fit.model.avar(m, rate_hz=200.0)
    np.testing.assert_allclose(np.sqrt(avar / expected), 1, atol=0.08)


@pytest.mark.parametrize("sign", ["\x9b", "\x80", "\u202e", "\u2066", "\u200e", "\u200f"])
def test_control_and_direction_characters_are_escaped(sign: str) -> None:
    """YAML refuses the former, and the latter reverse the text of an editor."""
    text = f"/imu{sign}31m"
    written = quoted(text)
    assert written.isprintable()
    assert json.loads(written) == text
    assert dumps([text]).strip().isprintable()
    assert comment([text]).isprintable()
