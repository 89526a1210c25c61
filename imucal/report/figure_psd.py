"""The spectrum as a plot: the root of the two-sided psd, in which white noise has the height N."""

from typing import TYPE_CHECKING, Any

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.noise_fit import Line
from imucal.noise.terms import TERMS
from imucal.report.figure_parts import (
    LEGEND_SIZE,
    Drawn,
    dashes,
    drawn_terms,
    limits,
    style_axes,
)
from imucal.report.labels import Label, place_labels
from imucal.report.palette import AXES, DATA, INK, LEFT_OUT, MODEL, UNUSED
from imucal.report.result import AxisReport
from imucal.report.sheet_units import SheetUnits
from imucal.report.smooth_spectrum import smooth_spectrum
from imucal.units import pretty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: At most this many lines are named, the strongest first; all are marked.
_NAMED_LINES = 3


def draw_psd(axes: "Axes", axis: AxisReport, units: SheetUnits) -> list[Any]:
    """Draw one axis's spectrum, model and terms in data-sheet units; return the entries of the legend."""
    smooth, factor = smooth_spectrum(axis), units.density.factor
    frequency, root = smooth.frequency, smooth.root * factor
    style_axes(
        axes,
        x="frequency (Hz)",
        y=f"√PSD, two-sided ({pretty(units.density.name)})",
        x_limits=limits(axis.spectrum.frequency, below=1.3, above=1.3),
        y_limits=limits(root, below=2.0, above=2.2),
    )
    if not frequency.size:
        axes.text(0.5, 0.5, "no samples, no spectrum", transform=axes.transAxes, ha="center", color=INK)
        return []
    band: dict[str, Any] = {"color": "#9db7d1", "alpha": 0.5, "linewidth": 0, "zorder": 2}
    axes.fill_between(frequency, smooth.low * factor, smooth.high * factor, **band)
    axes.plot(frequency, root, color=DATA.light, linewidth=1.0, zorder=4)
    grid = np.geomspace(axis.spectrum.frequency[0], axis.spectrum.frequency[-1], 200)
    for drawn in drawn_terms(axis):
        _term(axes, axis, drawn, grid, factor)
    if axis.fit.model.terms:
        model = np.sqrt(axis.fit.model.psd(grid, rate_hz=axis.fit.rate_hz)) * factor
        axes.plot(grid, model, color=MODEL.light, linewidth=1.8, zorder=6)
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
        grid = np.geomspace(axis.spectrum.frequency[0], axis.spectrum.frequency[-1], 200)
        model = np.sqrt(axis.fit.model.psd(grid, rate_hz=axis.fit.rate_hz)) * factor
        axes.plot(grid, model, color=stroke.light, linewidth=1.6, **dashes(stroke))
        values.append(root)
        places.append(grid)
    style_axes(
        axes,
        x="frequency (Hz)",
        y=f"√PSD, two-sided ({pretty(units.density.name)})",
        x_limits=limits(np.concatenate(places), below=1.3, above=1.3),
        y_limits=limits(np.concatenate(values), below=2.0, above=2.2),
    )


def _term(axes: "Axes", axis: AxisReport, drawn: Drawn, grid: FloatArray, factor: float) -> None:
    density = np.sqrt(drawn.term.psd(grid, 1 / axis.fit.rate_hz)) * factor
    stroke = TERMS[drawn.estimate.symbol].stroke
    if drawn.estimate.value is not None and np.any(density > 0):
        axes.plot(grid, density, color=stroke.light, linewidth=1.1, zorder=3, **dashes(stroke))


def _unused_band(axes: "Axes", axis: AxisReport) -> list[Any]:
    """Grey what lies outside the band of the fit."""
    band = axis.fit.goodness.band_hz
    if band is None:
        return []
    left, right = axes.get_xlim()
    spectrum = axis.spectrum.frequency
    spans = []
    if spectrum[0] < band[0]:
        spans.append((left, band[0]))
    if spectrum[-1] > band[1] * 1.01:
        spans.append((band[1], right))
    style: dict[str, Any] = {"color": UNUSED, "alpha": 0.3, "linewidth": 0, "zorder": 1}
    made = [axes.axvspan(*span, label="band not used by the fit", **style) for span in spans]
    return made[:1]


def _lines(axes: "Axes", axis: AxisReport, entries: list[Any], factor: float) -> list[Label]:
    """Mark the spectral lines that the fit left out; return names for the strongest."""
    lines = axis.fit.goodness.lines
    if not lines:
        return []
    at = [line.frequency_hz for line in lines]
    heights = [_height(axis, line) * factor for line in lines]
    entries += axes.plot(
        at,
        heights,
        marker="v",
        markersize=6,
        color=LEFT_OUT,
        linestyle="none",
        zorder=9,
        label="line left out of the fit",
    )
    strongest = sorted(zip(lines, heights, strict=True), key=lambda pair: -pair[0].amplitude)[:_NAMED_LINES]
    return [
        Label(
            text=f"{line.frequency_hz:.4g} Hz",
            x=np.array([line.frequency_hz]),
            y=np.array([height]),
            colour=LEFT_OUT,
        )
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
    return [Label(text=text, x=np.full(heights.size, response.cutoff_hz), y=heights, colour=INK)]
