"""The fast way: a channel whose messages all repeat the shape of the first one.

Every record is compared with the first one (its head, its encapsulation, the lengths of its strings), so
nothing is taken on trust; what differs goes to the walk.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.readers.column_store import Columns
from imucal.readers.containers import Alike, Batch, Bytes
from imucal.readers.messages.fields import Messages, adjacent
from imucal.readers.messages.message_types import ImuFields, Vector
from imucal.readers.messages.walker import Found, Layout, Place, Position
from imucal.recording import Sensor

#: A position from the start of a record, and the bytes that every record has there.
_Guard = tuple[int, bytes]
#: A position and a width, and the sensor, the position in them and the type of each vector there.
_Span = tuple[int, int, tuple[tuple[Sensor, int, str], ...]]
#: Longest head of a message that is gathered at once, in bytes.
_HEAD = 256
#: Widest span gathered at once: up to about here bytes in between cost less than another gather.
_WIDEST = 128
_SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Template:
    """The shape of the messages of a channel; positions count from the start of a record.

    Attributes
    ----------
    guards
        Those of the batch it was learnt from.
    alike
        The guards, the encapsulation and the lengths of strings, which every record must repeat.
    head
        Bytes at the start of a record that hold them and the stamp; whole words where there is room.
    end
        Bytes of a record.
    places
        Path -> position and type of every wanted field.
    imu
        What to take.
    spans
        Vectors that are three plain numbers side by side, those close to each other in one span of bytes:
        its position and width, and sensor, position in the span and type of each vector.
    others
        The other vectors.
    """

    guards: tuple[_Guard, ...]
    alike: Alike
    head: int
    end: int
    places: dict[str, Place]
    imu: ImuFields
    spans: tuple[_Span, ...]
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
        for at, width, vectors in self.spans:
            values = _gather(batch.buffer, starts, at, width)
            for sensor, place, dtype in vectors:
                for axis, row in enumerate(columns.vectors[sensor]):
                    row[part] = _cells(values, place + axis * int(dtype[-1]), dtype)
        messages = Messages(batch.buffer, starts, self.places)
        for vector in self.others:
            messages.write_vector(vector, columns, part)
        messages.write_temperature(self.imu, columns, part)
        return True


def learn(batch: Batch, found: Found, layout: Layout, code: bytes, imu: ImuFields) -> Template | None:
    """Return the template of a batch, from a walk of its first message.

    Parameters
    ----------
    found
        What the walk found, from the end of the encapsulation on.
    code
        The first bytes of the encapsulation, or none for ROS 1.

    Returns
    -------
    template
        None where the messages can't be taken at once.
    """
    if not isinstance(batch.sizes, int):
        return None
    skip, end = batch.header + (4 if code else 0), batch.header + batch.sizes
    places = {path: Place(skip + _fixed(place.at), place.dtype) for path, place in found.places.items()}
    alike = _alike(batch, found, layout, code, skip)
    head = _head(batch, alike, places, imu)
    if head > min(_HEAD, end) or skip + _fixed(found.end) > end:
        return None
    if imu.stamp is not None and places[imu.stamp.sec].dtype[1] == "f":
        return None
    plain = [vector for vector in imu.vectors if not vector.divisor and adjacent(places, vector)]
    return Template(
        guards=batch.guards,
        alike=Alike(alike, head),
        head=head,
        end=end,
        places=places,
        imu=imu,
        spans=_spans([(vector.sensor, places[vector.paths[0]]) for vector in plain]),
        others=tuple(vector for vector in imu.vectors if vector not in plain),
    )


def _spans(vectors: list[tuple[Sensor, Place]]) -> tuple[_Span, ...]:
    """Return the spans of bytes in which vectors lie, each given with the place of its first number."""
    spans: list[_Span] = []
    for sensor, place in sorted(vectors, key=lambda vector: _fixed(vector[1].at)):
        at, size = _fixed(place.at), 3 * int(place.dtype[-1])
        first, _, inside = spans[-1] if spans else (0, 0, ())
        if inside and at + size - first <= _WIDEST:
            spans[-1] = (first, at + size - first, (*inside, (sensor, at - first, place.dtype)))
        else:
            spans.append((at, size, ((sensor, 0, place.dtype),)))
    return tuple(spans)


def _alike(batch: Batch, found: Found, layout: Layout, code: bytes, skip: int) -> tuple[_Guard, ...]:
    """Return what every record must repeat: its head, the encapsulation and the lengths of strings."""
    u4 = np.dtype(layout.order + "u4")
    lengths = [
        (skip + _fixed(at), np.array(_fixed(length), dtype=u4).tobytes()) for at, length in found.lengths
    ]
    encapsulation = [(batch.header, code)] if code else []
    return (*batch.guards, *encapsulation, *lengths)


def _head(batch: Batch, alike: Sequence[_Guard], places: dict[str, Place], imu: ImuFields) -> int:
    """Return how many bytes at the start of a record hold what is alike, and the stamps."""
    ends = [at + len(value) for at, value in alike]
    if imu.stamp is not None:
        times = [places[path] for path in (imu.stamp.sec, imu.stamp.nanosec) if path]
        ends += [_fixed(place.at) + int(place.dtype[-1]) for place in times]
    head = max([*ends, (batch.log_at or 0) + 8])
    whole = -(-head // 8) * 8
    return whole if whole <= batch.header + batch.sizes else head


def _gather(buffer: Bytes, starts: IntArray, at: int, width: int) -> NDArray[np.void]:
    """Copy `width` bytes from ``starts + at``, whose bounds were checked; see `walker.gather`."""
    count = len(buffer) - at - width + 1
    view: NDArray[np.void] = np.ndarray((count,), f"V{width}", buffer=buffer, offset=at, strides=(1,))
    return view[starts]


def _cells(rows: NDArray[np.void], at: int, dtype: str) -> NDArray[Any]:
    """Return the number that stands `at` so many bytes in each row; copies nothing."""
    return np.ndarray(rows.shape, dtype, buffer=rows, offset=at, strides=rows.strides)


def _fixed(at: Position) -> int:
    """Return the position that a walk of one message gives."""
    return int(np.asarray(at).reshape(-1)[0])
