"""An MCAP file without a good index, scanned record by record.

A cut file keeps everything before the cut, of its last chunk too; the zeros that a crash leaves end it.
"""

from dataclasses import dataclass, field

from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.readers.containers import mcap_records as records
from imucal.readers.containers.mcap_chunks import ChunkTask, LooseTask, index_count, unpack, walk_records
from imucal.readers.containers.mcap_records import HEAD, MAGIC, ChannelRecord, ChunkIndex, Schema
from imucal.readers.files import DamagedError, LogFile

#: Messages outside chunks are loaded in parts of this many bytes.
_PART = 1 << 22
#: Schemas and channels are read whole; a longer one is damage.
_MAX_DEFINITION = 1 << 24
_WINDOW = 1 << 20
#: Bytes in which the head of a chunk is looked for: names of compressions are short.
_HEAD_BLOCK = 128


@dataclass(slots=True)
class Bookkeeping:
    """What an MCAP file says about itself."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, ChannelRecord] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    loose: list[LooseTask] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    start_ns: int | None = None
    end_ns: int | None = None
    findings: list[Finding] = field(default_factory=list)

    def define(self, opcode: int, body: memoryview) -> None:
        """Take a Schema or Channel record, unless its number is known."""
        if opcode == records.SCHEMA:
            schema = records.schema(body)
            self.schemas.setdefault(schema.id, schema)
        else:
            channel = records.channel(body)
            self.channels.setdefault(channel.id, channel)

    def define_all(self, raw: memoryview) -> None:
        """Take all definitions among the records of a chunk, up to the first that is damaged."""
        at = 0
        while at + 9 <= len(raw):
            opcode, length = HEAD.unpack_from(raw, at)
            if at + 9 + length > len(raw):
                return
            if opcode in {records.SCHEMA, records.CHANNEL}:
                try:
                    self.define(opcode, raw[at + 9 : at + 9 + length])
                except DamagedError:
                    return
            at += 9 + length

    def count(self, counts: dict[int, int]) -> None:
        """Add messages to those of each channel."""
        for key, count in counts.items():
            self.counts[key] = self.counts.get(key, 0) + count


def scan(file: LogFile, reason: DamagedError) -> Bookkeeping:
    """Return what the records of a file say whose index is missing or damaged.

    Raises
    ------
    ReadError
        If the file holds no channel.
    """
    found = _Scan(file)
    end, book = found.visit_records(), found.book
    found.find_channels()
    if not book.channels:
        msg = f"{file.path}: {reason}, and no whole record was found; expected an MCAP file"
        raise ReadError(msg)
    found.count()
    lost = file.size - end
    text = f"The index can't be used ({reason}); all records were scanned instead."
    if lost:
        text += f" The last {lost} of {file.size} bytes are cut or damaged."
    book.findings.append(Finding(level="warning", code="truncated" if lost else reason.code, text=text))
    return book


class _Scan:
    """One scan of a file, which is read a megabyte at a time."""

    def __init__(self, file: LogFile) -> None:
        self.book = Bookkeeping()
        self._file = file
        self._start, self._data = 0, file.read(0, min(_WINDOW, file.size))

    def _take(self, at: int, size: int) -> memoryview:
        """Return `size` bytes from `at` on, never before the last place; fewer at the end of the file."""
        if at + size > self._start + len(self._data):
            self._start = at
            self._data = self._file.read(at, min(max(size, _WINDOW), self._file.size - at))
        return memoryview(self._data)[at - self._start : at - self._start + size]

    def _head(self, at: int) -> tuple[int, int]:
        """Return opcode and length of the record at `at`."""
        opcode, length = HEAD.unpack_from(self._take(at, HEAD.size))
        return opcode, length

    def visit_records(self) -> int:
        """Visit the records of the file; return where the last whole one ends."""
        file, at = self._file, len(MAGIC)
        while at + 9 <= file.size:
            opcode, length = self._head(at)
            after = at + 9 + length
            if not opcode or opcode == records.FOOTER:
                return file.size if opcode else at
            if after > file.size:
                if opcode == records.CHUNK:
                    self._salvage(at)
                return at
            if opcode == records.DATA_END:
                self._define_from_summary(after)
                return file.size
            try:
                self._visit(opcode, at, length)
            except DamagedError:
                return at
            at = after
        return at

    def _define_from_summary(self, at: int) -> None:
        """Take definitions that the summary repeats, though its checksum is wrong."""
        while at + 9 <= self._file.size:
            opcode, length = self._head(at)
            if at + 9 + length > self._file.size or opcode not in {records.SCHEMA, records.CHANNEL}:
                return
            try:
                self.book.define(opcode, self._take(at + 9, length))
            except DamagedError:
                return
            at += 9 + length

    def _visit(self, opcode: int, at: int, length: int) -> None:
        chunks = self.book.chunks
        if opcode in {records.SCHEMA, records.CHANNEL} and length <= _MAX_DEFINITION:
            self.book.define(opcode, self._take(at + 9, length))
        elif opcode == records.CHUNK:
            head = records.chunk_head(self._take(at, min(HEAD.size + length, _HEAD_BLOCK)))
            chunks.append(ChunkIndex(start=at, length=9 + length, compression=head.compression))
        elif opcode == records.MESSAGE_INDEX and chunks:
            chunk = chunks[-1]
            key = int.from_bytes(self._take(at + 9, 2), "little")
            if chunk.start + chunk.length + chunk.index_length == at:
                chunk.index_length += 9 + length
                if length > 6:
                    chunk.indexes[key] = at
        elif opcode == records.MESSAGE and length >= 22:
            self._add_loose(int.from_bytes(self._take(at + 9, 2), "little"), at, length)

    def _add_loose(self, key: int, at: int, length: int) -> None:
        """Take a message that lies outside chunks."""
        loose = self.book.loose
        part = loose[-1] if loose else None
        if part is None or part.data is not None or at + 9 + length - part.position > _PART:
            part = LooseTask(self._file, at)
            loose.append(part)
        part.starts.setdefault(key, []).append(at - part.position)
        part.size = at + 9 + length - part.position

    def _salvage(self, at: int) -> None:
        """Keep the whole messages of a chunk that the end of the file cuts."""
        size = self._file.size - at
        try:
            raw = unpack(memoryview(self._file.read(at, size)), cut=True)
        except DamagedError:
            return
        self.book.define_all(raw)
        starts = walk_records(raw)
        if starts:
            self.book.loose.append(LooseTask(self._file, at, size, starts, bytes(raw)))

    def find_channels(self) -> None:
        """Read definitions from chunks until every indexed channel is known.

        Without a summary, a channel is defined in the first chunk that has messages of it.
        """
        for chunk in self.book.chunks:
            if chunk.indexes and self.book.channels.keys() >= chunk.indexes.keys():
                continue
            try:
                raw = unpack(memoryview(self._file.read(chunk.start, chunk.length)))
            except DamagedError:
                continue
            self.book.define_all(raw)

    def count(self) -> None:
        """Count the messages of each channel."""
        for chunk in self.book.chunks:
            try:
                counts = {key: index_count(self._file, key, at) for key, at in chunk.indexes.items()}
            except DamagedError:
                counts = {}
            self.book.count(counts or ChunkTask(self._file, chunk, frozenset(self.book.channels)).counts)
        for loose in self.book.loose:
            self.book.count(loose.counts)
