"""The tables of a fleet's page: the number for the config, units × terms, slopes, logs of one unit."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

from imucal.fleet.population import UnitValue
from imucal.fleet.trend import NEAREST, Trend
from imucal.fleet_report.shown import (
    alone,
    between,
    bound_name,
    deviation,
    median_text,
    p_text,
    per,
    percent,
    price_text,
    slope_text,
    with_limits,
)
from imucal.fleet_report.summary import FleetTerm, SensorModel
from imucal.noise.terms import TERMS
from imucal.recording import Axis
from imucal.report.markup import Markup, element, join, labelled, row, table

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
