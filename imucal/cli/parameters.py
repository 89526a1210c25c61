"""Parameters of commands: types that validate values, and options that several commands share."""

import functools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from imucal.cli._declared import argument, flag, is_set, option, together
from imucal.cli._printing import BYTES, FITTING, print_note, progress
from imucal.clock import seconds_of
from imucal.frozen import frozen
from imucal.recording import AxisSeries, Recording, Sensor
from imucal.units import (
    INCREMENT_UNITS,
    SAMPLE_UNITS,
    duration,
    parse_increment_unit,
    parse_sample_unit,
    time_unit_ns,
)

if TYPE_CHECKING:
    from imucal.pipeline import Settings
    from imucal.readers.remote_logs import LocalLogs
    from imucal.report.result import Report


class Text(click.ParamType):  # type: ignore[type-arg,unused-ignore] # generic from click 8.4 on
    """A type whose values a function parses from a text; its ValueError becomes the message."""

    def __init__(self, name: str, parse: Callable[[str], object]) -> None:
        self.name, self._parse = name, parse

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> object:
        try:
            # A default may already be parsed.
            return self._parse(value) if isinstance(value, str) else value
        except ValueError as error:
            self.fail(str(error), param, ctx)


class Number(click.FloatRange):
    """A finite number in a range; click alone accepts nan and infinity.

    The text may end with the `unit`; with `percent`, a fraction may be written in percent.
    """

    def __init__(
        self,
        *limits: Any,  # noqa: ANN401
        unit: str = "",
        percent: bool = False,
        **attributes: Any,  # noqa: ANN401
    ) -> None:
        super().__init__(*limits, **attributes)
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


#: Units that are accepted in the columns of a log but not from users, who may mean degrees by "degs".
_UNCLEAR = frozenset({"rads", "mrads", "degs", "mdegs"})


#: Unit of raw samples, which only a calibration accepts without a scale.
_COUNT = "count"


def _unit_of(sensor: Sensor, text: str) -> str:
    if text.strip().lower() in {_COUNT, f"{_COUNT}s"}:
        context = click.get_current_context(silent=True)
        if context is not None and context.info_name == "calibrate":
            return _COUNT
        msg = f"{text!r} is not a unit of the {sensor}; give the size of a count with --{sensor.short}-scale"
        raise ValueError(f"{msg}, in {sensor.unit}")
    found = parse_sample_unit(text) or parse_increment_unit(text)
    if text.strip().lower() in _UNCLEAR and found is not None:
        raise ValueError(f"{text!r} is ambiguous; did you mean {found[1]!r}?")
    if found is None or found[0] is not sensor:
        msg = f"{text!r} is not a unit of the {sensor}; expected one of {', '.join(SAMPLE_UNITS[sensor])}, "
        msg += f"or {' or '.join(INCREMENT_UNITS[sensor])} per sample"
        raise ValueError(msg)
    return text


def _time_unit(text: str) -> str:
    if time_unit_ns(text) is None:
        raise ValueError(
            f"{text!r} is not a unit of time; expected s, ms, us, ns, min, h, d or a number of them"
        )
    return text


_TAU_SET = re.compile(r"octave|all|decade(:[1-9]\d{0,3})?")


def _taus(text: str, *, lists: bool = True) -> str | tuple[float, ...]:
    text, known = text.strip(), "octave, decade, decade:20 or all"
    if _TAU_SET.fullmatch(text):
        return text
    try:
        seconds = tuple(map(seconds_of, text.split(",")))
    except ValueError:
        seconds = (0.0,)
    if not lists or min(seconds) <= 0:
        message = f"neither {known}, nor a list of times such as 0.1,1,10min" if lists else f"not {known}"
        raise ValueError(f"{text!r} is {message}")
    return seconds


def structure_of(text: str) -> str:
    """Return the terms of a model in their usual order, or auto; a ValueError for any other text."""
    from imucal.noise import parse_structure, structure_text

    return text if text == "auto" else structure_text(parse_structure(text))


def model_of(sensor: Sensor) -> Text:
    """Return the type of a sensor's model."""

    def checked(text: str) -> str:
        from imucal.noise.model import NoiseModel

        NoiseModel.parse(text, sensor)
        return text

    return Text("model", checked)


#: Rate in Hz: no IMU is outside this range, and no product overflows.
RATE = Number(1e-6, 1e9, unit="Hz")
#: Beyond these limits intervals are meaningless.
LEVEL = Number(0.01, 0.999999, percent=True)
SHARE = Number(0, 1, min_open=True, max_open=True, percent=True)
_SCALE = Number(min=0, min_open=True)
DURATION = Text("duration", seconds_of)
STRUCTURE = Text("structure", structure_of)
TAU_SET, TAUS = Text("taus", functools.partial(_taus, lists=False)), Text("taus", _taus)


PATH, FILE = click.Path(path_type=Path), click.Path(exists=True, dir_okay=False, path_type=Path)
FORMATS = ("png", "svg", "pdf")

TOPIC = option("--topic NAME  Topic to read; give one for each sensor if they are separate.", multiple=True)
QUIET = flag("-q --quiet  Print results only: no progress, findings or paths.")
FORCE = flag("--force  Continue even if the log is not at rest (otherwise exit code 4).")
PICTURES = option(
    "--format  Format of the pictures; may be repeated.",
    click.Choice(FORMATS), multiple=True, default=("png",), show_default=True,
)  # fmt: skip
DATASHEET = option(
    "--datasheet/--si  Use datasheet or SI units in the table.", default=True, show_default=True
)


class Asked(NamedTuple):
    """Logs as the user named them, and arguments of `imucal.read` in the order of the report."""

    logs: tuple[str, ...]
    options: dict[str, Any]


def _asked(*, logs: tuple[str, ...], **options: Any) -> Asked:  # noqa: ANN401
    for sensor in Sensor:
        if options[f"{sensor.short}_unit"] == _COUNT:
            options |= {f"{sensor.short}_unit": None, f"{sensor.short}_scale": 1.0}
    return Asked(logs, options)


def _sample_unit(sensor: Sensor) -> Text:
    return Text("unit", functools.partial(_unit_of, sensor))


READING = together(
    _asked,
    {
        # The reader, not click, checks whether a log can be read: the exit code differs.
        "logs": argument("LOG...", click.Path(allow_dash=True, readable=False), nargs=-1, required=True),
        "time": option("--time CLOCK  Time stamps to use: 'header', 'log', or a table's column."),
        "time_unit": option(
            "--time-unit UNIT  Unit of the time stamps, if the log has none: s, ms, us, ns, min, h or 100ns.",
            Text("unit", _time_unit),
        ),
        "rate_hz": option("--rate HZ  Sampling rate in Hz, if the log's is missing or wrong.", RATE),
        "gyro_unit": option(
            "--gyro-unit UNIT  Gyroscope unit, if the log has none: rad/s, deg/s, mdeg/s, …",
            _sample_unit(Sensor.GYROSCOPE),
        ),
        "accel_unit": option(
            "--accel-unit UNIT  Accelerometer unit, if the log has none: m/s^2, g, mg, …",
            _sample_unit(Sensor.ACCELEROMETER),
        ),
        "gyro_scale": option("--gyro-scale X  Scale of raw gyroscope counts, in rad/s per count.", _SCALE),
        "accel_scale": option(
            "--accel-scale X  Scale of raw accelerometer counts, in m/s^2 per count.", _SCALE
        ),
        "columns": option("--columns TEXT  Columns, or fields of messages: t=0,g=1:4,a=4:7 or gz=rate.z."),
        "message_definition": option(
            "--msg FILE  Message definition (.msg), or a folder with several, if the log has none.",
            click.Path(exists=True, path_type=Path),
            multiple=True,
        ),
    },
)


@contextmanager
def lent(logs: Sequence[str]) -> Iterator["LocalLogs"]:
    """Lend logs as local files; downloads have a progress bar."""
    from imucal.readers.remote_logs import local_logs
    from imucal.remote import is_url

    with ExitStack() as stack:
        with progress("downloading", *BYTES, when=any(map(is_url, logs))) as update:
            local = stack.enter_context(local_logs(logs, progress=update))
        yield local


@frozen
class LogRequest:
    """The logs to read; `reading` contains arguments of `imucal.read`.

    `models` are texts of models, which some commands accept instead of a log.
    """

    logs: tuple[str, ...]
    reading: dict[str, Any]
    strict: bool
    skip_s: float
    take_s: float | None
    models: Mapping[Sensor, str] = field(default_factory=dict)

    def read(self) -> Recording:
        with lent(self.logs) as logs:
            return self._read(logs)

    def _read(self, logs: "LocalLogs") -> Recording:
        from imucal.readers import read

        with progress("reading", *BYTES) as update:
            recording = read(*logs.paths, **self.reading, strict=self.strict, progress=update)
        if self.skip_s or self.take_s is not None:
            end = math.inf if self.take_s is None else self.skip_s + self.take_s
            recording = recording.between(self.skip_s, end)
        recording = logs.named(recording)
        _print_what_was_read(recording)
        return recording

    def characterise(
        self, settings: "Settings", *, workers: int | None = None, rests: bool = False
    ) -> "Report":
        """Read and characterise the log, or only its `rests`, with progress bars."""
        from imucal.pipeline import characterize
        from imucal.readers.checksums import checksums_of

        with lent(self.logs) as logs, checksums_of(logs.paths) as files_of_logs:
            recording = self._read(logs)
            if rests:
                from imucal.rests import at_rest

                recording = at_rest(recording)
            with progress(*FITTING) as update:
                report = characterize(recording, settings, progress=update, workers=workers)
            files = (*report.source.files, *logs.named_files(files_of_logs()))
            return replace(report, source=replace(report.source, files=files))

    def settings(self) -> dict[str, object]:
        """Return the settings that are not defaults, as JSON values for the report."""
        asked = {**self.reading, "strict": self.strict, "skip_s": self.skip_s, "take_s": self.take_s}
        return {
            name: list(map(str, value)) if isinstance(value, tuple) else value
            for name, value in asked.items()
            if value
        }


def _request(*, topic: tuple[str, ...], asked: Asked, join: bool, **others: Any) -> LogRequest:  # noqa: ANN401
    return LogRequest(logs=asked.logs, reading={"topic": topic, **asked.options, "join": join}, **others)


LOG = together(
    _request,
    {
        "topic": TOPIC,
        "asked": READING,
        "join": flag("--join  Read several LOGs as one recording, even if they do not look like it."),
        "skip_s": option("--skip TIME  Skip the start, such as 5min.", DURATION, default=0.0),
        "take_s": option("--take TIME  Read only this much, such as 2h.", DURATION),
        "strict": flag("--strict  Refuse a damaged log; exit with code 4 on a warning."),
        "_quiet": QUIET,
        "_verbose": flag("-v --verbose  Print the reason of each choice."),
    },
)


def _print_what_was_read(recording: Recording) -> None:
    """Print one line per sensor (with --verbose each decision), so that no choice is silent."""
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
        print_note(f"Read {Path(source.path).name} ({source.format}): {names}: {samples}")
    if source.read is not None and source.read.from_s > 0:
        print_note(
            f"Times below count from {source.read.from_s:.10g} s of the log, except those after --skip"
        )
    if is_set("verbose"):
        for topic, kind in zip(source.topics, source.message_types, strict=False):
            print_note(f"  topic {topic} ({kind})")
        for question, answer in source.decisions:
            print_note(f"  {question}: {answer}")
