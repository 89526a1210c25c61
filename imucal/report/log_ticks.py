"""Ticks of logarithmic axes: few, readable, and a tenth of the drawing time of matplotlib's own.

Matplotlib makes an object of every minor tick, of which two log-log plots have hundreds, and sets
every power of ten by its formula parser. Here the minor ticks of an axis are one artist.
"""

import math
from collections.abc import Iterable
from itertools import product
from typing import TYPE_CHECKING

from imucal.report.palette import FRAME, GRID, INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SIZE = 9.0
#: Length of a minor tick, in parts of the plot.
_MINOR = 0.006
#: At most so many labelled ticks an axis.
_MOST = 8
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def draw_ticks(axes: "Axes") -> None:
    """Draw ticks and grid lines for the axes' present limits."""
    from matplotlib.collections import LineCollection
    from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator

    marks: list[list[tuple[float, float]]] = []
    for axis, horizontal in ((axes.xaxis, True), (axes.yaxis, False)):
        low, high = axis.get_view_interval()
        major, minor = tick_places(low, high)
        axis.set_major_locator(FixedLocator(major))
        axis.set_major_formatter(FixedFormatter([tick_label(place) for place in major]))
        axis.set_minor_locator(NullLocator())
        for place in minor:
            part = math.log(place / low) / math.log(high / low)
            # The plot is wider than it is high: equal lengths are different parts.
            marks.append([(part, 0.0), (part, 1.5 * _MINOR)] if horizontal else [(0.0, part), (_MINOR, part)])
    axes.add_collection(
        LineCollection(marks, colors=FRAME, linewidths=0.7, transform=axes.transAxes, zorder=1.5),
        autolim=False,
    )
    axes.tick_params(labelsize=_SIZE, colors=INK)
    axes.grid(visible=True, which="major", color=GRID, linewidth=0.8)


def tick_places(low: float, high: float) -> tuple[list[float], list[float]]:
    """Return the places of labelled and of minor ticks between two positive limits."""
    decades, inside = _multiples(low, high, (1,)), _multiples(low, high, range(1, 10))
    if len(decades) >= 3:
        step = math.ceil(len(decades) / _MOST)
        if step == 1:
            return decades, inside
        return [place for place in decades if round(math.log10(place)) % step == 0], decades
    major = _multiples(low, high, (1, 2, 5))
    if len(major) >= 2:
        return major, inside
    return (inside if len(inside) >= 2 else [low, high]), []


def _multiples(low: float, high: float, digits: Iterable[int]) -> list[float]:
    """Return ``digit * 10^e`` between two limits, rising, of every digit and whole e."""
    powers = [10.0**e for e in range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)]
    return [digit * power for power, digit in product(powers, digits) if low <= digit * power <= high]


def tick_label(value: float) -> str:
    """Return ``0.01`` … ``1000`` as they are, others as ``10⁻⁵`` or ``2×10⁻⁵``."""
    exponent = math.floor(math.log10(value) + 1e-9)
    if -2 <= exponent <= 3:
        return f"{value:.6g}"
    factor = round(value / 10.0**exponent, 6)
    power = f"10{str(exponent).translate(_SUPERSCRIPTS)}"
    return power if factor == 1 else f"{factor:g}×{power}"
