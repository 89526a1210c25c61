"""The picture of a decomposition: the bias of one axis over time, and its parts."""

from typing import TYPE_CHECKING, Any

import numpy as np

from imucal._version import __version__
from imucal.arrays import FloatArray
from imucal.fitting.decomposition import Decomposition
from imucal.fitting.wiener import Component
from imucal.noise.term import Stroke
from imucal.noise.terms import TERMS
from imucal.report import figure as drawing
from imucal.report import numbers
from imucal.report.figure_style import (
    FADED,
    GRID,
    INK,
    LABEL_STYLE,
    LEGEND_SIZE,
    LEGEND_STYLE,
    MODEL,
    SMALL_SIZE,
    Style,
    new_figure,
    quiet_frame,
    write_foot,
    write_head,
)
from imucal.report.view import term_name
from imucal.units import pretty, time_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Heights in inches: the bias, one of its parts, the space between two parts, the head and the foot.
_TOP = 3.4
_PART = 1.3
_SPACE = 0.36
_HEAD = 0.74
_FOOT = 0.78
#: Sides of the axes, as fractions of the width.
_LEFT = 0.095
_RIGHT = 0.985
#: Largest number of points of a line; the eye sees no more at this width.
_POINTS = 1500
#: Number of averages of the samples that are drawn.
_AVERAGES = 1000
#: Half the width of the band, in standard errors.
_BAND = 2.0


def bias_figure(parts: Decomposition, *, source: str = "") -> "Figure":
    """Return the picture of an axis's bias over time."""
    shown = [part for part in parts.components if part.key != "level"]
    # A single part equals the bias, except for a level.
    shown = shown if len(shown) > 1 else []
    height = _HEAD + _TOP + len(shown) * (_PART + _SPACE) + _FOOT
    figure = new_figure(drawing.WIDTH, height)
    level = TERMS["B"].datasheet_unit(parts.series.sensor)
    divisor, time_name = time_unit(float(parts.time_s[-1]))
    view, unit = _View(parts, level.factor, divisor), pretty(level.name)
    bottom = height - _HEAD - _TOP
    axes = figure.add_axes((_LEFT, bottom / height, _RIGHT - _LEFT, _TOP / height))
    entries = _draw_bias(axes, view, f"bias minus its mean ({unit})")
    for part in shown:
        axes.tick_params(labelbottom=False)
        bottom -= _PART + _SPACE
        axes = figure.add_axes((_LEFT, bottom / height, _RIGHT - _LEFT, _PART / height))
        _draw_part(axes, view, part, unit)
    axes.set_xlabel(f"time ({time_name})", **LABEL_STYLE)
    series, count = parts.series, int(np.isfinite(parts.samples).sum())
    recorded = drawing.recording_text(parts.n * series.tau0, series.rate_hz, count)
    title = f"{str(series.sensor).capitalize()} {series.axis}: bias over time"
    write_head(figure, title, f"{recorded}   ·   model {parts.model}", below=0.42)
    write_foot(figure, source, __version__)
    figure.legend(
        handles=entries,
        loc="upper right",
        bbox_to_anchor=(_RIGHT, 1 - 0.04 / height),
        ncols=3,
        handlelength=2.4,
        columnspacing=1.4,
        markerscale=1.8,
        **LEGEND_STYLE,
    )
    return figure


def averages(parts: Decomposition, width: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return averages of `width` neighbouring samples: middle times in s, means, and numbers, shape (k,).

    The mean is NaN if all samples are missing.
    """
    first = np.arange(0, parts.n, width)
    seen = np.isfinite(parts.samples)
    count = np.add.reduceat(seen.astype(np.float64), first)
    total = np.add.reduceat(np.where(seen, parts.samples, 0.0), first)
    last = np.minimum(first + width, parts.n) - 1
    middle = parts.start_s + (first + last) / 2 * parts.series.tau0
    return middle, np.where(count > 0, total / np.maximum(count, 1.0), np.nan), count


class _View:
    def __init__(self, parts: Decomposition, scale: float, divisor: float) -> None:
        self.parts, self.scale, self.divisor = parts, scale, divisor
        self.place = np.unique(np.linspace(0, parts.n - 1, _POINTS).round().astype(np.int64))
        self.time = parts.time_s[self.place] / divisor
        self.mean = float(parts.bias.value.mean())


def _draw_bias(axes: "Axes", view: _View, label: str) -> list[Any]:
    """Draw averages of the samples, and the bias with its band; return the legend's entries."""
    parts = view.parts
    width = max(1, round(parts.n / _AVERAGES))
    time, mean, count = averages(parts, width)
    heights = (np.where(count >= width / 2, mean, np.nan) - view.mean) * view.scale
    seconds = width * parts.series.tau0
    name = f"samples, mean of {numbers.seconds(seconds)}" if width > 1 else "samples"
    dot: Style = {"marker": "o", "markersize": 2.2, "markeredgewidth": 0, "linestyle": "none"}
    dot |= {"color": FADED, "alpha": 0.75}
    (grey,) = axes.plot(time / view.divisor, heights, zorder=3.5, label=name, **dot)
    line, band, ends = _draw_line(axes, view, parts.bias, MODEL, 1.5, centred=True)
    line.set_label("bias, estimated from all samples")
    _style(axes, view, label, [heights, *ends])
    return [grey, line, band]


def _draw_part(axes: "Axes", view: _View, part: Component, unit: str) -> None:
    term = TERMS[part.key.rstrip("0123456789")]
    holds_level = term.symbol == "K"
    _, _, ends = _draw_line(axes, view, part, term.stroke, 1.3, centred=holds_level)
    _style(axes, view, unit, ends)
    name = term_name(term.symbol, view.parts.series.sensor)
    text = f"{part.key}  {name}{', minus its mean' if holds_level else ''}"
    place: Style = {"transform": axes.transAxes, "va": "bottom", "fontweight": "bold"}
    axes.text(0.0, 1.04, text, fontsize=LEGEND_SIZE, color=term.stroke.light, **place)


def _draw_line(
    axes: "Axes", view: _View, part: Component, stroke: Stroke, width: float, *, centred: bool
) -> tuple[Any, Any, list[FloatArray]]:
    """Return line, band and the band's limits. `centred` subtracts the mean."""
    off = float(part.value.mean()) if centred else 0.0
    value, error = (part.value[view.place] - off) * view.scale, part.error[view.place] * view.scale
    low, high = value - _BAND * error, value + _BAND * error
    style: Style = {"alpha": 0.18, "linewidth": 0, "zorder": 3, "label": "± 2 standard errors"}
    band = axes.fill_between(view.time, low, high, color=stroke.light, **style)
    (line,) = axes.plot(view.time, value, color=stroke.light, linewidth=width, zorder=4)
    return line, band, [low, high]


def _style(axes: "Axes", view: _View, label: str, drawn: list[FloatArray]) -> None:
    values = np.concatenate(drawn)
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    room = 0.06 * (high - low) or 1.0
    axes.set_ylim(low - room, high + room)
    axes.set_xlim(view.time[0], max(float(view.time[-1]), view.time[0] + 1e-9))
    quiet_frame(axes)
    axes.grid(visible=True, color=GRID, linewidth=0.8)
    axes.tick_params(labelsize=SMALL_SIZE, colors=INK, length=3)
    axes.set_ylabel(label, **LABEL_STYLE)
    axes.yaxis.set_label_coords(-0.06, 0.5)
