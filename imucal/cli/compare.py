"""``imucal compare``: the differences between two reports."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucal.calibration.writer import is_calibration
from imucal.cli._fleet import is_fleet, read_fleet
from imucal.cli._printing import FULL, as_typed, picked, print_json, print_note, width
from imucal.cli._report_input import given_report, is_model, read_report, with_model
from imucal.cli.context import misuse
from imucal.cli.options import (
    OUTPUT,
    Command,
    flag,
    fleet_model,
    model_options,
    option,
    quiet,
    si_units,
    unwrapped,
)
from imucal.cli.param_types import Number
from imucal.comparison import Comparison, Difference, compare
from imucal.fitting.noise_fit import Estimate
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.remote import is_url
from imucal.remote.addresses import shown as shown_address
from imucal.report.result import Report
from imucal.units import DatasheetUnit

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucal.calibration.comparison import CalibrationDifference

SCHEMA = "imucal/comparison/1"
#: Schema of the comparison of two calibrations.
CALIBRATIONS = "imucal/calibration-comparison/1"
#: Smallest p-value that is printed: smaller ones depend on the tails of the law.
_LEAST_P = 1e-9
_CALIBRATED = "{:<23}{:<16}{:>11}{:>11}{:>9}  {}".format

_EPILOG = unwrapped("""
Examples:
  imucal compare monday-imucal tuesday-imucal
  imucal compare golden-imucal new-imucal --tolerance 0.1
  imucal compare fleet-2023 fleet-2024
  imucal compare march-calibration june-calibration
  imucal compare still-imucal "N=0.3deg/sqrt(h) + B=5deg/h" --tolerance 1
  imucal compare still-imucal --sensor BMI088 --tolerance 0.5
  imucal compare a-imucal b-imucal --json -q | jq '.differences[].outcome'

Exit codes: 0 no significant difference (or --no-fail), 1 a term differs,
2 usage, 3 a report can't be read, 4 the reports have no axis in common.
""")


@click.command(cls=Command, epilog=_EPILOG)
@click.argument("a", metavar="A", type=click.Path())
@click.argument("b", metavar="B", type=click.Path(), required=False)
@model_options
@option(
    "--alpha",
    metavar="P",
    type=Number(0, 1, min_open=True, max_open=True),
    default=0.05,
    show_default=True,
    help="Probability of a false alarm in any term.",
)
@option(
    "--tolerance",
    metavar="FRACTION",
    type=Number(min=0),
    default=0.0,
    show_default=True,
    help="Relative difference to ignore, such as 0.05.",
)
@flag("--no-fail", help="Exit with code 0 even if a term differs.")
@fleet_model(or_part="Without B: the data sheet of this part, such as BMI088, in place of B.")
@flag("--json", "as_json", group=OUTPUT, help="Print the comparison as JSON (SI) on standard output.")
@si_units
@quiet
def command(
    *,
    a: str,
    b: str | None,
    models: dict[Sensor, str],
    alpha: float,
    tolerance: float,
    no_fail: bool,
    fleet_model: str | None,
    si: bool,
    as_json: bool,
) -> None:
    """Find the noise terms of two reports that differ significantly.

    A and B are reports: a report.json (also by URL) or its folder. p is adjusted for the number of
    tested terms (Holm): two records of one unchanged sensor show any difference with probability
    --alpha. The intervals describe the noise of one record, not changes of the sensor between runs;
    allow for these with --tolerance.

    For two calibrations (folders of 'imucal calibrate' or calibration.json) each parameter is
    compared. For two fleets (folders of 'imucal fleet run') the median units are compared. A or B may be a
    model, such as a data sheet's: give the gyroscope's as an argument, or --gyro and --accel instead
    of B.
    """
    if b is not None and all(is_calibration(Path(path)) for path in (a, b) if not is_url(path)):
        _compare_calibrations(Path(a), Path(b), alpha=alpha, as_json=as_json, no_fail=no_fail)
        return
    result = compare(*_both(a, b, models, fleet_model), alpha=alpha, tolerance=tolerance)
    if as_json:
        print_json(to_document(result))
    else:
        # Not `echo`, which escapes colours; the table contains no file names.
        click.echo(_table(result, datasheet=not si))
    for name, path in (("A", result.a), ("B", result.b)):
        print_note(f"{name}: {path}")
    for note in result.notes:
        print_note(note)
    if result.significant and not no_fail:
        click.get_current_context().exit(1)


def _compare_calibrations(a: Path, b: Path, *, alpha: float, as_json: bool, no_fail: bool) -> None:
    from imucal.calibration.comparison import compare_calibrations
    from imucal.calibration.document import load_document

    found = compare_calibrations(load_document(a), load_document(b), alpha=alpha)
    differing = [one for one in found if one.outcome == "differs"]
    if as_json:
        rows = [
            {
                **picked(one, "sensor parameter unit p outcome"),
                "a": picked(one.a, "value low high status"),
                "b": picked(one.b, "value low high status"),
            }
            for one in found
        ]
        print_json({"schema": CALIBRATIONS, "a": str(a), "b": str(b), "alpha": alpha, "differences": rows})
    else:
        click.echo(_calibration_table(found))
        count = f"{len(differing)} of {sum(one.p is not None for one in found)} parameters differ"
        text = count if differing else "no significant difference"
        click.echo(f"{click.style(text, fg='red' if differing else 'green', bold=True)} (alpha {alpha:g})")
    print_note(f"A: {a}")
    print_note(f"B: {b}")
    if any("bias" in one.parameter for one in differing):
        print_note("Biases differ between starts and temperatures; the intervals are of one log.")
    if differing and not no_fail:
        click.get_current_context().exit(1)


def _calibration_table(found: "Sequence[CalibrationDifference]") -> str:
    """Return a line for each parameter; two on a narrow terminal."""
    narrow = width() < FULL
    lines = [] if narrow else [_CALIBRATED("parameter", "unit", "A", "B", "p", "outcome")]
    for one in found:
        name = f"{one.sensor.short} {one.parameter.replace('_', ' ')}"
        p = _p_text(one.p)
        values = ["-" if each.value is None else f"{each.value:.4g}" for each in (one.a, one.b)]
        outcome: str = one.outcome
        if outcome == "differs":
            outcome = click.style(outcome, fg="red")
        if narrow:
            lines += [f"{name}  {outcome}{f', p {p}' if p else ''}", f"  {' -> '.join(values)} {one.unit}"]
        else:
            lines.append(_CALIBRATED(name, one.unit, *values, p, outcome))
    return "\n".join(lines)


def _both(a: str, b: str | None, models: dict[Sensor, str], fleet: str | None) -> tuple[Report, Report]:
    """Return two reports: from files, from models, or the median units of two fleets."""
    fleets = [path is not None and is_fleet(path) for path in (a, b)]
    if fleet is not None and not any(fleets):
        return _with_part(a, b, models, fleet)
    if b is None or models or is_model(a) or is_model(b):
        return _with_models(a, b, models)
    if not any(fleets):
        return read_report(a), read_report(b)
    if not all(fleets):
        folder, other = (a, b) if fleets[0] else (b, a)
        misuse(
            f"{folder} is a fleet and {shown_address(other)} is not; compare two fleets, or check one log: "
            f"imucal check {_typed(other)} --fleet {_typed(folder)}"
        )
    from imucal.fleet.as_report import fleet_as_report

    first, second = (fleet_as_report(read_fleet(path, fleet), value="median") for path in (a, b))
    return first, second


def _with_part(a: str, b: str | None, models: dict[Sensor, str], name: str) -> tuple[Report, Report]:
    """Return a report, and the figures of a part's data sheet at the same rate."""
    if b is not None or models or is_model(a):
        misuse(f"{shown_address(a)} is not a fleet; omit --sensor, or compare one report with a data sheet")
    from imucal.report.given import part_as_report
    from imucal.sensors import find_sensor

    part = find_sensor(name)
    report = read_report(a)
    print_note(
        "B is a data sheet's typical value: real units have half to twice its N; allow it: --tolerance 1"
    )
    return report, part_as_report(part, rate_hz=next((axis.rate_hz for axis in report.axes), 1.0))


def _with_models(a: str, b: str | None, models: dict[Sensor, str]) -> tuple[Report, Report]:
    """Return two reports, at least one of them a model, which gets the rate of the other."""
    read = [None if text is None or is_model(text) else read_report(text) for text in (a, b)]
    rate_hz = next((axis.rate_hz for report in read if report for axis in report.axes), 1.0)
    second = read[1] or given_report(with_model(b, models, "B"), rate_hz)
    return read[0] or given_report(with_model(a, {}), rate_hz), second


def _typed(text: str) -> str:
    """Return a path or a URL as one argument for a shell, without the URL's secrets."""
    return shlex.quote(shown_address(text)) if is_url(text) else as_typed(Path(text))


def to_document(result: Comparison) -> dict[str, object]:
    """Return a comparison as JSON values, SI."""
    return {
        "schema": SCHEMA,
        **picked(result, "a b alpha tolerance tested"),
        "significant": len(result.significant),
        "notes": result.notes,
        "differences": [
            {
                **picked(difference, "axis term=key unit"),
                "a": _estimate(difference.a),
                "b": _estimate(difference.b),
                **picked(difference, "ratio z p p_adjusted outcome"),
            }
            for difference in result.differences
        ],
    }


def _estimate(estimate: Estimate | None) -> dict[str, object] | None:
    return None if estimate is None else picked(estimate, "status value low high")


_ROW = "{:<8}{:<6}{:<17}{:>11}{:>11}{:>8}{:>9}  {}".format


def _table(result: Comparison, *, datasheet: bool) -> str:
    narrow = width() < FULL
    lines = [] if narrow else [_ROW("axis", "term", "unit", "A", "B", "B/A", "p", "outcome")]
    for difference in result.differences:
        lines += _lines(difference, narrow=narrow, datasheet=datasheet)
    beyond = f" beyond {result.tolerance:.3g} of A" if result.tolerance else ""
    count = len(result.significant)
    text = f"{count} of {result.tested} terms differ" if count else "no significant difference"
    verdict = click.style(f"{text}{beyond}", fg="red" if count else "green", bold=True)
    tests = f"(p adjusted for {result.tested} tests, alpha {result.alpha:g})"
    return "\n".join([*lines, *([verdict, tests] if narrow else [f"{verdict} {tests}"])])


def _p_text(p: float | None) -> str:
    """Return a p-value with two digits, ``<1e-9``, or nothing."""
    if p is None:
        return ""
    return f"{p:.2g}" if p >= _LEAST_P else "<1e-9"


def _lines(difference: Difference, *, narrow: bool, datasheet: bool) -> list[str]:
    """Return a difference as a row, or as two lines on a narrow terminal."""
    unit = DatasheetUnit(difference.unit, 1.0)
    if datasheet and difference.unit != "s":
        unit = TERMS[difference.symbol].datasheet_unit(difference.sensor)
    ratio = "" if difference.ratio is None else f"{difference.ratio:.4g}"
    p = _p_text(difference.p_adjusted)
    a, b = _cell(difference.a, unit), _cell(difference.b, unit)
    outcome: str = difference.outcome
    if outcome == "differs":
        outcome = click.style(outcome, fg="red")
    if narrow:
        first = f"{difference.axis:<8}{difference.key:<6}{outcome}{f', p {p}' if p else ''}"
        return [first, f"  {a} -> {b} {unit.name}"]
    return [_ROW(difference.axis, difference.key, unit.name, a, b, ratio, p, outcome)]


def _cell(estimate: Estimate | None, unit: DatasheetUnit) -> str:
    if estimate is None:
        return "-"
    if estimate.value is None:
        return f"<= {estimate.high * unit.factor:.3g}"
    return f"{estimate.value * unit.factor:.4g}"
