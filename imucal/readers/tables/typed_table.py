"""Tables with typed columns: Parquet, HDF5, NumPy's NPZ and NPY, MATLAB's MAT.

Packages read all but NPY and NPZ in a child process with limited memory (`imucal.readers.isolation`), because
small files may unpack to very large ones. An array of three columns is ``name[0]`` to ``name[2]`` for x, y,
z. Arrays of different lengths are separate tables.
"""

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.errors import ImucalError
from imucal.findings import Finding
from imucal.readers.files import first_bytes, refused
from imucal.readers.foreign import OBJECTS_IN_NPZ
from imucal.readers.isolation import isolated, require
from imucal.readers.read_options import ReadOptions
from imucal.readers.table import HEAD_ROWS, Column, Table
from imucal.readers.tables import hdf5, parquet_pages
from imucal.readers.tables.column_log import ColumnLog
from imucal.readers.tables.notes import Notes, RefusedError
from imucal.readers.tables.npz import is_numeric, npy_array, npz_arrays

#: Most columns of a list or a matrix.
_MAX_COLUMNS = 64

#: Fields of a MATLAB object as scipy returns it.
_OBJECT = ("s0", "s1", "s2", "arr")

#: Deepest nesting of MATLAB structures.
_MAX_DEPTH = 8

_FORMATS = {
    b"PAR1": "Parquet",
    b"\x93NUMPY": "NPY",
    b"PK": "NPZ",
    b"MATLAB 5.0": "MAT",
    b"MATLAB 7.3": "HDF5",
    b"\x89HDF\r\n\x1a\n": "HDF5",
}

_MAX_LISTED = 12

#: Class of a MATLAB object -> command that writes it as text.
_IN_MATLAB = {
    "table": "writetable({0}, '{0}.csv')",
    "timetable": "writetimetable({0}, '{0}.csv')",
    "timeseries": "writematrix([{0}.Time squeeze({0}.Data)], '{0}.csv')",
}

_RATES = frozenset(
    {"fs", "freq", "rate", "rate_hz", "samplerate", "sample_rate", "sampling_rate", "frequency"}
)

#: Specific force and turn rate in NaveGo's imu structure.
_NAVEGO = {"fb": ("accelerometer", "m/s^2"), "wb": ("gyroscope", "rad/s")}


@dataclass(frozen=True, kw_only=True, eq=False)
class TypedColumn:
    """A column, shape (n,), with name and unit."""

    name: str
    values: NDArray[Any]
    unit: str | None = None


def _parquet_arrays(path: Path, notes: Notes) -> Iterator[tuple[str, NDArray[Any]]]:
    import polars as pl

    notes.damage = parquet_pages.damage_of(path)
    scan = pl.scan_parquet(path, glob=False)
    # One column at a time, to hold little in memory.
    for name in scan.collect_schema().names():
        column = scan.select(pl.col(name)).collect().to_series()
        yield from ((label, part.to_numpy()) for label, part in _split(column))


def _split(series: Any) -> Iterator[tuple[str, Any]]:  # noqa: ANN401 - polars is imported late
    import polars as pl

    name, dtype = series.name, series.dtype
    if isinstance(dtype, pl.Struct):
        yield from ((f"{name}.{field.name}", series.struct.field(field.name)) for field in dtype.fields)
    elif isinstance(dtype, pl.Array):
        yield from ((f"{name}[{i}]", series.arr.get(i)) for i in range(min(dtype.shape[0], _MAX_COLUMNS)))
    elif isinstance(dtype, pl.List):
        columns = range(min(int(series.list.len().max() or 0), _MAX_COLUMNS))
        yield from ((f"{name}[{i}]", series.list.get(i, null_on_oob=True)) for i in columns)
    else:
        yield name, series


def _mat_arrays(path: Path, notes: Notes) -> Iterator[tuple[str, NDArray[Any]]]:
    import scipy.io

    content = scipy.io.loadmat(str(path), squeeze_me=True, struct_as_record=True)
    for name, value in content.items():
        if not name.startswith("__"):
            yield from _flatten(name, value, notes)


def _flatten(
    name: str,
    value: Any,  # noqa: ANN401
    notes: Notes,
    depth: int = 0,
) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the numeric arrays by dotted name; note the others."""
    array = np.asarray(value)
    if array.dtype.names == _OBJECT and array.size == 1:
        own, _, kind, _ = array.item()
        label = name if own is None or name != "None" else own.decode("latin-1")
        notes.objects[label] = kind.decode("latin-1")
    elif array.dtype.names is not None and depth < _MAX_DEPTH:
        for part in array.dtype.names:
            inner = array[part]
            inner = inner.item() if inner.dtype == object and inner.size == 1 else inner
            yield from _flatten(f"{name}.{part}", inner, notes, depth + 1)
    elif array.dtype.kind in "biufM":
        yield name, array
    elif array.dtype.kind == "c":
        notes.skip(name, array.shape, array.dtype)


@dataclass(frozen=True, kw_only=True)
class TableFile:
    """The columns of a file.

    `shapes` lists all arrays for messages, such as ``imu (600, 2, 3)``. `way` is advice for unreadable data.
    `damage` is a contradiction in the file, or empty.
    """

    format: str
    columns: tuple[TypedColumn, ...]
    rate_hz: float | None = None
    shapes: tuple[str, ...] = ()
    way: str = ""
    damage: str = ""


_ARRAYS = {"Parquet": _parquet_arrays, "HDF5": hdf5.arrays, "MAT": _mat_arrays}


def write_arrays(kind: str, path: Path, folder: Path) -> tuple[list[str], Notes]:
    """Write each array of a file to a file in a folder; return their names and the rest. Runs in the child.

    A pipe would need all arrays in both processes, twice in each.
    """
    notes = Notes()
    names: list[str] = []
    try:
        for name, array in _ARRAYS[kind](path, notes):
            plain = _texts(array) if array.dtype.hasobject else array
            np.save(folder / f"{len(names)}.npy", plain, allow_pickle=False)
            names.append(name)
    except RefusedError as error:
        notes.refusal = str(error)
    return names, notes


def _texts(array: NDArray[Any]) -> NDArray[np.str_]:
    """Return an array of Python objects as texts; a missing value is empty."""
    cells = ["" if value is None else str(value) for value in array.reshape(-1).tolist()]
    return np.array(cells, dtype=np.str_).reshape(array.shape)


def open_table(path: Path) -> TableFile:
    """Return the columns of a file; raises ReadError if it can't be read or has another format."""
    head = first_bytes(path, 16)
    kind = next((kind for magic, kind in _FORMATS.items() if head.startswith(magic)), "")
    if not kind and path.suffix.lower() != ".mat":
        raise refused(path, f"first bytes {head[:8].hex(' ')}; expected Parquet, HDF5, NPZ, NPY or MAT")
    kind = kind or "MAT"
    if kind == "HDF5":
        require(path, "h5py", "an HDF5 or MATLAB 7.3 file", extra="hdf5")
    if kind in _ARRAYS:
        return _table_of_child(path, kind)
    notes = Notes()
    try:
        arrays = npz_arrays(path, notes) if kind == "NPZ" else npy_array(path, notes)
    except ImucalError:
        raise
    except RefusedError as error:
        raise refused(path, str(error)) from error
    except Exception as error:
        # `zipfile`, Python's parser and others have their own errors.
        raise refused(path, f"not a readable {kind} file: {str(error) or type(error).__name__}") from error
    if notes.objects:
        raise refused(path, f"not a readable {kind} file: {OBJECTS_IN_NPZ.advice}")
    return _of_arrays(kind.lower(), arrays, notes)


def _table_of_child(path: Path, kind: str) -> TableFile:
    """Read a file in the child, which passes its arrays in files."""
    with tempfile.TemporaryDirectory(prefix="imucal-") as folder:
        # The child may have another working directory.
        names, notes = isolated(path, write_arrays, kind)(kind, path.absolute(), Path(folder))
        if notes.refusal:
            raise refused(path, notes.refusal)
        if kind == "HDF5":
            notes.damage = hdf5.damage_of(path)
        arrays = {
            name: np.load(Path(folder) / f"{number}.npy", allow_pickle=False)
            for number, name in enumerate(names)
        }
    return _of_arrays(kind.lower(), arrays, notes)


def _of_arrays(form: str, arrays: Mapping[str, NDArray[Any]], notes: Notes | None = None) -> TableFile:
    notes = notes or Notes()
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
    shapes += notes.skipped
    ways = [
        f"{name} is a {kind}, which only MATLAB can read; in MATLAB type "
        + _IN_MATLAB.get(kind, "its arrays into separate variables, and save those").format(name)
        for name, kind in notes.objects.items()
    ]
    return TableFile(
        format=form,
        columns=tuple(columns),
        rate_hz=rate,
        shapes=tuple(shapes[:_MAX_LISTED]),
        way="; ".join(ways[:_MAX_LISTED]),
        damage=notes.damage,
    )


def _of_array(name: str, array: NDArray[Any], unit: str | None = None) -> list[TypedColumn]:
    """Return the columns of a record or array; the longest of three or more dimensions is for samples."""
    if array.dtype.names is not None:
        parts = [(f"{name}.{part}".lstrip("."), array[part]) for part in array.dtype.names]
        return [column for label, part in parts for column in _of_array(label, part)]
    array = array.squeeze() if array.ndim > 2 else array
    # A field of a record may have such a type.
    if not array.ndim or not is_numeric(array.dtype):
        return []
    longest = int(np.argmax(array.shape))
    # Transpose a matrix with few rows.
    samples = longest if array.ndim > 2 or array.shape[0] <= _MAX_COLUMNS else 0
    array = np.moveaxis(array, samples, 0)
    width = math.prod(array.shape[1:])
    if width > _MAX_COLUMNS:
        return []
    return [_plain(_label(name, at, width), array[:, *at], unit) for at in np.ndindex(array.shape[1:])]


def _label(name: str, at: tuple[int, ...], width: int) -> str:
    """Return a column's name; only in arrays of three columns the number is an axis."""
    if len(at) > 1:
        return f"{name}[{','.join(map(str, at))}]"
    if not at or not name or width == 1:
        return name
    return f"{name}[{at[0]}]" if width == 3 else f"{name}[:,{at[0]}]"


def _plain(name: str, array: NDArray[Any], unit: str | None = None) -> TypedColumn:
    if array.dtype.kind not in "mM":
        return TypedColumn(name=name, values=array, unit=unit)
    return TypedColumn(name=name, values=array.astype(f"{array.dtype.kind}8[ns]").astype(np.int64), unit="ns")


def open_log(path: Path, options: ReadOptions) -> ColumnLog:
    """Open a file of typed columns; raises ReadError if it can't be read or has no columns of samples.

    Arrays of different lengths are separate tables. Indices in a columns text refer to the widest of them.
    """
    file = open_table(path)
    groups = _groups(path, file)
    if options.columns is not None:
        groups = [max(groups, key=lambda group: (len(group), group[0].values.size))]
    several = len(groups) > 1
    names = [f"{group[0].values.size} rows" if several else path.name for group in groups]
    arrays = {name: [one.values for one in group] for name, group in zip(names, groups, strict=True)}
    log = ColumnLog(path, arrays)
    log.form = file.format
    log.size_bytes = path.stat().st_size
    log.unpacked_bytes = 8 * sum(column.values.size for column in file.columns)
    log.advice = file.way
    log.tables = [_table(path, name, group, file) for name, group in zip(names, groups, strict=True)]
    if file.damage:
        text = f"The file is damaged: {file.damage}; some values may be wrong."
        log.findings.append(Finding("warning", "damaged", text, "Copy it again."))
    return log


def _table(path: Path, name: str, group: Sequence[TypedColumn], file: TableFile) -> Table:
    heads = [column.values[:HEAD_ROWS] for column in group]
    return Table(
        name=name,
        kind="table",
        place=str(path),
        columns=tuple(Column(name=one.name, type=one.values.dtype.name, unit=one.unit) for one in group),
        head=lambda: heads,
        count=group[0].values.size,
        rate_hz=file.rate_hz,
        sparse=any(head.dtype.kind == "f" and bool(np.isnan(head).any()) for head in heads),
        shapes=", ".join(file.shapes),
    )


def _groups(path: Path, table: TableFile) -> list[list[TypedColumn]]:
    lengths = dict.fromkeys(column.values.size for column in table.columns if column.values.size > 1)
    if not lengths:
        found = ", ".join(table.shapes or [column.name for column in table.columns]) or "nothing"
        why = table.way or (
            f"no columns of samples, found {found}; expected gyroscope or accelerometer arrays with a row "
            "per sample and up to 64 columns; save only those columns"
        )
        raise refused(path, why)
    return [[column for column in table.columns if column.values.size == n] for n in lengths]
