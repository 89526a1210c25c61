"""One view of results: rows of terms with a cell for each axis, in data-sheet units and in SI.

The table on the terminal, the page, notebooks, data frames and the texts of pictures all draw these rows;
none of them looks for terms, bounds or alternatives itself.
"""

from collections.abc import Iterator, Mapping

from imucal.fitting.noise_fit import Estimate, NoiseFit
from imucal.frozen import frozen
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.numbers import Quantity, SheetUnits, sheet_units
from imucal.report.result import Report

__all__ = ["Cell", "Column", "Row", "Shown", "View", "view", "views"]


@frozen
class Cell:
    """A quantity of one axis in data-sheet units and in SI; a bound where its value is None.

    `note` is a remark on it: another term that may stand in its place, or where on the curve it lies.
    """

    sheet: Quantity
    si: Quantity
    note: str = ""


@frozen
class Shown:
    """A cell as text: ``0.2013``, ``[0.2010, 0.2016]``, ``or GM``; a bound is ``< 0.12`` and no interval."""

    value: str
    interval: str
    note: str
    bounded: bool

    def __str__(self) -> str:
        return "  ".join(part for part in (self.value, self.interval, self.note) if part)


@frozen
class Column:
    """A row in one convention: all values are to be multiplied by ``10**exponent`` of the unit."""

    unit: str
    exponent: int
    texts: tuple[Shown | None, ...]


@frozen
class Row:
    """A quantity on every axis of a view, with a cell for each; None where an axis has no such term.

    `key`, `symbol` and `name` are such as ``GM1``, ``GM`` and ``Gauss-Markov``; its correlation time has
    the key ``GM1 T``, the lowest point of the curve the key ``minimum``, both without a symbol.
    """

    key: str
    symbol: str
    name: str
    cells: tuple[Cell | None, ...]

    def column(self, *, datasheet: bool) -> Column:
        """Return the texts, which share one power of ten, in data-sheet units or in SI."""
        cells = [(cell.sheet if datasheet else cell.si, cell.note) if cell else None for cell in self.cells]
        quantities = [cell[0] for cell in cells if cell]
        exponent = numbers.engineering_exponent(quantities)
        return Column(
            unit=quantities[0].unit,
            exponent=exponent,
            texts=tuple(_shown(*cell, exponent) if cell else None for cell in cells),
        )

    @property
    def columns(self) -> tuple[Column, Column]:
        """Its texts in data-sheet units, and in SI."""
        return self.column(datasheet=True), self.column(datasheet=False)


def _shown(quantity: Quantity, note: str, exponent: int) -> Shown:
    value, interval = numbers.compact(quantity, exponent=exponent)
    return Shown(value=value, interval=interval, note=note, bounded=quantity.value is None)


@frozen
class View:
    """The fits of one sensor as rows: its terms by rising slope, then the lowest point of the curve.

    `names` are what the columns are called, such as x, y and z; `sensor` is None where nobody knows it.
    """

    sensor: Sensor | None
    names: tuple[str, ...]
    fits: tuple[NoiseFit, ...]
    units: SheetUnits
    rows: tuple[Row, ...]


def views(report: Report) -> tuple[View, ...]:
    """Return the view of each sensor that has axes, the gyroscope first."""
    return tuple(view({axis.axis: axis.fit for axis in axes}) for axes in report.by_sensor.values())


def view(fits: Mapping[str, NoiseFit]) -> View:
    """Return fits of one sensor, by the names of their columns, as rows; there is at least one."""
    found = tuple(fits.values())
    units = sheet_units(found)
    return View(
        sensor=found[0].sensor, names=tuple(fits), fits=found, units=units, rows=tuple(_rows(found, units))
    )


def _rows(fits: tuple[NoiseFit, ...], units: SheetUnits) -> Iterator[Row]:
    sensor = fits[0].sensor
    symbols = {estimate.key: estimate.symbol for fit in fits for estimate in fit.estimates}
    for key in sorted(symbols, key=lambda key: list(TERMS).index(symbols[key])):
        found = [next((e for e in fit.estimates if e.key == key), None) for fit in fits]
        cells = (
            Cell(sheet=units.estimate(e, sensor), si=numbers.si(e, sensor), note=numbers.alternatives(e))
            if e
            else None
            for e in found
        )
        name = numbers.term_name(symbols[key], sensor)
        yield Row(key=key, symbol=symbols[key], name=name, cells=tuple(cells))
        times = tuple(_time(estimate) for estimate in found)
        if any(times):
            yield Row(key=f"{key} T", symbol="", name="correlation time", cells=times)
    lowest = tuple(
        Cell(
            sheet=units.minimum(fit),
            si=numbers.minimum(fit),
            note=f"at {numbers.seconds(fit.curve.minimum[1])}",
        )
        for fit in fits
    )
    yield Row(key="minimum", symbol="", name="of the curve", cells=lowest)


def _time(estimate: Estimate | None) -> Cell | None:
    if estimate is None or estimate.correlation_time is None:
        return None
    time = numbers.correlation_time(estimate.correlation_time)
    return Cell(sheet=time, si=time)
