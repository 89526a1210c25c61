"""Read delimited text (CSV, TSV, blanks) from a file, standard input, or an app's set of files.

The first lines determine the layout, and names of columns the sensors. Polars parses blocks of rows; if that
fails, a tolerant parser does. Ambiguous columns are not guessed: the error lists them with a columns text.

Gyroscope, accelerometer and their times may be in separate files: apps of phones write a zip or a folder
(phyphox, Sensor Logger), simulators several files.
"""

import re
import shlex
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, repeat
from pathlib import Path, PurePath
from typing import Any, BinaryIO, Literal, TypeAlias, cast, get_args

import numpy as np
from numpy.typing import NDArray

from imucal.errors import ChoiceError, DataError, ImucalError, ReadError
from imucal.findings import Finding
from imucal.readers.builder import RecordingBuilder
from imucal.readers.compression import keep_freed_memory
from imucal.readers.contents import LogContents
from imucal.readers.files import first_bytes, refused
from imucal.readers.read_options import ReadOptions
from imucal.readers.store import GrowingColumn
from imucal.readers.tables.columns import ColumnsError, NamedTable
from imucal.readers.tables.dates import NO_STAMP, TextKind, is_text_stamp, parse_texts, text_kind
from imucal.readers.tables.dialects import find_json, name_columns
from imucal.readers.tables.file_sets import FileHead, chosen_files
from imucal.readers.tables.layout import (
    BLANKS,
    Rows,
    TextLayout,
    find_layout,
    row_pattern,
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
from imucal.readers.tables.text_source import STANDARD_INPUT, LongerError, TextSource, open_text
from imucal.readers.ways_out import CURVES, LOGGERS, TEXTS, way_out
from imucal.recording import Recording, Sensor, span_ns
from imucal.resources import column_limit


def lay_out(path: str, lines: Sequence[str], options: ReadOptions) -> TextLayout:
    """Find the layout of a text: messages of a known dialect, or a table.

    Raises ReadError if it has no rows of numbers or no samples, ChoiceError if its header does not fit them.
    """
    start = "\n".join(lines).encode()
    if way := way_out(path, start, CURVES if options.columns else (*CURVES, *LOGGERS)):
        raise refused(path, way)
    if objects := find_json(lines):
        return objects
    layout = find_layout(lines)
    way = way_out(path, start, TEXTS)
    if layout is None or (way and not layout.headers):
        first = next(filter(None, map(str.strip, lines)), "")
        expected = way or "expected a table with a row per sample"
        raise refused(path, f"found no rows of numbers; the first line is {first[:80]!r}; {expected}")
    layout = name_columns(layout)
    if options.columns is None and not layout.headers:
        problem = f"the {layout.width} columns have no header"
        if layout.mismatch is not None:
            problem = f"the header has {layout.mismatch} names and the rows {layout.width} cells"
        raise NamedTable.of(path, [""] * layout.width, layout.cells).ask(problem)
    return layout


#: Advice for a file of times next to files of samples.
_ONLY_TIMES = "it contains only times; write them next to the samples, such as with paste -d ,"

#: Types of cells: numbers, or one of the kinds of time as text.
Kind: TypeAlias = Literal["integer", "float"] | TextKind
_TEXTS: tuple[Kind, ...] = get_args(TextKind)

_QUOTED = re.compile(rb'"[^"\n]*"')

_COMMENTS = ("#", "%", "//", ";")


@dataclass(slots=True, kw_only=True)
class BlockReader:
    """Reads the wanted columns of a text table, block by block.

    `kinds` maps the index of each wanted column to the type of its cells. A row without a cell of a `needed`
    column is bad. `limit` is the most bytes of a column in memory, `expected` the expected number of rows.
    Dates with the year last begin with the month, or with the day if `by_day`. `good` and `bad` count rows;
    the first bad row is kept.
    """

    layout: TextLayout
    kinds: dict[int, Kind]
    needed: frozenset[int]
    rows: Rows = None
    limit: int = 1 << 62
    expected: int = 0
    by_day: bool = False
    good: int = 0
    bad: int = 0
    first_bad: str = ""
    columns: dict[int, GrowingColumn] = field(init=False)
    _pattern: re.Pattern[bytes] | None = field(init=False)
    #: Delimiter of a plain block.
    _mark: str = field(init=False)

    def __post_init__(self) -> None:
        self.kinds = dict(sorted(self.kinds.items()))
        self.columns = {
            index: GrowingColumn(
                np.float64 if kind == "float" else np.int64, limit=self.limit, expected=self.expected
            )
            for index, kind in self.kinds.items()
        }
        self._pattern = row_pattern(self.rows, self.layout.delimiter) if self.rows else None
        self._mark = "," if self.layout.delimiter == BLANKS else self.layout.delimiter

    def add(self, block: bytes) -> None:
        """Read a block of whole lines."""
        if self.layout.prepare is not None:
            block = self.layout.prepare(block)
        if self._pattern is not None:
            block = b"\n".join(self._pattern.findall(block)) + b"\n"
        plain = self._plain(block)
        if not plain or plain.isspace():
            return
        values = self._by_polars(plain)
        if values is None:
            # Search for blank lines only now: it takes as long as parsing.
            plain = re.sub(rb"\n{2,}", b"\n", plain).lstrip(b"\n")
            values = self._by_polars(plain, last_try=True) or self._by_hand(plain)
        self.good += len(next(iter(values.values())))
        for index, column in self.columns.items():
            column.append(values[index])

    def _plain(self, block: bytes) -> bytes:
        """Return a block for the parser: one delimiter, decimal points, no blank lines."""
        delimiter = self.layout.delimiter
        if delimiter == BLANKS:
            block = re.sub(rb"(?m)^[ \t]+|[ \t]+$", b"", block)
            block = re.sub(rb"[ \t]+", b",", block)
        elif b" " in block:
            mark = delimiter.encode()
            block = block.replace(mark + b" ", mark)
            # Keep a blank in a cell, or two numbers would become one.
            if b" " in block:
                block = re.sub(rb"(?m)^ +| *(" + re.escape(mark) + rb") *| +$", rb"\1", block)
        if self.layout.decimal != ",":
            return block
        # If the delimiter is a comma, decimal commas are in quotes.
        if delimiter == ",":
            return _QUOTED.sub(lambda match: match[0].replace(b",", b"."), block)
        return block.replace(b",", b".")

    def _by_polars(self, block: bytes, *, last_try: bool = False) -> dict[int, NDArray[Any]] | None:
        """Return the wanted columns of a block; None where it holds something that is no row.

        Rows that lack a cell are such before the last try: they may be blank lines.
        """
        table = self._parsed(block)
        if table is None:
            return None
        values: dict[int, NDArray[Any]] = {}
        lacking = np.zeros(table.height, dtype=np.bool_)
        for index in self.needed or self.kinds:
            if table[str(index)].null_count():
                lacking |= table[str(index)].is_null().to_numpy()
        for index, kind in self.kinds.items():
            series = table[str(index)]
            if kind in _TEXTS:
                values[index] = self._times(series.fill_null("").to_list(), kind)
                lacking |= values[index] == NO_STAMP
            else:
                full = series.fill_null(0) if kind == "integer" and series.null_count() else series
                values[index] = np.asarray(full.to_numpy())
        if lacking.any():
            if not last_try:
                return None
            first = block.split(b"\n")[int(np.argmax(lacking))]
            self._note_bad(int(lacking.sum()), first.decode("utf-8", "replace"))
            values = {index: array[~lacking] for index, array in values.items()}
        return values

    def _parsed(self, block: bytes) -> Any:  # noqa: ANN401 - polars is imported late
        """Return a block as polars' table of the columns that are looked at; None where it can't be one."""
        import polars as pl

        types: dict[Kind | None, Any] = {"integer": pl.Int64, "float": pl.Float64}
        width, quoted = self.layout.width, self.layout.quoted
        looked_at = sorted(self.needed | self.kinds.keys())
        try:
            table = pl.read_csv(
                block,
                has_header=False,
                separator=self._mark,
                quote_char='"' if quoted else None,
                schema={str(index): types.get(self.kinds.get(index), pl.String) for index in range(width)},
                columns=looked_at if len(looked_at) < width else None,
            )
        except (pl.exceptions.PolarsError, UnicodeDecodeError):
            return None
        # An unclosed quotation mark may swallow lines.
        swallowed = quoted and table.height != block.count(b"\n") + (not block.endswith(b"\n"))
        return None if swallowed else table

    def _by_hand(self, block: bytes) -> dict[int, NDArray[Any]]:
        """Return the wanted columns of the good rows of a block, row by row."""
        header = self._mark.join(self.layout.headers).replace(" ", "")
        rows = []
        for line in block.decode("utf-8", "replace").split("\n"):
            text = line.strip("\r\n")
            if not text.strip() or text.startswith(_COMMENTS) or text.replace(" ", "") == header:
                continue
            row = self._row(split_line(text, self._mark))
            if row is None:
                self._note_bad(1, text)
            else:
                rows.append(row)
        columns = zip(*rows, strict=True) if rows else repeat((), len(self.kinds))
        return {
            index: self._times(cells, kind)
            if kind in _TEXTS
            else np.array(cells, None if cells else np.int64)
            for (index, kind), cells in zip(self.kinds.items(), columns, strict=True)
        }

    def _row(self, cells: Sequence[str]) -> list[Any] | None:
        """Return the wanted cells of a row as numbers; None for a bad row."""
        missing = self.layout.width - len(cells)
        cells = [*cells, *[""] * missing]
        if missing < 0 or any(not cells[index] for index in self.needed):
            return None
        row = [_number(cells[index], kind) for index, kind in self.kinds.items()]
        return None if None in row else row

    def _times(self, cells: Sequence[str], kind: Kind) -> NDArray[Any]:
        return parse_texts(cells, cast("TextKind", kind), by_day=self.by_day)

    def _note_bad(self, count: int, first: str) -> None:
        self.first_bad = self.first_bad if self.bad else first[:120]
        self.bad += count


def _number(cell: str, kind: Kind) -> int | float | str | None:
    """Return a cell's value; an empty cell of floats is NaN; None if it is invalid."""
    if kind in _TEXTS or "_" in cell:
        return cell if kind in _TEXTS else None
    with suppress(ValueError):
        if kind == "integer":
            value = int(cell)
            return value if -(2**63) <= value < 2**63 else None
    with suppress(ValueError):
        return float(cell or ("nan" if kind == "float" else ""))
    return None


_INTEGER = re.compile(r"[+-]?\d{1,20}")


def read_table(
    source: TextSource,
    options: ReadOptions,
    *,
    name: str = "",
    head: bool = False,
) -> Recording:
    """Read the table of an opened text; only its first lines if `head`.

    `name` is the file name, which may name the sensor. Raises ChoiceError if columns, units or time are not
    clear, ReadError if the text is not a table, DataError if it has no samples.
    """
    # Reuse the memory of blocks.
    keep_freed_memory()
    try:
        layout, plan = plan_of_head(source, options, name)
    except ColumnsError as error:
        tried = partial(read_table, source, name=name, head=True)
        raise with_more(source.name, error, options, tried) from error
    # Read sensors of the same rows together.
    groups: dict[Rows, list[SensorPlan]] = {}
    for sensor in plan.sensors:
        groups.setdefault(sensor.triad.rows, []).append(sensor)
    how: dict[str, Any] = {"temperature": plan.temperature, "limit": options.memory_limit}
    how["expected"] = 0 if head else source.expected_rows
    readers = [_reader(source.head, layout, group, **how) for group in groups.values()]
    blocks = [("\n".join(source.head) + "\n").encode()] if head else source.blocks()
    cut = _read_blocks(blocks, layout, readers)
    findings = _row_findings(source, cut, layout, readers, strict=options.strict)
    sensors = []
    for reader, group in zip(readers, groups.values(), strict=True):
        values = {index: column.take() for index, column in reader.columns.items()}
        if reader.good:
            sensors += [_columns(reader, sensor, values, plan.temperature) for sensor in group]
    if not sensors:
        text = "the table has no rows of its sensors; expected a row per sample"
        raise refused(source.name, text, DataError)
    findings += plan.findings
    work = RecordingBuilder(
        path=source.name, format="csv", options=options, rate_hz=layout.rate_hz, findings=findings
    )
    assemble(work, [plan], sensors)
    return work.build(topics=plan.topics)


def plan_of_head(source: TextSource, options: ReadOptions, name: str = "") -> tuple[TextLayout, TablePlan]:
    """Return the layout and the columns of a text from its first lines; its name may name the sensor.

    Raises ChoiceError if columns are not clear, ReadError if the text is not a table.
    """
    layout = lay_out(source.name, source.head, options)
    names = layout.headers or [""] * layout.width
    table = NamedTable.of(source.name, names, layout.cells, units=layout.units, preamble=layout.preamble)
    if all(column.role is Role.TIME for column in table.columns):
        joined = f"{shlex.quote(source.name)} SAMPLES > log.csv"
        way = f"{_ONLY_TIMES} {joined}, or leave it out and give the sampling rate"
        raise refused(source.name, way, ChoiceError)
    return layout, make_plan(table, options, name=name)


def _reader(
    lines: Sequence[str],
    layout: TextLayout,
    sensors: Sequence[SensorPlan],
    *,
    temperature: int | None,
    limit: int | None,
    expected: int,
) -> BlockReader:
    """Return the reader of some sensors' columns in the same rows; `lines` are the first rows."""
    rows = sensors[0].triad.rows
    layout = _of_rows(lines, layout, rows)
    kinds: dict[int, Kind] = {}
    times = [time for sensor in sensors for time in (sensor.time, sensor.log_time) if time is not None]
    for sensor in sensors:
        kinds |= dict.fromkeys(sensor.triad.indices, "float")
    for time in times:
        text = time.kind == "text"
        kinds |= {index: _kind(layout.cells(index), text=text) for index in time.indices}
    # A row without its last cell was cut, perhaps within a number.
    needed = frozenset(index for index in (*kinds, layout.width - 1) if all(layout.cells(index)))
    if temperature is not None:
        kinds.setdefault(temperature, "float")
    return BlockReader(
        layout=layout,
        kinds=kinds,
        needed=needed,
        rows=rows,
        # Half of the limit is for the results made from the columns.
        limit=(limit or column_limit()) // (2 * max(1, len(kinds))),
        expected=expected,
        by_day=any(time.by_day for time in times),
    )


def _of_rows(lines: Sequence[str], layout: TextLayout, rows: Rows) -> TextLayout:
    """Return the layout of some of the rows: tagged rows differ in width."""
    if rows is None:
        return layout
    lines = rows_of_tag(lines[layout.start :], layout.delimiter, rows)
    cells = [tuple(split_line(line, layout.delimiter)) for line in lines]
    if not cells:
        return layout
    width = Counter(map(len, cells)).most_common(1)[0][0]
    return replace(layout, width=width, rows=tuple(row for row in cells if len(row) == width))


def _kind(cells: Sequence[str], *, text: bool) -> Kind:
    if text or any(map(is_text_stamp, cells)):
        return text_kind(cells)
    filled = [cell.strip("\"'") for cell in cells if cell]
    integers = filled and all(_INTEGER.fullmatch(cell) and -(2**63) <= int(cell) < 2**63 for cell in filled)
    return "integer" if integers else "float"


def _read_blocks(blocks: Iterable[bytes], layout: TextLayout, readers: Sequence[BlockReader]) -> str:
    """Read all rows after the header; return the last line if it may be cut, otherwise an empty text."""
    cut, before = "", layout.start
    for block in blocks:
        *above, whole = block.split(b"\n", before) if before else [block]
        before -= len(above)
        if before:
            continue
        end = whole.rfind(b"\n") + 1
        last = whole[end:].decode("utf-8", "replace")
        if last.strip():
            # It is complete if it has all cells and its last cell is as long as usual.
            cells, others = split_line(last, layout.delimiter), layout.cells(layout.width - 1)
            _, point, digits = cells[-1].partition(layout.decimal)
            longest = max((len(other.partition(".")[2]) for other in others), default=0)
            if len(cells) != layout.width or not point or len(digits) < longest:
                cut, whole = last, whole[:end]
        for reader in readers:
            reader.add(whole)
    return cut


def _row_findings(
    source: TextSource, cut: str, layout: TextLayout, readers: Sequence[BlockReader], *, strict: bool
) -> list[Finding]:
    """Return the problems of a text as findings; refuse a table with hardly any readable row."""
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


def _columns(
    reader: BlockReader, sensor: SensorPlan, values: dict[Any, Any], temperature: int | None
) -> SensorColumns:
    def of(time: TimeChoice | None) -> tuple[Any, ...]:
        return tuple(values[index] for index in time.indices) if time else ()

    indices = sensor.triad.indices
    return SensorColumns(
        plan=sensor,
        axes=[values[index] for index in indices],
        time=of(sensor.time),
        log_time=of(sensor.log_time),
        temperature=values.get(temperature),
        sparse=not reader.needed.issuperset(indices),
    )


_ZIP = b"PK\x03\x04"
_SUFFIXES = (".csv", ".tsv", ".txt")

#: The tables of a set: the name of each, its size unpacked, and how to open it.
_Members: TypeAlias = dict[str, tuple[int, Callable[[], TextSource]]]


def is_set(path: Path) -> bool:
    """Return whether a path is a zip, or a folder, of text tables."""
    if path.is_dir():
        return any(entry.suffix.lower() in _SUFFIXES for entry in path.iterdir())
    with suppress(ReadError):
        return first_bytes(path, len(_ZIP)) == _ZIP
    return False


@contextmanager
def _members(path: Path) -> Iterator[_Members]:
    """Yield the text tables of a zip or a folder; raises ReadError for a damaged zip."""
    if path.is_dir():
        entries = sorted(entry for entry in path.iterdir() if entry.suffix.lower() in _SUFFIXES)
        yield {entry.name: (entry.stat().st_size, partial(open_text, entry)) for entry in entries}
        return

    def opened(name: str) -> TextSource:
        return TextSource(f"{path}:{name}", cast("BinaryIO", archive.open(name)))

    try:
        with zipfile.ZipFile(path) as archive:
            yield {
                info.filename: (info.file_size, partial(opened, info.filename))
                for info in archive.infolist()
                if info.filename.lower().endswith(_SUFFIXES) and not info.filename.startswith("__MACOSX")
            }
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, ValueError, RuntimeError) as error:
        text = f"the zip can't be read: {error}; expected the export of a phone's app"
        raise refused(path, text) from error


def _read_set(path: Path, options: ReadOptions, *, head: bool = False) -> Recording:
    """Read the gyroscope and the accelerometer of a zip or a folder; only the first lines if `head`."""
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
    """Return the start of a table of a set; without sensors if its columns are not clear."""
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

    Raises ReadError if a file can't be read, ChoiceError if one has only times.
    """
    sensors = []
    for path in paths:
        try:
            with open_text(path) as source:
                _, plan = plan_of_head(source, options, path.name)
        except ImucalError as error:
            if _ONLY_TIMES in str(error):
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
    """Merge the sensors of several recordings into one; each keeps its own clock.

    Raises ChoiceError if their times do not overlap, such as on different days.
    """
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
    findings = chain.from_iterable(part.findings for part in parts)
    return replace(
        parts[0],
        source=replace(source, topics=tuple(topics), decisions=tuple(dict.fromkeys(decisions))),
        series=tuple(series),
        temperature=next((part.temperature for part in parts if part.temperature is not None), None),
        findings=tuple(dict.fromkeys(findings)),
    )


def _refuse_other_times(path: str, names: Sequence[str], parts: Sequence[Recording]) -> None:
    spans = [span for part in parts if (span := span_ns(part.series))]
    if len(spans) == len(parts) and min(end for _, end in spans) < max(spans)[0]:
        apart = f"{' and '.join(names)} were not recorded at the same time"
        raise refused(path, f"{apart}; expected one recording; read one file at a time", ChoiceError)


#: Largest unpacked text that `describe` reads completely, in less than half a second.
_SMALL = 64 << 20


def read(path: Path, options: ReadOptions) -> Recording:
    """Read a text table, or the zip or folder of tables that a phone's app writes.

    Raises ChoiceError if files, columns, units or time are not clear, ReadError if it can't be opened or is
    not a table, DataError if it has no samples.
    """
    if is_set(path):
        return _read_set(path, options)
    refuse_topics(path, options, "a table of text")
    with open_text(path, progress=options.progress) as source:
        recording = read_table(source, options)
        return replace(recording, source=replace(recording.source, files=source.files()))


def describe(path: Path, options: ReadOptions) -> LogContents:
    """Return the contents of a text table: its columns, units, rate and sensors.

    If the columns are not clear, the note explains why the table can't be read. Raises ReadError if it can't
    be opened or is not a table.
    """
    if is_set(path):
        with _members(path) as members:
            unpacked = sum(size for size, _ in members.values())
        whole = unpacked <= _SMALL
        compression = "zip" if path.is_file() else "none"
        contents = _described(path, None, compression, partial(_read_set, path, options, head=not whole))
        return replace(contents if whole else of_a_part(contents), unpacked_bytes=unpacked)
    size = path.stat().st_size if str(path) != STANDARD_INPUT and path.is_file() else None
    # A few bytes may unpack to very many.
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
    found: Recording | str
    try:
        found = reading()
        layout = dict(found.source.decisions).get("layout", "table").partition(",")[0]
    except (ChoiceError, DataError) as error:
        found, layout = str(error).removeprefix(f"{path}: "), "table"
    return contents_of(path, "csv", found, size=size, layout=layout, compression=compression)
