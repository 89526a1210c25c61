"""Pass arrays from a child process to its parent in a file, part by part.

A pipe would need all arrays in both processes, twice in each.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import release
from imucal.readers.store import allocated
from imucal.resources import column_limit

#: Bytes read and written at a time.
PIECE = 1 << 24

#: Name of an array, the axis along which it is cut, and its parts with that axis first.
Part: TypeAlias = tuple[str, int, Iterable[NDArray[Any]]]


class RefusedError(Exception):
    """A file that imucal does not read; the text is the reason with advice. Caught in the child."""


@dataclass(slots=True)
class Notes:
    """What a file contains in addition to its arrays."""

    #: Objects that only MATLAB or Python reads: name -> class.
    objects: dict[str, str] = field(default_factory=dict)
    #: Arrays of types that can't be samples, such as ``gyro (900,) complex128``.
    skipped: list[str] = field(default_factory=list)
    #: The contradiction in a damaged file; empty if there is none.
    damage: str = ""
    #: Why the file is refused; empty if it is read.
    refusal: str = ""

    def skip(self, name: str, shape: Sequence[int], dtype: np.dtype[Any]) -> None:
        """Add an array of an unsuitable type."""
        self.skipped.append(f"{name} {(*shape,)} {dtype.name}")


class _Place(NamedTuple):
    """An array in the file; its shape has the cut axis first."""

    start: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    axis: int


#: Scalars and objects are not in the file.
Passed: TypeAlias = dict[str, _Place | NDArray[Any]]


def written(parts: Iterable[Part], target: Path) -> Passed:
    """Write arrays to a file; runs in the child."""
    found: Passed = {}
    with target.open("wb") as file:
        for name, axis, pieces in parts:
            start, n = file.tell(), 0
            for piece in pieces:
                if not piece.ndim or piece.dtype.hasobject:
                    found[name] = piece
                    continue
                file.write(np.ascontiguousarray(piece).reshape(-1).view(np.uint8).data)
                n += len(piece)
                found[name] = _Place(start, (n, *piece.shape[1:]), piece.dtype, axis)
    return found


def taken(found: Passed, source: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays, in temporary files if they are large."""
    large = source.stat().st_size > column_limit()
    arrays: dict[str, NDArray[Any]] = {}
    with source.open("rb", buffering=0) as file:
        for name, place in found.items():
            if isinstance(place, np.ndarray):
                arrays[name] = place
                continue
            n = math.prod(place.shape)
            flat = allocated(n, place.dtype, 0 if large else n * place.dtype.itemsize)
            file.seek(place.start)
            fill(flat.view(np.uint8), file)
            arrays[name] = np.moveaxis(flat.reshape(place.shape), 0, place.axis)
    return arrays


def fill(target: NDArray[np.uint8], file: Any) -> None:  # noqa: ANN401 - anything with `readinto`
    """Read an array's bytes; raises ValueError if the file ends early."""
    for start in range(0, target.size, PIECE):
        piece = target[start : start + PIECE]
        at = 0
        while at < piece.size:
            got = file.readinto(piece[at:].data)
            if not got:
                raise ValueError(f"an array ends after {start + at} of {target.size} bytes")
            at += got
        release(target)


def cut(shape: tuple[int, ...], itemsize: int, chunk: int = 1) -> Iterator[slice]:
    """Yield slices of the longest axis, of about `PIECE` bytes and whole chunks."""
    longest = max(shape)
    rows = max(1, PIECE * longest // max(1, math.prod(shape) * itemsize * chunk)) * chunk
    yield from (slice(start, start + rows) for start in range(0, longest, rows))
