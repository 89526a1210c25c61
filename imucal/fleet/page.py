"""The text of a fleet's report: numbers, the verdict, ``fleet.html`` (no network or script), and tables."""

import base64
import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

from imucal.fitting.noise_fit import Interval
from imucal.fleet.population import MIN_UNITS, UnitValue
from imucal.fleet.summary import Fleet, FleetTerm, SensorModel
from imucal.noise.terms import TERMS
from imucal.report import numbers
from imucal.report.markup import Markup, both_units, render
from imucal.report.numbers import Quantity
from imucal.units import DatasheetUnit

if TYPE_CHECKING:
    import polars as pl

#: Largest number of logs that the page lists.
_LISTED_LOGS = 500
#: Largest number of units like the others that the page names.
_LISTED_UNITS = 300
#: Largest number of models in a notebook's text.
_LISTED_MODELS = 9
#: Smallest p-value that is printed: smaller ones depend on the tails of the law.
_LEAST_P = 1e-4

#: Sensor model -> description and SVG of each picture.
Pictures: TypeAlias = Mapping[str, Sequence[tuple[str, bytes]]]


@dataclass(frozen=True, kw_only=True)
class UnitVerdict:
    """Whether a unit is like the others: the grade ``good``, ``check`` or ``not-noise``, and the reasons."""

    unit: str
    logs: int
    grade: str
    verdict: str
    reasons: tuple[str, ...]


def unit_verdicts(model: SensorModel) -> list[UnitVerdict]:
    """Return the verdict on each unit, those unlike the others first."""
    logs = Counter(log.unit for log in model.logs if log.counts)
    odd = [(term, unit) for term in model.terms for unit in term.odd]
    found = [
        _verdict_on(name, logs[name], model.terms, [(term, unit) for term, unit in odd if unit.unit == name])
        for name in model.units
    ]
    order = {"not-noise": 0, "check": 1, "good": 2}
    return sorted(found, key=lambda verdict: order[verdict.grade])


def _verdict_on(
    name: str, logs: int, terms: Sequence[FleetTerm], odd: Sequence[tuple[FleetTerm, UnitValue]]
) -> UnitVerdict:
    """Return the verdict on a unit from the terms in which it is odd, and from its groups and logs."""
    sure = [_oddity(term, unit) for term, unit in odd if name in term.sure]
    perhaps = [_oddity(term, unit) for term, unit in odd if name not in term.sure]
    few = [f"{term.name} {term.term}" for term in terms if name in _fewer(term.population.groups)]
    differing = [f"{term.name} {term.term}" for term in terms if name in term.differing]
    reasons = [*sure, *perhaps]
    if few:
        reasons.append(f"it is in the group of fewer units in {', '.join(few)}")
    if differing:
        reasons.append(f"its logs differ in {', '.join(differing)}")
    verdicts = (
        (sure, "not-noise", "unlike the others"),
        (perhaps, "check", "far off in one of many terms, perhaps by chance"),
        (few, "check", "of the group of fewer units"),
        (differing, "check", "it changes from log to log"),
        (True, "good", "like the others"),
    )
    grade, verdict = next((grade, verdict) for why, grade, verdict in verdicts if why)
    return UnitVerdict(unit=name, logs=logs, grade=grade, verdict=verdict, reasons=tuple(reasons))


def _fewer(groups: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """Return the group of fewer units, of larger values if both are equal; () if there are no groups."""
    return min(reversed(groups), key=len, default=())


def group_texts(model: SensorModel) -> list[str]:
    """Return a sentence for each division of the units into two groups, with all terms that show it."""
    divisions: dict[tuple[tuple[str, ...], ...], list[FleetTerm]] = {}
    for term in model.terms:
        if term.population.groups:
            divisions.setdefault(term.population.groups, []).append(term)
    texts = []
    for (smaller, larger), terms in divisions.items():
        where = ", ".join(f"{term.name} {term.term}" for term in terms)
        texts.append(
            f"The units of {model.title} form two groups in {where}: {', '.join(smaller)}; and larger, "
            f"{', '.join(larger)}. The number for every config is the bound of the larger group. "
            "Label batches that differ as separate models."
        )
    return texts


def _oddity(term: FleetTerm, unit: UnitValue) -> str:
    """Return ``gyro_z N: 2.2 × the median unit (p < 0.0001)``."""
    value = unit.value or unit.high
    ratio = f"{value / term.population.median.value:.2g} × the median unit"
    return f"{term.name} {term.term}: {ratio} ({p_text(unit.p_odd or 0.0)})"


def sheet_unit(term: FleetTerm) -> DatasheetUnit:
    """Return a term's unit in data sheets."""
    return TERMS[term.symbol].datasheet_unit(term.sensor)


def _both(write: Callable[[Quantity], str], plain: Quantity, sheet: DatasheetUnit) -> Markup:
    return both_units(write(plain.scaled(sheet.factor, sheet.name)), write(plain))


def with_limits(term: FleetTerm, value: float | None, low: float, high: float) -> Markup:
    """Return ``0.31 [0.30, 0.32] deg/√h`` in both units."""
    plain = Quantity(value=value, low=low, high=high, unit=term.unit)
    return _both(lambda q: _kept(numbers.with_interval(q)), plain, sheet_unit(term))


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


def percent(found: Interval) -> str:
    """Return a relative standard deviation with two digits, such as ``6.2 [4.7, 9.8] %``."""
    value, low, high = (
        f"{100 * part:{'.2g' if part < 0.995 else '.0f'}}" for part in (found.value, found.low, found.high)
    )
    return f"{value} [{low}, {high}]\N{NO-BREAK SPACE}%"


def p_text(p: float) -> str:
    """Return ``p = 0.0046``, or ``p < 0.0001``."""
    return f"p = {p:.2g}" if p >= _LEAST_P else f"p < {_LEAST_P:g}"


def bound_name(term: FleetTerm) -> str:
    """Return ``95/95``: content over confidence."""
    return f"{100 * term.population.content:.4g}/{100 * term.population.confidence:.4g}"


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
    if few := [model.title for model in fleet.models if len(model.units) < MIN_UNITS]:
        parts.append(f"{', '.join(few)}: too few units for a spread or a bound")
    parts += _changing_units(fleet)
    grade, text = ("check", "; ".join(parts)) if parts else ("good", "no unit is odd, and every log counts")
    if chance:
        text += f"; far off in one of many terms, perhaps by chance: {'; '.join(chance)}"
    # A model's name stays as it is.
    named = any(text.startswith((f"{model.title}:", f"{model.title},")) for model in fleet.models)
    return grade, f"{text if named else text[0].upper() + text[1:]}."


def _odd_units(fleet: Fleet) -> tuple[list[str], list[str]]:
    """Return the odd units of each model, and units that may be odd by chance."""
    several = len(fleet.models) > 1
    parts, chance = list[str](), list[str]()
    for model in fleet.models:
        title = f"{model.title}: " if several else ""
        odd = [(unit.unit, term) for term in model.terms for unit in term.odd]
        if surely := [(unit, term) for unit, term in odd if unit in term.sure]:
            parts.append(f"{title}odd unit{'s' * (len(dict(surely)) > 1)} {_listed(surely)}")
        if perhaps := _listed((unit, term) for unit, term in odd if unit not in term.sure):
            chance.append(f"{title}{perhaps}")
        if grouped := [f"{term.name} {term.term}" for term in model.terms if term.population.groups]:
            parts.append(f"{title}the units form two groups in {', '.join(grouped)}")
    return parts, chance


def _changing_units(fleet: Fleet) -> list[str]:
    """Return the units of each model whose logs differ from one another."""
    several = len(fleet.models) > 1
    parts = []
    for model in fleet.models:
        changing = _listed((unit, term) for term in model.terms for unit in term.differing)
        if changing:
            parts.append(f"{f'{model.title}: ' if several else ''}changes from log to log: {changing}")
    return parts


def _listed(places: Iterable[tuple[str, FleetTerm]]) -> str:
    terms: dict[str, list[str]] = {}
    for unit, term in places:
        terms.setdefault(unit, []).append(f"{term.name} {term.term}")
    return "; ".join(f"{unit} ({', '.join(where)})" for unit, where in terms.items())


def render_fleet_page(fleet: Fleet, pictures: Pictures | None = None) -> str:
    """Return the page with pictures; the same fleet always gives the same text."""
    return _filled(
        "fleet.html",
        fleet=fleet,
        models=fleet.models,
        pictures={
            name: [(shows, base64.b64encode(svg).decode("ascii")) for shows, svg in own]
            for name, own in (pictures or {}).items()
        },
        most_logs=_LISTED_LOGS,
        most_units=_LISTED_UNITS,
        command=shlex.join(["imucal", "fleet", "run", "-o", str(fleet.folder), "--labels", fleet.labels]),
    )


_FORMATS: tuple[Callable[..., object], ...] = (
    *(
        with_limits,
        median_text,
        alone,
        between,
        percent,
        bound_name,
        loose_text,
        verdict,
        unit_verdicts,
        group_texts,
    ),
    numbers.term_name,
)


def _filled(template: str, **values: object) -> Markup:
    texts = {function.__name__: function for function in _FORMATS}
    return render(template, package="imucal.fleet", **texts, **values)


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
    table = _filled("limits.html", models=fleet.models)
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
