"""Tables with typed columns: Parquet, HDF5, NumPy's NPZ and NPY, MATLAB's MAT.

Packages read all but NPY and NPZ in a child process with limited memory (`imucal.readers.isolation`), because
small files may unpack to very large ones. An array of three columns is ``name[0]`` to ``name[2]`` for x, y,
z. Arrays of different lengths are separate tables.
"""

import math
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.errors import Fix, ImucalError
from imucal.findings import Finding
from imucal.frozen import frozen, frozen_alone
from imucal.readers.contents import LogContents
from imucal.readers.files import first_bytes, refused
from imucal.readers.foreign import OBJECTS_IN_NPZ
from imucal.readers.isolation import isolated, require
from imucal.readers.message_logs import OpenLog, read_log
from imucal.readers.messages.topics import HELD_ROWS, Column, Topic, held_topic
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables import hdf5, parquet_pages
from imucal.readers.tables.columns import ColumnsError
from imucal.readers.tables.npz import is_numeric, npy_array, npz_arrays
from imucal.readers.tables.passed import PIECE, Notes, Part, Passed, RefusedError, taken, written
from imucal.readers.tables.tabular import contents_of, refuse_topics, with_more
from imucal.recording import Recording

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


@frozen_alone
class TypedColumn:
    """A column, shape (n,), with name and unit."""

    name: str
    values: NDArray[Any]
    unit: str | None = None


def _parquet_parts(path: Path, notes: Notes) -> Iterator[Part]:
    import polars as pl

    notes.damage = parquet_pages.damage_of(path)

    scan = pl.scan_parquet(path, glob=False)
    names, n = scan.collect_schema().names(), int(scan.select(pl.len()).collect().item())
    some = max(1, PIECE // max(1, 8 * n))
    for start in range(0, len(names), some):
        for series in scan.select(names[start : start + some]).collect():
            yield from ((name, 0, [column.to_numpy()]) for name, column in _split(series))


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


def _mat_parts(path: Path, notes: Notes) -> Iterator[Part]:
    import scipy.io

    content = scipy.io.loadmat(str(path), squeeze_me=True, struct_as_record=True)
    for name, value in content.items():
        if not name.startswith("__"):
            yield from ((label, 0, [array]) for label, array in _flatten(name, value, notes))


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


@frozen
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


_PARTS = {"Parquet": _parquet_parts, "HDF5": hdf5.parts, "MAT": _mat_parts}


def write_arrays(kind: str, path: Path, target: Path) -> tuple[Passed, Notes]:
    """Write the arrays of a file to another; return their places and the rest. Runs in the child."""
    notes = Notes()
    try:
        return written(_PARTS[kind](path, notes), target), notes
    except RefusedError as error:
        notes.refusal = str(error)
        return {}, notes


def open_table(path: Path) -> TableFile:
    """Return the columns of a file; raises ReadError if it can't be read or has another format."""
    head = first_bytes(path, 16)
    kind = next((kind for magic, kind in _FORMATS.items() if head.startswith(magic)), "")
    if not kind and path.suffix.lower() != ".mat":
        raise refused(path, f"first bytes {head[:8].hex(' ')}; expected Parquet, HDF5, NPZ, NPY or MAT")
    kind = kind or "MAT"
    if kind == "HDF5":
        require(path, "h5py", "an HDF5 or MATLAB 7.3 file", extra="hdf5")
    if kind in _PARTS:
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
    """Read a table in the child, which passes its arrays in a file."""
    with tempfile.TemporaryDirectory(prefix="imucal-") as folder:
        target = Path(folder) / "arrays"
        # The child may have another working directory.
        found, notes = isolated(path, write_arrays, kind)(kind, path.absolute(), target)
        if notes.refusal:
            raise refused(path, notes.refusal)
        if kind == "HDF5":
            notes.damage = hdf5.damage_of(path)
        return _of_arrays(kind.lower(), taken(found, target), notes)


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


def read(path: Path, options: ReadOptions) -> Recording:
    """Read a table of typed columns.

    Raises ChoiceError if columns, units or time are ambiguous, ReadError, or DataError without samples.
    """
    return _read(path, open_table(path), options)


def describe(path: Path, options: ReadOptions) -> LogContents:
    """Return the contents of a table."""
    size, table = path.stat().st_size, open_table(path)
    found: Recording | ImucalError
    try:
        found = _read(path, table, options)
    except ImucalError as error:
        names = ", ".join(f"{column.name} ({column.values.size})" for column in table.columns[:60])
        found = error.with_fixes(Fix(f"columns: {names}"))
    unpacked = 8 * sum(column.values.size for column in table.columns)
    return replace(contents_of(path, table.format, found, size=size), unpacked_bytes=unpacked)


def _read(path: Path, table: TableFile, options: ReadOptions) -> Recording:
    topics = _topics(path, table, options)
    if len(topics) == 1:
        refuse_topics(path, options, "a table")
    try:
        return read_log(_log(path, table, topics), options)
    except ColumnsError as error:

        def tried(asked: ReadOptions) -> object:
            heads = [replace(one, held=tuple(values[:HELD_ROWS] for values in one.held)) for one in topics]
            return read_log(_log(path, table, heads), asked)

        asking = with_more(str(path), error, options, tried)
        raise (asking.with_fixes(Fix(table.way)) if table.way else asking) from error


def _log(path: Path, table: TableFile, topics: list[Topic]) -> OpenLog:
    findings = []
    if table.damage:
        text = f"The file is damaged: {table.damage}; some values may be wrong."
        findings.append(Finding("warning", "damaged", text, "Copy it again."))
    return OpenLog(path, table.format, topics, findings, rate_hz=table.rate_hz)


def _topics(path: Path, table: TableFile, options: ReadOptions) -> list[Topic]:
    """Return a topic for each array length with a sensor; without one, the widest table.

    Indices in a columns text refer to the widest table.
    """
    groups = _groups(path, table)
    topics = []
    if len(groups) > 1 and options.columns is None:
        topics = [_topic(path, group, table, options, f"{group[0].values.size} rows") for group in groups]
    widest = max(groups, key=lambda group: (len(group), group[0].values.size))
    return [one for one in topics if one.sensors] or [_topic(path, widest, table, options, path.name)]


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


def _topic(path: Path, group: list[TypedColumn], table: TableFile, options: ReadOptions, name: str) -> Topic:
    columns = {
        Column(one.name, str(at), one.values.dtype.name, one.unit): one.values for at, one in enumerate(group)
    }
    heads = [one.values[:HELD_ROWS] for one in group if one.values.dtype.kind == "f"]
    sparse = any(bool(np.isnan(head).any()) for head in heads)
    shapes = ", ".join(table.shapes)
    return held_topic(name, "table", columns, options, file=str(path), shapes=shapes, sparse=sparse)
