"""What Parquet, HDF5, MATLAB and NPZ files hold, a few bytes of which may unpack to very many.

Parquet, HDF5 and MATLAB files are read by the packages that know them, in a child process: every result can
be pickled; see `imucal.readers.isolation`. What the headers of an NPZ file state is added up before anything
is unpacked: arrays that are too large together go to temporary files, and where only their first values are
wanted nothing else is unpacked. What a MATLAB file unpacks to is counted without keeping any of it.

Source: MathWorks, MAT-File Format (version 5): a header of 128 bytes, then elements of a tag of 8 bytes (type
and size) and their data; those of type 15 are zlib streams.
"""

import math
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import release
from imucal.readers.store import allocated
from imucal.readers.ways_out import OBJECTS_IN_NPZ

#: Parts of a list or a matrix that are shown as columns.
WIDEST = 64

#: Rows that are looked at to choose columns.
HEAD = 400

#: What stands for an object of MATLAB in the package's arrays: its name, its system, its class, its numbers.
_OBJECT = ("s0", "s1", "s2", "arr")

#: Structures within structures of a MATLAB file that are looked into.
_DEEP = 8


class ParquetColumn(NamedTuple):
    """A column of a Parquet file, or a part of one: the field of a structure, the place in a list.

    `name` is that of the column, `part` the field's name, the place, or None for all of it.
    """

    label: str
    name: str
    part: str | int | None
    rows: int
    head: NDArray[Any]
    unit: str | None
    has_gaps: bool


def parquet_columns(path: Path) -> list[ParquetColumn]:
    """Return the columns of a Parquet file with their first values."""
    import polars as pl

    # Only the columns that are read are decoded, so that one in an unknown encoding does no harm.
    scan = pl.scan_parquet(path)
    rows = int(scan.select(pl.len()).collect().item())
    columns = []
    for name, dtype in scan.collect_schema().items():
        parts: dict[str, str | int | None] = {name: None}
        if isinstance(dtype, pl.Struct):
            parts = {f"{name}.{field.name}": field.name for field in dtype.fields}
        elif isinstance(dtype, pl.List | pl.Array):
            lengths = [dtype.shape[0]] if isinstance(dtype, pl.Array) else []
            if isinstance(dtype, pl.List):
                lengths = (
                    scan.head(HEAD).select(pl.col(name).list.len()).collect()[name].drop_nulls().to_list()
                )
            parts = {f"{name}[{i}]": i for i in range(min(max(lengths, default=0), WIDEST))}
        for label, part in parts.items():
            head = scan.head(HEAD).select(_expression(dtype, name, part).alias("v")).collect()["v"]
            unit = "ns" if isinstance(head.dtype, pl.Datetime) else None
            gaps = head.null_count() > 0
            columns.append(ParquetColumn(label, name, part, rows, head.to_numpy(), unit, gaps))
    return columns


def parquet_values(path: Path, name: str, part: str | int | None) -> NDArray[Any]:
    """Return all values of a column of a Parquet file, or of a part of it."""
    import polars as pl

    scan = pl.scan_parquet(path)
    dtype = scan.collect_schema()[name]
    return np.asarray(scan.select(_expression(dtype, name, part).alias("v")).collect()["v"].to_numpy())


def _expression(dtype: Any, name: str, part: str | int | None) -> Any:  # noqa: ANN401 - polars is imported late
    import polars as pl

    column = pl.col(name)
    if isinstance(part, str):
        return column.struct.field(part)
    if part is None:
        return column
    getter = column.list if isinstance(dtype, pl.List) else column.arr
    return getter.get(part, null_on_oob=True)


class Arrays(NamedTuple):
    """The arrays of numbers in a file, those in structures under names with points; and objects of MATLAB.

    Of those, such as a ``table``, a file holds numbers that only MATLAB understands: name -> class.
    """

    arrays: dict[str, NDArray[Any]]
    objects: dict[str, str]


def mat_arrays(path: Path) -> Arrays:
    """Return the arrays of numbers in a MATLAB file up to version 7."""
    import scipy.io

    content = scipy.io.loadmat(str(path), squeeze_me=True, struct_as_record=True)
    found = Arrays({}, {})
    for name, value in content.items():
        if not name.startswith("__"):
            _flatten(name, value, found)
    return found


def _flatten(name: str, value: Any, found: Arrays, depth: int = 0) -> None:  # noqa: ANN401
    """Collect the arrays of MATLAB structures under names with points."""
    array = np.asarray(value)
    if array.dtype.names == _OBJECT and array.size == 1:
        own, _, kind, _ = array.item()
        found.objects[name if own is None or name != "None" else own.decode("latin-1")] = kind.decode(
            "latin-1"
        )
    elif array.dtype.names is not None and depth < _DEEP:
        for part in array.dtype.names:
            inner = array[part]
            inner = inner.item() if inner.dtype == object and inner.size == 1 else inner
            _flatten(f"{name}.{part}", inner, found, depth + 1)
    elif array.dtype.kind in "biufM":
        found.arrays[name] = array


def hdf5_arrays(path: Path, limit: int) -> Arrays:
    """Return the arrays of numbers in an HDF5 file, perhaps MATLAB's of version 7.3, and single attributes.

    Raises
    ------
    ValueError
        If they take more than `limit` bytes.
    """
    import h5py

    found = Arrays({}, {})
    with h5py.File(path) as file:
        nodes: dict[str, Any] = {"": file}
        file.visititems(nodes.__setitem__)
        matlab = any("MATLAB_class" in node.attrs for node in file.values())
        sets = {}
        for name, node in nodes.items():
            kind = node.attrs.get("MATLAB_class", b"").decode("latin-1") if matlab else ""
            if name.startswith(("#refs#", "#subsystem#")) or kind in {"char", "cell"}:
                continue
            if "MATLAB_object_decode" in node.attrs:
                found.objects[name.replace("/", ".")] = kind
            elif isinstance(node, h5py.Dataset) and node.dtype.kind in "biufV":
                sets[name.replace("/", ".")] = node
            found.arrays.update(_single_numbers(name, {} if matlab else node.attrs))
        took, most = sum(node.size * node.dtype.itemsize for node in sets.values()) / 1e6, limit / 1e6
        if took > most:
            msg = f"its arrays take {took:.4g} MB, and it is read whole; expected at most {most:.4g} MB"
            raise ValueError(msg)
        # MATLAB writes columns where others write rows.
        found.arrays.update((name, node[()].T if matlab else node[()]) for name, node in sets.items())
    return found


def _single_numbers(owner: str, attributes: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Return the attributes that are a number each, such as a sampling rate, by their paths."""
    numbers = {f"{owner}/{key}".strip("/").replace("/", "."): np.asarray(v) for key, v in attributes.items()}
    return {name: value for name, value in numbers.items() if value.size == 1 and value.dtype.kind in "iuf"}


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
                most = 0 if size > limit and not heads else header.size
                array = _read(cast("BinaryIO", member), header, heads=heads, most=most)
            arrays[header.info.filename.removesuffix(_SUFFIX)] = array
    return arrays


def _header(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> _Header:
    """Read the header of a member; a ValueError if it claims what it can't hold."""
    with archive.open(info) as member:
        first = np.lib.format.read_magic(member) == (1, 0)
        read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(member)
        header = _Header(info, tuple(shape), bool(fortran), np.dtype(dtype), member.tell())
    if header.dtype.hasobject:
        msg = OBJECTS_IN_NPZ.said(str(archive.filename))
        raise ValueError(msg)
    if header.start + header.size > info.file_size:
        msg = f"{info.filename} claims {header.size} bytes, it holds {info.file_size - header.start}"
        raise ValueError(msg)
    return header


def _read(stream: BinaryIO, header: _Header, *, heads: bool, most: int) -> NDArray[Any]:
    """Return an array, in a temporary file if it has more than `most` bytes; of `heads` the first values."""
    size = math.prod(header.shape)
    # Memory that nobody touches is never taken.
    flat = np.zeros(size, dtype=header.dtype) if heads else allocated(size, header.dtype, most)
    for part in _head(header) if heads else [slice(0, size)]:
        stream.seek(header.start + part.start * header.dtype.itemsize)
        _fill(stream, flat[part].view(np.uint8))
    return flat.reshape(header.shape, order="F" if header.fortran else "C")


def _head(header: _Header) -> list[slice]:
    """Return where the first values along the longest axis of an array lie."""
    lengths = header.shape[::-1] if header.fortran else header.shape
    if not header.size:
        return []
    at = int(np.argmax(lengths)) if lengths else 0
    outer, longest = math.prod(lengths[:at]), lengths[at] if lengths else 1
    inner = math.prod(lengths[at + 1 :])
    starts = range(0, outer * longest * inner, longest * inner) if outer <= _MOST_PIECES else ()
    return [slice(start, start + min(HEAD, longest) * inner) for start in starts]


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
        release(target)


_HEADER, _COMPRESSED = 128, 15
#: No zlib stream grows by more than this factor. Source: zlib, "Maximum compression factor".
MOST_GROWTH = 1032
#: Bytes unpacked at once.
_PIECE = 1 << 20


def unpacks_to_more(path: Path, limit: int) -> bool:
    """Return whether the elements of a file hold more than `limit` bytes together."""
    size = path.stat().st_size
    if size * MOST_GROWTH <= limit:
        return False
    total = 0
    with path.open("rb") as file:
        file.seek(124)
        order = ">" if file.read(4)[2:] == b"MI" else "<"
        while len(tag := file.read(8)) == 8 and total <= limit:
            kind, length = struct.unpack(f"{order}II", tag)
            length = min(length, size - file.tell())
            if kind == _COMPRESSED:
                total += _unpacked(file, length, limit - total)
            else:
                total += length
                file.seek(length, 1)
    return total > limit


def _unpacked(file: BinaryIO, length: int, limit: int) -> int:
    """Return how many bytes a stream holds, or a number beyond `limit`; a damaged one as far as it goes."""
    machine, total = zlib.decompressobj(), 0
    end = file.tell() + length
    try:
        while total <= limit and not machine.eof:
            packed = machine.unconsumed_tail or file.read(min(_PIECE >> 6, end - file.tell()))
            if not packed:
                break
            total += len(machine.decompress(packed, _PIECE))
    except zlib.error:
        pass
    file.seek(end)
    return total
