"""Rewrite a text table: the cells of the IMU change, all other cells and lines stay byte for byte."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.applying import Correction, without_force
from imucal.correction.bias_over_time import BiasOverTime
from imucal.correction.targets import Target
from imucal.errors import DataError, Fix
from imucal.readers.tables.layout import BLANKS, TextLayout
from imucal.recording import Sensor

#: Lines that are corrected at once.
_LINES = 20_000
#: A cell of a table whose cells are separated by blanks, with the blanks before it.
_CELL = re.compile(rb"[ \t]*[^ \t\r\n]+")


@dataclass(frozen=True, kw_only=True, eq=False)
class TableCorrection:
    """The layout of a table, its samples, and their correction."""

    layout: TextLayout
    targets: Sequence[Target]
    correction: Correction | BiasOverTime

    @property
    def indices(self) -> list[int]:
        """The columns of all samples."""
        return [index for one in self.targets for index in one.indices]

    def refuse_unfit(self) -> None:
        """Raise DataError for a layout that has no row per sample."""
        if self.layout.prepare is not None or self.layout.quoted or any(one.rows for one in self.targets):
            problem = "the table has no row per sample with plain cells"
            raise DataError(problem, fix=Fix("write it as a plain CSV table"))
        correction = self.correction
        if isinstance(correction, Correction) and correction.G.any() and len(self.targets) < len(Sensor):
            raise without_force("")


@dataclass(frozen=True, kw_only=True, eq=False)
class _Row:
    """A line of a table: its cells, and its end."""

    cells: list[bytes]
    end: bytes


def rewrite_text(
    source: BinaryIO, target: BinaryIO, table: TableCorrection, progress: Callable[[int], None]
) -> None:
    """Copy a table with corrected cells; `progress` gets the bytes read.

    Raises DataError for a layout that has no row per sample.
    """
    table.refuse_unfit()
    read = 0
    rows = 0
    lines: list[bytes] = []
    for number, line in enumerate(source):
        read += len(line)
        if number < table.layout.start:
            target.write(line)
            continue
        lines.append(line)
        if len(lines) == _LINES:
            rows += _write_lines(lines, target, table, rows)
            lines = []
            progress(read)
    _write_lines(lines, target, table, rows)
    progress(read)


def _write_lines(lines: Sequence[bytes], target: BinaryIO, table: TableCorrection, first: int) -> int:
    """Write lines with corrected cells, from row `first` on; lines that are no rows stay. Return the rows."""
    layout = table.layout
    indices = table.indices
    rows = [_row(line, layout) for line in lines]
    numbers = [_numbers(row, indices, layout.decimal) for row in rows]
    places = [place for place, found in enumerate(numbers) if found is not None]
    if places:
        raw = np.array([numbers[place] for place in places], np.float64)
        values = _corrected(raw, table.targets, table.correction, first)
        for place, found in zip(places, values.tolist(), strict=True):
            row = rows[place]
            if row is not None:
                for index, value in zip(indices, found, strict=True):
                    row.cells[index] = _written(row.cells[index], value, layout.decimal)
    mark = b"" if layout.delimiter == BLANKS else layout.delimiter.encode()
    for line, row in zip(lines, rows, strict=True):
        target.write(line if row is None else mark.join(row.cells) + row.end)
    return len(places)


def _row(line: bytes, layout: TextLayout) -> _Row | None:
    """Return the cells of a line; None if it is no row of the table."""
    body = line.rstrip(b"\r\n")
    cells = _CELL.findall(body) if layout.delimiter == BLANKS else body.split(layout.delimiter.encode())
    rest = line[len(body) :]
    if layout.delimiter == BLANKS:
        rest = body[sum(map(len, cells)) :] + rest
    return _Row(cells=cells, end=rest) if len(cells) == layout.width else None


def _numbers(row: _Row | None, indices: Sequence[int], decimal: str) -> list[float] | None:
    """Return the numbers of some cells; None if one is no number."""
    if row is None:
        return None
    try:
        return [float(row.cells[index].decode("ascii").replace(decimal, ".")) for index in indices]
    except (ValueError, IndexError):
        return None


def _written(cell: bytes, value: float, decimal: str) -> bytes:
    """Return a cell with another number, and the blanks around it."""
    text = cell.strip()
    if not np.isfinite(value):
        return cell
    start = cell.find(text)
    number = repr(value).replace(".", decimal).encode()
    return cell[:start] + number + cell[start + len(text) :]


def _corrected(
    raw: FloatArray, targets: Sequence[Target], correction: Correction | BiasOverTime, first: int
) -> FloatArray:
    """Return corrected numbers, shape (n, 3 per target), in the units of the log; from row `first` on."""
    parts = {one.sensor: raw[:, 3 * place : 3 * place + 3] * one.factor for place, one in enumerate(targets)}
    if isinstance(correction, BiasOverTime):
        found = correction.samples_of_rows(parts, first)
    else:
        found = correction.samples(parts)
    return np.hstack([found[one.sensor] / one.result for one in targets])
