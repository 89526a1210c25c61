"""Arrays that lie in a mapped file: worked on in blocks, their pages handed back to the system.

A mapped array is used like any other. Its pages count as memory of the process as long as they are in it, so
whoever has gone through one hands them back; they are read again when they are used.
"""

import mmap
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Values of an array worked on at once: what fits the processor's cache, and makes up for Python's loop.
BLOCK = 1 << 18
#: Values of an array after which pages are handed back.
_HELD = 1 << 21


def release(*arrays: NDArray[Any]) -> None:
    """Hand the pages of arrays that lie in mapped files back to the system; does nothing to others."""
    for held in _mappings(arrays):
        _hand_back(held)


def blocks(n: int, *arrays: NDArray[Any], size: int = 0) -> Iterator[slice]:
    """Yield the blocks of arrays of n values; the pages of mapped ones are handed back behind them.

    They hold `size` values, or as many as are usual.
    """
    size = size or BLOCK
    held = _mappings(arrays)
    passed = 0
    for start in range(0, n, size):
        yield slice(start, min(start + size, n))
        passed += size
        if held and passed >= _HELD:
            passed = 0
            for one in held:
                _hand_back(one)
    for one in held:
        _hand_back(one)


def _mappings(arrays: tuple[NDArray[Any], ...]) -> list[mmap.mmap]:
    """Return the maps in which arrays lie, each once."""
    found = {id(held): held for array in arrays if (held := _mapping(array)) is not None}
    return list(found.values())


def _mapping(array: NDArray[Any]) -> mmap.mmap | None:
    base: object = array
    while isinstance(base, np.ndarray):
        base = base.base
    if isinstance(base, memoryview):
        base = base.obj
    return base if isinstance(base, mmap.mmap) else None


def _hand_back(held: mmap.mmap) -> None:
    if hasattr(held, "madvise"):
        held.madvise(mmap.MADV_DONTNEED)
