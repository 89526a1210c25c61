"""A cursor over a JSON document that says where something is wrong.

``node["fit"]["method"].text()`` raises `ReadError` with the place, what was found and what was
expected, so that no caller needs to check types.
"""

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray
from imucal.errors import ReadError

_SHOWN = 40

A = TypeVar("A")
T = TypeVar("T", bound=np.generic)


@dataclass(frozen=True, slots=True)
class Node:
    """A value of the document and its place, such as ``report.json: axes[2].fit.method``."""

    value: object
    file: str
    place: str = ""

    def __getitem__(self, key: str) -> "Node":
        """Return the value under `key`, which must be there."""
        table = self.table()
        if key not in table:
            keys = ", ".join(table) or "no keys"
            self.fail(f"found {keys}", f"the key {key!r}")
        return Node(table[key], self.file, f"{self.place}.{key}".lstrip("."))

    def __iter__(self) -> Iterator["Node"]:
        """Yield the items of a list."""
        if not isinstance(self.value, list):
            self._refuse("a list")
        for index, item in enumerate(self.value):
            yield Node(item, self.file, f"{self.place}[{index}]")

    def fail(self, found: str, expected: str) -> NoReturn:
        """Raise the error that names this place."""
        where = f"{self.file}: {self.place}" if self.place else self.file
        msg = f"{where}: {found}, expected {expected}; write the report again"
        raise ReadError(msg)

    def table(self) -> dict[str, object]:
        """Return the value, which must be an object."""
        if not isinstance(self.value, dict):
            self._refuse("an object")
        return self.value

    def maybe(self, read: Callable[["Node"], A]) -> A | None:
        """Return None for null, else what `read` makes of the node."""
        return None if self.value is None else read(self)

    def text(self, *allowed: str) -> str:
        """Return the value, which must be a text, one of `allowed` where given."""
        if not isinstance(self.value, str):
            self._refuse("a text")
        if allowed and self.value not in allowed:
            self._refuse(" or ".join(f'"{choice}"' for choice in allowed))
        return self.value

    def texts(self) -> tuple[str, ...]:
        """Return a list of texts."""
        return tuple(item.text() for item in self)

    def number(self, *, null: float | None = None) -> float:
        """Return the value, which must be a number; `null` stands for null where given."""
        if self.value is None and null is not None:
            return null
        if isinstance(self.value, bool) or not isinstance(self.value, int | float):
            self._refuse("a number")
        if not math.isfinite(self.value):
            self._refuse("a finite number")
        return float(self.value)

    def positive(self) -> float:
        """Return the value, which must be a number above 0."""
        value = self.number()
        if value <= 0:
            self._refuse("a number above 0")
        return value

    def count(self) -> int:
        """Return the value, which must be a whole number from 0."""
        if isinstance(self.value, bool) or not isinstance(self.value, int) or self.value < 0:
            self._refuse("a whole number from 0")
        return self.value

    def integer(self) -> int:
        """Return the value, which must be a whole number."""
        if isinstance(self.value, bool) or not isinstance(self.value, int):
            self._refuse("a whole number")
        return self.value

    def pair(self) -> tuple[float, float]:
        """Return a list of two numbers."""
        values = [item.number() for item in self]
        if len(values) != 2:
            self._refuse("a list of two numbers")
        return values[0], values[1]

    def array(self, *, like: int | None = None) -> FloatArray:
        """Return a list of numbers, null as NaN, of `like` items where given; shape (k,)."""
        return self._sized(np.array([item.number(null=math.nan) for item in self], np.float64), like)

    def counts(self, *, like: int | None = None) -> IntArray:
        """Return a list of whole numbers, of `like` items where given; shape (k,)."""
        return self._sized(np.array([item.count() for item in self], dtype=np.int64), like)

    def matrix(self, size: int) -> FloatArray:
        """Return a square list of lists of numbers, null as NaN; shape (size, size)."""
        rows = [row.array(like=size) for row in self]
        if len(rows) != size:
            self._refuse(f"{size} rows")
        return np.array(rows, dtype=np.float64).reshape(size, size)

    def _sized(self, array: NDArray[T], like: int | None) -> NDArray[T]:
        if like is not None and array.size != like:
            self.fail(f"found a list of {array.size}", f"{like} items as beside it")
        return array

    def _refuse(self, expected: str) -> NoReturn:
        found = json.dumps(self.value)
        shown = found if len(found) <= _SHOWN else f"{found[:_SHOWN]}…"
        self.fail(f"found {shown}", expected)
