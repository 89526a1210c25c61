"""The three pictures of a calibration: length of gravity at rest, attitudes, and residuals of the turns."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from imucal._version import __version__
from imucal.arrays import FloatArray
from imucal.calibration.result import Calibration
from imucal.calibration.table import headline
from imucal.report import figure as drawing
from imucal.report.figure_style import (
    AXES,
    FADED,
    FRAME,
    GRID,
    INK,
    LABEL_SIZE,
    LABEL_STYLE,
    LEFT_OUT,
    LEGEND_SIZE,
    LEGEND_STYLE,
    MODEL,
    Style,
    limits,
    new_figure,
    quiet_frame,
    write_foot,
    write_head,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["FIGURES", "picture"]

#: Width of a picture, in inches.
_WIDTH = 10.0
#: Height of a picture, in inches.
_HEIGHT = 4.3
#: Height of the title, in inches.
_HEAD = 0.8
#: Height of the lower axis and the last line, in inches.
_FOOT = 0.8
#: Half-width of a 95 % interval in deviations.
_Z95 = 1.959964
#: Colour of values before the calibration.
_BEFORE = FADED
#: Colour of values after the calibration.
_AFTER = MODEL.light
#: Colour of values that are not used.
_UNUSED = LEFT_OUT


def picture(found: Calibration, name: str) -> bytes:
    """Return a picture of `FIGURES` as a PNG file."""
    return drawing.render(FIGURES[name](found), "png", version=__version__)


def rests_figure(found: Calibration) -> "Figure":
    """Return |f| - g of each rest over time, before and after, with 95 % intervals."""
    figure = _new(found, "Gravity at rest", "length of the specific force minus g, with 95 % intervals")
    time = np.array([(rest.start_s + rest.end_s) / 120 for rest in found.rests])
    used = np.array([rest.used for rest in found.rests])
    after = 1e3 * np.array([rest.residual for rest in found.rests])
    before = 1e3 * np.array([rest.before for rest in found.rests])
    half = 1e3 * _Z95 * np.array([rest.sigma or 0.0 for rest in found.rests])
    counts = found.accelerometer.parameters["bias_x"].unit == "raw"
    places = [(0.075, 0.9)] if counts else [(0.075, 0.4), (0.575, 0.4)]
    for k, (left, width) in enumerate(places):
        axes = _axes(figure, left, width, "time (min)", "|f| - g (mm/s²)")
        axes.axhline(0.0, color=FRAME, linewidth=1.0)
        first = k == 0 and not counts
        values, colour = (before, _BEFORE) if first else (after, _AFTER)
        axes.set_title("before" if first else "after", fontsize=LABEL_SIZE, color=INK)
        bars = np.zeros_like(half) if first else half
        axes.errorbar(
            time[used], values[used], yerr=bars[used], color=colour, fmt="o", markersize=4.5, elinewidth=1.2
        )
        if not used.all():
            style: Style = {"color": _UNUSED, "marker": "x", "linestyle": "none"}
            axes.plot(time[~used], values[~used], label="moved, not used", **style)
            axes.legend(loc="best", **LEGEND_STYLE)
    return figure


def attitudes_figure(found: Calibration) -> "Figure":
    """Return where down pointed at each rest, on two equal-area discs, and the rest that would help most."""
    figure = _new(found, "Attitudes", "direction of gravity; each disc is half of the sphere, equal-area")
    down = -np.array([rest.up for rest in found.rests])
    used = np.array([rest.used for rest in found.rests])
    suggested = np.array([found.accelerometer.suggestion.down])
    for left, sign in ((0.02, 1.0), (0.52, -1.0)):
        height = 1 - (_HEAD + 0.35) / _HEIGHT
        axes = figure.add_axes((left, 0.35 / _HEIGHT, 0.46, height))
        axes.set_aspect("equal")
        axes.axis("off")
        axes.set_xlim(-2.4, 2.4)
        axes.set_ylim(-1.75, 1.75)
        circle = np.linspace(0, 2 * math.pi, 200)
        for radius in (math.sqrt(2), 2 * math.sin(math.pi / 8)):
            axes.plot(radius * np.cos(circle), radius * np.sin(circle), color=GRID, linewidth=1.2)
        _name_axes(axes, sign)
        _mark(axes, down[used], sign, color=_AFTER, marker="o", label="rest")
        _mark(axes, down[~used], sign, color=_UNUSED, marker="x", label="rest that moved")
        _mark(axes, suggested, sign, color=AXES["x"].light, marker="*", label="add this one", size=14.0)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="upper left", bbox_to_anchor=(-0.02, 1.03), **LEGEND_STYLE)
    return figure


def turns_figure(found: Calibration) -> "Figure":
    """Return the error of gravity's direction after each turn, before and after the calibration."""
    errors = "error of gravity's direction"
    if any(turn.known_deg is not None for turn in found.turns):
        errors += " and of a known angle"
    figure = _new(found, "Turns", f"{errors} after integrating the gyroscope through a turn")
    axes = _axes(figure, 0.075, 0.9, "time (min)", "error (deg)")
    judged = [turn for turn in found.turns if turn.residual_deg is not None and turn.before_deg is not None]
    if not judged:
        axes.text(0.5, 0.5, "no turn could be used", transform=axes.transAxes, ha="center", color=INK)
        return figure
    time = np.array([(turn.start_s + turn.end_s) / 120 for turn in judged])
    used = np.array([turn.used for turn in judged])
    before = np.array([math.hypot(*(turn.before_deg or (0.0, 0.0))) for turn in judged])
    after = np.array([math.hypot(*(turn.residual_deg or (0.0, 0.0))) for turn in judged])
    dots: Style = {"linestyle": "none", "markersize": 5.5}
    axes.plot(time, before, color=_BEFORE, marker="o", markerfacecolor="white", label="before", **dots)
    axes.plot(time[used], after[used], color=_AFTER, marker="o", label="after", **dots)
    if not used.all():
        axes.plot(time[~used], after[~used], color=_UNUSED, marker="x", label="after, not used", **dots)
    low, high = limits(np.concatenate([before, after]), below=2.0, above=3.0)
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    axes.legend(loc="upper right", ncols=3, **LEGEND_STYLE)
    return figure


#: Name of a picture's file without ending -> function that draws it.
FIGURES: dict[str, Callable[[Calibration], "Figure"]] = {
    "rests": rests_figure,
    "attitudes": attitudes_figure,
    "turns": turns_figure,
}


def _new(found: Calibration, title: str, subtitle: str) -> "Figure":
    figure = new_figure(_WIDTH, _HEIGHT)
    write_head(figure, title, subtitle)
    write_foot(figure, headline(found), __version__)
    return figure


def _axes(figure: "Figure", left: float, width: float, x: str, y: str) -> "Axes":
    axes = figure.add_axes((left, _FOOT / _HEIGHT, width, 1 - (_HEAD + _FOOT) / _HEIGHT))
    quiet_frame(axes)
    axes.set_xlabel(x, **LABEL_STYLE)
    axes.set_ylabel(y, **LABEL_STYLE)
    axes.tick_params(labelsize=LEGEND_SIZE, colors=INK)
    axes.grid(visible=True, which="major", color=GRID, linewidth=0.8)
    return axes


def _flat(down: FloatArray, sign: float) -> FloatArray:
    """Return Lambert's equal-area map of directions onto the disc of their half.

    Source: Snyder (1987), Map Projections: A Working Manual, USGS 1395, chapter 24.
    """
    factor = np.sqrt(2 / (1 + np.clip(sign * down[:, 2], 0.0, 1.0)))
    # The half with -z is seen from the other side.
    return np.column_stack([sign * down[:, 0] * factor, down[:, 1] * factor])


def _mark(
    axes: "Axes", down: FloatArray, sign: float, *, color: str, marker: str, label: str, size: float = 7.0
) -> None:
    here = down[(sign * down[:, 2] > 0) | ((down[:, 2] == 0) & (sign > 0))]
    if len(here):
        x, y = _flat(here, sign).T
        axes.plot(x, y, color=color, marker=marker, markersize=size, linestyle="none", label=label, zorder=4)


def _name_axes(axes: "Axes", sign: float) -> None:
    style: Style = {"fontsize": LABEL_SIZE, "color": FADED, "va": "center"}
    edge = math.sqrt(2) + 0.16
    axes.text(0.0, -0.13, f"{'+' if sign > 0 else '-'}z", ha="center", **style)
    axes.plot(0.0, 0.0, color=FADED, marker="+", markersize=6)
    right, left = ("+x", "-x") if sign > 0 else ("-x", "+x")
    for x, y, name in ((edge, 0.0, right), (-edge, 0.0, left), (0.0, edge, "+y"), (0.0, -edge, "-y")):
        axes.text(x, y, name, ha="center", **style)
