"""The array types every stage speaks, the read-only view that values hold, and how large arrays may be."""

import os
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]

T = TypeVar("T", bound=np.generic)

#: Memory that one step may take, in bytes, where the machine does not say how much it has.
_UNKNOWN = 2_000_000_000


def read_only(array: NDArray[T]) -> NDArray[T]:
    """Return a view of `array` that can't be written through; copies nothing."""
    view = array.view()
    view.flags.writeable = False
    return view


def memory_limit() -> int:
    """Return how many bytes one step may take: a quarter of the memory; 2 GB where that can't be asked."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 4
    except (AttributeError, ValueError, OSError):
        return _UNKNOWN
