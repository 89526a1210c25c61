"""NumPy's NPZ files, read part by part, because `numpy.load` would hold them in memory."""

import math
import zipfile
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from imucal.readers.store import allocated
from imucal.readers.tables.passed import fill
from imucal.resources import column_limit

_SUFFIX = ".npy"


def npz_arrays(path: Path) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """Return the arrays of an NPZ file by name, and the names of Python objects, which are not loaded.

    Raises ReadError if the disk is full, ValueError or an error of `zipfile` for damage.
    """
    arrays: dict[str, NDArray[Any]] = {}
    objects: dict[str, str] = {}
    with zipfile.ZipFile(path) as archive:
        members = [info for info in archive.infolist() if info.filename.endswith(_SUFFIX)]
        large = sum(info.file_size for info in members) > column_limit()
        for info in members:
            name = info.filename.removesuffix(_SUFFIX)
            with archive.open(info) as member:
                shape, fortran, dtype = _header(cast("zipfile.ZipExtFile", member))
                if dtype.hasobject:
                    objects[name] = "object"
                    continue
                n, held = math.prod(shape), info.file_size - member.tell()
                if n * dtype.itemsize > held:
                    declared = f"declares {n * dtype.itemsize} bytes and contains {held}"
                    raise ValueError(f"{info.filename} {declared}")
                flat = allocated(n, dtype, 0 if large else held)
                # `zipfile` verifies the checksum at the end.
                fill(flat.view(np.uint8), member)
            arrays[name] = flat.reshape(shape, order="F" if fortran else "C")
    return arrays, objects


def _header(member: zipfile.ZipExtFile) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    first = np.lib.format.read_magic(member) == (1, 0)
    read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(member)
    return tuple(shape), bool(fortran), np.dtype(dtype)
