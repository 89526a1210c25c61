"""The arguments of `imucal.read` that fix an error, with the words of the advice."""

from imucal.errors import Fix
from imucal.recording import Sensor

GIVE_RATE = Fix("give the sampling rate", "rate_hz", "HZ")
GIVE_TIME_UNIT = Fix("give the time unit", "time_unit", "UNIT")
NAME_TIME = Fix("name another time column", "time", "CLOCK")

# The problem's sentence already lists what is expected.
TIME = Fix("", "time", "CLOCK")
TIME_UNIT = Fix("", "time_unit", "UNIT")
TOPIC = Fix("", "topic", "NAME")
COLUMNS = Fix("", "columns", "TEXT")


def give_rates(*rates_hz: float) -> tuple[Fix, ...]:
    """Return the fixes that give one of several possible sampling rates."""
    first, *others = (f"{rate:.6g}" for rate in rates_hz)
    return Fix(GIVE_RATE.text, "rate_hz", first), *(Fix("", "rate_hz", rate) for rate in others)


def unit(sensor: Sensor, text: str = "") -> Fix:
    """Return the fix that gives the unit of a sensor."""
    return Fix(text, f"{sensor.short}_unit", "UNIT")


def unit_or_scale(sensor: Sensor) -> tuple[Fix, Fix]:
    """Return the fixes that give the unit of a sensor, or the scale of its counts."""
    scale = f"give the scale of its counts in {sensor.unit} per count"
    return unit(sensor, "give its unit"), Fix(scale, f"{sensor.short}_scale", "X")
