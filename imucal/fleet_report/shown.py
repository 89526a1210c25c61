"""Numbers of a fleet as people read them, in data-sheet units and in SI."""

import math

from imucal.fitting.noise_fit import Interval
from imucal.fleet.population import UnitValue
from imucal.fleet_report.summary import Fleet, FleetTerm
from imucal.noise.terms import TERMS
from imucal.report import numbers
from imucal.report.markup import Markup, both_units
from imucal.report.numbers import Quantity
from imucal.report.sheet_units import level_unit
from imucal.units import DatasheetUnit, pretty

#: Width of a band of 95 %, in standard deviations.
_BAND_SDS = 2 * 1.96
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
    return both_units(*(numbers.with_interval(each) for each in quantity(term, value, low, high)))


def median_text(term: FleetTerm) -> Markup:
    """Return the median unit with its interval."""
    median = term.population.median
    return with_limits(term, None if term.population.bounded else median.value, median.low, median.high)


def alone(term: FleetTerm, value: float) -> Markup:
    """Return a number with three digits and its unit, in both units: ``0.342 deg/√h``."""
    return both_units(*(plain_text(each) for each in quantity(term, value, value, value)))


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


def slope_text(slope: Interval, unit: str) -> str:
    """Return ``+0.31 [0.25, 0.37] % a °C`` of a change of the logarithm."""
    places = max(0, 1 - math.floor(math.log10(max(100 * (slope.high - slope.low) / 2, 1e-9))))
    value, low, high = (f"{100 * x:+.{min(places, 4)}f}" for x in (slope.value, slope.low, slope.high))
    return f"{value} [{low}, {high}] % a {unit}".replace("-", "\N{MINUS SIGN}")


def bound_name(term: FleetTerm) -> str:
    """Return ``95/95``: content over confidence."""
    return f"{100 * term.population.content:.4g}/{100 * term.population.confidence:.4g}"


def price_text(term: FleetTerm) -> str:
    """Return what the bound costs, and what more units would buy."""
    if not term.price:
        return ""
    (now, excess), *more = term.price
    text = f"{now} units: {excess:.2f} × the level that it bounds"
    return "; ".join([text, *(f"{units} units: {ratio:.2f} ×" for units, ratio in more)])


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
