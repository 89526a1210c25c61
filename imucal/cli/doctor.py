"""``imucal doctor``: whether a stream is fit for a filter."""

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucal.cli._fixes import option_of
from imucal.cli._printing import print_json, print_note, width
from imucal.cli._verdicts import print_annotations, verdict_options, write_junit
from imucal.cli.context import is_set
from imucal.cli.log_request import LogRequest
from imucal.cli.options import Command, log_options, option, out_option, unwrapped
from imucal.errors import DataError
from imucal.printable import printable

if TYPE_CHECKING:
    from imucal.health.diagnosis import Diagnosis, Row, Status

_EPILOG = unwrapped("""
Examples:
  imucal doctor drive.mcap
  imucal doctor drive.bag --topic /imu --expect z-up
  imucal doctor drive.mcap -o drive-doctor
  imucal doctor flight.ulg --json -q | jq .status
  imucal doctor drive.mcap --junit doctor.xml --github

Exit codes: 0 no row failed, 1 a row failed, 2 usage, 3 the log can't be
read, 4 the data can't be analysed (with --strict: or a row warned), 5 the
result can't be written.
""")

_COLOURS: "dict[Status, str]" = {"pass": "green", "warn": "yellow", "fail": "red", "unknown": "cyan"}
#: The word of a row; "unknown" means that the log can't tell.
_WORDS: "dict[Status, str]" = {"pass": "pass", "warn": "warn", "fail": "fail", "unknown": "?"}
#: Columns of the word.
_START = 6


@click.command(cls=Command, epilog=_EPILOG)
@option(
    "--expect",
    metavar="AXIS",
    help="The axis that points up or down at the start, such as z-up, x-down.",
)
@out_option("DIR", help="Write doctor.json, a page and pictures to DIR.")
@verdict_options
@log_options
def command(
    *,
    request: LogRequest,
    expect: str | None,
    out: Path | None,
    as_json: bool,
    junit: Path | None,
    github: bool,
) -> None:
    """Check that a stream of IMU samples is fit for a filter.

    LOG may move: drive, flight or hand. Each row answers one question about rate, stamps, units, gravity,
    axes and signs, delay, range, samples, vibration and temperature: pass, warn, fail, or ? if this log
    can't tell, with how to record one that does. Axes, signs and delay need turns between short rests.
    With -o, doctor.html shows a picture of each row that failed or warned.
    """
    from imucal.health import diagnose
    from imucal.health.document import cases_of, to_document
    from imucal.health.writer import check_folder

    if out is not None:
        check_folder(out)
    recording = request.read()
    found = diagnose(recording, expect=expect)
    if junit is not None:
        write_junit(junit, cases_of(found), command="imucal doctor", source=found.source.path)
    if as_json:
        print_json(to_document(found))
    else:
        click.echo("\n".join(_table(found)))
    if out is not None:
        _write_folder(found, out)
    if github:
        print_annotations(cases_of(found), err=as_json)
    if found.status == "fail":
        click.get_current_context().exit(1)
    if found.status == "warn" and is_set("strict"):
        names = ", ".join(row.name for row in found.rows if row.status == "warn")
        error = DataError(f"{names}: --strict allows no warning", place=found.source.path)
        error.printed = True
        raise error


def _write_folder(found: "Diagnosis", out: Path) -> None:
    from imucal.health.writer import write_diagnosis

    files = write_diagnosis(found, out, option_of=option_of)
    names = [path.name for path in files if path.suffix != ".png"]
    count = len(files) - len(names)
    names += [f"{count} picture{'s' if count > 1 else ''}"] if count else []
    print_note(f"Wrote {out}: {', '.join(names)}")


def _table(found: "Diagnosis") -> list[str]:
    """Return the verdict and the rows as lines that fit the terminal."""
    verdict, *more = textwrap.wrap(found.sentence, width())
    lines = [click.style(verdict, fg=_COLOURS[found.status], bold=True), *more]
    for row in found.rows:
        lines += _lines(row)
    return lines


def _lines(row: "Row") -> list[str]:
    word = click.style(f"{_WORDS[row.status]:<{_START}}", fg=_COLOURS[row.status])
    text = f"{row.name}: {row.text}"
    # Options such as --gyro-unit stay whole.
    first, *rest = textwrap.wrap(printable(text), width() - _START, break_on_hyphens=False)
    return [f"{word}{first}", *(" " * _START + line for line in rest)]
