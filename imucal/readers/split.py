"""Read several logs as one recording if each continues the previous one; otherwise raise an error."""

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from imucal.clock import Clock, Segment
from imucal.errors import ChoiceError, Fix, ImucalError
from imucal.findings import Finding
from imucal.readers.assemble import assemble
from imucal.readers.choose import candidates_of, whole
from imucal.readers.containers.rosbag2_folder import natural
from imucal.readers.formats import detect
from imucal.readers.read_options import ReadOptions
from imucal.readers.reading import read_one
from imucal.readers.tables.text_table import ONLY_TIMES, TextLog
from imucal.recording import AxisSeries, Recording, Temperature, span_ns

#: Longest pause between two parts, in s.
_MAX_PAUSE_S = 10.0
#: Largest overlap of two parts, in samples.
_SAMPLES_OVER = 10
#: Largest overlap of two parts, in s, if it is more.
_TIME_OVER = 0.1
#: File extensions, and the number that log rotation appends.
_ENDINGS = re.compile(
    r"(?:\.(?:csv|tsv|txt|log|dat|mcap|db3|bag|active|ulg|parquet|npz|npy|mat|gz|bz2|xz|lz4|zst|zstd))+"
    r"(?P<number>(?:\.\d+)?)$"
)
#: Names of devices: unit1, imu2, sensor3. Parts of a recording are imu_0, imu_1.
_DEVICE = re.compile(r"(?<![a-z])(?:(?:unit|device|dev|board|serial|sn)[\W_]*|imu|sensor|gyro)\d+$")

#: Largest relative difference of the rates of two parts.
_SAME_RATE = 0.01
_MAX_LISTED = 12
#: Earlier stamps (before 1980), in ns, count from power-on.
_NO_DATE = 315_532_800_000_000_000

_COMMON = ("frame", "layout", "gyroscope unit", "accelerometer unit")


def why_not_one(paths: Sequence[Path], parts: Sequence[Recording]) -> str:
    """Return why recordings, ordered by time, are not parts of one; empty if they are."""
    names = [path.name for path in paths]
    return overlap(names, parts) or _differences(parts) or _names(names) or _pauses(names, parts)


def overlap(names: Sequence[str], parts: Sequence[Recording]) -> str:
    """Return which recordings, ordered by time, overlap; empty if none do."""
    for (first, one), (second, other) in pairwise(zip(names, (part.series for part in parts), strict=True)):
        if (before := span_ns(one)) and (after := span_ns(other)):
            over = (min(before[1], after[1]) - after[0]) / 1e9
            if over > max(_SAMPLES_OVER * max(series.tau0 for series in one + other), _TIME_OVER):
                return f"{first} and {second} overlap in time by {over:.4g} s"
    return ""


def _differences(parts: Sequence[Recording]) -> str:
    topics = [", ".join(part.source.topics) for part in parts]
    if len(set(topics)) > 1:
        what = "topics" if parts[0].source.message_types else "columns"
        return f"their {what} differ ({' and '.join(dict.fromkeys(topics))})"
    for question in _COMMON:
        answers = dict.fromkeys(part.source.values.get(question, "none") for part in parts)
        if len(answers) > 1:
            return f"their {question}s differ ({' and '.join(answers)})"
    return ""


def _names(names: Sequence[str]) -> str:
    if len({series_of(name.lower()) for name in names}) > 1:
        return "their names are not a series: they differ in more than a number"
    if all(_DEVICE.search(_ENDINGS.sub("", name.lower())) for name in names):
        return "the numbers in their names are of devices, not of parts"
    return ""


def series_of(name: str) -> str:
    """Return a name without numbers and file extensions."""
    return re.sub(r"[\W_]*\d+", "", _ENDINGS.sub(r"\g<number>", name))


def _pauses(names: Sequence[str], parts: Sequence[Recording]) -> str:
    spans = zip(names, (span_ns(part.series) for part in parts), strict=True)
    for (first, before), (second, after) in pairwise(spans):
        if before is None or after is None:
            return f"{second if before else first} has no time stamps of the recording"
        pause = (after[0] - before[1]) / 1e9
        if pause > _MAX_PAUSE_S:
            return f"{second} starts {pause:.4g} s after the end of {first}"
    return ""


def read_all(paths: Sequence[Path], options: ReadOptions) -> Recording:
    """Read several logs as one recording, in the order of their times.

    Raises ReadError if a log can't be read; ChoiceError if the logs overlap, differ in topic, frame or unit,
    or do not continue each other; with `ReadOptions.join`, only if their axes or rates differ.
    """
    ordered = sorted(paths, key=natural)
    formats = [detect(path) for path in ordered]
    if all(entry.name == "text" for entry in formats) and (found := _of_sensors(ordered, options)):
        return _part(_named(found, ordered), options)
    whole_parts = replace(options, skip_s=0.0, take_s=None)
    parts = [read_one(path, whole_parts) for path in ordered]
    spans = [span for part in parts if (span := span_ns(part.series))]
    if len(spans) == len(parts):
        order = sorted(range(len(parts)), key=lambda i: spans[i][0])
        ordered, parts = [ordered[i] for i in order], [parts[i] for i in order]
    problem = why_not_one(ordered, parts)
    if problem and not options.join:
        raise _refusal(ordered, parts, problem)
    _refuse_others(ordered, parts)
    return _part(_named(_joined(ordered, parts, problem), ordered), options)


def _part(recording: Recording, options: ReadOptions) -> Recording:
    """Return the requested part of a joined recording."""
    return recording.between(options.skip_s, options.end_s) if options.is_part else recording


def _of_sensors(paths: Sequence[Path], options: ReadOptions) -> Recording | None:
    """Read texts with one sensor each as one recording; None for other texts.

    Raises ChoiceError if one contains only times.
    """
    with TextLog(Path(", ".join(map(str, paths))), options) as log:
        try:
            log.open_files(paths)
            choices = [whole(candidate, "one file per sensor") for candidate in candidates_of(log, options)]
        except ImucalError as error:
            if error.code == ONLY_TIMES:
                raise
            return None
        sensors = [sensor.triad.sensor for choice in choices for sensor in choice.plan.sensors]
        if not len(sensors) == len(set(sensors)) == len(paths):
            return None
        return assemble(log, choices, options)


def _named(recording: Recording, paths: Sequence[Path]) -> Recording:
    return replace(recording, source=replace(recording.source, path=", ".join(map(str, paths))))


def _refusal(paths: Sequence[Path], parts: Sequence[Recording], problem: str) -> ChoiceError:
    rows = [_row(path, part) for path, part in zip(paths, parts, strict=True)][:_MAX_LISTED]
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ["  " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    lines += [f"  and {len(paths) - _MAX_LISTED} more"] if len(paths) > _MAX_LISTED else []
    listed = "\n".join(lines)
    return ChoiceError(
        f"{len(paths)} logs do not look like one recording: {problem}; found\n{listed}",
        place=paths[0],
        fixes=[
            Fix(
                "expected parts that each continue the one before; read one log at a time, such as "
                f"{paths[0]}"
            ),
            Fix("state that they are parts of one recording", "join"),
        ],
    )


def _row(path: Path, part: Recording) -> tuple[str, str, str, str]:
    span, series = span_ns(part.series), part.series[0]
    frame = part.source.values.get("frame")
    topics = ", ".join(part.source.topics) if part.source.message_types else part.source.format
    amount = f"{series.duration_s:.4g} s at {series.rate_hz:.4g} Hz"
    what = f"{topics}, frame {frame}" if frame else topics
    return path.name, _when(span[0]) if span else "no stamps", amount, what


def _when(ns: int) -> str:
    from datetime import UTC, datetime

    if ns < _NO_DATE:
        return f"from {ns / 1e9:.6g} s"
    try:
        return datetime.fromtimestamp(ns / 1e9, tz=UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (ValueError, OverflowError, OSError):
        return f"from {ns / 1e9:.6g} s"


def _refuse_others(paths: Sequence[Path], parts: Sequence[Recording]) -> None:
    names = [[series.name for series in part.series] for part in parts]
    if any(row != names[0] for row in names):
        rows = zip(paths, names, strict=True)
        found = "; ".join(f"{path}: {', '.join(row)}" for path, row in rows)
        text = f"the logs have different axes ({found}); expected one recording"
        raise ChoiceError(text, fix=Fix("read one log at a time"))
    for path, part in zip(paths, parts, strict=True):
        for series, first in zip(part.series, parts[0].series, strict=True):
            if abs(series.rate_hz / first.rate_hz - 1) > _SAME_RATE:
                text = (
                    f"its rate is {series.rate_hz:.6g} Hz, and {paths[0]} has {first.rate_hz:.6g} Hz; "
                    "expected one recording"
                )
                raise ChoiceError(text, place=path, fix=Fix("read one log at a time"))


def _joined(paths: Sequence[Path], parts: Sequence[Recording], problem: str) -> Recording:
    """Join recordings axis by axis; a `problem` that the user overrides becomes a warning."""
    columns: list[tuple[AxisSeries, ...]] = list(zip(*(part.series for part in parts), strict=True))
    # Axes that share clocks share the joined clock.
    clocks: dict[tuple[int, ...], Clock] = {}
    in_order = not overlap([path.name for path in paths], parts)
    series = []
    for column in columns:
        samples = np.concatenate([one.samples for one in column])
        own = [one.clock for one in column]
        clock = clocks.setdefault(tuple(map(id, own)), _clock(own, in_order=in_order))
        series.append(replace(column[0], samples=samples, clock=clock))
    text = f"{len(paths)} logs are joined as one recording: {', '.join(path.name for path in paths)}."
    if problem:
        text += f" They were joined as requested, although {problem}."
        text += "" if in_order else " They are joined in the given order, not by their time stamps."
    return replace(
        parts[0],
        source=replace(parts[0].source, files=tuple(file for part in parts for file in part.source.files)),
        series=tuple(series),
        temperature=_temperature(parts, clocks, in_order=in_order),
        findings=(
            Finding("warning" if problem else "info", "joined", text),
            *dict.fromkeys(finding for part in parts for finding in part.findings),
        ),
    )


def _temperature(
    parts: Sequence[Recording], clocks: dict[tuple[int, ...], Clock], *, in_order: bool
) -> Temperature | None:
    found = [part.temperature for part in parts if part.temperature is not None]
    if len(found) != len(parts):
        return None
    own = [one.clock for one in found]
    clock = clocks.get(tuple(map(id, own))) or _clock(own, in_order=in_order)
    return Temperature(samples=np.concatenate([one.samples for one in found]), clock=clock)


def _clock(clocks: Sequence[Clock], *, in_order: bool) -> Clock:
    """Join the clocks of parts on one grid; parts that overlap are placed one sample apart.

    Each part is placed relative to the end of the previous one, so errors of the rate do not accumulate.
    """
    total = sum(clock.grid_size for clock in clocks)
    tau = sum(clock.tau0 * clock.grid_size for clock in clocks) / total
    segments: list[Segment] = []
    count, place = 0, 0
    end_ns: float | None = None
    for clock in clocks:
        if in_order and end_ns is not None and clock.start_ns is not None:
            place += max(0, round((clock.start_ns - end_ns) / 1e9 / tau))
        shift = place - clock.segments[0].offset
        for part in clock.segments:
            last, offset = segments[-1] if segments else None, part.offset + shift
            if last is not None and last.offset + last.size == offset:
                segments[-1] = replace(last, stop=part.stop + count)
            else:
                segments.append(Segment(part.start + count, part.stop + count, offset))
        count += clock.n
        place += clock.grid_size
        end_ns = None if clock.start_ns is None else clock.start_ns + clock.duration_s * 1e9
    return replace(clocks[0], rate_hz=1 / tau, segments=tuple(segments))
