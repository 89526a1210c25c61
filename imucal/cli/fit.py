"""``imucal fit``: fit a noise model and write the report."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucal.cli._declared import declared, flag, is_set, misuse, option, together
from imucal.cli._printing import as_typed, echo, name_of_log, print_findings, print_note, refuse, width
from imucal.cli.parameters import DATASHEET, FORCE, LEVEL, LOG, PATH, PICTURES, STRUCTURE, TAU_SET, LogRequest
from imucal.fitting import CRITERIA, METHODS, WEIGHTS
from imucal.fitting.settings import MAX_SEGMENTS
from imucal.grading import remedy, unit_option
from imucal.printable import printable_json

if TYPE_CHECKING:
    from imucal.findings import Finding
    from imucal.report.result import Report


@declared
def command(
    *,
    request: LogRequest = LOG,
    out: Path | None = option("-o --out DIR  Write the report to DIR. [default: NAME-imucal]", PATH),
    rests: bool = flag("--rests  Fit all rests of a drive together."),
    choices: dict[str, Any] = together(
        dict,
        {
            "model": option(
                '--model TEXT=auto  Fit these terms, such as "N + B + K" or "N + 2*GM".', STRUCTURE
            ),
            "method": option(
                "--method=mle  Estimator: likelihood, wavelet moments or slopes.", click.Choice(METHODS)
            ),
            "level": option("--level P=0.95  Confidence level of every interval.", LEVEL),
            "criterion": option(
                "--criterion --ic=chance  Criterion for choosing the model.", click.Choice(CRITERIA)
            ),
            "weights": option("--weights=full  Weights of the gmwm fit.", click.Choice(WEIGHTS)),
            "segments": option(
                "--segments N=8  Compare the noise of N parts of the log; 1 disables this.",
                click.IntRange(1, MAX_SEGMENTS),
            ),
            "second_opinion": flag("--second-opinion  Also compare with a fit of the Allan curve."),
            "taus": option("--taus SET=octave  Averaging times: octave, decade, decade:20 or all.", TAU_SET),
            "edf": option(
                "--edf=hybrid  Method for the degrees of freedom of the intervals.",
                click.Choice(["hybrid", "model", "greenhall"]),
            ),
        },
    ),
    no_clean: bool = flag("--no-clean  Keep spikes instead of leaving them out."),
    datasheet: bool = DATASHEET,
    formats: tuple[str, ...] = PICTURES,
    figure: str = option(
        "--figure=report  paper: also draw curves for one column of a paper (NAME-paper.pdf; SVG with "
        "--format svg).",
        click.Choice(["report", "paper"]),
    ),
    no_html: bool = flag("--no-html  Do not write the HTML page."),
    opened: bool = flag("--open  Open the page in the browser."),
    no_report: bool = flag("--no-report  Do not write any files."),
    jobs: int | None = option(
        "--jobs N  Number of axes to fit in parallel. [default: number of processors]",
        click.IntRange(1),
    ),
    bins: bool = flag("--bins  Add binned spectra to report.json, for pooling logs."),
    as_json: bool = flag("--json  Print report.json on standard output."),
    _force: bool = FORCE,
) -> None:
    """Fit a noise model to every axis of LOG and write a report.

    LOG is a CSV or other text, MCAP, ROS 1 bag, ROS 2 bag (file or folder), Parquet, NPZ, NPY,
    MAT, HDF5, JSON lines, ULog or ArduPilot (.bin) file, its URL (https://, s3://,
    gs://, az://), or - for text on standard input. Several LOGs are joined to one recording if
    each continues the one before (splits of a bag, rotated tables), or with --join.

    The table on standard output lists the noise terms of each axis with their intervals. The
    report folder contains report.json, report.html and the pictures. Table and report begin with a
    verdict: good, look first or not noise. With not noise, the exit code is 4.

    Examples::
      imucal fit log.mcap
      imucal fit s3://bucket/log.mcap
      imucal fit log.bag --topic /imu/data_raw --skip 10min -o report
      imucal fit log.csv --gyro-unit deg/s --accel-unit g --model "N + B + K"
      imucal fit drive.mcap --rests
      imucal fit log.mcap --json --no-report -q | jq '.axes[].fit.terms.N'

    Exit codes: 0 done, 2 usage, 3 the log can't be read, 4 the data can't be
    analysed or are not noise at rest (with --strict: or a warning was found),
    5 the report can't be written, 130 interrupted.
    """
    from imucal.cli._result_table import summary_table
    from imucal.pipeline import Settings
    from imucal.report.json_file import to_document
    from imucal.report.json_node import dumps
    from imucal.report.writer import check_folder, write_report

    try:
        reading = request.settings() | ({"rests": True} if rests else {})
        settings = Settings(clean=not no_clean, bins=bins, reading=reading, **choices)
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
    if option := unit_option(report.all_findings, reading if isinstance(reading, Mapping) else {}):
        return f"Next: run again with {option}, because the unit looks wrong"
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
