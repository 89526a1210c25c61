"""Tables with typed columns: Parquet, NumPy's NPZ and NPY, MATLAB's MAT; chosen by their names like a CSV's.

An array of three columns counts as ``name[0]``, ``name[1]``, ``name[2]`` for x, y, z; columns of others say
nothing by their places. Arrays of different lengths are tables of their own: the gyroscope may have one, the
accelerometer another.
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucal.errors import ChoiceError, ImucalError, ReadError
from imucal.readers.builder import RecordingBuilder
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.isolation import isolated, require
from imucal.readers.read_options import ReadOptions
from imucal.readers.store import Room, join_rows
from imucal.readers.tables.columns import ColumnsError
from imucal.readers.tables.dates import parse_texts, text_kind
from imucal.readers.tables.foreign_files import (
    HEAD,
    WIDEST,
    TypedColumn,
    hdf5_arrays,
    mat_arrays,
    npz_arrays,
    parquet_columns,
    unpacks_to_more,
)
from imucal.readers.tables.plan import SensorPlan, TablePlan, make_plan
from imucal.readers.tables.stamps import Numbers, TimeChoice
from imucal.readers.tables.tabular import (
    SensorColumns,
    assemble,
    contents_of,
    of_a_part,
    refuse_topics,
    with_more,
)
from imucal.recording import Recording, Sensor
from imucal.resources import MEMORY, column_limit, memory_limit

#: Arrays whose shapes are kept for a message.
_SHOWN = 12

#: How often the arrays of a MAT or an HDF5 file are in memory while it is read.
_COPIES = 4

#: Class of an object of MATLAB -> what writes it as text there.
_IN_MATLAB = {
    "table": "writetable({0}, '{0}.csv')",
    "timetable": "writetimetable({0}, '{0}.csv')",
    "timeseries": "writematrix([{0}.Time squeeze({0}.Data)], '{0}.csv')",
}

#: Names of a single number that is the sampling rate, in Hz.
_RATES = frozenset(
    {"fs", "freq", "rate", "rate_hz", "samplerate", "sample_rate", "sampling_rate", "frequency"}
)

#: NaveGo's names of an IMU structure: specific force, turn rate. Source: NaveGo, imu structure.
_NAVEGO = {"fb": ("accelerometer", "m/s^2"), "wb": ("gyroscope", "rad/s")}


@dataclass(frozen=True, slots=True, kw_only=True)
class TableFile:
    """The columns of a file, its format, and the sampling rate where it states one.

    `shapes` are its arrays as a message shows them, such as ``imu (600, 2, 3)``; those of which no columns
    were made are among them. `way` says what to do with what can't be read.
    """

    format: str
    columns: tuple[TypedColumn, ...]
    rate_hz: float | None = None
    shapes: tuple[str, ...] = ()
    way: str = ""


def open_table(path: Path, *, limit: int | None = None, heads_above: int | None = None) -> TableFile:
    """Return the columns of a file.

    Parameters
    ----------
    limit
        Bytes to hold in memory before a temporary file takes them; None for `imucal.resources.column_limit`.
    heads_above
        Bytes above which a file that is unpacked as it is opened is not: only the heads of its columns hold
        values then.

    Raises
    ------
    ReadError
        If it can't be read, or is none of the formats.
    """
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        msg = f"{path}: can't be opened: {error.strerror or error}"
        raise ReadError(msg) from error
    kind = next((kind for magic, kind in _FORMATS.items() if head.startswith(magic)), "")
    if not kind and path.suffix.lower() != ".mat":
        msg = f"{path}: first bytes {head[:8].hex(' ')}; expected Parquet, HDF5, NPZ, NPY or MAT"
        raise ReadError(msg)
    kind = kind or "MAT"
    if kind == "Parquet":
        columns = isolated(path, parquet_columns, "Parquet")(path)
        each = (replace(column, values=isolated(path, column.values, "Parquet")) for column in columns)
        return TableFile(format="parquet", columns=tuple(each))
    # The packages read these whole; the arrays are there, on their way to this process, and here.
    share = memory_limit() // _COPIES
    if kind == "HDF5":
        require(path, "h5py", "an HDF5 or MATLAB 7.3 file", extra="hdf5")
        return _of_arrays("hdf5", *isolated(path, hdf5_arrays, "HDF5")(path, share))
    if kind == "MAT":
        if unpacks_to_more(path, share):
            msg = (
                f"{path}: its arrays unpack to more than {share / 1e6:.4g} MB, and a MAT file is read whole; "
                "expected at most a quarter of the memory that one step may take; save them as NPZ or CSV, "
                f"or let {MEMORY} be four times what they hold"
            )
            raise ReadError(msg)
        return _of_arrays("mat", *isolated(path, mat_arrays, "MAT")(path))
    try:
        if kind == "NPZ":
            most = column_limit() if limit is None else limit
            return _of_arrays("npz", npz_arrays(path, limit=most, heads_above=heads_above))
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:
        text = str(error) or type(error).__name__
        msg = f"{path}: not a readable {kind} file: {text}"
        raise ReadError(msg) from error
    return TableFile(format="npy", columns=tuple(_of_array("", array)), shapes=(_shape("", array),))


def _of_arrays(
    form: str, arrays: Mapping[str, NDArray[Any]], objects: Mapping[str, str] | None = None
) -> TableFile:
    """Return the columns of the arrays of a file; a single number may be its sampling rate."""
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
    shapes = [_shape(name, array) for name, array in arrays.items() if array.size != 1]
    ways = [
        f"{name} is a {kind} of MATLAB, which no other program reads; type there {way.format(name)}"
        for name, kind in (objects or {}).items()
        if (way := _IN_MATLAB.get(kind, "its arrays into variables of their own, and save those"))
    ]
    return TableFile(
        format=form,
        columns=tuple(columns),
        rate_hz=rate,
        shapes=tuple(shapes[:_SHOWN]),
        way="; ".join(ways[:_SHOWN]),
    )


def _shape(name: str, array: NDArray[Any]) -> str:
    """Return an array as a message shows it: its name and its shape."""
    return f"{name or 'array'} {array.shape}"


def _of_array(name: str, array: NDArray[Any], unit: str | None = None) -> list[TypedColumn]:
    """Return the columns of an array: of a record, of a matrix, or itself; none of what is no table.

    Of three dimensions or more the longest holds the samples; the others are columns ``name[0,2]``.
    """
    if array.dtype.names is not None:
        parts = [(f"{name}.{part}".lstrip("."), array[part]) for part in array.dtype.names]
        return [column for label, part in parts for column in _of_array(label, part)]
    array = array.squeeze() if array.ndim > 2 else array
    if not array.ndim:
        return []
    longest = int(np.argmax(array.shape))
    # A matrix lies on its side where its rows are few enough to be columns.
    samples = longest if array.ndim > 2 or array.shape[0] <= WIDEST else 0
    array = np.moveaxis(array, samples, 0)
    width = math.prod(array.shape[1:])
    if width > WIDEST:
        return []
    return [_plain(_label(name, at, width), array[:, *at], unit) for at in np.ndindex(array.shape[1:])]


def _label(name: str, at: tuple[int, ...], width: int) -> str:
    """Return the name of a column of an array; three are x, y and z, of others no number tells an axis."""
    if len(at) > 1:
        return f"{name}[{','.join(map(str, at))}]"
    if not at or not name or width == 1:
        return name
    return f"{name}[{at[0]}]" if width == 3 else f"{name}[:,{at[0]}]"


def _plain(name: str, array: NDArray[Any], unit: str | None = None) -> TypedColumn:
    head = array[:HEAD]
    return TypedColumn(
        name=name,
        size=array.size,
        values=lambda: array,
        head=head,
        unit="ns" if array.dtype.kind == "M" else unit,
        has_gaps=array.dtype.kind == "f" and bool(np.isnan(head).any()),
    )


#: First bytes -> format.
_FORMATS = {
    b"PAR1": "Parquet",
    b"\x93NUMPY": "NPY",
    b"PK": "NPZ",
    b"MATLAB 5.0": "MAT",
    b"MATLAB 7.3": "HDF5",
    b"\x89HDF\r\n\x1a\n": "HDF5",
}

#: Tables up to this size are read to be described, in bytes: they take less than half a second.
_SMALL = 64 << 20


class _Part(NamedTuple):
    """Columns of one length and what was chosen of them."""

    columns: Sequence[TypedColumn]
    plan: TablePlan


def read(path: Path, options: ReadOptions) -> Recording:
    """Read a table of typed columns.

    Raises
    ------
    ChoiceError
        If columns, units or time are not clear.
    ReadError
        If the file can't be read.
    DataError
        If it holds no samples.
    """
    refuse_topics(path, options, "a table")
    table = open_table(path, limit=options.memory_limit)
    return _read(path, table, _parts(path, table, options), options)


def _read(path: Path, table: TableFile, parts: Sequence[_Part], options: ReadOptions) -> Recording:
    plans = [part.plan for part in parts]
    found = {sensor.triad.sensor.short for plan in plans for sensor in plan.sensors}
    work = RecordingBuilder(
        path=str(path),
        format=table.format,
        options=options,
        rate_hz=table.rate_hz,
        decisions=[*dict.fromkeys(decision for plan in plans for decision in plan.decisions)],
        # What one table lacks another may hold.
        findings=[finding for plan in plans for finding in plan.findings if finding.axis not in found],
    )
    sensors = [_columns(part, sensor, options) for part in parts for sensor in part.plan.sensors]
    return assemble(work, sensors, [topic for plan in plans for topic in plan.topics])


def describe(path: Path, options: ReadOptions) -> LogContents:
    """Return what a table holds."""
    size = path.stat().st_size
    table = open_table(path, heads_above=_SMALL)
    # As numbers of eight bytes.
    unpacked = 8 * sum(column.size for column in table.columns)
    shown = ", ".join(f"{column.name} ({column.size})" for column in table.columns[:60])
    try:
        parts = _parts(path, table, options)
        read_parts = parts if unpacked <= _SMALL else [_heads(part) for part in parts]
        contents = contents_of(_read(path, table, read_parts, options), path, size=size)
    except ImucalError as error:
        topic = TopicContents(name=path.name, type="table", note=f"{error}; columns: {shown}")
        return LogContents(path=str(path), format=table.format, size_bytes=size, topics=(topic,))
    contents = contents if unpacked <= _SMALL else of_a_part(contents, parts[0].columns[0].size)
    return replace(contents, unpacked_bytes=unpacked)


def _heads(part: _Part) -> _Part:
    """Return a part of which all that is read are the heads of its columns."""
    columns = [replace(c, size=len(c.head), values=partial(np.asarray, c.head)) for c in part.columns]
    return part._replace(columns=columns)


def _parts(path: Path, table: TableFile, options: ReadOptions) -> list[_Part]:
    """Choose the columns; of arrays of several lengths each length for itself."""
    lengths = dict.fromkeys(column.size for column in table.columns if column.size > 1)
    if not lengths:
        found = ", ".join(table.shapes or [column.name for column in table.columns]) or "nothing"
        why = table.way or (
            f"no columns of samples, found {found}; expected arrays of the gyroscope or the accelerometer "
            "with a row per sample and up to 64 columns; save those columns alone"
        )
        msg = f"{path}: {why}"
        raise ReadError(msg)
    groups = [tuple(column for column in table.columns if column.size == length) for length in lengths]
    parts: list[_Part] = []
    for group in groups if len(groups) > 1 and options.columns is None else ():
        with suppress(ChoiceError):
            parts.append(_part(path, group, options, table.shapes))
    if not parts:
        # The indices in a columns text, and in the error that proposes one, are those of the widest table.
        widest = max(groups, key=lambda group: (len(group), group[0].size))
        return [_only_part(path, table, widest, options)]
    triads = [sensor.triad for part in parts for sensor in part.plan.sensors]
    for sensor in Sensor:
        names = [triad.headers[0] for triad in triads if triad.sensor is sensor]
        if len(names) > 1:
            msg = (
                f"{path}: two tables hold a {sensor}: {' and '.join(names[:2])}; "
                "expected one; give the columns"
            )
            raise ChoiceError(msg)
    return parts


def _only_part(path: Path, table: TableFile, columns: Sequence[TypedColumn], options: ReadOptions) -> _Part:
    """Choose among the columns of one length; where that is open, ask for all that is."""
    try:
        return _part(path, columns, options, table.shapes)
    except ColumnsError as error:

        def tried(text: str) -> object:
            asked = replace(options, columns=text)
            return _read(path, table, [_heads(_part(path, columns, asked, table.shapes))], asked)

        asking = with_more(str(path), error, tried)
        raise type(asking)(f"{asking}; or {table.way}" if table.way else str(asking)) from error


def _part(path: Path, columns: Sequence[TypedColumn], options: ReadOptions, shapes: Sequence[str]) -> _Part:
    plan = make_plan(
        str(path),
        [column.name for column in columns],
        [column.cells for column in columns].__getitem__,
        options,
        units=[column.unit for column in columns],
        name=path.name,
        shape=", ".join(shapes),
    )
    return _Part(columns, plan)


def _columns(part: _Part, sensor: SensorPlan, options: ReadOptions) -> SensorColumns:
    indices, at = sensor.triad.indices, part.plan.temperature
    # Copies, as samples are scaled in place; half of what may be held is for each of two sensors.
    limit = (options.memory_limit or column_limit()) // 2
    columns = SensorColumns(
        plan=sensor,
        axes=join_rows([[part.columns[index].values()] for index in indices], limit=limit),
        time=_times(part, sensor.time),
        log_time=_times(part, sensor.log_time),
        temperature=np.array(part.columns[at].values(), dtype=np.float64) if at is not None else None,
        sparse=any(part.columns[index].has_gaps for index in indices),
    )
    if sensor.triad.rows is None:
        return columns
    index, tag = sensor.triad.rows
    chosen = np.array([str(value) == tag for value in part.columns[index].values()], dtype=np.bool_)
    return columns.rows(chosen, Room(options.memory_limit))


def _times(part: _Part, time: TimeChoice | None) -> tuple[Numbers, ...]:
    """Return the columns of a time as whole numbers or floats; texts in ns."""
    found: list[Numbers] = []
    for column in [part.columns[index] for index in time.indices] if time is not None else ():
        values = column.values()
        if time is not None and time.kind == "text":
            found.append(parse_texts(list(map(str, values)), text_kind(column.cells), by_day=time.by_day))
            continue
        if values.dtype.kind == "M":
            values = values.astype("datetime64[ns]")
        # Stamps may be mended in place, so whole numbers are copied.
        integers = values.dtype.kind in "iuM"
        found.append(values.astype(np.int64) if integers else np.asarray(values, dtype=np.float64))
    return tuple(found)
