"""``imucal export``: the config files of downstream filters and simulators."""

import math
import os
import textwrap
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import get_args

import click
from click.shell_completion import CompletionItem

from imucal.atomic import write_configs
from imucal.calibration.document import load_intrinsics
from imucal.calibration.exports import CALIBRATION_TARGETS, find_calibration_target, render_calibration
from imucal.calibration.writer import NOISE_NAME, is_calibration
from imucal.cli._fleet import is_fleet, read_fleet
from imucal.cli._printing import echo, print_note
from imucal.cli._report_input import load_report, part_report
from imucal.cli.context import is_set, misuse
from imucal.cli.log_request import LogRequest
from imucal.cli.options import (
    NUMBERS,
    OUTPUT,
    ReportCommand,
    flag,
    fleet_model,
    force,
    option,
    report_options,
    unwrapped,
)
from imucal.cli.param_types import DURATION, Text
from imucal.errors import DataError
from imucal.grading import FORCE
from imucal.prediction.filter_numbers import STEP_S
from imucal.prediction.left_out import causes
from imucal.recording import Sensor
from imucal.remote.addresses import shown as shown_address
from imucal.report import exports
from imucal.report.exports.config_numbers import INFLATABLE, AxisPolicy, Basis
from imucal.report.exports.target import name_key
from imucal.report.given import FROM_SHEET
from imucal.report.json_file import load
from imucal.report.result import Report
from imucal.temperature.document import load_thermal
from imucal.temperature.exports import THERMAL_TARGETS, find_thermal_target, render_thermal
from imucal.temperature.writer import is_thermal

_FOLDER = Path("imucal-exports")


_TITLES = {target.name: target.title for target in exports.TARGETS.values()}


def _target_name(text: str) -> str:
    """Return the name as typed; an ArgumentError if it is neither a downstream format nor all."""
    others = {*map(name_key, CALIBRATION_TARGETS), *map(name_key, THERMAL_TARGETS)}
    if text != "all" and name_key(text) not in others:
        exports.find_target(text, others=["all"])
    return text


def _complete_target(_: click.Context, __: click.Parameter, incomplete: str) -> list[CompletionItem]:
    titles = {**_TITLES, "all": "each of them"}
    return [CompletionItem(name, help=title) for name, title in titles.items() if name.startswith(incomplete)]


def _factors(text: str) -> dict[str, float]:
    """Return the factors of ``white=2,walk=10``."""
    factors: dict[str, float] = {}
    for part in text.split(","):
        name, _, number = (piece.strip() for piece in part.partition("="))
        try:
            factors[name] = float(number)
        except ValueError:
            factors[name] = 0.0
        if name not in INFLATABLE or not 0 < factors[name] < math.inf:
            names = ", ".join(INFLATABLE)
            raise ValueError(f"{part!r} is not a factor of {names}; write such as white=2,walk=10")
    return factors


#: Width of a family's title in the list of formats.
_TITLE_WIDTH = 14
#: Width of a line of the list of formats.
_LIST_WIDTH = 76


def _format_line(title: str, names: Iterable[str]) -> str:
    """Return the names of a family's formats in a column next to its title."""
    return textwrap.fill(
        ", ".join(names),
        _LIST_WIDTH,
        initial_indent=f"  {title:<{_TITLE_WIDTH}}",
        subsequent_indent=" " * (2 + _TITLE_WIDTH),
        break_on_hyphens=False,
    )


_LISTED = "\n".join(
    _format_line(title, (target.name for target in family)) for title, family in exports.FAMILIES.items()
)
_FORMATS = unwrapped(f"""
Formats:
{_LISTED}
{_format_line("Calibration", CALIBRATION_TARGETS)}
{_format_line("Temperature", THERMAL_TARGETS)}
""")
_EPILOG = unwrapped("""
Examples:
  imucal export still-imucal --to kalibr -o imu.yaml
  imucal export still-imucal --to all -o configs
  imucal export still-imucal --to openvins --inflate white=5,walk=10
  imucal export still-imucal --to px4 --coast 10min
  imucal export fleet --to kalibr
  imucal export --sensor ADIS16448 --rate 200 --to kalibr
  imucal export poses-calibration --to openvins -o imu.yaml

Exit codes: 0 done, 2 usage, 3 report not readable, 4 not noise at rest or a
number is missing, 5 file not writable.
""")


@click.command(cls=ReportCommand, epilog=f"{_FORMATS}\n\n{_EPILOG}")
@option(
    "--to",
    "targets",
    metavar="NAME",
    type=Text("target", _target_name),
    shell_complete=_complete_target,
    multiple=True,
    required=True,
    help="Format (see below), or all; may be repeated.",
)
@force
@option(
    "-o",
    "--out",
    group=OUTPUT,
    metavar="PATH",
    type=click.Path(allow_dash=True),
    help="File or folder (a name that ends with / is a folder), or - for standard output. "
    f"[default: the format's usual name; for several formats the folder {_FOLDER}]",
)
@option("--rostopic", group=OUTPUT, metavar="NAME", help="IMU topic in the file. [default: the log's]")
@option(
    "--axis",
    "axis_policy",
    group=NUMBERS,
    metavar="NAME",
    type=click.Choice(get_args(AxisPolicy)),
    default="worst",
    show_default=True,
    help="One number for three axes: worst, rms, x, y or z.",
)
@flag(
    "--as-fitted",
    group=NUMBERS,
    help="Write N and K of the fit. By default they are larger, so that a filter that knows only these two "
    "is not overconfident.",
)
@option(
    "--coast",
    "coast_s",
    group=NUMBERS,
    metavar="TIME",
    type=DURATION,
    help="Longest time without camera, lidar or GNSS. [default: by format, 1 or 5 min]",
)
@option(
    "--inflate",
    group=NUMBERS,
    metavar="FACTORS",
    type=Text("inflation", _factors),
    default={},
    help="Multiply white (N), walk (K) or flicker (B, GM), such as white=2,walk=10.",
)
@flag("--median", group=NUMBERS, help="Of a fleet: the median unit instead of the bound for every unit.")
@fleet_model(group=NUMBERS, or_part="Without REPORT: the figures of this part's data sheet, such as BMI088.")
@report_options
def command(
    *,
    targets: tuple[str, ...],
    out: str | None,
    axis_policy: AxisPolicy,
    as_fitted: bool,
    coast_s: float | None,
    inflate: dict[str, float],
    median: bool,
    fleet_model: str | None,
    rostopic: str | None,
    request: LogRequest,
) -> None:
    """Write the config file of a filter or simulator.

    REPORT is the folder of 'imucal fit', 'imucal calibrate', 'imucal thermal' or 'imucal fleet', a
    report.json, or a log, which is fitted first. Comments in the file name each number's formula, unit, axis
    and interval.
    """
    if coast_s is not None and coast_s <= STEP_S:
        misuse(f"{coast_s:g} s is not longer than {STEP_S:g} s, the time between two updates", "--coast")
    chosen = exports.ExportOptions(
        axis_policy=axis_policy,
        inflate=inflate,
        numbers="as-fitted" if as_fitted else "covered",
        horizon_s=coast_s,
        topic=rostopic,
    )
    path = Path(request.logs[0] if request.logs else "")
    if request.logs and is_calibration(path):
        _export_calibration(path, targets, out, chosen)
        return
    if request.logs and is_thermal(path):
        _export_thermal(path, targets, out)
        return
    source = request.logs[0] if request.logs else fleet_model or ""
    _require_noise_targets(targets, shown_address(source))
    report = _report(request, fleet_model, median=median)
    if not is_set("force"):
        exports.refuse_unsound(report, place=source)
    names = tuple(exports.TARGETS) if "all" in targets else _names(targets)
    texts = {exports.TARGETS[name].file_name: exports.render(report, name, chosen) for name in names}
    _write(texts, out, several=len(names) > 1)
    for text in (*_remarks(report, chosen.numbers), *_left_out(report, names, chosen)):
        print_note(text)


def _write(texts: dict[str, str], out: str | None, *, several: bool) -> None:
    if out == "-":
        if several:
            misuse("standard output takes one format; name a folder", "-o")
        click.echo(next(iter(texts.values())), nl=False)
        return
    path = Path(out) if out else (_FOLDER if several else Path())
    # A path without its last slash is the same path.
    named_folder = out is not None and out.endswith(("/", os.sep))
    for file in write_configs(texts, path, folder=several or named_folder):
        echo(str(file))


def _export_calibration(
    path: Path, names: tuple[str, ...], out: str | None, options: exports.ExportOptions
) -> None:
    """Write the files of a calibration; with ``all``, list the formats without a calibration."""
    found, every = load_intrinsics(path), "all" in names
    folder = path if path.is_dir() else path.parent
    noise = load(folder / NOISE_NAME) if (folder / NOISE_NAME).exists() else None
    try:
        targets = [find_calibration_target(name) for name in (CALIBRATION_TARGETS if every else names)]
    except ValueError as error:
        misuse(error, "--to")
    texts = {}
    for target in targets:
        try:
            texts[target] = render_calibration(found, target.name, noise, options)
        except DataError as error:
            if not every:
                raise
            print_note(f"{target.name} is not written: {error}")
    _write({target.file_name: text for target, text in texts.items()}, out, several=every or len(texts) > 1)
    if noise is None and out != "-" and any(target.noise for target in texts):
        print_note("The files have no noise numbers: run imucal calibrate with --noise REPORT")


def _export_thermal(path: Path, names: tuple[str, ...], out: str | None) -> None:
    """Write the files of a temperature ramp."""
    found = load_thermal(path)
    if found.verdict == "not-usable" and not is_set("force"):
        codes = ", ".join(each.code for each in found.findings if each.level == "error")
        raise DataError(f"{codes} found; nothing was exported", place=path, fix=FORCE)
    try:
        targets = [find_thermal_target(name) for name in (THERMAL_TARGETS if "all" in names else names)]
    except ValueError as error:
        misuse(error, "--to")
    texts = {target.file_name: render_thermal(found, target.name) for target in targets}
    _write(texts, out, several=len(texts) > 1)


def _require_noise_targets(names: tuple[str, ...], source: str) -> None:
    for name in names:
        try:
            if name != "all":
                exports.find_target(name)
        except ValueError:
            misuse(
                f"{name} is for a calibration, and {source} is not one; run 'imucal calibrate' on a log",
                "--to",
            )


def _report(request: LogRequest, model: str | None, *, median: bool) -> Report:
    """Return the report of a log, or the numbers of a fleet's model or of a part in the same form."""
    if not request.logs and model is not None:
        if median:
            misuse("a part is not a fleet; omit --median")
        return part_report(model, request)
    folder = request.logs[0]
    if is_fleet(folder):
        if len(request.logs) > 1 or request.settings():
            misuse(f"{folder} is a fleet; give it alone, without options for a log")
        from imucal.fleet.as_report import fleet_as_report

        return fleet_as_report(read_fleet(folder, model), value="median" if median else "tolerance")
    if median or model is not None:
        instead = "--median" if median else "--sensor, or omit REPORT to export a data sheet"
        misuse(f"{shown_address(folder)} is not a fleet; omit {instead}")
    return load_report(request)


def _names(asked: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the formats, each once; print the name for each alias."""
    found = {name: exports.find_target(name) for name in asked}
    for name, target in found.items():
        if not target.is_called(name):
            print_note(f"{name}: written as {target.name} ({target.title})")
    return tuple(dict.fromkeys(target.name for target in found.values()))


def _left_out(report: Report, names: Iterable[str], chosen: exports.ExportOptions) -> Iterator[str]:
    """Yield a warning for each axis whose log contains more noise than the numbers of the files."""
    warned = set()
    for target in map(exports.find_target, names):
        numbers = target.numbers(report, chosen)
        for axis, more in numbers.left_out(per_axis=target.per_axis):
            if axis.name in warned:
                continue
            warned.add(axis.name)
            text = (
                f"warning: {axis.name}: the log contains more noise than the numbers of {target.name}, "
                f"because the fit leaves out {causes(axis.findings)}"
            )
            if numbers.covers:
                text += f"; --inflate white={numbers.white_to_include(more)} includes it"
            yield text


def _remarks(report: Report, numbers: Basis) -> Iterator[str]:
    """Yield remarks on the kind of the numbers, on bounds, and on sensors that the files lack."""
    if warned := dict.fromkeys(
        f.text for f in report.all_findings if f.code in {"unit-given", "unit-suspect", "unit-of-sensor"}
    ):
        yield from (f"warning: {text} All exported numbers of this sensor depend on it." for text in warned)
    if numbers == "covered":
        yield (
            "The exported white noise and walk are enough for the fitted spectrum, so they are larger "
            "than N and K; the files show by how much (--as-fitted writes N and K)"
        )
    for symbol in ("N", "K") if numbers == "as-fitted" else ():
        if axes := [axis.name for axis in report.axes if axis.fit[symbol].value is None]:
            yield (
                f"{symbol} was not detected on {', '.join(axes)}; files that need it contain its upper "
                "bound, with a comment"
            )
    if report.source.format.startswith(FROM_SHEET):
        yield f"warning: all numbers are {FROM_SHEET}; fit a log at rest to know your unit"
    for sensor in Sensor:
        if sensor not in report.by_sensor:
            yield f"the report has no {sensor}; the files omit its numbers"
