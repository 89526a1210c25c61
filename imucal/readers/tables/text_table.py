"""One text table: layout, columns, rows -> Recording."""

import io
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from imucal.arrays import FloatArray
from imucal.errors import DataError, ReadError
from imucal.findings import Finding
from imucal.readers.compression import keep_freed_memory
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.column_plan import SensorPlan, TablePlan, make_plan
from imucal.readers.tables.dates import text_kind
from imucal.readers.tables.layout import Rows, TextLayout, rows_of_tag
from imucal.readers.tables.line_splits import split_line
from imucal.readers.tables.row_blocks import BlockReader, Kind, RowCounts, without_start
from imucal.readers.tables.scales import Work
from imucal.readers.tables.table_clock import SensorColumns
from imucal.readers.tables.tabular import assemble
from imucal.readers.tables.text import TextSource
from imucal.readers.tables.text_layout import lay_out
from imucal.readers.tables.timing import TimeChoice
from imucal.recording import Recording
from imucal.resources import column_limit

_INTEGER = re.compile(r"[+-]?\d{1,20}")

#: The index of times that stand in a file of their own.
EXTERNAL = -1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExternalTime:
    """The times of a table's rows, shape (n,), from the file at `path`; `choice` has the index `EXTERNAL`."""

    path: str
    choice: TimeChoice
    values: FloatArray

    def replace_times(self, plan: TablePlan) -> TablePlan:
        """Return a plan in which these are the times of all sensors."""
        sensors = tuple(replace(sensor, time=self.choice, log_time=None) for sensor in plan.sensors)
        return replace(plan, sensors=sensors)

    def of_rows(self, counts: RowCounts, path: str) -> FloatArray:
        """Return the times; a ReadError unless there is one for each row."""
        if counts.bad or counts.good != self.values.size:
            msg = (
                f"{self.path}: {self.values.size} times for the {counts.good} good and {counts.bad} bad rows "
                f"of {path}; expected one time for each row"
            )
            raise ReadError(msg)
        return self.values


def read_table(
    source: TextSource, options: ReadOptions, *, name: str = "", stamps: ExternalTime | None = None
) -> Recording:
    """Read the table of an opened text.

    `name` is the file's own, which may name the sensor; `stamps` are times of the rows that stand in a
    file of their own.

    Raises
    ------
    ChoiceError
        If columns, units or time are not clear.
    ReadError
        If it is no table.
    DataError
        If it holds no samples.
    """
    # The blocks of text are as large as its chunks: freed, they are to be used again.
    keep_freed_memory()
    layout, plan = plan_of_head(source, options, name)
    if stamps is not None:
        plan = stamps.replace_times(plan)
    groups = _by_rows(plan)
    readers = [_reader(source, layout, plan, group, options) for group in groups]
    cut = _read_blocks(source, layout, readers)
    if options.strict and source.findings:
        msg = f"{source.name}: {source.findings[0].text} Expected an undamaged log"
        raise ReadError(msg)
    findings = _row_findings(source.name, cut, layout, readers, options)
    sensors = []
    for reader, group in zip(readers, groups, strict=True):
        values = {index: column.take() for index, column in reader.columns.items()}
        if stamps is not None:
            values[EXTERNAL] = stamps.of_rows(reader.counts, source.name)
        if reader.counts.good:
            sensors += [_columns(reader, sensor, values, plan.temperature) for sensor in group]
    if not sensors:
        msg = f"{source.name}: the table has no rows of its sensors; expected a row per sample"
        raise DataError(msg)
    work = Work(
        path=source.name,
        options=options,
        dialect=plan.dialect,
        rate_hz=layout.rate_hz,
        decisions=[*plan.decisions],
        findings=[*source.findings, *findings, *plan.findings],
    )
    return assemble(work, sensors, "csv", plan.topics)


def read_head(path: str, lines: Sequence[str], options: ReadOptions, name: str) -> Recording:
    """Read the table that the first lines of a text hold, as `read_table` would read all of it."""
    text = io.BytesIO(("\n".join(lines) + "\n").encode())
    with TextSource(path, text, size=None, progress=None) as source:
        return read_table(source, options, name=name)


def plan_of_head(source: TextSource, options: ReadOptions, name: str = "") -> tuple[TextLayout, TablePlan]:
    """Return the layout and the columns of a text from its first lines; its name may name the sensor.

    A ChoiceError where columns are not clear, a ReadError where it is no table.
    """
    layout = lay_out(source.name, source.head, options)
    plan = make_plan(
        source.name,
        layout.headers or ("",) * layout.width,
        layout.cells,
        options,
        units=layout.units,
        preamble=layout.preamble,
        name=name,
    )
    return layout, plan


def _by_rows(plan: TablePlan) -> list[list[SensorPlan]]:
    """Return the sensors in groups that are read from the same rows."""
    groups: dict[Rows, list[SensorPlan]] = {}
    for sensor in plan.sensors:
        groups.setdefault(sensor.triad.rows, []).append(sensor)
    return list(groups.values())


def _reader(
    source: TextSource,
    layout: TextLayout,
    plan: TablePlan,
    sensors: Sequence[SensorPlan],
    options: ReadOptions,
) -> BlockReader:
    """Return the reader of one group's rows."""
    rows = sensors[0].triad.rows or layout.tag
    layout = _of_rows(source.head, layout, rows)
    kinds: dict[int, Kind] = {}
    by_day = False
    for sensor in sensors:
        kinds |= dict.fromkeys(sensor.triad.indices, "float")
        for time in (sensor.time, sensor.log_time):
            if time is not None and EXTERNAL not in time.indices:
                kinds |= {
                    index: _kind(layout.cells(index), text=time.kind == "text") for index in time.indices
                }
                by_day |= time.by_day
    needed = frozenset(index for index in kinds if all(layout.cells(index)))
    if plan.temperature is not None and plan.temperature not in kinds:
        kinds[plan.temperature] = "float"
    last = layout.width - 1
    # A row that lacks its last cell was cut, perhaps within a number that stands before it.
    if all(layout.cells(last)):
        needed |= {last}
    # Half of what may be held is for what the columns become.
    limit = (options.memory_limit or column_limit()) // (2 * max(1, len(kinds)))
    return BlockReader(
        layout=layout,
        kinds=kinds,
        needed=needed,
        rows=rows,
        limit=limit,
        expected=source.expected_rows,
        by_day=by_day,
    )


def _of_rows(lines: Sequence[str], layout: TextLayout, rows: Rows) -> TextLayout:
    """Return the layout of some of the rows: tagged rows differ in width."""
    if rows is None or rows == layout.tag:
        return layout
    lines = rows_of_tag(lines[layout.start :], layout.delimiter, rows)
    cells = [tuple(split_line(line, layout.delimiter)) for line in lines]
    if not cells:
        return layout
    width = Counter(len(row) for row in cells).most_common(1)[0][0]
    same = tuple(row for row in cells if len(row) == width)
    return replace(layout, width=width, rows=same)


def _kind(cells: Sequence[str], *, text: bool) -> Kind:
    if text:
        return text_kind(cells)
    filled = [cell.strip("\"'") for cell in cells if cell]
    integers = bool(filled) and all(_INTEGER.fullmatch(cell) for cell in filled)
    return "integer" if integers and all(-(2**63) <= int(cell) < 2**63 for cell in filled) else "float"


def _read_blocks(source: TextSource, layout: TextLayout, readers: Sequence[BlockReader]) -> str:
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


def _is_complete(line: bytes, layout: TextLayout) -> bool:
    """Return whether a line without an end has all its cells, the last one as long as any other."""
    cells = split_line(line.decode("utf-8", "replace"), layout.delimiter)
    if len(cells) != layout.width:
        return False
    lengths = [len(cell.partition(".")[2]) for cell in layout.cells(layout.width - 1)]
    point = layout.decimal
    return point in cells[-1] and len(cells[-1].partition(point)[2]) >= max(lengths, default=0)


def _row_findings(
    path: str, cut: str, layout: TextLayout, readers: Sequence[BlockReader], options: ReadOptions
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
    if cut and options.strict:
        msg = f"{path}: the last line has no line end and may be cut ({cut[:60]!r}); expected whole lines"
        raise ReadError(msg)
    if cut:
        text = f"The last line has no line end and may be cut ({cut[:60]!r}); it was dropped."
        findings.append(Finding(level="info", code="cut-line", text=text))
    return findings


def _columns(
    reader: BlockReader, sensor: SensorPlan, values: dict[int, Any], temperature: int | None
) -> SensorColumns:
    return SensorColumns(
        plan=sensor,
        axes=[values[index] for index in sensor.triad.indices],
        time=tuple(values[index] for index in sensor.time.indices) if sensor.time else (),
        log_time=tuple(values[index] for index in sensor.log_time.indices) if sensor.log_time else (),
        temperature=values.get(temperature) if temperature is not None else None,
        sparse=not set(sensor.triad.indices) <= reader.needed,
    )
