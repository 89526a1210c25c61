"""Parameters of commands: types that say what is right, and options that several commands share.

Types of options that several commands share: they refuse what is out of range, and say what is right.

Options of how to read a log, where it doesn't say itself.

Options that several commands share.

The LOG argument with the options of reading it, and what is read by them.
"""

import functools
import math
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import click

from imucal.cli._printing import say
from imucal.cli._progress import axes_progress, download_progress, reading_progress
from imucal.recording import AxisSeries, Recording, Sensor
from imucal.units import SAMPLE_UNITS, duration, parse_sample_unit

if TYPE_CHECKING:
    from imucal.pipeline import Settings
    from imucal.readers.remote_logs import LocalLogs
    from imucal.report.result import Report

if TYPE_CHECKING:
    from click import ParamType as ParamType  # noqa: PLC0414 - offered to the commands
else:

    class ParamType(click.ParamType):
        """A parameter type, generic for type checkers; click's own is generic from 8.4 on."""

        def __class_getitem__(cls, _: object) -> type:
            return cls


#: Written like this, averaging times are a set and not a list.
_TAU_SET = re.compile(r"octave|all|decade(:[1-9]\d{0,3})?")


class Number(click.FloatRange):
    """A finite number in a range: click lets nan and infinity through.

    A `unit` may follow it, and a fraction may be given in percent.
    """

    def __init__(
        self,
        min: float | None = None,  # noqa: A002 - as click calls them
        max: float | None = None,  # noqa: A002
        *,
        min_open: bool = False,
        max_open: bool = False,
        unit: str = "",
        percent: bool = False,
    ) -> None:
        super().__init__(min, max, min_open=min_open, max_open=max_open)
        self.unit, self.percent = unit, percent

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        text = str(value).strip()
        if self.unit:
            text = re.sub(f"\\s*{self.unit}$", "", text, flags=re.IGNORECASE)
        try:
            number = float(text.removesuffix("%")) / (100 if self.percent and text.endswith("%") else 1)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        if self.percent and 1 < number < 100:
            self.fail(f"{value!r} is more than all; did you mean {number / 100:g} or {text}%?", param, ctx)
        return float(super().convert(repr(number), param, ctx))  # type: ignore[arg-type] # click's stub is narrow


#: Hz: no IMU is slower or faster, and no product of these overflows.
RATE = Number(1e-6, 1e9, unit="Hz")
#: Beyond these levels an interval is a point or everything.
LEVEL = Number(0.01, 0.999999, percent=True)


class Duration(ParamType[float]):
    """Seconds, or a number with s, min, m, h or d."""

    name = "duration"
    _factors: ClassVar[dict[str, float]] = {"s": 1.0, "min": 60.0, "m": 60.0, "h": 3600.0, "d": 86400.0}

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        if isinstance(value, int | float):
            return float(value)
        text = str(value).strip()
        number = text.rstrip("smindh")
        factor = self._factors.get(text[len(number) :] or "s")
        try:
            seconds = float(number) * (factor or float("nan"))
        except ValueError:
            seconds = float("nan")
        if not 0 <= seconds < float("inf"):
            self.fail(f"{text!r} is not a duration; write seconds, or such as 90s, 5min, 2.5h", param, ctx)
        return seconds


class UnitName(ParamType[str]):
    """A unit of one sensor's samples, in a spelling that can't be meant otherwise."""

    name = "unit"
    #: Plurals: a log's column may be called so, but "degs" typed by a person may be degrees.
    _unclear = frozenset({"rads", "mrads", "degs", "mdegs"})

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        text = str(value)
        found = parse_sample_unit(text)
        known = ", ".join(SAMPLE_UNITS[self.sensor])
        if text.strip().lower() in self._unclear and found is not None:
            self.fail(f"{text!r} is not clear; did you mean {found[1]!r}?", param, ctx)
        if found is None or found[0] is not self.sensor:
            self.fail(f"{text!r} is no unit of the {self.sensor}; expected one of {known}", param, ctx)
        return text


class TauSet(ParamType[str]):
    """A set of averaging times by its name."""

    name = "taus"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        text = str(value).strip()
        if not _TAU_SET.fullmatch(text):
            self.fail(f"{text!r} is not octave, decade, decade:20 or all", param, ctx)
        return text


class Taus(ParamType[str | tuple[float, ...]]):
    """A set of averaging times by name, or a list of durations."""

    name = "taus"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str | tuple[float, ...]:
        text = str(value).strip()
        if _TAU_SET.fullmatch(text):
            return text
        try:
            seconds = tuple(Duration().convert(part, param, ctx) for part in text.split(","))
        except click.BadParameter:
            seconds = (0.0,)
        if min(seconds) <= 0:
            known = "octave, decade, decade:20 or all, nor a list of times such as 0.1,1,10min"
            self.fail(f"{text!r} is neither {known}", param, ctx)
        return seconds


class Structure(ParamType[str]):
    """The terms of a model, or auto."""

    name = "structure"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from imucal.noise import parse_structure, structure_text

        text = str(value)
        try:
            return text if text == "auto" else structure_text(parse_structure(text))
        except ValueError as error:
            self.fail(str(error), param, ctx)


Command = TypeVar("Command", bound=Callable[..., Any])

#: How to read a log, where it doesn't say itself.
READING = (
    click.option("--time", metavar="CLOCK", help="'header' or 'log' stamps; a table's time column."),
    click.option(
        "--time-unit",
        type=click.Choice(["s", "ms", "us", "ns"]),
        help="Unit of the time, where the log doesn't say.",
    ),
    click.option(
        "--rate",
        type=RATE,
        metavar="HZ",
        help="Sampling rate, where the log's own is missing or wrong.",
    ),
    click.option(
        "--gyro-unit",
        type=UnitName(Sensor.GYROSCOPE),
        metavar="UNIT",
        help="rad/s, deg/s, mdeg/s, …, where the log doesn't say.",
    ),
    click.option(
        "--accel-unit",
        type=UnitName(Sensor.ACCELEROMETER),
        metavar="UNIT",
        help="m/s^2, g, mg, …, where the log doesn't say.",
    ),
    click.option(
        "--gyro-scale",
        type=Number(min=0, min_open=True),
        metavar="X",
        help="rad/s per count, for raw counts.",
    ),
    click.option(
        "--accel-scale",
        type=Number(min=0, min_open=True),
        metavar="X",
        help="m/s^2 per count, for raw counts.",
    ),
    click.option("--columns", metavar="TEXT", help="Columns of a table: t=0,g=1:4,a=4:7 or t=0,gz=1."),
    click.option(
        "--fields",
        multiple=True,
        metavar="TEXT",
        help="Fields of messages, such as 'gyro=gx,gy,gz accel=imu.a' or gyro.z=turn; info -v lists them.",
    ),
    click.option(
        "--msg",
        multiple=True,
        type=click.Path(exists=True, path_type=Path),
        metavar="FILE",
        help="Definition (.msg) of a type the log doesn't define, or a folder of them.",
    ),
)
#: What a fields text starts with.
_FIELDS = re.compile(r"(g|gyro|a|accel|t|time|temp|temperature)=")
#: Name of an option of `READING` -> argument of `imucal.read`, where they differ.
_ARGUMENTS = {"rate": "rate_hz", "msg": "message_definition"}
_READING = (
    *("time", "time_unit", "rate", "gyro_unit", "accel_unit", "gyro_scale", "accel_scale"),
    *("columns", "fields", "msg"),
)


def reading_options(command: Command) -> Callable[..., Any]:
    """Add the options of reading a log; the command gets them as `reading`, arguments of `imucal.read`."""

    @functools.wraps(command)
    def wrapper(**values: Any) -> object:  # noqa: ANN401 - click passes every option by name
        values = with_all_fields(values)
        reading = {_ARGUMENTS.get(name, name): values.pop(name) for name in _READING}
        return command(reading=reading, **values)

    decorated: Callable[..., Any] = wrapper
    for option in reversed(READING):
        decorated = option(decorated)
    return decorated


def with_all_fields(values: dict[str, Any]) -> dict[str, Any]:
    """Take what stands behind --fields without quotes, as in ``--fields gyro=g accel=a``, out of the logs."""
    if not values["fields"]:
        return values
    more = tuple(log for log in values["logs"] if _FIELDS.match(log) and not Path(log).exists())
    logs = tuple(log for log in values["logs"] if log not in more)
    return {**values, "logs": logs, "fields": (*values["fields"], *more)}


#: An option whose default stands in its help.
shown = functools.partial(click.option, show_default=True)
quiet_option = click.option(
    "-q", "--quiet", is_flag=True, help="Print results only: no progress, findings or paths."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class LogRequest:
    """What the user asked to read; the fields are the options of `log_options`."""

    logs: tuple[str, ...]
    topic: tuple[str, ...]
    time: str | None
    time_unit: str | None
    rate: float | None
    gyro_unit: str | None
    accel_unit: str | None
    gyro_scale: float | None
    accel_scale: float | None
    columns: str | None
    fields: tuple[str, ...]
    msg: tuple[Path, ...]
    join: bool
    strict: bool
    skip: float
    take: float | None
    quiet: bool
    verbose: bool

    @contextmanager
    def local(self) -> Iterator["LocalLogs"]:
        """Lend the logs as files of this machine, those by URL with a progress bar where a person watches."""
        from imucal.readers.remote_logs import local_logs
        from imucal.remote import is_url

        with ExitStack() as stack:
            quiet = self.quiet or not any(map(is_url, self.logs))
            with download_progress(quiet=quiet) as progress:
                logs = stack.enter_context(local_logs(self.logs, progress=progress))
            yield logs

    def read(self) -> Recording:
        """Read the log, with a progress bar where a person watches."""
        with self.local() as logs:
            return self._read(logs)

    def _read(self, logs: "LocalLogs") -> Recording:
        from imucal.readers import read
        from imucal.readers.clocks import part_between

        with reading_progress(quiet=self.quiet) as progress:
            recording = read(
                *logs.paths,
                topic=self.topic,
                time=self.time,
                time_unit=self.time_unit,
                rate_hz=self.rate,
                gyro_unit=self.gyro_unit,
                accel_unit=self.accel_unit,
                gyro_scale=self.gyro_scale,
                accel_scale=self.accel_scale,
                columns=self.columns,
                message_definition=self.msg,
                fields=self.fields,
                join=self.join,
                strict=self.strict,
                progress=progress,
            )
        if self.skip or self.take is not None:
            end = float("inf") if self.take is None else self.skip + self.take
            recording = part_between(recording, self.skip, end)
        recording = logs.named(recording)
        _say_what_was_read(recording, quiet=self.quiet, verbose=self.verbose)
        return recording

    def characterise(self, settings: "Settings", *, workers: int | None = None) -> "Report":
        """Read and characterise the log, `workers` axes at a time, with progress bars on a terminal."""
        from imucal.pipeline import characterize
        from imucal.readers.checksums import Checksums

        with self.local() as logs, Checksums(logs.paths) as checksums:
            recording = self._read(logs)
            with axes_progress(quiet=self.quiet) as progress:
                report = characterize(recording, settings, progress=progress, workers=workers)
            files = (*report.source.files, *logs.named_files(checksums.files()))
            return replace(report, source=replace(report.source, files=files))

    def settings(self) -> dict[str, object]:
        """Return what was asked, for the report: JSON values, defaults left out."""
        asked: dict[str, object] = {
            "topic": list(self.topic),
            "time": self.time,
            "time_unit": self.time_unit,
            "rate_hz": self.rate,
            "gyro_unit": self.gyro_unit,
            "accel_unit": self.accel_unit,
            "gyro_scale": self.gyro_scale,
            "accel_scale": self.accel_scale,
            "columns": self.columns,
            "message_definition": [str(path) for path in self.msg],
            "fields": list(self.fields),
            "join": self.join,
            "strict": self.strict,
            "skip_s": self.skip,
            "take_s": self.take,
        }
        return {name: value for name, value in asked.items() if value}


def log_options(command: Command) -> Callable[..., Any]:
    """Add the LOG argument and the options of reading it; the command gets them as `request`."""

    @functools.wraps(command)
    def wrapper(**values: Any) -> object:  # noqa: ANN401 - click passes every option by name
        values = with_all_fields(values)
        names = LogRequest.__dataclass_fields__
        request = LogRequest(**{name: values.pop(name) for name in names})
        return command(request=request, **values)

    options = (
        # Whether a log can be read is for its reader to say, with the exit code of that.
        click.argument(
            "logs",
            metavar="LOG...",
            nargs=-1,
            required=True,
            type=click.Path(allow_dash=True, readable=False),
        ),
        click.option("--topic", multiple=True, metavar="NAME", help="Topic to read; twice for one a sensor."),
        *READING,
        click.option(
            "--join",
            is_flag=True,
            help="Take several LOGs as parts of one recording, whatever they look like.",
        ),
        click.option(
            "--skip", type=Duration(), default=0.0, metavar="TIME", help="Leave out the start, such as 5min."
        ),
        click.option("--take", type=Duration(), metavar="TIME", help="Use only so much, such as 2h."),
        click.option(
            "--strict", is_flag=True, help="Refuse a damaged log; end with exit code 4 on a warning."
        ),
        quiet_option,
        click.option("-v", "--verbose", is_flag=True, help="Say how each choice was made."),
    )
    decorated: Callable[..., Any] = wrapper
    for option in reversed(options):
        decorated = option(decorated)
    return decorated


def _say_what_was_read(recording: Recording, *, quiet: bool, verbose: bool) -> None:
    """Print one line a sensor (and with `verbose` each decision), so that nothing is picked silently."""
    source = recording.source
    by_clock: dict[int, list[AxisSeries]] = {}
    for series in recording.series:
        by_clock.setdefault(id(series.clock), []).append(series)
    for group in by_clock.values():
        clock = group[0].clock
        sensors: dict[str, str] = {}
        for series in group:
            sensors[series.sensor.short] = sensors.get(series.sensor.short, "") + series.axis
        names = ", ".join(f"{sensor} {axes}" for sensor, axes in sensors.items())
        samples = f"{clock.n} samples at {clock.rate_hz:.6g} Hz, {duration(clock.duration_s)}"
        say(f"Read {Path(source.path).name} ({source.format}): {names}: {samples}", quiet=quiet)
    if verbose:
        for topic, kind in zip(source.topics, source.message_types, strict=False):
            say(f"  topic {topic} ({kind})", quiet=quiet)
        for question, answer in source.decisions:
            say(f"  {question}: {answer}", quiet=quiet)
