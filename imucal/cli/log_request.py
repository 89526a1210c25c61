"""LogRequest: the logs that a command reads, with the options for reading them."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imucal.cli._printing import BYTES, FITTING, print_note, progress
from imucal.cli.context import is_set
from imucal.recording import AxisSeries, Recording, Sensor
from imucal.units import duration

if TYPE_CHECKING:
    from imucal.pipeline import Settings
    from imucal.readers.remote_logs import LocalLogs
    from imucal.report.result import Report
    from imucal.sensors import Part


@contextmanager
def lent(logs: Sequence[str]) -> Iterator["LocalLogs"]:
    """Lend logs as local files; downloads have a progress bar."""
    from imucal.readers.remote_logs import local_logs
    from imucal.remote import is_url

    with ExitStack() as stack:
        with progress("downloading", *BYTES, when=any(map(is_url, logs))) as update:
            local = stack.enter_context(local_logs(logs, progress=update))
        yield local


@dataclass(frozen=True, kw_only=True)
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
            recording = read(
                *logs.paths,
                **self.reading,
                strict=self.strict,
                skip_s=self.skip_s,
                take_s=self.take_s,
                progress=update,
            )
        recording = logs.named(recording)
        _print_what_was_read(recording)
        return recording

    def characterise(
        self,
        settings: "Settings",
        *,
        workers: int | None = None,
        rests: bool = False,
        part: "Part | None" = None,
    ) -> "Report":
        """Read and characterise the log, or only its `rests`, with progress bars.

        With a `part`, compare the report with its data sheet.
        """
        from imucal.pipeline import characterize
        from imucal.readers.checksums import checksums_of

        with lent(self.logs) as logs, checksums_of(logs.paths) as files_of_logs:
            recording = self._read(logs)
            if rests:
                from imucal.rests import at_rest

                recording = at_rest(recording)
            with progress(*FITTING) as update:
                report = characterize(recording, settings, progress=update, workers=workers)
            if part is not None:
                from imucal.sheet_comparison import compared_with_sheet

                report = compared_with_sheet(report, recording, part)
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
