"""Tables with typed columns: Parquet, NumPy's NPZ and NPY, MATLAB's MAT; chosen by their names like a CSV's.

An array of three columns counts as ``name[0]``, ``name[1]``, ``name[2]`` for x, y, z; columns of others say
nothing by their places. Arrays of different lengths are tables of their own: the gyroscope may have one, the
accelerometer another.

Parquet, NPZ, NPY and MAT files as lists of named columns.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.errors import ChoiceError, ImucalError, ReadError
from imucal.findings import Finding
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.isolation import isolated
from imucal.readers.read_options import ReadOptions
from imucal.readers.store import Room, join_rows
from imucal.readers.tables.dates import parse_texts, text_kind
from imucal.readers.tables.foreign_files import (
    WIDEST,
    mat_arrays,
    npz_arrays,
    parquet_columns,
    parquet_values,
    unpacks_to_more,
)
from imucal.readers.tables.plan import SensorPlan, TablePlan, make_plan
from imucal.readers.tables.scales import Work
from imucal.readers.tables.stamps import Numbers, TimeChoice
from imucal.readers.tables.tabular import SensorColumns, assemble, contents_of, refuse_topics
from imucal.recording import Recording, Sensor
from imucal.resources import MEMORY, column_limit, memory_limit

#: Arrays whose shapes are kept for a message.
_SHOWN = 12

#: How often the arrays of a MAT file are in memory while it is read.
_MAT_COPIES = 4

#: Names of a single number that is the sampling rate, in Hz.
_RATES = frozenset(
    {"fs", "freq", "rate", "rate_hz", "samplerate", "sample_rate", "sampling_rate", "frequency"}
)

#: NaveGo's names of an IMU structure: specific force, turn rate. Source: NaveGo, imu structure.
_NAVEGO = {"fb": ("accelerometer", "m/s^2"), "wb": ("gyroscope", "rad/s")}


@dataclass(frozen=True, slots=True, kw_only=True)
class TypedColumn:
    """A column under the name and unit that the rules for names take; some cells are empty if it `has_gaps`.

    `values` reads all of it, shape (size,); `head` are the first ones.
    """

    name: str
    size: int
    values: Callable[[], NDArray[Any]] = field(repr=False)
    head: NDArray[Any] = field(repr=False)
    unit: str | None = None
    has_gaps: bool = False

    def cells(self, rows: int) -> list[str]:
        """Return the first values as the cells of a text table; an empty one for NaN."""
        values = self.head[:rows]
        if values.dtype.kind == "M":
            return [str(value) for value in values.astype("datetime64[ns]").astype(np.int64).tolist()]
        return ["" if value is None or value != value else str(value) for value in values.tolist()]  # noqa: PLR0124 - NaN

    def is_text(self, text: str) -> NDArray[np.bool_]:
        """Return which cells hold a text."""
        return np.array([str(value) == text for value in self.values()], dtype=np.bool_)


@dataclass(frozen=True, slots=True, kw_only=True)
class TableFile:
    """The columns of a file, its format, and the sampling rate where it states one.

    `shapes` are its arrays as a message shows them, such as ``imu (600, 2, 3)``; those of which no columns
    were made are among them.
    """

    format: str
    columns: tuple[TypedColumn, ...]
    rate_hz: float | None = None
    shapes: tuple[str, ...] = ()

    @property
    def unpacked_bytes(self) -> int:
        """Bytes of all columns as numbers of eight bytes."""
        return 8 * sum(column.size for column in self.columns)


#: The columns of a file, the sampling rate where it states one, and the shapes of its arrays.
_Content: TypeAlias = tuple[list[TypedColumn], float | None, tuple[str, ...]]
_Reader: TypeAlias = Callable[[Path], _Content]


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
    kind, reader = _reader(path, head)
    reader = partial(_npz, limit=limit, heads_above=heads_above) if reader is _npz else reader
    columns, rate, shapes = reader(path)
    return TableFile(format=kind.lower(), columns=tuple(columns), rate_hz=rate, shapes=shapes)


def _reader(path: Path, head: bytes) -> tuple[str, _Reader]:
    for magic, kind, reader in _FORMATS:
        if head.startswith(magic):
            return kind, reader
    if head.startswith(b"\x89HDF\r\n\x1a\n") or head[:10] == b"MATLAB 7.3":
        msg = (
            f"{path}: a MATLAB 7.3 or HDF5 file; expected MAT up to version 7; "
            "save it in MATLAB with save(..., '-v7'), or export a CSV"
        )
        raise ReadError(msg)
    if path.suffix.lower() == ".mat":
        return "MAT", _mat
    msg = f"{path}: first bytes {head[:8].hex(' ')}; expected Parquet, NPZ, NPY or MAT"
    raise ReadError(msg)


def _parquet(path: Path) -> _Content:
    values = isolated(path, parquet_values, "Parquet")
    columns = [
        TypedColumn(
            name=column.label,
            size=column.rows,
            head=column.head,
            values=partial(values, path, column.name, column.part),
            unit=column.unit,
            has_gaps=column.has_gaps,
        )
        for column in isolated(path, parquet_columns, "Parquet")(path)
    ]
    return columns, None, ()


def _npy(path: Path) -> _Content:
    with _readable(path, "NPY"):
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    return _of_array("", array), None, (_shape("", array),)


def _npz(path: Path, *, limit: int | None = None, heads_above: int | None = None) -> _Content:
    size = column_limit() if limit is None else limit
    with _readable(path, "NPZ"):
        arrays = npz_arrays(path, limit=size, heads_above=heads_above)
    return _of_arrays(arrays)


@contextmanager
def _readable(path: Path, kind: str) -> Iterator[None]:
    """Turn whatever NumPy raises at a damaged file into a ReadError."""
    try:
        yield
    except Exception as error:
        text = str(error) or type(error).__name__
        msg = f"{path}: not a readable {kind} file: {text}"
        raise ReadError(msg) from error


def _mat(path: Path) -> _Content:
    # The package reads it whole; the arrays are there, on their way to this process, and here.
    limit = memory_limit() // _MAT_COPIES
    if unpacks_to_more(path, limit):
        msg = (
            f"{path}: its arrays unpack to more than {limit / 1e6:.4g} MB, and a MAT file is read whole; "
            "expected at most a quarter of the memory that one step may take; save them as NPZ or CSV, "
            f"or let {MEMORY} be four times what they hold"
        )
        raise ReadError(msg)
    return _of_arrays(isolated(path, mat_arrays, "MAT")(path))


def _of_arrays(arrays: Mapping[str, NDArray[Any]]) -> _Content:
    rate = None
    columns: list[TypedColumn] = []
    shapes = [_shape(name, array) for name, array in arrays.items() if array.size != 1]
    for name, array in arrays.items():
        last = name.rpartition(".")[2].lower()
        if array.size == 1 and array.dtype.kind in "iuf":
            value = float(array.reshape(-1)[0])
            if last in _RATES and np.isfinite(value) and value > 0:
                rate = value
            continue
        label, unit = _NAVEGO.get(last, ("", None))
        columns += _of_array(f"{name}.{label}" if label else name, array, unit)
    return columns, rate, tuple(shapes[:_SHOWN])


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
    if array.ndim > 2:
        array = array.squeeze()
    if array.ndim == 1:
        return [_plain(name, array, unit)]
    return _of_matrix(name, array, unit) if array.ndim == 2 else _of_cube(name, array, unit)


def _of_matrix(name: str, array: NDArray[Any], unit: str | None) -> list[TypedColumn]:
    if array.shape[0] < array.shape[1] and array.shape[0] <= WIDEST:
        array = array.T
    if array.shape[1] > WIDEST:
        return []
    if array.shape[1] == 1:
        return [_plain(name, array[:, 0], unit)]
    # Three columns are x, y and z; of others no number tells an axis.
    place = "[{}]" if array.shape[1] == 3 else "[:,{}]"
    labels = [name + place.format(i) if name else "" for i in range(array.shape[1])]
    return [_plain(label, array[:, i], unit) for i, label in enumerate(labels)]


def _of_cube(name: str, array: NDArray[Any], unit: str | None) -> list[TypedColumn]:
    if array.ndim == 0 or array.size > WIDEST * max(array.shape):
        return []
    array = np.moveaxis(array, int(np.argmax(array.shape)), 0)
    places = np.ndindex(array.shape[1:])
    return [_plain(f"{name}[{','.join(map(str, at))}]", array[:, *at], unit) for at in places]


def _plain(name: str, array: NDArray[Any], unit: str | None = None) -> TypedColumn:
    unit = "ns" if array.dtype.kind == "M" else unit
    gaps = array.dtype.kind == "f" and bool(np.isnan(array[:400]).any())
    return TypedColumn(
        name=name, size=array.size, values=lambda: array, head=array[:400], unit=unit, has_gaps=gaps
    )


#: First bytes, name and reader of each format.
_FORMATS: tuple[tuple[bytes, str, _Reader], ...] = (
    (b"PAR1", "Parquet", _parquet),
    (b"\x93NUMPY", "NPY", _npy),
    (b"PK", "NPZ", _npz),
    (b"MATLAB 5.0", "MAT", _mat),
)


#: Tables up to this size are read to be described, in bytes: they take less than half a second.
_SMALL = 64 << 20
#: Rows shown to the rules that choose columns.
_HEAD = 400


@dataclass(frozen=True, slots=True, kw_only=True)
class _Part:
    """Columns of one length and what was chosen of them."""

    columns: tuple[TypedColumn, ...]
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
    sensors = [_columns(part, sensor, options) for part in parts for sensor in part.plan.sensors]
    decisions = dict.fromkeys(decision for part in parts for decision in part.plan.decisions)
    topics = [topic for part in parts for topic in part.plan.topics]
    dialect = next((part.plan.dialect for part in parts if part.plan.dialect), None)
    work = Work(
        path=str(path),
        options=options,
        dialect=dialect,
        rate_hz=table.rate_hz,
        decisions=[*decisions],
        findings=_findings(parts),
    )
    return assemble(work, sensors, table.format, topics)


def describe(path: Path, options: ReadOptions) -> LogContents:
    """Return what a table holds."""
    size = path.stat().st_size
    table = open_table(path, heads_above=_SMALL)
    unpacked = table.unpacked_bytes
    shown = ", ".join(f"{column.name} ({column.size})" for column in table.columns[:60])
    try:
        parts = _parts(path, table, options)
        read_parts = parts if unpacked <= _SMALL else [_heads(part) for part in parts]
        contents = contents_of(_read(path, table, read_parts, options), path, size=size)
    except ImucalError as error:
        topic = TopicContents(name=path.name, type="table", note=f"{error}; columns: {shown}")
        return LogContents(path=str(path), format=table.format, size_bytes=size, topics=(topic,))
    contents = replace(contents, unpacked_bytes=unpacked)
    if unpacked <= _SMALL:
        return contents
    rows = parts[0].columns[0].size
    topics = tuple(replace(topic, count=rows, duration_s=None) for topic in contents.topics)
    return replace(contents, topics=topics, duration_s=None)


def _heads(part: _Part) -> _Part:
    """Return a part of which all that is read are the heads of its columns."""
    columns = tuple(replace(c, size=len(c.head), values=partial(np.asarray, c.head)) for c in part.columns)
    return replace(part, columns=columns)


def _parts(path: Path, table: TableFile, options: ReadOptions) -> list[_Part]:
    """Choose the columns; of arrays of several lengths each length for itself."""
    lengths = dict.fromkeys(column.size for column in table.columns if column.size > 1)
    groups = [tuple(c for c in table.columns if c.size == length) for length in lengths]
    if not groups:
        raise _nothing(path, table)
    parts = []
    for group in groups if len(groups) > 1 and options.columns is None else ():
        with suppress(ChoiceError):
            parts.append(_part(path, group, options, table.shapes))
    if not parts:
        # The indices in a columns text, and in the error that proposes one, are those of the widest table.
        widest = max(groups, key=lambda group: (len(group), group[0].size))
        return [_part(path, widest, options, table.shapes)]
    _refuse_doubles(path, parts)
    return parts


def _nothing(path: Path, table: TableFile) -> ReadError:
    """Return the error of a file without columns of samples."""
    shown = ", ".join(table.shapes or [column.name for column in table.columns]) or "nothing"
    return ReadError(
        f"{path}: no columns of samples, found {shown}; expected arrays of the gyroscope or the "
        "accelerometer with a row per sample and up to 64 columns; save those columns alone"
    )


def _findings(parts: Sequence[_Part]) -> list[Finding]:
    """Return what was not found; what one table lacks another may hold."""
    found = {plan.triad.sensor.short for part in parts for plan in part.plan.sensors}
    return [finding for part in parts for finding in part.plan.findings if finding.axis not in found]


def _refuse_doubles(path: Path, parts: Sequence[_Part]) -> None:
    """Refuse a sensor that stands in two tables."""
    found: dict[Sensor, list[str]] = {}
    for triad in (plan.triad for part in parts for plan in part.plan.sensors):
        names = found.setdefault(triad.sensor, [])
        names.append(triad.headers[0])
        if len(names) > 1:
            msg = (
                f"{path}: two tables hold a {triad.sensor}: {' and '.join(names)}; "
                "expected one; give the columns"
            )
            raise ChoiceError(msg)


def _part(path: Path, columns: Sequence[TypedColumn], options: ReadOptions, shapes: Sequence[str]) -> _Part:
    cells = [column.cells(_HEAD) for column in columns]
    plan = make_plan(
        str(path),
        [column.name for column in columns],
        lambda index: cells[index],
        options,
        units=[column.unit for column in columns],
        name=path.name,
        shape=", ".join(shapes),
    )
    return _Part(columns=tuple(columns), plan=plan)


def _columns(part: _Part, sensor: SensorPlan, options: ReadOptions) -> SensorColumns:
    indices, at = sensor.triad.indices, part.plan.temperature
    # Copies, as samples are scaled in place; half of what may be held is for each of two sensors.
    limit = (options.memory_limit or column_limit()) // 2
    columns = SensorColumns(
        plan=sensor,
        axes=join_rows([[part.columns[index].values()] for index in indices], limit=limit),
        time=_times(part, sensor.time),
        log_time=_times(part, sensor.log_time),
        temperature=_floats(part.columns[at]) if at is not None else None,
        sparse=any(part.columns[index].has_gaps for index in indices),
    )
    if sensor.triad.rows is None:
        return columns
    index, tag = sensor.triad.rows
    return columns.rows(part.columns[index].is_text(tag), Room(options.memory_limit))


def _times(part: _Part, time: TimeChoice | None) -> tuple[Numbers, ...]:
    if time is None:
        return ()
    columns = [part.columns[index] for index in time.indices]
    if time.kind == "text":
        kinds = [text_kind(column.cells(_HEAD)) for column in columns]
        return tuple(
            parse_texts([str(cell) for cell in column.values()], kind, by_day=time.by_day)
            for column, kind in zip(columns, kinds, strict=True)
        )
    return tuple(map(_numbers, columns))


def _numbers(column: TypedColumn) -> Numbers:
    values = column.values()
    if values.dtype.kind == "M":
        return np.asarray(values.astype("datetime64[ns]").astype(np.int64))
    if values.dtype.kind in "iu":
        return values.astype(np.int64)
    return np.asarray(values, dtype=np.float64)


def _floats(column: TypedColumn) -> Any:  # noqa: ANN401 - numpy's astype
    return np.array(column.values(), dtype=np.float64)
