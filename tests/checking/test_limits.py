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
    assert limits.findings.forbid == {"motion", "saturated"}
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
    ("text", "message"),
    [
        ("[gyroscope\n", "l.toml: not valid TOML (Expected ']' at the end of a table declaration"),
        ("", "l.toml: no limit, write one, such as [gyroscope] N = { max = 1e-4 }"),
        ("[gyro]\nN = { max = 1 }", "l.toml: unknown key 'gyro'; did you mean 'gyroscope'?"),
        ("[gyroscop]\n", "l.toml: unknown key 'gyroscop'; did you mean 'gyroscope'?"),
        (
            "[gyroscope]\nW = { max = 1 }",
            "l.toml: gyroscope: unknown key 'W', expected Q, N, B, GM, K, R, minimum,",
        ),
        ("[gyroscope]\naxis = ['x']", "l.toml: gyroscope: unknown key 'axis'; did you mean 'axes'?"),
        ("[gyro_x]\naxis = 1", "l.toml: gyro_x: unknown key 'axis'; did you mean 'gaps'?"),
        ("'' = 1", "l.toml: unknown key '', expected log, gyroscope, accelerometer, gyro_x,"),
        ("[gyroscope]\n'' = 1", "l.toml: gyroscope: unknown key '', expected Q, N, B, GM, K, R, minimum,"),
        ("[baseline]\nmax_decrease = -0.1", "l.toml: baseline.max_decrease: -0.1, expected 0 or more"),
        ("[gyroscope]\nminimun = { max = 1 }", "gyroscope: unknown key 'minimun'; did you mean 'minimum'?"),
        (
            "[gyroscope]\nN = { maximum = 1 }",
            "l.toml: gyroscope.N: unknown key 'maximum'; did you mean 'max'?",
        ),
        ("[gyroscope]\nN = 1", "l.toml: gyroscope.N: 1, expected a table, such as { max = 1e-4 }"),
        ("[gyroscope]\nN = { }", "l.toml: gyroscope.N: neither min nor max, expected a limit"),
        ('[gyroscope]\nN = { max = "1" }', "l.toml: gyroscope.N.max: '1', expected a number"),
        ("[gyroscope]\nN = { max = nan }", "l.toml: gyroscope.N.max: nan, expected a number"),
        ("[gyroscope]\nN = { max = true }", "l.toml: gyroscope.N.max: True, expected a number"),
        ("[gyroscope]\nN = { min = 2, max = 1 }", "l.toml: gyroscope.N: min is above max, swap them"),
        (
            '[gyroscope]\nB = { max = 1, unit = "mg" }',
            "l.toml: gyroscope.B.unit: 'mg', expected one of rad/s, mrad/s, deg/s, mdeg/s, deg/h",
        ),
        ("[gyroscope]\nB = { max = 1, unit = 3 }", "l.toml: gyroscope.B.unit: 3, expected text"),
        ("[log]\nN = { max = 1 }", "l.toml: log: unknown key 'N', expected rate, duration, gaps, missing"),
        ("[gyro_x]\naxes = []", "l.toml: gyro_x.axes: only gyroscope and accelerometer have axes, remove it"),
        ('[gyroscope]\naxes = ["w"]', "l.toml: gyroscope.axes: unknown key 'w', expected x, y, z"),
        ('[gyroscope]\naxes = "x"', "l.toml: gyroscope.axes: 'x', expected a list of texts"),
        ("undecided = 1\n[gyroscope]\nN = { max = 1 }", 'l.toml: undecided: 1, expected "pass" or "fail"'),
        (
            '[findings]\nlevel = "grave"',
            "l.toml: findings.level: 'grave', expected info, warning, error or none",
        ),
        (
            '[findings]\nforbid = ["motoin"]',
            "l.toml: findings.forbid: unknown code 'motoin'; did you mean 'motion'?",
        ),
        ('[findings]\nallow = ["?"]', "l.toml: findings.allow: unknown code '?', expected the code of a"),
        (
            '[findings]\nforbid = ["gaps"]\nallow = ["gaps"]',
            "l.toml: findings: gaps both forbidden and allowed",
        ),
        ("[baseline]\nmax_increase = -1", "l.toml: baseline.max_increase: -1, expected 0 or more"),
        ('[baseline]\nterms = ["W"]', "l.toml: baseline.terms: unknown key 'W', expected Q, N, B, GM, K, R"),
        ("[baseline]\nreport = 1", "l.toml: baseline.report: 1, expected the path of a report"),
    ],
)
def test_errors_contain_their_place(text: str, message: str) -> None:
    """A typing error must not let a check pass; the exit code is 2."""
    with pytest.raises(LimitsError) as error:
        parse_limits(text, name="l.toml")
    assert message in str(error.value)
    assert error.value.exit_code == 2


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
    with pytest.raises(LimitsError, match=r"gyro_x\.N: N has limits twice"):
        parse_limits("[gyro_x]\nARW = { max = 1 }\nN = { max = 1 }")


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
