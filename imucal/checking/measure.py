"""Reports -> measured quantities, as limits ask for them."""

import math
from collections.abc import Iterable

from imucal.checking.verdict import Measured
from imucal.recording import Sensor
from imucal.report.result import AxisReport, Report


def axes_of(report: Report, where: str) -> tuple[AxisReport, ...]:
    """Return the axes that ``log``, a sensor or an axis name stands for."""
    return tuple(axis for axis in report.axes if where in ("log", axis.sensor, axis.name))


def measure(axis: AxisReport, quantity: str) -> tuple[tuple[str, Measured], ...]:
    """Return a quantity of an axis in SI, under its name; several for several Gauss-Markov terms."""
    gaps = len(axis.gaps)
    missing = sum(gap.missing for gap in axis.gaps)
    exact = {
        "rate": axis.rate_hz,
        "duration": axis.duration_s,
        "gaps": float(gaps),
        "missing": missing / (axis.samples + missing) if missing else 0.0,
        "mean": axis.mean,
        "std": axis.std,
    }
    if quantity in exact:
        return ((quantity, Measured.exactly(exact[quantity])),)
    if quantity == "minimum":
        return ((quantity, _minimum(axis)),)
    return tuple(
        (estimate.key, Measured(value=estimate.value, low=estimate.low, high=estimate.high))
        for estimate in axis.fit.estimates
        if estimate.symbol == quantity
    )


def relative(now: Measured, before: Measured) -> Measured:
    """Return the ratio of two independent quantities with its interval.

    The distances to the limits of both add in quadrature on the logarithmic scale (Zou & Donner
    2008, the MOVER method). A bound is between 0 and its upper limit.
    """
    if now.value is None or before.value is None:
        low = now.low / before.high if before.high else math.inf
        high = now.high / before.low if before.low else math.inf
        return Measured(value=None, low=low, high=high)
    ratio = now.value / before.value if before.value else math.inf
    down = math.hypot(_distance(now.low, now.value), _distance(before.value, before.high))
    up = math.hypot(_distance(now.value, now.high), _distance(before.low, before.value))
    return Measured(value=ratio, low=ratio * math.exp(-down), high=ratio * _exp(up))


def same_everywhere(axes: Iterable[AxisReport], quantity: str) -> bool:
    """Return whether a quantity of the clock is one for all axes."""
    return len({measure(axis, quantity) for axis in axes}) == 1


def sensors_of(axes: Iterable[AxisReport]) -> tuple[Sensor, ...]:
    """Return the sensors of some axes, each once."""
    return tuple(dict.fromkeys(axis.sensor for axis in axes))


def _minimum(axis: AxisReport) -> Measured:
    value, tau = axis.fit.curve.minimum
    low, high = axis.fit.curve.confidence_interval(axis.fit.level)
    index = int(abs(axis.fit.curve.tau - tau).argmin())
    if not (math.isfinite(low[index]) and math.isfinite(high[index])):
        return Measured.exactly(value)
    return Measured(value=value, low=float(low[index]), high=float(high[index]))


def _distance(low: float, high: float) -> float:
    return math.log(high / low) if low > 0 else math.inf


def _exp(x: float) -> float:
    return math.exp(x) if x < 700 else math.inf
