"""Where the fields of many messages lie, found for all of them at once from the message definition.

A position is kept as one integer while all strings and sequences so far have the same length in every
message, and as an int64 vector otherwise; there is no loop over messages.

Layouts: ROS 1 (no alignment); CDR and XCDR2 (numbers aligned to their size, at most 8 or 4 bytes, from
the end of the four bytes of encapsulation). Source: OMG DDS-XTypes 1.3, 7.4.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.readers.containers import Bytes, gather
from imucal.readers.files import DamagedError
from imucal.readers.messages.definitions import Field

#: From the start of the payload: the same for all messages, or one for each.
Position: TypeAlias = int | IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where a wanted field lies, from the start of the payload, and its NumPy type with byte order."""

    at: Position
    dtype: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """How numbers are laid out.

    Attributes
    ----------
    order
        ``<`` or ``>``.
    align
        Largest alignment in bytes; 1 for ROS 1.
    """

    order: str = "<"
    align: int = 8


@dataclass(slots=True, eq=False)
class Found:
    """What a walk gives: places of wanted fields, the length words passed, and where it stopped."""

    places: dict[str, Place] = field(default_factory=dict)
    lengths: list[tuple[Position, NDArray[np.int64] | int]] = field(default_factory=list)
    end: Position = 0


#: One element of an array.
_ELEMENT = re.compile(r"(.+)\[(\d+)\]")


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

        Raises
        ------
        DamagedError
            If a length reaches beyond the buffer.
        """
        found = Found()
        at: Position = 0
        for entry in self.fields:
            if entry.kind in {"number", "array"}:
                at = _align(at, entry.size, layout)
                if entry.path in self.wanted:
                    found.places[entry.path] = Place(at, layout.order + entry.code)
                self._note_elements(entry, at, layout, found)
                at = at + entry.size * entry.count
            else:
                at = self._skip(buffer, starts, at, entry, layout, found)
        found.end = at
        return found

    def _note_elements(self, entry: Field, at: Position, layout: Layout, found: Found) -> None:
        """Note the places of the wanted elements of an array that starts at `at`."""
        for index, path in self.elements.get(entry.path, {}).items():
            found.places[path] = Place(at + index * entry.size, layout.order + entry.code)

    def _skip(  # noqa: PLR0917 - all that a step of the walk knows
        self, buffer: Bytes, starts: IntArray, at: Position, entry: Field, layout: Layout, found: Found
    ) -> Position:
        """Return the position after a string or a sequence."""
        at = _align(at, 4, layout)
        words = gather(buffer, starts + at, 4).view(layout.order + "u4").astype(np.int64)
        first = int(words[0])
        length: IntArray | int = first if bool((words == first).all()) else words
        if int(np.max(length)) * max(entry.size * entry.count, 1) > len(buffer):
            msg = f"{entry.path} claims {int(np.max(length))} elements, more than its chunk holds"
            raise DamagedError(msg)
        found.lengths.append((at, length))
        at = at + 4
        if entry.path in self.elements:
            last = max(self.elements[entry.path])
            if int(np.min(length)) <= last:
                msg = f"{entry.path} has {int(np.min(length))} elements in a message, and no [{last}]"
                raise DamagedError(msg)
            self._note_elements(entry, _align(at, entry.size, layout), layout, found)
        if entry.kind == "string":
            return at + length
        size = entry.size * entry.count
        if isinstance(length, int):
            return _align(at, entry.size, layout) + length * size if length else at
        return np.where(length > 0, _align(at, entry.size, layout) + length * size, at)


def _align(at: Position, size: int, layout: Layout) -> Position:
    """Round a position up to the alignment of a number of `size` bytes."""
    step = min(size, layout.align)
    return at if step <= 1 else (at + (step - 1)) & -step
