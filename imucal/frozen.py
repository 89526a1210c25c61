"""Decorators of immutable dataclasses with keyword-only fields, and their short texts."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from typing import TypeVar, dataclass_transform

__all__ = ["brief", "frozen", "frozen_alone"]

T = TypeVar("T")

#: Limits of lines, characters of a line, and elements of a sequence in a text.
_LINES, _WIDE, _ELEMENTS = 12, 100, 4


@dataclass_transform(frozen_default=True, kw_only_default=True)
def frozen(cls: type[T]) -> type[T]:
    """Make a class an immutable dataclass with slots and keyword-only fields."""
    return dataclass(frozen=True, slots=True, kw_only=True, repr=False)(_shown(cls))


@dataclass_transform(eq_default=False, frozen_default=True, kw_only_default=True)
def frozen_alone(cls: type[T]) -> type[T]:
    """Do the same for a class with arrays, which can't be compared: values are equal only to themselves."""
    return dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)(_shown(cls))


def _shown(cls: type[T]) -> type[T]:
    """Give a class the short text of `brief`, unless it has its own."""
    if cls.__repr__ is object.__repr__:
        cls.__repr__ = brief  # type: ignore[method-assign] # a function of the value, as any method
    return cls


def brief(value: object) -> str:
    """Return the class and the fields of a dataclass in at most twelve lines.

    Arrays, long sequences and other values are described by their size and type.
    """
    name = type(value).__name__
    parts = [(one.name, _short(getattr(value, one.name))) for one in fields(value) if one.repr]  # type: ignore[arg-type]
    line = f"{name}({', '.join(f'{key}={text}' for key, text in parts)})"
    if len(line) <= _WIDE:
        return line
    most = _LINES - 1 if len(parts) < _LINES else _LINES - 2
    lines = [f"  {key}: {text}" for key, text in parts[:most]]
    more = [f"  and {len(parts) - most} more"] if len(parts) > most else []
    return "\n".join([name, *lines, *more])


def _short(value: object) -> str:
    shape = getattr(value, "shape", None)
    if isinstance(shape, tuple) and shape:
        return f"array of shape {shape}"
    match value:
        case Enum():
            text = str(value)
        case float():
            text = f"{value:.6g}"
        case Mapping():
            text = f"{{{', '.join(map(str, value))}}}"
        case tuple() | list() if len(value) <= _ELEMENTS and not any(map(is_dataclass, value)):
            text = f"({', '.join(map(_short, value))})"
        case tuple() | list():
            kinds = dict.fromkeys(type(each).__name__ for each in value)
            text = f"{len(value)} of {' or '.join(kinds)}"
        case _:
            text = type(value).__name__ if is_dataclass(value) else repr(value)
    return _cut(text)


def _cut(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= _WIDE else f"{text[: _WIDE - 1]}…"
