"""One view of results for all outputs: rows with a cell for each axis, in data-sheet units and in SI."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from imucal.fitting.noise_fit import Estimate, NoiseFit
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.numbers import Quantity, SheetUnits, sheet_units
from imucal.report.result import AxisReport, Report

__all__ = ["ROWS", "Cell", "Column", "Row", "Shown", "Subject", "View", "ordered_keys", "view", "views"]

Subject: TypeAlias = AxisReport | NoiseFit


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A quantity of one axis; `note` names another term that fits as well, or the time of the minimum."""

    sheet: Quantity
    si: Quantity
    note: str = ""


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
class Column:
    """A row in one convention; values are multiples of ``10**exponent`` units."""

    unit: str
    exponent: int
    texts: tuple[Shown | None, ...]


@dataclass(frozen=True, kw_only=True)
class Row:
    """A quantity on every axis of a view; None if an axis does not have it.

    `key`, `symbol` and `name` are, for example, ``GM1``, ``GM`` and ``Gauss-Markov``; ``GM1 T`` and
    ``minimum`` have no symbol. Rows are sorted by `place`.
    """

    key: str
    symbol: str
    name: str
    cells: tuple[Cell | None, ...]
    place: float = len(TERMS)

    def column(self, *, datasheet: bool) -> Column:
        """Return the texts, which share one power of ten."""
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
        return self.column(datasheet=True), self.column(datasheet=False)


def _shown(quantity: Quantity, note: str, exponent: int) -> Shown:
    value, interval = numbers.compact(quantity, exponent=exponent)
    return Shown(value=value, interval=interval, note=note, bounded=quantity.value is None)


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
    found = tuple(subjects.values())
    fits = tuple(map(_fit_of, found))
    units = sheet_units(fits)
    rows = [row for make in ROWS for row in make(found, units)]
    return View(
        sensor=fits[0].sensor,
        names=tuple(subjects),
        fits=fits,
        units=units,
        rows=tuple(sorted(rows, key=lambda row: row.place)),
    )


def ordered_keys(seen: Sequence[View]) -> list[str]:
    """Return the keys of all rows, in order."""
    places = {row.key: row.place for each in seen for row in each.rows}
    return sorted(places, key=lambda key: (places[key], key))


def _fit_of(subject: Subject) -> NoiseFit:
    return subject.fit if isinstance(subject, AxisReport) else subject


def _terms(subjects: Sequence[Subject], units: SheetUnits) -> Iterator[Row]:
    """Yield the rows of the terms, each Gauss-Markov term with its correlation time."""
    fits = tuple(map(_fit_of, subjects))
    sensor = fits[0].sensor
    symbols = {estimate.key: estimate.symbol for fit in fits for estimate in fit.estimates}
    for key in sorted(symbols):
        place = list(TERMS).index(symbols[key])
        found = [next((e for e in fit.estimates if e.key == key), None) for fit in fits]
        cells = (
            Cell(sheet=units.estimate(e, sensor), si=numbers.si(e, sensor), note=numbers.alternatives(e))
            if e
            else None
            for e in found
        )
        name = numbers.term_name(symbols[key], sensor)
        yield Row(key=key, symbol=symbols[key], name=name, cells=tuple(cells), place=place)
        times = tuple(_time(estimate) for estimate in found)
        if any(times):
            yield Row(key=f"{key} T", symbol="", name="correlation time", cells=times, place=place)


def _minimum(subjects: Sequence[Subject], units: SheetUnits) -> Iterator[Row]:
    cells = tuple(
        Cell(
            sheet=units.minimum(fit),
            si=numbers.minimum(fit),
            note=f"at {numbers.seconds(fit.curve.minimum[1])}",
        )
        for fit in map(_fit_of, subjects)
    )
    yield Row(key="minimum", symbol="", name="of the curve", cells=cells, place=math.inf)


def _time(estimate: Estimate | None) -> Cell | None:
    if estimate is None or estimate.correlation_time is None:
        return None
    time = numbers.correlation_time(estimate.correlation_time)
    return Cell(sheet=time, si=time)


ROWS: list[Callable[[Sequence[Subject], SheetUnits], Iterator[Row]]] = [_terms, _minimum]
