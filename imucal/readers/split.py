"""Several files of one recording: joined, with gaps between them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from imucal.clock import Clock, Segment
from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.readers.containers.rosbag2_folder import natural
from imucal.readers.formats import Format, detect, load, load_opener
from imucal.readers.message_logs import read_logs
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables import read_many
from imucal.recording import AxisSeries, Recording

#: Two files of one recording may differ this much in their measured rates.
_SAME_RATE = 0.01


def read_all(paths: Sequence[Path], options: ReadOptions) -> Recording:
    """Read several files as one recording, in the order of their names.

    Files of messages are joined message by message; others file by file, by the time of their first
    samples.

    Raises
    ------
    ReadError
        If a file can't be read, or the files do not belong together.
    """
    ordered = sorted(paths, key=natural)
    formats = [detect(path) for path in ordered]
    if all(entry.messages for entry in formats):
        recording = _read_messages(ordered, formats, options)
    elif all(entry.name == "text" for entry in formats) and (found := read_many(ordered, options)):
        # A gyroscope's file and an accelerometer's, perhaps with one of their times.
        recording = found
    else:
        recording = _joined([load(f).read(p, options) for p, f in zip(ordered, formats, strict=True)])
    names = ", ".join(str(path) for path in ordered)
    return replace(recording, source=replace(recording.source, path=names))


def _read_messages(paths: Sequence[Path], formats: Sequence[Format], options: ReadOptions) -> Recording:
    containers = []
    try:
        for path, entry in zip(paths, formats, strict=True):
            containers += load_opener(entry).open_files(path)[0]
    except BaseException:
        for container in containers:
            container.close()
        raise
    return read_logs(containers, paths[0], options, form=containers[0].format)


def _joined(parts: Sequence[Recording]) -> Recording:
    """Join recordings axis by axis, in the order of their first samples."""
    if all(_start(part) is not None for part in parts):
        parts = sorted(parts, key=lambda part: _start(part) or 0)
    names = [[series.name for series in part.series] for part in parts]
    if any(row != names[0] for row in names):
        rows = zip(parts, names, strict=True)
        found = "; ".join(f"{part.source.path}: {', '.join(row)}" for part, row in rows)
        msg = f"the files hold different axes ({found}); expected files of one recording"
        raise ReadError(msg)
    text = f"{len(parts)} files are joined as one recording."
    joined = Finding(level="info", code="joined", text=text)
    return replace(
        parts[0],
        series=tuple(_axis([part.series[i] for part in parts], parts) for i in range(len(names[0]))),
        temperature=None,
        findings=(joined, *(finding for part in parts for finding in part.findings)),
    )


def _start(part: Recording) -> int | None:
    return part.series[0].clock.start_ns


def _axis(series: Sequence[AxisSeries], parts: Sequence[Recording]) -> AxisSeries:
    clocks = [one.clock for one in series]
    first = clocks[0]
    for clock, part in zip(clocks, parts, strict=True):
        if abs(clock.rate_hz / first.rate_hz - 1) > _SAME_RATE:
            msg = (
                f"{part.source.path}: its rate is {clock.rate_hz:.6g} Hz, that of {parts[0].source.path} "
                f"{first.rate_hz:.6g} Hz; expected files of one recording"
            )
            raise ReadError(msg)
    samples = np.concatenate([one.samples for one in series])
    return replace(series[0], samples=samples, clock=_clock(clocks))


def _clock(clocks: Sequence[Clock]) -> Clock:
    """Put the clocks of several files on one grid; files without stamps are one sample apart."""
    total = sum(clock.grid_size for clock in clocks)
    tau = sum(clock.tau0 * clock.grid_size for clock in clocks) / total
    segments: list[Segment] = []
    count, offset = 0, 0
    for clock in clocks:
        if clock.start_ns is not None and clocks[0].start_ns is not None:
            offset = max(offset, round((clock.start_ns - clocks[0].start_ns) / 1e9 / tau))
        elif segments:
            offset += 1
        base = clock.segments[0].offset
        segments += [
            Segment(start=s.start + count, stop=s.stop + count, offset=s.offset - base + offset)
            for s in clock.segments
        ]
        count += clock.n
        offset += clock.grid_size
    return replace(clocks[0], rate_hz=1 / tau, segments=tuple(segments))
