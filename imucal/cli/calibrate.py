"""``imucal calibrate``: bias, scale, misalignment and g-sensitivity from a log of rests and turns."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucal.cli._printing import (
    as_typed,
    can_print,
    echo,
    print_findings,
    print_note,
    progress,
    width,
    wrapped,
)
from imucal.cli._report_input import read_report
from imucal.cli.context import is_set, misuse
from imucal.cli.fit import report_folder
from imucal.cli.log_request import LogRequest
from imucal.cli.options import OUTPUT, Command, context_flag, flag, log_options, option, out_option, unwrapped
from imucal.cli.param_types import ANGLE, DURATION, PATH, Number
from imucal.cli.simulate import log_to_write
from imucal.errors import ChoiceError, DataError, Fix, ImucalError
from imucal.grading import refusal
from imucal.printable import printable_json
from imucal.recording import AXES, Sensor

if TYPE_CHECKING:
    from imucal.calibration import Calibration
    from imucal.recording import Recording
    from imucal.report.result import Report


_EPILOG = unwrapped("""
Examples:
  imucal calibrate poses.mcap --noise still-imucal --latitude 47.4
  imucal calibrate poses.csv --gravity 9.8072 -o calibration
  imucal calibrate poses.bag --apply corrected.mcap
  imucal calibrate table.mcap --turns 360deg
  imucal export calibration --to openvins -o imu.yaml

Exit codes: 0 done, 2 usage, 3 the log can't be read, 4 it can't be calibrated
(with --strict: or a warning was found), 5 the result can't be written.
""")


@click.command(cls=Command, epilog=_EPILOG)
@option(
    "--noise",
    metavar="REPORT",
    type=PATH,
    help="Noise report of a long log at rest: report.json or its folder.",
)
@option("--latitude", metavar="DEG", type=Number(-90, 90), help="Latitude of the place, to compute gravity.")
@option("--height", metavar="M", type=Number(-500, 9000), help="Height above sea level, in m.")
@option("--gravity", metavar="G", type=Number(9.7, 9.9), help="Gravity in m/s^2, if known.")
@option(
    "--rest-at-least",
    metavar="TIME",
    type=DURATION,
    default="1s",
    show_default=True,
    help="Minimum length of a rest.",
)
@flag("--in-hand", help="Accept a hand-held IMU as at rest.")
@option(
    "--frame",
    type=click.Choice(["kalibr", "imu-tk", "nearest"]),
    default="kalibr",
    show_default=True,
    help="Axes of the result: x along the accelerometer's x axis (kalibr), z along its z axis (imu-tk), or "
    "nearest to all three.",
)
@option(
    "--turns",
    metavar="ANGLE",
    type=ANGLE,
    help="Angle of turns on a table, such as 360deg or 360deg+-0.1deg.",
)
@flag("--no-gyro", help="Calibrate the accelerometer only.")
@option(
    "--apply",
    "apply_to",
    metavar="FILE",
    type=PATH,
    callback=log_to_write,
    help="Also write the corrected log: .csv, .mcap or .bag.",
)
@context_flag("--force", help="Write the result even if a finding is an error.")
@out_option(
    "DIR",
    help="Write the result to DIR. [default: NAME-calibration]",
)
@flag("--json", "as_json", group=OUTPUT, help="Print calibration.json on standard output.")
@flag("--open", "opened", group=OUTPUT, help="Open the page in the browser.")
@flag("--no-html", group=OUTPUT, help="Do not write the HTML page and the pictures.")
@flag("--no-files", group=OUTPUT, help="Do not write any files.")
@log_options
def command(
    *,
    request: LogRequest,
    noise: Path | None,
    latitude: float | None,
    height: float | None,
    gravity: float | None,
    rest_at_least: float,
    in_hand: bool,
    frame: str,
    turns: str | None,
    no_gyro: bool,
    out: Path | None,
    apply_to: Path | None,
    no_files: bool,
    no_html: bool,
    opened: bool,
    as_json: bool,
) -> None:
    """Calibrate an IMU from a log of rests in many attitudes.

    Put the IMU down, leave it alone for 5 s, turn it and put it down again: each face once, then
    six edges; about two minutes in all. Gravity is the reference: no turntable and no levelled
    surface are needed. The table shows scale error, misalignment, bias and g-sensitivity with
    95 % intervals. The folder contains calibration.json, calibration.html and three pictures.
    Raw counts are welcome: --accel-unit count --gyro-unit count.
    """
    from imucal.calibration import calibrate
    from imucal.calibration.applying import apply
    from imucal.calibration.document import to_document
    from imucal.calibration.writer import check_folder
    from imucal.report.typed_json import dumps

    if turns and no_gyro:
        misuse("turns of a known angle calibrate the gyroscope; omit one of them", "--turns", "--no-gyro")
    folder = out or report_folder(request.logs[0], "calibration")
    if not no_files:
        check_folder(folder)
    report = _noise_report(noise) if noise else None
    recording = _read(request)
    with progress("calibrating"):
        found = calibrate(
            recording, report, latitude, height, gravity,
            rest_at_least=rest_at_least, in_hand=in_hand, gyro=not no_gyro, frame=frame,
            turns=turns,
        )  # fmt: skip
    if as_json:
        click.echo(printable_json(dumps(to_document(found))), nl=False)
    else:
        _print_table(found)
    print_findings(found.findings)
    if found.verdict != "not-usable" or is_set("force"):
        if not no_files:
            _write_folder(found, folder, report, html=not no_html, opened=opened)
        if apply_to:
            _write_corrected(apply(found, recording), apply_to)
    _end(found.verdict, recording.source.path, [f.code for f in found.findings if f.level != "info"])


def _read(request: LogRequest) -> "Recording":
    """Read the log; if a unit is unknown, the error names the option for raw counts."""
    try:
        return request.read()
    except ChoiceError as error:
        raise _with_counts(error) from error


def _with_counts(error: ImucalError) -> ImucalError:
    units = {f"{sensor.short}_unit" for sensor in Sensor}
    asked = [fix.argument for fix in error.fixes if fix.argument in units]
    counts = [Fix("give the unit count for raw counts", argument, "count") for argument in asked]
    other = error.with_fixes(*counts)
    other.also = tuple(map(_with_counts, other.also))
    return other


def _noise_report(path: Path) -> "Report":
    """Load the report of the noise; refuse data that are not noise at rest, unless forced."""
    report = read_report(path)
    if not (report.verdict.usable or is_set("force")):
        raise refusal(report.verdict, report.all_findings, place=path, consequence="nothing was calibrated")
    return report


def _print_table(found: "Calibration") -> None:
    from imucal.calibration.table import headline, remarks, table

    lines = [*wrapped(headline(found)), "", table(found, width()), ""]
    text = "\n".join([*lines, *(line for remark in remarks(found) for line in wrapped(remark))])
    echo(text if can_print(text) else text.replace("±", "+-").replace("²", "^2").replace("°", " deg"))


def _write_folder(
    found: "Calibration", folder: Path, noise: "Report | None", *, html: bool, opened: bool
) -> None:
    from imucal.calibration.writer import PAGE_NAME, write_calibration

    files = write_calibration(found, folder, noise=noise, html=html)
    names = [path.name for path in files if path.suffix != ".png"]
    names += [f"{len(files) - len(names)} pictures"] * html
    print_note(f"Wrote {folder}: {', '.join(names)}")
    print_note(f"Next: imucal export {as_typed(folder)} --to kalibr (or openvins, px4, python, …)")
    if opened and html:
        click.launch(str(folder / PAGE_NAME))


def _write_corrected(corrected: "Recording", path: Path) -> None:
    from imucal.simulation import write_log

    clocks = {(series.clock.segments, series.clock.start_ns, series.rate_hz) for series in corrected.series}
    if len(corrected.series) != len(Sensor) * len(AXES) or len(clocks) != 1:
        msg = (
            "expected a gyroscope and an accelerometer with the same time stamps; apply the "
            "calibration to the log: imucal apply"
        )
        raise DataError(msg, place=path)
    write_log(corrected, path)
    print_note(f"Wrote {path}: the corrected log")


def _end(verdict: str, where: str, codes: list[str]) -> None:
    """End with exit code 4 if the result is not usable, or if --strict forbids a warning."""
    listed = ", ".join(dict.fromkeys(codes))
    if verdict == "not-usable" and not is_set("force"):
        fix = Fix("try --no-gyro for the accelerometer alone, or --force")
        error = DataError(f"{listed} found; nothing was written", place=where, fix=fix)
    elif codes and is_set("strict"):
        error = DataError(f"{listed} found; --strict allows no warning", place=where)
    else:
        return
    error.printed = True
    raise error
