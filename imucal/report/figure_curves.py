"""Draw the Allan deviation and the spectrum of axes, with model and terms."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray, IntArray
from imucal.fitting.noise_fit import Estimate, Line, NoiseFit
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.figure_style import (
    AXES,
    DATA,
    DOTS,
    INK,
    LEFT_OUT,
    LEGEND_SIZE,
    MARKERS,
    MODEL,
    UNUSED,
    Style,
    limits,
    stroked,
    style_axes,
)
from imucal.report.labels import Label, Obstacle, place_labels
from imucal.report.numbers import SheetUnits
from imucal.report.result import AxisReport
from imucal.report.smooth_spectrum import smooth_spectrum
from imucal.report.view import term_name
from imucal.units import pretty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: The band of a confidence interval.
_BAND: Style = {"color": "#9db7d1", "alpha": 0.5, "linewidth": 0, "zorder": 2}


class Drawn(NamedTuple):
    """An estimate to draw as a line."""

    estimate: Estimate
    term: NoiseTerm

    @property
    def bounded(self) -> bool:
        return self.estimate.value is None


def term_entries(fit: NoiseFit, terms: list[Drawn], marked_symbols: set[str]) -> list[Any]:
    """Return the legend's entries, one per symbol."""
    from matplotlib.lines import Line2D

    entries: Style = {}
    for drawn in terms:
        symbol = drawn.term.symbol
        name = f"{symbol}{' bound:' if drawn.bounded else ''} {term_name(symbol, fit.sensor)}"
        mark = _read_off_mark(drawn) if symbol in marked_symbols else {}
        line = stroked(drawn.term.stroke, linewidth=1.3, label=name, **mark)
        entries[symbol] = Line2D([], [], **line)
    return list(entries.values())


def _read_off_mark(drawn: Drawn) -> Style:
    marker, face = ("v", "white") if drawn.bounded else ("D", drawn.term.stroke.light)
    return {"marker": marker, "markersize": 5.5, "markerfacecolor": face}


def drawn_terms(fit: NoiseFit) -> list[Drawn]:
    """Return each term of the fit, and each bound."""
    found, terms = [], fit.terms_in_model
    for estimate in fit.estimates:
        term = terms.get(estimate.key)
        if estimate.value is None:
            known = 0 < estimate.high < math.inf and not TERMS[estimate.symbol].repeatable
            term = estimate.term(estimate.high) if known else None
        if term is not None:
            found.append(Drawn(estimate, term))
    return found


def estimate_text(estimate: Estimate, sensor: Sensor | None, units: SheetUnits) -> str:
    """Return ``N 0.4125 ± 0.0016 deg/√h``, then lines with T and alternatives."""
    lines = [f"{estimate.key} {numbers.with_uncertainty(units.estimate(estimate, sensor))}"]
    if estimate.correlation_time is not None:
        time = numbers.with_uncertainty(numbers.correlation_time(estimate.correlation_time))
        lines.append(f"T {time}")
    if note := numbers.alternatives(estimate):
        lines.append(note)
    return "\n".join(lines)


@dataclass(frozen=True, kw_only=True)
class SheetLine:
    """A term of a data sheet to draw, with its label."""

    label: str
    term: NoiseTerm


_SHEET: Style = {"color": UNUSED, "linewidth": 2.4, "linestyle": "--", "zorder": 1}

#: Cost of a label for each covered point of the data or of the model.
_BUSY = 2.0
#: Cost of a label for each covered point of a term.
_QUIET = 0.7
#: Factor below the curve down to which read-offs are visible.
_DEEPEST = 40.0


def draw_allan(
    axes: "Axes", fit: NoiseFit, units: SheetUnits, sheet: Sequence["SheetLine"] = ()
) -> list[Any]:
    """Draw one axis's curve, model, terms and lines of a data sheet; return the legend's entries."""
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
    obstacles = [
        Obstacle(curve.tau[shown], curve.adev[shown] * factor, _BUSY),
        Obstacle(tau, total, _BUSY),
    ]
    for each in sheet:
        deviation = np.sqrt(each.term.avar(m, 1 / rate)) * factor
        entries += axes.plot(tau, deviation, label=each.label, **_SHEET)
    labels = []
    for drawn in terms:
        line = np.sqrt(drawn.term.avar(m, 1 / rate)) * factor
        obstacles.append(Obstacle(tau, line, _QUIET))
        labels.append(_term(axes, fit, drawn, units, (tau, line, total)))
    marked_symbols = {d.term.symbol for d, label in zip(terms, labels, strict=True) if not np.ndim(label.x)}
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
    """Style the axes of Allan deviations in `unit`, at averaging times `tau` in s."""
    style_axes(
        axes,
        x="averaging time τ (s)",
        y=f"Allan deviation ({unit})",
        x_limits=limits(tau, below=1.6, above=1.9),
        y_limits=y_limits,
    )


def shown_points(curve: AllanCurve) -> IntArray:
    """Return the indices of points with at least 2 degrees of freedom; all if there are fewer than 2."""
    positive = curve.avar > 0
    sure = positive & ~(curve.edf < 2)
    return np.flatnonzero(sure if np.count_nonzero(sure) >= 2 else positive).astype(np.int64)


def smooth_adev(fit: NoiseFit, m: IntArray, points: int = 200) -> tuple[FloatArray, FloatArray]:
    """Return averaging factors, dense enough for a smooth line over `m`, and the model's deviations."""
    dense = np.unique(np.geomspace(m.min(), m.max(), points).round())
    return dense, np.sqrt(fit.model.avar(dense, rate_hz=fit.rate_hz))


def smooth_root(axis: AxisReport, points: int = 200) -> tuple[FloatArray, FloatArray]:
    """Return frequencies in Hz and the root of the model's density, in U/√Hz."""
    found = axis.spectrum.frequency
    grid = np.geomspace(found[0], found[-1], points) if found.size else found
    return grid, np.sqrt(axis.fit.model.psd(grid, rate_hz=axis.fit.rate_hz))


def _y_limits(adev: FloatArray, heights: list[float]) -> tuple[float, float]:
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
        # Above the labels' white boxes.
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
    """Draw a term's line and read-off; `lines` are tau, the term and the model."""
    stroke, (tau, line, total) = drawn.term.stroke, lines
    width, alpha = (1.0, 0.65) if drawn.bounded else (1.3, 1.0)
    axes.plot(tau, line, zorder=3, **stroked(stroke, linewidth=width, alpha=alpha))
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    at, height = drawn.term.read_off()
    height *= units.level.factor
    if at is None and not drawn.bounded:
        # Mark a floor where its share of the model is largest.
        at = float(tau[np.argmax(np.where((tau > left * 2) & (tau < right / 2), line / total, 0))])
    text = estimate_text(drawn.estimate, fit.sensor, units)
    if at is not None and left < at < right and bottom < height < top:
        axes.plot([at], [height], color=stroke.light, linestyle="none", zorder=8, **_read_off_mark(drawn))
        return Label(text, at, height, stroke.light)
    in_view = (line > bottom * 1.1) & (line < top / 1.1) & (tau > left) & (tau < right)
    inside = np.flatnonzero(in_view)
    if not inside.size:
        places = np.geomspace(left, right, 12)[1:-1]
        edge = np.full(places.size, bottom * (top / bottom) ** 0.01)
        return Label(f"{text} (below)", places, edge, stroke.light)
    some = inside[:: max(1, inside.size // 12)]
    return Label(text, tau[some], line[some], stroke.light)


#: The strongest lines have a label; all have a mark.
_NAMED_LINES = 3


def draw_psd(axes: "Axes", axis: AxisReport, units: SheetUnits) -> list[Any]:
    """Draw one axis's spectrum, model and terms; return the legend's entries."""
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
    place_labels(axes, labels, obstacles=[Obstacle(frequency, root, _BUSY)], fontsize=LEGEND_SIZE)
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
    """Mark the spectral lines that the fit left out; return labels of the strongest."""
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
    nearest = np.argmin(np.abs(axis.spectrum.frequency - line.frequency_hz))
    around = axis.spectrum.psd[max(nearest - 1, 0) : nearest + 2]
    return float(np.sqrt(around.max()) * 1.12)


def _response(axes: "Axes", axis: AxisReport) -> list[Label]:
    response = axis.fit.response
    left, right = axes.get_xlim()
    if response is None or not left < response.cutoff_hz < right:
        return []
    axes.axvline(response.cutoff_hz, color=INK, linewidth=1.0, dashes=(2, 2), zorder=5)
    bottom, top = axes.get_ylim()
    text = f"output filter\n-3 dB at {response.cutoff_hz:.3g} Hz"
    heights = np.geomspace(bottom, top, 8)[1:-1]
    return [Label(text, np.full(heights.size, response.cutoff_hz), heights, INK)]
