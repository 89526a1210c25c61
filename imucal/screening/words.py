"""Figures as a finding says them: spans of time, and amounts in SI with the data-sheet unit beside it."""

import math

from imucal.recording import Sensor
from imucal.units import G0


def time(seconds: float) -> str:
    """Return ``12.3 s``, ``4.5 min`` or ``2.25 h``.

    >>> time(12.34), time(600.0), time(10_000.0)
    ('12.3 s', '10 min', '2.78 h')
    """
    if seconds < 300:
        return f"{seconds:.3g} s" if seconds < 100 else f"{seconds:.0f} s"
    return f"{seconds / 60:.3g} min" if seconds < 7200 else f"{seconds / 3600:.3g} h"


def span(start_s: float, end_s: float) -> str:
    """Return ``12.3 to 15.2 s``: always in seconds, as these are what a person cuts by."""
    return f"{start_s:.1f} to {end_s:.1f} s"


def amount(value: float, sensor: Sensor) -> str:
    """Return ``0.0012 rad/s (0.0688 deg/s)`` or ``0.012 m/s^2 (1.22 mg)``."""
    if sensor is Sensor.GYROSCOPE:
        return f"{_figure(value)} rad/s ({_figure(math.degrees(value))} deg/s)"
    return f"{_figure(value)} m/s^2 ({_figure(value / G0 * 1e3)} mg)"


def _figure(value: float) -> str:
    """Return three digits, without an exponent where four or five digits say it as well."""
    return f"{value:.0f}" if 999.5 <= abs(value) < 1e5 else f"{value:.3g}"


def name_list(names: list[str]) -> str:
    """Return ``a``, ``a and b`` or ``a, b and c``."""
    if len(names) < 2:
        return "".join(names)
    return ", ".join(names[:-1]) + " and " + names[-1]
