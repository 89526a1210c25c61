"""The units that a limit may be written in, for each quantity."""

from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.units import SAMPLE_UNITS

#: Terms of the model: their coefficients, sigma for GM.
TERM_QUANTITIES = tuple(TERMS)
#: Quantities in the unit of the samples: the curve's lowest deviation, mean and spread of the samples.
SAMPLE_QUANTITIES = ("minimum", "mean", "std")
#: Quantities of a recording: rate, length, number of gaps, missing samples as a fraction.
LOG_QUANTITIES = ("rate", "duration", "gaps", "missing")

_LOG_UNITS: dict[str, dict[str, float]] = {
    "rate": {"Hz": 1.0, "kHz": 1e3},
    "duration": {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0},
    "gaps": {"": 1.0},
    "missing": {"": 1.0, "%": 0.01, "ppm": 1e-6},
}

_SIGNS = (
    ("√(", "sqrt("),
    ("√Hz", "sqrt(Hz)"),
    ("√h", "sqrt(h)"),
    ("√s", "sqrt(s)"),
    ("²", "^2"),
    ("³", "^3"),
)
_LETTERS = (("°", "deg"), ("º", "deg"), ("µ", "u"), ("μ", "u"), (" ", ""), ("·", ""))


def quantity_units(quantity: str, sensor: Sensor) -> dict[str, float]:
    """Return the units of a quantity, the SI unit first, each with its factor to SI."""
    if quantity in LOG_QUANTITIES:
        return _LOG_UNITS[quantity]
    symbol = "B" if quantity in SAMPLE_QUANTITIES else quantity
    term = TERMS[symbol]
    units = {term.unit(sensor): 1.0}
    units |= {
        f"{name}{over}": factor * divisor
        for name, factor in SAMPLE_UNITS[sensor].items()
        for over, divisor in term.divisors.items()
    }
    datasheet = term.datasheet_unit(sensor)
    units[datasheet.name] = 1 / datasheet.factor
    if term.spellings:
        units[term.spellings[sensor is Sensor.ACCELEROMETER]] = 1.0
    return units


def plain_unit(text: str) -> str:
    """Return the ASCII spelling of a unit: ``°/√h`` becomes ``deg/sqrt(h)``."""
    for sign, plain in (*_SIGNS, *_LETTERS):
        text = text.replace(sign, plain)
    return text
