"""``fleet.html``: what the units of each sensor model are like, on one page that opens without a network.

Tables and pictures are there without any script.

The tables of a fleet's page: the number for the config, units × terms, slopes, logs of one unit.

The lists of a fleet's page: logs that do not count, logs without a unit, what the words mean.

Pictures of a fleet's units as SVG in the page itself: there without any script, in the page's colours.
"""

import math
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from imucal.fleet.population import UnitValue
from imucal.fleet.trend import NEAREST, Trend
from imucal.fleet.values import LogValue
from imucal.fleet_report.summary import Fleet, FleetLog, FleetTerm, LooseLog, SensorModel
from imucal.fleet_report.verdict import (
    alone,
    between,
    bound_name,
    deviation,
    loose_text,
    median_text,
    p_text,
    per,
    percent,
    price_text,
    sheet_unit,
    slope_text,
    verdict,
    with_limits,
)
from imucal.noise.terms import TERMS
from imucal.recording import Axis, Sensor
from imucal.report import numbers
from imucal.report.figure import tick_label, tick_places
from imucal.report.html_page import Page, Section, page_file, render_frame
from imucal.report.markup import Markup, both_units, element, join, labelled, row, table
from imucal.report.numbers import Quantity
from imucal.units import pretty

_AXES: tuple[Axis, ...] = ("x", "y", "z")
#: Most rows of the table of units: the strangest ones.
_MOST = 200


def by_term(model: SensorModel) -> dict[tuple[str, str], list[FleetTerm]]:
    """Return the axes of each term, by sensor and term."""
    groups: dict[tuple[str, str], list[FleetTerm]] = {}
    for term in model.terms:
        groups.setdefault((str(term.sensor), term.term), []).append(term)
    return groups


def config_table(model: SensorModel) -> Markup:
    """Return the number for the config of each term and axis that the model has, with median and spreads."""
    body = []
    shown = [axis for axis in _AXES if any(term.axis == axis for term in model.terms)]
    for (sensor, key), terms in by_term(model).items():
        axes = {term.axis: term for term in terms}
        name = TERMS[terms[0].symbol].name(terms[0].sensor)
        head = element("th", element("b", key), f" {name}", element("small", sensor), scope="row")
        body.append(row(head, *(element("td", _config_cell(axes.get(axis))) for axis in shown)))
    bound = bound_name(model.terms[0]) if model.terms else "95/95"
    head = row(element("td"), *(element("th", axis, scope="col") for axis in shown))
    return table(
        f"{model.title}: {bound} tolerance bound, median unit, spreads", [head], body, class_="summary config"
    )


def _config_cell(term: FleetTerm | None) -> Markup:
    if term is None:
        return Markup("–")
    found = term.population
    bold = element("b", alone(term, found.tolerance)) if found.tolerance else element("span", "no bound")
    spreads = []
    if found.spread:
        spreads.append(f"units ±{percent(found.spread.value)}")
    if found.within:
        spreads.append(f"logs of a unit ±{percent(found.within.value)}")
    return join(
        [
            bold,
            element("small", "median ", median_text(term)),
            element("small", ", ".join(spreads) or "spread between units not known"),
        ]
    )


def detail_table(model: SensorModel) -> Markup:
    """Return spreads with intervals, the band of the next unit and the price of the bound, term by term."""
    titles = ("units", "logs", "median", "between units", "within a unit", "next unit", "bound", "price")
    body = []
    for term in model.terms:
        found = term.population
        spreads = [
            f"{percent(s.value)} [{percent(s.low)}, {percent(s.high)}]" if s else "–"
            for s in (found.spread, found.within)
        ]
        cells = (
            str(len(found.units)),
            str(found.logs),
            median_text(term),
            *spreads,
            _band(term),
            alone(term, found.tolerance) if found.tolerance else "–",
            price_text(term) or "–",
        )
        head = element("th", f"{term.name} {term.term}", scope="row")
        body.append(row(head, *labelled(titles, cells)))
    heads = [row(*(element("th", title, scope="col") for title in ("", *titles)))]
    return table(f"{model.title}: all numbers", heads, body, class_="wide cards")


def _band(term: FleetTerm) -> str | Markup:
    if term.population.prediction is None:
        return "–"
    low, high = term.population.prediction
    if term.population.bounded:
        return join(["below ", alone(term, high)])
    return between(term, low, high)


def heat_table(model: SensorModel) -> Markup:
    """Return units × terms: each unit's difference from the median in %, coloured by the spread of units."""
    columns = list(model.terms)
    every = [{unit.unit: unit for unit in term.population.units} for term in columns]
    names = sorted(model.units, key=lambda name: -_strangeness(name, columns, every))
    left_out = len(names) - _MOST
    shown = sorted(names[:_MOST])
    body = []
    for name in shown:
        cells = [
            _heat_cell(term, of_term.get(name), first=i == 0 or columns[i - 1].symbol != term.symbol)
            for i, (term, of_term) in enumerate(zip(columns, every, strict=True))
        ]
        body.append(row(element("th", name, scope="row", title=name), *cells))
    groups = [
        element("th", f"{sensor} {key}", colspan=str(len(terms)), scope="colgroup", class_="first")
        for (sensor, key), terms in by_term(model).items()
    ]
    axes = [
        element("th", term.axis, scope="col", class_="first" if term is terms[0] else None)
        for terms in by_term(model).values()
        for term in terms
    ]
    caption = f"{model.title}: each unit against the median, in %; < where it only has an upper bound"
    if left_out > 0:
        caption += f"; the {_MOST} strangest of {len(names)} units"
    head = [row(element("td"), *groups), row(element("th", "unit", scope="col"), *axes)]
    return table(caption, head, body, class_="heat")


def _strangeness(name: str, terms: Sequence[FleetTerm], every: Sequence[dict[str, UnitValue]]) -> float:
    """Return what sorts units: odd ones first, then the farthest from a median."""
    own = [(term, of_term[name]) for term, of_term in zip(terms, every, strict=True) if name in of_term]
    return max((100.0 * unit.odd + abs(deviation(term, unit) or 0.0) for term, unit in own), default=0.0)


def _heat_cell(term: FleetTerm, unit: UnitValue | None, *, first: bool) -> Markup:
    classes = ["first"] * first
    if unit is None:
        return element("td", "–", class_=" ".join(classes) or None)
    if unit.value is None:
        text = "<"
    elif term.population.bounded:
        text = "seen"
    else:
        change = 100 * math.expm1(math.log(unit.value / term.population.median.value))
        text = f"{change:+.0f}".replace("-", "\N{MINUS SIGN}") if abs(change) >= 0.5 else "0"
        level = min(int(abs(deviation(term, unit) or 0.0)), 3)
        classes += [f"{'u' if change > 0 else 'd'}{level}"] * (level > 0)
    if unit.odd:
        text, classes = f"{text}!", [*classes, "is-odd"]
    return element("td", text, class_=" ".join(classes) or None)


def slope_table(models: Iterable[SensorModel]) -> Markup:
    """Return what temperature and time do to each term; where labels do not tell, why not."""
    rows: list[Markup] = []
    refused: dict[str, list[str]] = {}
    several = list(models)
    titles = ("temperature", "drift", "units", "units that move otherwise")
    trends = [term.trend for model in several for term in model.terms if term.trend]
    units = {label: per(label, trends) for label in NEAREST}
    for model in several:
        for term in model.terms:
            where = (
                f"{model.title} {term.name} {term.term}" if len(several) > 1 else f"{term.name} {term.term}"
            )
            if term.trend is None:
                refused.setdefault(term.no_trend, []).append(where)
                continue
            cells = (
                *(_mean_slope(term.trend, label, *units[label]) for label in NEAREST),
                str(term.trend.units),
                "; ".join(_moving(term.trend, units)) or "none",
            )
            rows.append(row(element("th", where, scope="row"), *labelled(titles, cells)))
    notes = [
        element("p", f"{', '.join(places) if len(places) < 7 else f'Each of {len(places)} terms'}: {why}.")
        for why, places in refused.items()
    ]
    if not rows:
        return join(notes)
    head = [row(*(element("th", title, scope="col") for title in ("", *titles)))]
    caption = "Change of each coefficient with its 95 % interval; bold where it is more than chance"
    return join([table(caption, head, rows, class_="wide cards"), *notes])


def _mean_slope(trend: Trend, label: str, unit: str, part: float) -> str | Markup:
    """Return the fleet's slope, bold where it is not chance."""
    mean = next((mean for mean in trend.means if mean.label == label), None)
    if mean is None:
        return "–"
    text = slope_text(mean.slope, unit, part)
    return element("b", text) if mean.odd else text


def _moving(trend: Trend, units: Mapping[str, tuple[str, float]]) -> Iterator[str]:
    for slope in trend.slopes:
        if slope.odd:
            yield f"{slope.unit} {slope_text(slope.slope, *units[slope.label])}"


def unit_logs_table(model: SensorModel) -> Markup:
    """Return how many units have logs that differ, and which."""
    titles = ("units with several logs", "logs differ in", "which")
    body = []
    for term in model.terms:
        differing = [unit for unit in term.unit_logs if unit.differs]
        if not differing:
            continue
        said = join(
            element(
                "li",
                f"{unit.unit} by {percent(unit.spread)} ({p_text(unit.p_value)}): ",
                with_limits(term, unit.value, unit.low, unit.high),
            )
            for unit in differing
        )
        cells = (str(len(term.unit_logs)), str(len(differing)), element("ul", said))
        body.append(row(element("th", f"{term.name} {term.term}", scope="row"), *labelled(titles, cells)))
    if not body:
        units = {unit.unit for term in model.terms for unit in term.unit_logs}
        text = (
            f"{model.title}: the logs of each of {len(units)} units agree with one coefficient a term; all "
            "tests are judged together."
        )
        return element("p", text)
    head = [row(*(element("th", title, scope="col") for title in ("", *titles)))]
    caption = f"{model.title}: have the logs of a unit one coefficient?"
    return table(caption, head, body, class_="wide cards")


#: Most paths of one reason that stand in sight; most logs without a label that are listed.
_FEW, _FLEET_LISTS_MOST = 5, 500

_WORDS = {
    "median unit": "Half of the units of this sensor model are below it, half above; with its 95 % interval.",
    "between units": (
        "Standard deviation of the units' coefficients about the median, relative. It is what is left when "
        "the error of each log is taken out."
    ),
    "within a unit": (
        "Standard deviation between the logs of one unit beyond the error of each: day, temperature, place."
    ),
    "next unit": "A new unit of the same model lies within this band with a probability of 95 %.",
    "tolerance bound": (
        "The number for the config of every unit. 95/95: with 95 % confidence, 95 of 100 units of this model "
        "are below it. Odd units count in it, as in all numbers."
    ),
    "price": (
        "How far the tolerance bound lies above the level that those 95 of 100 units are below: with as many "
        "units as were tested, and with more. Few units make the bound large; testing more would save that."
    ),
    "odd": (
        "A unit that is not like the others, judged by what the others alone are like. In a fleet without "
        "odd units, each term of each axis has a false alarm with a probability of at most 5 %; the first "
        "line of this page names apart those that may be one of so many terms' false alarms."
    ),
    "upper bound": (
        "The logs of the unit do not show the term; it is below this. It still counts in median and spread."
    ),
}


def failures_section(fleet: Fleet) -> Markup:
    """Return the logs that do not count, grouped by reason, with links to their own reports."""
    blocks = []
    for (kind, reason), logs in fleet.failures.items():
        items = [element("li", *_path(log)) for log in logs]
        listed = element("ul", *items[:_FEW], class_="paths")
        if more := items[_FEW:]:
            rest = element("ul", *more, class_="paths")
            listed = join([listed, element("details", element("summary", f"{len(more)} more"), rest)])
        level = "warning" if kind == "not-noise" else "error"
        title = join([element("b", f"{kind}, {len(logs)} log{'s' * (len(logs) > 1)}: "), reason])
        blocks.append(element("ul", element("li", title, listed), class_=f"findings {level}"))
    return join(blocks) if blocks else element("p", "Every log that was done counts.")


def _path(log: FleetLog) -> list[str | Markup]:
    parts: list[str | Markup] = [element("code", log.path)]
    if log.report:
        parts += [" – ", element("a", "its report", href=f"{log.report}/report.html")]
    return parts


def loose_section(fleet: Fleet) -> Markup:
    """Return the logs without a unit one by one, and the labels that would make a population of them."""
    text = (
        f"{loose_text(fleet)}: which of them are of one unit is not known, so that "
        "nothing is said of the sensor model. Say where the label stands in the paths, or give a manifest "
        "with the columns path and unit:"
    )
    command = f"imucal fleet run -o {shlex.quote(str(fleet.folder))} --labels {shlex.quote(fleet.labels)}"
    shown = fleet.loose[:_FLEET_LISTS_MOST]
    columns = list(dict.fromkeys(where for one in shown for where in one.values))
    titles = [f"{axis} {term}" for axis, term in columns]
    body = [
        row(
            element("th", _name(one), scope="row"),
            *labelled(titles, [_loose_cell(where, one.values.get(where)) for where in columns]),
        )
        for one in shown
    ]
    head = [row(*(element("th", title, scope="col") for title in ("log", *titles)))]
    listed = table("Each log by itself, with its 95 % interval", head, body, class_="wide cards tight")
    return join([element("p", text), element("pre", element("code", command)), listed])


def _name(one: LooseLog) -> Markup:
    if not one.log.report:
        return element("code", one.log.path)
    return element("a", one.log.path, href=f"{one.log.report}/report.html")


def _loose_cell(where: tuple[str, str], value: LogValue | None) -> Markup:
    if value is None:
        return Markup("–")
    axis, term = where
    sensor = next(s for s in Sensor if axis.startswith(s.short))
    law = TERMS[term.rstrip("0123456789")]
    plain = Quantity(value=value.value, low=value.low, high=value.high, unit=law.unit(sensor))
    unit = law.datasheet_unit(sensor)
    return both_units(
        numbers.with_interval(plain.scaled(unit.factor, unit.name)), numbers.with_interval(plain)
    )


def words_section() -> Markup:
    """Return what the words of the page mean."""
    pairs = [(element("dt", element("b", word)), element("dd", text)) for word, text in _WORDS.items()]
    return element("dl", *map(join, pairs))


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


_KEY = (
    ('<circle class="mark" cx="13" cy="7" r="3.2"/><line class="whisker" x1="2" y1="7" x2="24" y2="7"/>',
     "a unit with its 95 % interval"),
    ('<polygon class="mark open" points="8,7 16,3 16,11"/>', "a unit that is only bounded"),
    ('<polygon class="mark odd" points="8,7 13,2 18,7 13,12"/>', "an odd unit"),
    ('<line class="median" x1="13" y1="0" x2="13" y2="14"/>', "the median unit"),
    ('<rect class="band" x="2" y="1" width="22" height="12"/>', "where the next unit lies, 95 %"),
    ('<line class="bound" x1="13" y1="0" x2="13" y2="14"/>', "the tolerance bound"),
)  # fmt: skip


def render_fleet_page(fleet: Fleet) -> str:
    """Return the page; the same fleet always gives the same text."""
    name = fleet.folder.resolve().name
    grade, sentence = verdict(fleet)
    return render_frame(
        Page(
            title=f"{name} – fleet of IMUs",
            heading="Fleet" if name == "fleet" else f"Fleet {name}",
            grade=grade,
            sentence=sentence,
            lead=_lead(fleet),
            sections=_sections(fleet),
            version=fleet.version,
            style=page_file("fleet.css", "imucal.fleet_report"),
        )
    )


def _lead(fleet: Fleet) -> str:
    parts = [
        f"{f'{model.name}: ' * bool(model.name)}{len(model.units)} unit{'s' * (len(model.units) != 1)}, "
        f"{sum(not log.left_out for log in model.logs)} logs that count, {model.rate_hz:.6g} Hz"
        for model in fleet.models
    ]
    waiting = fleet.asked - len(fleet.logs)
    if waiting > 0:
        parts.append(f"{waiting} of {fleet.asked} logs are not done yet")
    return " · ".join(parts) or f"{len(fleet.logs)} logs"


def _sections(fleet: Fleet) -> list[Section]:
    models = fleet.models
    found: list[Section] = []
    if models:
        note = element("p", "Bold: the number for the config of every unit. ", _few_note(fleet))
        found.append(("config", "The number for the config", join([note, *map(config_table, models)])))
    for i, model in enumerate(models):
        found.append((f"units-{i}", f"Units of {model.name}" if model.name else "Units", _units(model)))
    if len(models) > 1:
        found.append(("models", "Models side by side", _strips(models)))
    if models:
        found.append(("heat", "Units and terms", join([_heat_note(), *map(heat_table, models)])))
        found.append(("trend", "Temperature and time", slope_table(models)))
        tested = [model for model in models if any(term.unit_logs for term in model.terms)]
        if tested:
            found.append(("logs", "Several logs of one unit", join(map(unit_logs_table, tested))))
        found.append(("numbers", "All numbers", join(map(detail_table, models))))
    if fleet.loose:
        found.append(("loose", "Logs without a unit", loose_section(fleet)))
    found.append(("failed", "Logs that do not count", failures_section(fleet)))
    if fleet.findings:
        items = [element("li", finding.text) for finding in fleet.findings]
        found.append(("findings", "Findings", element("ul", *items, class_="findings warning")))
    found.append(("words", "What the words mean", words_section()))
    return found


def _few_note(fleet: Fleet) -> str:
    few = [model.title for model in fleet.models if len(model.units) < 3]
    if not few:
        return ""
    return (
        f"{', '.join(few)}: fewer than 3 units tell no spread between units, and so no bound; 10 are worth "
        "testing."
    )


def _units(model: SensorModel) -> Markup:
    key = [
        element("li", Markup(f'<svg class="units-plot" aria-hidden="true">{svg}</svg>'), f" {text}")
        for svg, text in _KEY
    ]
    parts = [element("ul", *key, class_="keyline")]
    groups = by_term(model)
    if all(len(terms) == 1 for terms in groups.values()):
        # One axis: its terms side by side.
        return join([*parts, element("div", *map(_figure, model.terms), class_="panels")])
    for (sensor, name), terms in groups.items():
        title = f"{name} {TERMS[terms[0].symbol].name(terms[0].sensor)}, {sensor}"
        parts += [element("h3", title), element("div", *map(_figure, terms), class_="panels")]
    return join(parts)


def _figure(term: FleetTerm) -> Markup:
    found = term.population
    label = f"{term.name} {term.term}: {len(found.units)} units, sorted, with 95 % intervals"
    text: list[str | Markup] = [element("b", f"{term.name} {term.term}"), ": median ", median_text(term)]
    if found.spread:
        text.append(f", units ±{percent(found.spread.value)}")
    text.append(".")
    if term.odd:
        text.append(f" Odd: {', '.join(f'{u.unit} ({p_text(u.p_odd or 0.0)})' for u in term.odd)}.")
    if term.price:
        text.append(f" Price of {bound_name(term)}: {price_text(term)}.")
    text += [f" {finding.text}" for finding in found.findings]
    return element("figure", unit_panel(term, label), element("figcaption", *text))


def _strips(models: tuple[SensorModel, ...]) -> Markup:
    keys = dict.fromkeys((term.name, term.term) for model in models for term in model.terms)
    panels = []
    for name, key in keys:
        own = [(m, t) for m in models for t in m.terms if (t.name, t.term) == (name, key)]
        label = f"{name} {key}: a row a model, a dot a unit"
        panels.append(
            element("figure", strip_panel(own, label), element("figcaption", element("b", f"{name} {key}")))
        )
    note = "A dot is a unit, the line the median unit; the next unit lies in the band with 95 % probability."
    return join([element("p", note), element("div", *panels, class_="panels")])


def _heat_note() -> Markup:
    return element(
        "p",
        "Colour: how many standard deviations of the next unit a unit lies above (warm) or below (cold) the "
        "median, one, two or three. A frame and ! mark an odd unit; seen: the unit shows a term that the "
        "logs of all units together do not.",
    )
