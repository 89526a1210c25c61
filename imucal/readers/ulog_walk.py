"""Walk the messages of a ULog: find where it is cut off or damaged, and leave the damaged parts out.

pyulog skips damaged bytes and may then read shifted numbers as samples.
Source: docs.px4.io, ULog File Format.
"""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

from imucal.readers.files import damaged_if

#: Bytes of the header: signature, version and start time.
_HEADER = 16
#: Size of the body, and kind of the message.
_HEAD = struct.Struct("<HB")
#: Kinds of messages of the specification.
_KINDS = frozenset(b"BFIMPQADRLCSO")
#: Kinds of the messages that the walk looks into.
_DATA = ord("D")
_FORMAT = ord("F")
_SUBSCRIPTION = ord("A")
_FLAGS = ord("B")
#: Places of data appended after a crash, in the body of the flags.
_APPENDED = slice(16, 40)
#: Bytes of the types of fields.
_SIZES = {
    "int8_t": 1,
    "uint8_t": 1,
    "bool": 1,
    "char": 1,
    "int16_t": 2,
    "uint16_t": 2,
    "int32_t": 4,
    "uint32_t": 4,
    "float": 4,
    "int64_t": 8,
    "uint64_t": 8,
    "double": 8,
}
_FIELD = re.compile(r"(?P<type>\w+)(?:\[(?P<length>\d{1,9})\])? (?P<name>\w+)")
#: Deepest nesting of formats.
_MAX_DEPTH = 8
#: Consecutive messages that must fit after a damage: by chance, one in 10^9 places fits the first.
_FITTING = 3


@dataclass
class Walk:
    """The complete messages of a log, and whether it is cut off or damaged."""

    data: bytes
    #: Start and end of each complete message.
    spans: list[tuple[int, int]] = field(default_factory=list)
    truncated: bool = False
    damaged: bool = False
    #: Whether messages after a damage were found.
    resumed: bool = False

    def sound(self) -> bytes:
        """Return the log without its damaged parts."""
        parts = [self.data[:_HEADER]]
        for start, end in self.spans:
            message = self.data[start:end]
            if message[2] == _FLAGS and len(message) >= _HEAD.size + _APPENDED.stop:
                # The parts have other places now.
                at = _HEAD.size + _APPENDED.start
                message = message[:at] + bytes(24) + message[_HEAD.size + _APPENDED.stop :]
            parts.append(message)
        return b"".join(parts)


def walk(data: bytes) -> Walk:
    """Return the complete messages of a ULog.

    Raises DamagedError if its header is incomplete.
    """
    damaged_if(len(data) < _HEADER, "the file ends within its header", "truncated")
    return _Walker(data).walked()


class _Walker:
    """Follows the heads of messages, with the sizes of subscribed messages."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._walk = Walk(data)
        #: Format -> its fields: type and number.
        self._formats: dict[str, list[tuple[str, int, str]]] = {}
        #: Subscribed message -> possible sizes of its body; empty if unknown.
        self._sizes: dict[int, frozenset[int]] = {}

    def walked(self) -> Walk:
        at = _HEADER
        for limit in self._limits():
            if at < limit:
                self._to(at, limit)
            at = limit
        return self._walk

    def _limits(self) -> list[int]:
        """Return the ends of the log and of the data that were appended after a crash."""
        data, end = self._data, len(self._data)
        first = _HEADER + _HEAD.size
        flags = data[first : first + _APPENDED.stop]
        if len(flags) < _APPENDED.stop or data[_HEADER + 2] != _FLAGS:
            return [end]
        offsets = struct.unpack("<3Q", flags[_APPENDED])
        return [*sorted(offset for offset in offsets if _HEADER < offset < end), end]

    def _to(self, at: int, limit: int) -> None:
        data, spans = self._data, self._walk.spans
        while at < limit:
            end = self._end(at, limit)
            if end > limit:
                self._walk.truncated = True
                return
            if end:
                spans.append((at, end))
                kind = data[at + 2]
                if kind == _FORMAT:
                    self._define(data[at + _HEAD.size : end])
                elif kind == _SUBSCRIPTION:
                    self._subscribe(data[at + _HEAD.size : end])
                at = end
                continue
            self._walk.damaged = True
            # The message before the damage may contain it.
            at = spans.pop()[0] if spans and spans[-1][1] == at else at
            at = self._next(at + 1, limit)
            self._walk.resumed |= at < limit

    def _end(self, at: int, limit: int) -> int:
        """Return the end of the message at a place, perhaps beyond the limit; 0 if none can begin there."""
        data = self._data
        if at + _HEAD.size > limit:
            return limit + 1
        size, kind = _HEAD.unpack_from(data, at)
        end = at + _HEAD.size + int(size)
        if kind == _DATA and at + _HEAD.size + 2 <= limit:
            sizes = self._sizes.get(data[at + 3] | data[at + 4] << 8)
            return end if sizes is not None and (not sizes or size in sizes) else 0
        return end if kind in _KINDS and size else 0

    def _next(self, at: int, limit: int) -> int:
        """Return the first place from which several messages of data follow; the limit if there is none."""
        while (at := self._data.find(b"D", at + 2, limit) - 2) >= 0:
            if self._fits(at, limit):
                return at
            at += 1
        return limit

    def _fits(self, at: int, limit: int) -> bool:
        if not self._sizes:
            return False
        for _ in range(_FITTING):
            end = self._end(at, limit)
            if not end or end > limit:
                return False
            if end == limit:
                return True
            at = end
        return True

    def _define(self, body: bytes) -> None:
        name, _, text = body.decode("ascii", "replace").partition(":")
        fields = [_FIELD.fullmatch(part.strip()) for part in text.split(";") if part.strip()]
        if all(fields):
            self._formats[name] = [
                (found["type"], int(found["length"] or 1), found["name"]) for found in fields if found
            ]

    def _subscribe(self, body: bytes) -> None:
        if len(body) > 3:
            name = body[3:].decode("ascii", "replace")
            self._sizes[body[1] | body[2] << 8] = frozenset(self._possible_sizes(name))

    def _possible_sizes(self, name: str) -> Iterator[int]:
        """Yield the sizes of a subscribed message; the logger may leave out bytes that pad its end."""
        size = self._size(name)
        if size is None:
            return
        # Each message begins with two bytes of its subscription.
        yield size + 2
        for kind, length, name_of_field in reversed(self._formats[name]):
            if not name_of_field.startswith("_padding"):
                return
            size -= (self._size(kind) or 0) * length
            yield size + 2

    def _size(self, kind: str, depth: int = 0) -> int | None:
        """Return the bytes of a type or format; None if it is unknown."""
        if kind in _SIZES:
            return _SIZES[kind]
        if kind not in self._formats or depth > _MAX_DEPTH:
            return None
        sizes = [(self._size(part, depth + 1), length) for part, length, _ in self._formats[kind]]
        return None if any(size is None for size, _ in sizes) else sum((size or 0) * n for size, n in sizes)
