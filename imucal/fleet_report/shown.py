"""Numbers of a fleet as people read them, in data-sheet units and in SI."""

import math
from collections.abc import Iterable

from imucal.fitting.noise_fit import Interval
from imucal.fleet.population import UnitValue
from imucal.fleet.trend import Trend
from imucal.fleet_report.summary import Fleet, FleetTerm
from imucal.noise.terms import TERMS
from imucal.report import numbers
from imucal.report.markup import Markup, both_units, element, join
from imucal.report.numbers import Quantity
from imucal.report.sheet_units import level_unit
from imucal.units import DatasheetUnit, pretty

#: Width of a band of 95 %, in standard deviations.
_BAND_SDS = 2 * 1.96
#: Less is not told apart.
_LEAST_P = 1e-4
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def sheet_unit(term: FleetTerm) -> DatasheetUnit:
    """Return the unit that data sheets print a term in: µg in place of mg where the median is small."""
    unit = TERMS[term.symbol].datasheet_unit(term.sensor)
    return level_unit(term.sensor, term.population.median.value) if unit.name == "mg" else unit


def quantity(term: FleetTerm, value: float | None, low: float, high: float) -> tuple[Quantity, Quantity]:
    """Return a coefficient of a term in data-sheet units and in SI."""
    unit = sheet_unit(term)
    plain = Quantity(value=value, low=low, high=high, unit=term.unit)
    return plain.scaled(unit.factor, unit.name), plain


def with_limits(term: FleetTerm, value: float | None, low: float, high: float) -> Markup:
    """Return ``0.31 [0.30, 0.32] deg/√h`` in both units."""
    texts = (numbers.with_interval(each).rpartition(" ") for each in quantity(term, value, low, high))
    return both_units(*(join([f"{number} ", unbroken(unit)]) for number, _, unit in texts))


def median_text(term: FleetTerm) -> Markup:
    """Return the median unit with its interval."""
    median = term.population.median
    return with_limits(term, None if term.population.bounded else median.value, median.low, median.high)


def alone(term: FleetTerm, value: float) -> Markup:
    """Return a number with three digits and its unit, in both units: ``0.342 deg/√h``."""
    return both_units(*(unbroken(plain_text(each)) for each in quantity(term, value, value, value)))


def between(term: FleetTerm, low: float, high: float) -> Markup:
    """Return ``0.24 to 0.42 deg/√h`` in both units."""
    pairs = zip(quantity(term, low, low, low), quantity(term, high, high, high), strict=True)
    texts = [[plain_text(each).rpartition(" ") for each in pair] for pair in pairs]
    return both_units(*(join([f"{first[0]} to {last[0]} ", unbroken(last[2])]) for first, last in texts))


def unbroken(text: str) -> Markup:
    """Return a text that stays in one line: browsers part a unit such as ``deg/h`` after the stroke."""
    return element("span", text, class_="keep")


def plain_text(one: Quantity) -> str:
    """Return a bound with three digits and its unit, rounded up so that it stays one."""
    value = one.value or one.high
    power = numbers.power_of_ten(one)
    scaled = value * 10.0**-power
    places = 2 - math.floor(math.log10(scaled))
    raised = math.ceil(scaled * 10.0**places * (1 - 1e-12)) / 10.0**places
    body = f"{raised:.{max(places, 0)}f}"
    return f"{body}{f' ×10{str(power).translate(_SUPERSCRIPTS)}' if power else ''} {pretty(one.unit)}"


def percent(value: float) -> str:
    """Return a relative standard deviation of two digits, such as ``6.2 %``."""
    return (
        f"{100 * value:.2g}\N{NO-BREAK SPACE}%" if value < 0.995 else f"{100 * value:.0f}\N{NO-BREAK SPACE}%"
    )


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
