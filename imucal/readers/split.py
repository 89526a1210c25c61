"""Several logs as one recording: joined where they are its parts, refused where they may be anything else."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from imucal.clock import Clock, Segment
from imucal.errors import ChoiceError
from imucal.findings import Finding
from imucal.readers.column_store import join_rows
from imucal.readers.containers.rosbag2_folder import natural
from imucal.readers.formats import detect, load
from imucal.readers.join_checks import overlap, span_ns, why_not_one
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables import read_many
from imucal.recording import AxisSeries, Recording, Temperature
from imucal.resources import column_limit

#: Two parts of one recording may differ this much in their measured rates.
_SAME_RATE = 0.01
#: Logs that a message lists.
_MOST = 12
#: Stamps before this, 1 January 1980 in ns, count from the start of a computer or a sensor: no date.
_NO_DATE = 315_532_800_000_000_000


def read_all(paths: Sequence[Path], options: ReadOptions) -> Recording:
    """Read several logs as one recording, in the order of their times.

    Raises
    ------
    ReadError
        If a log can't be read.
    ChoiceError
        If the logs are not parts of one recording: they overlap in time, differ in topic, frame or scale,
        or nothing says that one goes on where another ends. With `ReadOptions.join` only logs of other
        axes or rates are refused.
    """
    ordered = sorted(paths, key=natural)
    formats = [detect(path) for path in ordered]
    if all(entry.name == "text" for entry in formats) and (found := read_many(ordered, options)):
        # A gyroscope's file and an accelerometer's, perhaps with one of their times.
        return _named(found, ordered)
    # Half of what may be held is for the parts, half for what they become.
    limit = options.memory_limit or column_limit()
    part_options = replace(options, memory_limit=max(1, limit // (2 * len(ordered))))
    parts = [load(f).read(path, part_options) for path, f in zip(ordered, formats, strict=True)]
    ordered, parts = _in_time_order(ordered, parts)
    problem = why_not_one(ordered, parts)
    if problem and not options.join:
        raise _refusal(ordered, parts, problem)
    _refuse_others(ordered, parts)
    return _named(_joined(ordered, parts, problem, limit // 2), ordered)


def _named(recording: Recording, paths: Sequence[Path]) -> Recording:
    return replace(recording, source=replace(recording.source, path=", ".join(map(str, paths))))


def _in_time_order(paths: Sequence[Path], parts: Sequence[Recording]) -> tuple[list[Path], list[Recording]]:
    """Return logs in the order of their first samples; in the given one where some have no stamps."""
    spans = [span_ns(part) for part in parts]
    order = sorted(range(len(parts)), key=lambda i: (spans[i] or (0,))[0] if all(spans) else i)
    return [paths[i] for i in order], [parts[i] for i in order]


def _refusal(paths: Sequence[Path], parts: Sequence[Recording], problem: str) -> ChoiceError:
    rows = [_row(path, part) for path, part in zip(paths, parts, strict=True)][:_MOST]
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = ["  " + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    lines += [f"  and {len(paths) - _MOST} more"] if len(paths) > _MOST else []
    listed = "\n".join(lines)
    return ChoiceError(
        f"{paths[0]}: {len(paths)} logs are not seen to be one recording: {problem}; found\n{listed}\n"
        f"expected parts of which each goes on where the one before ends; read one log at a time, such as "
        f"{paths[0]}, or say that they are parts of one recording"
    )


def _row(path: Path, part: Recording) -> tuple[str, str, str, str]:
    """Return a log as its name, when it was recorded, how much of it there is, and what was read."""
    span, series = span_ns(part), part.series[0]
    frame = dict(part.source.decisions).get("frame")
    topics = ", ".join(part.source.topics) if part.source.message_types else part.source.format
    what = topics + (f", frame {frame}" if frame else "")
    amount = f"{series.duration_s:.4g} s at {series.rate_hz:.4g} Hz"
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
    """Refuse logs that can't be joined at all: of different axes or rates."""
    names = [[series.name for series in part.series] for part in parts]
    if any(row != names[0] for row in names):
        rows = zip(paths, names, strict=True)
        found = "; ".join(f"{path}: {', '.join(row)}" for path, row in rows)
        msg = f"the logs hold different axes ({found}); expected one recording; read one log at a time"
        raise ChoiceError(msg)
    for path, part in zip(paths, parts, strict=True):
        for series, first in zip(part.series, parts[0].series, strict=True):
            if abs(series.rate_hz / first.rate_hz - 1) > _SAME_RATE:
                msg = (
                    f"{path}: its rate is {series.rate_hz:.6g} Hz, that of {paths[0]} "
                    f"{first.rate_hz:.6g} Hz; expected one recording; read one log at a time"
                )
                raise ChoiceError(msg)


def _joined(paths: Sequence[Path], parts: Sequence[Recording], problem: str, limit: int) -> Recording:
    """Join recordings axis by axis, one behind the other; a `problem` is said, as the user knows better."""
    columns: list[tuple[AxisSeries, ...]] = list(zip(*(part.series for part in parts), strict=True))
    # One clock is one object: axes that share the clocks of their parts share the joined one.
    clocks: dict[tuple[int, ...], Clock] = {}
    in_order = not overlap([path.name for path in paths], parts)
    for column in columns:
        own = [series.clock for series in column]
        clocks.setdefault(tuple(map(id, own)), _clock(own, in_order=in_order))
    rows = join_rows([[series.samples for series in column] for column in columns], limit=limit)
    series = tuple(
        replace(column[0], samples=samples, clock=clocks[tuple(id(one.clock) for one in column)])
        for column, samples in zip(columns, rows, strict=True)
    )
    return replace(
        parts[0],
        series=series,
        temperature=_temperature(parts, clocks, in_order=in_order),
        findings=(
            _how(paths, problem, in_order=in_order),
            *dict.fromkeys(finding for part in parts for finding in part.findings),
        ),
    )


def _how(paths: Sequence[Path], problem: str, *, in_order: bool) -> Finding:
    """Return the finding that says what was joined, and what spoke against it."""
    names = ", ".join(path.name for path in paths)
    text = f"{len(paths)} logs are joined as one recording: {names}."
    if not problem:
        return Finding(level="info", code="joined", text=text)
    place = "" if in_order else " They stand one behind the other, whatever their stamps say."
    text = f"{text} They were said to be its parts, though {problem}.{place}"
    return Finding(level="warning", code="joined", text=text)


def _temperature(
    parts: Sequence[Recording], clocks: dict[tuple[int, ...], Clock], *, in_order: bool
) -> Temperature | None:
    """Return the temperature of all parts, where each has one."""
    found = [part.temperature for part in parts if part.temperature is not None]
    if len(found) != len(parts):
        return None
    own = [one.clock for one in found]
    clock = clocks.get(tuple(map(id, own))) or _clock(own, in_order=in_order)
    (samples,) = join_rows([[one.samples for one in found]])
    return Temperature(samples=samples, clock=clock)


def _clock(clocks: Sequence[Clock], *, in_order: bool) -> Clock:
    """Put the clocks of several parts on one grid; parts without order in time are one sample apart.

    A part's place is that of its first stamp behind the last one of the part before, so that nothing adds
    up where the rate drifts.
    """
    total = sum(clock.grid_size for clock in clocks)
    tau = sum(clock.tau0 * clock.grid_size for clock in clocks) / total
    segments: list[Segment] = []
    count, place = 0, 0
    end_ns: float | None = None
    for clock in clocks:
        if in_order and end_ns is not None and clock.start_ns is not None:
            place += max(0, round((clock.start_ns - end_ns) / 1e9 / tau))
        base = clock.segments[0].offset
        segments += [
            Segment(start=s.start + count, stop=s.stop + count, offset=s.offset - base + place)
            for s in clock.segments
        ]
        count += clock.n
        place += clock.grid_size
        # The next sample is due here.
        end_ns = None if clock.start_ns is None else clock.start_ns + clock.duration_s * 1e9
    return replace(clocks[0], rate_hz=1 / tau, segments=_merged(segments))


def _merged(segments: Sequence[Segment]) -> tuple[Segment, ...]:
    """Return segments of which none starts where the one before ends."""
    merged: list[Segment] = []
    for segment in segments:
        last = merged[-1] if merged else None
        if last is not None and last.offset + last.size == segment.offset:
            merged[-1] = replace(last, stop=segment.stop)
        else:
            merged.append(segment)
    return tuple(merged)
