"""Parameters of commands: types that say what is right, and options that several commands share.

Among these are the options of how to read a log, where it doesn't say itself, and the LOG argument with them.
"""

import functools
import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from imucal.cli._printing import say
from imucal.cli._progress import axes_progress, download_progress, reading_progress
from imucal.clock import seconds_of
from imucal.recording import AxisSeries, Recording, Sensor
from imucal.units import SAMPLE_UNITS, duration, parse_sample_unit

if TYPE_CHECKING:
    from click import ParamType

    from imucal.pipeline import Settings
    from imucal.readers.remote_logs import LocalLogs
    from imucal.report.result import Report
else:

    class ParamType(click.ParamType):
        """A parameter type, generic for type checkers; click's own is generic from 8.4 on."""

        def __class_getitem__(cls, _: object) -> type:
            return cls


Value = TypeVar("Value")
Command = TypeVar("Command", bound=Callable[..., Any])


class Text(ParamType[Value]):
    """What a function makes of a text; the sentence of its ValueError is the message."""

    def __init__(self, name: str, parse: Callable[[str], Value]) -> None:
        self.name, self._parse = name, parse

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Value:
        if not isinstance(value, str):
            return value  # type: ignore[return-value]  # a default that is no text
        try:
            return self._parse(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)


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


#: Units that a column of a log may be called by, but "degs" typed by a person may be degrees.
_UNCLEAR = frozenset({"rads", "mrads", "degs", "mdegs"})


def _unit_of(sensor: Sensor, text: str) -> str:
    """Return a unit of one sensor's samples, in a spelling that can't be meant otherwise."""
    found = parse_sample_unit(text)
    if text.strip().lower() in _UNCLEAR and found is not None:
        msg = f"{text!r} is not clear; did you mean {found[1]!r}?"
        raise ValueError(msg)
    if found is None or found[0] is not sensor:
        msg = f"{text!r} is no unit of the {sensor}; expected one of {', '.join(SAMPLE_UNITS[sensor])}"
        raise ValueError(msg)
    return text


#: Written like this, averaging times are a set and not a list.
_TAU_SET = re.compile(r"octave|all|decade(:[1-9]\d{0,3})?")


def _tau_set(text: str) -> str:
    if not _TAU_SET.fullmatch(text.strip()):
        msg = f"{text.strip()!r} is not octave, decade, decade:20 or all"
        raise ValueError(msg)
    return text.strip()


def _taus(text: str) -> str | tuple[float, ...]:
    if _TAU_SET.fullmatch(text.strip()):
        return text.strip()
    try:
        seconds = tuple(map(seconds_of, text.split(",")))
    except ValueError:
        seconds = (0.0,)
    if min(seconds) <= 0:
        known = "octave, decade, decade:20 or all, nor a list of times such as 0.1,1,10min"
        msg = f"{text.strip()!r} is neither {known}"
        raise ValueError(msg)
    return seconds


def structure_of(text: str) -> str:
    """Return the terms of a model in their usual order, or auto.

    Raises
    ------
    ValueError
        If the text names no model.
    """
    from imucal.noise import parse_structure, structure_text

    return text if text == "auto" else structure_text(parse_structure(text))


#: Hz: no IMU is slower or faster, and no product of these overflows.
RATE = Number(1e-6, 1e9, unit="Hz")
#: Beyond these levels an interval is a point or everything.
LEVEL = Number(0.01, 0.999999, percent=True)
#: A probability or a share, ends left out.
SHARE = Number(0, 1, min_open=True, max_open=True, percent=True)
_SCALE = Number(min=0, min_open=True)
#: Seconds, or a number with s, min, m, h or d.
DURATION = Text("duration", seconds_of)
#: Averaging times: a set by its name; the same, or a list of durations.
TAU_SET, TAUS = Text("taus", _tau_set), Text("taus", _taus)

#: An option whose default stands in its help.
shown = functools.partial(click.option, show_default=True)
#: Formats of pictures that can be written.
FORMATS = ("png", "svg", "pdf")

topic_option = click.option(
    "--topic", multiple=True, metavar="NAME", help="Topic to read; twice for one a sensor."
)
quiet_option = click.option(
    "-q", "--quiet", is_flag=True, help="Print results only: no progress, findings or paths."
)
pictures_option = shown(
    "--format",
    "formats",
    type=click.Choice(FORMATS),
    multiple=True,
    default=("png",),
    help="Pictures; may be repeated.",
)


def datasheet_option(text: str = "Units of the table.") -> Callable[[Command], Command]:
    """Return the option ``--datasheet/--si`` with its help."""
    return shown("--datasheet/--si", default=True, help=text)


def out_option(metavar: str, text: str) -> Callable[[Command], Command]:
    """Return the option ``-o``, a path, with its help."""
    return click.option("-o", "--out", type=click.Path(path_type=Path), metavar=metavar, help=text)


def model_option(text: str) -> Callable[[Command], Command]:
    """Return the option ``--model``, the terms to fit, with its help."""
    return shown("--model", type=Text("structure", structure_of), default="auto", metavar="TEXT", help=text)


def json_option(text: str) -> Callable[[Command], Command]:
    """Return the flag ``--json``, given as `as_json`, with its help."""
    return click.option("--json", "as_json", is_flag=True, help=text)


#: What a fields text starts with.
_FIELDS = re.compile(r"(g|gyro|a|accel|t|time|temp|temperature)=")
#: Options of how to read a log, in the order that a report keeps.
_READING = (
    *("time", "time_unit", "rate_hz", "gyro_unit", "accel_unit", "gyro_scale", "accel_scale"),
    *("columns", "message_definition", "fields"),
)


def reading_options(command: Command) -> Callable[..., Any]:
    """Add the options of reading a log; the command gets them as `reading`, arguments of `imucal.read`."""

    @click.option("--time", metavar="CLOCK", help="'header' or 'log' stamps; a table's time column.")
    @click.option(
        "--time-unit",
        type=click.Choice(["s", "ms", "us", "ns"]),
        help="Unit of the time, where the log doesn't say.",
    )
    @click.option(
        "--rate",
        "rate_hz",
        type=RATE,
        metavar="HZ",
        help="Sampling rate, where the log's own is missing or wrong.",
    )
    @click.option(
        "--gyro-unit",
        type=Text("unit", functools.partial(_unit_of, Sensor.GYROSCOPE)),
        metavar="UNIT",
        help="rad/s, deg/s, mdeg/s, …, where the log doesn't say.",
    )
    @click.option(
        "--accel-unit",
        type=Text("unit", functools.partial(_unit_of, Sensor.ACCELEROMETER)),
        metavar="UNIT",
        help="m/s^2, g, mg, …, where the log doesn't say.",
    )
    @click.option("--gyro-scale", type=_SCALE, metavar="X", help="rad/s per count, for raw counts.")
    @click.option("--accel-scale", type=_SCALE, metavar="X", help="m/s^2 per count, for raw counts.")
    @click.option("--columns", metavar="TEXT", help="Columns of a table: t=0,g=1:4,a=4:7 or t=0,gz=1.")
    @click.option(
        "--fields",
        multiple=True,
        metavar="TEXT",
        help="Fields of messages, such as 'gyro=gx,gy,gz accel=imu.a' or gyro.z=turn; info -v lists them.",
    )
    @click.option(
        "--msg",
        "message_definition",
        multiple=True,
        type=click.Path(exists=True, path_type=Path),
        metavar="FILE",
        help="Definition (.msg) of a type the log doesn't define, or a folder of them.",
    )
    @functools.wraps(command)
    def wrapper(*, logs: tuple[str, ...], fields: tuple[str, ...], **values: Any) -> object:  # noqa: ANN401
        # What stands behind --fields without quotes, as in ``--fields gyro=g accel=a``, is no log.
        more = [log for log in logs if fields and _FIELDS.match(log) and not Path(log).exists()]
        values["fields"] = (*fields, *more)
        reading = {name: values.pop(name) for name in _READING}
        return command(logs=tuple(log for log in logs if log not in more), reading=reading, **values)

    return wrapper


@dataclass(frozen=True, slots=True, kw_only=True)
class LogRequest:
    """What the user asked to read; `reading` holds arguments of `imucal.read`.

    `models` are texts of models in place of a log, where a command takes them.
    """

    logs: tuple[str, ...]
    reading: dict[str, Any]
    strict: bool
    skip_s: float
    take_s: float | None
    quiet: bool
    verbose: bool
    models: Mapping[Sensor, str] = field(default_factory=dict)

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

        with reading_progress(quiet=self.quiet) as progress:
            recording = read(*logs.paths, **self.reading, strict=self.strict, progress=progress)
        if self.skip_s or self.take_s is not None:
            end = math.inf if self.take_s is None else self.skip_s + self.take_s
            recording = recording.between(self.skip_s, end)
        recording = logs.named(recording)
        _say_what_was_read(recording, quiet=self.quiet, verbose=self.verbose)
        return recording

    def characterise(
        self, settings: "Settings", *, workers: int | None = None, rests: bool = False
    ) -> "Report":
        """Read and characterise the log, or its `rests` alone, with progress bars on a terminal."""
        from imucal.pipeline import characterize
        from imucal.readers.checksums import Checksums

        with self.local() as logs, Checksums(logs.paths) as checksums:
            recording = self._read(logs)
            if rests:
                from imucal.rests import at_rest

                recording = at_rest(recording)
            with axes_progress(quiet=self.quiet) as progress:
                report = characterize(recording, settings, progress=progress, workers=workers)
            files = (*report.source.files, *logs.named_files(checksums.files()))
            return replace(report, source=replace(report.source, files=files))

    def settings(self) -> dict[str, object]:
        """Return what was asked, for the report: JSON values, defaults left out."""
        asked = {**self.reading, "strict": self.strict, "skip_s": self.skip_s, "take_s": self.take_s}
        return {
            name: list(map(str, value)) if isinstance(value, tuple) else value
            for name, value in asked.items()
            if value
        }


def log_options(command: Command) -> Callable[..., Any]:
    """Add the LOG argument and the options of reading it; the command gets them as `request`."""

    # Whether a log can be read is for its reader to say, with the exit code of that.
    @click.argument(
        "logs", metavar="LOG...", nargs=-1, required=True, type=click.Path(allow_dash=True, readable=False)
    )
    @topic_option
    @reading_options
    @click.option(
        "--join", is_flag=True, help="Take several LOGs as parts of one recording, whatever they look like."
    )
    @click.option(
        "--skip",
        "skip_s",
        type=DURATION,
        default=0.0,
        metavar="TIME",
        help="Leave out the start, such as 5min.",
    )
    @click.option("--take", "take_s", type=DURATION, metavar="TIME", help="Use only so much, such as 2h.")
    @click.option("--strict", is_flag=True, help="Refuse a damaged log; end with exit code 4 on a warning.")
    @quiet_option
    @click.option("-v", "--verbose", is_flag=True, help="Say how each choice was made.")
    @functools.wraps(command)
    def wrapper(
        *, topic: tuple[str, ...], reading: dict[str, Any], join: bool, **values: Any  # noqa: ANN401
    ) -> object:  # fmt: skip
        asked = {
            name: values.pop(name) for name in ("logs", "strict", "skip_s", "take_s", "quiet", "verbose")
        }
        request = LogRequest(reading={"topic": topic, **reading, "join": join}, **asked)
        return command(request=request, **values)

    return wrapper


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
