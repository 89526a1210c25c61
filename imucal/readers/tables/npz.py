"""NumPy's NPZ and NPY files; a file that declares too much is refused before it is read."""

import math
import os
import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from imucal.errors import Fix
from imucal.readers.compression import most_unpacked
from imucal.readers.memory import fit_into_memory, too_large
from imucal.readers.tables.notes import Notes, RefusedError

_SUFFIX = ".npy"
#: Bytes read at a time.
_PIECE = 1 << 24
#: Most arrays of an archive; opening one takes 0.1 ms.
_MAX_MEMBERS = 4000


def npz_arrays(path: Path, notes: Notes) -> dict[str, NDArray[Any]]:
    """Return the arrays of an NPZ file by name; Python objects are noted and not loaded.

    Raises RefusedError if the file unpacks to too much, ValueError or an error of `zipfile` for damage.
    """
    arrays: dict[str, NDArray[Any]] = {}
    with zipfile.ZipFile(path) as archive:
        members = [info for info in archive.infolist() if info.filename.endswith(_SUFFIX)]
        size = sum(info.file_size for info in members)
        _require_plausible(len(members), size, path.stat().st_size)
        _require_memory(path, size)
        for info in members:
            name = info.filename.removesuffix(_SUFFIX)
            with archive.open(info) as member:
                array = _array(name, member, info.file_size, notes)
            if array is not None:
                arrays[name] = array
    return arrays


def npy_array(path: Path, notes: Notes) -> dict[str, NDArray[Any]]:
    """Return the array of an NPY file by an empty name; see `npz_arrays`.

    It is not mapped: the process would be killed if another one cuts the file meanwhile.
    """
    with path.open("rb", buffering=0) as file:
        size = os.fstat(file.fileno()).st_size
        _require_memory(path, size)
        array = _array("", file, size, notes)
    return {} if array is None else {"": array}


def is_numeric(dtype: np.dtype[Any]) -> bool:
    """Return whether values can be samples or stamps; complex numbers and empty values can't."""
    return bool(dtype.itemsize) and dtype.kind != "c"


def _require_plausible(members: int, size: int, packed: int) -> None:
    """Raise RefusedError if an archive unpacks to more than recordings do; sizes are in bytes."""
    if members > _MAX_MEMBERS:
        found = f"it contains {members} arrays"
        raise RefusedError(f"{found}; expected at most {_MAX_MEMBERS}; save only those of the IMU")
    if size > most_unpacked(packed):
        found = f"its {packed} bytes declare {size} bytes of arrays"
        raise RefusedError(f"{found}; no recording is compressed so much, save its samples again")


def _require_memory(path: Path, size: int) -> None:
    """Raise DataError if arrays of `size` bytes do not fit into memory."""
    values = size // np.dtype(np.float64).itemsize
    if not fit_into_memory(values):
        raise too_large(path, values, Fix("save a part of the samples"))


def _array(name: str, file: IO[bytes], size: int, notes: Notes) -> NDArray[Any] | None:
    """Return the array in a file of `size` bytes; None if it is noted instead."""
    shape, fortran, dtype = _header(file)
    if dtype.hasobject:
        notes.objects[name] = "object"
        return None
    if dtype.names is None and not is_numeric(dtype):
        notes.skip(name or "array", shape, dtype)
        return None
    n, held = math.prod(shape), size - file.tell()
    label = f"{name}{_SUFFIX}" if name else "the array"
    if n < 0 or n * dtype.itemsize > held:
        raise ValueError(f"{label} declares {n * dtype.itemsize} bytes and contains {held}")
    if n * dtype.itemsize < held:
        notes.damage = f"{label} declares {n * dtype.itemsize} bytes and contains {held}"
    flat = np.empty(n, dtype)
    # `zipfile` verifies the checksum at the end.
    _fill(flat.view(np.uint8), file)
    return flat.reshape(shape, order="F" if fortran else "C")


def _header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    first = np.lib.format.read_magic(file) == (1, 0)
    read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(file)
    return tuple(shape), bool(fortran), np.dtype(dtype)


def _fill(target: NDArray[np.uint8], file: Any) -> None:  # noqa: ANN401 - anything with `readinto`
    """Read an array's bytes; raises ValueError if the file ends early."""
    filled = 0
    while filled < target.size:
        count = file.readinto(target[filled : filled + _PIECE].data)
        if not count:
            raise ValueError(f"an array ends after {filled} of {target.size} bytes")
        filled += count
