"""JSON of dataclasses, written and read by their type hints: attributes are keys.

Numbers that are not finite are null. A hint ``Annotated[type, Key(…)]`` adds what a value needs besides its
type. Attributes that comparisons ignore are not written.
"""

import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import PurePath
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NoReturn,
    TypeAlias,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.errors import Fix, ReadError
from imucal.printable import printable_json

JsonObject: TypeAlias = dict[str, object]
A = TypeVar("A")

#: Characters of a wrong value in a message.
_MAX_TEXT = 40
#: Larger whole numbers do not fit into 64 bits.
_MAX_INTEGER = 2**63 - 1


@dataclass(frozen=True, kw_only=True)
class Key:
    """What a value needs besides its type.

    Attributes
    ----------
    null
        The number that is written as null; None if null is refused.
    above, below, least
        Limits of a number, or of each item of an array: ``above < number < below``, ``number >= least``.
    choices
        The allowed texts; empty for any.
    like
        The key of a list of the same length, which comes first.
    shape
        The shape of an array; by default that of a list of numbers of any length.
    """

    null: float | None = math.nan
    above: float = -math.inf
    below: float = math.inf
    least: float = -math.inf
    choices: tuple[str, ...] = ()
    like: str = ""
    shape: tuple[int, ...] = ()


@dataclass(frozen=True)
class Place:
    """A place in a document, such as ``report.json: axes[2].fit.method``, and what to do if it is wrong."""

    file: str
    fix: str
    path: str = ""

    def key(self, name: str) -> "Place":
        return Place(self.file, self.fix, f"{self.path}.{name}".lstrip("."))

    def item(self, index: int) -> "Place":
        return Place(self.file, self.fix, f"{self.path}[{index}]")

    def refuse(self, found: str, expected: str) -> NoReturn:
        """Raise a ReadError."""
        where = f"{self.file}: {self.path}" if self.path else self.file
        raise ReadError(f"{found}, expected {expected}", place=where, fix=Fix(self.fix))

    def refuse_value(self, value: object, expected: str) -> NoReturn:
        """Raise a ReadError with the start of the value."""
        text = json.dumps(value)
        shown = text if len(text) <= _MAX_TEXT else f"{text[:_MAX_TEXT]}…"
        self.refuse(f"found {shown}", expected)

    def check_schema(self, document: object, schema: str) -> None:
        """Raise a ReadError if a document does not have this schema."""
        found = _table(document, self).get("schema")
        if found != schema:
            self.refuse(f"the schema is {json.dumps(found)}", f'"{schema}"')


def to_json(value: object) -> Any:  # noqa: ANN401 - JSON
    """Return JSON values: dataclasses as objects, arrays as lists, numbers that are not finite as null.

    Raises
    ------
    TypeError
        If a value has an unknown type.
    """
    if value is None or isinstance(value, bool | str | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.ndarray | np.generic):
        return to_json(value.tolist())
    if is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in fields_of(type(value))}
    if isinstance(value, Mapping):
        return {str(key): to_json(item) for key, item in value.items()}
    if isinstance(value, Sequence):
        return [to_json(item) for item in value]
    if isinstance(value, PurePath):
        return str(value)
    raise TypeError(f"{type(value).__name__} can't be written to a report: {value!r}")


def from_json(kind: type[A], value: object, place: Place) -> A:
    """Return the dataclass of a JSON object.

    A key may be missing if its attribute has a default. Other keys are ignored.

    Raises
    ------
    ReadError
        If a value does not fit its hint; the error contains its place in the document.
    """
    result: A = _dataclass(kind, value, place)
    return result


def is_optional(hint: object) -> bool:
    """Return whether a hint allows None."""
    return get_origin(hint) in {Union, UnionType} and NoneType in get_args(hint)


def without_none(hint: object) -> Any:  # noqa: ANN401 - a type
    """Return an optional hint without None."""
    return next(part for part in get_args(hint) if part is not NoneType)


@cache
def fields_of(kind: Any) -> tuple[Field[Any], ...]:  # noqa: ANN401 - any dataclass
    """Return the fields that are keys: those that count when two values are compared."""
    return tuple(field for field in fields(kind) if field.compare)


@cache
def hints_of(kind: type) -> dict[str, Any]:
    """Return the hint of each field of a dataclass."""
    hints = get_type_hints(kind, include_extras=True)
    return {field.name: hints[field.name] for field in fields_of(kind)}


def choices_of(hint: object, key: Key) -> tuple[str, ...]:
    """Return the allowed texts of a literal, of an enumeration of texts, or of a key; () for any."""
    if get_origin(hint) is Literal:
        return get_args(hint)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return tuple(member.value for member in hint)
    return key.choices


_PLAIN = Key()


def _value(hint: Any, value: object, place: Place, key: Key = _PLAIN) -> Any:  # noqa: ANN401 - any type
    origin = get_origin(hint)
    if origin is Annotated:
        return _value(hint.__origin__, value, place, hint.__metadata__[0])
    if is_optional(hint):
        return None if value is None else _value(without_none(hint), value, place, Key(null=None))
    if origin is tuple:
        return _tuple(get_args(hint), value, place)
    if origin is Mapping:
        item_hint = get_args(hint)[1]
        return {name: _value(item_hint, item, place.key(name)) for name, item in _table(value, place).items()}
    if is_dataclass(hint):
        return _dataclass(hint, value, place)
    return _simple(hint, value, place, key)


def _simple(hint: Any, value: object, place: Place, key: Key) -> Any:  # noqa: ANN401 - any type
    if hint in (FloatArray, IntArray):
        return _array(hint, value, place, key)
    if hint in (float, int):
        return _number(hint, value, place, key)
    if hint is object:
        return value
    if hint is bool:
        return value if isinstance(value, bool) else place.refuse_value(value, "true or false")
    return _text(hint, value, place, key)


def _table(value: object, place: Place) -> JsonObject:
    return value if isinstance(value, dict) else place.refuse_value(value, "an object")


def _list(value: object, place: Place) -> list[object]:
    return value if isinstance(value, list) else place.refuse_value(value, "a list")


def _dataclass(kind: Any, value: object, place: Place) -> Any:  # noqa: ANN401 - any dataclass
    table = _table(value, place)
    attributes: dict[str, Any] = {}
    for field in fields_of(kind):
        if field.name not in table:
            if _has_default(field):
                continue
            place.refuse(f"found {', '.join(table) or 'no keys'}", f"the key {field.name!r}")
        hint, inner = hints_of(kind)[field.name], place.key(field.name)
        attributes[field.name] = _value(hint, table[field.name], inner)
        if get_origin(hint) is Annotated and (like := hint.__metadata__[0].like):
            check_length(attributes[field.name], len(attributes[like]), inner)
    return kind(**attributes)


def _has_default(field: Field[Any]) -> bool:
    return field.default is not MISSING or field.default_factory is not MISSING


def check_length(values: Sequence[object] | FloatArray, length: int, place: Place) -> None:
    """Raise a ReadError if a list does not have as many items as the other lists."""
    if len(values) != length:
        place.refuse(f"found a list of {len(values)}", f"{length} items, like the other lists")


def _tuple(hints: tuple[Any, ...], value: object, place: Place) -> tuple[Any, ...]:
    items = _list(value, place)
    if hints[-1] is ...:
        hints = hints[:1] * len(items)
    if len(items) != len(hints):
        place.refuse_value(value, f"a list of {len(hints)}")
    pairs = zip(hints, items, strict=True)
    return tuple(_value(hint, item, place.item(index)) for index, (hint, item) in enumerate(pairs))


def _text(hint: Any, value: object, place: Place, key: Key) -> Any:  # noqa: ANN401 - a text or an enumeration
    choices = choices_of(hint, key)
    if not isinstance(value, str):
        place.refuse_value(value, "a text" if not choices else _either(choices))
    if choices and value not in choices:
        place.refuse_value(value, _either(choices))
    return hint(value) if isinstance(hint, type) else value


def _either(choices: Sequence[str]) -> str:
    return " or ".join(f'"{choice}"' for choice in choices)


def _array(hint: object, value: object, place: Place, key: Key) -> FloatArray | IntArray:
    if hint == FloatArray:
        return np.array(_numbers(float, value, place, key, key.shape), dtype=np.float64)
    return np.array(_numbers(int, value, place, key, key.shape), dtype=np.int64)


def _numbers(kind: type, value: object, place: Place, key: Key, shape: tuple[int, ...]) -> list[object]:
    items = _list(value, place)
    if shape and len(items) != shape[0]:
        place.refuse_value(value, f"a list of {shape[0]}")
    if len(shape) > 1:
        return [_numbers(kind, item, place.item(index), key, shape[1:]) for index, item in enumerate(items)]
    for index, item in enumerate(items):
        if expected := _misfit(kind, item, key):
            place.item(index).refuse_value(item, expected)
    return [key.null if item is None else item for item in items]


def _number(kind: type, value: object, place: Place, key: Key) -> Any:  # noqa: ANN401 - float or int
    if expected := _misfit(kind, value, key):
        place.refuse_value(value, expected)
    return key.null if value is None else kind(value)


def _misfit(kind: type, value: Any, key: Key) -> str:  # noqa: ANN401 - JSON
    """Return what was expected of a number; empty if it fits."""
    if value is None and kind is float and key.null is not None:
        return ""
    numbers = (int, float) if kind is float else (int,)
    if isinstance(value, bool) or not isinstance(value, numbers):
        return _expected(kind, key)
    # Python compares whole numbers of any size with floats; a comparison with NaN is false.
    if kind is float and not abs(value) <= sys.float_info.max:
        return "a finite number"
    if kind is int and abs(value) > _MAX_INTEGER:
        return "a whole number of 64 bits"
    fits = key.above < value < key.below and value >= key.least
    return "" if fits else _expected(kind, key)


def _expected(kind: type, key: Key) -> str:
    noun = "a number" if kind is float else "a whole number"
    if math.isfinite(key.least):
        return f"{noun} from {key.least:g}"
    if math.isfinite(key.below):
        return f"{noun} between {key.above:g} and {key.below:g}"
    return f"{noun} above {key.above:g}" if math.isfinite(key.above) else noun


def picked(value: object, names: str) -> JsonObject:
    """Return attributes as JSON values; ``term=key`` puts the attribute `key` under ``term``."""
    pairs = (name.partition("=")[::2] for name in names.split())
    return {key: to_json(getattr(value, attribute or key)) for key, attribute in pairs}


def dumps(document: object) -> str:
    """Return the text of a document, with one key a line."""
    return _lines(document, "") + "\n"


def _lines(value: object, indent: str) -> str:
    inner = f"{indent}  "
    if isinstance(value, dict) and value:
        lines = [f"{inner}{json.dumps(key)}: {_lines(item, inner)}" for key, item in value.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        lines = [inner + _lines(item, inner) for item in value]
        return "[\n" + ",\n".join(lines) + f"\n{indent}]"
    return printable_json(json.dumps(value, allow_nan=False, ensure_ascii=False))
