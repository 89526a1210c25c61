"""What Parquet, MATLAB and NumPy files hold, by the packages that know them: run in a child process.

Every result can be pickled; see `imucal.readers.isolation`.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Parts of a list or a matrix that are shown as columns.
WIDEST = 64

#: Rows that are looked at to choose columns.
HEAD = 400

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
    schema = scan.collect_schema()
    rows = int(scan.select(pl.len()).collect()["len"].to_list()[0])
    columns = []
    for name, dtype in schema.items():
        parts: list[tuple[str, str | int | None]] = [(name, None)]
        if isinstance(dtype, pl.Struct):
            parts = [(f"{name}.{field.name}", field.name) for field in dtype.fields]
        elif isinstance(dtype, pl.List):
            lengths = scan.head(HEAD).select(pl.col(name).list.len()).collect()[name].to_list()
            width = max((length for length in lengths if length is not None), default=0)
            parts = [(f"{name}[{i}]", i) for i in range(min(width, WIDEST))]
        elif isinstance(dtype, pl.Array):
            parts = [(f"{name}[{i}]", i) for i in range(min(dtype.shape[0], WIDEST))]
        for label, part in parts:
            head = scan.head(HEAD).select(_expression(dtype, name, part).alias("v")).collect()["v"]
            columns.append(
                ParquetColumn(
                    label=label,
                    name=name,
                    part=part,
                    rows=rows,
                    head=head.to_numpy(),
                    unit="ns" if isinstance(head.dtype, pl.Datetime) else None,
                    has_gaps=head.null_count() > 0,
                )
            )
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


def mat_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of numbers in a MATLAB file; those in structures under names with points."""
    import scipy.io

    content = scipy.io.loadmat(str(path), squeeze_me=True, struct_as_record=True)
    arrays: dict[str, NDArray[Any]] = {}
    for name, value in content.items():
        if not name.startswith("__"):
            _flatten(name, value, arrays)
    return arrays


def _flatten(name: str, value: Any, arrays: dict[str, NDArray[Any]], depth: int = 0) -> None:  # noqa: ANN401
    """Collect the arrays of MATLAB structures under names with points."""
    array = np.asarray(value)
    if array.dtype.names is not None and depth < _DEEP:
        for part in array.dtype.names:
            inner = array[part]
            inner = inner.item() if inner.dtype == object and inner.size == 1 else inner
            _flatten(f"{name}.{part}", inner, arrays, depth + 1)
    elif array.dtype.kind in "biufM":
        arrays[name] = array
