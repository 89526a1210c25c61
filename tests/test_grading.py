"""Tests of the verdict: the grade of every code, and its sentence."""

import ast
from pathlib import Path

import pytest

import imucal
from imucal.checking.limits import FINDING_CODES
from imucal.findings import Finding, Level
from imucal.grading import BY_LEVEL, OF_ALL_AXES, OTHERWISE, Grade, grade_of, judge_findings, percent

LEVELS: tuple[Level, ...] = ("info", "warning", "error")
#: Codes of fleets, which do not occur in a recording.
OF_A_FLEET = {"few-units", "weak-term"}
#: Position of the code among the arguments.
PLACE_OF_CODE = {"Finding": 1, "Loss": 0, "DamagedError": 1, "damaged_if": 2}
AXES = [f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"]


def finding(code: str, level: Level = "warning", axis: str | None = None) -> Finding:
    """Return a finding."""
    return Finding(level=level, code=code, text="Seen.", axis=axis)


def sentence(*findings: Finding, errors: dict[str, float] | None = None) -> str:
    """Return the verdict's sentence about six axes."""
    return judge_findings(findings, AXES, errors=errors).sentence


@pytest.mark.parametrize("code", sorted(FINDING_CODES))
def test_the_grade_follows_from_the_table_or_the_level(code: str) -> None:
    """Info is good, warning is check, and error is not noise, except for the entries of the table."""
    by_level: dict[Level, Grade] = {"info": "good", "warning": "check", "error": "not-noise"}
    harmless = {(each, "warning") for each in ("unindexed", "index", "not-drawn")}
    for level in LEVELS:
        expected = "good" if (code, level) in harmless else by_level[level]
        assert grade_of(finding(code, level)) == expected
        assert judge_findings([finding(code, level)], AXES).grade == expected


def test_the_tables_contain_existing_codes_only() -> None:
    assert {code for code, _ in OTHERWISE} | OF_ALL_AXES <= FINDING_CODES
    assert set(BY_LEVEL) == set(LEVELS)


def test_every_code_of_the_source_is_known() -> None:
    """The test collects all strings that the package passes as the code of a finding."""
    found: set[str] = set()
    for path in Path(imucal.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            name = getattr(node.func, "id", "")
            if name.endswith("Error"):
                continue
            codes = [keyword.value for keyword in node.keywords if keyword.arg == "code"]
            if name in PLACE_OF_CODE:
                at = PLACE_OF_CODE[name]
                codes += node.args[at : at + 1]
            for code in codes:
                if not isinstance(code, ast.Subscript | ast.Call):  # report.json's own, read back
                    constants = [each.value for each in ast.walk(code) if isinstance(each, ast.Constant)]
                    found |= {value for value in constants if isinstance(value, str)}
    assert len(found) > 40
    assert found - OF_A_FLEET <= FINDING_CODES


def test_a_good_recording_reports_the_precision_of_n() -> None:
    """The widest interval determines it."""
    errors = dict.fromkeys(AXES, 0.002) | {"accel_z": 0.00432}
    assert sentence(errors=errors) == "Good: 6 of 6 axes are stationary noise, N to ±0.43 %"
    assert sentence() == "Good: 6 of 6 axes are stationary noise"
    one = judge_findings([], ["gyro_x"], errors={"gyro_x": 0.12})
    assert one.sentence == "Good: 1 of 1 axis is stationary noise, N to ±12 %"
    assert judge_findings([], []).sentence == "Good: no problem found"


def test_findings_of_level_info_do_not_change_the_verdict() -> None:
    assert sentence(finding("delay", "info"), finding("tone", "info", "gyro_x")).startswith("Good: 6 of 6")


def test_a_warning_contains_its_axes() -> None:
    """The other axes are counted with their own N; a sensor means its three axes."""
    errors = dict.fromkeys(AXES, 0.002) | {"gyro_x": 0.5}
    found = [finding("tone", axis="gyro_x"), finding("warm-up", axis="accel")]
    assert sentence(*found, errors=errors) == (
        "Check first: a tone on gyro_x, a warm-up on accel; 2 of 6 axes are stationary noise, N to ±0.2 %"
    )
    found = [finding("spikes", axis=axis) for axis in ("gyro_x", "gyro_y", "gyro_z", "accel_y")]
    assert sentence(*found).startswith("Check first: spikes on gyro and accel_y; 2 of 6")


def test_a_warning_about_the_log_does_not_exclude_axes() -> None:
    """Missing samples do not affect the noise, but a touch affects all axes."""
    assert sentence(finding("gaps")) == "Check first: missing samples; 6 of 6 axes are stationary noise"
    assert sentence(finding("touch")) == "Check first: something touched or shook the IMU"


def test_many_reasons_are_counted() -> None:
    """Three reasons are listed."""
    found = [finding(code) for code in ("gaps", "damaged", "truncated", "clock-jump", "bad-rows")]
    assert sentence(*found).startswith(
        "Check first: missing samples, damage to the log, a log that was cut off and 2 more; "
    )


def test_a_moved_recording_is_not_noise() -> None:
    """An error about the log excludes all axes, and warnings are omitted."""
    moved = finding("motion", "error")
    assert sentence(moved, finding("gaps")) == "Not noise: the IMU was moved; do not use these numbers"
    assert not judge_findings([moved], AXES).usable
    assert judge_findings([finding("gaps")], AXES).usable


def test_a_dead_axis_does_not_exclude_the_others() -> None:
    """The other axes are counted."""
    errors = dict.fromkeys(AXES, 0.002)
    assert sentence(finding("no-data", "error", "accel_z"), errors=errors) == (
        "Not noise: no data on accel_z; 5 of 6 axes are stationary noise, N to ±0.2 %"
    )
    found = [finding("no-data", "error", "accel_z"), finding("saturated", axis="gyro")]
    found += [finding("tone", axis="accel_x"), finding("spikes", axis="accel_y")]
    assert sentence(*found) == "Not noise: no data on accel_z; look at gyro, accel_x and accel_y first"
    assert sentence(finding("unit-suspect", axis="gyro")) == (
        "Check first: a unit that looks wrong on gyro; 6 of 6 axes are stationary noise"
    )
    dead = [finding("stuck", "error", axis) for axis in AXES]
    assert sentence(*dead) == "Not noise: a stuck value on gyro and accel; do not use these numbers"


def test_a_sensor_without_axes_is_reported() -> None:
    verdict = judge_findings([finding("no-data", axis="accel")], AXES[:3])
    assert verdict.sentence == "Check first: no data on accel; 3 of 3 axes are stationary noise"


@pytest.mark.parametrize(("fraction", "text"), [(0.00432, "0.43 %"), (0.2, "20 %"), (1.234, "120 %")])
def test_a_fraction_is_written_in_percent(fraction: float, text: str) -> None:
    """It has two digits and no exponent."""
    assert percent(fraction) == text
