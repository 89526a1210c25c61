"""A fleet in words: its numbers in data-sheet units and in SI, and what matters of it in one sentence."""

import math
from collections.abc import Iterable

import numpy as np

from imucal.fitting.noise_fit import Interval
from imucal.fleet.population import FALSE_SHARE, UnitValue, adjusted
from imucal.fleet.trend import Trend
from imucal.fleet.values import LogValue
from imucal.fleet_report.answers import symbol_of
from imucal.fleet_report.summary import Fleet, FleetTerm, SensorModel
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.markup import Markup, both_units
from imucal.report.numbers import Quantity
from imucal.report.sheet_units import level_unit
from imucal.units import DatasheetUnit

#: Width of a band of 95 %, in standard deviations.
_BAND_SDS = 2 * 1.96
#: Less is not told apart.
_LEAST_P = 1e-4


def sheet_unit(term: FleetTerm) -> DatasheetUnit:
    """Return the unit that data sheets print a term in: µg in place of mg where the median is small."""
    unit = TERMS[term.symbol].datasheet_unit(term.sensor)
    return level_unit(term.sensor, term.population.median.value) if unit.name == "mg" else unit


def _quantities(term: FleetTerm, value: float | None, low: float, high: float) -> tuple[Quantity, Quantity]:
    """Return a coefficient of a term in data-sheet units and in SI."""
    unit = sheet_unit(term)
    plain = Quantity(value=value, low=low, high=high, unit=term.unit)
    return plain.scaled(unit.factor, unit.name), plain


def with_limits(term: FleetTerm, value: float | None, low: float, high: float) -> Markup:
    """Return ``0.31 [0.30, 0.32] deg/√h`` in both units."""
    return both_units(*(_kept(numbers.with_interval(each)) for each in _quantities(term, value, low, high)))


def term_name(term: FleetTerm) -> str:
    """Return what a term is called for its sensor."""
    return TERMS[term.symbol].name(term.sensor)


def loose_value(where: tuple[str, str], value: LogValue) -> Markup:
    """Return what a log without a unit says of an axis and term, in both units."""
    axis, term = where
    sensor = next(s for s in Sensor if axis.startswith(s.short))
    law = TERMS[symbol_of(term)]
    unit = law.datasheet_unit(sensor)
    plain = Quantity(value=value.value, low=value.low, high=value.high, unit=law.unit(sensor))
    sheet = plain.scaled(unit.factor, unit.name)
    return both_units(numbers.with_interval(sheet), numbers.with_interval(plain))


def median_text(term: FleetTerm) -> Markup:
    """Return the median unit with its interval."""
    median = term.population.median
    return with_limits(term, None if term.population.bounded else median.value, median.low, median.high)


def alone(term: FleetTerm, value: float) -> Markup:
    """Return a number with three digits and its unit, in both units: ``0.342 deg/√h``."""
    each = _quantities(term, value, value, value)
    return both_units(*(Markup('<span class="keep">{}</span>').format(_rounded_up(one)) for one in each))


def between(term: FleetTerm, low: float, high: float) -> Markup:
    """Return ``0.24 to 0.42 deg/√h`` in both units."""
    pairs = zip(_quantities(term, low, low, low), _quantities(term, high, high, high), strict=True)
    texts = ((_rounded_up(first).rpartition(" ")[0], _rounded_up(last)) for first, last in pairs)
    return both_units(*(_kept(f"{first} to {last}") for first, last in texts))


def _kept(text: str) -> Markup:
    """Return a text whose last word, a unit, stays in one line: browsers part ``deg/h`` after the stroke."""
    number, _, unit = text.rpartition(" ")
    return Markup('{} <span class="keep">{}</span>').format(number, unit)


def _rounded_up(one: Quantity) -> str:
    """Return a bound with three digits and its unit, rounded up so that it stays one."""
    exponent = numbers.power_of_ten(one)
    scaled = (one.value or one.high) * 10.0**-exponent
    return numbers.with_unit(numbers.rounded_up(scaled, 3), exponent, one.unit)


def percent(value: float) -> str:
    """Return a relative standard deviation of two digits, such as ``6.2 %``."""
    digits = ".2g" if value < 0.995 else ".0f"
    return f"{100 * value:{digits}}\N{NO-BREAK SPACE}%"


def p_text(p: float) -> str:
    """Return ``p = 0.0046``, or that it is less than what anyone asks for."""
    return f"p = {p:.2g}" if p >= _LEAST_P else f"p < {_LEAST_P:g}"


def per(label: str, trends: Iterable[Trend]) -> tuple[str, float]:
    """Return what changes by a label are said of, such as a year, and what part of the slopes' it is.

    A change of the logarithm is a share of the coefficient while it is small. Where one would come to more
    than 100 % a year, as it may of logs of one week, all are said of a day.
    """
    if label == "temperature_c":
        return "°C", 1.0
    shown = [slope for trend in trends for slope in (*trend.means, *trend.slopes) if slope.label == label]
    fast = any(abs(slope.slope.value) > 1 for slope in shown if slope.odd or not slope.unit)
    return ("day", 1 / 365.25) if fast else ("year", 1.0)


def slope_text(slope: Interval, unit: str, part: float) -> str:
    """Return ``+0.31 [+0.25, +0.37] % a °C`` of a change of the logarithm; unit, part: see `per`."""
    value, low, high = (100 * part * x for x in (slope.value, slope.low, slope.high))
    places = min(max(0, 1 - math.floor(math.log10(max((high - low) / 2, 1e-9)))), 4)
    # No sign before a zero.
    texts = [f"{x:+.{places}f}" if round(x, places) else f"{0:.{places}f}" for x in (value, low, high)]
    unit = f"% a {unit}".replace(" ", "\N{NO-BREAK SPACE}")
    return f"{texts[0]} [{texts[1]}, {texts[2]}] {unit}".replace("-", "\N{MINUS SIGN}")


def by_term(model: SensorModel) -> dict[tuple[str, str], list[FleetTerm]]:
    """Return the axes of each term, by sensor and term."""
    groups: dict[tuple[str, str], list[FleetTerm]] = {}
    for term in model.terms:
        groups.setdefault((str(term.sensor), term.term), []).append(term)
    return groups


def bound_name(term: FleetTerm) -> str:
    """Return ``95/95``: content over confidence."""
    return f"{100 * term.population.content:.4g}/{100 * term.population.confidence:.4g}"


def price_text(term: FleetTerm) -> str:
    """Return what the bound costs, and what more units would buy."""
    if not term.price:
        return ""
    return ", ".join(f"{ratio:.2f}\N{NO-BREAK SPACE}× with {units}" for units, ratio in term.price) + " units"


def deviation(term: FleetTerm, unit: UnitValue) -> float | None:
    """Return how many standard deviations of the next unit a unit lies above the median, in the logarithm.

    None where one of them is not known, or only bounded.
    """
    band = term.population.prediction
    if unit.value is None or band is None or term.population.bounded:
        return None
    return math.log(unit.value / term.population.median.value) / (math.log(band[1] / band[0]) / _BAND_SDS)


def loose_text(fleet: Fleet) -> str:
    """Return how many logs stand without a unit."""
    number = len(fleet.loose)
    return f"{number} log has no unit's label" if number == 1 else f"{number} logs have no unit's label"


def verdict(fleet: Fleet) -> tuple[str, str]:
    """Return the grade of a fleet and one sentence: which units are odd, and how many logs do not count."""
    said, chance = _strange(fleet)
    failed = sum(len(logs) for logs in fleet.failures.values())
    if failed:
        said.append(f"{failed} of {len(fleet.logs)} logs do{'es' * (failed == 1)} not count")
    if fleet.loose:
        said.append(loose_text(fleet))
    few = [model.title for model in fleet.models if len(model.units) < 3]
    if few:
        said.append(f"{', '.join(few)}: too few units to tell a spread or a bound")
    grade, text = ("look", "; ".join(said)) if said else ("good", "no unit is odd, and every log counts")
    if chance:
        text += f"; far off in one term of so many, perhaps by chance: {'; '.join(chance)}"
    # A model's name stays as it is.
    named = any(text.startswith((f"{model.title}:", f"{model.title},")) for model in fleet.models)
    return grade, f"{text if named else text[0].upper() + text[1:]}."


def _strange(fleet: Fleet) -> tuple[list[str], list[str]]:
    """Return which units of each model are odd or move otherwise, and which may be odd by chance."""
    several = len(fleet.models) > 1
    sure = beyond_chance(fleet)
    said: list[str] = []
    chance: list[str] = []
    for model in fleet.models:
        title = f"{model.title}: " if several else ""
        odd = [(unit.unit, term) for term in model.terms for unit in term.odd]
        if surely := [(unit, term) for unit, term in odd if (id(term), unit) in sure]:
            said.append(f"{title}odd unit{'s' * (len(dict(surely)) > 1)} {_listed(surely)}")
        if perhaps := _listed((unit, term) for unit, term in odd if (id(term), unit) not in sure):
            chance.append(f"{title}{perhaps}")
        if moving := _listed((unit, term) for term in model.terms for unit in term.drifting):
            said.append(f"{title}drifts with time or temperature unlike the others: {moving}")
    return said, chance


def beyond_chance(fleet: Fleet) -> set[tuple[int, str]]:
    """Return the terms, by identity, and units that are odd among all units of all terms together.

    Each term has its false alarms, of which a fleet with many terms has some.
    """
    tested = [
        (id(term), unit.unit, unit.p_value)
        for model in fleet.models
        for term in model.terms
        for unit in term.population.units
        if unit.p_value is not None
    ]
    p_values = adjusted(np.array([p for *_, p in tested]))
    return {
        (term, unit) for (term, unit, _), p in zip(tested, p_values.tolist(), strict=True) if p <= FALSE_SHARE
    }


def _listed(places: Iterable[tuple[str, FleetTerm]]) -> str:
    """Return ``u07 (gyro_z N); u11 (gyro_x B, gyro_x K)``."""
    terms: dict[str, list[str]] = {}
    for unit, term in places:
        terms.setdefault(unit, []).append(f"{term.name} {term.term}")
    return "; ".join(f"{unit} ({', '.join(where)})" for unit, where in terms.items())
