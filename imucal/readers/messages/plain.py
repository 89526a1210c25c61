"""Decode ROS 1 and CDR messages: find the fields of many messages at once, and gather their bytes.

A position is one integer while all previous strings and sequences have the same length in every message,
otherwise an int64 vector. CDR and XCDR2 align numbers to their size, at most 8 or 4 bytes, after the
encapsulation. Source: OMG DDS-XTypes 1.3, 7.4.
"""

import re
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray
from imucal.readers.containers import Batch, Bytes, gather
from imucal.readers.containers.container import cells
from imucal.readers.files import DamagedError, damaged_if
from imucal.readers.messages.definitions import Field

#: Offset from the start of the payload: common, or per message.
Position: TypeAlias = int | IntArray
#: Offset and NumPy type with byte order.
Place: TypeAlias = tuple[Position, str]
_ELEMENT = re.compile(r"(.+)\[(\d+)\]")
#: CDR pads messages to four bytes.
_PADDING = 3
#: Bytes before the frame's length in a ROS 1 header, or a ROS 2 header with encapsulation.
_BEFORE_FRAME = 12
#: A longer frame name is damage.
_MAX_FRAME_BYTES = 256


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Byte order and alignment of numbers."""

    #: ``<`` or ``>``.
    order: str = "<"
    #: Largest alignment in bytes; 1 for ROS 1.
    align: int = 8

    def aligned(self, at: Position, size: int) -> Position:
        step = min(size, self.align)
        return at if step <= 1 else (at + (step - 1)) & -step


_ROS1 = Layout(order="<", align=1)
#: Encapsulation -> layout. Source: OMG DDS-XTypes 1.3, table 60; DDSI-RTPS 10.2.
_ENCAPSULATIONS = {
    0x0000: Layout(order=">", align=8),
    0x0001: Layout(order="<", align=8),
    0x0006: Layout(order=">", align=4),
    0x0007: Layout(order="<", align=4),
}


def is_reachable(paths: Sequence[str], fields: Sequence[Field]) -> bool:
    """Return whether `BinaryDecoder` supports all paths.

    It supports numbers, times, and elements of arrays, before the first list of structures with texts.
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

    return all(map(reached, chain.from_iterable(_parts(path, known) for path in paths)))


def _parts(path: str, known: Container[str]) -> tuple[str, ...]:
    """Return the paths of the numbers in a path: two for a time or a quotient."""
    return (f"{path}.sec", f"{path}.nanosec") if f"{path}.sec" in known else tuple(path.split("/"))


class BinaryDecoder:
    """Decodes the wanted fields of one channel's ROS 1 or CDR messages.

    A path names a number, a time (decoded as ns), or one element, ``gyro[0]``; ``step[0]/dt`` is a quotient
    with a duration in µs.
    """

    #: Decoding so few messages takes as long as decoding one.
    group = 64

    def __init__(self, fields: Sequence[Field], paths: Sequence[str], *, ros1: bool) -> None:
        self._ros1 = ros1
        known = {entry.path for entry in fields}
        self._columns = [(path, _parts(path, known)) for path in paths]
        self._wanted = frozenset(chain.from_iterable(parts for _, parts in self._columns))
        self._elements: dict[str, dict[int, str]] = {}
        for path in self._wanted - known:
            if match := _ELEMENT.fullmatch(path):
                self._elements.setdefault(match[1], {})[int(match[2])] = path
        #: Whether the size is known: the walk ends before a list of structures.
        self._whole = all(entry.kind != "other" for entry in fields)
        self._fields = [entry for entry in fields if entry.kind != "other"]

    def decode(self, batch: Batch) -> list[NDArray[Any]]:
        """Return the wanted numbers of a batch; raises DamagedError for an unknown layout or a wrong size."""
        groups = list(self._groups(batch))
        blocks = [self._decode(batch.part(rows), skipped, layout) for rows, skipped, layout in groups]
        if len(blocks) == 1:
            return blocks[0]
        order = np.argsort(np.concatenate([rows for rows, _, _ in groups]))
        return [np.concatenate(parts)[order] for parts in zip(*blocks, strict=True)]

    def write(self, batch: Batch, columns: Sequence[FloatArray]) -> None:
        """Replace the wanted numbers, shape (n,) each, in the messages of a batch, whose buffer is mutable.

        Only numbers that are one field can be replaced. Raises DamagedError as `decode` does.
        """
        data = np.frombuffer(batch.buffer, np.uint8)
        for rows, skipped, layout in self._groups(batch):
            starts = batch.starts[rows] + skipped
            places, _ = self._walk(batch.buffer, starts, layout)
            for (path, _), column in zip(self._columns, columns, strict=True):
                at, dtype = places[path]
                values = np.ascontiguousarray(column[rows], dtype)
                size = values.itemsize
                targets = (starts + at)[:, np.newaxis] + np.arange(size)
                damaged_if(targets.size and int(targets.max()) >= data.size, "a message is cut off")
                data[targets] = values.view(np.uint8).reshape(-1, size)

    def _groups(self, batch: Batch) -> Iterator[tuple[IntArray, int, Layout]]:
        """Yield the messages of each encapsulation: their rows, the bytes before the payload, the layout."""
        if self._ros1:
            yield np.arange(batch.n), 0, _ROS1
            return
        damaged_if(int(batch.sizes.min()) < 4, "a message is too short for CDR")
        codes = gather(batch.buffer, batch.starts, 2).view(">u2")
        for code in np.unique(codes).tolist():
            yield np.flatnonzero(codes == code), 4, _layout(code)

    def _decode(self, batch: Batch, skipped: int, layout: Layout) -> list[NDArray[Any]]:
        starts = batch.starts + skipped
        places, end = self._walk(batch.buffer, starts, layout)
        spare = batch.sizes - skipped - end
        damaged_if((spare < 0).any(), "a message is shorter than its type")
        wrong = spare > _PADDING
        if self._whole and wrong.any():
            row = int(np.argmax(wrong))
            size = int(batch.sizes[row])
            msg = f"a message has {size} bytes instead of the {size - spare[row]} of its definition"
            # If all of several differ, the definition is wrong.
            raise DamagedError(msg, "definition" if batch.n > 1 and wrong.all() else "damaged")
        wanted = [places[part] for _, parts in self._columns for part in parts]
        values = iter(_gathered(batch.buffer, starts, wanted))
        columns = [batch.log_ns]
        for path, parts in self._columns:
            column = next(values)
            if len(parts) > 1:
                column = (quotient if "/" in path else _stamps)(column, next(values))
            columns.append(column)
        return columns

    def _walk(self, buffer: Bytes, starts: IntArray, layout: Layout) -> tuple[dict[str, Place], Position]:
        """Find the wanted fields, and the end, of messages whose payloads start at `starts`, shape (n,).

        Raises DamagedError.
        """
        places: dict[str, Place] = {}
        at: Position = 0
        for entry in self._fields:
            if entry.kind in {"number", "array"}:
                at = layout.aligned(at, entry.size)
                places |= self._places(entry, at, layout)
                at = at + entry.size * entry.count
                continue
            at = layout.aligned(at, 4)
            length = self._length(buffer, starts + at, entry, layout)
            first = at + 4 if entry.kind == "string" else layout.aligned(at + 4, entry.size)
            places |= self._places(entry, first, layout)
            end = first + length * (entry.size * entry.count if entry.kind != "string" else 1)
            # No alignment follows the length of an empty sequence.
            known = isinstance(length, int)
            at = (end if length else at + 4) if known else np.where(np.greater(length, 0), end, at + 4)
        return places, at

    def _places(self, entry: Field, at: Position, layout: Layout) -> Iterator[tuple[str, Place]]:
        if entry.path in self._wanted:
            yield entry.path, (at, layout.order + entry.code)
        for index, path in self._elements.get(entry.path, {}).items():
            yield path, (at + index * entry.size, layout.order + entry.code)

    def _length(self, buffer: Bytes, at: IntArray, entry: Field, layout: Layout) -> IntArray | int:
        """Return the elements of a string or sequence; one number if equal in all messages."""
        words = gather(buffer, at, 4).view(layout.order + "u4").astype(np.int64)
        least, most = int(words.min()), int(words.max())
        damaged_if(
            most * max(entry.size * entry.count, 1) > len(buffer),
            f"{entry.path} declares {most} elements, more than its chunk contains",
        )
        last = max(self._elements.get(entry.path, {}), default=-1)
        damaged_if(least <= last, f"{entry.path} has {least} elements in a message, and no [{last}]")
        return most if least == most else words


def _layout(code: int) -> Layout:
    damaged_if(
        code not in _ENCAPSULATIONS,
        f"encapsulation 0x{code:04x} is not supported; expected plain CDR or XCDR2",
        "encapsulation",
    )
    return _ENCAPSULATIONS[code]


def _gathered(buffer: Bytes, starts: IntArray, places: Sequence[Place]) -> list[NDArray[Any]]:
    numbers: list[NDArray[Any]] = []
    while len(numbers) < len(places):
        at, size = places[len(numbers)][0], 0
        run = []
        for place, dtype in places[len(numbers) :]:
            if not np.all(at + size == place):
                break
            run.append((size, dtype))
            size += int(dtype[-1])
        records = gather(buffer, starts + at, size)
        numbers += [cells(records, offset, dtype) for offset, dtype in run]
    return numbers


def _stamps(seconds: NDArray[Any], nanoseconds: NDArray[Any]) -> IntArray:
    # Adding in place halves the time.
    result = seconds.astype(np.int64)
    result *= 1_000_000_000
    result += nanoseconds
    return result


def quotient(steps: NDArray[Any], micros: NDArray[Any]) -> FloatArray:
    """Return rates from increments and their durations in µs; NaN for a duration that is not positive."""
    seconds = micros.astype(np.float64) * 1e-6
    seconds[seconds <= 0] = np.nan
    return np.asarray(steps / seconds)


def frame_of(message: bytes, encoding: str) -> str:
    """Return the frame in a message header; empty if its bytes can't be a name."""
    if encoding not in {"ros1", "cdr"} or len(message) < _BEFORE_FRAME + 4:
        return ""
    # CDR: the second byte of the encapsulation contains the byte order.
    little = encoding == "ros1" or message[1] & 1
    end = (
        _BEFORE_FRAME
        + 4
        + int.from_bytes(message[_BEFORE_FRAME : _BEFORE_FRAME + 4], "little" if little else "big")
    )
    name = message[_BEFORE_FRAME + 4 : end].rstrip(b"\x00")
    if not 0 < end - _BEFORE_FRAME - 4 <= _MAX_FRAME_BYTES or end > len(message):
        return ""
    text = name.decode("utf-8", "replace")
    return text if text.isprintable() else ""
