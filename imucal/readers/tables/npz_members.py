"""The arrays of an NPZ file, a few bytes of which may unpack to very many.

What the headers state is added up before anything is unpacked: arrays that are too large together go to
temporary files, and where only their first values are wanted nothing else is unpacked.
"""

import math
import zipfile
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from imucal.readers.column_store import map_stream

#: Values of an array that are read where only the first are wanted, along its longest axis.
HEAD = 400
#: Pieces of memory in which they may lie; in more of them no samples are.
_MOST_PIECES = 4096
_SUFFIX = ".npy"


class _Header(NamedTuple):
    """What the header of a member states, and how many bytes it takes."""

    info: zipfile.ZipInfo
    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]
    start: int

    @property
    def size(self) -> int:
        return math.prod(self.shape) * self.dtype.itemsize


def npz_arrays(path: Path, *, limit: int, heads_above: int | None = None) -> dict[str, NDArray[Any]]:
    """Return the arrays of an NPZ file by their names.

    Parameters
    ----------
    limit
        Bytes of all arrays together above which they lie in temporary files.
    heads_above
        Bytes of all arrays together above which only their first values are read; the others are zero, and
        take no memory. None reads all of them.

    Raises
    ------
    ValueError
        If a member is damaged, claims more than the file holds, or is no array of plain values.
    """
    with zipfile.ZipFile(path) as archive:
        headers = [_header(archive, info) for info in archive.infolist() if info.filename.endswith(_SUFFIX)]
        size = sum(header.size for header in headers)
        heads = heads_above is not None and size > heads_above
        arrays = {}
        for header in headers:
            with archive.open(header.info) as member:
                member.seek(header.start)
                stream = cast("BinaryIO", member)
                array = _head(stream, header) if heads else _whole(stream, header, spill=size > limit)
            arrays[header.info.filename.removesuffix(_SUFFIX)] = array
    return arrays


def _header(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> _Header:
    """Read the header of a member; a ValueError if it claims what it can't hold."""
    with archive.open(info) as member:
        version = np.lib.format.read_magic(member)
        read = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        shape, fortran, dtype = read(member)
        header = _Header(info, tuple(shape), bool(fortran), np.dtype(dtype), member.tell())
    if header.dtype.hasobject:
        msg = f"Object arrays cannot be loaded: {info.filename}"
        raise ValueError(msg)
    if header.start + header.size > info.file_size:
        msg = f"{info.filename} claims {header.size} bytes, it holds {info.file_size - header.start}"
        raise ValueError(msg)
    return header


def _whole(stream: BinaryIO, header: _Header, *, spill: bool) -> NDArray[Any]:
    """Return all of an array, read-only where it lies in a temporary file."""
    if spill and header.size:
        flat = np.frombuffer(map_stream(stream, header.size), dtype=header.dtype)
    else:
        flat = np.empty(math.prod(header.shape), dtype=header.dtype)
        _fill(stream, flat.view(np.uint8))
    return flat.reshape(header.shape, order="F" if header.fortran else "C")


def _head(stream: BinaryIO, header: _Header) -> NDArray[Any]:
    """Return an array of which only the first values along its longest axis are read."""
    # Memory that nobody touches is never taken.
    flat = np.zeros(math.prod(header.shape), dtype=header.dtype)
    lengths = header.shape[::-1] if header.fortran else header.shape
    if flat.size:
        at = int(np.argmax(lengths)) if lengths else 0
        outer, longest = math.prod(lengths[:at]), lengths[at] if lengths else 1
        inner = math.prod(lengths[at + 1 :])
        for piece in range(outer if outer <= _MOST_PIECES else 0):
            first = piece * longest * inner
            stop = first + min(HEAD, longest) * inner
            stream.seek(header.start + first * header.dtype.itemsize)
            _fill(stream, flat[first:stop].view(np.uint8))
    return flat.reshape(header.shape, order="F" if header.fortran else "C")


def _fill(stream: BinaryIO, target: NDArray[np.uint8]) -> None:
    """Read exactly as many bytes as fit; a ValueError where there are fewer."""
    done = 0
    while done < target.size:
        piece = stream.read(min(target.size - done, 1 << 22))
        if not piece:
            msg = f"an array ends after {done} of {target.size} bytes"
            raise ValueError(msg)
        target[done : done + len(piece)] = np.frombuffer(piece, dtype=np.uint8)
        done += len(piece)
