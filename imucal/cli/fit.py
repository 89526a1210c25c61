"""``imucal fit``: fit a noise model and write the report."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucal.cli._fixes import option_of
from imucal.cli._printing import (
    as_typed,
    can_print,
    echo,
    name_of_log,
    print_findings,
    print_note,
    refuse,
    width,
    wrapped,
)
from imucal.cli.context import is_set, misuse
from imucal.cli.log_request import LogRequest
from imucal.cli.options import (
    MODEL,
    OUTPUT,
    SAMPLES,
    Command,
    flag,
    force,
    level,
    log_options,
    model,
    option,
    out_option,
    pictures,
    si_units,
    unwrapped,
)
from imucal.errors import Fix
from imucal.fitting import METHODS
from imucal.grading import unit_fix
from imucal.printable import printable_json

if TYPE_CHECKING:
    from imucal.findings import Finding
    from imucal.report.result import Report
    from imucal.sensors import Part


_EPILOG = unwrapped("""
Examples:
  imucal fit log.mcap
  imucal fit s3://bucket/log.mcap --skip 10min
  imucal fit log.csv --gyro-unit deg/s --accel-unit g --model "N + B + K"
  imucal fit drive.mcap --rests
  imucal fit log.mcap --json --no-report -q | jq .summary

Exit codes: 0 done, 2 usage, 3 log not readable, 4 not noise at rest or no
result (with --strict: or a warning), 5 report not writable, 130 interrupted.
""")


#: For a log that was moved.
_CHECK_IT = Fix("check the stream: type 'imucal doctor' in place of 'imucal fit'")


@click.command(cls=Command, epilog=_EPILOG)
@force
@out_option(
    "DIR",
    help="Folder of the report. [default: NAME-imucal]",
)
@flag("--open", "opened", group=OUTPUT, help="Open the page in the browser.")
@flag("--json", "as_json", group=OUTPUT, help="Print report.json on standard output.")
@flag("--no-report", group=OUTPUT, help="Write no files.")
@pictures
@si_units
@log_options
@flag("--rests", group=SAMPLES, help="Use only the times at rest of a drive.")
@model
@option(
    "--method",
    group=MODEL,
    metavar="NAME",
    type=click.Choice(METHODS),
    default="mle",
    show_default=True,
    help="mle (likelihood), gmwm (wavelet moments) or slope.",
)
@level
@option(
    "--sensor",
    "part_name",
    group=MODEL,
    metavar="NAME",
    help="Compare with the data sheet of this part, such as BMI088 (see 'imucal sensor --list').",
)
@option(
    "--jobs",
    group=MODEL,
    metavar="N",
    type=click.IntRange(1),
    help="Axes at a time. [default: number of processors]",
)
def command(
    *,
    request: LogRequest,
    rests: bool,
    model: str,
    method: str,
    level: float,
    part_name: str | None,
    jobs: int | None,
    si: bool,
    out: Path | None,
    no_report: bool,
    formats: tuple[str, ...],
    opened: bool,
    as_json: bool,
) -> None:
    """Fit a noise model to every axis of LOG and write a report.

    LOG is a recording of an IMU at rest: MCAP, ROS 1 or ROS 2 bag, CSV or other text, Parquet, HDF5, MAT,
    NPZ, NPY, ULog, ArduPilot (.bin) or JSON lines; its URL (https, s3, gs, az); or - for text on standard
    input. Several LOGs are joined to one recording if each continues the one before (splits of a bag,
    rotated tables), or with --join.

    The first line is the verdict: good, check first, or not noise (exit code 4). The table lists the noise
    terms of each axis with their intervals. The report is a folder with report.html, report.json and
    pictures.
    """
    from imucal.cli._result_table import summary_table
    from imucal.pipeline import Settings
    from imucal.report.json_file import to_document
    from imucal.report.typed_json import dumps
    from imucal.report.writer import check_folder, write_report

    try:
        reading = request.settings() | ({"rests": True} if rests else {})
        settings = Settings(model=model, method=method, level=level, reading=reading)
    except ValueError as error:
        misuse(error)
    part = _part(part_name)
    folder = out or report_folder(request.logs[0])
    replaced = (folder / "report.json").exists()
    if not no_report:
        check_folder(folder)
    report = request.characterise(settings, workers=jobs, rests=rests, part=part)
    if as_json:
        click.echo(printable_json(dumps(to_document(report))), nl=False)
    else:
        echo(summary_table(report, datasheet=not si, forced=is_set("force"), columns=width()))
        if part is not None:
            _print_ratios(report, part)
    print_findings(_printed_findings(report))
    missing: list[Finding] = []
    if not no_report:
        files = write_report(report, folder, formats=formats, on_finding=missing.append, workers=jobs)
        print_note(_written(folder, [path.name for path in files], replaced=replaced))
        print_findings(missing)
        if opened and (page := folder / "report.html") in files:
            click.launch(str(page))
        if report.verdict.usable:
            print_note(_next_step(report, folder))
    written = "nothing was written" if no_report else f"see {folder}"
    findings = (*report.all_findings, *missing)
    refuse(
        report.verdict,
        findings,
        place=report.source.path,
        consequence=written,
        printed=True,
        if_moved=[_CHECK_IT],
    )


def _part(name: str | None) -> "Part | None":
    if name is None:
        return None
    from imucal.sensors import find_sensor

    return find_sensor(name)


def _print_ratios(report: "Report", part: "Part") -> None:
    """Print a line for each term that the data sheet has."""
    from imucal.sheet_comparison import sheet_ratios

    ratios = sheet_ratios(report, part, forced=is_set("force"))
    if ratios:
        echo("")
    for ratio in ratios:
        for line in wrapped(ratio.text(plain=not can_print("√µ²"))):
            echo(line)


def _next_step(report: "Report", folder: Path) -> str:
    """Return the advice for the next step: give the unit, record for longer, or export."""
    from imucal.report.exports.config_numbers import advice_on_vague, vague_axes

    export = f"imucal export {as_typed(folder)} --to kalibr (or vins, px4, …, all)"
    reading = report.settings.get("reading")
    if fix := unit_fix(report.all_findings, reading if isinstance(reading, Mapping) else {}):
        return f"Next: run again with {option_of(fix)}, because the unit looks wrong"
    if given := [f.axis for f in report.all_findings if f.code == "unit-given"]:
        options = " and ".join(f"--{axis}-unit" for axis in given)
        return f"Next: run again without {options} if the log's own unit is right; if not, {export}"
    if axes := vague_axes(report):
        advice = advice_on_vague(report)
        return f"Next: {advice}; N of {', '.join(axes)} is uncertain by more than a factor of 10"
    return f"Next: {export}"


def _written(folder: Path, names: Sequence[str], *, replaced: bool) -> str:
    """Return ``Wrote still-imucal: report.json, report.html, 8 pictures, 6 JSON files``."""
    first = [name for name in names if name.startswith("report.")]
    data = sum(name.endswith(".json") for name in names if name not in first)
    pictures = len(names) - len(first) - data
    counted = [f"{pictures} pictures"] * (pictures > 0) + [f"{data} JSON files"] * (data > 0)
    return f"{'Replaced the report in' if replaced else 'Wrote'} {folder}: {', '.join([*first, *counted])}"


def _printed_findings(report: "Report") -> Sequence["Finding"]:
    """Return the findings to print; if a log has no numbers, only their cause, without consequences."""
    every = report.all_findings
    if is_set("force") or is_set("verbose") or report.verdict.axes:
        return every
    return report.findings + tuple(
        finding for finding in every[len(report.findings) :] if finding.level == "error"
    )


def report_folder(log: str, what: str = "imucal") -> Path:
    """Return the folder of a log's report: ``<log name>-imucal`` in the current folder."""
    name = name_of_log(log)
    stem = name
    while (suffix := Path(stem).suffix) and suffix.lstrip(".").isalnum() and not suffix[1:].isdigit():
        stem = Path(stem).stem
    return Path(f"{stem or name}-{what}")
