"""The Allan deviation as a plot: points and intervals, the model and its terms, the read-offs."""

from typing import TYPE_CHECKING, Any

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray, IntArray
from imucal.noise.terms import TERMS
from imucal.report import numbers
from imucal.report.figure_parts import (
    LEGEND_SIZE,
    Drawn,
    dashes,
    drawn_terms,
    estimate_text,
    limits,
    style_axes,
    term_entries,
)
from imucal.report.labels import Label, place_labels
from imucal.report.palette import AXES, DATA, INK, MODEL, UNUSED
from imucal.report.result import AxisReport
from imucal.report.sheet_units import SheetUnits
from imucal.units import pretty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: The vertical axis reaches this far below the curve to show a read-off, never further.
_DEEPEST = 40.0
#: Axis -> its marker in an overview.
MARKERS = {"x": "o", "y": "s", "z": "^"}


def draw_allan(axes: "Axes", axis: AxisReport, units: SheetUnits) -> list[Any]:
    """Draw one axis's curve, model and terms in data-sheet units; return the entries of the legend."""
    curve, rate, factor = axis.fit.curve, axis.fit.rate_hz, units.level.factor
    shown, terms, m = shown_points(curve), drawn_terms(axis), _dense(curve)
    style_axes(
        axes,
        x="averaging time τ (s)",
        y=f"Allan deviation ({pretty(units.level.name)})",
        x_limits=limits(curve.tau[shown], below=1.6, above=1.9),
        y_limits=_y_limits(curve.adev[shown] * factor, [each.height * factor for each in terms]),
    )
    entries = _points(axes, axis, shown, factor)
    total = np.sqrt(axis.fit.model.avar(m, rate_hz=rate)) * factor
    if axis.fit.model.terms:
        name = f"model {axis.fit.model}"
        entries += axes.plot(m / rate, total, color=MODEL.light, linewidth=1.8, zorder=6, label=name)
    obstacles = [(curve.tau[shown], curve.adev[shown] * factor, 2.0), (m / rate, total, 2.0)]
    labels = []
    for drawn in terms:
        line = np.sqrt(drawn.term.avar(m, 1 / rate)) * factor
        obstacles.append((m / rate, line, 0.7))
        labels += _term(axes, axis, drawn, units, m / rate, line, total)
    labels.append(_minimum(axes, axis, units))
    place_labels(axes, labels, obstacles=obstacles, fontsize=LEGEND_SIZE)
    return entries + term_entries(axis, terms)


def draw_allan_overview(axes: "Axes", reports: list[AxisReport], units: SheetUnits) -> None:
    """Draw the curves and models of a sensor's axes."""
    values, times, factor = [], [], units.level.factor
    for axis in reports:
        curve, colour = axis.fit.curve, AXES[axis.axis].light
        shown = shown_points(curve)
        tau, adev = curve.tau[shown], curve.adev[shown] * factor
        low, high = curve.confidence_interval(axis.fit.level)
        axes.fill_between(
            tau, low[shown] * factor, high[shown] * factor, color=colour, alpha=0.13, linewidth=0
        )
        marker: dict[str, Any] = {"marker": MARKERS[axis.axis], "markersize": 3.8, "markerfacecolor": "white"}
        axes.plot(tau, adev, color=colour, linestyle="none", zorder=4, **marker)
        m = _dense(curve)
        total = np.sqrt(axis.fit.model.avar(m, rate_hz=axis.fit.rate_hz)) * factor
        line: dict[str, Any] = {"color": colour, "linewidth": 1.5, **dashes(AXES[axis.axis])}
        axes.plot(m / axis.fit.rate_hz, total, **line)
        values.append(adev)
        times.append(tau)
    style_axes(
        axes,
        x="averaging time τ (s)",
        y=f"Allan deviation ({pretty(units.level.name)})",
        x_limits=limits(np.concatenate(times), below=1.6, above=1.9),
        y_limits=limits(np.concatenate(values), below=2.0, above=2.0),
    )


def shown_points(curve: AllanCurve) -> IntArray:
    """Return the indices worth drawing: those with at least 2 degrees of freedom, where there are any."""
    positive = curve.avar > 0
    sure = positive & ~(curve.edf < 2)
    return np.flatnonzero(sure if np.count_nonzero(sure) >= 2 else positive).astype(np.int64)


def _dense(curve: AllanCurve) -> FloatArray:
    """Return whole averaging factors that make a smooth line over the curve."""
    return np.unique(np.geomspace(float(curve.m.min()), float(curve.m.max()), 200).round())


def _y_limits(adev: FloatArray, heights: list[float]) -> tuple[float, float]:
    """Return limits that hold the curve, and the read-offs not too far below it."""
    bottom, top = limits(adev, below=2.2, above=2.2)
    deepest = bottom * 2.2 / _DEEPEST
    for height in heights:
        if deepest < height < bottom * 1.3:
            bottom = min(bottom, height / 1.6)
    return bottom, top


def _points(axes: "Axes", axis: AxisReport, shown: IntArray, factor: float) -> list[Any]:
    curve = axis.fit.curve
    low, high = (limit * factor for limit in curve.confidence_interval(axis.fit.level))
    adev = curve.adev * factor
    known = shown[np.isfinite(low[shown]) & np.isfinite(high[shown])]
    entries: list[Any] = []
    dots: dict[str, Any] = {"marker": "o", "markersize": 4.4, "linestyle": "none"}
    used, unused = np.intersect1d(shown, axis.fit.used), np.setdiff1d(shown, axis.fit.used)
    if used.size:
        name = f"Allan deviation ({curve.estimator})"
        # Above the labels' white boxes: no label hides a part of a point.
        entries += axes.plot(curve.tau[used], adev[used], color=DATA.light, zorder=21, label=name, **dots)
    if known.size:
        name = f"its {100 * axis.fit.level:.4g} % interval"
        band: dict[str, Any] = {"color": "#9db7d1", "alpha": 0.5, "linewidth": 0, "zorder": 2, "label": name}
        entries.append(axes.fill_between(curve.tau[known], low[known], high[known], **band))
    if unused.size:
        name = "not used by the fit"
        entries += axes.plot(curve.tau[unused], adev[unused], color=UNUSED, zorder=5, label=name, **dots)
    return entries


def _term(  # noqa: PLR0917 - drawing takes what is drawn
    axes: "Axes",
    axis: AxisReport,
    drawn: Drawn,
    units: SheetUnits,
    tau: FloatArray,
    line: FloatArray,
    total: FloatArray,
) -> list[Label]:
    """Draw a term's line and read-off; return its label, or nothing where no part of it is in view."""
    stroke, bounded = TERMS[drawn.estimate.symbol].stroke, drawn.estimate.value is None
    style: dict[str, Any] = {"linewidth": 1.0 if bounded else 1.3, "alpha": 0.65 if bounded else 1.0}
    axes.plot(tau, line, color=stroke.light, zorder=3, **style, **dashes(stroke))
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    at, height = drawn.tau_s, drawn.height * units.level.factor
    if at is None and not bounded:
        # A floor is read where it makes up most of the curve.
        at = float(tau[np.argmax(np.where((tau > left * 2) & (tau < right / 2), line / total, 0))])
    text = estimate_text(drawn.estimate, axis.sensor, units)
    if at is not None and left < at < right and bottom < height < top:
        face = "white" if bounded else stroke.light
        mark: dict[str, Any] = {"marker": "v" if bounded else "D", "markersize": 5.5, "markerfacecolor": face}
        axes.plot([at], [height], color=stroke.light, linestyle="none", zorder=8, **mark)
        return [Label(text=text, x=np.array([at]), y=np.array([height]), colour=stroke.light)]
    in_view = (line > bottom * 1.1) & (line < top / 1.1) & (tau > left) & (tau < right)
    inside = np.flatnonzero(in_view)
    if not inside.size:
        # Too small to matter anywhere in view; the reader still wants the number.
        places = np.geomspace(left, right, 12)[1:-1]
        edge = np.full(places.size, bottom * (top / bottom) ** 0.01)
        return [Label(text=f"{text} (below)", x=places, y=edge, colour=stroke.light)]
    some = inside[:: max(1, inside.size // 12)]
    return [Label(text=text, x=tau[some], y=line[some], colour=stroke.light)]


def _minimum(axes: "Axes", axis: AxisReport, units: SheetUnits) -> Label:
    """Ring the lowest point of the curve; return its label."""
    floor = units.minimum(axis)
    adev, tau = axis.fit.curve.minimum
    adev *= units.level.factor
    axes.plot([tau], [adev], marker="o", markersize=8, markerfacecolor="none", color=INK, zorder=9)
    text = f"minimum {numbers.with_interval(floor)}"
    return Label(text=text, x=np.array([tau]), y=np.array([adev]), colour=INK)
