"""The picture of a row: one function draws the evidence of each."""

from typing import TYPE_CHECKING

import numpy as np

from imucal._version import __version__
from imucal.health.diagnosis import Diagnosis, Row
from imucal.health.evidence import Curve, Evidence
from imucal.report import figure as drawing
from imucal.report.figure_style import (
    AXES,
    DATA,
    FADED,
    GRID,
    INK,
    LABEL_STYLE,
    LEFT_OUT,
    LEGEND_SIZE,
    LEGEND_STYLE,
    MODEL,
    SMALL_SIZE,
    Style,
    limits,
    new_figure,
    quiet_frame,
    stroked,
    style_axes,
    tick_label,
    tick_places,
    write_foot,
    write_head,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["picture", "row_figure"]

#: Width of a picture, in inches.
_WIDTH = 10.0
#: Height of a picture, in inches.
_HEIGHT = 4.0
#: Space for the label of the scale, as a share of the width.
_LEFT = 0.085
#: Space for the names of bars, as a share of the width.
_LEFT_OF_BARS = 0.2
#: Space for the texts of level limits, as a share of the width.
_RIGHT = 0.14
#: Height of the title and the legend, in inches.
_HEAD = 1.0
#: Height of the lower scale and the last line, in inches.
_FOOT = 0.8
#: Most points of a curve that are drawn as dots.
_MOST_DOTS = 160
#: Most marks that are rings around a sample; more would hide it.
_MOST_RINGS = 60
#: Size of a ring, in points.
_RING = 6.0
#: Size of a mark that is a dot, in points.
_DOT = 1.2
#: Colour of the background of rests.
_SHADE = "#e9f6ec"
#: Space above the highest point and below the lowest one, as a share of their distance.
_MARGIN = 0.08


def picture(diagnosis: Diagnosis, row: Row, evidence: Evidence) -> bytes:
    """Return the picture of a row as a PNG file."""
    return drawing.render(row_figure(diagnosis, row, evidence), "png", version=__version__)


def row_figure(diagnosis: Diagnosis, row: Row, evidence: Evidence) -> "Figure":
    """Return the picture of a row."""
    figure = new_figure(_WIDTH, _HEIGHT)
    write_head(figure, f"{row.name[:1].upper()}{row.name[1:]}", evidence.title)
    write_foot(figure, diagnosis.source.name, __version__)
    left = _LEFT_OF_BARS if evidence.names else _LEFT
    place = (left, _FOOT / _HEIGHT, 1 - left - _RIGHT, 1 - (_HEAD + _FOOT) / _HEIGHT)
    axes = figure.add_axes(place)
    _set_scales(axes, evidence)
    for k, (start, end) in enumerate(evidence.shaded):
        axes.axvspan(start, end, color=_SHADE, zorder=0, label=evidence.shade_label if k == 0 else None)
    colours = _colours(evidence)
    for curve, style in zip(evidence.curves, colours, strict=True):
        _draw(axes, curve, style)
    for limit in evidence.limits:
        style = {"color": FADED, "linewidth": 1.2, "dashes": (5, 3), "zorder": 1.5}
        text: Style = {"fontsize": SMALL_SIZE, "color": INK}
        if limit.upright:
            axes.axvline(limit.value, **style)
            axes.annotate(
                limit.label,
                (limit.value, 1.0),
                (3, 2),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                **text,
            )
        else:
            axes.axhline(limit.value, **style)
            axes.annotate(
                limit.label,
                (1.0, limit.value),
                (4, 0),
                xycoords=("axes fraction", "data"),
                textcoords="offset points",
                va="center",
                **text,
            )
    if evidence.names:
        axes.set_yticks(range(len(evidence.names)), evidence.names)
    elif axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.05), ncols=5, borderaxespad=0.0, **LEGEND_STYLE)
    return figure


def _set_scales(axes: "Axes", evidence: Evidence) -> None:
    if evidence.log_x and evidence.log_y:
        ends = [
            limits(np.concatenate([getattr(curve, name) for curve in evidence.curves]), below=1.5, above=1.5)
            for name in ("x", "y")
        ]
        style_axes(axes, x=evidence.x_label, y=evidence.y_label, x_limits=ends[0], y_limits=ends[1])
        return
    quiet_frame(axes)
    axes.set_xlabel(evidence.x_label, **LABEL_STYLE)
    axes.set_ylabel(evidence.y_label, **LABEL_STYLE)
    axes.tick_params(labelsize=LEGEND_SIZE, colors=INK)
    axes.grid(visible=True, which="major", color=GRID, linewidth=0.8)
    axes.margins(x=0.01, y=_MARGIN)
    if evidence.log_y:
        _make_logarithmic(axes, evidence)
    if evidence.names:
        axes.invert_yaxis()
        axes.set_xlim(0.0, 100.0)


def _make_logarithmic(axes: "Axes", evidence: Evidence) -> None:
    levels = [limit.value for limit in evidence.limits if not limit.upright]
    values = np.concatenate([levels, *(curve.y for curve in evidence.curves)])
    low, high = limits(values, below=1.5, above=1.5)
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    major, minor = tick_places(low, high)
    axes.set_yticks(major, [tick_label(value) for value in major])
    axes.set_yticks(minor, [""] * len(minor), minor=True)


def _colours(evidence: Evidence) -> list[Style]:
    """Return the style of each curve: a single one has the colour of data, several those of axes."""
    strokes = list(AXES.values())
    if sum(curve.look != "marks" for curve in evidence.curves) == 1:
        strokes = [DATA]
    elif any(curve.look == "dots" for curve in evidence.curves):
        strokes = [DATA, MODEL]
    styles: list[Style] = []
    for curve in evidence.curves:
        if curve.look == "marks":
            styles.append({"color": LEFT_OUT})
        else:
            styles.append(stroked(strokes[len(styles) % len(strokes)]))
    return styles


def _percent(share: float) -> str:
    return f"{share:.0f} %" if share >= 10 else f"{share:.2g} %"


def _draw(axes: "Axes", curve: Curve, style: Style) -> None:
    colour = style["color"]
    match curve.look:
        case "bars":
            widths = axes.barh(curve.y, curve.x, color=[LEFT_OUT, *[MODEL.light] * (curve.x.size - 1)])
            axes.bar_label(widths, fmt=_percent, padding=3, fontsize=SMALL_SIZE, color=INK)
        case "dots":
            axes.plot(
                curve.x, curve.y, color=colour, marker="o", markersize=5, linestyle="none", label=curve.label
            )
        case "marks":
            size = _RING if curve.x.size <= _MOST_RINGS else _DOT
            ring: Style = {"marker": "o", "markerfacecolor": "none", "markeredgewidth": 1.4}
            axes.plot(
                curve.x,
                curve.y,
                color=colour,
                markersize=size,
                linestyle="none",
                label=curve.label,
                zorder=4,
                **ring,
            )
        case "samples" | "line":
            dots = curve.look == "samples" and curve.x.size <= _MOST_DOTS
            axes.plot(
                curve.x,
                curve.y,
                linewidth=0.9,
                marker="." if dots else "",
                markersize=4,
                label=curve.label,
                **style,
            )
