"""``fleet.html``: what the units of each sensor model are like, on one page that opens without a network.

Tables and pictures are there without any script: the templates lay them out, `verdict` words the numbers.
"""

import math
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence

from imucal.fleet.population import UnitValue
from imucal.fleet.trend import NEAREST, Trend
from imucal.fleet.values import LogValue
from imucal.fleet_report.answers import symbol_of
from imucal.fleet_report.summary import Fleet, FleetTerm, LooseLog, SensorModel
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
from imucal.printable import printable
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.figure import tick_label, tick_places
from imucal.report.markup import Markup, both_units, render
from imucal.report.numbers import Quantity
from imucal.units import pretty

#: Most rows of the table of units, the strangest ones; most logs without a label that are listed.
_MOST_UNITS, _MOST_LOOSE = 200, 500


def render_fleet_page(fleet: Fleet) -> str:
    """Return the page; the same fleet always gives the same text."""
    name = fleet.folder.resolve().name
    grade, sentence = verdict(fleet)
    return _filled(
        "fleet.html",
        title=f"{name} – fleet of IMUs",
        heading="Fleet" if name == "fleet" else f"Fleet {name}",
        grade=grade,
        sentence=sentence,
        lead=_lead(fleet),
        sections=list(_sections(fleet)),
        version=fleet.version,
    )


def _filled(template: str, **values: object) -> Markup:
    return render(template, package="imucal.fleet_report", **_TEXTS, **values)


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


def _sections(fleet: Fleet) -> Iterator[tuple[str, str, Markup]]:
    """Yield anchor, title and body of each section."""
    models = fleet.models
    if models:
        yield "config", "The number for the config", config_section(models)
    for i, model in enumerate(models):
        title = f"Units of {model.name}" if model.name else "Units"
        yield f"units-{i}", title, _filled("units.html", model=model)
    if len(models) > 1:
        yield "models", "Models side by side", _filled("models.html", strips=list(_strips(models)))
    if models:
        yield "heat", "Units and terms", _filled("heat.html", tables=list(map(_heat_table, models)))
        yield "trend", "Temperature and time", _slopes(models)
        tested = [model for model in models if any(term.unit_logs for term in model.terms)]
        if tested:
            yield "logs", "Several logs of one unit", Markup().join(map(_unit_logs, tested))
        yield "numbers", "All numbers", Markup().join(map(_all_numbers, models))
    if fleet.loose:
        yield "loose", "Logs without a unit", _loose(fleet)
    yield "failed", "Logs that do not count", _filled("failed.html", failures=fleet.failures)
    if fleet.findings:
        yield "findings", "Findings", _filled("remarks.html", findings=fleet.findings)
    yield "words", "What the words mean", _filled("words.html")


def config_section(models: Sequence[SensorModel]) -> Markup:
    """Return the number for the config of each term and axis of sensor models, with median and spreads."""
    few = [model.title for model in models if len(model.units) < 3]
    with_axes = [(model, sorted({term.axis for term in model.terms})) for model in models]
    return _filled("config.html", models=with_axes, few=few)


def by_term(model: SensorModel) -> dict[tuple[str, str], list[FleetTerm]]:
    """Return the axes of each term, by sensor and term."""
    groups: dict[tuple[str, str], list[FleetTerm]] = {}
    for term in model.terms:
        groups.setdefault((str(term.sensor), term.term), []).append(term)
    return groups


def same_terms(models: Sequence[SensorModel]) -> dict[tuple[str, str], list[tuple[SensorModel, FleetTerm]]]:
    """Return the models that have a term, with theirs, by axis and term."""
    groups: dict[tuple[str, str], list[tuple[SensorModel, FleetTerm]]] = {}
    for model in models:
        for term in model.terms:
            groups.setdefault((term.name, term.term), []).append((model, term))
    return groups


def _cards(
    titles: Sequence[str], rows: Sequence[tuple[object, object]], caption: str, notes: Sequence[str] = ()
) -> Markup:
    """Return a table of heads and cells, where there are rows, with remarks below it."""
    tables = [(caption, ("", *titles), rows)] if rows else []
    return _filled("cards.html", tables=tables, notes=notes)


def _all_numbers(model: SensorModel) -> Markup:
    """Return spreads with intervals, the band of the next unit and the price of the bound, term by term."""
    titles = ("units", "logs", "median", "between units", "within a unit", "next unit", "bound", "price")
    rows = []
    for term in model.terms:
        found = term.population
        spreads = [
            f"{percent(s.value)} [{percent(s.low)}, {percent(s.high)}]" if s else "–"
            for s in (found.spread, found.within)
        ]
        bound = alone(term, found.tolerance) if found.tolerance else "–"
        cells = (len(found.units), found.logs, median_text(term), *spreads, _band(term), bound)
        rows.append((f"{term.name} {term.term}", (*cells, price_text(term) or "–")))
    return _cards(titles, rows, f"{model.title}: all numbers")


def _band(term: FleetTerm) -> str | Markup:
    if term.population.prediction is None:
        return "–"
    low, high = term.population.prediction
    if term.population.bounded:
        return Markup("below {}").format(alone(term, high))
    return between(term, low, high)


def _heat_table(model: SensorModel) -> dict[str, object]:
    """Return units × terms: each unit's difference from the median in %, coloured by the spread of units."""
    groups = by_term(model)
    columns = [(term, {unit.unit: unit for unit in term.population.units}) for term in model.terms]
    firsts = [i == 0 or model.terms[i - 1].symbol != term.symbol for i, term in enumerate(model.terms)]

    def strangeness(name: str) -> float:
        """Return what sorts units: odd ones first, then the farthest from a median."""
        own = [(term, units[name]) for term, units in columns if name in units]
        return max((100.0 * unit.odd + abs(deviation(term, unit) or 0.0) for term, unit in own), default=0.0)

    names = sorted(model.units, key=strangeness, reverse=True)
    caption = f"{model.title}: each unit against the median, in %; < where it only has an upper bound"
    if len(names) > _MOST_UNITS:
        caption += f"; the {_MOST_UNITS} strangest of {len(names)} units"
    rows = [
        (
            name,
            [
                _heat_cell(term, units.get(name), ["first"] * first)
                for (term, units), first in zip(columns, firsts, strict=True)
            ],
        )
        for name in sorted(names[:_MOST_UNITS])
    ]
    return {"caption": caption, "groups": groups, "rows": rows}


def _heat_cell(term: FleetTerm, unit: UnitValue | None, classes: list[str]) -> tuple[str, str]:
    """Return text and classes of a cell."""
    if unit is None:
        return "–", " ".join(classes)
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
    return text, " ".join(classes)


def _slopes(models: Sequence[SensorModel]) -> Markup:
    """Return what temperature and time do to each term; where labels do not tell, why not."""
    rows: list[tuple[object, object]] = []
    refused: dict[str, list[str]] = {}
    trends = [term.trend for model in models for term in model.terms if term.trend]
    units = {label: per(label, trends) for label in NEAREST}
    for model in models:
        for term in model.terms:
            where = f"{f'{model.title} ' * (len(models) > 1)}{term.name} {term.term}"
            if term.trend is None:
                refused.setdefault(term.no_trend, []).append(where)
                continue
            slopes = [_mean_slope(term.trend, label, *units[label]) for label in NEAREST]
            moving = [
                f"{slope.unit} {slope_text(slope.slope, *units[slope.label])}"
                for slope in term.trend.slopes
                if slope.odd
            ]
            rows.append((where, (*slopes, term.trend.units, "; ".join(moving) or "none")))
    notes = [
        f"{', '.join(places) if len(places) < 7 else f'Each of {len(places)} terms'}: {why}."
        for why, places in refused.items()
    ]
    titles = ("temperature", "drift", "units", "units that move otherwise")
    caption = "Change of each coefficient with its 95 % interval; bold where it is more than chance"
    return _cards(titles, rows, caption, notes)


def _mean_slope(trend: Trend, label: str, unit: str, part: float) -> str | Markup:
    """Return the fleet's slope, bold where it is not chance."""
    mean = next((mean for mean in trend.means if mean.label == label), None)
    if mean is None:
        return "–"
    text = slope_text(mean.slope, unit, part)
    return Markup("<b>{}</b>").format(text) if mean.odd else text


def _unit_logs(model: SensorModel) -> Markup:
    """Return how many units have logs that differ, and which."""
    rows = []
    for term in model.terms:
        if differing := [unit for unit in term.unit_logs if unit.differs]:
            said = Markup().join(
                Markup("<li>{} by {} ({}): {}</li>").format(
                    printable(unit.unit),
                    percent(unit.spread),
                    p_text(unit.p_value),
                    with_limits(term, unit.value, unit.low, unit.high),
                )
                for unit in differing
            )
            cells = (len(term.unit_logs), len(differing), Markup("<ul>{}</ul>").format(said))
            rows.append((f"{term.name} {term.term}", cells))
    units = {unit.unit for term in model.terms for unit in term.unit_logs}
    agree = (
        f"{model.title}: the logs of each of {len(units)} units agree with one coefficient a term; all "
        "tests are judged together."
    )
    titles = ("units with several logs", "logs differ in", "which")
    caption = f"{model.title}: have the logs of a unit one coefficient?"
    return _cards(titles, rows, caption, () if rows else [agree])


def _loose(fleet: Fleet) -> Markup:
    """Return the logs without a unit one by one, and the labels that would make a population of them."""
    logs = fleet.loose[:_MOST_LOOSE]
    columns = list(dict.fromkeys(where for one in logs for where in one.values))
    return _filled(
        "loose.html",
        fleet=fleet,
        command=f"imucal fleet run -o {shlex.quote(str(fleet.folder))} --labels {shlex.quote(fleet.labels)}",
        titles=["log", *(f"{axis} {term}" for axis, term in columns)],
        rows=[
            (_log_name(one), [_loose_cell(where, one.values.get(where)) for where in columns]) for one in logs
        ],
    )


def _log_name(one: LooseLog) -> Markup:
    path = printable(one.log.path)
    if not one.log.report:
        return Markup("<code>{}</code>").format(path)
    return Markup('<a href="{}/report.html">{}</a>').format(printable(one.log.report), path)


def _loose_cell(where: tuple[str, str], value: LogValue | None) -> str | Markup:
    if value is None:
        return "–"
    axis, term = where
    sensor = next(s for s in Sensor if axis.startswith(s.short))
    law = TERMS[symbol_of(term)]
    plain = Quantity(value=value.value, low=value.low, high=value.high, unit=law.unit(sensor))
    unit = law.datasheet_unit(sensor)
    sheet = plain.scaled(unit.factor, unit.name)
    return both_units(numbers.with_interval(sheet), numbers.with_interval(plain))


def sorted_units(term: FleetTerm) -> list[UnitValue]:
    """Return the units from the largest to the smallest; those that are only bounded by their bounds."""
    return sorted(term.population.units, key=lambda unit: -(unit.value or unit.high))


#: A whisker or bound reaches no farther below the lowest value than this factor.
_BELOW = 3.0


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


def labelled_ticks(low: float, high: float) -> tuple[list[float], list[str], str]:
    """Return places, their labels, and the power of ten that goes before the unit, such as ``10⁻³ ``."""
    places = _round_ticks(low, high)
    power = math.floor(math.log10(min(places)) + 1e-9)
    if -2 <= power <= 3:
        # Plain numbers: 8000, 10000, and not 8000, 10⁴.
        plain = max(places) < 1e6
        return places, [f"{place:.6g}" if plain else tick_label(place) for place in places], ""
    labels = [f"{place / 10.0**power:.4g}" for place in places]
    return places, labels, f"{tick_label(10.0**power)} "


def _round_ticks(low: float, high: float) -> list[float]:
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


class Panel:
    """Places of a picture of units: rows one below the other, values across on a logarithmic scale.

    Parameters
    ----------
    terms
        Drawn on one scale, in the unit of the first.
    rows, row
        Number of rows, and the height of one.
    """

    #: Size of a picture and of its margins, in its own units; middle of the scale.
    width, left, middle = 420, 88, 246.0
    _right = 404
    #: Most letters of a unit's name that fit the margin; width of a letter.
    _letters, _letter = 11, 7.5

    def __init__(self, terms: Sequence[FleetTerm], *, rows: int, row: float) -> None:
        spans = [span(term) for term in terms]
        self.low, self.high = min(low for low, _ in spans), max(high for _, high in spans)
        self.row, self.height = row, rows * row
        unit = sheet_unit(terms[0])
        conventions = (("sheet", unit.factor, unit.name), ("si", 1.0, terms[0].unit))
        #: Class, places with their labels, and title of the scale in data-sheet units and in SI.
        self.scales = [
            (convention, *self._scale(factor, f"{terms[0].term} in {{}}{pretty(name)}"))
            for convention, factor, name in conventions
        ]

    def x(self, value: float) -> float:
        """Return the place of a value, cut at the ends of the scale."""
        part = math.log(max(value, self.low) / self.low) / math.log(self.high / self.low)
        return round(self.left + (self._right - self.left) * min(part, 1.0), 1)

    def _scale(self, factor: float, title: str) -> tuple[list[tuple[float, str]], str]:
        """Return the ticks of one unit, those without room with an empty label, and the title."""
        places, labels, power = labelled_ticks(self.low * factor, self.high * factor)
        ticks, free = [], 0.0
        for at, label in zip((self.x(place / factor) for place in places), labels, strict=True):
            half = self._letter * len(label) / 2
            fits = at - half >= free and at + half <= self.width
            ticks.append((at, label if fits else ""))
            free = at + half + self._letter if fits else free
        return ticks, title.format(power)

    @classmethod
    def short(cls, name: str) -> str:
        """Return a name that fits the margin: its end tells units apart."""
        return name if len(name) <= cls._letters else f"…{name[1 - cls._letters :]}"


#: Height of a row, most and least; of all rows; rows lower than the last have the names of odd units alone.
_ROW, _THIN, _TALLEST, _NAMED = 15.0, 1.5, 560.0, 10.0


def _unit_panel(term: FleetTerm) -> dict[str, object]:
    """Return the panel of a term, its units from the top with their names, and whether these are written."""
    units = sorted_units(term)
    row = min(_ROW, max(_THIN, _TALLEST / len(units)))
    return {
        "panel": Panel([term], rows=len(units), row=row),
        "units": [(unit, Panel.short(unit.unit)) for unit in units],
        "named": row >= _NAMED,
    }


def _strips(models: Sequence[SensorModel]) -> Iterator[tuple[str, Panel, list[tuple[str, FleetTerm]]]]:
    """Yield title, panel and rows of each term: models with their short names."""
    for (name, key), own in same_terms(models).items():
        panel = Panel([term for _, term in own], rows=len(own), row=46.0)
        yield f"{name} {key}", panel, [(Panel.short(model.title), term) for model, term in own]


#: What the templates call, by name.
_TEXTS: Mapping[str, Callable[..., object]] = {
    "alone": alone,
    "bound_name": bound_name,
    "by_term": by_term,
    "loose_text": loose_text,
    "median_text": median_text,
    "p_text": p_text,
    "panel": _unit_panel,
    "percent": percent,
    "price_text": price_text,
    "term_name": lambda term: TERMS[term.symbol].name(term.sensor),
}
