"""`imucal.plot`: recordings, curves, fits and reports in the style of the report's pictures."""

from typing import TYPE_CHECKING, Any

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.errors import ArgumentError
from imucal.fitting.noise_fit import NoiseFit
from imucal.recording import AxisSeries, Recording, Sensor
from imucal.report import figure as drawing
from imucal.report.figure_curves import draw_allan, draw_allan_overview, shown_points, style_allan
from imucal.report.figure_style import (
    AXES,
    DATA,
    DOTS,
    INK,
    LABEL_STYLE,
    LEGEND_STYLE,
    MODEL,
    Style,
    limits,
    name_axes,
    quiet_frame,
)
from imucal.report.numbers import sheet_units
from imucal.report.result import AxisReport, Overview, Report
from imucal.units import pretty, time_unit

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

__all__ = ["plot"]

#: Size of the drawing of one sensor, in inches.
_WIDTH = 6.4
_HEIGHT = 4.2
_STRETCHES = 800


def plot(value: object, ax: "Axes | Sequence[Axes] | None" = None) -> "Axes | tuple[Axes, ...]":
    """Draw a value in the report's style, with named units.

    Parameters
    ----------
    value
        A recording or one of its axes (the lowest and highest sample of each stretch of time), an Allan
        curve, a fit or an axis of a report (curve, model and terms), or a report (the curves of each sensor).
    ax
        Matplotlib's axes to draw in; for a recording or a report, one for each sensor. By default a new
        figure of pyplot, which a notebook shows.

    Returns
    -------
    The axes; for a recording or a report a tuple, the gyroscope's first.

    Raises
    ------
    ArgumentError
        If there is no picture for this type, or if the number of axes is not the number of sensors.
    """
    if isinstance(value, Recording | Report):
        parts: Sequence[Any] = value.series if isinstance(value, Recording) else value.axes
        each = {s: own for s in Sensor if (own := [part for part in parts if part.sensor is s])}
        places = _places(ax, len(each))
        for place, (sensor, parts) in zip(places, each.items(), strict=True):
            _draw_sensor(parts, place)
            place.set_title(str(sensor).capitalize(), loc="left", color=INK, fontweight="bold")
        return places
    (place,) = _places(ax, 1)
    _draw(value, place)
    return place


def _places(ax: "Axes | Sequence[Axes] | None", count: int) -> "tuple[Axes, ...]":
    if ax is None:
        import matplotlib.pyplot as plt

        width = _WIDTH * (1 + 0.9 * (count - 1))
        figure, made = plt.subplots(1, count, squeeze=False, figsize=(width, _HEIGHT))
        # The layout must be final before labels are placed.
        left, room = 0.75 / width, 0.28
        figure.subplots_adjust(left=left, right=1 - 0.15 / width, top=0.92, bottom=room, wspace=3 * left)
        return tuple(made[0])
    given = tuple(np.ravel(np.asarray(ax, dtype=object)))
    if len(given) != count:
        msg = f"found {len(given)} axes, expected {count}, one for each sensor; give {count} axes or none"
        raise ArgumentError(msg)
    return given


def _draw_sensor(parts: list[Any], axes: "Axes") -> None:
    if isinstance(parts[0], AxisReport):
        draw_allan_overview(axes, parts, sheet_units([axis.fit for axis in parts]))
        name_axes(axes, parts)
        return
    for series in parts:
        _draw_signal(series, axes)
    axes.legend(loc="upper right", **LEGEND_STYLE)


def _draw(value: object, axes: "Axes") -> None:
    match value:
        case AxisSeries():
            _draw_signal(value, axes)
        case AllanCurve():
            _draw_curve(value, axes)
        case NoiseFit():
            _draw_fit(value, axes)
        case AxisReport():
            _draw_fit(value.fit, axes)
            axes.set_title(drawing.axis_title(value), loc="left", color=INK, fontweight="bold")
        case _:
            known = "a recording, one of its axes, an Allan curve, a fit or a report"
            raise ArgumentError(f"{type(value).__name__} can't be plotted; give {known}")


def _draw_signal(series: AxisSeries, axes: "Axes") -> None:
    seen = Overview.of(series, stretches=_STRETCHES)
    divisor, name = time_unit(series.duration_s)
    mean = float(np.nanmean((seen.low + seen.high) / 2)) if seen.low.size else 0.0
    style: Style = {"color": AXES[series.axis].light, "alpha": 0.45, "linewidth": 0.5}
    axes.fill_between(seen.time_s / divisor, seen.low - mean, seen.high - mean, label=series.axis, **style)
    quiet_frame(axes)
    axes.set_xlabel(f"time ({name})", **LABEL_STYLE)
    axes.set_ylabel(f"samples minus their middle ({pretty(series.unit)})", **LABEL_STYLE)


def _draw_curve(curve: AllanCurve, axes: "Axes") -> None:
    shown = shown_points(curve)
    tau, adev = curve.tau[shown], curve.adev[shown]
    y_limits = limits(adev, below=2.2, above=2.2)
    style_allan(axes, "unit of the samples", tau, y_limits)
    low, high = (limit[shown] for limit in curve.confidence_interval())
    band: Style = {"color": MODEL.light, "alpha": 0.2, "linewidth": 0}
    axes.fill_between(tau, low, high, label="95 % interval", **band)
    axes.plot(tau, adev, color=DATA.light, label=curve.estimator, **DOTS)
    axes.legend(**LEGEND_STYLE)


def _draw_fit(fit: NoiseFit, axes: "Axes") -> None:
    entries = draw_allan(axes, fit, sheet_units([fit]))
    axes.legend(handles=entries, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, **LEGEND_STYLE)
