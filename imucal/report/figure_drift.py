"""The picture of a drift: angles, velocities and positions over time, with limits and contributions."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from imucal.prediction import Drift, DriftOf, drift
from imucal.report import numbers
from imucal.report.figure import WIDTH
from imucal.report.figure_style import (
    AXES,
    FADED,
    GRID,
    INK,
    LEGEND_STYLE,
    MODEL,
    SMALL_SIZE,
    Style,
    limits,
    new_figure,
    stroked,
    style_axes,
    write_foot,
    write_head,
)
from imucal.report.result import Report
from imucal.units import duration

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Inches: height of a picture, of its head and of its foot, and space for the labels left of a curve.
_HEIGHT = 4.3
_HEAD = 0.75
_FOOT = 0.75
_SPACE = 0.62
#: Points of a line.
_POINTS = 25
#: Space for the first label, as a fraction of the axis.
_ROOM = 0.36
_PARTS = {"accelerometer": AXES["x"], "tilt": AXES["z"]}


def drift_figure(report: Report, found: Drift) -> "Figure":
    """Return one plot per kind of quantity, with the given times marked."""
    asked = [point.time_s for point in found.quantities[0].points]
    fine = np.geomspace(min(asked), max(asked), _POINTS)
    lines = drift(report, sorted({*asked, *fine[1:-1].tolist()}), rest_s=found.rest_s)
    units = list(dict.fromkeys(quantity.unit for quantity in lines.quantities))
    figure = new_figure(WIDTH, _HEIGHT)
    width, height = 1 / len(units), 1 - (_HEAD + _FOOT) / _HEIGHT
    for place, unit in enumerate(units):
        left = place * width + _SPACE / WIDTH
        axes = figure.add_axes((left, _FOOT / _HEIGHT, width - (_SPACE + 0.12) / WIDTH, height))
        _draw(axes, [quantity for quantity in lines.quantities if quantity.unit == unit], set(asked))
    upright = f"   ·   {found.vertical} is vertical" if found.vertical else ""
    message = (
        f"one standard deviation, {100 * found.level:.4g} % limits   ·   each sensor's worst axis{upright}"
    )
    title = f"Drift without aiding, after a rest of {duration(found.rest_s)}"
    write_head(figure, title, message if report.verdict.usable else report.verdict.sentence)
    write_foot(figure, report.source.name, report.version)
    return figure


def _draw(axes: "Axes", quantities: Sequence[DriftOf], asked: set[float]) -> None:
    """Draw quantities of one unit over time; their total, or the first angle, has limits."""
    radians = quantities[0].unit == "rad"
    main, factor = (quantities[0], math.degrees(1)) if radians else (quantities[-1], 1.0)
    values = [
        factor * np.array([point.value or point.high for point in quantity.points]) for quantity in quantities
    ]
    time, low, high = (
        np.array([getattr(p, name) for p in main.points]) for name in ("time_s", "low", "high")
    )
    bottom, top = limits(np.concatenate([*values, factor * high]), below=12.0, above=12.0)
    style_axes(
        axes,
        x="time without aiding (s)",
        y=f"{'angle' if radians else main.kind} ({'deg' if radians else main.unit})",
        x_limits=(time[0] / max(3.0, (time[-1] / time[0]) ** _ROOM), time[-1] * 1.3),
        y_limits=(bottom, top),
    )
    for quantity, value in zip(quantities, values, strict=True):
        label = quantity.through or quantity.kind
        stroke = MODEL if quantity is main else _PARTS[label]
        axes.plot(time, value, label=label, zorder=4, **stroked(stroke, linewidth=1.6))
    band: Style = {"color": MODEL.light, "alpha": 0.18, "linewidth": 0}
    axes.fill_between(time, np.maximum(factor * low, bottom), factor * high, where=np.isfinite(high), **band)
    axes.legend(loc="upper left", **LEGEND_STYLE)
    _mark(axes, main, values[quantities.index(main)].tolist(), asked)


def _mark(axes: "Axes", main: DriftOf, heights: list[float], asked: set[float]) -> None:
    """Label value and dominant term at the `asked` times; shade times beyond the record."""
    small: Style = {"fontsize": SMALL_SIZE, "ha": "right"}
    for point, height in zip(main.points, heights, strict=True):
        if point.time_s in asked and math.isfinite(height):
            place = (point.time_s, height)
            axes.plot(*place, color=MODEL.light, marker="o", markersize=4.5, zorder=5)
            shown = numbers.drifted(point, main.unit)
            text = f"{'< ' if shown.value is None else ''}{float(f'{shown.size:.2g}'):.10g} {shown.unit}"
            text += f"\n{point.term}" if point.term else ""
            axes.annotate(text, place, xytext=(-4, 3), textcoords="offset points", color=INK, **small)
    unseen = [point.time_s for point in main.points if point.seen is False]
    if unseen:
        right = axes.get_xlim()[1]
        axes.axvspan(unseen[0], right, color=GRID, alpha=0.6, linewidth=0, zorder=0)
        bottom = axes.get_xaxis_transform()
        axes.text(right, 0.02, "extrapolated ", color=FADED, transform=bottom, **small)
