"""Messages of ROS 1 and CDR -> numbers: by a template for messages of one shape, by a walk for the others.

The walk finds where the fields of many messages lie for all of them at once: a position is one integer while
all strings and sequences so far have the same length in every message, and an int64 vector otherwise; there
is no loop over messages. Layouts: ROS 1 (no alignment); CDR and XCDR2 (numbers aligned to their size, at most
8 or 4 bytes, from the end of the four bytes of encapsulation). Source: OMG DDS-XTypes 1.3, 7.4.

The template is the shape of a channel's first message. Every record is compared with it (its head, its
encapsulation, the lengths of its strings), so nothing is taken on trust; what differs goes to the walk.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.readers.containers import Alike, Batch, Bytes, Loss, gather
from imucal.readers.containers.container import Guard
from imucal.readers.files import DamagedError, damaged_if
from imucal.readers.messages.definitions import Field
from imucal.readers.messages.message_types import ImuFields, Stamp, Vector
from imucal.readers.store import Columns
from imucal.recording import Sensor

#: From the start of the payload: the same for all messages, or one for each.
Position: TypeAlias = int | IntArray
#: One element of an array.
_ELEMENT = re.compile(r"(.+)\[(\d+)\]")
#: Longest head of a message that is gathered at once, in bytes.
_HEAD = 256
_SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where a wanted field lies, from the start of the payload, and its NumPy type with byte order."""

    at: Position
    dtype: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """How numbers are laid out."""

    #: ``<`` or ``>``.
    order: str = "<"
    #: Largest alignment in bytes; 1 for ROS 1.
    align: int = 8

    def aligned(self, at: Position, size: int) -> Position:
        """Round a position up to the alignment of a number of `size` bytes."""
        step = min(size, self.align)
        return at if step <= 1 else (at + (step - 1)) & -step


#: Encapsulation, as a big-endian number -> layout. Source: OMG DDS-XTypes 1.3, table 60; DDSI-RTPS 10.2.
_ENCAPSULATIONS = {
    0x0000: Layout(order=">", align=8),
    0x0001: Layout(order="<", align=8),
    0x0006: Layout(order=">", align=4),
    0x0007: Layout(order="<", align=4),
}
_ROS1 = Layout(order="<", align=1)


@dataclass(slots=True, eq=False)
class Found:
    """What a walk gives: places of wanted fields, the length words passed, and where it stopped."""

    places: dict[str, Place] = field(default_factory=dict)
    lengths: list[tuple[Position, NDArray[np.int64] | int]] = field(default_factory=list)
    end: Position = 0


class Walker:
    """Walks the fields of a message type up to the last wanted one.

    A wanted path is that of a field, or of one element of an array or a sequence of numbers: ``gyro[0]``.
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
            # A string or a sequence, behind its length.
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
            f"{entry.path} claims {most} elements, more than its chunk holds",
        )
        last = max(self.elements.get(entry.path, {}), default=-1)
        damaged_if(least <= last, f"{entry.path} has {least} elements in a message, and no [{last}]")
        return most if least == most else words


@dataclass(frozen=True, slots=True, eq=False)
class Messages:
    """Messages in a buffer: where each starts, shape (n,), and the place of each wanted field in it."""

    buffer: Bytes
    starts: IntArray
    places: dict[str, Place]

    def write(self, imu: ImuFields, columns: Columns, to: slice | IntArray) -> None:
        """Gather the wanted fields and write them to the columns."""
        columns.stamps[to] = 0 if imu.stamp is None else self._stamps(imu.stamp)
        for vector in imu.vectors:
            self.write_vector(vector, columns, to)
        self.write_temperature(imu, columns, to)

    def write_vector(self, vector: Vector, columns: Columns, to: slice | IntArray) -> None:
        """Gather x, y and z at once where they lie side by side, and turn increments into rates."""
        rows = columns.vectors[vector.sensor]
        if adjacent(self.places, vector):
            first = self.places[vector.paths[0]]
            size = np.dtype(first.dtype).itemsize
            values = gather(self.buffer, self.starts + first.at, 3 * size)
            rows[:, to] = values.view(first.dtype).reshape(-1, 3).T
        else:
            for row, path in zip(rows, vector.paths, strict=True):
                row[to] = self._field(path)
        if vector.divisor:
            seconds = self._field(vector.divisor).astype(np.float64) * 1e-6
            seconds[seconds == 0] = np.nan
            rows[:, to] /= seconds

    def write_temperature(self, imu: ImuFields, columns: Columns, to: slice | IntArray) -> None:
        """Write the temperature, where there is one."""
        if imu.temperature and columns.temperature is not None:
            columns.temperature[to] = self._field(imu.temperature)

    def _stamps(self, stamp: Stamp) -> IntArray:
        """Return stamps in ns, shape (n,)."""
        sec = self.places[stamp.sec]
        if not stamp.nanosec:
            return _scaled(self._field(stamp.sec), stamp.scale)
        nanosec = self.places[stamp.nanosec]
        if _apart(sec.at, nanosec.at, 4):
            both = gather(self.buffer, self.starts + sec.at, 8)
            seconds = np.ndarray(both.shape, sec.dtype, buffer=both, strides=(8,))
            rest = np.ndarray(both.shape, nanosec.dtype, buffer=both, offset=4, strides=(8,))
        else:
            seconds, rest = self._field(stamp.sec), self._field(stamp.nanosec)
        result = seconds.astype(np.int64)
        result *= _SECOND
        result += rest
        return result

    def _field(self, path: str) -> NDArray[np.float64]:
        """Return one field of every message, shape (n,)."""
        place = self.places[path]
        dtype = np.dtype(place.dtype)
        values: NDArray[np.float64] = gather(self.buffer, self.starts + place.at, dtype.itemsize).view(dtype)
        return values


def _scaled(counts: NDArray[np.float64], scale: int) -> IntArray:
    """Return counts of `scale` ns as ns; floats are split first, so that nothing is lost."""
    if counts.dtype.kind != "f":
        return counts.astype(np.int64) * np.int64(scale)
    good = np.isfinite(counts) & (np.abs(counts) < float((1 << 62) // scale))
    whole = np.where(good, np.floor(counts), 0.0)
    rest = np.where(good, counts, 0.0) - whole
    return whole.astype(np.int64) * scale + np.round(rest * scale).astype(np.int64)


def adjacent(places: dict[str, Place], vector: Vector) -> bool:
    """Say whether the numbers of a vector lie side by side in every message."""
    if len(vector.axes) < 3:
        return False
    if len(vector.paths) == 1:
        return True
    x, y, z = (places[path] for path in vector.paths)
    size = np.dtype(x.dtype).itemsize
    return x.dtype == y.dtype == z.dtype and _apart(x.at, y.at, size) and _apart(y.at, z.at, size)


def _apart(first: Position, second: Position, size: int) -> bool:
    """Say whether `second` lies `size` bytes after `first` in every message."""
    return bool(np.all(np.asarray(second) - np.asarray(first) == size))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Template:
    """The shape of the messages of a channel; positions count from the start of a record."""

    #: Those of the batch it was learnt from.
    guards: tuple[Guard, ...]
    #: The guards, the encapsulation and the lengths of strings, which every record must repeat.
    alike: Alike
    #: Bytes at the start of a record that hold them and the stamp; whole words where there is room.
    head: int
    #: Bytes of a record.
    end: int
    #: Path -> position and type of every wanted field.
    places: dict[str, Place]
    imu: ImuFields
    #: Vectors that are three plain numbers side by side, with the place of the first.
    plain: tuple[tuple[Sensor, Place], ...]
    #: The other vectors.
    others: tuple[Vector, ...]

    def fits(self, batch: Batch) -> bool:
        """Say whether the records of a batch are those that it was learnt from, by their head and size."""
        same_size = isinstance(batch.sizes, int) and batch.header + batch.sizes == self.end
        return same_size and batch.guards == self.guards

    def decode(self, batch: Batch, columns: Columns, first: int) -> bool:
        """Write the samples of a batch to the columns; False if a record has another shape."""
        starts = batch.starts
        # As unsigned numbers, negative ones lie beyond any buffer.
        if int(starts.view(np.uint64).max()) + self.end > len(batch.buffer):
            return False
        head = _gather(batch.buffer, starts, 0, self.head)
        part = slice(first, first + batch.n)
        columns.log[part] = batch.log_ns if batch.log_at is None else _cells(head, batch.log_at, "<i8")
        stamp, stamps = self.imu.stamp, columns.stamps[part]
        if stamp is None:
            stamps[:] = 0
        else:
            sec = self.places[stamp.sec]
            # A cast, then a product in place: all at once goes through a buffer and takes twice as long.
            stamps[:] = _cells(head, _fixed(sec.at), sec.dtype)
            stamps *= _SECOND if stamp.nanosec else stamp.scale
            if stamp.nanosec:
                rest = self.places[stamp.nanosec]
                stamps += _cells(head, _fixed(rest.at), rest.dtype).astype(np.int64)
        # Last, since it writes to the heads; what was written to the columns counts only if it is true.
        if not self.alike.all(head):
            return False
        for sensor, place in self.plain:
            size = int(place.dtype[-1])
            values = _gather(batch.buffer, starts, _fixed(place.at), 3 * size)
            for axis, row in enumerate(columns.vectors[sensor]):
                row[part] = _cells(values, axis * size, place.dtype)
        messages = Messages(batch.buffer, starts, self.places)
        for vector in self.others:
            messages.write_vector(vector, columns, part)
        messages.write_temperature(self.imu, columns, part)
        return True


def learn(batch: Batch, found: Found, layout: Layout, code: bytes, imu: ImuFields) -> Template | None:
    """Return the template of a batch, from a walk of its first message; None where it can't be taken at once.

    The walk starts at the end of the encapsulation, whose first bytes are `code` (none for ROS 1).
    """
    if not isinstance(batch.sizes, int):
        return None
    skip, end = batch.header + (4 if code else 0), batch.header + batch.sizes
    places = {path: Place(skip + _fixed(place.at), place.dtype) for path, place in found.places.items()}
    alike = _repeated(batch, found, layout, code)
    stamp = (imu.stamp.sec, imu.stamp.nanosec) if imu.stamp else ()
    times = [places[path] for path in stamp if path]
    head = _head_size(alike, times, batch.log_at or 0, end)
    if head > min(_HEAD, end) or skip + _fixed(found.end) > end or (times and times[0].dtype[1] == "f"):
        return None
    plain = _plain(imu, places)
    return Template(
        guards=batch.guards,
        alike=Alike(alike, head),
        head=head,
        end=end,
        places=places,
        imu=imu,
        plain=tuple(plain.items()),
        others=tuple(vector for vector in imu.vectors if vector.sensor not in plain),
    )


def _plain(imu: ImuFields, places: dict[str, Place]) -> dict[Sensor, Place]:
    """Return where the vectors begin whose numbers lie side by side as they are."""
    vectors = [vector for vector in imu.vectors if not vector.divisor and adjacent(places, vector)]
    return {vector.sensor: places[vector.paths[0]] for vector in vectors}


def _head_size(alike: Sequence[Guard], times: Sequence[Place], log_at: int, end: int) -> int:
    """Return how many bytes of a record hold its times and what is compared: whole words if it has them."""
    ends = [at + len(value) for at, value in alike]
    ends += [_fixed(place.at) + int(place.dtype[-1]) for place in times]
    head = max([*ends, log_at + 8])
    whole = -(-head // 8) * 8
    return whole if whole <= end else head


def _repeated(batch: Batch, found: Found, layout: Layout, code: bytes) -> list[Guard]:
    """Return what every record must repeat: its head, the encapsulation and the lengths of strings."""
    u4 = np.dtype(layout.order + "u4")
    first = batch.header + (4 if code else 0)
    lengths = [(first + _fixed(at), np.array(_fixed(size), u4).tobytes()) for at, size in found.lengths]
    return [*batch.guards, *([(batch.header, code)] if code else []), *lengths]


def _gather(buffer: Bytes, starts: IntArray, at: int, width: int) -> NDArray[np.void]:
    """Copy `width` bytes from ``starts + at``, whose bounds were checked; see `gather`."""
    count = len(buffer) - at - width + 1
    view: NDArray[np.void] = np.ndarray((count,), f"V{width}", buffer=buffer, offset=at, strides=(1,))
    return view[starts]


def _cells(rows: NDArray[np.void], at: int, dtype: str) -> NDArray[Any]:
    """Return the number that stands `at` so many bytes in each row; copies nothing."""
    return np.ndarray(rows.shape, dtype, buffer=rows, offset=at, strides=rows.strides)


def _fixed(at: Position) -> int:
    """Return the position that a walk of one message gives."""
    return int(np.asarray(at).reshape(-1)[0])


@dataclass(frozen=True, slots=True)
class Shape:
    """The fields of a message type, and which of them to take."""

    fields: tuple[Field, ...]
    imu: ImuFields


def is_reachable(imu: ImuFields, fields: Sequence[Field]) -> bool:
    """Say whether the walk can reach all fields that a user asked for.

    It can reach numbers, and elements of arrays and of sequences of numbers, that stand before any list of
    structures that hold texts. The three elements of an array of three are taken at once.
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

    The `shapes` are definitions to try on the first messages: the log's own, and the standard one of its
    type. The first whose size fits is taken; where none fits, the first. Where messages must have `exact`-ly
    the size of their definition, it is only assumed.
    """

    def __init__(self, shapes: Sequence[Shape], *, ros1: bool, exact: bool = False) -> None:
        self.ros1 = ros1
        self.notes: list[Loss] = []
        self._shapes = tuple(shapes)
        self._exact = exact
        self._settled = False
        self._use(self._shapes[0])

    def _use(self, shape: Shape) -> None:
        self.imu = shape.imu
        self.walker = Walker(shape.fields, shape.imu.wanted)
        self._whole = Walker(shape.fields, [shape.fields[-1].path]) if self._exact else None
        self._template: Template | None = None

    def settle(self, batch: Batch) -> None:
        """Choose the definition by the size of the first messages; called once, before all others.

        A damaged definition shifts every field: its messages then have another size.
        """
        if self._settled:
            return
        self._settled = True
        few = batch.checked()
        few = few.part(np.arange(min(few.n, 16)))
        if few.n and len(self._shapes) > 1 and not self._fits(self._shapes[0], few):
            for shape in self._shapes[1:]:
                if self._fits(shape, few):
                    self._use(shape)
                    text = "the definition in the log does not fit its messages; the standard one was used"
                    self.notes.append(Loss(code="definition", text=text))

    def _fits(self, shape: Shape, batch: Batch) -> bool:
        """Say whether messages have the size of a definition; CDR may be padded to four bytes."""
        if shape.fields[-1].kind == "other":
            return True
        body, layout = batch.payload(), _ROS1
        try:
            if not self.ros1:
                codes = gather(batch.buffer, body, 2).view(">u2")
                layout, body = _ENCAPSULATIONS.get(int(codes[0]), _ENCAPSULATIONS[1]), body + 4
            end = Walker(shape.fields, [shape.fields[-1].path]).walk(batch.buffer, body, layout).end
        except DamagedError:
            return False
        spare = batch.sizes - np.int64(0 if self.ros1 else 4) - end
        return bool(np.all((spare >= 0) & (spare < (2 if self.ros1 else 4))))

    def fast(self, batch: Batch, columns: Columns, first: int) -> bool:
        """Decode records that all repeat the shape of the first one seen; False if they don't."""
        template = self._template
        if template is None or not template.fits(batch):
            try:
                template = self._template = self._learn(batch) if batch.n else None
            except DamagedError:
                return False
        return template is not None and template.decode(batch, columns, first)

    def slow(self, batch: Batch, columns: Columns, first: int) -> None:
        """Decode a checked batch whose messages may all differ.

        Raises DamagedError if a message is shorter than its type, or is laid out in an unknown way.
        """
        if self.ros1:
            self._walk(batch, batch.payload(), _ROS1, columns, slice(first, first + batch.n))
        elif batch.n:
            self._by_encapsulation(batch, columns, first)

    def _learn(self, batch: Batch) -> Template | None:
        """Learn the shape of the first record; None where its messages can't be taken at once."""
        if self._whole is not None:
            return None
        body, layout, code = batch.starts[:1] + batch.header, _ROS1, b""
        if not self.ros1:
            code = bytes(gather(batch.buffer, body, 2))
            known = _ENCAPSULATIONS.get(int.from_bytes(code, "big"))
            if known is None:
                return None
            layout, body = known, body + 4
        return learn(batch, self.walker.walk(batch.buffer, body, layout), layout, code, self.imu)

    # The walk

    def _by_encapsulation(self, batch: Batch, columns: Columns, first: int) -> None:
        """Walk the messages of each encapsulation on their own."""
        damaged_if(int(np.min(batch.sizes)) < 4, "a message is too short for CDR")
        payload = batch.payload()
        codes = gather(batch.buffer, payload, 2).view(">u2")
        kinds = codes[:1] if (codes == codes[0]).all() else np.unique(codes)
        for kind in kinds.tolist():
            layout = _ENCAPSULATIONS.get(kind)
            if layout is None:
                msg = f"encapsulation 0x{kind:04x} is not supported; expected plain CDR or XCDR2"
                raise DamagedError(msg, code="encapsulation")
            if kinds.size == 1:
                self._walk(batch, payload + 4, layout, columns, slice(first, first + batch.n))
            else:
                chosen = np.flatnonzero(codes == kind)
                self._walk(batch.part(chosen), payload[chosen] + 4, layout, columns, chosen + first)

    def _walk(
        self, batch: Batch, body: IntArray, layout: Layout, columns: Columns, to: slice | IntArray
    ) -> None:
        found = self.walker.walk(batch.buffer, body, layout)
        self._check_size(batch, body, layout, found)
        columns.log[to] = batch.log_ns
        Messages(batch.buffer, body, found.places).write(self.imu, columns, to)

    def _check_size(self, batch: Batch, body: IntArray, layout: Layout, found: Found) -> None:
        """Refuse messages that end before the last wanted field; bytes after it are not looked at."""
        skipped = 0 if self.ros1 else 4
        damaged_if(
            bool(np.any(found.end > batch.sizes - np.int64(skipped))), "a message is shorter than its type"
        )
        if self._whole is not None:
            end = self._whole.walk(batch.buffer, body, layout).end
            damaged_if(
                bool(np.any(np.abs(end + skipped - batch.sizes) > 3)),
                "messages do not have the size of the built-in definition of their type",
                code="definition",
            )
