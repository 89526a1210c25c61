"""Types of arrays, read-only views, and blocks of arrays."""

from collections.abc import Iterator, Sequence
from dataclasses import fields
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]

_HELD_AS: dict[object, Any] = {FloatArray: np.float64, IntArray: np.int64, BoolArray: np.bool_}
#: Bytes of a cache line.
_LINE = 64

T = TypeVar("T", bound=np.generic)


def read_only(array: NDArray[T]) -> NDArray[T]:
    """Return a view of `array` that can't be written through; copies nothing."""
    view = array.view()
    view.flags.writeable = False
    return view


class ReadOnlyArrays:
    """A frozen dataclass whose arrays are read-only and have the types of their annotations."""

    def __post_init__(self) -> None:
        value: Any = self
        for field in fields(value):
            if field.type in _HELD_AS:
                array = np.asarray(getattr(self, field.name), dtype=_HELD_AS[field.type])
                object.__setattr__(self, field.name, read_only(array))


def aligned(n: int) -> FloatArray:
    """Return an uninitialised array of n floats that starts at a cache line.

    NumPy's arrays start 16 bytes after one, and passes that write to them take twice as long.
    """
    memory = np.empty(8 * n + _LINE, dtype=np.uint8)
    start = -int(memory.__array_interface__["data"][0]) % _LINE
    return memory[start : start + 8 * n].view(np.float64)


def median(values: NDArray[Any] | Sequence[float]) -> float:
    """Return the median of finite numbers, shape (n,), n >= 1, bit-identical to `numpy.median`.

    `numpy.median`, `numpy.percentile` and `numpy.unique` import masked arrays, which is slow.
    """
    array = np.sort(np.asarray(values))
    middle = array.size // 2
    if array.size % 2:
        return float(array[middle])
    return (float(array[middle - 1]) + float(array[middle])) / 2


def percentile(values: NDArray[Any], percent: float) -> float:
    """Return a percentile of finite numbers, shape (n,), n >= 1: `numpy.percentile` to the bit."""
    array = np.sort(values)
    place = percent / 100 * (array.size - 1)
    low = min(int(place), array.size - 1)
    first, second = float(array[low]), float(array[min(low + 1, array.size - 1)])
    share, step = place - low, second - first
    return second - step * (1 - share) if share >= 0.5 else first + step * share


def distinct(values: IntArray) -> IntArray:
    """Return the distinct integers, shape (n,), in increasing order, as `numpy.unique` does."""
    array = np.sort(values)
    new = np.ones(array.size, dtype=np.bool_)
    new[1:] = array[1:] != array[:-1]
    found: IntArray = array[new]
    return found


#: Values per block: few enough for the cache, many enough for a loop in Python.
BLOCK = 1 << 18


def blocks(n: int, *, size: int = BLOCK) -> Iterator[slice]:
    """Yield slices of `size` values of arrays of n values, to avoid large temporary arrays."""
    for start in range(0, n, size):
        yield slice(start, min(start + size, n))


def never_changes(values: NDArray[Any]) -> bool:
    """Return whether all of at least one value are equal to the first; NaN equals NaN."""
    first = values[0]
    parts = (values[part] for part in blocks(values.size))
    return all(bool((np.isnan(part) if np.isnan(first) else part == first).all()) for part in parts)
