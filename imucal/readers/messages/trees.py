"""Decode messages one by one: JSON, protobuf, and ROS messages with lists of structures."""

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.readers.containers import Batch
from imucal.readers.files import DamagedError

#: Bytes of a message -> mappings, lists and numbers, or objects.
Parse: TypeAlias = Callable[[bytes], Any]

#: Type of a leaf with seconds and nanoseconds.
TIME = "time"
_SECONDS = ("sec", "secs", "seconds")
_NANOSECONDS = ("nanosec", "nanos", "nsec", "nsecs", "nanoseconds")
#: Most members examined of a JSON object.
_MAX_MEMBERS = 600

_STEP = re.compile(r"\[(\d+)\]|([^.\[\]]+)")


@dataclass(frozen=True)
class Leaf:
    """A number, a time, or an array of numbers in a message.

    ``imus[0].gyro.x`` represents all elements of a list. The type is such as ``float64``, ``time`` or
    ``int16[3]``.
    """

    path: str
    type: str

    def __str__(self) -> str:
        return f"{self.path} {self.type}"


class TreeDecoder:
    """Decodes messages one by one, in 6 µs or more each; `paths` are the wanted numbers."""

    #: Some messages of a topic may have no sample.
    group = 1

    def __init__(self, paths: Sequence[str], parse: Parse = json.loads, kind: str = "JSON") -> None:
        self._parse, self._kind = parse, kind
        self._steps = [[name or int(index) for index, name in _STEP.findall(path)] for path in paths]

    def decode(self, batch: Batch) -> list[NDArray[Any]]:
        """Return the wanted numbers; raises DamagedError if a message is damaged or lacks a field."""
        rows = [self._row(bytes(data)) for data in batch.messages()]
        columns = (list(cells) for cells in zip(*rows, strict=True))
        return [batch.log_ns, *(np.array(cells, _common_type(cells)) for cells in columns)]

    def _row(self, data: bytes) -> list[int | float]:
        try:
            tree = self._parse(data)
            return [_value(_follow(tree, steps)) for steps in self._steps]
        except Exception as error:
            # Parsers have their own error classes.
            msg = f"a {self._kind} message has no IMU sample: {type(error).__name__} {error}"
            raise DamagedError(msg) from error


def _common_type(cells: Sequence[int | float]) -> type[np.generic]:
    return np.int64 if all(isinstance(cell, int) for cell in cells) else np.float64


def _follow(tree: Any, steps: Sequence[str | int]) -> Any:  # noqa: ANN401 - any tree
    for step in steps:
        tree = tree[step] if isinstance(step, int) or isinstance(tree, Mapping) else getattr(tree, str(step))
    return tree


def _value(value: Any) -> int | float:  # noqa: ANN401 - any value of a tree
    if value is None:
        return math.nan
    if isinstance(value, int | np.integer | np.bool_):
        return int(np.int64(value))
    if isinstance(value, float | np.floating | str):
        return float(value)
    get = value.get if isinstance(value, Mapping) else lambda name: getattr(value, name, None)
    seconds, nanoseconds = (
        next(int(part) for part in map(get, names) if part is not None) for names in (_SECONDS, _NANOSECONDS)
    )
    return int(np.int64(seconds * 1_000_000_000 + nanoseconds))


def is_time(names: Sequence[str]) -> bool:
    """Return whether the fields of a structure are seconds and nanoseconds."""
    return len(names) == 2 and any(n in _SECONDS for n in names) and any(n in _NANOSECONDS for n in names)


def leaves_of_tree(tree: object, path: str = "") -> Iterator[Leaf]:
    """Yield the numbers of a JSON message."""
    if isinstance(tree, Mapping):
        if path and is_time(list(tree)) and all(isinstance(value, int) for value in tree.values()):
            yield Leaf(path, TIME)
            return
        for name, value in list(tree.items())[:_MAX_MEMBERS]:
            yield from leaves_of_tree(value, f"{path}.{name}" if path else str(name))
    elif isinstance(tree, list):
        if tree and all(map(_is_number, tree)):
            yield Leaf(path, f"number[{len(tree)}]")
        elif tree and isinstance(tree[0], Mapping):
            yield from leaves_of_tree(tree[0], f"{path}[0]")
    elif _is_number(tree):
        yield Leaf(path, "number")


def _is_number(value: object) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))
