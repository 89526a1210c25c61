"""The pictures of a temperature ramp: bias and what is left over the temperature, heating and cooling."""

from typing import TYPE_CHECKING

import numpy as np

from imucal._version import __version__
from imucal.arrays import FloatArray
from imucal.recording import Sensor
from imucal.report import figure as drawing
from imucal.report.figure_style import (
    AXES,
    DATA,
    FRAME,
    GRID,
    INK,
    LABEL_STYLE,
    LEGEND_SIZE,
    LEGEND_STYLE,
    MODEL,
    Style,
    new_figure,
    quiet_frame,
    write_foot,
    write_head,
)
from imucal.temperature.result import AxisThermal, Shown, Thermal
from imucal.temperature.table import UNITS, headline

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["DESCRIPTION", "picture"]

#: What a picture shows, for readers who can't see it.
DESCRIPTION = (
    "Bias of each axis over the temperature while heating and cooling, with the curve and its 95 % interval, "
    "and next to it what the curve leaves."
)
#: Width of a picture, in inches.
_WIDTH = 10.0
#: Height of the plots of one axis, in inches.
_ROW = 2.5
#: Height of the title and the legend, in inches.
_HEAD = 0.75
#: Height of the lower scale and the last line, in inches.
_FOOT = 0.8
#: Space between the plots of two axes, in inches.
_BETWEEN = 0.3
#: Colour of heating: orange.
_HEATING = AXES["x"].light
#: Colour of cooling: blue.
_COOLING = AXES["y"].light
#: Points of a curve.
_POINTS = 200


def picture(found: Thermal, sensor: Sensor) -> bytes:
    """Return the picture of a sensor as a PNG file."""
    return drawing.render(sensor_figure(found, sensor), "png", version=__version__)


def sensor_figure(found: Thermal, sensor: Sensor) -> "Figure":
    """Return bias and rest of each axis of a sensor over the temperature."""
    # A result that was read from a file shows nothing.
    axes = [(one, one.shown) for one in found.axes if one.sensor is sensor and one.shown is not None]
    height = _HEAD + _FOOT + len(axes) * _ROW
    figure = new_figure(_WIDTH, height)
    write_head(
        figure,
        f"{sensor.capitalize()} over temperature",
        "left: bias less its mean, and the curve at a steady temperature; right: what compensation leaves",
    )
    write_foot(figure, headline(found), __version__)
    for place, (one, shown) in enumerate(axes):
        bottom = (_FOOT + (len(axes) - 1 - place) * _ROW) / height
        share = (_ROW - _BETWEEN) / height
        bias = figure.add_axes((0.09, bottom, 0.39, share))
        left = figure.add_axes((0.58, bottom, 0.39, share))
        _draw_bias(bias, one, shown)
        _draw_left(left, one, shown)
        last = place == len(axes) - 1
        for plot in (bias, left):
            _style(plot, last=last)
        if not place:
            bias.legend(
                loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=4, borderaxespad=0.2, **LEGEND_STYLE
            )
    return figure


def _draw_bias(plot: "Axes", axis: AxisThermal, shown: Shown) -> None:
    unit, factor = UNITS[axis.sensor]
    curve = axis.curve
    mean = float(shown.bias.mean())
    _draw_branches(plot, shown, (shown.bias - mean) * factor)
    temperature = np.linspace(curve.low_c, curve.high_c, _POINTS)
    middle = (curve.static(temperature) - mean) * factor
    half = curve.half_width(temperature) * factor
    plot.fill_between(temperature, middle - half, middle + half, color=MODEL.light, alpha=0.25, linewidth=0)
    plot.plot(temperature, middle, color=DATA.light, linewidth=1.6, label="curve")
    plot.set_ylabel(f"{axis.name} ({unit})", **LABEL_STYLE)


def _draw_left(plot: "Axes", axis: AxisThermal, shown: Shown) -> None:
    unit, factor = UNITS[axis.sensor]
    plot.axhline(0.0, color=FRAME, linewidth=1.0)
    _draw_branches(plot, shown, shown.left * factor)
    plot.set_ylabel(f"left ({unit})", **LABEL_STYLE)


def _draw_branches(plot: "Axes", shown: Shown, values: FloatArray) -> None:
    heats = shown.heats > 0
    dots: Style = {"linestyle": "none", "markersize": 3.2}
    for chosen, color, marker, label in (
        (heats, _HEATING, "^", "heating"),
        (~heats, _COOLING, "v", "cooling"),
    ):
        if chosen.any():
            places = shown.temperature[chosen]
            plot.plot(places, values[chosen], color=color, marker=marker, label=label, **dots)


def _style(plot: "Axes", *, last: bool) -> None:
    quiet_frame(plot)
    if last:
        plot.set_xlabel("temperature (°C)", **LABEL_STYLE)
    else:
        plot.tick_params(labelbottom=False)
    plot.tick_params(labelsize=LEGEND_SIZE, colors=INK)
    plot.grid(visible=True, which="major", color=GRID, linewidth=0.8)
