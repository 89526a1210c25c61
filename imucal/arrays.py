"""The array types every stage speaks, and the read-only view that values hold."""

from collections.abc import Sequence
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]

#: Bytes of a line of the cache.
_LINE = 64

T = TypeVar("T", bound=np.generic)


def read_only(array: NDArray[T]) -> NDArray[T]:
    """Return a view of `array` that can't be written through; copies nothing."""
    view = array.view()
    view.flags.writeable = False
    return view


def aligned(n: int) -> FloatArray:
    """Return an array of n floats, not set, that begins where a line of the processor's cache does.

    NumPy's own begin 16 bytes behind one; passes that write to them then take twice as long.
    """
    memory = np.empty(8 * n + _LINE, dtype=np.uint8)
    start = -int(memory.__array_interface__["data"][0]) % _LINE
    return memory[start : start + 8 * n].view(np.float64)


def median(values: NDArray[Any] | Sequence[float]) -> float:
    """Return the median of finite numbers, shape (n,), n >= 1: to the bit what `numpy.median` returns.

    That one, like `numpy.percentile` and `numpy.unique`, imports masked arrays, which takes as long as
    reading 50 000 messages.
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
    """Return the distinct numbers among integers, shape (n,), in rising order, as `numpy.unique` does."""
    array = np.sort(values)
    new = np.ones(array.size, dtype=np.bool_)
    new[1:] = array[1:] != array[:-1]
    found: IntArray = array[new]
    return found
