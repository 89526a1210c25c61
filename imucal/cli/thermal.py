"""``imucal thermal``: bias over temperature, from a log at rest in which the IMU heats and cools."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucal.cli._printing import (
    as_typed,
    can_print,
    echo,
    print_findings,
    print_json,
    print_note,
    progress,
    width,
    wrapped,
)
from imucal.cli.context import is_set
from imucal.cli.fit import report_folder
from imucal.cli.log_request import LogRequest
from imucal.cli.options import OUTPUT, Command, context_flag, flag, log_options, out_option, unwrapped
from imucal.errors import DataError, Fix

if TYPE_CHECKING:
    from imucal.temperature.result import Thermal

_EPILOG = unwrapped("""
Examples:
  imucal thermal ramp.ulg -o thermal
  imucal thermal chamber.csv --time-unit us
  imucal thermal ramp.mcap --json -q | jq .axes
  imucal export thermal --to px4

Exit codes: 0 done, 2 usage, 3 the log can't be read, 4 it shows no bias over
temperature (with --strict: or a warning was found), 5 the result can't be
written.
""")


@click.command(cls=Command, epilog=_EPILOG)
@context_flag("--force", help="Write the result even if a finding is an error.")
@out_option("DIR", help="Write the result to DIR. [default: NAME-thermal]")
@flag("--json", "as_json", group=OUTPUT, help="Print thermal.json on standard output.")
@flag("--no-html", group=OUTPUT, help="Do not write the HTML page and the pictures.")
@flag("--no-files", group=OUTPUT, help="Do not write any files.")
@log_options
def command(*, request: LogRequest, out: Path | None, as_json: bool, no_html: bool, no_files: bool) -> None:
    """Find the bias of every axis over the temperature.

    Fix the IMU, log it at rest while it heats and cools over its whole range, and log its temperature with
    it: in the IMU's messages, a topic of sensor_msgs/Temperature, or a column. The curve may follow the
    temperature with a lag. Halves of the heating and of the cooling that the curve has not seen show the
    error that remains. The folder contains thermal.json, thermal.html and a picture of each sensor.
    """
    from imucal.temperature import thermal
    from imucal.temperature.document import to_document
    from imucal.temperature.writer import check_folder

    folder = out or report_folder(request.logs[0], "thermal")
    if not no_files:
        check_folder(folder)
    recording = request.read()
    with progress("fitting"):
        found = thermal(recording)
    if as_json:
        print_json(to_document(found))
    else:
        _print_table(found)
    print_findings(found.findings)
    if not no_files and (found.verdict != "not-usable" or is_set("force")):
        _write_folder(found, folder, html=not no_html)
    _end(found)


def _print_table(found: "Thermal") -> None:
    from imucal.temperature.table import headline, sentence, table

    lines = [*wrapped(headline(found)), *wrapped(sentence(found)), "", table(found, width()), ""]
    text = "\n".join(lines)
    echo(text if can_print(text) else text.replace("→", "->").replace("°", "deg "))


def _write_folder(found: "Thermal", folder: Path, *, html: bool) -> None:
    from imucal.temperature.writer import write_thermal

    files = write_thermal(found, folder, html=html)
    names = [path.name for path in files if path.suffix != ".png"]
    names += [f"{len(files) - len(names)} pictures"] if len(files) > len(names) else []
    print_note(f"Wrote {folder}: {', '.join(names)}")
    print_note(f"Next: imucal export {as_typed(folder)} --to px4 (or ardupilot, c, python, …)")


def _end(found: "Thermal") -> None:
    """End with exit code 4 if the result is not usable, or if --strict forbids a warning."""
    codes = list(dict.fromkeys(each.code for each in found.findings if each.level != "info"))
    place = found.source.path
    if found.verdict == "not-usable" and not is_set("force"):
        fix = Fix("record again, or use --force")
        error = DataError(f"{', '.join(codes)} found; nothing was written", place=place, fix=fix)
    elif codes and is_set("strict"):
        error = DataError(f"{', '.join(codes)} found; --strict allows no warning", place=place)
    else:
        return
    error.printed = True
    raise error
