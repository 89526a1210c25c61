"""Delimited text: CSV, TSV, blanks; plain or compressed; a file, standard input, or an app's zip of files.

The head gives the layout, the names of the columns give the sensors, and blocks of rows go through
polars into columns. In doubt nothing is guessed: the error shows the columns and a text to choose them.
"""

import re
from collections.abc import Sequence
from pathlib import Path, PurePath
from typing import Any

from imucal.errors import ChoiceError, DataError, ImucalError, ReadError
from imucal.findings import Finding
from imucal.readers.tabular import SensorColumns, assemble
from imucal.readers.blocks import BlockReader, Kind, without_start
from imucal.readers.columns import Rows
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.growing import default_memory_limit
from imucal.readers.layout import Layout, find_layout, split_line
from imucal.readers.options import ReadOptions
from imucal.readers.plan import SensorPlan, TablePlan, make_plan
from imucal.readers.text import TextSource, open_text
from imucal.recording import Recording, Source

__all__ = ["describe", "read"]

_INTEGER = re.compile(r"[+-]?\d{1,20}")


def read(path: Path, options: ReadOptions) -> Recording:
    """Read a text table.

    Raises
    ------
    ChoiceError
        If columns, units or time are not clear.
    ReadError
        If it can't be opened, or is no table.
    DataError
        If it holds no samples.
    """
    with open_text(path, progress=options.progress) as source:
        return read_source(source, options)


def read_source(source: TextSource, options: ReadOptions, *, name: str = "") -> Recording:
    """Read the table of an opened text; `name` is the file's own name, which may name the sensor."""
    layout = _layout(source, options)
    plan = _plan(source.name, layout, options, name or PurePath(source.name).name)
    groups = _by_rows(plan)
    readers = [_reader(layout, plan, group, options) for group in groups]
    cut = _read_blocks(source, layout, readers)
    findings = [*source.findings, *_row_findings(source.name, cut, layout, readers, options)]
    sensors = []
    for reader, group in zip(readers, groups, strict=True):
        values = {place: column.take() for place, column in reader.columns.items()}
        sensors += [
            _columns(reader, sensor, values, plan.temperature) for sensor in group if reader.counts.good
        ]
    if not sensors:
        msg = f"{source.name}: the table has no rows of its sensors; expected a row per sample"
        raise DataError(msg)
    return assemble(
        Source(
            path=source.name,
            format="csv",
            topics=tuple(plan.headers[place] for s in plan.sensors for place in s.triad.places),
            decisions=plan.decisions,
        ),
        sensors,
        options,
        signature=plan.signature,
        rate_hz=layout.rate_hz,
        findings=findings,
    )


def describe(path: Path, options: ReadOptions) -> LogContents:
    """Return the table a text holds: its columns, units, rate and what it gives."""
    size = path.stat().st_size if path.is_file() else None
    with open_text(path) as source:
        compression = source.compression
        layout = find_layout(source.head)
    if size is not None and size <= _SMALL:
        return _described_by_reading(path, options, size, compression, layout)
    return _described_by_head(path, options, size, compression, layout)


#: Files up to this size are read to be described: they take less than half a second.
_SMALL = 64 << 20


def _described_by_reading(
    path: Path, options: ReadOptions, size: int, compression: str, layout: Layout | None
) -> LogContents:
    try:
        recording = read(path, options)
    except ImucalError as error:
        topic = TopicContents(name=path.name, type="table", count=None, note=str(error))
        return LogContents(
            path=str(path), format="csv", size_bytes=size, topics=(topic,), compression=compression
        )
    first = recording.series[0]
    sensors = tuple(dict.fromkeys(series.sensor for series in recording.series))
    note = "; ".join(f"{what}: {how}" for what, how in recording.source.decisions)
    kind = next(
        (how.partition(",")[0] for what, how in recording.source.decisions if what == "layout"), "table"
    )
    topic = TopicContents(
        name=path.name,
        type=kind,
        count=first.n,
        rate_hz=first.rate_hz,
        duration_s=first.duration_s,
        sensors=sensors,
        note=note,
    )
    return LogContents(
        path=str(path),
        format="csv",
        size_bytes=size,
        topics=(topic,),
        start_ns=first.clock.start_ns,
        duration_s=first.duration_s,
        compression=compression,
        findings=recording.findings,
    )


def _described_by_head(
    path: Path, options: ReadOptions, size: int | None, compression: str, layout: Layout | None
) -> LogContents:
    name = path.name
    if layout is None:
        topic = TopicContents(name=name, type="text", note="no rows of numbers")
        return LogContents(
            path=str(path), format="csv", size_bytes=size, topics=(topic,), compression=compression
        )
    try:
        plan = _plan(str(path), layout, options, name)
    except ImucalError as error:
        topic = TopicContents(name=name, type="table", note=str(error))
    else:
        kind = plan.signature.name if plan.signature else "table"
        note = "; ".join(f"{what}: {how}" for what, how in plan.decisions)
        sensors = tuple(sensor.triad.sensor for sensor in plan.sensors)
        topic = TopicContents(name=name, type=kind, rate_hz=layout.rate_hz, sensors=sensors, note=note)
    return LogContents(
        path=str(path), format="csv", size_bytes=size, topics=(topic,), compression=compression
    )


def _layout(source: TextSource, options: ReadOptions) -> Layout:
    layout = find_layout(source.head)
    if layout is None:
        first = next((line.strip() for line in source.head if line.strip()), "")
        msg = (
            f"{source.name}: no rows of three numbers or more, the first line is {first[:80]!r}; "
            "expected a table with a row per sample"
        )
        raise ReadError(msg)
    if layout.mismatch is not None and options.columns is None:
        msg = (
            f"{source.name}: the header has {layout.mismatch} names and the rows {layout.width} cells, so no name "
            f"belongs to a column; found the row {', '.join(layout.rows[0][:40])}; correct the header, or say which "
            "columns are which by a columns text such as t=0,g=1:4,a=4:7 (places from 0 with the end left out)"
        )
        raise ChoiceError(msg)
    return layout


def _plan(path: str, layout: Layout, options: ReadOptions, name: str) -> TablePlan:
    headers = layout.headers or ("",) * layout.width
    return make_plan(
        path, headers, layout.cells, options, units=layout.units, preamble=layout.preamble, name=name
    )


def _by_rows(plan: TablePlan) -> list[list[SensorPlan]]:
    """Return the sensors in groups that are read from the same rows."""
    groups: dict[Rows, list[SensorPlan]] = {}
    for sensor in plan.sensors:
        groups.setdefault(sensor.triad.rows, []).append(sensor)
    return list(groups.values())


def _reader(
    layout: Layout, plan: TablePlan, sensors: Sequence[SensorPlan], options: ReadOptions
) -> BlockReader:
    """Return the reader of one group's rows."""
    kinds: dict[int, Kind] = {}
    for sensor in sensors:
        kinds |= dict.fromkeys(sensor.triad.places, "float")
        for time in (sensor.time, sensor.log_time):
            if time is not None:
                kinds |= {
                    place: _kind(layout.cells(place), text=time.kind == "text") for place in time.places
                }
    needed = frozenset(place for place in kinds if all(layout.cells(place)))
    if plan.temperature is not None and plan.temperature not in kinds:
        kinds[plan.temperature] = "float"
    last = layout.width - 1
    # A row that lacks its last cell was cut, perhaps within a number that stands before it.
    if sensors[0].triad.rows is None and all(layout.cells(last)):
        needed |= {last}
    limit = (options.memory_limit or default_memory_limit()) // max(1, len(kinds))
    return BlockReader(layout=layout, kinds=kinds, needed=needed, rows=sensors[0].triad.rows, limit=limit)


def _kind(cells: Sequence[str], *, text: bool) -> Kind:
    if text:
        return "text"
    filled = [cell.strip("\"'") for cell in cells if cell]
    integers = bool(filled) and all(_INTEGER.fullmatch(cell) for cell in filled)
    return "integer" if integers and all(-(2**63) <= int(cell) < 2**63 for cell in filled) else "float"


def _read_blocks(source: TextSource, layout: Layout, readers: Sequence[BlockReader]) -> str:
    """Read all rows; returns the last line where it may be cut, else an empty text."""
    cut = ""
    for block in without_start(source.blocks(), layout.start):
        whole = block
        if not block.endswith(b"\n"):
            end = block.rfind(b"\n") + 1
            last = block[end:]
            if last.strip() and not _is_complete(last, layout):
                cut, whole = last.decode("utf-8", "replace"), block[:end]
        for reader in readers:
            reader.add(whole)
    return cut


def _is_complete(line: bytes, layout: Layout) -> bool:
    """Return whether a line without an end has all its cells, the last one as long as any other."""
    cells = split_line(line.decode("utf-8", "replace"), layout.delimiter)
    if len(cells) != layout.width:
        return False
    lengths = [len(cell.partition(".")[2]) for cell in layout.cells(layout.width - 1)]
    point = layout.decimal
    return point in cells[-1] and len(cells[-1].partition(point)[2]) >= max(lengths, default=0)


def _row_findings(
    path: str, cut: str, layout: Layout, readers: Sequence[BlockReader], options: ReadOptions
) -> list[Finding]:
    """Return what was wrong with the rows; refuse a table of which hardly a row can be read."""
    findings = []
    good = sum(reader.counts.good for reader in readers)
    bad = sum(reader.counts.bad for reader in readers)
    first = next((reader.counts.first_bad for reader in readers if reader.counts.bad), "")
    if bad:
        found = f"{bad} of {good + bad} rows are no rows of {layout.width} numbers, the first is {first!r}"
        if options.strict or bad > good:
            msg = f"{path}: {found}; expected a table with a row per sample"
            raise ReadError(msg)
        text = f"{found}; they were dropped."
        findings.append(Finding(level="warning", code="bad-rows", text=text))
    if cut:
        text = f"The last line has no line end and may be cut ({cut[:60]!r}); it was dropped."
        findings.append(Finding(level="info", code="cut-line", text=text))
    return findings


def _columns(
    reader: BlockReader, sensor: SensorPlan, values: dict[int, Any], temperature: int | None
) -> SensorColumns:
    x, y, z = (values[place] for place in sensor.triad.places)
    return SensorColumns(
        plan=sensor,
        axes=(x, y, z),
        time=tuple(values[place] for place in sensor.time.places) if sensor.time else (),
        log_time=tuple(values[place] for place in sensor.log_time.places) if sensor.log_time else (),
        temperature=values.get(temperature) if temperature is not None else None,
        sparse=not set(sensor.triad.places) <= reader.needed,
    )
