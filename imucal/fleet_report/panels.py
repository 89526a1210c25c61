"""Pictures of a fleet's units as SVG in the page itself: there without any script, in the page's colours."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from imucal.fleet.population import UnitValue
from imucal.fleet_report.shown import bound_name, sheet_unit
from imucal.fleet_report.summary import FleetTerm, SensorModel
from imucal.report.log_ticks import tick_label, tick_places
from imucal.report.markup import Markup, element, join
from imucal.units import pretty

#: Size of a picture and of its margins, in its own units; height of a row, most and least.
_WIDTH, _LEFT, _RIGHT, _TOP, _BOTTOM = 420, 88, 16, 22, 40
_ROW, _THIN, _TALLEST = 15.0, 1.5, 560.0
#: Rows lower than this have no name, but for odd units.
_NAMED = 10.0
#: A whisker or bound reaches no farther below the lowest value than this factor.
_BELOW = 3.0
#: Most letters of a unit's name; width of a letter.
_LETTERS, _LETTER = 11, 7.5


def sorted_units(term: FleetTerm) -> list[UnitValue]:
    """Return the units from the largest to the smallest; those that are only bounded by their bounds."""
    return sorted(term.population.units, key=lambda unit: -(unit.value or unit.high))


def span(term: FleetTerm) -> tuple[float, float]:
    """Return the limits of a term's scale: all values, the band and the bound, and most of the whiskers."""
    found = term.population
    values = [unit.value or unit.high for unit in found.units]
    values += [found.median.value, *(found.prediction or ()), *([found.tolerance] if found.tolerance else ())]
    low, high = min(value for value in values if value > 0), max(values)
    told = [unit for unit in found.units if unit.value]
    low = max(min([low, *(unit.low for unit in told)]), low / _BELOW)
    high = min(max([high, *(unit.high for unit in told)]), high * _BELOW)
    return low / 1.06, high * 1.06


def unit_panel(term: FleetTerm, label: str) -> Markup:
    """Return one term's units: sorted, with intervals, band of the next unit, median and bound."""
    units = sorted_units(term)
    row = min(_ROW, max(_THIN, _TALLEST / len(units)))
    height = len(units) * row
    x = _Scale(*span(term))
    found = term.population
    parts = [*_frame(term, x, height)]
    if found.prediction:
        low, high = map(x, found.prediction)
        parts.append(_rect(low, _TOP, high - low, height, "band"))
    if not found.bounded:
        parts.append(_line(x(found.median.value), _TOP, x(found.median.value), _TOP + height, "median"))
    if found.tolerance:
        at = x(found.tolerance)
        parts += [
            _line(at, _TOP - 4, at, _TOP + height, "bound"),
            _text(at, _TOP - 8, bound_name(term), text_anchor=_anchor(at), class_="bound-name"),
        ]
    parts += [_unit(unit, x, _TOP + (i + 0.5) * row, named=row >= _NAMED) for i, unit in enumerate(units)]
    return _picture(parts, _TOP + height + _BOTTOM, label)


def strip_panel(models: Sequence[tuple[SensorModel, FleetTerm]], label: str) -> Markup:
    """Return one term of several models: a row each, a dot a unit, the median and the next unit's band."""
    spans = [span(term) for _, term in models]
    x = _Scale(min(low for low, _ in spans), max(high for _, high in spans))
    row = 46.0
    height = len(models) * row
    parts = [*_frame(models[0][1], x, height)]
    for i, (model, term) in enumerate(models):
        top, found = _TOP + i * row, term.population
        parts.append(
            _text(_LEFT - 8, top + row / 2 + 4, _short(model.title), text_anchor="end", class_="name")
        )
        if found.prediction:
            low, high = map(x, found.prediction)
            parts.append(_rect(low, top + 5, high - low, row - 10, "band"))
        if not found.bounded:
            at = x(found.median.value)
            parts.append(_line(at, top + 4, at, top + row - 4, "median"))
        for place, unit in enumerate(found.units):
            # Three lanes keep units of one value apart.
            y = top + row / 2 + 9 * (place % 3 - 1)
            parts.append(_mark(unit, x(unit.value or unit.high), y))
    return _picture(parts, _TOP + height + _BOTTOM, label)


@dataclass(frozen=True, slots=True)
class _Scale:
    """Place of a value across the picture: logarithmic, cut at its ends."""

    low: float
    high: float

    def __call__(self, value: float) -> float:
        part = math.log(max(value, self.low) / self.low) / math.log(self.high / self.low)
        return round(_LEFT + (_WIDTH - _LEFT - _RIGHT) * min(part, 1.0), 1)


def _frame(term: FleetTerm, x: _Scale, height: float) -> list[Markup]:
    """Return the grid, and ticks in data-sheet units and in SI, of which the page shows one."""
    unit = sheet_unit(term)
    parts = []
    for class_, factor, name in (("sheet", unit.factor, unit.name), ("si", 1.0, term.unit)):
        inside: list[Markup] = []
        places, labels, power = labelled_ticks(x.low * factor, x.high * factor)
        free = 0.0
        for place, label in zip(places, labels, strict=True):
            at, half = x(place / factor), _LETTER * len(label) / 2
            inside.append(_line(at, _TOP, at, _TOP + height, "grid"))
            if at - half >= free and at + half <= _WIDTH:
                inside.append(_text(at, _TOP + height + 15, label, text_anchor="middle"))
                free = at + half + _LETTER
        middle = (_LEFT + _WIDTH - _RIGHT) / 2
        title = f"{term.term} in {power}{pretty(name)}"
        inside.append(_text(middle, _TOP + height + 33, title, text_anchor="middle"))
        parts.append(element("g", *inside, class_=class_))
    return parts


def labelled_ticks(low: float, high: float) -> tuple[list[float], list[str], str]:
    """Return places, their labels, and the power of ten that goes before the unit, such as ``10⁻³ ``."""
    places = round_ticks(low, high)
    power = math.floor(math.log10(min(places)) + 1e-9)
    if -2 <= power <= 3:
        # Plain numbers: 8000, 10000, and not 8000, 10⁴.
        plain = max(places) < 1e6
        return places, [f"{place:.6g}" if plain else tick_label(place) for place in places], ""
    labels = [f"{place / 10.0**power:.4g}" for place in places]
    return places, labels, f"{tick_label(10.0**power)} "


def round_ticks(low: float, high: float) -> list[float]:
    """Return three to six round values between two limits; fewer where the limits are close."""
    places = tick_places(low, high)[0]
    if len(places) >= 3 and high / low >= 3:
        return places[:: math.ceil(len(places) / 6)]
    step = 10.0 ** math.floor(math.log10(high - low))
    for part in (0.1, 0.2, 0.5, 1.0, 2.0):
        size = part * step
        first, last = math.ceil(low / size), math.floor(high / size)
        if last - first + 1 <= 5:
            return [float(f"{i * size:.6g}") for i in range(first, last + 1)]
    return places


def _unit(unit: UnitValue, x: _Scale, y: float, *, named: bool) -> Markup:
    parts = []
    if named or unit.odd:
        name = _text(
            _LEFT - 8, y + 4, _short(unit.unit), text_anchor="end", class_="odd" if unit.odd else "name"
        )
        parts.append(name)
    if unit.value is None:
        parts.append(_line(x(0.0), y, x(unit.high), y, "whisker far"))
    else:
        parts.append(_line(x(unit.low), y, x(unit.high), y, "whisker"))
    parts.append(_mark(unit, x(unit.value or unit.high), y))
    return join(parts)


def _mark(unit: UnitValue, at: float, y: float) -> Markup:
    """Return a dot; a diamond for an odd unit, an open triangle that points down the scale for a bound."""
    title = element(
        "title", f"{unit.unit}{' (odd)' if unit.odd else ''}{' (upper bound)' * (unit.value is None)}"
    )
    if unit.value is None:
        points = f"{at - 7:g},{y:g} {at:g},{y - 4:g} {at:g},{y + 4:g}"
        return element("polygon", title, points=points, class_="mark open odd" if unit.odd else "mark open")
    if unit.odd:
        points = f"{at - 5:g},{y:g} {at:g},{y - 5:g} {at + 5:g},{y:g} {at:g},{y + 5:g}"
        return element("polygon", title, points=points, class_="mark odd")
    return element("circle", title, cx=f"{at:g}", cy=f"{y:g}", r="3.2", class_="mark")


def _short(name: str) -> str:
    """Return a name that fits the margin: its end tells units apart."""
    return name if len(name) <= _LETTERS else f"…{name[1 - _LETTERS :]}"


def _anchor(at: float) -> str:
    return "end" if at > _WIDTH - 40 else "middle"


def _picture(parts: Sequence[Markup], height: float, label: str) -> Markup:
    return element(
        "svg",
        *parts,
        class_="units-plot",
        viewBox=f"0 0 {_WIDTH} {height:g}",
        role="img",
        aria_label=label,
    )


def _line(x1: float, y1: float, x2: float, y2: float, class_: str) -> Markup:
    return element("line", class_=class_, x1=f"{x1:g}", y1=f"{y1:g}", x2=f"{x2:g}", y2=f"{y2:g}")


def _rect(x: float, y: float, width: float, height: float, class_: str) -> Markup:
    return element(
        "rect", class_=class_, x=f"{x:g}", y=f"{y:g}", width=f"{max(width, 1):g}", height=f"{height:g}"
    )


def _text(x: float, y: float, text: str, **attributes: str) -> Markup:
    return element("text", text, x=f"{x:g}", y=f"{y:g}", **attributes)
