"""The LOG argument with the options of reading it, and what is read by them."""

import functools
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucal.cli._echo import say
from imucal.cli._progress import axes_progress, download_progress, reading_progress
from imucal.cli.parameters.option_types import Duration
from imucal.cli.parameters.reading_options import READING, Command, with_all_fields
from imucal.cli.parameters.shared_options import quiet_option
from imucal.recording import AxisSeries, Recording
from imucal.units import duration

if TYPE_CHECKING:
    from imucal.pipeline import Settings
    from imucal.readers.remote_logs import LocalLogs
    from imucal.report.result import Report


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
