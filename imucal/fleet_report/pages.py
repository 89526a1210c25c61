"""The text of a fleet's report: numbers, the verdict, ``fleet.html`` (no network or script), and tables."""

import base64
import itertools
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

from imucal.fitting.homogeneity import symbol_of
from imucal.fleet.values import LogValue
from imucal.fleet_report.summary import Fleet, FleetTerm, SensorModel
from imucal.multiple_tests import SIGNIFICANCE, holm
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.markup import Markup, both_units, render
from imucal.report.numbers import Quantity
from imucal.units import DatasheetUnit

if TYPE_CHECKING:
    import polars as pl

#: Largest numbers on the page, and in a notebook's text.
_LISTED_LOGS, _LISTED_MODELS = 500, 9

#: Section of the page -> description and SVG of each picture.
Pictures: TypeAlias = Mapping[str, Sequence[tuple[str, bytes]]]


_MIN_P = 1e-4


def sheet_unit(term: FleetTerm) -> DatasheetUnit:
    """Return a term's unit in data sheets."""
    return TERMS[term.symbol].datasheet_unit(term.sensor)


def _both(write: Callable[[Quantity], str], plain: Quantity, sheet: DatasheetUnit) -> Markup:
    return both_units(write(plain.scaled(sheet.factor, sheet.name)), write(plain))


def with_limits(term: FleetTerm, value: float | None, low: float, high: float) -> Markup:
    """Return ``0.31 [0.30, 0.32] deg/√h`` in both units."""
    plain = Quantity(value=value, low=low, high=high, unit=term.unit)
    return _both(lambda q: _kept(numbers.with_interval(q)), plain, sheet_unit(term))


def loose_value(where: tuple[str, str], value: LogValue) -> Markup:
    """Return the value of a log without a unit label, in both units."""
    axis, term = where
    sensor = next(s for s in Sensor if axis.startswith(s.short))
    law = TERMS[symbol_of(term)]
    return _both(numbers.with_interval, Quantity.of(value, law.unit(sensor)), law.datasheet_unit(sensor))


def median_text(term: FleetTerm) -> Markup:
    """Return the median unit with its interval."""
    found = term.population
    return with_limits(term, found.middle, found.median.low, found.median.high)


def alone(term: FleetTerm, value: float) -> Markup:
    """Return a number with three digits in both units: ``0.342 deg/√h``."""
    keep = Markup('<span class="keep">{}</span>').format
    plain = Quantity(value=value, low=value, high=value, unit=term.unit)
    return _both(lambda q: keep(_rounded_up(q)), plain, sheet_unit(term))


def between(term: FleetTerm, low: float, high: float) -> Markup:
    """Return ``0.24 to 0.42 deg/√h`` in both units."""

    def write(q: Quantity) -> Markup:
        first = _rounded_up(replace(q, value=q.low)).rpartition(" ")[0]
        return _kept(f"{first} to {_rounded_up(q)}")

    return _both(write, Quantity(value=high, low=low, high=high, unit=term.unit), sheet_unit(term))


def _kept(text: str) -> Markup:
    """Keep the unit in one line: browsers break it after the stroke."""
    number, _, unit = text.rpartition(" ")
    return Markup('{} <span class="keep">{}</span>').format(number, unit)


def _rounded_up(one: Quantity) -> str:
    """Return a bound with three digits, rounded up so that it stays one."""
    exponent = numbers.power_of_ten(one)
    scaled = (one.value or one.high) * 10.0**-exponent
    return numbers.with_unit(numbers.rounded_up(scaled, 3), exponent, one.unit)


def percent(value: float) -> str:
    """Return a relative standard deviation of two digits, such as ``6.2 %``."""
    digits = ".2g" if value < 0.995 else ".0f"
    return f"{100 * value:{digits}}\N{NO-BREAK SPACE}%"


def p_text(p: float) -> str:
    """Return ``p = 0.0046``, or ``p < 0.0001``."""
    return f"p = {p:.2g}" if p >= _MIN_P else f"p < {_MIN_P:g}"


def by_term(model: SensorModel) -> dict[tuple[str, str], list[FleetTerm]]:
    """Return the axes of each term, by sensor and term."""
    groups = itertools.groupby(model.terms, lambda term: (str(term.sensor), term.term))
    return {key: list(terms) for key, terms in groups}


def bound_name(term: FleetTerm) -> str:
    """Return ``95/95``: content over confidence."""
    return f"{100 * term.population.content:.4g}/{100 * term.population.confidence:.4g}"


def price_text(term: FleetTerm) -> str:
    """Return the price of the bound for these and for more units."""
    if not term.price:
        return ""
    return ", ".join(f"{ratio:.2f}\N{NO-BREAK SPACE}× with {units}" for units, ratio in term.price) + " units"


def loose_text(fleet: Fleet) -> str:
    """Return the number of logs without a unit label."""
    number = len(fleet.loose)
    return f"{number} log has no unit label" if number == 1 else f"{number} logs have no unit label"


def verdict(fleet: Fleet) -> tuple[str, str]:
    """Return the grade of a fleet and a sentence on odd units and logs that do not count."""
    parts, chance = _odd_units(fleet)
    if failed := sum(bool(log.left_out) for log in fleet.logs):
        parts.append(f"{failed} of {len(fleet.logs)} logs do{'es' * (failed == 1)} not count")
    if fleet.loose:
        parts.append(loose_text(fleet))
    if few := [model.title for model in fleet.models if len(model.units) < 3]:
        parts.append(f"{', '.join(few)}: too few units for a spread or a bound")
    grade, text = ("check", "; ".join(parts)) if parts else ("good", "no unit is odd, and every log counts")
    if chance:
        text += f"; far off in one of many terms, perhaps by chance: {'; '.join(chance)}"
    # A model's name stays as it is.
    named = any(text.startswith((f"{model.title}:", f"{model.title},")) for model in fleet.models)
    return grade, f"{text if named else text[0].upper() + text[1:]}."


def _odd_units(fleet: Fleet) -> tuple[list[str], list[str]]:
    """Return the odd units of each model, and units that may be odd by chance."""
    several, sure = len(fleet.models) > 1, beyond_chance(fleet)
    parts, chance = list[str](), list[str]()
    for model in fleet.models:
        title = f"{model.title}: " if several else ""
        odd = [(unit.unit, term) for term in model.terms for unit in term.odd]
        if surely := [(unit, term) for unit, term in odd if (id(term), unit) in sure]:
            parts.append(f"{title}odd unit{'s' * (len(dict(surely)) > 1)} {_listed(surely)}")
        if perhaps := _listed((unit, term) for unit, term in odd if (id(term), unit) not in sure):
            chance.append(f"{title}{perhaps}")
    return parts, chance


def beyond_chance(fleet: Fleet) -> set[tuple[int, str]]:
    """Return the terms, by identity, and units that are odd among all units of all terms.

    Without this correction a fleet with many terms has false alarms.
    """
    every = ((id(t), unit) for m in fleet.models for t in m.terms for unit in t.population.units)
    tested = {(term, unit.unit): unit.p_value for term, unit in every if unit.p_value is not None}
    chances = zip(tested, holm([*tested.values()]), strict=True)
    return {place for place, p in chances if p <= SIGNIFICANCE}


def _listed(places: Iterable[tuple[str, FleetTerm]]) -> str:
    terms: dict[str, list[str]] = {}
    for unit, term in places:
        terms.setdefault(unit, []).append(f"{term.name} {term.term}")
    return "; ".join(f"{unit} ({', '.join(where)})" for unit, where in terms.items())


def render_fleet_page(fleet: Fleet, pictures: Pictures | None = None) -> str:
    """Return the page with pictures; the same fleet always gives the same text."""
    loose = fleet.loose[:_LISTED_LOGS]
    return _filled(
        "fleet.html",
        fleet=fleet,
        models=fleet.models,
        pictures={
            section: [(shows, base64.b64encode(svg).decode("ascii")) for shows, svg in own]
            for section, own in (pictures or {}).items()
        },
        logs=loose,
        columns=list(dict.fromkeys(where for one in loose for where in one.values)),
        command=shlex.join(["imucal", "fleet", "run", "-o", str(fleet.folder), "--labels", fleet.labels]),
    )


_FORMATS: tuple[Callable[..., object], ...] = (
    *(with_limits, loose_value, median_text, alone, between, percent, p_text, by_term),
    *(bound_name, price_text, loose_text, verdict, numbers.term_name),
)


def _filled(template: str, **values: object) -> Markup:
    texts = {function.__name__: function for function in _FORMATS}
    return render(template, package="imucal.fleet_report", **texts, **values)


def text_of(fleet: Fleet) -> str:
    """Return a summary of at most twelve lines."""
    lines = [f"Fleet of {len(fleet.logs)} logs in {fleet.folder}: {verdict(fleet)[1]}"]
    for model in fleet.models[:_LISTED_MODELS]:
        many = f"{len(model.units)} units, {len(model.logs)} logs, {len(model.terms)} terms"
        lines.append(f"{model.title}: {many}")
    more = len(fleet.models) - _LISTED_MODELS
    return "\n".join([*lines, *([f"and {more} more sensor models"] if more > 0 else [])])


def html_of(fleet: Fleet) -> Markup:
    """Return the page's table of numbers for configs."""
    table = _filled("config.html", models=fleet.models)
    return render("notebook.html", table=table, caption=verdict(fleet)[1])


def frame_of(fleet: Fleet) -> "pl.DataFrame":
    """Return a row for each term and axis of each sensor model: median and bound in SI, or null."""
    import polars as pl

    rows = [
        {
            "model": model.name,
            "axis": term.name,
            "term": term.term,
            "units": len(term.population.units),
            "logs": term.population.logs,
            "median": term.population.middle,
            "tolerance": term.population.tolerance,
            "unit": term.unit,
        }
        for model in fleet.models
        for term in model.terms
    ]
    return pl.DataFrame(rows, schema_overrides={"median": pl.Float64, "tolerance": pl.Float64})
