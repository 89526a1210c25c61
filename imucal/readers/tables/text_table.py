"""Read delimited text (CSV, TSV, blanks) from a file, standard input, or several files.

The first lines determine the layout, and column names the sensors; polars parses blocks of rows. Each sensor
may have a file, also in the zip or folder of a phone app.
"""

import shlex
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path, PurePath
from typing import Any, BinaryIO, TypeAlias, cast

from imucal.errors import ChoiceError, DataError, Fix, ImucalError, ReadError, joined
from imucal.findings import Finding
from imucal.readers.builder import RecordingBuilder
from imucal.readers.compression import keep_freed_memory, most_unpacked
from imucal.readers.contents import LogContents
from imucal.readers.files import first_bytes, refused
from imucal.readers.foreign import CURVES, LOGGERS, TEXTS, advice_on
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.columns import ColumnsError, NamedTable
from imucal.readers.tables.dialects import find_json, name_columns
from imucal.readers.tables.file_sets import FileHead, chosen_files
from imucal.readers.tables.layout import (
    BLANKS,
    Rows,
    TextLayout,
    find_layout,
    is_number,
    rows_of_tag,
    split_line,
)
from imucal.readers.tables.names import Role
from imucal.readers.tables.plan import SensorPlan, TablePlan, make_plan
from imucal.readers.tables.stamps import TimeChoice
from imucal.readers.tables.tabular import (
    SensorColumns,
    assemble,
    contents_of,
    of_a_part,
    refuse_topics,
    with_more,
)
from imucal.readers.tables.text_blocks import BlockReader, Kind, kind_of
from imucal.readers.tables.text_source import STANDARD_INPUT, LongerError, TextSource, open_text
from imucal.recording import Recording, Sensor, span_ns
from imucal.resources import column_limit


def lay_out(path: str, lines: Sequence[str], options: ReadOptions) -> TextLayout:
    """Find the layout of a text.

    Raises ReadError if it has no rows of numbers, ChoiceError if its header does not fit them.
    """
    start = "\n".join(lines).encode()
    if advice := advice_on(start, CURVES if options.columns else (*CURVES, *LOGGERS)):
        raise refused(path, advice)
    if objects := find_json(lines):
        return objects
    layout = find_layout(lines)
    advice = advice_on(start, TEXTS)
    if layout is None or (advice and not layout.headers):
        first = next(filter(None, map(str.strip, lines)), "")
        expected = advice or "expected a table with a row per sample"
        raise refused(path, f"found no rows of numbers; the first line is {first[:80]!r}; {expected}")
    if not layout.headers and (advice := _other_rows(layout)):
        raise refused(path, advice)
    layout = name_columns(layout)
    if options.columns is None and not layout.headers:
        problem = f"the {layout.width} columns have no header"
        if layout.mismatch is not None:
            problem = f"the header has {layout.mismatch} names and the rows {layout.width} cells"
        raise NamedTable.of(path, [""] * layout.width, layout.cells).ask(problem)
    return layout


def _other_rows(layout: TextLayout) -> str:
    """Return advice for a table with a row per axis, or with two separators, or an empty text."""
    if layout.width > _MAX_COLUMNS and all(row and not is_number(row[0]) for row in layout.rows):
        return "it has a row for each axis, expected a row per sample; exchange its rows and columns"
    cells = [cell for row in layout.rows[:3] for cell in row]
    for other in ",;\t":
        several = any(sum(map(is_number, cell.split(other))) > 2 for cell in cells)
        if several and other != layout.delimiter != BLANKS:
            marks = f"{layout.delimiter!r} and {other!r}"
            return f"its rows contain two separators, {marks}; replace one by the other"
    return ""


#: A wider table has no row per sample.
_MAX_COLUMNS = 500
#: Longest text between two rows of a table, in bytes. Logs with messages between their rows have a row in
#: every few KB. A line that is no row costs 2 µs, so 200 MB of them would take a minute.
_MAX_WITHOUT_ROWS = 8 << 20
#: Longest compressed text of one repeated line, in bytes: a million rows, which take 2 s to read.
_MAX_REPEATED_TEXT = 32 << 20
#: Bytes of a line that an error shows.
_SHOWN = 60
#: Code of the error for a file without samples.
_ONLY_TIMES = "only-times"


def read_table(
    source: TextSource,
    options: ReadOptions,
    *,
    name: str = "",
    head: bool = False,
    trial: bool = False,
) -> Recording:
    """Read the table of an open text; only its first lines if `head`.

    The file `name` may contain the sensor. In a `trial` of proposed columns, an error proposes no others.
    Raises ChoiceError if columns, units or time are ambiguous, ReadError if the text is not a table, and
    DataError without samples.
    """
    keep_freed_memory()
    try:
        layout, plan = plan_of_head(source, options, name)
    except ColumnsError as error:
        if trial:
            raise
        tried = partial(read_table, source, name=name, head=True, trial=True)
        raise with_more(source.name, error, options, tried) from error
    groups: dict[Rows, list[SensorPlan]] = {}
    for sensor in plan.sensors:
        groups.setdefault(sensor.triad.rows, []).append(sensor)
    plans = [replace(plan, sensors=tuple(group)) for group in groups.values()]
    expected = 0 if head else source.expected_rows
    readers = [_reader(source.head, layout, part, options.memory_limit, expected) for part in plans]
    blocks = [("\n".join(source.head) + "\n").encode()] if head else source.blocks()
    cut = _read_blocks(source, blocks, layout, readers)
    findings = _row_findings(source, cut, layout, readers, strict=options.strict)
    sensors = []
    for reader, part in zip(readers, plans, strict=True):
        if reader.good:
            sensors += _columns(reader, part)
    if not sensors:
        advice = advice_on("\n".join(source.head).encode(), LOGGERS)
        text = f"the table has no rows of its sensors; {advice or 'expected a row per sample'}"
        raise refused(source.name, text, DataError)
    findings += plan.findings
    work = RecordingBuilder(
        path=source.name, format="csv", options=options, rate_hz=layout.rate_hz, findings=findings
    )
    try:
        assemble(work, [plan], sensors)
    except ChoiceError as error:
        if not source.findings:
            raise
        damage = [ChoiceError(finding.text, place=source.name) for finding in source.findings]
        raise joined(source.name, [error, *damage]) from error
    return work.build(topics=plan.topics)


def plan_of_head(source: TextSource, options: ReadOptions, name: str = "") -> tuple[TextLayout, TablePlan]:
    """Return layout and columns of a text, with the errors of `read_table`."""
    layout = lay_out(source.name, source.head, options)
    names = layout.headers or [""] * layout.width
    table = NamedTable.of(source.name, names, layout.cells, units=layout.units, preamble=layout.preamble)
    if all(column.role is Role.TIME for column in table.columns):
        pasted = f"paste -d , {shlex.quote(source.name)} SAMPLES > log.csv"
        raise refused(
            source.name,
            "it contains only times",
            ChoiceError,
            Fix(f"write them next to the samples, such as with {pasted}"),
            Fix("leave it out and give the sampling rate", "rate_hz", "HZ"),
            code=_ONLY_TIMES,
        )
    return layout, make_plan(table, options, name=name)


def _reader(
    lines: Sequence[str], layout: TextLayout, plan: TablePlan, limit: int | None, expected: int
) -> BlockReader:
    rows = plan.sensors[0].triad.rows
    layout = _of_rows(lines, layout, rows)
    kinds: dict[int, Kind] = {}
    times = [time for sensor in plan.sensors for time in (sensor.time, sensor.log_time) if time is not None]
    for sensor in plan.sensors:
        kinds |= dict.fromkeys(sensor.triad.indices, "float")
    for time in times:
        text = time.kind == "text"
        kinds |= {index: kind_of(layout.cells(index), text=text) for index in time.indices}
    # A row without its last cell was truncated, perhaps within a number.
    needed = frozenset(index for index in (*kinds, layout.width - 1) if all(layout.cells(index)))
    if plan.temperature is not None:
        kinds.setdefault(plan.temperature, "float")
    return BlockReader(
        layout=layout,
        kinds=kinds,
        needed=needed,
        rows=rows,
        # The other half is for the results.
        limit=(limit or column_limit()) // (2 * max(1, len(kinds))),
        expected=expected,
        by_day=any(time.by_day for time in times),
    )


def _of_rows(lines: Sequence[str], layout: TextLayout, rows: Rows) -> TextLayout:
    if rows is None:
        return layout
    lines = rows_of_tag(lines[layout.start :], layout.delimiter, rows)
    cells = [tuple(split_line(line, layout.delimiter)) for line in lines]
    if not cells:
        return layout
    width = Counter(map(len, cells)).most_common(1)[0][0]
    return replace(layout, width=width, rows=tuple(row for row in cells if len(row) == width))


def _read_blocks(
    source: TextSource, blocks: Iterable[bytes], layout: TextLayout, readers: Sequence[BlockReader]
) -> str:
    """Read all rows; return the last line if it may be truncated.

    Raises ReadError if a long part of the text has no rows.
    """
    cut, before = "", layout.start
    watch = _RowWatch(source, layout.width, lines=before)
    for block in blocks:
        *above, whole = block.split(b"\n", before) if before else [block]
        before -= len(above)
        if before:
            continue
        end = whole.rfind(b"\n") + 1
        last = whole[end:].decode("utf-8", "replace")
        if last.strip():
            # A complete line has all cells, and its last cell is as long as usual.
            cells, others = split_line(last, layout.delimiter), layout.cells(layout.width - 1)
            _, point, digits = cells[-1].partition(layout.decimal)
            longest = max((len(other.partition(".")[2]) for other in others), default=0)
            if len(cells) != layout.width or not point or len(digits) < longest:
                cut, whole = last, whole[:end]
        for reader in readers:
            reader.add(whole)
        watch.check(whole, readers)
    return cut


@dataclass(slots=True)
class _RowWatch:
    """Refuses a text with a long part that has no rows or, if it is compressed, repeats one line."""

    source: TextSource
    width: int
    lines: int = 0
    lines_with_rows: int = 0
    repeated: int = 0

    def check(self, block: bytes, readers: Sequence[BlockReader]) -> None:
        """Raise ReadError after too many bytes without a row; `readers` have read the block."""
        is_repeated = self.source.compression != "none" and _repeats_a_line(block)
        self.repeated = self.repeated + len(block) if is_repeated else 0
        without_rows = min(reader.bytes_without_rows for reader in readers)
        self.lines += block.count(b"\n")
        if not without_rows and not self.repeated:
            self.lines_with_rows = self.lines
        line = block.lstrip()[:_SHOWN].partition(b"\n")[0].decode("utf-8", "replace").strip()
        found = ""
        if without_rows > _MAX_WITHOUT_ROWS:
            found = f"have no row of {self.width} numbers, such as {line!r}; expected a row per sample"
        elif self.repeated > _MAX_REPEATED_TEXT:
            found = f"repeat the line {line!r}; expected samples that differ"
        if found:
            amount = max(without_rows, self.repeated) >> 20
            below = f"below line {self.lines_with_rows}, {amount} MiB"
            way = self.source.keep_lines(self.lines_with_rows)
            raise refused(self.source.name, f"{below} {found}; {way}")


def _repeats_a_line(block: bytes) -> bool:
    """Return whether all lines of a block are the same."""
    width = block.find(b"\n") + 1
    if not 0 < width < len(block) or block[:width] != block[width : 2 * width]:
        return False
    return block[width:] == block[:-width]


def _row_findings(
    source: TextSource, cut: str, layout: TextLayout, readers: Sequence[BlockReader], *, strict: bool
) -> list[Finding]:
    path, findings = source.name, [*source.findings]
    if strict and findings:
        raise refused(path, f"{findings[0].text} Expected an undamaged log")
    good, bad = sum(reader.good for reader in readers), sum(reader.bad for reader in readers)
    if bad:
        first = next(reader.first_bad for reader in readers if reader.bad)
        found = f"{bad} of {good + bad} rows are not {layout.width} numbers; the first is {first!r}"
        if strict or bad > good:
            raise refused(path, f"{found}; expected a table with a row per sample")
        findings.append(Finding("warning", "bad-rows", f"{found}; they were dropped."))
    if cut:
        found = f"last line has no line end and may be cut off ({cut[:60]!r})"
        if strict:
            raise refused(path, f"the {found}; expected whole lines")
        findings.append(Finding("info", "cut-line", f"The {found}; it was dropped."))
    return findings


def _columns(reader: BlockReader, plan: TablePlan) -> list[SensorColumns]:
    values: dict[Any, Any] = {index: column.take() for index, column in reader.columns.items()}

    def of(time: TimeChoice | None) -> tuple[Any, ...]:
        return tuple(values[index] for index in time.indices) if time else ()

    return [
        SensorColumns(
            plan=sensor,
            axes=[values[index] for index in sensor.triad.indices],
            time=of(sensor.time),
            log_time=of(sensor.log_time),
            temperature=values.get(plan.temperature),
            sparse=not reader.needed.issuperset(sensor.triad.indices),
        )
        for sensor in plan.sensors
    ]


_ZIP = b"PK\x03\x04"
_SUFFIXES = (".csv", ".tsv", ".txt")
#: Most text tables of a zip or folder: an app writes one per sensor; reading the head of one takes 1 ms.
_MAX_TABLES = 1000

#: Table name -> unpacked size, and function that opens it.
_Members: TypeAlias = dict[str, tuple[int, Callable[[], TextSource]]]


def is_set(path: Path) -> bool:
    """Return whether a path is a zip or a folder of text tables."""
    if path.is_dir():
        return any(entry.suffix.lower() in _SUFFIXES for entry in path.iterdir())
    with suppress(ReadError):
        return first_bytes(path, len(_ZIP)) == _ZIP
    return False


@contextmanager
def _members(path: Path) -> Iterator[_Members]:
    if path.is_dir():
        entries = sorted(entry for entry in path.iterdir() if entry.suffix.lower() in _SUFFIXES)
        _require_few(path, len(entries))
        yield {entry.name: (_size(entry), partial(open_text, entry)) for entry in entries}
        return
    packed = path.stat().st_size

    def opened(name: str) -> TextSource:
        return TextSource(f"{path}:{name}", cast("BinaryIO", archive.open(name)), packed=packed)

    try:
        with zipfile.ZipFile(path) as archive:
            tables = [
                info
                for info in archive.infolist()
                if info.filename.lower().endswith(_SUFFIXES) and not info.filename.startswith("__MACOSX")
            ]
            _require_few(path, len(tables))
            declared = sum(info.file_size for info in tables)
            if declared > most_unpacked(packed):
                found = f"its {packed} bytes declare {declared} bytes of tables"
                raise refused(
                    path, f"{found}; no recording is compressed so much, unpack it and look at them"
                )
            yield {info.filename: (info.file_size, partial(opened, info.filename)) for info in tables}
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, ValueError, RuntimeError) as error:
        text = f"the zip can't be read: {error}; expected the export of a phone's app"
        raise refused(path, text) from error


def _require_few(path: Path, tables: int) -> None:
    if tables > _MAX_TABLES:
        found = f"it contains {tables} tables of text"
        raise refused(
            path, f"{found}; expected one per sensor, at most {_MAX_TABLES}: give the files of the IMU"
        )


def _size(entry: Path) -> int:
    """Return the size of a file in bytes; 0 for a broken link, which is refused when it is opened."""
    try:
        return entry.stat().st_size
    except OSError:
        return 0


def _read_set(path: Path, options: ReadOptions, *, head: bool = False) -> Recording:
    with _members(path) as members:
        chosen = [*members]
        if len(members) != 1 or options.topics:
            files = {name: _head_of(name, opened, options) for name, (_, opened) in members.items()}
            chosen = [choice.topic.name for choice in chosen_files(path, files, options)]
        parts = []
        for name in chosen:
            with members[name][1]() as source:
                parts.append(read_table(source, options, name=PurePath(name).name, head=head))
        return merge(parts, chosen, str(path))


def _head_of(name: str, opened: Callable[[], TextSource], options: ReadOptions) -> FileHead:
    head = FileHead()
    try:
        with opened() as source:
            head = head._replace(header=next(iter(source.head), ""))
            _, plan = plan_of_head(source, options, PurePath(name).name)
    except ChoiceError:
        return head._replace(has_rows=True)
    except ReadError:
        return head
    return head._replace(has_rows=True, sensors=tuple(sensor.triad.sensor for sensor in plan.sensors))


def read_many(paths: Sequence[Path], options: ReadOptions) -> Recording | None:
    """Read files with one sensor each; None for other files.

    Raises ReadError if a file can't be read, ChoiceError if one has no samples.
    """
    sensors = []
    for path in paths:
        try:
            with open_text(path) as source:
                _, plan = plan_of_head(source, options, path.name)
        except ImucalError as error:
            if error.code == _ONLY_TIMES:
                raise
            return None
        sensors += [sensor.triad.sensor for sensor in plan.sensors]
    if not len(sensors) == len(set(sensors)) == len(paths):
        return None
    parts = []
    for path in paths:
        with open_text(path, progress=options.progress) as source:
            parts.append(read_table(source, options))
    return merge(parts, [path.name for path in paths], ", ".join(map(str, paths)))


def merge(parts: Sequence[Recording], names: Sequence[str], path: str) -> Recording:
    """Merge the sensors of recordings; raises ChoiceError if their times do not overlap."""
    source = replace(parts[0].source, path=path)
    if len(parts) == 1:
        return replace(parts[0], source=source)
    _refuse_other_times(path, names, parts)
    every = chain.from_iterable(part.series for part in parts)
    series = sorted(every, key=lambda one: one.sensor is Sensor.ACCELEROMETER)
    if all(one.clock == series[0].clock for one in series):
        series = [replace(one, clock=series[0].clock) for one in series]
    topics = chain.from_iterable(part.source.topics for part in parts)
    decisions = chain([("files", ", ".join(names))], *(part.source.decisions for part in parts))
    values = dict(chain.from_iterable(part.source.values.items() for part in parts))
    findings = chain.from_iterable(part.findings for part in parts)
    return replace(
        parts[0],
        source=replace(
            source, topics=tuple(topics), decisions=tuple(dict.fromkeys(decisions)), values=values
        ),
        series=tuple(series),
        temperature=next((part.temperature for part in parts if part.temperature is not None), None),
        findings=tuple(dict.fromkeys(findings)),
    )


def _refuse_other_times(path: str, names: Sequence[str], parts: Sequence[Recording]) -> None:
    spans = [span for part in parts if (span := span_ns(part.series))]
    if len(spans) == len(parts) and min(end for _, end in spans) < max(spans)[0]:
        apart = f"{' and '.join(names)} were not recorded at the same time"
        raise refused(path, f"{apart}; expected one recording; read one file at a time", ChoiceError)


#: Largest unpacked text that `describe` reads completely, in bytes.
_SMALL = 64 << 20


def read(path: Path, options: ReadOptions) -> Recording:
    """Read a text table, or the zip or folder of a phone app, with the errors of `read_table`."""
    if is_set(path):
        return _read_set(path, options)
    refuse_topics(path, options, "a table of text")
    with open_text(path, progress=options.progress) as source:
        recording = read_table(source, options)
        return replace(recording, source=replace(recording.source, files=source.files()))


def describe(path: Path, options: ReadOptions) -> LogContents:
    """Return the contents of a text table; a note explains why a table can't be read.

    Raises ReadError if it can't be opened or is not a table.
    """
    if is_set(path):
        with _members(path) as members:
            unpacked = sum(size for size, _ in members.values())
        whole = unpacked <= _SMALL
        compression = "zip" if path.is_file() else "none"
        contents = _described(path, None, compression, partial(_read_set, path, options, head=not whole))
        return replace(contents if whole else of_a_part(contents), unpacked_bytes=unpacked)
    size = path.stat().st_size if str(path) != STANDARD_INPUT and path.is_file() else None
    # A small file may unpack to a huge one.
    with suppress(LongerError):
        if size is not None and size <= _SMALL:
            with open_text(path, progress=options.progress, most=_SMALL) as source:
                return _described(path, size, source.compression, partial(read_table, source, options))
    with open_text(path) as source:
        reading = partial(read_table, source, options, name=path.name, head=True)
        contents = _described(path, size, source.compression, reading)
    return replace(of_a_part(contents), unpacked_bytes=max(size or 0, _SMALL + 1))


def _described(
    path: Path, size: int | None, compression: str, reading: Callable[[], Recording]
) -> LogContents:
    found: Recording | ImucalError
    try:
        found = reading()
        layout = found.source.values.get("layout", "table")
    except (ChoiceError, DataError) as error:
        found, layout = error, "table"
    return contents_of(path, "csv", found, size=size, layout=layout, compression=compression)
