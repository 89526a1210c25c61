"""Logs whose columns are in memory."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import BoolArray
from imucal.errors import ChoiceError
from imucal.readers.fixes import COLUMNS
from imucal.readers.table import Loaded, Log, Request, cells_of
from imucal.readers.tables.dates import parse_texts, text_kind
from imucal.readers.tables.layout import is_number


class ColumnLog(Log):
    """A log whose tables are arrays in memory: the columns of each table, shape (n,) each, by its name."""

    def __init__(self, path: Path, arrays: Mapping[str, Sequence[NDArray[Any]]]) -> None:
        super().__init__(path)
        self._arrays = arrays

    def read(self, requests: Sequence[Request]) -> list[Loaded]:
        return [_loaded(request, self._arrays[request.table.name]) for request in requests]


def _loaded(request: Request, columns: Sequence[NDArray[Any]]) -> Loaded:
    found = {index: _numbers(request, index, columns[index]) for index in request.columns}
    if request.rows is None:
        return Loaded(found)
    index, tag = request.rows
    tagged = columns if index < 0 else [columns[index]]
    keep = np.any([_equal(column, tag) for column in tagged], axis=0)
    return Loaded({index: column[keep] for index, column in found.items()})


def _equal(column: NDArray[Any], tag: str) -> BoolArray:
    """Return which values are a tag, as text or as a number."""
    if column.dtype.kind in "iuf" and is_number(tag):
        return np.asarray(column == float(tag), np.bool_)
    return np.array([str(value) == tag for value in column], np.bool_)


def _numbers(request: Request, index: int, values: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of a column: samples as float64, times as int64 or float64, texts of times in ns."""
    texts = [time for time in request.times if time.kind == "text" and index in time.indices]
    if texts:
        return parse_texts(list(map(str, values)), text_kind(cells_of(values)), by_day=texts[0].by_day)
    is_sample = index in request.samples or index == request.temperature
    if values.dtype.kind in "iu" and not is_sample:
        return np.array(values, np.int64)
    try:
        return np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        name = request.table.columns[index].name
        text = f"column {name} does not contain numbers: {error}"
        raise ChoiceError(text, place=request.table.place, fix=COLUMNS) from error
