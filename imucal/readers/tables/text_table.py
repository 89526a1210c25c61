"""Delimited text (CSV, TSV, blanks) from a file, standard input, or the zip or folder of a phone app.

The first lines determine the layout, and polars parses blocks of rows. An app writes a text for each sensor,
each of which is a table.
"""

import shlex
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import BinaryIO, cast

from imucal.errors import ChoiceError, DataError, Fix, ReadError
from imucal.findings import Finding
from imucal.readers.compression import keep_freed_memory, most_unpacked
from imucal.readers.files import first_bytes, refused
from imucal.readers.foreign import CURVES, LOGGERS, TEXTS, advice_on
from imucal.readers.memory import fit_into_memory, too_large
from imucal.readers.read_options import ReadOptions
from imucal.readers.table import Column, Loaded, Log, Request, Table
from imucal.readers.tables.columns import NamedTable
from imucal.readers.tables.dialects import find_json, name_columns
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
from imucal.readers.tables.text_blocks import BlockReader, Kind, kind_of
from imucal.readers.tables.text_source import STANDARD_INPUT, TextSource, open_text
from imucal.recording import LogFileInfo

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
ONLY_TIMES = "only-times"
#: First bytes of a zip file.
_ZIP = b"PK\x03\x04"
#: Extensions of text tables in a zip or folder.
_SUFFIXES = (".csv", ".tsv", ".txt")
#: Most text tables of a zip or folder: an app writes one per sensor; reading the head of one takes 1 ms.
_MAX_TABLES = 1000


@dataclass(eq=False)
class _Text:
    """A text with its layout; `source` is None if it must be opened again."""

    open: Callable[[], TextSource]
    layout: TextLayout
    source: TextSource | None = None


class TextLog(Log):
    """A text, or the texts of an app; if `head` is true, only the first lines are read."""

    form = "csv"

    def __init__(self, path: Path, options: ReadOptions) -> None:
        super().__init__(path)
        self.head = False
        self.is_set = False
        self._options = options
        self._texts: dict[str, _Text] = {}
        self._archive: zipfile.ZipFile | None = None
        self._files: tuple[LogFileInfo, ...] = ()

    def open_text(self, most: int | None) -> None:
        """Add the text of a file, or of standard input."""
        opened = partial(open_text, self.path, progress=self._options.progress, most=most)
        if str(self.path) != STANDARD_INPUT and self.path.is_file():
            self.size_bytes = self.path.stat().st_size
        source = opened()
        try:
            layout = lay_out(source.name, source.head, self._options)
            self.tables.append(_table(self.path.name, source, layout))
        except BaseException:
            source.close()
            raise
        self.name = source.name
        self.compression = source.compression
        self._texts[self.path.name] = _Text(opened, layout, source)

    def open_files(self, paths: Sequence[Path]) -> None:
        """Add the texts of files, which may have one sensor each; raises ReadError if one can't be read."""
        names = [path.name for path in paths]
        for path in paths:
            name = path.name if names.count(path.name) == 1 else str(path)
            opened = partial(open_text, path, progress=self._options.progress)
            with opened() as source:
                layout = lay_out(source.name, source.head, self._options)
                self.tables.append(replace(_table(name, source, layout), is_member=True))
            self._texts[name] = _Text(opened, layout)

    def open_folder(self) -> None:
        """Add the texts in a folder."""
        entries = sorted(entry for entry in self.path.iterdir() if entry.suffix.lower() in _SUFFIXES)
        _require_few(self.path, len(entries))
        self.is_set = True
        self.compression = "none"
        self.unpacked_bytes = sum(map(_size, entries))
        for entry in entries:
            self._add(entry.name, partial(open_text, entry))

    def open_archive(self) -> None:
        """Add the texts in a zip; raises ReadError if it can't be read."""
        packed = self.path.stat().st_size
        self.is_set = True
        self.compression = "zip"
        with _reading_zip(self.path):
            archive = zipfile.ZipFile(self.path)
            self._archive = archive
            members = [
                info
                for info in archive.infolist()
                if info.filename.lower().endswith(_SUFFIXES) and not info.filename.startswith("__MACOSX")
            ]
            _require_few(self.path, len(members))
            self.unpacked_bytes = sum(info.file_size for info in members)
            if self.unpacked_bytes > most_unpacked(packed):
                found = f"its {packed} bytes declare {self.unpacked_bytes} bytes of tables"
                raise refused(
                    self.path, f"{found}; no recording is compressed so much, unpack it and look at them"
                )
            for info in members:
                self._add(info.filename, partial(_open_member, self.path, archive, info.filename, packed))

    def _add(self, name: str, opened: Callable[[], TextSource]) -> None:
        """Add one of several texts as a table, which may be unreadable."""
        try:
            with opened() as source:
                layout = lay_out(source.name, source.head, self._options)
                table = _table(name, source, layout)
        except ReadError as error:
            empty = Table(name=name, kind="table", place=name, columns=(), head=list, count=0)
            table = replace(empty, reason=error.sentence, fixes=error.fixes)
        else:
            self._texts[name] = _Text(opened, layout)
        self.tables.append(replace(table, is_member=True))

    def read(self, requests: Sequence[Request]) -> list[Loaded]:
        names = dict.fromkeys(request.table.name for request in requests)
        found: dict[int, Loaded] = {}
        with _reading_zip(self.path) if self._archive else nullcontext():
            for name in names:
                numbers = [at for at, request in enumerate(requests) if request.table.name == name]
                loaded = self._read(self._texts[name], [requests[at] for at in numbers])
                found |= zip(numbers, loaded, strict=True)
        return [found[at] for at in range(len(requests))]

    def _read(self, text: _Text, requests: Sequence[Request]) -> list[Loaded]:
        """Read a text once for all requests."""
        keep_freed_memory()
        source = text.source or text.open()
        text.source = None
        with source:
            expected = 0 if self.head else source.expected_rows
            values = expected * sum(len(request.columns) for request in requests)
            if not fit_into_memory(values):
                raise too_large(source.name, values, Fix("write a part of its lines to another file"))
            readers = [_reader(source.head, text.layout, request, expected) for request in requests]
            blocks = [("\n".join(source.head) + "\n").encode()] if self.head else source.blocks()
            cut = _read_blocks(source, blocks, text.layout, readers)
            findings = _row_findings(source, cut, text.layout, readers, strict=self._options.strict)
            if not any(reader.good for reader in readers) and all(one.rows is None for one in requests):
                advice = advice_on("\n".join(source.head).encode(), LOGGERS)
                problem = f"the table has no rows of its sensors; {advice or 'expected a row per sample'}"
                raise refused(source.name, problem, DataError)
            self._files += source.files()
        first, *others = [
            {index: column.take() for index, column in reader.columns.items()} for reader in readers
        ]
        return [Loaded(first, findings), *map(Loaded, others)]

    def layout_of(self, table: Table) -> TextLayout:
        """Return the layout of the text of a table."""
        return self._texts[table.name].layout

    def files(self) -> tuple[LogFileInfo, ...]:
        return self._files

    def close(self) -> None:
        for text in self._texts.values():
            if text.source is not None:
                text.source.close()
        if self._archive is not None:
            self._archive.close()


def open_log(path: Path, options: ReadOptions, *, most: int | None = None) -> TextLog:
    """Open a text, or the zip or folder of an app.

    Raises ReadError if it can't be opened or is not a table. Reading a single text raises LongerError after
    `most` unpacked bytes.
    """
    log = TextLog(path, options)
    try:
        if not is_set(path):
            log.open_text(most)
        elif path.is_dir():
            log.open_folder()
        else:
            log.open_archive()
    except BaseException:
        log.close()
        raise
    return log


def is_set(path: Path) -> bool:
    """Return whether a path is a zip or a folder of text tables."""
    if path.is_dir():
        return any(entry.suffix.lower() in _SUFFIXES for entry in path.iterdir())
    with suppress(ReadError):
        return first_bytes(path, len(_ZIP)) == _ZIP
    return False


def _open_member(path: Path, archive: zipfile.ZipFile, name: str, packed: int) -> TextSource:
    return TextSource(f"{path}:{name}", cast("BinaryIO", archive.open(name)), packed=packed)


@contextmanager
def _reading_zip(path: Path) -> Iterator[None]:
    """Convert errors of a damaged zip to ReadError."""
    try:
        yield
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
    return name_columns(layout)


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


def _table(name: str, source: TextSource, layout: TextLayout) -> Table:
    """Return a text as a table; raises ChoiceError if it contains only times."""
    names = layout.headers or ("",) * layout.width
    units = (*layout.units, *([None] * layout.width))[: len(names)]
    cells = [layout.cells(index) for index in range(layout.width)]
    named = NamedTable.of(source.name, names, layout.cells, units=layout.units)
    if all(column.role is Role.TIME for column in named.columns):
        pasted = f"paste -d , {shlex.quote(source.name)} SAMPLES > log.csv"
        raise refused(
            source.name,
            "it contains only times",
            ChoiceError,
            Fix(f"write them next to the samples, such as with {pasted}"),
            Fix("leave it out and give the sampling rate", "rate_hz", "HZ"),
            code=ONLY_TIMES,
        )
    return Table(
        name=name,
        kind="table",
        place=source.name,
        columns=tuple(Column(name=one, unit=unit) for one, unit in zip(names, units, strict=True)),
        head=lambda: cells,
        rate_hz=layout.rate_hz,
        preamble=layout.preamble,
        unnamed=_why_unnamed(layout),
    )


def _why_unnamed(layout: TextLayout) -> str:
    """Return why the columns of a text have no names, or an empty text."""
    if layout.headers:
        return ""
    if layout.mismatch is not None:
        return f"the header has {layout.mismatch} names and the rows {layout.width} cells"
    return f"the {layout.width} columns have no header"


def _reader(lines: Sequence[str], layout: TextLayout, request: Request, expected: int) -> BlockReader:
    layout = _of_rows(lines, layout, request.rows)
    kinds: dict[int, Kind] = dict.fromkeys(request.samples, "float")
    for time in request.times:
        text = time.kind == "text"
        kinds |= {index: kind_of(layout.cells(index), text=text) for index in time.indices}
    # A row without its last cell was truncated, perhaps within a number.
    needed = frozenset(index for index in (*kinds, layout.width - 1) if all(layout.cells(index)))
    if request.temperature is not None:
        kinds.setdefault(request.temperature, "float")
    return BlockReader(
        layout=layout,
        kinds=kinds,
        needed=needed,
        rows=request.rows,
        expected=expected,
        by_day=any(time.by_day for time in request.times),
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


@dataclass
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
