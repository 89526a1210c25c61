"""Several files of one recording: joined, with gaps between them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from imucal.clock import Clock, Segment
from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.readers.assemble import read_logs
from imucal.readers.containers.container import Container
from imucal.readers.containers.mcap_file import McapFile
from imucal.readers.containers.ros1_file import BagFile
from imucal.readers.containers.ros2_bag import open_files
from imucal.readers.containers.rosbag2_folder import natural
from imucal.readers.formats import detect, load
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
    if all(entry.name in {"mcap", "ROS 1 bag", "ROS 2 bag"} for entry in formats):
        containers: list[Container] = []
        try:
            for path, entry in zip(ordered, formats, strict=True):
                containers += _open(path, entry.name)
        except BaseException:
            for container in containers:
                container.close()
            raise
        recording = read_logs(containers, ordered[0], options)
    elif all(entry.name == "text" for entry in formats) and (found := read_many(ordered, options)):
        # A gyroscope's file and an accelerometer's, perhaps with one of their times.
        recording = found
    else:
        recording = _joined([load(f).read(p, options) for p, f in zip(ordered, formats, strict=True)])
    names = ", ".join(str(path) for path in ordered)
    return replace(recording, source=replace(recording.source, path=names))


def _open(path: Path, name: str) -> list[Container]:
    if name == "mcap":
        return [McapFile(path)]
    return [BagFile(path)] if name == "ROS 1 bag" else open_files(path)


def _joined(parts: Sequence[Recording]) -> Recording:
    """Join recordings axis by axis, in the order of their first samples."""
    starts = [part.series[0].clock.start_ns for part in parts]
    if all(start is not None for start in starts):
        order = sorted(range(len(parts)), key=lambda i: starts[i] or 0)
        parts = [parts[i] for i in order]
    names = [[series.name for series in part.series] for part in parts]
    if any(row != names[0] for row in names):
        found = "; ".join(
            f"{part.source.path}: {', '.join(row)}" for part, row in zip(parts, names, strict=True)
        )
        msg = f"the files hold different axes ({found}); expected files of one recording"
        raise ReadError(msg)
    series = tuple(_axis([part.series[i] for part in parts], parts) for i in range(len(names[0])))
    text = f"{len(parts)} files are joined as one recording."
    joined = Finding(level="info", code="joined", text=text)
    findings = (joined, *(finding for part in parts for finding in part.findings))
    return replace(parts[0], series=series, temperature=None, findings=findings)


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
    count, place = 0, 0
    for clock in clocks:
        if clock.start_ns is not None and clocks[0].start_ns is not None:
            place = max(place, round((clock.start_ns - clocks[0].start_ns) / 1e9 / tau))
        elif segments:
            place += 1
        base = clock.segments[0].offset
        segments += [
            Segment(start=s.start + count, stop=s.stop + count, offset=s.offset - base + place)
            for s in clock.segments
        ]
        count += clock.n
        place += clock.grid_size
    return replace(clocks[0], rate_hz=1 / tau, segments=tuple(segments))
