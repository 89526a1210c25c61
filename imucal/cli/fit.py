"""``imucal fit``: fit a noise model and write the report."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucal.cli._fixes import option_of
from imucal.cli._printing import as_typed, echo, name_of_log, print_findings, print_note, refuse, width
from imucal.cli.context import is_set, misuse
from imucal.cli.log_request import LogRequest
from imucal.cli.options import (
    ADVANCED,
    MODEL,
    OUTPUT,
    SAMPLES,
    Command,
    datasheet,
    flag,
    force,
    level,
    log_options,
    model,
    no_clean,
    option,
    pictures,
    unwrapped,
)
from imucal.cli.param_types import PATH, TAU_SET
from imucal.fitting import CRITERIA, METHODS, WEIGHTS
from imucal.fitting.settings import MAX_SEGMENTS
from imucal.grading import remedy, unit_fix
from imucal.printable import printable_json

if TYPE_CHECKING:
    from imucal.findings import Finding
    from imucal.report.result import Report


_EPILOG = unwrapped("""
Examples:
  imucal fit log.mcap
  imucal fit s3://bucket/log.mcap
  imucal fit log.bag --topic /imu/data_raw --skip 10min -o report
  imucal fit log.csv --gyro-unit deg/s --accel-unit g --model "N + B + K"
  imucal fit drive.mcap --rests
  imucal fit log.mcap --json --no-report -q | jq '.axes[].fit.terms.N'

Exit codes: 0 done, 2 usage, 3 the log can't be read, 4 the data can't be
analysed or are not noise at rest (with --strict: or a warning was found),
5 the report can't be written, 130 interrupted.
""")


@click.command(cls=Command, epilog=_EPILOG)
@option(
    "--jobs",
    metavar="N",
    type=click.IntRange(1),
    help="Number of axes to fit in parallel. [default: number of processors]",
)
@force
@option(
    "-o",
    "--out",
    group=OUTPUT,
    metavar="DIR",
    type=PATH,
    help="Write the report to DIR. [default: NAME-imucal]",
)
@flag("--json", "as_json", group=OUTPUT, help="Print report.json on standard output.")
@flag("--open", "opened", group=OUTPUT, help="Open the page in the browser.")
@pictures
@option(
    "--figure",
    group=OUTPUT,
    type=click.Choice(["report", "paper"]),
    default="report",
    show_default=True,
    help="paper: also draw curves for one column of a paper (NAME-paper.pdf; SVG with --format svg).",
)
@flag("--no-html", group=OUTPUT, help="Do not write the HTML page.")
@flag("--no-report", group=OUTPUT, help="Do not write any files.")
@datasheet
@log_options
@flag("--rests", group=SAMPLES, help="Fit all rests of a drive together.")
@model
@level
@option(
    "--method",
    group=MODEL,
    type=click.Choice(METHODS),
    default="mle",
    show_default=True,
    help="Estimator: likelihood, wavelet moments or slopes.",
)
@option(
    "--taus",
    group=ADVANCED,
    metavar="SET",
    type=TAU_SET,
    default="octave",
    show_default=True,
    help="Averaging times: octave, decade, decade:20 or all.",
)
@option(
    "--edf",
    group=ADVANCED,
    type=click.Choice(["hybrid", "model", "greenhall"]),
    default="hybrid",
    show_default=True,
    help="Method for the degrees of freedom of the intervals.",
)
@no_clean
@option(
    "--criterion",
    "--ic",
    "criterion",
    group=ADVANCED,
    type=click.Choice(CRITERIA),
    default="chance",
    show_default=True,
    help="Criterion for choosing the model.",
)
@option(
    "--weights",
    group=ADVANCED,
    type=click.Choice(WEIGHTS),
    default="full",
    show_default=True,
    help="Weights of the gmwm fit.",
)
@option(
    "--segments",
    group=ADVANCED,
    metavar="N",
    type=click.IntRange(1, MAX_SEGMENTS),
    default=8,
    show_default=True,
    help="Compare the noise of N parts of the log; 1 disables this.",
)
@flag("--second-opinion", group=ADVANCED, help="Also compare with a fit of the Allan curve.")
@flag("--bins", group=ADVANCED, help="Add binned spectra to report.json, for pooling logs.")
def command(
    *,
    request: LogRequest,
    rests: bool,
    model: str,
    method: str,
    level: float,
    criterion: str,
    weights: str,
    segments: int,
    second_opinion: bool,
    taus: str,
    edf: str,
    no_clean: bool,
    bins: bool,
    jobs: int | None,
    datasheet: bool,
    out: Path | None,
    no_report: bool,
    formats: tuple[str, ...],
    figure: str,
    no_html: bool,
    opened: bool,
    as_json: bool,
) -> None:
    """Fit a noise model to every axis of LOG and write a report.

    LOG is a CSV or other text, MCAP, ROS 1 bag, ROS 2 bag (file or folder), Parquet, NPZ, NPY,
    MAT, HDF5, JSON lines, ULog or ArduPilot (.bin) file, its URL (https://, s3://,
    gs://, az://), or - for text on standard input. Several LOGs are joined to one recording if
    each continues the one before (splits of a bag, rotated tables), or with --join.

    The table on standard output lists the noise terms of each axis with their intervals. The
    report folder contains report.json, report.html and the pictures. Table and report begin with a
    verdict: good, look first or not noise. With not noise, the exit code is 4.
    """
    from imucal.cli._result_table import summary_table
    from imucal.pipeline import Settings
    from imucal.report.json_file import to_document
    from imucal.report.json_node import dumps
    from imucal.report.writer import check_folder, write_report

    try:
        reading = request.settings() | ({"rests": True} if rests else {})
        settings = Settings(
            model=model,
            method=method,
            level=level,
            criterion=criterion,
            weights=weights,
            segments=segments,
            second_opinion=second_opinion,
            taus=taus,
            edf=edf,
            clean=not no_clean,
            bins=bins,
            reading=reading,
        )
    except ValueError as error:
        misuse(error)
    folder = out or report_folder(request.logs[0])
    replaced = (folder / "report.json").exists()
    if not no_report:
        check_folder(folder)
    report = request.characterise(settings, workers=jobs, rests=rests)
    if as_json:
        click.echo(printable_json(dumps(to_document(report))), nl=False)
    else:
        echo(summary_table(report, datasheet=datasheet, forced=is_set("force"), columns=width()))
    print_findings(_printed_findings(report))
    missing: list[Finding] = []
    if not no_report:
        files = write_report(
            report, folder, formats=formats, html=not no_html, paper=figure == "paper",
            on_finding=missing.append, workers=jobs,
        )  # fmt: skip
        print_note(_written(folder, [path.name for path in files], replaced=replaced))
        print_findings(missing)
        if opened and (page := folder / "report.html") in files:
            click.launch(str(page))
        if report.verdict.usable:
            print_note(_next_step(report, folder))
    written = "nothing was written" if no_report else f"see {folder}"
    where = report.source.path
    findings = (*report.all_findings, *missing)
    refuse(report.verdict, where, written, findings=findings, remedy=remedy(findings), printed=True)


def _next_step(report: "Report", folder: Path) -> str:
    """Return the advice for the next step: give the unit, record for longer, or export."""
    from imucal.report.exports.config_numbers import vague_axes

    export = f"imucal export {as_typed(folder)} --to kalibr (or vins, px4, …, all)"
    reading = report.settings.get("reading")
    if fix := unit_fix(report.all_findings, reading if isinstance(reading, Mapping) else {}):
        return f"Next: run again with {option_of(fix)}, because the unit looks wrong"
    if given := [f.axis for f in report.all_findings if f.code == "unit-given"]:
        options = " and ".join(f"--{axis}-unit" for axis in given)
        return f"Next: run again without {options} if the log's own unit is right; if not, {export}"
    if axes := vague_axes(report):
        return f"Next: record for longer; N of {', '.join(axes)} is uncertain by more than a factor of 10"
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
