"""Format values for people: as many digits as the interval supports; bounds as ``< high``.

Rounding: an uncertainty whose three leading digits are below 355 keeps two digits, otherwise one. Source:
PDG, Review of Particle Physics (2022), sec. 5.3.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imucal.fitting.noise_fit import Estimate, Interval, NoiseFit
from imucal.noise.terms import TERMS, GaussMarkov
from imucal.prediction import DriftPoint
from imucal.recording import Sensor
from imucal.units import DATASHEET_UNITS, DatasheetUnit, duration, pretty

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
#: At a larger ratio of the sides, the interval is printed instead of a symmetric uncertainty.
_ASYMMETRY = 1.25
#: Longer numbers are written with an exponent.
_LONGEST = 10
#: Smaller drifts are printed in thousandths.
_SMALL = 0.1


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A value with its limits and unit; `value` is None if only the bound `high` is known.

    `in_model` is the coefficient in the model of a bounded term.
    """

    value: float | None
    low: float
    high: float
    unit: str = ""
    in_model: float | None = None

    @classmethod
    def of(cls, known: Any, unit: str = "") -> "Quantity":  # noqa: ANN401
        return cls(value=known.value, low=known.low, high=known.high, unit=unit)

    @classmethod
    def exactly(cls, value: float) -> "Quantity":
        return cls(value=value, low=value, high=value)

    def scaled(self, factor: float, unit: str = "") -> "Quantity":
        value, in_model = (None if x is None else x * factor for x in (self.value, self.in_model))
        low, high = self.low * factor, self.high * factor
        return Quantity(value=value, low=low, high=high, unit=unit, in_model=in_model)

    def text(self) -> str:
        """Return ``0.41 [0.4, 0.42]``, ``<= 0.2`` for a bound, or only the number."""
        value, low, high = self.value, self.low, self.high
        if value is not None:
            return f"{value:.6g}" if low == high else f"{value:.4g} [{low:.4g}, {high:.4g}]"
        if math.isinf(high):
            return f">= {low:.4g}" if low else "unknown"
        return f"[{low:.4g}, {high:.4g}]" if low > 0 else f"<= {high:.4g}"

    @property
    def size(self) -> float:
        """Magnitude that determines the power of ten."""
        return abs(self.high if self.value is None else self.value)


def gauss_markov_term(fit: NoiseFit, estimate: Estimate) -> GaussMarkov | None:
    """Return the term of an estimate; None if it is bounded or not in the model."""
    term = fit.terms_in_model.get(estimate.key) if estimate.value is not None else None
    return term if isinstance(term, GaussMarkov) else None


def term_name(symbol: str, sensor: Sensor | None) -> str:
    """Return the usual name of a term; its meaning if the sensor is unknown."""
    return TERMS[symbol].name(sensor) if sensor else TERMS[symbol].description.meaning


def si(estimate: Estimate, sensor: Sensor | None) -> Quantity:
    """Return a coefficient in SI; without a unit if the sensor is unknown."""
    unit = TERMS[estimate.symbol].unit(sensor) if sensor else ""
    found = Quantity.of(estimate, unit)
    return found if found.value is not None else replace(found, in_model=estimate.in_model)


def datasheet(estimate: Estimate, sensor: Sensor | None) -> Quantity:
    """Return a coefficient in the unit of data sheets; in SI if the sensor is unknown."""
    if sensor is None:
        return si(estimate, sensor)
    unit = TERMS[estimate.symbol].datasheet_unit(sensor)
    return si(estimate, sensor).scaled(unit.factor, unit.name)


def correlation_time(interval: Interval) -> Quantity:
    """Return a correlation time in s."""
    return Quantity.of(interval, "s")


def drifted(point: DriftPoint, unit: str) -> Quantity:
    """Return a drift in deg, m/s or m, or thousandths; `unit` is rad, m/s or m."""
    known = Quantity.of(point, unit)
    if unit == "rad":
        known = known.scaled(math.degrees(1), "deg")
    return known if known.size >= _SMALL else known.scaled(1e3, f"m{known.unit}")


def minimum(fit: NoiseFit) -> Quantity:
    """Return the curve's minimum and its interval, in SI; it is biased low."""
    adev, tau = fit.curve.minimum
    low, high = fit.curve.confidence_interval(fit.level)
    at = int(np.flatnonzero(fit.curve.tau == tau)[0])
    known = math.isfinite(low[at]) and math.isfinite(high[at])
    limits = (float(low[at]), float(high[at])) if known else (adev, adev)
    return Quantity(value=adev, low=limits[0], high=limits[1], unit=fit.sensor.unit if fit.sensor else "")


@dataclass(frozen=True, kw_only=True)
class SheetUnits:
    """Units of a sensor: `density` for N and roots of psds; `level` for Allan deviations, B and sigma."""

    level: DatasheetUnit
    density: DatasheetUnit

    def estimate(self, estimate: Estimate, sensor: Sensor | None) -> Quantity:
        return datasheet(estimate, sensor)

    def minimum(self, fit: NoiseFit) -> Quantity:
        return minimum(fit).scaled(self.level.factor, self.level.name)


def sheet_units(fits: Sequence[NoiseFit]) -> SheetUnits:
    """Return deg/h and deg/√h, or µg and m/s/√h; the unit of the samples if the sensor is unknown."""
    sensor = fits[0].sensor
    if sensor is None:
        return SheetUnits(level=DatasheetUnit("", 1.0), density=DatasheetUnit("", 1.0))
    return SheetUnits(level=TERMS["B"].datasheet_unit(sensor), density=TERMS["N"].datasheet_unit(sensor))


def alternatives(estimate: Estimate) -> str:
    """Return ``or GM`` if another term fits as well, otherwise an empty text.

    With ``or GM, T > 310 s``, the terms do not differ for times up to T.
    """
    text = f"or {' or '.join(estimate.alternatives)}" if estimate.alternatives else ""
    return f"{text}, T > {seconds(estimate.horizon_s)}" if math.isfinite(estimate.horizon_s) else text


def seconds(value: float) -> str:
    """Return a time with three digits and no exponent, such as ``2620 s``."""
    return f"{float(f'{value:.3g}'):.10g} s"


def recorded(duration_s: float, rate_hz: float) -> str:
    """Return ``12 min at 50 Hz``."""
    return f"{duration(duration_s)} at {rate_hz:.6g} Hz"


def decimals(quantity: Quantity) -> int:
    """Return the decimal places that the interval supports, possibly negative."""
    if quantity.value is None:
        return _places(quantity.high, 2)
    half = (quantity.high - quantity.low) / 2
    if not math.isfinite(half):
        return _places(quantity.value, 2)
    if half == 0:
        return _places(quantity.value, 4)
    if half <= 1e-4 * abs(quantity.value):
        return _places(quantity.value, 5)
    return max(_places_of_half(half), _places(quantity.value, 2))


def _places_of_half(half: float) -> int:
    """Return the decimal places of half an interval: two digits up to 35, otherwise one."""
    exponent = math.floor(math.log10(half))
    # 950 and more round up to 1000.
    return -exponent + (half / 10.0**exponent < 3.55)


def power_of_ten(quantity: Quantity) -> int:
    """Return the exponent of the size; 0 for 0.01 to 99999 and in data-sheet units."""
    if quantity.unit in DATASHEET_UNITS or not (math.isfinite(quantity.size) and quantity.size > 0):
        return 0
    exponent = math.floor(math.log10(quantity.size))
    return 0 if -2 <= exponent <= 4 else exponent


def engineering_exponent(quantities: Iterable[Quantity]) -> int:
    """Return one exponent, a multiple of three, that fits the largest value.

    Bounds count only if there is no value. The exponent is 0 in data-sheet units, because 0.0059 m/s/√h is
    easier to read than 5.9 in a unit of 1e-3 m/s/√h.
    """
    known = [q for q in quantities if math.isfinite(q.size) and q.size > 0]
    sizes = [q.size for q in known if q.value is not None] or [q.size for q in known]
    if not sizes or known[0].unit in DATASHEET_UNITS:
        return 0
    size = math.log10(max(sizes))
    # Half a decade of tolerance: 0.54e-3 is better than 540e-6.
    return 0 if -2 <= size < 5 else 3 * math.floor((size + 0.5) / 3)


def compact(quantity: Quantity, *, exponent: int = 0) -> tuple[str, str]:
    """Return value and interval over ``10**exponent``, such as ``("0.2013", "[0.2010, 0.2016]")``.

    A bound is ``("< 0.12", "")``, or ``("< 0.12", "(model: 0.07)")`` if the model contains the term.
    """
    scaled = quantity.scaled(10.0**-exponent, quantity.unit)
    if scaled.value is None:
        drawn = "" if scaled.in_model is None else f"(model: {_fixed(scaled.in_model, decimals(scaled))})"
        return _bound(scaled.high), drawn
    places = decimals(scaled)
    value = _fixed(scaled.value, places)
    if scaled.low == scaled.high:
        return value, ""
    high = _fixed(scaled.high, places) if math.isfinite(scaled.high) else "?"
    return value, f"[{_fixed(scaled.low, places)}, {high}]"


def with_uncertainty(quantity: Quantity, *, exponent: int | None = None) -> str:
    """Return ``0.2013 ± 0.0003 deg/√h``, ``12.1 [11.2, 13.9] deg/h`` or ``< 0.12 deg/h/√h``.

    `exponent` is the common power of ten, by default the quantity's own.
    """
    exponent = power_of_ten(quantity) if exponent is None else exponent
    scaled = quantity.scaled(10.0**-exponent, quantity.unit)
    value, interval = compact(scaled)
    if not (interval and _symmetric(scaled)):
        return with_interval(quantity, exponent=exponent)
    body = f"{value} ± {_fixed((scaled.high - scaled.low) / 2, decimals(scaled))}"
    return with_unit(f"({body})" if exponent else body, exponent, quantity.unit)


def value_and_half(value: float, half: float) -> tuple[str, str]:
    """Return a value of either sign and half of its interval, such as ``-0.133`` and ``0.011``."""
    if not (math.isfinite(half) and half > 0):
        return f"{value:.6g}", f"{half:.2g}"
    places = _places_of_half(half)
    return _fixed(value, places), _fixed(half, places)


def with_interval(quantity: Quantity, *, exponent: int | None = None) -> str:
    """Return ``0.2013 [0.2010, 0.2016] deg/√h`` or ``< 0.12 deg/h/√h``."""
    exponent = power_of_ten(quantity) if exponent is None else exponent
    value, interval = compact(quantity, exponent=exponent)
    return with_unit(f"{value} {interval}".rstrip(), exponent, quantity.unit)


def with_unit(body: str, exponent: int, unit: str) -> str:
    """Return ``0.2013 ×10⁻⁵ deg/√h``; no power of ten if `exponent` is 0."""
    return f"{body}{f' ×{ten_to(exponent)}' if exponent else ''} {pretty(unit)}"


def ten_to(exponent: int) -> str:
    """Return ``10⁻⁵``."""
    return f"10{str(exponent).translate(_SUPERSCRIPTS)}"


def scientific(value: float) -> str:
    """Return three digits, such as ``0.0332`` or ``1.49 ×10⁻⁵``."""
    if not (math.isfinite(value) and value):
        return f"{value:g}"
    # Rounding may carry into the next decade.
    mantissa, exponent = f"{value:.2e}".split("e")
    if -3 <= int(exponent) <= 3:
        return f"{float(f'{value:.3g}'):g}"
    return f"{mantissa} ×{ten_to(int(exponent))}"


def _symmetric(quantity: Quantity) -> bool:
    if quantity.value is None or not math.isfinite(quantity.high):
        return False
    below, above = quantity.value - quantity.low, quantity.high - quantity.value
    return below > 0 and above > 0 and 1 / _ASYMMETRY < above / below < _ASYMMETRY


def _places(size: float, digits: int) -> int:
    if not (math.isfinite(size) and size):
        return 0
    exponent = math.floor(math.log10(abs(size)))
    # Rounding may carry: 0.0996 with two digits is 0.10.
    if abs(round(size, digits - 1 - exponent)) >= 10.0 ** (exponent + 1):
        exponent += 1
    return digits - 1 - exponent


def _bound(high: float) -> str:
    if not math.isfinite(high):
        return "unknown"
    return f"< {rounded_up(high, 2)}" if high else "0"


def rounded_up(bound: float, digits: int) -> str:
    """Round a bound up to `digits` digits."""
    places = digits - 1 - math.floor(math.log10(bound))
    # A rounding error must not turn 0.12 into 0.13.
    raised = math.ceil(bound * 10.0**places * (1 - 1e-12)) / 10.0**places
    return _fixed(raised, places)


def _in_powers(value: float, places: int) -> str:
    """Return a number such as ``1.45e-9``: the digits that `places` decimal places show, but 2 to 5."""
    exponent = math.floor(math.log10(abs(value)))
    mantissa, power = f"{value:.{min(max(places + exponent, 1), 4)}e}".split("e")
    whole, _, part = mantissa.partition(".")
    return f"{whole}.{part.rstrip('0') or '0'}e{int(power)}"


def _fixed(value: float, places: int) -> str:
    text = f"{round(value, places):.{max(places, 0)}f}"
    if len(text) > _LONGEST:
        return _in_powers(value, places) if value else "0"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text
