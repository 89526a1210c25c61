"""``imucal drift``: how far dead reckoning drifts after a rest."""

from pathlib import Path

import click

from imucal.cli._printing import FULL, echo, picked, print_json, print_note, refuse, width, wrapped
from imucal.cli._report_input import load_report
from imucal.cli.context import misuse
from imucal.cli.log_request import LogRequest
from imucal.cli.options import (
    OUTPUT,
    PICTURE_FORMATS,
    ReportCommand,
    flag,
    force,
    option,
    out_option,
    report_options,
    unwrapped,
)
from imucal.cli.param_types import DURATION, Text
from imucal.prediction import Drift, drift
from imucal.prediction.drift import STRETCHES
from imucal.prediction.left_out import causes, left_out_of_model
from imucal.report import numbers
from imucal.units import duration
from imucal.user_input import seconds_of

SCHEMA = "imucal/drift/1"


def _times(text: str) -> tuple[float, ...]:
    """Return the times of ``1s,10s,5min`` in s, in increasing order, each once."""
    return tuple(sorted({seconds_of(part) for part in text.split(",")}))


_EPILOG = unwrapped("""
Examples:
  imucal drift still-imucal
  imucal drift still.mcap --rest 30s --times 5s,30s,2min -o drift.png
  imucal drift still-imucal --all-axes --json -q

Exit codes: 0 done, 2 usage, 3 the report or log can't be read, 4 the data
are not noise at rest, 5 the picture can't be written.
""")


@click.command(cls=ReportCommand, epilog=_EPILOG)
@option(
    "--rest",
    metavar="TIME",
    type=DURATION,
    default="60s",
    show_default=True,
    help="Length of the rest in which the bias is averaged.",
)
@option(
    "--times",
    metavar="LIST",
    type=Text("times", _times),
    default="1s,10s,60s,5min",
    show_default=True,
    help="Times without aiding after the rest.",
)
@flag("--all-axes", help="Show every axis instead of each sensor's worst.")
@force
@out_option(
    "FILE",
    help="Also draw a picture to FILE: .png, .svg or .pdf.",
)
@flag("--json", "as_json", group=OUTPUT, help="Print the drift as JSON (SI) on standard output.")
@report_options
def command(
    *,
    rest: float,
    times: tuple[float, ...],
    all_axes: bool,
    out: Path | None,
    as_json: bool,
    request: LogRequest,
) -> None:
    """Predict the drift of dead reckoning after a rest.

    REPORT is a report.json, its folder, or a log, which is characterised first. The bias is averaged
    during the rest; then nothing aids the IMU. Angles drift with the gyroscope's noise. Velocity and
    position drift with the accelerometer's noise and, through tilt, with g times the gyroscope's.
    The table shows one standard deviation with its limits, and the dominant term.
    """
    form = out.suffix.lstrip(".") if out else PICTURE_FORMATS[0]
    if form not in PICTURE_FORMATS:
        misuse(
            f"{out} is not the name of a picture; use one of the endings .{', .'.join(PICTURE_FORMATS)}",
            "-o",
            "--out",
        )
    report = load_report(request)
    refuse(report.verdict, report.all_findings, place=request.logs[0], consequence="nothing was predicted")
    try:
        found = drift(report, times, rest_s=rest, each_axis=all_axes)
    except ValueError as error:
        misuse(error)
    if as_json:
        print_json(to_document(found))
    else:
        echo(_table(found))
    for axis in report.axes:
        if more := left_out_of_model(axis.fit, axis.fit.model.terms):
            ratios = ", ".join(f"{ratio:.2g} x at {time:g} s" for time, ratio in more.ratios)
            print_note(
                f"warning: {axis.name} drifts more than this, because the fit leaves out "
                f"{causes(axis.findings)}: the Allan deviation of the log over that of the model is {ratios}"
            )
    if out:
        from imucal.atomic import replacing
        from imucal.report.figure import render
        from imucal.report.figure_drift import drift_figure

        with replacing(out) as scratch:
            scratch.write_bytes(render(drift_figure(report, found), form, version=report.version))
        print_note(out)


def to_document(found: Drift) -> dict[str, object]:
    """Return a drift as JSON values, SI; null for unknown values."""
    names = "time_s axis value low high term share seen"
    return {
        "schema": SCHEMA,
        **picked(found, "rest_s level vertical"),
        "quantities": [
            {**picked(one, "name unit"), "points": [picked(point, names) for point in one.points]}
            for one in found.quantities
        ],
    }


def _table(found: Drift) -> str:
    text = f"Drift without aiding after a rest of {duration(found.rest_s)}: one standard deviation"
    lines = wrapped(f"{text} [{100 * found.level:.4g} % limits]")
    lines += [f"{found.vertical} is vertical (by the accelerometer)"] if found.vertical else []
    for quantity in found.quantities:
        lines += ["", quantity.name]
        for point in quantity.points:
            value = numbers.with_interval(numbers.drifted(point, quantity.unit), exponent=0)
            # The dominant term of a total contains the axis already.
            makes = [] if " " in point.axis else [f"{point.axis:<8}"]
            makes += [f"{point.term} {100 * point.share:.0f} %"] if point.term else []
            makes += ["extrapolated"] if point.seen is False else []
            row = f"  {duration(point.time_s):<8}{value:<32}"
            text = "  ".join(makes)
            lines += [f"{row}{text}".rstrip()] if width() >= FULL else [row.rstrip(), f"    {text}"]
    if any(point.seen is False for quantity in found.quantities for point in quantity.points):
        few = f"the log is shorter than {STRETCHES} times rest plus time"
        lines += ["", *wrapped(f"extrapolated: {few}; the model is assumed to remain valid")]
    return "\n".join(lines)
