"""Limits of a calibration: the complete interval of a parameter's magnitude decides, as for noise."""

import json
from pathlib import Path
from typing import Any, TypeAlias

import pytest

import imucal
from imucal.calibration import Calibration
from imucal.calibration.document import from_document, to_document
from imucal.checking import CheckResult, parse_limits
from imucal.checking.calibrated import check_calibration
from imucal.errors import LimitsError
from tests.cli.run import SAMPLE_LOGS, run
from tests.report.synthetic import consumer_report

Document: TypeAlias = dict[str, Any]

SCALE = '[calibration.accelerometer]\nscale = { max = 2, unit = "%" }\n'


@pytest.fixture(scope="module")
def found() -> Calibration:
    """Return the calibration of the sample log."""
    return imucal.calibrate(imucal.read(SAMPLE_LOGS / "poses.mcap"), latitude=47.4)


@pytest.fixture
def document(found: Calibration) -> Document:
    """Return its JSON document, which tests can modify."""
    copy: Document = json.loads(json.dumps(to_document(found)))
    return copy


def judged(document: Document, limits: str) -> CheckResult:
    return check_calibration(from_document(document, file="calibration.json"), parse_limits(limits))


@pytest.mark.parametrize(
    ("interval", "verdict", "text"),
    [
        ((1.2, 1.5, 1.9), "pass", "|scale_x| is 1.5 [1.2, 1.9] %; not above the largest allowed, 2"),
        ((-1.9, -1.5, -1.2), "pass", "|scale_x| is 1.5 [1.2, 1.9] %; not above the largest allowed, 2"),
        ((-0.5, 0.3, 1.1), "pass", "|scale_x| is 0.3 [0, 1.1] %; not above the largest allowed, 2"),
        ((2.1, 2.5, 2.9), "fail", "|scale_x| is 2.5 [2.1, 2.9] %; above the largest allowed, 2"),
        ((-2.9, -2.5, -2.1), "fail", "|scale_x| is 2.5 [2.1, 2.9] %; above the largest allowed, 2"),
        ((1.5, 1.9, 2.3), "undecided", "|scale_x| is 1.9 [1.5, 2.3] %; the interval contains the largest"),
        ((-2.3, -0.1, 2.1), "undecided", "|scale_x| is 0.1 [0, 2.3] %; the interval contains the largest"),
    ],
)
def test_the_interval_of_the_magnitude_decides(
    document: Document, interval: tuple[float, float, float], verdict: str, text: str
) -> None:
    """A scale error of -2.5 % is as bad as one of 2.5 %."""
    document["accelerometer"]["parameters"]["scale_x"] |= dict(
        zip(("low", "value", "high"), interval, strict=True)
    )
    row, *others = judged(document, SCALE).rows
    assert (row.where, row.rule, row.verdict) == ("accel", "|scale_x| <= 2 %", verdict)
    assert row.text.startswith(f"accel: {text}")
    assert [other.subject for other in others] == ["|scale_y|", "|scale_z|", "findings"]


def test_every_limit_has_rows_in_its_unit(found: Calibration, document: Document) -> None:
    """Rows contain the values of calibration.json in that unit; the residual has no interval."""
    limits = """
        [calibration.accelerometer]
        misalignment = { max = 1, unit = "deg" }
        bias = { max = 1, unit = "mm/s^2" }
        residual = { max = 5, unit = "mm/s^2" }
        [calibration.gyroscope]
        scale = { max = 30000, unit = "ppm" }
        misalignment = { max = 0.1, unit = "rad" }
        bias = { max = 1, unit = "deg/s" }
        g_sensitivity = { max = 1, unit = "deg/s/g" }
        residual = { max = 1, unit = "deg" }
    """
    rows = {(row.where, row.subject): row for row in judged(document, limits).rows}
    assert len(rows) == 3 + 3 + 1 + 3 + 6 + 3 + 9 + 1 + 1
    bias, residual = rows["accel", "|bias_x|"], rows["accel", "residual"]
    assert bias.measured is not None
    assert bias.measured.value == pytest.approx(1e3 * abs(found.accelerometer.b[0]))
    assert bias.verdict == "fail"
    assert residual.measured is not None
    squares = [rest.residual**2 for rest in found.rests if rest.used]
    assert residual.measured.value == pytest.approx(1e3 * (sum(squares) / len(squares)) ** 0.5)
    assert residual.measured.low == residual.measured.high
    turns = rows["gyro", "residual"].measured
    assert turns is not None
    assert turns.value == pytest.approx(0.028, abs=0.002)
    scale = rows["gyro", "|scale_x|"].measured
    assert scale is not None
    assert scale.value == pytest.approx(1e4 * abs(document["gyroscope"]["parameters"]["scale_x"]["value"]))


def test_a_parameter_that_the_log_does_not_determine_is_undecided(document: Document) -> None:
    """A missing gyroscope fails, so that its absence can't pass; raw counts are an error."""
    unknown = {"low": None, "value": None, "high": None, "status": "not-observable"}
    document["accelerometer"]["parameters"]["scale_x"] |= unknown
    row = judged(document, SCALE).rows[0]
    assert (row.verdict, row.measured) == ("undecided", None)
    assert row.text.startswith("accel: the log does not determine scale_x; add the rests and turns")
    document["turns"] = []
    gyroscope = SCALE.replace("accelerometer", "gyroscope")
    (row, _) = judged(document, '[calibration.gyroscope]\nresidual = { max = 1, unit = "deg" }').rows
    assert row.verdict == "undecided"
    document["gyroscope"] = None
    row = judged(document, gyroscope).rows[0]
    assert (row.verdict, row.text) == ("fail", "gyro: the calibration has no gyroscope")
    document["accelerometer"]["parameters"]["scale_x"]["unit"] = "raw/(m/s^2)"
    with pytest.raises(LimitsError, match="scale_x of the accelerometer is in raw counts"):
        judged(document, SCALE)


def test_findings_of_a_calibration_are_judged(document: Document) -> None:
    """Level and code decide, as for noise."""
    finding = {"level": "warning", "code": "warming", "axis": None, "text": "It warms up.", "advice": ""}
    document["findings"] = [finding]
    assert judged(document, SCALE).passed
    assert not judged(document, f'{SCALE}[findings]\nlevel = "warning"').passed
    result = judged(document, '[findings]\nforbid = ["warming"]')
    assert [(row.subject, row.verdict) for row in result.rows] == [("warming", "fail")]
    assert result.noise.grade == "check"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[calibration.gyro]\n", "calibration: unknown key 'gyro'; did you mean 'gyroscope'?"),
        ("[calibraton.gyroscope]\n", "unknown key 'calibraton'; did you mean 'calibration'?"),
        (
            SCALE.replace("scale", "scal"),
            "calibration.accelerometer: unknown key 'scal'; did you mean 'scale'?",
        ),
        (SCALE.replace("max", "maks"), "accelerometer.scale: unknown key 'maks'; did you mean 'max'?"),
        (SCALE.replace("max", "min"), "accelerometer.scale: unknown key 'min', expected one of max, unit"),
        (SCALE.replace("%", "deg"), 'accelerometer.scale.unit: found "deg", expected one of %, ppm'),
        (SCALE.replace("2", "-2"), "accelerometer.scale.max: found -2, expected a number from 0"),
        (SCALE.replace(', unit = "%"', ""), "accelerometer.scale: found max, expected the key 'unit'"),
        (SCALE.replace("max = 2, ", ""), "accelerometer.scale: found unit, expected the key 'max'"),
        (
            SCALE.replace("scale", "g_sensitivity"),
            "unknown key 'g_sensitivity', expected one of scale, misalignment",
        ),
    ],
)
def test_wrong_limits_of_a_calibration_are_refused(text: str, message: str) -> None:
    """The error contains the place and the nearest known key."""
    with pytest.raises(LimitsError) as error:
        parse_limits(text, name="l.toml")
    assert message in str(error.value)


def test_limits_of_noise_are_refused_for_a_calibration(document: Document) -> None:
    """A file with both kinds of limits works for both."""
    noise = '[gyroscope]\nN = { max = 1, unit = "deg/sqrt(h)" }\n'
    with pytest.raises(LimitsError, match=r"poses.mcap: this is a calibration"):
        judged(document, noise)
    with pytest.raises(LimitsError, match="this is a noise report"):
        imucal.check(consumer_report(), SCALE)
    assert judged(document, noise + SCALE).count("pass") == 4
    assert imucal.check(consumer_report(), noise + SCALE).count("pass") == 4


def test_check_works_on_the_command_line_and_in_python(found: Calibration, tmp_path: Path) -> None:
    """Exit code, table, JSON and JUnit equal those for noise. A calibration needs a limits file."""
    log = str(SAMPLE_LOGS / "poses.mcap")
    run("calibrate", log, "--latitude", "47.4", "-o", "found", "--no-html", "-q", cwd=tmp_path)
    (tmp_path / "limits.toml").write_text(SCALE)
    (tmp_path / "strict.toml").write_text(SCALE.replace("2", "0.1"))
    command = ("check", "found", "--limits")
    done = run(*command, "limits.toml", "--junit", "junit.xml", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("PASS: 4 passed, 0 failed, 0 undecided (intervals at 95%)\n")
    assert '<testsuite name="' in (tmp_path / "junit.xml").read_text()
    failed = run(*command, "strict.toml", "--json", cwd=tmp_path)
    assert failed.returncode == 1
    assert json.loads(failed.stdout)["counts"] == {"pass": 1, "fail": 3, "undecided": 0}
    assert imucal.check(tmp_path / "found", tmp_path / "limits.toml").rows == imucal.check(found, SCALE).rows
    for wrong in (("--baseline", "found"), ("--config", "limits.toml"), ("--skip", "3s")):
        refused = run(*command, "limits.toml", *wrong, cwd=tmp_path)
        assert refused.returncode == 2
        assert "found is a calibration, " in refused.stderr
