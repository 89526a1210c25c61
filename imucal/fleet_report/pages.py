"""``fleet.html``: what the units of each sensor model are like, on one page that opens without a network.

Tables and pictures are there without any script: the templates lay them out, `verdict` words the numbers.
"""

import base64
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeAlias

from imucal.fleet.trend import NEAREST, Trend
from imucal.fleet.values import LogValue
from imucal.fleet_report.answers import symbol_of
from imucal.fleet_report.summary import Fleet, SensorModel
from imucal.fleet_report.verdict import (
    alone,
    between,
    bound_name,
    by_term,
    loose_text,
    median_text,
    p_text,
    per,
    percent,
    price_text,
    slope_text,
    verdict,
    with_limits,
)
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.markup import Markup, both_units, render
from imucal.report.numbers import Quantity

#: Most logs without a label that are listed.
_MOST_LOOSE = 500


#: Section of the page -> what each of its pictures shows, and its SVG.
Pictures: TypeAlias = Mapping[str, Sequence[tuple[str, bytes]]]


def render_fleet_page(fleet: Fleet, pictures: Pictures | None = None) -> str:
    """Return the page, with the pictures that are drawn; the same fleet always gives the same text."""
    name = fleet.folder.resolve().name
    grade, sentence = verdict(fleet)
    return _filled(
        "fleet.html",
        title=f"{name} – fleet of IMUs",
        heading="Fleet" if name == "fleet" else f"Fleet {name}",
        grade=grade,
        sentence=sentence,
        lead=_lead(fleet),
        sections=list(_sections(fleet, pictures or {})),
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


def _sections(fleet: Fleet, pictures: Pictures) -> Iterator[tuple[str, str, Markup]]:
    """Yield anchor, title and body of each section."""
    models = fleet.models

    def drawn(section: str) -> Markup:
        own = pictures.get(section, ())
        encoded = [(shows, base64.b64encode(svg).decode("ascii")) for shows, svg in own]
        return _filled("pictures.html", section=section, pictures=encoded)

    if models:
        yield "config", "The number for the config", _for_the_config(models)
    for i, model in enumerate(models):
        title = f"Units of {model.name}" if model.name else "Units"
        yield f"units-{i}", title, drawn(f"units-{i}") + _filled("units.html", model=model)
    if len(models) > 1:
        yield "models", "Models side by side", drawn("models")
    if models:
        yield "heat", "Units and terms", drawn("heat")
        yield "trend", "Temperature and time", drawn("trend") + _slopes(models)
        tested = [model for model in models if any(term.unit_logs for term in model.terms)]
        if tested:
            yield "logs", "Several logs of one unit", _filled("unit_logs.html", models=tested)
        yield "numbers", "All numbers", _filled("numbers.html", models=models)
    if fleet.loose:
        yield "loose", "Logs without a unit", _loose(fleet)
    yield "failed", "Logs that do not count", _filled("failed.html", failures=fleet.failures)
    if fleet.findings:
        yield "findings", "Findings", _filled("remarks.html", findings=fleet.findings)
    yield "words", "What the words mean", _filled("words.html")


def _for_the_config(models: Sequence[SensorModel]) -> Markup:
    few = [model.title for model in models if len(model.units) < 3]
    with_axes = [(model, sorted({term.axis for term in model.terms})) for model in models]
    return _filled("config.html", models=with_axes, few=few)


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
    return _filled("slopes.html", titles=("", *titles), rows=rows, caption=caption, notes=notes)


def _mean_slope(trend: Trend, label: str, unit: str, part: float) -> str | Markup:
    """Return the fleet's slope, bold where it is not chance."""
    mean = next((mean for mean in trend.means if mean.label == label), None)
    if mean is None:
        return "–"
    text = slope_text(mean.slope, unit, part)
    return Markup("<b>{}</b>").format(text) if mean.odd else text


def _loose(fleet: Fleet) -> Markup:
    """Return the logs without a unit one by one, and the labels that would make a population of them."""
    logs = fleet.loose[:_MOST_LOOSE]
    columns = list(dict.fromkeys(where for one in logs for where in one.values))
    return _filled(
        "loose.html",
        fleet=fleet,
        command=f"imucal fleet run -o {shlex.quote(str(fleet.folder))} --labels {shlex.quote(fleet.labels)}",
        titles=["log", *(f"{axis} {term}" for axis, term in columns)],
        rows=[(one.log, [_loose_cell(where, one.values.get(where)) for where in columns]) for one in logs],
    )


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


#: What the templates call, by name.
_TEXTS: Mapping[str, Callable[..., object]] = {
    "alone": alone,
    "between": between,
    "bound_name": bound_name,
    "by_term": by_term,
    "loose_text": loose_text,
    "median_text": median_text,
    "p_text": p_text,
    "percent": percent,
    "price_text": price_text,
    "term_name": lambda term: TERMS[term.symbol].name(term.sensor),
    "with_limits": with_limits,
}
