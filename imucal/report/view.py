"""One view of results for all outputs: rows with a cell for each axis, in data-sheet units and in SI."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from imucal.fitting.noise_fit import Estimate, NoiseFit
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.numbers import Quantity, SheetUnits, sheet_units
from imucal.report.result import AxisReport, Report

__all__ = [
    "ROWS", "Cell", "Column", "Row", "Shown", "Subject", "View", "ordered_keys", "term_name", "view", "views",
]  # fmt: skip

Subject: TypeAlias = AxisReport | NoiseFit

#: B in results. Its usual name, bias instability, is left to the minimum, because data sheets mean that.
_FLICKER_NAME = "flicker noise"
#: What B is, next to the minimum.
_FLICKER_REMARK = "coefficient of the fit; floor 0.664 B"
#: What the minimum is, next to B.
_MINIMUM_REMARK = "data sheets call it bias instability"


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A cell as text: ``0.2013``, ``[0.2010, 0.2016]``, ``or GM``; a bound has no interval."""

    value: str
    interval: str
    note: str
    bounded: bool

    def __str__(self) -> str:
        return "  ".join(part for part in (self.value, self.interval, self.note) if part)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A quantity of one axis; `note` names another term that fits as well, or the time of the minimum."""

    sheet: Quantity
    si: Quantity
    note: str = ""

    def quantity(self, *, datasheet: bool) -> Quantity:
        return self.sheet if datasheet else self.si

    def shown(self, exponent: int, *, datasheet: bool) -> Shown:
        """Return the texts of the quantity over ``10**exponent``."""
        quantity = self.quantity(datasheet=datasheet)
        value, interval = numbers.compact(quantity, exponent=exponent)
        return Shown(value=value, interval=interval, note=self.note, bounded=quantity.value is None)


@dataclass(frozen=True, kw_only=True)
class Column:
    """A row in one convention; values are multiples of ``10**exponent`` units."""

    unit: str
    exponent: int
    texts: tuple[Shown | None, ...]


@dataclass(frozen=True, kw_only=True)
class Row:
    """A quantity on every axis of a view; None if an axis does not have it.

    `key`, `symbol` and `name` are, for example, ``GM1``, ``GM`` and ``Gauss-Markov``; ``GM1 T`` and
    ``minimum`` have no symbol. `remark` explains the quantity. Rows are sorted by `place`.
    """

    key: str
    symbol: str
    name: str
    cells: tuple[Cell | None, ...]
    remark: str = ""
    place: float = len(TERMS)

    def column(self, *, datasheet: bool) -> Column:
        """Return the texts, which share one power of ten."""
        cells = [cell for cell in self.cells if cell]
        exponent = numbers.engineering_exponent(cell.quantity(datasheet=datasheet) for cell in cells)
        return Column(
            unit=cells[0].quantity(datasheet=datasheet).unit,
            exponent=exponent,
            texts=tuple(cell.shown(exponent, datasheet=datasheet) if cell else None for cell in self.cells),
        )

    @property
    def columns(self) -> tuple[Column, Column]:
        return self.column(datasheet=True), self.column(datasheet=False)


@dataclass(frozen=True, kw_only=True)
class View:
    """The results of one sensor as rows; `names` are the columns, such as x."""

    sensor: Sensor | None
    names: tuple[str, ...]
    fits: tuple[NoiseFit, ...]
    units: SheetUnits
    rows: tuple[Row, ...]


def views(report: Report) -> tuple[View, ...]:
    """Return the view of each sensor that has axes, the gyroscope first."""
    return tuple(view({axis.axis: axis for axis in axes}) for axes in report.by_sensor.values())


def view(subjects: Mapping[str, Subject]) -> View:
    """Return the view of at least one axis or fit of a sensor, by the names of the columns."""
    values = tuple(subjects.values())
    fits = _fits(values)
    units = sheet_units(fits)
    rows = [row for make in ROWS for row in make(values, units)]
    rows.sort(key=lambda row: row.place)
    return View(sensor=fits[0].sensor, names=tuple(subjects), fits=fits, units=units, rows=tuple(rows))


def ordered_keys(seen: Sequence[View]) -> list[str]:
    """Return the keys of all rows, in order."""
    places = {row.key: row.place for each in seen for row in each.rows}
    return sorted(places, key=lambda key: (places[key], key))


def term_name(symbol: str, sensor: Sensor | None) -> str:
    """Return the name of a term in results; its meaning if the sensor is unknown."""
    return _FLICKER_NAME if symbol == "B" else numbers.term_name(symbol, sensor)


def _fits(subjects: Sequence[Subject]) -> tuple[NoiseFit, ...]:
    return tuple(subject.fit if isinstance(subject, AxisReport) else subject for subject in subjects)


def _terms(subjects: Sequence[Subject], units: SheetUnits) -> Iterator[Row]:
    """Yield the rows of the terms, each Gauss-Markov term with its correlation time."""
    fits = _fits(subjects)
    sensor = fits[0].sensor
    estimates = [{estimate.key: estimate for estimate in fit.estimates} for fit in fits]
    symbols = {key: estimate.symbol for of_fit in estimates for key, estimate in of_fit.items()}
    for key in sorted(symbols):
        symbol = symbols[key]
        place = list(TERMS).index(symbol)
        row = [of_fit.get(key) for of_fit in estimates]
        yield Row(
            key=key,
            symbol=symbol,
            name=term_name(symbol, sensor),
            cells=tuple(_coefficient(estimate, sensor, units) if estimate else None for estimate in row),
            remark=_FLICKER_REMARK if symbol == "B" else "",
            place=place,
        )
        times = tuple(_time(estimate) if estimate else None for estimate in row)
        if any(times):
            yield Row(key=f"{key} T", symbol="", name="correlation time", cells=times, place=place)


def _coefficient(estimate: Estimate, sensor: Sensor | None, units: SheetUnits) -> Cell:
    note = numbers.alternatives(estimate)
    return Cell(sheet=units.estimate(estimate, sensor), si=numbers.si(estimate, sensor), note=note)


def _time(estimate: Estimate) -> Cell | None:
    if estimate.correlation_time is None:
        return None
    time = numbers.correlation_time(estimate.correlation_time)
    return Cell(sheet=time, si=time)


def _minimum(subjects: Sequence[Subject], units: SheetUnits) -> Iterator[Row]:
    cells = []
    for fit in _fits(subjects):
        note = f"at {numbers.seconds(fit.curve.minimum[1])}"
        cells.append(Cell(sheet=units.minimum(fit), si=numbers.minimum(fit), note=note))
    yield Row(
        key="minimum",
        symbol="",
        name="of the curve",
        cells=tuple(cells),
        remark=_MINIMUM_REMARK,
        # Just above the row of B, so that nobody mistakes one for the other.
        place=list(TERMS).index("B") - 0.5,
    )


#: The functions that make the rows.
ROWS: list[Callable[[Sequence[Subject], SheetUnits], Iterator[Row]]] = [_terms, _minimum]
