"""JSON documents: nodes with a place in the document, and layouts of dataclasses.

Numbers that are not finite are null.
"""

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import PurePath
from typing import Any, Generic, Literal, NamedTuple, NoReturn, TypeAlias, TypeVar, get_args, get_origin

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray
from imucal.errors import Fix, ReadError
from imucal.printable import printable_json
from imucal.recording import Sensor

_MAX_TEXT = 40
JsonObject: TypeAlias = dict[str, object]
A = TypeVar("A")
T = TypeVar("T", bound=np.generic)


@dataclass(frozen=True, slots=True)
class Node:
    """A value of the document and its place, such as ``report.json: axes[2].fit.method``."""

    value: object
    file: str
    place: str = ""

    def __getitem__(self, key: str) -> "Node":
        table = self.table()
        if key not in table:
            keys = ", ".join(table) or "no keys"
            self.fail(f"found {keys}", f"the key {key!r}")
        return Node(table[key], self.file, f"{self.place}.{key}".lstrip("."))

    def __iter__(self) -> Iterator["Node"]:
        for index, item in enumerate(self._of("a list", list)):
            yield Node(item, self.file, f"{self.place}[{index}]")

    def fail(self, found: str, expected: str) -> NoReturn:
        where = f"{self.file}: {self.place}" if self.place else self.file
        raise ReadError(f"{found}, expected {expected}", place=where, fix=Fix("write the report again"))

    def table(self) -> JsonObject:
        return self._of("an object", dict)

    def maybe(self, read: Callable[["Node"], A]) -> A | None:
        return None if self.value is None else read(self)

    def text(self, *allowed: str) -> str:
        """Return the text, one of `allowed` if given."""
        value = self._of("a text", str)
        if allowed and value not in allowed:
            self._refuse(" or ".join(f'"{choice}"' for choice in allowed))
        return value

    def texts(self) -> tuple[str, ...]:
        return tuple(item.text() for item in self)

    def number(self, *, null: float | None = None) -> float:
        """Return the number; `null` replaces null if given."""
        if self.value is None and null is not None:
            return null
        value = self._of("a number", float, int)
        if not math.isfinite(value):
            self._refuse("a finite number")
        return float(value)

    def positive(self) -> float:
        value = self.number()
        if value <= 0:
            self._refuse("a number above 0")
        return value

    def count(self) -> int:
        value = self._of(expected := "a whole number from 0", int)
        if value < 0:
            self._refuse(expected)
        return value

    def integer(self) -> int:
        return self._of("a whole number", int)

    def pair(self) -> tuple[float, float]:
        values = [item.number() for item in self]
        if len(values) != 2:
            self._refuse("a list of two numbers")
        return values[0], values[1]

    def array(self, *, like: int | None = None) -> FloatArray:
        """Return numbers, null as NaN, with `like` items if given; shape (k,)."""
        return self.sized(np.array([item.number(null=math.nan) for item in self], np.float64), like)

    def counts(self, *, like: int | None = None) -> IntArray:
        """Return whole numbers from 0; shape (k,)."""
        return self.sized(np.array([item.count() for item in self], dtype=np.int64), like)

    def matrix(self, size: int) -> FloatArray:
        """Return numbers, null as NaN; shape (size, size)."""
        rows = [row.array(like=size) for row in self]
        if len(rows) != size:
            self._refuse(f"{size} rows")
        return np.array(rows, dtype=np.float64).reshape(size, size)

    def sized(self, array: NDArray[T], like: int | None) -> NDArray[T]:
        if like is not None and array.size != like:
            self.fail(f"found a list of {array.size}", f"{like} items, like the other lists")
        return array

    def _of(self, expected: str, *kinds: type[A]) -> A:
        """Return the value if it has this type, otherwise raise an error; a boolean is not a number."""
        if isinstance(self.value, bool) or not isinstance(self.value, kinds):
            self._refuse(expected)
        return self.value

    def _refuse(self, expected: str) -> NoReturn:
        found = json.dumps(self.value)
        shown = found if len(found) <= _MAX_TEXT else f"{found[:_MAX_TEXT]}…"
        self.fail(f"found {shown}", expected)


Reader: TypeAlias = Callable[[Node], Any]


class Key(NamedTuple):
    """A key; `like` is the key of a list of the same length, `read` returns the attribute."""

    name: str
    optional: bool
    attribute: str
    like: str
    read: Reader | None


@dataclass(frozen=True, slots=True)
class Layout(Generic[A]):
    """The keys of the object for a dataclass."""

    make: Callable[..., A]
    keys: tuple[Key, ...]

    def read(self, node: Node, **known: object) -> A:
        """Return the value; `known` contains attributes that are not in the node."""
        found: dict[str, Any] = dict(known)
        sizes: dict[str, int] = {}
        for key in self.keys:
            absent = key.optional and key.name not in node.table()
            if key.read is None or key.attribute in known or absent:
                continue
            found[key.attribute] = value = key.read(node[key.name])
            if isinstance(value, np.ndarray):
                sizes[key.name] = value.shape[-1]
                node[key.name].sized(value, sizes.get(key.like))
        return self.make(**found)

    def write(self, value: A, **others: object) -> JsonObject:
        """Return an object; `others` contains keys that are not attributes."""
        found: JsonObject = {}
        for key in self.keys:
            held = getattr(value, key.attribute) if key.attribute else None
            if key.name in others or (key.attribute and not (key.optional and held is None)):
                found[key.name] = others.get(key.name, held)
        return found


def one_of(*allowed: str) -> Reader:
    """Return a reader of the allowed texts."""
    return lambda node: node.text(*allowed)


def maybe(read: Reader) -> Reader:
    """Return a reader that accepts null."""
    return lambda node: node.maybe(read)


def list_of(read: Reader) -> Reader:
    """Return a reader of a list."""
    return lambda node: tuple(map(read, node))


def number_or(null: float) -> Reader:
    """Return a reader of a number that replaces null."""
    return lambda node: node.number(null=null)


OR_NAN, OR_INFINITE = number_or(math.nan), number_or(math.inf)
#: `layout_of` adds readers of dataclasses.
READERS: dict[object, Reader] = {
    str: Node.text,
    int: Node.count,
    float: Node.number,
    FloatArray: Node.array,
    IntArray: Node.counts,
    Sensor: lambda node: Sensor(node.text(*Sensor)),
    Mapping[str, object]: Node.table,
    str | None: maybe(Node.text),
    int | None: maybe(Node.integer),
    float | None: maybe(Node.number),
    tuple[str, ...]: Node.texts,
    tuple[float, float]: Node.pair,
    tuple[float, float] | None: maybe(Node.pair),
}
_LAYOUTS: dict[type, Layout[Any]] = {}


def layout_of(make: type[A], keys: str, **read: Reader) -> Layout[A]:
    """Return the layout of a dataclass and register it for values that contain the class.

    A key has the form ``name?=attribute~like``. With the question mark it may be missing, and None is not
    written. With ``=`` alone there is no attribute. `read` has readers of types that `READERS` lacks.
    """
    types: dict[str, Any] = {each.name: each.type for each in fields(make)}  # type: ignore[arg-type]
    made = []
    for text in keys.split():
        name, optional, same, attribute, like = re.fullmatch(  # type: ignore[union-attr]
            r"(\w+)(\??)(=?)(\w*)~?(\w*)", text
        ).groups()
        attribute = attribute if same else name
        kind = types.get(attribute)
        usual = one_of(*get_args(kind)) if get_origin(kind) is Literal else READERS.get(kind)
        made.append(Key(name, bool(optional), attribute, like, read.get(name, usual)))
    layout = _LAYOUTS[make] = Layout(make, tuple(made))
    READERS.update(
        {make: layout.read, make | None: maybe(layout.read), tuple[make, ...]: list_of(layout.read)}  # type: ignore[valid-type]
    )
    return layout


def plain(value: object) -> object:
    """Return JSON values: arrays as lists, NaN as null; raises TypeError for unknown types."""
    if value is None or isinstance(value, bool | str | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if type(value) in _LAYOUTS:
        value = _LAYOUTS[type(value)].write(value)
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, Sequence):
        return [plain(item) for item in value]
    if isinstance(value, PurePath):
        return str(value)
    raise TypeError(f"{type(value).__name__} can't be written to a report: {value!r}")


def picked(value: object, names: str) -> JsonObject:
    """Return attributes as JSON values; ``term=key`` puts the attribute `key` under ``term``."""
    pairs = (name.partition("=")[::2] for name in names.split())
    return {key: plain(getattr(value, attribute or key)) for key, attribute in pairs}


def dumps(document: object) -> str:
    """Return the text of a document, with one key a line."""
    return _text(document, "") + "\n"


def _text(value: object, indent: str) -> str:
    inner = f"{indent}  "
    if isinstance(value, dict) and value:
        lines = [f"{inner}{json.dumps(k)}: {_text(v, inner)}" for k, v in value.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        lines = [inner + _text(item, inner) for item in value]
        return "[\n" + ",\n".join(lines) + f"\n{indent}]"
    return printable_json(json.dumps(value, allow_nan=False, ensure_ascii=False))
