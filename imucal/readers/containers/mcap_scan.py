"""An MCAP file without a good index, scanned record by record.

A cut file keeps everything before the cut, of its last chunk too; the zeros that a crash leaves end it.
"""

from typing import TYPE_CHECKING

from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.readers.containers import mcap_records as records
from imucal.readers.containers.mcap_chunks import ChunkTask, LooseTask, index_count, unpack, walk_records
from imucal.readers.containers.mcap_records import HEAD, MAGIC, ChunkIndex
from imucal.readers.files import DamagedError, LogFile, Scratch

if TYPE_CHECKING:
    from imucal.readers.containers.mcap_file import Bookkeeping

#: Messages outside chunks are loaded in parts of this many bytes.
_PART = 1 << 22
#: Schemas and channels are read whole; a longer one is damage.
_MAX_DEFINITION = 1 << 24
_WINDOW = 1 << 20


class _Window:
    """The file's bytes around the scan, read a megabyte at a time."""

    def __init__(self, file: LogFile) -> None:
        self._file = file
        self._start, self._data = 0, bytearray()

    def take(self, at: int, size: int) -> memoryview:
        """Return `size` bytes from `at` on; fewer at the end of the file."""
        size = min(size, self._file.size - at)
        if not (self._start <= at and at + size <= self._start + len(self._data)):
            self._start = at
            self._data = self._file.read(at, min(max(size, _WINDOW), self._file.size - at))
        return memoryview(self._data)[at - self._start : at - self._start + size]


def scan(file: LogFile, book: "Bookkeeping", reason: DamagedError) -> "Bookkeeping":
    """Fill `book` from the records of a file whose index is missing or damaged.

    Raises
    ------
    ReadError
        If the file holds no channel.
    """
    window = _Window(file)
    end = _scan_records(file, window, book)
    _find_channels(file, book)
    if not book.channels:
        msg = f"{file.path}: {reason}, and no whole record was found; expected an MCAP file"
        raise ReadError(msg)
    _count(file, book)
    lost = file.size - end
    code = "truncated" if reason.code == "damaged" and lost else reason.code
    text = f"The index can't be used ({reason}); all records were scanned instead."
    if lost:
        text += f" The last {lost} of {file.size} bytes are cut or damaged."
        code = "truncated"
    book.findings.append(Finding(level="warning", code=code, text=text))
    return book


def _scan_records(file: LogFile, window: _Window, book: "Bookkeeping") -> int:
    """Visit the records of the file; return where the last whole one ends."""
    at = len(MAGIC)
    while at + 9 <= file.size:
        opcode, length = HEAD.unpack_from(window.take(at, 9), 0)
        after = at + 9 + length
        if not opcode or opcode == records.FOOTER:
            return file.size if opcode else at
        if after > file.size:
            if opcode == records.CHUNK:
                _salvage(file, at, book)
            return at
        if opcode == records.DATA_END:
            _define_from_summary(file, window, book, after)
            return file.size
        try:
            _visit(file, window, book, (opcode, at, length))
        except DamagedError:
            return at
        at = after
    return at


def _define_from_summary(file: LogFile, window: _Window, book: "Bookkeeping", at: int) -> None:
    """Take definitions that the summary repeats, though its checksum is wrong."""
    while at + 9 <= file.size:
        opcode, length = HEAD.unpack_from(window.take(at, 9), 0)
        if at + 9 + length > file.size or opcode not in {records.SCHEMA, records.CHANNEL}:
            return
        try:
            _define(book, opcode, window.take(at + 9, length))
        except DamagedError:
            return
        at += 9 + length


def _visit(file: LogFile, window: _Window, book: "Bookkeeping", record: tuple[int, int, int]) -> None:
    opcode, at, length = record
    if opcode in {records.SCHEMA, records.CHANNEL} and length <= _MAX_DEFINITION:
        _define(book, opcode, window.take(at + 9, length))
    elif opcode == records.CHUNK:
        head = records.chunk_head(window.take(at, min(9 + length, 128)))
        book.chunks.append(
            ChunkIndex(start=at, length=9 + length, index_length=0, indexes={}, compression=head.compression)
        )
    elif opcode == records.MESSAGE_INDEX and book.chunks:
        chunk = book.chunks[-1]
        key = int.from_bytes(window.take(at + 9, 2), "little")
        if chunk.start + chunk.length + chunk.index_length == at:
            chunk.index_length += 9 + length
            if length > 6:
                chunk.indexes[key] = at
    elif opcode == records.MESSAGE and length >= 22:
        key = int.from_bytes(window.take(at + 9, 2), "little")
        _loose(file, book, (key, at, length))


def _loose(file: LogFile, book: "Bookkeeping", message: tuple[int, int, int]) -> None:
    key, at, length = message
    part = book.loose[-1] if book.loose else None
    if part is None or part.data is not None or at + 9 + length - part.position > _PART:
        part = LooseTask(file, at)
        book.loose.append(part)
    part.starts.setdefault(key, []).append(at - part.position)
    part.size = at + 9 + length - part.position


def _define(book: "Bookkeeping", opcode: int, body: memoryview) -> None:
    if opcode == records.SCHEMA:
        schema = records.schema(body)
        book.schemas.setdefault(schema.id, schema)
    else:
        channel = records.channel(body)
        book.channels.setdefault(channel.id, channel)


def _salvage(file: LogFile, at: int, book: "Bookkeeping") -> None:
    """Keep the whole messages of a chunk that the end of the file cuts."""
    try:
        raw = unpack(memoryview(file.read(at, file.size - at)), Scratch(), cut=True)
    except DamagedError:
        return
    _define_all(raw, book)
    places = walk_records(raw)
    if places:
        book.loose.append(LooseTask(file, at, file.size - at, places, bytes(raw)))


def _find_channels(file: LogFile, book: "Bookkeeping") -> None:
    """Read definitions from chunks until every indexed channel is known.

    Without a summary, a channel is defined in the first chunk that has messages of it.
    """
    for chunk in book.chunks:
        if chunk.indexes and book.channels.keys() >= chunk.indexes.keys():
            continue
        try:
            raw = unpack(memoryview(file.read(chunk.start, chunk.length)), Scratch())
        except DamagedError:
            continue
        _define_all(raw, book)


def _define_all(raw: memoryview, book: "Bookkeeping") -> None:
    at = 0
    while at + 9 <= len(raw):
        opcode, length = HEAD.unpack_from(raw, at)
        if at + 9 + length > len(raw):
            return
        if opcode in {records.SCHEMA, records.CHANNEL}:
            try:
                _define(book, opcode, raw[at + 9 : at + 9 + length])
            except DamagedError:
                return
        at += 9 + length


def _count(file: LogFile, book: "Bookkeeping") -> None:
    """Count the messages of each channel."""
    for chunk in book.chunks:
        try:
            counts = {key: index_count(file, key, position) for key, position in chunk.indexes.items()}
        except DamagedError:
            counts = {}
        if not counts:
            counts = ChunkTask(file, chunk, frozenset(book.channels)).counts
        for key, count in counts.items():
            book.counts[key] = book.counts.get(key, 0) + count
    for loose in book.loose:
        for key, count in loose.counts.items():
            book.counts[key] = book.counts.get(key, 0) + count
