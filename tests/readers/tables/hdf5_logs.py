"""Simulated HDF5 files, plain or in the format of MATLAB 7.3."""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

__all__ = ["write_hdf5", "write_matlab"]

#: Bytes in front of the HDF5 file that contain MATLAB's signature.
_BLOCK = 512


def write_hdf5(
    path: Path, arrays: Mapping[str, Any], *, compression: str | None = None, **attributes: float
) -> Path:
    """Write arrays at paths such as ``imu/gyro``, and attributes of the file."""
    with h5py.File(path, "w") as file:
        file.attrs.update(attributes)
        for name, array in arrays.items():
            file.create_dataset(name, data=array, compression=compression)
    return path


def write_matlab(path: Path, arrays: Mapping[str, Any], *, table: bool = False) -> Path:
    """Write arrays like MATLAB: transposed, with classes as attributes, and optionally a table.

    Source: output of MATLAB R2023 for ``save(..., '-v7.3')``.
    """
    with h5py.File(path, "w", userblock_size=_BLOCK) as file:
        for name, array in arrays.items():
            group, _, last = name.rpartition("/")
            owner = file.require_group(group) if group else file
            if group:
                owner.attrs["MATLAB_class"] = np.bytes_("struct")
            data = owner.create_dataset(
                last, data=np.atleast_2d(array).T if np.ndim(array) < 2 else np.transpose(array)
            )
            data.attrs["MATLAB_class"] = np.bytes_("double")
        file.create_group("#refs#")["a"] = np.zeros((1, 9))
        if table:
            data = file.create_dataset("T", data=np.array([[0xDD000000, 2, 1, 1, 1, 1]], dtype=np.uint32))
            data.attrs["MATLAB_class"] = np.bytes_("table")
            data.attrs["MATLAB_object_decode"] = np.int32(3)
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + struct.pack("<H", 0x200) + b"IM")
    return path
