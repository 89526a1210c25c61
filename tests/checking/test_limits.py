"""The limits file: its content, and the errors for wrong content."""

import math
import re
import tomllib
from pathlib import Path

import pytest

from imucal.checking import Baseline, Limits, parse_limits, read_limits
from imucal.checking.limits import (
    FINDING_CODES,
    LOG_QUANTITIES,
    SAMPLE_QUANTITIES,
    TERM_QUANTITIES,
    quantity_units,
)
from imucal.errors import LimitsError
from imucal.noise import TERMS
from imucal.recording import Sensor
from imucal.units import G0, find_unit

EXAMPLE = Path(__file__).parents[2] / "docs" / "limits-example.toml"
DEGREE = math.pi / 180


def test_the_example_of_the_documentation_is_valid() -> None:
    """Every part of the file is read."""
    limits = read_limits(EXAMPLE)
    assert len(limits.limits) == 4 + 5 + 2 + 2
    assert len(limits.calibration) == 4 + 5
    assert limits.required[Sensor.GYROSCOPE] == ("x", "y", "z")
    assert limits.findings.forbid == ("motion", "saturated")
    assert limits.baseline is None
    assert limits.undecided == "pass"


def test_a_limit_keeps_its_unit_and_a_factor_to_si() -> None:
    """0.3 deg/sqrt(h) is 0.3 * pi/180/60 rad/s/sqrt(Hz)."""
    (limit,) = parse_limits('[gyroscope]\nN = { max = 0.3, unit = "deg/sqrt(h)" }').limits
    assert (limit.where, limit.quantity, limit.side, limit.value) == ("gyroscope", "N", "max", 0.3)
    assert limit.value * limit.factor == pytest.approx(0.3 * DEGREE / 60)


@pytest.mark.parametrize(
    ("sensor", "quantity", "unit", "si"),
    [
        (Sensor.GYROSCOPE, "N", "deg/s/sqrt(Hz)", DEGREE),
        (Sensor.GYROSCOPE, "N", "°/√h", DEGREE / 60),
        (Sensor.ACCELEROMETER, "N", "µg/√Hz", 1e-6 * G0),
        (Sensor.ACCELEROMETER, "N", "m/s/sqrt(h)", 1 / 60),
        (Sensor.GYROSCOPE, "B", "deg/h", DEGREE / 3600),
        (Sensor.ACCELEROMETER, "minimum", "mg", 1e-3 * G0),
        (Sensor.GYROSCOPE, "K", "rad/s^2/sqrt(Hz)", 1.0),
        (Sensor.GYROSCOPE, "K", "deg/h/sqrt(h)", DEGREE / 3600 / 60),
        (Sensor.ACCELEROMETER, "K", "m/s^3/sqrt(Hz)", 1.0),
        (Sensor.GYROSCOPE, "R", "deg/h/h", DEGREE / 3600**2),
        (Sensor.GYROSCOPE, "R", "deg/h^2", DEGREE / 3600**2),
        (Sensor.GYROSCOPE, "Q", "arcsec", DEGREE / 3600),
    ],
)
def test_units_of_data_sheets_and_configs_are_converted(
    sensor: Sensor, quantity: str, unit: str, si: float
) -> None:
    found = find_unit(unit, quantity_units(quantity, sensor))
    assert found is not None
    assert found[1] == pytest.approx(si, rel=1e-12)


def test_quantities_of_the_log_have_units() -> None:
    """A limit without a unit uses the first one."""
    found = {
        quantity: list(quantity_units(quantity, Sensor.GYROSCOPE).items()) for quantity in LOG_QUANTITIES
    }
    assert found == {
        "rate": [("Hz", 1), ("kHz", 1000)],
        "duration": [("s", 1), ("min", 60), ("h", 3600), ("d", 86_400)],
        "gaps": [("", 1)],
        "missing": [("", 1), ("%", 0.01), ("ppm", 1e-6)],
    }


@pytest.mark.parametrize("sensor", Sensor)
@pytest.mark.parametrize("quantity", [*TERM_QUANTITIES, *SAMPLE_QUANTITIES])
def test_every_quantity_has_si_first_and_its_data_sheet_unit(sensor: Sensor, quantity: str) -> None:
    """A limit without a unit is in SI."""
    units = quantity_units(quantity, sensor)
    symbol = quantity if quantity in TERMS else "B"
    assert next(iter(units)) == TERMS[symbol].unit(sensor)
    assert next(iter(units.values())) == 1
    assert TERMS[symbol].datasheet_unit(sensor).name in units


@pytest.mark.parametrize(
    ("text", "place", "problem"),
    [
        ("", "", "no limit, expected one such as [gyroscope] N = { max = 1e-4 }"),
        ("undecided = 'fail'", "", "no limit"),
        ("[gyro]\nN = { max = 1 }", "", "unknown key 'gyro'; did you mean 'gyroscope'?"),
        ("[gyroscop]\n", "", "unknown key 'gyroscop'; did you mean 'gyroscope'?"),
        ("'' = 1", "", "unknown key '', expected one of log, gyroscope, accelerometer, gyro_x,"),
        ("gyroscope = 1", "gyroscope", "found 1, expected a table"),
        ("[gyroscope]\nW = { max = 1 }", "gyroscope", "expected one of Q, N, B, GM, K, R, minimum,"),
        ("[gyroscope]\n'' = 1", "gyroscope", "unknown key '', expected one of Q, N, B, GM, K, R, minimum,"),
        ("[gyroscope]\naxis = ['x']", "gyroscope", "unknown key 'axis'; did you mean 'axes'?"),
        ("[gyro_x]\naxes = ['x']", "gyro_x", "unknown key 'axes', expected one of Q,"),
        ("[gyroscope]\nminimun = { max = 1 }", "gyroscope", "unknown key 'minimun'; did you mean 'minimum'?"),
        ("[gyroscope]\nN = { maximum = 1 }", "gyroscope.N", "unknown key 'maximum'; did you mean 'max'?"),
        ("[log]\nrate = { max = 1, sensor = 'BMI088' }", "log.rate", "unknown key 'sensor'"),
        ("[log]\nN = { max = 1 }", "log", "unknown key 'N', expected one of rate, duration, gaps, missing"),
        ("[gyroscope]\nN = 1", "gyroscope.N", "found 1, expected a table"),
        ("[gyroscope]\nN = { }", "gyroscope.N", "neither min nor max, expected a limit"),
        ('[gyroscope]\nN = { max = "1" }', "gyroscope.N.max", 'found "1", expected a number'),
        ("[gyroscope]\nN = { max = nan }", "gyroscope.N.max", "found NaN, expected a finite number"),
        ("[gyroscope]\nN = { min = -inf }", "gyroscope.N.min", "expected a finite number"),
        ("[gyroscope]\nN = { max = true }", "gyroscope.N.max", "found true, expected a number"),
        ("[gyroscope]\nN = { max = 2026-11-30 }", "gyroscope.N.max", 'found "2026-11-30", expected a number'),
        ("[gyroscope]\nN = { min = 2, max = 1 }", "gyroscope.N", "min 2 is above max 1"),
        ('[gyroscope]\nB = { max = 1, unit = "mg" }', "gyroscope.B.unit", "expected one of rad/s, mrad/s,"),
        ("[gyroscope]\nB = { max = 1, unit = 3 }", "gyroscope.B.unit", "found 3, expected a text"),
        ("[gyro_x]\nARW = { max = 1 }\nN = { max = 1 }", "gyro_x.N", "N has limits twice"),
        ('[gyroscope]\naxes = ["w"]', "gyroscope.axes[0]", 'found "w", expected "x" or "y" or "z"'),
        ('[gyroscope]\naxes = "x"', "gyroscope.axes", 'found "x", expected a list'),
        ("undecided = 1\n[gyroscope]\nN = { max = 1 }", "undecided", 'expected "pass" or "fail"'),
        (
            '[findings]\nlevel = "grave"',
            "findings.level",
            'expected "info" or "warning" or "error" or "none"',
        ),
        (
            '[findings]\nforbid = ["motoin"]',
            "findings.forbid",
            "unknown code 'motoin'; did you mean 'motion'?",
        ),
        ('[findings]\nallow = ["?"]', "findings.allow", "unknown code '?', expected one of "),
        ('[findings]\nforbid = ["gaps"]\nallow = ["gaps"]', "findings", "gaps both forbidden and allowed"),
        ("[baseline]\nmax_increase = -1", "baseline.max_increase", "found -1, expected a number from 0"),
        ("[baseline]\nmax_decrease = -0.1", "baseline.max_decrease", "found -0.1, expected a number from 0"),
        (
            '[baseline]\nterms = ["W"]',
            "baseline.terms",
            "unknown term 'W', expected one of Q, N, B, GM, K, R",
        ),
        ("[baseline]\nreport = 1", "baseline.report", "found 1, expected a text"),
        (
            "[calibration.gyroscope]\nscale = { max = 1 }",
            "calibration.gyroscope.scale",
            "found max, expected the key 'unit'",
        ),
        (
            "[calibration.gyroscope]\nscale = { max = -1, unit = '%' }",
            "calibration.gyroscope.scale.max",
            "found -1, expected a number from 0",
        ),
        (
            "[calibration.accelerometer]\nbias = { max = 1, unit = 'deg' }",
            "calibration.accelerometer.bias.unit",
            'found "deg", expected one of m/s^2,',
        ),
    ],
)
def test_errors_contain_their_place(text: str, place: str, problem: str) -> None:
    """A typing error must not let a check pass; the exit code is 2."""
    with pytest.raises(LimitsError) as error:
        parse_limits(text, name="l.toml")
    assert error.value.place == (f"l.toml: {place}" if place else "l.toml")
    assert problem in error.value.sentence
    assert error.value.fixes
    assert error.value.exit_code == 2


def test_a_text_that_is_not_toml_is_an_error() -> None:
    with pytest.raises(LimitsError, match=r"not valid TOML \(Expected ']' at the end of a table") as error:
        parse_limits("[gyroscope\n", name="l.toml")
    assert error.value.place == "l.toml"


def test_an_unreadable_limits_file_is_an_error(tmp_path: Path) -> None:
    """Cases: a missing file, and a binary file."""
    with pytest.raises(LimitsError, match=r"no\.toml: .*No such file"):
        read_limits(tmp_path / "no.toml")
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(LimitsError, match=r"b\.toml: .*not UTF-8"):
        read_limits(tmp_path / "b.toml")


def test_a_baseline_is_relative_to_the_limits_file(tmp_path: Path) -> None:
    """The check is therefore the same from every folder."""
    file = tmp_path / "limits.toml"
    file.write_text('[baseline]\nreport = "golden/report.json"\nmax_decrease = 0.5\n')
    baseline = read_limits(file).baseline
    assert baseline is not None
    assert baseline.report == tmp_path / "golden" / "report.json"
    assert baseline.max_decrease == 0.5
    assert baseline.max_increase is None  # only what is requested
    # The help of the command documents this default: 20 % more N, B and K.
    assert parse_limits("[baseline]").baseline == Baseline(
        report=None, terms=("N", "B", "K"), max_increase=0.2, max_decrease=None
    )


def test_names_of_data_sheets_are_accepted() -> None:
    """ARW and VRW are N, BI is B, RRW is K; the unit does not change."""
    text = """
        [gyroscope]
        ARW = { max = 0.3, unit = "deg/sqrt(h)" }
        BI = { max = 10, unit = "deg/h" }
        [accelerometer]
        VRW = { max = 1e-3 }
        RRW = { max = 1e-4 }
        [baseline]
        terms = ["ARW", "K"]
    """
    limits = parse_limits(text)
    assert [limit.quantity for limit in limits.limits] == ["N", "B", "N", "K"]
    assert limits.limits[0].unit == "deg/sqrt(h)"
    assert limits.baseline is not None
    assert limits.baseline.terms == ("N", "K")


def test_the_finding_codes_equal_those_of_the_documentation() -> None:
    """The page is compared with the source by another test, so a new code must be added to page and list."""
    page = (EXAMPLE.parent / "messages.md").read_text(encoding="utf-8")
    cells = re.findall(r"^\| (`[^|]*`) \|", page, re.MULTILINE)
    assert {code for cell in cells for code in re.findall(r"`([a-z-]+)`", cell)} == FINDING_CODES


def test_the_toml_blocks_of_the_page_on_ci_are_valid() -> None:
    page = (EXAMPLE.parent / "use-in-ci.md").read_text(encoding="utf-8")
    blocks = [block.split("```")[0] for block in page.split("```toml\n")[1:]]
    assert len(blocks) == 2
    for block in blocks:
        assert tomllib.loads(block)
        assert isinstance(parse_limits(block), Limits)
