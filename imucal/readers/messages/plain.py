"""Decode ROS 1 and CDR messages: messages of one shape by a template, other messages by a walk.

The walk finds the positions of fields in many messages at once, without a loop over messages. A position is
one integer while all previous strings and sequences have the same length in every message, otherwise an int64
vector. Layouts: ROS 1 (no alignment); CDR and XCDR2 (numbers aligned to their size, at most
8 or 4 bytes, from the end of the four bytes of encapsulation). Source: OMG DDS-XTypes 1.3, 7.4.

The template is the shape of a channel's first message. The head, encapsulation and string lengths of every
record are compared with it; records that differ are decoded by the walk.
"""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.frozen import frozen, frozen_alone
from imucal.readers.containers import Alike, Batch, Bytes, Loss, gather
from imucal.readers.containers.container import Guard, cells
from imucal.readers.files import DamagedError, damaged_if
from imucal.readers.messages.definitions import Field
from imucal.readers.messages.message_types import ImuFields, Stamp, Vector
from imucal.readers.store import Columns

#: Offset from the start of the payload: one for all messages, or one for each.
Position: TypeAlias = int | IntArray
#: One element of an array.
_ELEMENT = re.compile(r"(.+)\[(\d+)\]")
#: Longest head of a message for a template, in bytes.
_HEAD = 256


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Offset of a wanted field from the start of the payload, and its NumPy type with byte order."""

    at: Any
    dtype: str


@frozen
class Layout:
    """Byte order and alignment of numbers."""

    #: ``<`` or ``>``.
    order: str = "<"
    #: Largest alignment in bytes; 1 for ROS 1.
    align: int = 8

    def aligned(self, at: Position, size: int) -> Position:
        """Round a position up to the alignment of a number of `size` bytes."""
        step = min(size, self.align)
        return at if step <= 1 else (at + (step - 1)) & -step


_ROS1 = -1
#: Encapsulation, as a big-endian number -> layout; ROS 1 has none.
#: Source: OMG DDS-XTypes 1.3, table 60; DDSI-RTPS 10.2.
_ENCAPSULATIONS = {
    _ROS1: Layout(order="<", align=1),
    0x0000: Layout(order=">", align=8),
    0x0001: Layout(order="<", align=8),
    0x0006: Layout(order=">", align=4),
    0x0007: Layout(order="<", align=4),
}


@dataclass(slots=True, eq=False)
class Found:
    """Result of a walk: places of wanted fields, the length words passed, and the end position."""

    places: dict[str, Place] = field(default_factory=dict)
    lengths: list[tuple[Any, Any]] = field(default_factory=list)
    end: Any = 0


class Walker:
    """Walks the fields of a message type up to the last wanted one.

    A wanted path names a field, or one element of an array or a sequence of numbers: ``gyro[0]``.
    """

    def __init__(self, fields: Sequence[Field], wanted: Sequence[str]) -> None:
        self.wanted = frozenset(wanted)
        self.elements: dict[str, dict[int, str]] = {}
        for path in self.wanted - {entry.path for entry in fields}:
            if match := _ELEMENT.fullmatch(path):
                self.elements.setdefault(match[1], {})[int(match[2])] = path
        needed = self.wanted | set(self.elements)
        last = max(i for i, entry in enumerate(fields) if entry.path in needed)
        self.fields = fields[: last + 1]

    def walk(self, buffer: Bytes, starts: IntArray, layout: Layout) -> Found:
        """Find the wanted fields of messages whose payloads start at `starts`, shape (n,).

        Raises DamagedError if a length reaches beyond the buffer.
        """
        found = Found()
        at: Position = 0
        for entry in self.fields:
            if entry.kind in {"number", "array"}:
                at = layout.aligned(at, entry.size)
                self._note(entry, at, layout, found)
                at = at + entry.size * entry.count
                continue
            # A string or a sequence, after its length.
            at = layout.aligned(at, 4)
            length = self._length(buffer, starts + at, entry, layout)
            found.lengths.append((at, length))
            first = at + 4 if entry.kind == "string" else layout.aligned(at + 4, entry.size)
            self._note(entry, first, layout, found)
            end = first + length * (entry.size * entry.count if entry.kind != "string" else 1)
            # No alignment follows the length of an empty sequence.
            known = isinstance(length, int)
            at = (end if length else at + 4) if known else np.where(np.greater(length, 0), end, at + 4)
        found.end = at
        return found

    def _note(self, entry: Field, at: Position, layout: Layout, found: Found) -> None:
        """Note the place of a wanted field, and of the wanted elements of an array that starts at `at`."""
        if entry.path in self.wanted:
            found.places[entry.path] = Place(at, layout.order + entry.code)
        for index, path in self.elements.get(entry.path, {}).items():
            found.places[path] = Place(at + index * entry.size, layout.order + entry.code)

    def _length(self, buffer: Bytes, at: IntArray, entry: Field, layout: Layout) -> IntArray | int:
        """Return the elements of a string or a sequence: one number where all messages have as many."""
        words = gather(buffer, at, 4).view(layout.order + "u4").astype(np.int64)
        least, most = int(words.min()), int(words.max())
        damaged_if(
            most * max(entry.size * entry.count, 1) > len(buffer),
            f"{entry.path} declares {most} elements, more than its chunk contains",
        )
        last = max(self.elements.get(entry.path, {}), default=-1)
        damaged_if(least <= last, f"{entry.path} has {least} elements in a message, and no [{last}]")
        return most if least == most else words


@dataclass(frozen=True, slots=True, eq=False)
class Messages:
    """Messages in a buffer: their starts, shape (n,), and the places of wanted fields in them."""

    buffer: Bytes
    starts: IntArray
    places: dict[str, Place]

    def write(self, imu: ImuFields, columns: Columns, to: slice | IntArray) -> None:
        """Gather the samples of the wanted fields and write them to the columns."""
        for vector in imu.vectors:
            self._write_vector(vector, columns, to)
        if imu.temperature and columns.temperature is not None:
            columns.temperature[to] = self.field(imu.temperature)

    def _write_vector(self, vector: Vector, columns: Columns, to: slice | IntArray) -> None:
        """Gather x, y and z, at once if they are adjacent, and convert increments to rates."""
        rows = columns.vectors[vector.sensor]
        if adjacent(self.places, vector):
            first = self.places[vector.paths[0]]
            size = np.dtype(first.dtype).itemsize
            values = self._bytes(first.at, 3 * size)
            for axis, row in enumerate(rows):
                row[to] = cells(values, axis * size, first.dtype)
        else:
            for row, path in zip(rows, vector.paths, strict=True):
                row[to] = self.field(path)
        if vector.divisor:
            seconds = self.field(vector.divisor).astype(np.float64) * 1e-6
            seconds[seconds == 0] = np.nan
            rows[:, to] /= seconds

    def field(self, path: str) -> NDArray[np.float64]:
        """Return one field of every message, shape (n,)."""
        place = self.places[path]
        dtype = np.dtype(place.dtype)
        values: NDArray[np.float64] = self._bytes(place.at, dtype.itemsize).view(dtype)
        return values

    def _bytes(self, at: Position, width: int) -> NDArray[np.void]:
        if isinstance(at, int):
            return gather(self.buffer, self.starts, width, at)
        return gather(self.buffer, self.starts + at, width)


def _stamps(stamp: Stamp | None, field: Callable[[str], NDArray[Any]]) -> IntArray | int:
    """Return stamps in ns, shape (n,), from the parts returned by `field`; 0 without stamps."""
    if stamp is None:
        return 0
    counts = field(stamp.sec)
    if not stamp.nanosec:
        return _scaled(counts, stamp.scale)
    # Cast first, then add in place: this takes half the time.
    result = counts.astype(np.int64)
    result *= 1_000_000_000
    result += field(stamp.nanosec).astype(np.int64)
    return result


def _scaled(counts: NDArray[np.float64], scale: int) -> IntArray:
    """Return counts of `scale` ns as ns; floats are split first to keep their resolution."""
    if counts.dtype.kind != "f":
        return counts.astype(np.int64) * np.int64(scale)
    good = np.isfinite(counts) & (np.abs(counts) < float((1 << 62) // scale))
    whole = np.where(good, np.floor(counts), 0.0)
    rest = np.where(good, counts, 0.0) - whole
    return whole.astype(np.int64) * scale + np.round(rest * scale).astype(np.int64)


def adjacent(places: dict[str, Place], vector: Vector) -> bool:
    """Return whether the numbers of a vector are adjacent in every message."""
    if len(vector.axes) < 3:
        return False
    if len(vector.paths) == 1:
        return True
    x, y, z = (places[path] for path in vector.paths)
    size = np.dtype(x.dtype).itemsize
    return x.dtype == y.dtype == z.dtype and _apart(x.at, y.at, size) and _apart(y.at, z.at, size)


def _apart(first: Position, second: Position, size: int) -> bool:
    """Return whether `second` is `size` bytes after `first` in every message."""
    same = second - first == size
    return same if isinstance(same, bool) else bool(np.all(same))


@frozen_alone
class Template:
    """The shape of the messages of a channel; positions count from the start of a record."""

    #: Guards of the batch from which the template was made.
    guards: tuple[Guard, ...]
    #: Guards, encapsulation and lengths of strings, equal in every record.
    alike: Alike
    #: Bytes at the start of a record with these and the stamp; whole words if the record is long enough.
    head: int
    #: Bytes of a record.
    end: int
    #: Path -> position and type of every wanted field.
    places: dict[str, Place]
    imu: ImuFields

    def fits(self, batch: Batch) -> bool:
        """Return whether the records of a batch match the template's guards and size."""
        same_size = isinstance(batch.sizes, int) and batch.header + batch.sizes == self.end
        return same_size and batch.guards == self.guards

    def decode(self, batch: Batch, columns: Columns, first: int) -> bool:
        """Write the samples of a batch to the columns; False if a record has another shape."""
        starts = batch.starts
        # As unsigned numbers, negative starts are beyond any buffer.
        if int(starts.view(np.uint64).max()) + self.end > len(batch.buffer):
            return False
        head = gather(batch.buffer, starts, self.head)
        part = slice(first, first + batch.n)
        columns.log[part] = batch.log_ns if batch.log_at is None else cells(head, batch.log_at, "<i8")

        def of_head(path: str) -> NDArray[Any]:
            return cells(head, self.places[path].at, self.places[path].dtype)

        columns.stamps[part] = _stamps(self.imu.stamp, of_head)
        # Last, because it overwrites the heads; if it fails, the columns are written again by the walk.
        if not self.alike.all(head):
            return False
        Messages(batch.buffer, starts, self.places).write(self.imu, columns, part)
        return True


def learn(batch: Batch, found: Found, layout: Layout, code: bytes, imu: ImuFields) -> Template | None:
    """Return the template of a batch from a walk of its first message; None if a template is not possible.

    The walk starts after the encapsulation, whose first bytes are `code` (none for ROS 1).
    """
    if not isinstance(batch.sizes, int):
        return None
    skip, end = batch.header + (4 if code else 0), batch.header + batch.sizes
    places = {path: Place(skip + place.at, place.dtype) for path, place in found.places.items()}
    # Every record must have the same head, encapsulation and lengths of strings.
    u4 = np.dtype(layout.order + "u4")
    lengths = [(skip + at, np.array(size, u4).tobytes()) for at, size in found.lengths]
    alike = [*batch.guards, (batch.header, code), *lengths]
    times = [places[path] for path in ((imu.stamp.sec, imu.stamp.nanosec) if imu.stamp else ()) if path]
    ends = [at + len(value) for at, value in alike] + [place.at + int(place.dtype[-1]) for place in times]
    head = max(*ends, (batch.log_at or 0) + 8)
    # Whole words, if the record is long enough.
    whole = -(-head // 8) * 8
    head = whole if whole <= end else head
    if head > min(_HEAD, end) or skip + found.end > end:
        return None
    return Template(guards=batch.guards, alike=Alike(alike, head), head=head, end=end, places=places, imu=imu)


@dataclass(frozen=True, slots=True)
class Shape:
    """The fields of a message type, and the selected ones."""

    fields: tuple[Field, ...]
    imu: ImuFields


def is_reachable(imu: ImuFields, fields: Sequence[Field]) -> bool:
    """Return whether the walk can reach all fields chosen by the user.

    It can reach numbers, and elements of arrays and of sequences of numbers, before the first list of
    structures with texts. The elements of an array of three are read at once.
    """
    known = {entry.path: entry for entry in fields}

    def reached(path: str) -> bool:
        if path in known:
            return known[path].kind == "number"
        match = _ELEMENT.fullmatch(path)
        owner = known.get(match[1]) if match else None
        if match is None or owner is None:
            return False
        if owner.kind == "sequence":
            return owner.count == 1
        return owner.kind == "array" and int(match[2]) < owner.count

    return not imu.lists and all(map(reached, imu.wanted))


class BinaryDecoder:
    """Decodes the ROS 1 or CDR messages of one channel.

    The `shapes` are definitions to try on the first messages: the log's own and the standard one. The first
    with the right size is used, or the first of all if none fits. With `exact`, messages must have exactly
    the size of their definition, because it is only assumed.
    """

    def __init__(self, shapes: Iterable[Shape], *, ros1: bool, exact: bool = False) -> None:
        self.ros1 = ros1
        #: Size of the encapsulation, in bytes.
        self._skip = 0 if ros1 else 4
        self.notes: list[Loss] = []
        self._others = iter(shapes)
        self._exact = exact
        self._settled = False
        self._first = next(self._others)
        self._use(self._first)

    def _use(self, shape: Shape) -> None:
        self.imu = shape.imu
        self.walker = Walker(shape.fields, shape.imu.wanted)
        self._whole = Walker(shape.fields, [shape.fields[-1].path]) if self._exact else None
        self._template: Template | None = None

    def settle(self, batch: Batch) -> None:
        """Choose the definition by the size of the first messages; call it once, before other methods.

        A damaged definition shifts every field, so its messages have another size.
        """
        if self._settled:
            return
        self._settled = True
        few = batch.checked()
        few = few.part(np.arange(min(few.n, 16)))
        if few.n and not self._fits(self._first, few):
            for shape in self._others:
                if self._fits(shape, few):
                    self._use(shape)
                    text = "the definition in the log does not match its messages; the standard one was used"
                    self.notes.append(Loss("definition", text))

    def _fits(self, shape: Shape, batch: Batch) -> bool:
        """Return whether messages have the size of a definition; CDR may be padded to four bytes."""
        if shape.fields[-1].kind == "other":
            return True
        try:
            layout = _ENCAPSULATIONS.get(int(self._codes(batch)[0]), _ENCAPSULATIONS[1])
            walker = Walker(shape.fields, [shape.fields[-1].path])
            end = walker.walk(batch.buffer, batch.payload() + self._skip, layout).end
        except DamagedError:
            return False
        spare = batch.sizes - np.int64(self._skip) - end
        return bool(np.all((spare >= 0) & (spare < (2 if self.ros1 else 4))))

    def fast(self, batch: Batch, columns: Columns, first: int) -> bool:
        """Decode records with the shape of the first one; False if a record differs."""
        template = self._template
        if template is None or not template.fits(batch):
            try:
                template = self._template = self._learn(batch) if batch.n else None
            except DamagedError:
                return False
        return template is not None and template.decode(batch, columns, first)

    def slow(self, batch: Batch, columns: Columns, first: int) -> None:
        """Decode a checked batch of messages with different shapes.

        Raises DamagedError if a message is shorter than its type or has an unknown layout.
        """
        if not batch.n:
            return
        damaged_if(int(np.min(batch.sizes)) < self._skip, "a message is too short for CDR")
        codes = self._codes(batch)
        if (codes == codes[0]).all():
            self._walk(batch, int(codes[0]), columns, slice(first, first + batch.n))
            return
        # Decode the messages of each encapsulation separately.
        for code in np.unique(codes).tolist():
            chosen = np.flatnonzero(codes == code)
            self._walk(batch.part(chosen), code, columns, chosen + first)

    def _codes(self, batch: Batch) -> NDArray[Any]:
        """Return the encapsulation of each message, shape (n,)."""
        if self.ros1:
            return np.full(batch.n, _ROS1)
        return gather(batch.buffer, batch.payload(), 2).view(">u2")

    def _learn(self, batch: Batch) -> Template | None:
        """Return the template of the first record; None if a template is not possible."""
        if self._whole is not None:
            return None
        body = batch.starts[:1] + batch.header
        code = b"" if self.ros1 else bytes(gather(batch.buffer, body, 2))
        layout = _ENCAPSULATIONS.get(int.from_bytes(code, "big") if code else _ROS1)
        if layout is None:
            return None
        found = self.walker.walk(batch.buffer, body + self._skip, layout)
        return learn(batch, found, layout, code, self.imu)

    def _walk(self, batch: Batch, code: int, columns: Columns, to: slice | IntArray) -> None:
        """Walk messages of one layout; they must not end before the last wanted field."""
        layout = _ENCAPSULATIONS.get(code)
        if layout is None:
            msg = f"encapsulation 0x{code:04x} is not supported; expected plain CDR or XCDR2"
            raise DamagedError(msg, "encapsulation")
        body = batch.payload() + self._skip
        found = self.walker.walk(batch.buffer, body, layout)
        room = batch.sizes - np.int64(self._skip)
        damaged_if(np.any(found.end > room), "a message is shorter than its type")
        if self._whole is not None:
            end = self._whole.walk(batch.buffer, body, layout).end
            damaged_if(
                bool(np.any(np.abs(end - room) > 3)),
                "messages do not have the size of the built-in definition of their type",
                "definition",
            )
        columns.log[to] = batch.log_ns
        messages = Messages(batch.buffer, body, found.places)
        columns.stamps[to] = _stamps(self.imu.stamp, messages.field)
        messages.write(self.imu, columns, to)
