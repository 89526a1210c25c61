"""The pictures of a report: each axis by itself, and the three axes of a sensor together.

Drawn through matplotlib's object interface on the Agg canvas: no window, no pyplot, no state that outlives a
call; side by side where processes may be forked, since each is worth half a second. Sizes are chosen so that
the smallest text has 9 px at a width of 800 px.

Colours are darkened from Okabe & Ito (2008), "Color universal design", so that they also serve as text on
white (contrast above 4.5); every colour comes with its own line style or marker as well. Those of a term
stand in its class.

Ticks are our own: matplotlib makes an object of every minor tick, of which two log-log plots have hundreds,
and sets every power of ten by its formula parser. Here the minor ticks of an axis are one artist, which takes
a tenth of the time.
"""

import base64
import io
import math
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from importlib import import_module
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray, IntArray
from imucal.findings import Finding
from imucal.fitting.noise_fit import Estimate, Line, NoiseFit
from imucal.frozen import frozen_alone
from imucal.noise.term import NoiseTerm, Stroke
from imucal.noise.terms import TERMS
from imucal.printable import printable
from imucal.processes import side_by_side, try_side_work
from imucal.recording import Axis, Sensor
from imucal.report import numbers
from imucal.report.labels import Label, place_labels
from imucal.report.numbers import SheetUnits, sheet_units
from imucal.report.result import AxisReport, Report
from imucal.report.view import Row, View, views
from imucal.resources import threads
from imucal.units import duration, pretty

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Fewest ordinates of the first point and of the others: 95 % of roots lie within 0.45 to 1.55 and 0.61
#: to 1.39 times the truth. Fewer are single spikes; more would leave no slope at the lowest frequencies.
_FIRST, _LEAST = 6.0, 12.0


@frozen_alone
class SmoothSpectrum:
    """Roots of a two-sided density with their limits, in U/√Hz, shape (k,); `frequency` in Hz."""

    frequency: FloatArray
    root: FloatArray
    low: FloatArray
    high: FloatArray


def smooth_spectrum(axis: AxisReport) -> SmoothSpectrum:
    """Return an axis's spectrum with neighbouring bins merged until each point averages 12 ordinates.

    The ratio to the model is averaged, not the density: within a merged bin the slope is the model's, and a
    steep density is not read too high. Limits are chi-squared, at the level of the fit, one degree of
    freedom an ordinate. Source: Blackman & Tukey (1958), The Measurement of Power Spectra, sec. B.18, for
    prewhitening by a model.
    """
    from scipy.special import chdtri

    spectrum, fit = axis.spectrum, axis.fit
    if not spectrum.frequency.size:
        none = np.zeros(0)
        return SmoothSpectrum(frequency=none, root=none, low=none, high=none)
    first = _firsts(spectrum.count)
    count = np.add.reduceat(spectrum.count, first)
    frequency = np.exp(np.add.reduceat(np.log(spectrum.frequency) * spectrum.count, first) / count)
    ratio = np.add.reduceat(spectrum.psd / _shape(axis, spectrum.frequency) * spectrum.count, first) / count
    root = np.sqrt(ratio * _shape(axis, frequency))
    tail = (1 - fit.level) / 2
    low, high = (root * np.sqrt(count / chdtri(count, beyond)) for beyond in (tail, 1 - tail))
    return SmoothSpectrum(frequency=frequency, root=root, low=low, high=high)


def _shape(axis: AxisReport, frequency: FloatArray) -> FloatArray:
    """Return the model's density, or 1 where there is no model."""
    density = axis.fit.model.psd(frequency, rate_hz=axis.fit.rate_hz)
    return density if np.all(density > 0) else np.ones(frequency.size)


def _firsts(count: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return the first bin of each merged one; the last takes what is left over."""
    firsts, held = [0], 0.0
    for index, ordinates in enumerate(count.tolist()):
        if held >= (_FIRST if len(firsts) == 1 else _LEAST):
            firsts.append(index)
            held = 0.0
        held += ordinates
    if held < _LEAST and len(firsts) > 1:
        firsts.pop()
    return np.array(firsts, dtype=np.int64)


INK = "#1c2733"
DATA = Stroke("#33414f", "#c9d4df", ())
MODEL = Stroke("#0063a3", "#5db6f2", ())
#: Text of second rank.
FADED = "#66717d"
#: What the fit did not use.
UNUSED = "#b4bcc5"
#: Spectral lines.
LEFT_OUT = "#b00020"
GRID = "#e3e7ec"
#: Spines and ticks.
FRAME = "#9aa5b1"

#: Axis -> its stroke in an overview.
AXES: dict[str, Stroke] = {
    "x": Stroke("#b84300", "#ff9157", ()),
    "y": Stroke("#0063a3", "#5db6f2", (6, 2)),
    "z": Stroke("#00734f", "#36c99a", (2, 1.5)),
}


_SIZE = 9.0
#: Length of a minor tick, in parts of the plot.
_MINOR = 0.006
#: At most so many labelled ticks an axis.
_MOST = 8


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
    power = numbers.ten_to(exponent)
    return power if factor == 1 else f"{factor:g}×{power}"


#: Text sizes in points, for a figure 10 inches wide.
TITLE_SIZE, LABEL_SIZE, LEGEND_SIZE, SMALL_SIZE = 13.0, 9.5, 9.0, 8.5
#: What an artist of matplotlib's looks like, by the names of its arguments.
Style: TypeAlias = dict[str, Any]
LABEL_STYLE: Style = {"fontsize": LABEL_SIZE, "color": INK, "labelpad": 3}
LEGEND_STYLE: Style = {"fontsize": LEGEND_SIZE, "frameon": False, "labelcolor": INK}
#: The points of a curve, and the band of an interval.
DOTS: Style = {"marker": "o", "markersize": 4.4, "linestyle": "none"}
_BAND: Style = {"color": "#9db7d1", "alpha": 0.5, "linewidth": 0, "zorder": 2}


class Drawn(NamedTuple):
    """A term as a line: the estimate it draws, the term with its value or its bound."""

    estimate: Estimate
    term: NoiseTerm

    @property
    def bounded(self) -> bool:
        """Whether only its bound is known."""
        return self.estimate.value is None


def new_figure(width: float, height: float, dpi: float = 160) -> "Figure":
    """Return an empty white figure with its own Agg canvas; sizes in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def style_axes(
    axes: "Axes", *, x: str, y: str, x_limits: tuple[float, float], y_limits: tuple[float, float]
) -> None:
    """Make both scales logarithmic, with named units, quiet grid lines and final limits."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(*x_limits)
    axes.set_ylim(*y_limits)
    quiet_frame(axes)
    axes.set_xlabel(x, **LABEL_STYLE)
    axes.set_ylabel(y, **LABEL_STYLE)
    draw_ticks(axes)


def quiet_frame(axes: "Axes") -> None:
    """Leave only the left and the lower side of the frame, under what is drawn."""
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(FRAME)


def write_head(figure: "Figure", title: str, subtitle: str, *, below: float = 0.38) -> None:
    """Write the title at the top left, and a line so many inches below the edge."""
    height = figure.get_figheight()
    style: Style = {"color": INK, "va": "top"}
    figure.text(0.012, 1 - 0.10 / height, title, fontsize=TITLE_SIZE, fontweight="bold", **style)
    figure.text(0.012, 1 - below / height, subtitle, fontsize=LEGEND_SIZE, **style)


def write_foot(figure: "Figure", source: str, version: str) -> None:
    """Write the log's name, cut at its start, and imucal's version."""
    name = printable(source)
    shown = name if len(name) <= 90 else f"…{name[-89:]}"
    # A dollar sign in a name starts no formula.
    style: Style = {"fontsize": SMALL_SIZE, "color": FADED, "va": "bottom", "parse_math": False}
    y = 0.07 / figure.get_figheight()
    figure.text(0.012, y, shown, **style)
    figure.text(0.988, y, f"imucal {version}", ha="right", **style)


def limits(values: FloatArray, *, below: float, above: float) -> tuple[float, float]:
    """Return limits about the positive ones of `values`, with factors of room below and above."""
    positive = values[np.isfinite(values) & (values > 0)]
    if not positive.size:
        return 0.1, 10.0
    return float(positive.min() / below), float(positive.max() * above)


def stroked(stroke: Stroke, **style: object) -> Style:
    """Return colour and dashes of a stroke, and what else makes up the style of a line."""
    return {"color": stroke.light, **style, **({"dashes": stroke.dashes} if stroke.dashes else {})}


def marked(axis: Axis, **style: object) -> Style:
    """Return the style of an axis's line in an overview, with its marker."""
    return stroked(AXES[axis], marker=MARKERS[axis], markerfacecolor="white", **style)


def name_axes(axes: "Axes", reports: list[AxisReport], **style: object) -> None:
    """Add a legend of which line of an overview is which axis."""
    for axis in reports:
        axes.plot([], [], label=axis.axis, **marked(axis.axis, **style))
    axes.legend(loc="upper right", **LEGEND_STYLE)


def term_entries(fit: NoiseFit, terms: list[Drawn], marked_symbols: set[str]) -> list[Any]:
    """Return the legend's entries of the terms' lines, one a symbol; a mark only if the plot has it."""
    from matplotlib.lines import Line2D

    entries: Style = {}
    for drawn in terms:
        symbol = drawn.term.symbol
        name = f"{symbol}{' bound:' if drawn.bounded else ''} {numbers.term_name(symbol, fit.sensor)}"
        mark = _read_off_mark(drawn) if symbol in marked_symbols else {}
        line = stroked(drawn.term.stroke, linewidth=1.3, label=name, **mark)
        entries[symbol] = Line2D([], [], **line)
    return list(entries.values())


def _read_off_mark(drawn: Drawn) -> Style:
    marker, face = ("v", "white") if drawn.bounded else ("D", drawn.term.stroke.light)
    return {"marker": marker, "markersize": 5.5, "markerfacecolor": face}


def drawn_terms(fit: NoiseFit) -> list[Drawn]:
    """Return the lines to draw: each term of the fit, and each bound as if it were the value."""
    found, terms = [], fit.drawn
    for estimate in fit.estimates:
        term = terms.get(estimate.key)
        if estimate.value is None:
            known = 0 < estimate.high < math.inf and not TERMS[estimate.symbol].repeatable
            term = estimate.term(estimate.high) if known else None
        if term is not None:
            found.append(Drawn(estimate, term))
    return found


def estimate_text(estimate: Estimate, sensor: Sensor | None, units: SheetUnits) -> str:
    """Return ``N 0.4125 ± 0.0016 deg/√h``; T of a Gauss-Markov term and other explanations follow."""
    lines = [f"{estimate.key} {numbers.with_uncertainty(units.estimate(estimate, sensor))}"]
    if estimate.correlation_time is not None:
        time = numbers.with_uncertainty(numbers.correlation_time(estimate.correlation_time))
        lines.append(f"T {time}")
    if note := numbers.alternatives(estimate):
        lines.append(note)
    return "\n".join(lines)


#: The vertical axis reaches this far below the curve to show a read-off, never further.
_DEEPEST = 40.0
#: Axis -> its marker in an overview.
MARKERS = {"x": "o", "y": "s", "z": "^"}


def draw_allan(axes: "Axes", fit: NoiseFit, units: SheetUnits) -> list[Any]:
    """Draw one axis's curve, model and terms in data-sheet units; return the entries of the legend."""
    curve, rate, factor = fit.curve, fit.rate_hz, units.level.factor
    shown, terms = shown_points(curve), drawn_terms(fit)
    y_limits = _y_limits(curve.adev[shown] * factor, [each.term.read_off()[1] * factor for each in terms])
    style_allan(axes, pretty(units.level.name), curve.tau[shown], y_limits)
    entries = _points(axes, fit, shown, factor)
    m, total = smooth_adev(fit, curve.m)
    tau, total = m / rate, total * factor
    if fit.model.terms:
        name = f"model {fit.model}"
        entries += axes.plot(tau, total, color=MODEL.light, linewidth=1.8, zorder=6, label=name)
    obstacles = [(curve.tau[shown], curve.adev[shown] * factor, 2.0), (tau, total, 2.0)]
    labels = []
    for drawn in terms:
        line = np.sqrt(drawn.term.avar(m, 1 / rate)) * factor
        obstacles.append((tau, line, 0.7))
        labels.append(_term(axes, fit, drawn, units, (tau, line, total)))
    # A label at one point belongs to a mark.
    marked_symbols = {d.term.symbol for d, label in zip(terms, labels, strict=True) if not np.ndim(label.x)}
    # The lowest point of the curve has a ring.
    (lowest, at), text = curve.minimum, f"minimum {numbers.with_interval(units.minimum(fit))}"
    axes.plot([at], [lowest * factor], marker="o", markersize=8, markerfacecolor="none", color=INK, zorder=9)
    labels.append(Label(text, at, lowest * factor, INK))
    place_labels(axes, labels, obstacles=obstacles, fontsize=LEGEND_SIZE)
    return entries + term_entries(fit, terms, marked_symbols)


def draw_allan_overview(axes: "Axes", reports: list[AxisReport], units: SheetUnits) -> None:
    """Draw the curves and models of a sensor's axes."""
    values, times, factor = [], [], units.level.factor
    for axis in reports:
        curve, stroke = axis.fit.curve, AXES[axis.axis]
        shown = shown_points(curve)
        tau, adev = curve.tau[shown], curve.adev[shown] * factor
        low, high = (limit[shown] * factor for limit in curve.confidence_interval(axis.fit.level))
        axes.fill_between(tau, low, high, color=stroke.light, alpha=0.13, linewidth=0)
        points = DOTS | {"marker": MARKERS[axis.axis], "markersize": 3.8, "markerfacecolor": "white"}
        axes.plot(tau, adev, color=stroke.light, zorder=4, **points)
        m, total = smooth_adev(axis.fit, curve.m)
        axes.plot(m / axis.fit.rate_hz, total * factor, **stroked(stroke, linewidth=1.5))
        values.append(adev)
        times.append(tau)
    y_limits = limits(np.concatenate(values), below=2.0, above=2.0)
    style_allan(axes, pretty(units.level.name), np.concatenate(times), y_limits)


def style_allan(axes: "Axes", unit: str, tau: FloatArray, y_limits: tuple[float, float]) -> None:
    """Style the axes of Allan deviations in a unit, at averaging times in s, shape (k,)."""
    style_axes(
        axes,
        x="averaging time τ (s)",
        y=f"Allan deviation ({unit})",
        x_limits=limits(tau, below=1.6, above=1.9),
        y_limits=y_limits,
    )


def shown_points(curve: AllanCurve) -> IntArray:
    """Return the indices worth drawing: those with at least 2 degrees of freedom, where there are any."""
    positive = curve.avar > 0
    sure = positive & ~(curve.edf < 2)
    return np.flatnonzero(sure if np.count_nonzero(sure) >= 2 else positive).astype(np.int64)


def smooth_adev(fit: NoiseFit, m: IntArray, points: int = 200) -> tuple[FloatArray, FloatArray]:
    """Return whole averaging factors as dense as a smooth line over `m`, and the model's deviations there."""
    dense = np.unique(np.geomspace(m.min(), m.max(), points).round())
    return dense, np.sqrt(fit.model.avar(dense, rate_hz=fit.rate_hz))


def smooth_root(axis: AxisReport, points: int = 200) -> tuple[FloatArray, FloatArray]:
    """Return frequencies over a spectrum, in Hz, and the root of the model's density there, in U/√Hz."""
    found = axis.spectrum.frequency
    grid = np.geomspace(found[0], found[-1], points) if found.size else found
    return grid, np.sqrt(axis.fit.model.psd(grid, rate_hz=axis.fit.rate_hz))


def _y_limits(adev: FloatArray, heights: list[float]) -> tuple[float, float]:
    """Return limits that hold the curve, and the read-offs not too far below it."""
    bottom, top = limits(adev, below=2.2, above=2.2)
    deepest = bottom * 2.2 / _DEEPEST
    for height in heights:
        if deepest < height < bottom * 1.3:
            bottom = min(bottom, height / 1.6)
    return bottom, top


def _points(axes: "Axes", fit: NoiseFit, shown: IntArray, factor: float) -> list[Any]:
    curve = fit.curve
    low, high = (limit * factor for limit in curve.confidence_interval(fit.level))
    adev = curve.adev * factor
    known = shown[np.isfinite(low[shown]) & np.isfinite(high[shown])]
    entries: list[Any] = []
    used, unused = np.intersect1d(shown, fit.used), np.setdiff1d(shown, fit.used)
    if used.size:
        name = f"Allan deviation ({curve.estimator})"
        # Above the labels' white boxes: no label hides a part of a point.
        entries += axes.plot(curve.tau[used], adev[used], color=DATA.light, zorder=21, label=name, **DOTS)
    if known.size:
        name = f"its {100 * fit.level:.4g} % interval"
        entries.append(axes.fill_between(curve.tau[known], low[known], high[known], label=name, **_BAND))
    if unused.size:
        name = "not used by the fit"
        entries += axes.plot(curve.tau[unused], adev[unused], color=UNUSED, zorder=5, label=name, **DOTS)
    return entries


def _term(
    axes: "Axes", fit: NoiseFit, drawn: Drawn, units: SheetUnits, lines: tuple[FloatArray, ...]
) -> Label:
    """Draw a term's line and read-off, of `lines` tau, the term's and the model's; return its label."""
    stroke, (tau, line, total) = drawn.term.stroke, lines
    width, alpha = (1.0, 0.65) if drawn.bounded else (1.3, 1.0)
    axes.plot(tau, line, zorder=3, **stroked(stroke, linewidth=width, alpha=alpha))
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    at, height = drawn.term.read_off()
    height *= units.level.factor
    if at is None and not drawn.bounded:
        # A floor is read where it makes up most of the curve.
        at = float(tau[np.argmax(np.where((tau > left * 2) & (tau < right / 2), line / total, 0))])
    text = estimate_text(drawn.estimate, fit.sensor, units)
    if at is not None and left < at < right and bottom < height < top:
        axes.plot([at], [height], color=stroke.light, linestyle="none", zorder=8, **_read_off_mark(drawn))
        return Label(text, at, height, stroke.light)
    in_view = (line > bottom * 1.1) & (line < top / 1.1) & (tau > left) & (tau < right)
    inside = np.flatnonzero(in_view)
    if not inside.size:
        # Too small to matter anywhere in view; the reader still wants the number.
        places = np.geomspace(left, right, 12)[1:-1]
        edge = np.full(places.size, bottom * (top / bottom) ** 0.01)
        return Label(f"{text} (below)", places, edge, stroke.light)
    some = inside[:: max(1, inside.size // 12)]
    return Label(text, tau[some], line[some], stroke.light)


#: At most this many lines are named, the strongest first; all are marked.
_NAMED_LINES = 3


def draw_psd(axes: "Axes", axis: AxisReport, units: SheetUnits) -> list[Any]:
    """Draw one axis's spectrum, model and terms in data-sheet units; return the entries of the legend."""
    smooth, factor = smooth_spectrum(axis), units.density.factor
    frequency, root = smooth.frequency, smooth.root * factor
    _style_psd(axes, units, axis.spectrum.frequency, root)
    if not frequency.size:
        axes.text(0.5, 0.5, "no samples, no spectrum", transform=axes.transAxes, ha="center", color=INK)
        return []
    axes.fill_between(frequency, smooth.low * factor, smooth.high * factor, **_BAND)
    axes.plot(frequency, root, color=DATA.light, linewidth=1.0, zorder=4)
    grid, model = smooth_root(axis)
    for drawn in drawn_terms(axis.fit):
        density = np.sqrt(drawn.term.psd(grid, 1 / axis.fit.rate_hz)) * factor
        if not drawn.bounded and np.any(density > 0):
            axes.plot(grid, density, zorder=3, **stroked(drawn.term.stroke, linewidth=1.1))
    if axis.fit.model.terms:
        axes.plot(grid, model * factor, color=MODEL.light, linewidth=1.8, zorder=6)
    entries = _unused_band(axes, axis)
    labels = _lines(axes, axis, entries, factor) + _response(axes, axis)
    place_labels(axes, labels, obstacles=[(frequency, root, 2.0)], fontsize=LEGEND_SIZE)
    return entries


def draw_psd_overview(axes: "Axes", reports: list[AxisReport], units: SheetUnits) -> None:
    """Draw the spectra and models of a sensor's axes."""
    values, places, factor = [np.zeros(0)], [np.zeros(0)], units.density.factor
    for axis in reports:
        smooth, stroke = smooth_spectrum(axis), AXES[axis.axis]
        frequency, root = smooth.frequency, smooth.root * factor
        if not frequency.size:
            continue
        axes.plot(frequency, root, color=stroke.light, linewidth=0.8, alpha=0.55)
        grid, model = smooth_root(axis)
        axes.plot(grid, model * factor, **stroked(stroke, linewidth=1.6))
        values.append(root)
        places.append(grid)
    _style_psd(axes, units, np.concatenate(places), np.concatenate(values))


def _style_psd(axes: "Axes", units: SheetUnits, frequency: FloatArray, root: FloatArray) -> None:
    style_axes(
        axes,
        x="frequency (Hz)",
        y=f"√PSD, two-sided ({pretty(units.density.name)})",
        x_limits=limits(frequency, below=1.3, above=1.3),
        y_limits=limits(root, below=2.0, above=2.2),
    )


def _unused_band(axes: "Axes", axis: AxisReport) -> list[Any]:
    """Grey what lies outside the band of the fit."""
    band = axis.fit.goodness.band_hz
    if band is None:
        return []
    left, right = axes.get_xlim()
    spectrum = axis.spectrum.frequency
    spans = [(left, band[0])] if spectrum[0] < band[0] else []
    if spectrum[-1] > band[1] * 1.01:
        spans.append((band[1], right))
    style: Style = {"color": UNUSED, "alpha": 0.3, "linewidth": 0, "zorder": 1}
    made = [axes.axvspan(*span, label="band not used by the fit", **style) for span in spans]
    return made[:1]


def _lines(axes: "Axes", axis: AxisReport, entries: list[Any], factor: float) -> list[Label]:
    """Mark the spectral lines that the fit left out; return names for the strongest."""
    lines = axis.fit.goodness.lines
    if not lines:
        return []
    at = [line.frequency_hz for line in lines]
    heights = [_height(axis, line) * factor for line in lines]
    mark: Style = {"marker": "v", "markersize": 6, "color": LEFT_OUT, "linestyle": "none"}
    entries += axes.plot(at, heights, zorder=9, label="line left out of the fit", **mark)
    strongest = sorted(zip(lines, heights, strict=True), key=lambda pair: -pair[0].amplitude)[:_NAMED_LINES]
    return [
        Label(f"{line.frequency_hz:.4g} Hz", line.frequency_hz, height, LEFT_OUT)
        for line, height in strongest
    ]


def _height(axis: AxisReport, line: Line) -> float:
    """Return the height of the spectrum at a line, so that its mark stands on the peak."""
    nearest = np.argmin(np.abs(axis.spectrum.frequency - line.frequency_hz))
    around = axis.spectrum.psd[max(nearest - 1, 0) : nearest + 2]
    return float(np.sqrt(around.max()) * 1.12)


def _response(axes: "Axes", axis: AxisReport) -> list[Label]:
    """Mark the corner of the output filter."""
    response = axis.fit.response
    left, right = axes.get_xlim()
    if response is None or not left < response.cutoff_hz < right:
        return []
    axes.axvline(response.cutoff_hz, color=INK, linewidth=1.0, dashes=(2, 2), zorder=5)
    bottom, top = axes.get_ylim()
    text = f"output filter\n{response.kind}\n{response.cutoff_hz:.3g} Hz"
    heights = np.geomspace(bottom, top, 8)[1:-1]
    return [Label(text, np.full(heights.size, response.cutoff_hz), heights, INK)]


#: What `render` can make.
FORMATS = ("png", "svg", "pdf")

#: Inches.
WIDTH = 10.0
_PLOT_HEIGHT, _HEAD, _AXIS_ROOM, _ROW = 3.3, 0.72, 0.55, 0.2
#: Grade -> colour of the verdict.
_GRADES = {"good": "#1d6b35", "look": "#8a5200", "not-noise": "#b00020"}
#: Left edge and width of the two plots, in parts of the figure.
_LEFT, _RIGHT = (0.085, 0.497), (0.674, 0.312)


def check_format(form: str) -> None:
    """Raise a ValueError if no picture has such a format."""
    if form not in FORMATS:
        raise ValueError(f"format {form!r} is not one of {', '.join(FORMATS)}")


def axis_figure(report: Report, axis: AxisReport) -> "Figure":
    """Return the Allan deviation and the psd of one axis, with all that the fit says about them."""
    figure, left, right = _figure(report, rows=4)
    fit, units = axis.fit, units_of(report, axis.sensor)
    recorded, structure = _recorded(axis), str(fit.model) or "no term shown"
    write_head(figure, axis_title(axis), f"{recorded}   ·   model {structure} ({fit.method.upper()})")
    entries = draw_allan(left, fit, units)
    names = {str(entry.get_label()) for entry in entries}
    entries += [entry for entry in draw_psd(right, axis, units) if str(entry.get_label()) not in names]
    figure.legend(
        handles=entries,
        loc="lower center",
        bbox_to_anchor=(0.5, 0.24 / figure.get_figheight()),
        ncols=min(4, len(entries)),
        columnspacing=1.6,
        handlelength=3.2,
        **LEGEND_STYLE,
    )
    return figure


def sensor_figure(report: Report, sensor: Sensor) -> "Figure":
    """Return the curves and psds of a sensor's axes in one picture; a ValueError where it has none."""
    axes = report.by_sensor.get(sensor)
    if not axes:
        raise ValueError(f"the report has no {sensor} axis")
    seen = next(each for each in views(report) if each.sensor is sensor)
    units, rows = seen.units, _table_rows(seen)
    figure, left, right = _figure(report, rows=len(rows) + 2)
    write_head(figure, str(sensor).capitalize(), _recorded(axes[0]))
    draw_allan_overview(left, axes, units)
    draw_psd_overview(right, axes, units)
    _write_table(figure, axes, rows)
    return figure


#: Inches of a column of a paper, its height, and the points of all its text.
_COLUMN, _COLUMN_HEIGHT, _COLUMN_SIZE = 3.5, 2.8, 8.0


def paper_figure(report: Report, item: AxisReport | Sensor) -> "Figure":
    """Return Allan deviations for one column of a paper: no title, no foot, text of 8 points."""
    from matplotlib.text import Text

    figure = new_figure(_COLUMN, _COLUMN_HEIGHT)
    axes = figure.add_axes((0.17, 0.15, 0.81, 0.83))
    if isinstance(item, Sensor):
        draw_allan_overview(axes, report.by_sensor[item], units_of(report, item))
        name_axes(axes, report.by_sensor[item], markersize=3.8)
    else:
        draw_allan(axes, item.fit, units_of(report, item.sensor))
    for text in figure.findobj(Text):
        text.set_fontsize(_COLUMN_SIZE)
    return figure


def render(figure: "Figure", form: str, *, version: str = "") -> bytes:
    """Return the picture's file: png, svg or pdf, else a ValueError.

    The same report always gives the same png. It has a palette of 256 colours, which is enough for lines on
    white and makes it a third as large.
    """
    check_format(form)
    maker = f"imucal {version}".strip()
    stream = io.BytesIO()
    if form == "png":
        _save_png(figure, stream, maker)
    else:
        dated = "Date" if form == "svg" else "CreationDate"
        figure.savefig(stream, format=form, dpi=figure.dpi, metadata={"Creator": maker, dated: None})
    return stream.getvalue()


#: A pixel of it, as four bytes in one.
_WHITE = np.uint32(0xFFFFFFFF)


def _save_png(figure: "Figure", stream: io.BytesIO, maker: str) -> None:
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    canvas: Any = figure.canvas
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba()).view(np.uint32)[..., 0]
    # Nine tenths are white, and need no search for a palette: white is its last colour.
    inked = np.flatnonzero(pixels != _WHITE)
    ink = Image.fromarray(pixels.ravel()[inked].view(np.uint8).reshape(1, -1, 4), "RGBA").convert("RGB")
    ink = ink.quantize(255, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    indices = np.full(pixels.shape, 255, dtype=np.uint8)
    indices.ravel()[inked] = np.asarray(ink)[0]
    image = Image.fromarray(indices, "P")
    palette = (ink.getpalette() or [])[: 3 * 255]
    image.putpalette(palette + [0] * (3 * 255 - len(palette)) + [255] * 3)
    info = PngInfo()
    info.add_text("Software", maker)
    image.save(stream, "png", pnginfo=info, dpi=(figure.dpi, figure.dpi))


def units_of(report: Report, sensor: Sensor) -> SheetUnits:
    """Return the data-sheet units of a sensor's numbers."""
    return sheet_units([axis.fit for axis in report.by_sensor[sensor]])


def axis_title(axis: AxisReport) -> str:
    """Return ``Gyroscope x``."""
    return f"{str(axis.sensor).capitalize()} {axis.axis}"


def _figure(report: Report, *, rows: int) -> tuple["Figure", Any, Any]:
    """Return a figure with verdict and foot, two plots, and room for `rows` lines of text under them."""
    bottom = _AXIS_ROOM + _ROW * rows + 0.1
    height = bottom + _PLOT_HEIGHT + _HEAD
    figure = new_figure(WIDTH, height)
    plots = [
        figure.add_axes((place, bottom / height, width, _PLOT_HEIGHT / height))
        for place, width in (_LEFT, _RIGHT)
    ]
    write_foot(figure, report.source.name, report.version)
    # The verdict at the top right: a picture is passed on without its page.
    lines = "\n".join(textwrap.wrap(report.verdict.sentence, 110))
    style: Style = {"fontsize": SMALL_SIZE, "color": _GRADES[report.verdict.grade], "wrap": False}
    figure.text(0.988, 1 - 0.12 / height, lines, ha="right", va="top", **style)
    return figure, plots[0], plots[1]


def recording_text(duration_s: float, rate_hz: float, samples: int) -> str:
    """Return ``3 h at 200 Hz   ·   2 160 000 samples``."""
    count = f"{samples:,}".replace(",", " ")
    return f"{duration(duration_s)} at {rate_hz:.6g} Hz   ·   {count} samples"


def _recorded(axis: AxisReport) -> str:
    return recording_text(axis.duration_s, axis.rate_hz, axis.samples)


def _table_rows(seen: View) -> list[tuple[str, list[str]]]:
    """Return the rows under an overview: a name, and a text for each axis; T stands beside its term."""
    rows: dict[str, list[str]] = {}
    for row in seen.rows:
        key, _, time = row.key.partition(" ")
        if time:
            also = [f",  T {numbers.with_uncertainty(cell.si)}" if cell else "" for cell in row.cells]
            rows[key] = [text + more for text, more in zip(rows[key], also, strict=True)]
        else:
            rows[key] = _told(row)
            notes = [cell.note if cell and row.symbol else "" for cell in row.cells]
            if any(notes):
                rows[f"{key} note"] = notes
    return [("" if key.endswith(" note") else key, texts) for key, texts in rows.items()]


def _told(row: Row) -> list[str]:
    """Return the texts of a row with their unit, in one power of ten."""
    exponent = row.column(datasheet=True).exponent
    tell = numbers.with_uncertainty if row.symbol else numbers.with_interval
    return [tell(cell.sheet, exponent=exponent) if cell else "–" for cell in row.cells]


def _write_table(figure: "Figure", axes: list[AxisReport], rows: list[tuple[str, list[str]]]) -> None:
    """Write the table that also serves as the legend: its head draws each axis's line."""
    from matplotlib.lines import Line2D

    height = figure.get_figheight()
    columns = [0.1, 0.4, 0.7]
    y = (0.42 + _ROW * len(rows)) / height
    style: Style = {"fontsize": LEGEND_SIZE, "color": INK, "va": "baseline"}
    for axis, x in zip(axes, columns, strict=False):
        line = marked(axis.axis, linewidth=1.8, markersize=4)
        figure.add_artist(Line2D([x, x + 0.02, x + 0.04], [y + 0.045 / height] * 3, **line))
        figure.text(x + 0.048, y, axis.axis, **(style | {"fontweight": "bold"}))
    for key, texts in rows:
        y -= _ROW / height
        figure.text(0.02, y, key, **(style | {"fontweight": "bold"}))
        for text, x in zip(texts, columns, strict=False):
            figure.text(x, y, text, **style)


#: Format -> media type, of the formats that a page can show, the best first.
_SHOWN_BY_PAGES = {"png": "image/png", "svg": "image/svg+xml"}


@dataclass(slots=True)
class Drawings:
    """What was drawn, by the name of the file, and why files are missing, in their order."""

    files: dict[str, bytes] = field(default_factory=dict)
    failures: list[Finding] = field(default_factory=list)

    @property
    def addresses(self) -> dict[str, str]:
        """The pictures as addresses that hold them, for a page; by the names of files, less the ending."""
        return {
            name.removesuffix(f".{form}"): f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
            for form, kind in reversed(_SHOWN_BY_PAGES.items())
            for name, content in self.files.items()
            if name.endswith(f".{form}")
        }


def picture_names(report: Report, formats: Sequence[str], *, paper: bool = False) -> tuple[str, ...]:
    """Return the names of the files that are drawn of a report."""
    return tuple(name for item in _items(report) for name in _files(item, formats, paper=paper))


def _items(report: Report) -> tuple[AxisReport | Sensor, ...]:
    """Return what has a picture: each axis, and each sensor."""
    return (*report.axes, *report.by_sensor)


def _files(
    item: AxisReport | Sensor, formats: Sequence[str], *, paper: bool
) -> dict[str, Callable[[Report, Any], "Figure"]]:
    """Return the files of an item, and what draws each; for papers in formats that scale, else as pdf."""
    stem, whole = (item.short, sensor_figure) if isinstance(item, Sensor) else (item.name, axis_figure)
    scaling = [form for form in formats if form != "png"] or ["pdf"]
    return {
        **{f"{stem}.{form}": whole for form in formats},
        **{f"{stem}-paper.{form}": paper_figure for form in scaling if paper},
    }


def draw(
    report: Report,
    formats: Sequence[str],
    *,
    page: bool = False,
    paper: bool = False,
    workers: int | None = None,
) -> Drawings:
    """Draw the pictures of a report in some formats, each once.

    There are at most `workers` at a time, by default as many as the machine has processors. For a `page`
    there is a png where no other format would do. For a `paper` there are more, such as ``gyro-paper.pdf``.
    """
    wanted = tuple(formats)
    if page and not _SHOWN_BY_PAGES.keys() & set(wanted):
        wanted += ("png",)
    items = _items(report) if wanted or paper else ()
    count = threads() if workers is None else workers
    if count > 1 and items:
        # Loaded once, by the process that the others are forked from.
        import_module("matplotlib.figure")
        import_module("matplotlib.backends.backend_agg")
    drawn = Drawings()
    for one in side_by_side(partial(_draw_one, report, formats=wanted, paper=paper), items, workers=count):
        drawn.files |= one.files
        drawn.failures += one.failures
    return drawn


def _draw_one(
    report: Report, item: AxisReport | Sensor, *, formats: tuple[str, ...], paper: bool
) -> Drawings:
    """Build each figure of an item once, and make all of its files."""
    from matplotlib import rc_context

    made = cache(lambda figure: figure(report, item))
    result = Drawings()
    for name, figure in _files(item, formats, paper=paper).items():
        form = name.rpartition(".")[2]
        # At this size letters need no fitting to the pixels, which takes a tenth of the drawing.
        with rc_context({"text.hinting": "none"}):
            content, failed = try_side_work(
                lambda figure=figure, form=form: render(made(figure), form, version=report.version),  # type: ignore[misc]
                None,
                what=f"{name} was left out",
                code="not-drawn",
            )
        if content is not None:
            result.files[name] = content
        result.failures += failed
    return result
