"""Options that several commands share, and classes of commands whose ``--help`` lists options in groups."""

import functools
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import click

from imucal.cli.context import remember
from imucal.cli.log_request import LogRequest
from imucal.cli.param_types import (
    COUNT,
    DURATION,
    LEVEL,
    PATH,
    RATE,
    SCALE,
    STRUCTURE,
    TIME_UNIT,
    model_of,
    sample_unit,
)
from imucal.recording import Sensor

Decorator: TypeAlias = Callable[[Callable[..., Any]], Callable[..., Any]]

# Titles of the groups.
OPTIONS = "Options"
OUTPUT = "Output"
SAMPLES = "Part of the log"
UNITS = "Units"
MODEL = "Fit"
NUMBERS = "Numbers"
ADVANCED = "Advanced"
MESSAGES = "Messages"

PICTURE_FORMATS = ("png", "svg", "pdf")
#: A range such as ``[x>=1]``, which click adds to the help; the error message contains it.
_RANGE = re.compile(r"  \[{0}\]|; {0}(?=\])".format(r"(?:[^\s;[]+<=?)?x(?:[<>]=?[^\s;\]]+)?"))


class Option(click.Option):
    """An option with the title of the group that contains it in ``--help``."""

    def __init__(self, *args: Any, group: str = OPTIONS, **attributes: Any) -> None:  # noqa: ANN401
        super().__init__(*args, **attributes)
        self.group = group

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        record = super().get_help_record(ctx)
        if record is None:
            return None
        names, text = record
        return names, _RANGE.sub("", text)


class Command(click.Command):
    """A command whose ``--help`` lists its options in groups."""

    groups: tuple[str, ...] = (OPTIONS, OUTPUT, SAMPLES, UNITS, NUMBERS, MODEL, ADVANCED, MESSAGES)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        records: dict[str, list[tuple[str, str]]] = {title: [] for title in self.groups}
        options = [parameter for parameter in self.get_params(ctx) if isinstance(parameter, click.Option)]
        for parameter in options:
            # click makes --help itself, without a group.
            title = parameter.group if isinstance(parameter, Option) else OPTIONS
            record = parameter.get_help_record(ctx)
            if title in records and record is not None:
                records[title].append(record)
        for title, rows in records.items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows, col_max=formatter.width // 3)


class ReportCommand(Command):
    """A command for a report or a log; its ``--help`` only mentions the options for reading a log."""

    groups = tuple(title for title in Command.groups if title not in {SAMPLES, UNITS})

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        super().format_options(ctx, formatter)
        formatter.write_paragraph()
        with formatter.indentation():
            formatter.write_text("For a log, the options of 'imucal fit' for samples and units work too.")


def option(*names: str, group: str = OPTIONS, **attributes: Any) -> Decorator:  # noqa: ANN401
    """Declare an option with click's `attributes`, in a group of ``--help``."""
    return click.option(*names, cls=Option, group=group, **attributes)


def flag(*names: str, group: str = OPTIONS, **attributes: Any) -> Decorator:  # noqa: ANN401
    """Declare an option without a value."""
    return option(*names, group=group, is_flag=True, **attributes)


def context_flag(*names: str, group: str = OPTIONS, help: str) -> Decorator:  # noqa: A002 - click's name
    """Declare a flag that is not an argument of the command; functions ask `is_set`."""
    return flag(*names, group=group, help=help, expose_value=False, callback=remember)


def all_of(decorators: Sequence[Decorator]) -> Decorator:
    """Return a decorator that applies several; the first one is the outermost."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return decorate


def unwrapped(text: str) -> str:
    """Return a text with blocks that click does not wrap, for the end of the help."""
    return "\n\n".join(f"\b\n{block}" for block in text.strip("\n").split("\n\n"))


def out_option(metavar: str, **attributes: Any) -> Decorator:  # noqa: ANN401
    """Declare the option for the path of the result, with click's `attributes`."""
    return option("-o", "--out", group=OUTPUT, metavar=metavar, type=PATH, **attributes)


def fleet_model(*, group: str = OPTIONS, or_part: str = "") -> Decorator:
    """Declare the option for one sensor model of a fleet; `or_part` is its meaning without a fleet."""
    text = f"Of a fleet with several sensor models: this one. {or_part}".rstrip()
    return option("--sensor", "fleet_model", group=group, metavar="NAME", help=text)


quiet = context_flag("-q", "--quiet", group=MESSAGES, help="Print results only.")
verbose = context_flag(
    "-v", "--verbose", group=MESSAGES, help="Print all warnings, and the reason of each choice."
)
force = context_flag("--force", help="Go on although the log is not noise at rest.")
si_units = flag("--si", group=OUTPUT, help="Print SI units instead of those of data sheets.")
pictures = option(
    "--format",
    "formats",
    group=OUTPUT,
    metavar="NAME",
    type=click.Choice(PICTURE_FORMATS),
    multiple=True,
    default=("png",),
    show_default=True,
    help="Pictures as png, svg or pdf; may be repeated.",
)
model = option(
    "--model",
    group=MODEL,
    metavar="TEXT",
    type=STRUCTURE,
    default="auto",
    help='Fit these terms, such as "N + B + K" or "N + 2*GM". [default: chosen by the data]',
)
level = option(
    "--level",
    group=MODEL,
    metavar="P",
    type=LEVEL,
    default=0.95,
    show_default=True,
    help="Confidence level of the intervals.",
)

# Options for reading a log.
topic = option(
    "--topic",
    group=SAMPLES,
    metavar="NAME",
    multiple=True,
    help="IMU topic; give two if the sensors are separate.",
)
skip = option(
    "--skip",
    "skip_s",
    group=SAMPLES,
    metavar="TIME",
    type=DURATION,
    default=0.0,
    help="Leave out the start, such as 5min.",
)
take = option(
    "--take", "take_s", group=SAMPLES, metavar="TIME", type=DURATION, help="Use only this much, such as 2h."
)
_time = option("--time", group=SAMPLES, metavar="CLOCK", help="Time stamps: 'header', 'log', or a column.")
_RATE_HELP = "Sampling rate, if the log's is missing or wrong."
_rate = option("--rate", "rate_hz", group=SAMPLES, metavar="HZ", type=RATE, help=_RATE_HELP)
_rate_of_model = option(
    "--rate", "rate_hz", metavar="HZ", type=RATE, help=f"{_RATE_HELP} Required with a model."
)
_columns = option(
    "--columns",
    group=SAMPLES,
    metavar="TEXT",
    help="Columns of a table, or fields of messages: t=0,g=1:4,a=4:7.",
)
_message_definition = option(
    "--msg",
    "message_definition",
    group=SAMPLES,
    metavar="FILE",
    type=click.Path(exists=True, path_type=Path),
    multiple=True,
    help="Message definition (.msg) or a folder of them, if the log has none.",
)
_join = flag("--join", group=SAMPLES, help="Read several LOGs as one recording.")
_strict = flag("--strict", callback=remember, help="Refuse a damaged log; exit with code 4 on a warning.")
_strict_reading = flag("--strict", group=SAMPLES, callback=remember, help="Refuse a damaged log.")
_units = all_of(
    [
        option(
            "--gyro-unit",
            group=UNITS,
            metavar="UNIT",
            type=sample_unit(Sensor.GYROSCOPE),
            help="rad/s, deg/s, mdeg/s, …, if the log has none.",
        ),
        option(
            "--accel-unit",
            group=UNITS,
            metavar="UNIT",
            type=sample_unit(Sensor.ACCELEROMETER),
            help="m/s^2, g, mg, …, if the log has none.",
        ),
        option(
            "--gyro-scale",
            group=UNITS,
            metavar="X",
            type=SCALE,
            help="Size of a raw count, in rad/s.",
        ),
        option(
            "--accel-scale",
            group=UNITS,
            metavar="X",
            type=SCALE,
            help="Size of a raw count, in m/s^2.",
        ),
        option(
            "--time-unit",
            group=UNITS,
            metavar="UNIT",
            type=TIME_UNIT,
            help="s, ms, us, ns, min, h or 100ns, if the log has none.",
        ),
    ]
)
#: Arguments of `imucal.read` in the order of the report.
_READING = (
    "time",
    "time_unit",
    "rate_hz",
    "gyro_unit",
    "accel_unit",
    "gyro_scale",
    "accel_scale",
    "columns",
    "message_definition",
)


def logs_argument(metavar: str, *, required: bool) -> Decorator:
    """Declare any number of logs; the reader checks whether they can be read, with another exit code."""
    kind = click.Path(allow_dash=True, readable=False)
    return click.argument("logs", metavar=metavar, nargs=-1, required=required, type=kind)


def _with_reading(function: Callable[..., Any]) -> Callable[..., Any]:
    """Give the command the arguments of `imucal.read` as `reading`."""

    @functools.wraps(function)
    def command(**values: Any) -> object:  # noqa: ANN401
        reading = {name: values.pop(name) for name in _READING}
        for sensor in Sensor:
            if reading[f"{sensor.short}_unit"] == COUNT:
                reading |= {f"{sensor.short}_unit": None, f"{sensor.short}_scale": 1.0}
        return function(reading=reading, **values)

    return command


def _with_request(function: Callable[..., Any]) -> Callable[..., Any]:
    """Give the command the logs and the options for reading them as a `LogRequest`."""

    @functools.wraps(function)
    def command(*, reading: dict[str, Any], **values: Any) -> object:  # noqa: ANN401
        request = LogRequest(
            logs=values.pop("logs"),
            reading={"topic": values.pop("topic"), **reading, "join": values.pop("join")},
            strict=values.pop("strict"),
            skip_s=values.pop("skip_s"),
            take_s=values.pop("take_s"),
        )
        return function(request=request, **values)

    return command


def _with_models(function: Callable[..., Any]) -> Callable[..., Any]:
    """Give the command the models of the options as `models`: sensor -> text."""

    @functools.wraps(function)
    def command(**values: Any) -> object:  # noqa: ANN401
        texts = {sensor: values.pop(sensor.value) for sensor in Sensor}
        models = {sensor: text for sensor, text in texts.items() if text}
        return function(models=models, **values)

    return command


def _with_report(function: Callable[..., Any]) -> Callable[..., Any]:
    """Give the command a request whose models are those of the options or of the argument."""

    @functools.wraps(function)
    def command(*, request: LogRequest, models: dict[Sensor, str], **values: Any) -> object:  # noqa: ANN401
        from imucal.cli._report_input import report_request

        if values.get("fleet_model") and not (request.logs or models):
            # The command decides whether the option may name a part in place of a report.
            return function(request=request, **values)
        return function(request=report_request(request, models), **values)

    return command


#: Options for reading a log, without its range; the command gets them as `reading`.
reading_options = all_of([_columns, _time, _rate, _message_definition, _units, _with_reading])
#: LOG and all options for reading it; the command gets them as `request`.
log_options = all_of(
    [
        logs_argument("LOG...", required=True),
        topic,
        skip,
        take,
        reading_options,
        _join,
        _strict,
        quiet,
        verbose,
        _with_request,
    ]
)
#: Models in place of a report; the command gets them as `models`.
model_options = all_of(
    [
        option(
            "--gyro",
            Sensor.GYROSCOPE.value,
            metavar="MODEL",
            type=model_of(Sensor.GYROSCOPE),
            help='Use this gyroscope model instead of a report, such as "N=0.3deg/sqrt(h) + B=5deg/h".',
        ),
        option(
            "--accel",
            Sensor.ACCELEROMETER.value,
            metavar="MODEL",
            type=model_of(Sensor.ACCELEROMETER),
            help='Use this accelerometer model instead of a report, such as "N=60ug/sqrt(Hz) + B=40ug".',
        ),
        _with_models,
    ]
)
#: REPORT, which may be a log, with the options of both; for a `ReportCommand`, which gets them as `request`.
report_options = all_of(
    [
        click.argument("logs", metavar="REPORT", nargs=-1, type=click.Path()),
        model_options,
        _rate_of_model,
        topic,
        skip,
        take,
        _time,
        _columns,
        _message_definition,
        _units,
        _with_reading,
        _join,
        _strict_reading,
        quiet,
        verbose,
        _with_request,
        _with_report,
    ]
)
