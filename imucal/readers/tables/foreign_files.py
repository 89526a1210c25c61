"""Columns of Parquet, HDF5, MATLAB, NPZ and NPY files; small files may unpack to very large ones.

Packages read Parquet, HDF5 and MATLAB files in a child process, so every result can be pickled; see
`imucal.readers.isolation`. The sizes in the headers of an NPZ file are added before unpacking: if the total
is too large, arrays go to temporary files. If only first values are wanted, the rest is not unpacked. The
unpacked size of a MATLAB file is counted without storing the data.

An array of three columns is ``name[0]``, ``name[1]``, ``name[2]`` for x, y, z; in other arrays the position
of a column has no meaning.

Source: MathWorks, MAT-File Format (version 5): a header of 128 bytes, then elements of a tag of 8 bytes (type
and size) and their data; those of type 15 are zlib streams.
"""

import math
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import release
from imucal.frozen import frozen
from imucal.readers.files import first_bytes, refused
from imucal.readers.isolation import isolated, require
from imucal.readers.store import allocated
from imucal.readers.ways_out import OBJECTS_IN_NPZ
from imucal.resources import MEMORY, column_limit, memory_limit

#: Most columns of a list or a matrix.
_WIDEST = 64

#: Rows examined to choose columns.
_HEAD = 400

#: Fields of a MATLAB object in the package's arrays: its name, its system, its class, its numbers.
_OBJECT = ("s0", "s1", "s2", "arr")

#: Deepest nesting of MATLAB structures that is read.
_DEEP = 8


@frozen
class TypedColumn:
    """A column with the name and unit used by the rules for names; some cells are empty if it `has_gaps`.

    `values` reads all values, shape (size,); `head` contains the first values.
    """

    name: str
    size: int
    values: Callable[[], NDArray[Any]] = field(repr=False)
    head: NDArray[Any] = field(repr=False)
    unit: str | None = None
    has_gaps: bool = False

    @property
    def cells(self) -> list[str]:
        """The first values as the cells of a text table; NaN is an empty cell."""
        values = self.head
        if values.dtype.kind == "M":
            return [str(value) for value in values.astype("datetime64[ns]").astype(np.int64).tolist()]
        return ["" if value is None or value != value else str(value) for value in values.tolist()]  # noqa: PLR0124 - NaN


def parquet_columns(path: Path) -> list[TypedColumn]:
    """Return the columns of a Parquet file with their first values; structures and lists are split."""
    import polars as pl

    # Decode only the columns needed, because others may have an unknown encoding.
    scan = pl.scan_parquet(path)
    rows = int(scan.select(pl.len()).collect().item())
    columns = []
    for name, dtype in scan.collect_schema().items():
        whole = pl.col(name)
        parts = {name: whole}
        if isinstance(dtype, pl.Struct):
            parts = {f"{name}.{field.name}": whole.struct.field(field.name) for field in dtype.fields}
        elif isinstance(dtype, pl.Array):
            parts = {f"{name}[{i}]": whole.arr.get(i) for i in range(min(dtype.shape[0], _WIDEST))}
        elif isinstance(dtype, pl.List):
            widest = scan.head(_HEAD).select(whole.list.len().max()).collect().item() or 0
            parts = {f"{name}[{i}]": whole.list.get(i, null_on_oob=True) for i in range(min(widest, _WIDEST))}
        for label, part in parts.items():
            head = scan.head(_HEAD).select(part.alias("v")).collect()["v"]
            columns.append(
                TypedColumn(
                    name=label,
                    size=rows,
                    values=partial(_parquet_values, path, part),
                    head=head.to_numpy(),
                    unit="ns" if isinstance(head.dtype, pl.Datetime) else None,
                    has_gaps=head.null_count() > 0,
                )
            )
    return columns


def _parquet_values(path: Path, part: Any) -> NDArray[Any]:  # noqa: ANN401 - polars is imported late
    """Return all values of a column of a Parquet file, or of a part, given by a polars expression."""
    import polars as pl

    return np.asarray(pl.scan_parquet(path).select(part.alias("v")).collect()["v"].to_numpy())


class Arrays(NamedTuple):
    """The numeric arrays in a file, with dotted names in structures, and MATLAB's objects: name -> class.

    Only MATLAB can read the numbers of an object, such as a ``table``.
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
    """Collect the arrays of MATLAB structures under dotted names."""
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
    """Return the numeric arrays and attributes of an HDF5 file, which may be MATLAB's version 7.3.

    Raises ValueError if they take more than `limit` bytes.
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
            msg = (
                f"its arrays need {took:.4g} MB, because it is read as a whole; expected at most "
                f"{most:.4g} MB"
            )
            raise ValueError(msg)
        # MATLAB stores matrices transposed.
        found.arrays.update((name, node[()].T if matlab else node[()]) for name, node in sets.items())
    return found


def _single_numbers(owner: str, attributes: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Return the attributes with one number, such as a sampling rate, by their paths."""
    numbers = {f"{owner}/{key}".strip("/").replace("/", "."): np.asarray(v) for key, v in attributes.items()}
    return {name: value for name, value in numbers.items() if value.size == 1 and value.dtype.kind in "iuf"}


#: Most pieces of memory for the first values; an array with more has no samples.
_MOST_PIECES = 4096
_SUFFIX = ".npy"
#: Bytes unpacked at once.
_PIECE = 1 << 20


class _Header(NamedTuple):
    """The header of a member, and the size of the header in bytes."""

    info: zipfile.ZipInfo
    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]
    start: int

    @property
    def size(self) -> int:
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    def head(self) -> list[slice]:
        """Slices of the first values along the longest axis."""
        lengths = self.shape[::-1] if self.fortran else self.shape
        at = int(np.argmax(lengths)) if lengths else 0
        outer, inner = math.prod(lengths[:at]), math.prod(lengths[at + 1 :])
        if not self.size or outer > _MOST_PIECES:
            return []
        piece = inner * (lengths[at] if lengths else 1)
        return [slice(at * piece, at * piece + min(_HEAD * inner, piece)) for at in range(outer)]


def npz_arrays(path: Path, *, limit: int, heads_above: int | None = None) -> dict[str, NDArray[Any]]:
    """Return the arrays of an NPZ file by name.

    If they take more than `limit` bytes, they are in temporary files. If they take more than `heads_above`
    bytes, only their first values are read; the others are zero and take no memory. Raises ValueError if a
    member is damaged, claims more bytes than the file contains, or is not an array of plain values.
    """
    with zipfile.ZipFile(path) as archive:
        headers = [_header(archive, info) for info in archive.infolist() if info.filename.endswith(_SUFFIX)]
        size = sum(header.size for header in headers)
        heads = heads_above is not None and size > heads_above
        arrays = {}
        for header in headers:
            n, most = math.prod(header.shape), 0 if size > limit else header.size
            # The system does not allocate zeros that are never written.
            flat = np.zeros(n, dtype=header.dtype) if heads else allocated(n, header.dtype, most)
            with archive.open(header.info) as member:
                for part in header.head if heads else [slice(0, n)]:
                    member.seek(header.start + part.start * header.dtype.itemsize)
                    target = flat[part].view(np.uint8)
                    for start in range(0, target.size, _PIECE):
                        piece = target[start : start + _PIECE]
                        got = cast("zipfile.ZipExtFile", member).readinto(piece.data)
                        if got < piece.size:
                            raise ValueError(f"an array ends after {start + got} of {target.size} bytes")
                        release(target)
            name = header.info.filename.removesuffix(_SUFFIX)
            arrays[name] = flat.reshape(header.shape, order="F" if header.fortran else "C")
    return arrays


def _header(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> _Header:
    """Read the header of a member; raises ValueError if it claims more than the member can contain."""
    with archive.open(info) as member:
        first = np.lib.format.read_magic(member) == (1, 0)
        read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(member)
        header = _Header(info, tuple(shape), bool(fortran), np.dtype(dtype), member.tell())
    held = info.file_size - header.start
    wrong = f"{info.filename} declares {header.size} bytes and contains {held}" if header.size > held else ""
    if header.dtype.hasobject:
        wrong = OBJECTS_IN_NPZ.said(str(archive.filename))
    if wrong:
        raise ValueError(wrong)
    return header


#: The type of an element of a MATLAB file that is a zlib stream.
_COMPRESSED = 15
#: No zlib stream grows by more than this factor. Source: zlib, "Maximum compression factor".
MOST_GROWTH = 1032


def unpacks_to_more(path: Path, limit: int) -> bool:
    """Return whether a file unpacks to more than `limit` bytes, up to the first damage."""
    size = path.stat().st_size
    if size * MOST_GROWTH <= limit:
        return False
    total = 0
    with path.open("rb") as file:
        file.seek(124)
        order = ">" if file.read(4)[2:] == b"MI" else "<"
        while len(tag := file.read(8)) == 8 and total <= limit:
            kind, length = struct.unpack(f"{order}II", tag)
            start, end = file.tell(), min(file.tell() + length, size)
            if kind != _COMPRESSED:
                total += end - start
            machine = zlib.decompressobj()
            with suppress(zlib.error):
                while kind == _COMPRESSED and total <= limit and not machine.eof:
                    packed = machine.unconsumed_tail or file.read(min(_PIECE >> 6, end - file.tell()))
                    if not packed:
                        break
                    total += len(machine.decompress(packed, _PIECE))
            file.seek(end)
    return total > limit


#: First bytes -> format.
_FORMATS = {
    b"PAR1": "Parquet",
    b"\x93NUMPY": "NPY",
    b"PK": "NPZ",
    b"MATLAB 5.0": "MAT",
    b"MATLAB 7.3": "HDF5",
    b"\x89HDF\r\n\x1a\n": "HDF5",
}

#: Most arrays listed in a message.
_SHOWN = 12

#: Copies of the arrays of a MAT or an HDF5 file in memory during reading.
_COPIES = 4

#: Class of a MATLAB object -> MATLAB command that writes it as text.
_IN_MATLAB = {
    "table": "writetable({0}, '{0}.csv')",
    "timetable": "writetimetable({0}, '{0}.csv')",
    "timeseries": "writematrix([{0}.Time squeeze({0}.Data)], '{0}.csv')",
}

#: Names of a scalar with the sampling rate in Hz.
_RATES = frozenset(
    {"fs", "freq", "rate", "rate_hz", "samplerate", "sample_rate", "sampling_rate", "frequency"}
)

#: NaveGo's names of an IMU structure: specific force, turn rate. Source: NaveGo, imu structure.
_NAVEGO = {"fb": ("accelerometer", "m/s^2"), "wb": ("gyroscope", "rad/s")}


@frozen
class TableFile:
    """The columns of a file, its format, and its sampling rate if there is one.

    `shapes` lists all arrays for messages, such as ``imu (600, 2, 3)``, also arrays without columns. `way`
    is advice for data that can't be read.
    """

    format: str
    columns: tuple[TypedColumn, ...]
    rate_hz: float | None = None
    shapes: tuple[str, ...] = ()
    way: str = ""


def open_table(path: Path, *, limit: int | None = None, heads_above: int | None = None) -> TableFile:
    """Return the columns of a file; raises ReadError if it can't be read or has another format.

    More than `limit` bytes (None: `imucal.resources.column_limit`) go to a temporary file. If a file that is
    unpacked when opened has more than `heads_above` bytes, only the heads of its columns are valid.
    """
    head = first_bytes(path, 16)
    kind = next((kind for magic, kind in _FORMATS.items() if head.startswith(magic)), "")
    if not kind and path.suffix.lower() != ".mat":
        raise refused(path, f"first bytes {head[:8].hex(' ')}; expected Parquet, HDF5, NPZ, NPY or MAT")
    if kind == "Parquet":
        columns = isolated(path, parquet_columns, "Parquet")(path)
        each = (replace(column, values=isolated(path, column.values, "Parquet")) for column in columns)
        return TableFile(format="parquet", columns=tuple(each))
    # Packages read these files completely, and the arrays are copied between processes.
    share = memory_limit() // _COPIES
    if kind == "HDF5":
        require(path, "h5py", "an HDF5 or MATLAB 7.3 file", extra="hdf5")
        return _of_arrays("hdf5", *isolated(path, hdf5_arrays, "HDF5")(path, share))
    if kind in {"MAT", ""}:
        if unpacks_to_more(path, share):
            text = (
                f"its arrays unpack to more than {share / 1e6:.4g} MB, and a MAT file is read as a whole; "
                "expected at most a quarter of the memory for one step; save them as NPZ or CSV, or set "
                f"{MEMORY} to four times their size"
            )
            raise refused(path, text)
        return _of_arrays("mat", *isolated(path, mat_arrays, "MAT")(path))
    try:
        if kind == "NPZ":
            most = column_limit() if limit is None else limit
            return _of_arrays("npz", npz_arrays(path, limit=most, heads_above=heads_above))
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:
        text = str(error) or type(error).__name__
        raise refused(path, f"not a readable {kind} file: {text}") from error
    return TableFile(format="npy", columns=tuple(_of_array("", array)), shapes=(f"array {array.shape}",))


def _of_arrays(
    form: str, arrays: Mapping[str, NDArray[Any]], objects: Mapping[str, str] | None = None
) -> TableFile:
    """Return the columns of a file's arrays; a scalar may be the sampling rate."""
    rate = None
    columns: list[TypedColumn] = []
    for name, array in arrays.items():
        last = name.rpartition(".")[2].lower()
        if array.size == 1 and array.dtype.kind in "iuf":
            value = float(array.reshape(-1)[0])
            if last in _RATES and np.isfinite(value) and value > 0:
                rate = value
            continue
        label, unit = _NAVEGO.get(last, ("", None))
        columns += _of_array(f"{name}.{label}" if label else name, array, unit)
    shapes = [f"{name or 'array'} {array.shape}" for name, array in arrays.items() if array.size != 1]
    ways = [
        f"{name} is a {kind}, which only MATLAB can read; in MATLAB type "
        + _IN_MATLAB.get(kind, "its arrays into separate variables, and save those").format(name)
        for name, kind in (objects or {}).items()
    ]
    return TableFile(
        format=form,
        columns=tuple(columns),
        rate_hz=rate,
        shapes=tuple(shapes[:_SHOWN]),
        way="; ".join(ways[:_SHOWN]),
    )


def _of_array(name: str, array: NDArray[Any], unit: str | None = None) -> list[TypedColumn]:
    """Return the columns of an array: a record, a matrix or a vector; empty if it is not a table.

    With three dimensions or more the longest is the samples; the others are columns ``name[0,2]``.
    """
    if array.dtype.names is not None:
        parts = [(f"{name}.{part}".lstrip("."), array[part]) for part in array.dtype.names]
        return [column for label, part in parts for column in _of_array(label, part)]
    array = array.squeeze() if array.ndim > 2 else array
    if not array.ndim:
        return []
    longest = int(np.argmax(array.shape))
    # A matrix is transposed if its rows are few enough to be columns.
    samples = longest if array.ndim > 2 or array.shape[0] <= _WIDEST else 0
    array = np.moveaxis(array, samples, 0)
    width = math.prod(array.shape[1:])
    if width > _WIDEST:
        return []
    return [_plain(_label(name, at, width), array[:, *at], unit) for at in np.ndindex(array.shape[1:])]


def _label(name: str, at: tuple[int, ...], width: int) -> str:
    """Return the name of an array's column; only in arrays of three columns the number is an axis."""
    if len(at) > 1:
        return f"{name}[{','.join(map(str, at))}]"
    if not at or not name or width == 1:
        return name
    return f"{name}[{at[0]}]" if width == 3 else f"{name}[:,{at[0]}]"


def _plain(name: str, array: NDArray[Any], unit: str | None = None) -> TypedColumn:
    head = array[:_HEAD]
    return TypedColumn(
        name=name,
        size=array.size,
        values=lambda: array,
        head=head,
        unit="ns" if array.dtype.kind == "M" else unit,
        has_gaps=array.dtype.kind == "f" and bool(np.isnan(head).any()),
    )
