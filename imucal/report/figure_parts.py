"""What the plots of a picture share: sizes, axes, read-offs."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.noise_fit import Estimate
from imucal.noise.term import NoiseTerm, Stroke
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.log_ticks import draw_ticks
from imucal.report.palette import FRAME, INK
from imucal.report.result import AxisReport
from imucal.report.sheet_units import SheetUnits

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Text sizes in points, for a figure 10 inches wide.
TITLE_SIZE, LABEL_SIZE, LEGEND_SIZE, SMALL_SIZE = 13.0, 9.5, 9.0, 8.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """A term as a line: the estimate it draws, the term with its value or its bound.

    `tau_s` is where its coefficient is read off, in s; None for a floor.
    """

    estimate: Estimate
    term: NoiseTerm
    tau_s: float | None
    height: float


def new_figure(width: float, height: float, dpi: float) -> "Figure":
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
    axes.set_axisbelow(True)
    for spine, visible in (("left", True), ("bottom", True), ("top", False), ("right", False)):
        axes.spines[spine].set_visible(visible)
        axes.spines[spine].set_color(FRAME)
    axes.set_xlabel(x, fontsize=LABEL_SIZE, color=INK, labelpad=3)
    axes.set_ylabel(y, fontsize=LABEL_SIZE, color=INK, labelpad=3)
    draw_ticks(axes)


def limits(values: FloatArray, *, below: float, above: float) -> tuple[float, float]:
    """Return limits about the positive ones of `values`, with factors of room below and above."""
    positive = values[np.isfinite(values) & (values > 0)]
    if not positive.size:
        return 0.1, 10.0
    return float(positive.min() / below), float(positive.max() * above)


def dashes(stroke: Stroke) -> dict[str, Any]:
    """Return the line style of a stroke."""
    return {"dashes": stroke.dashes} if stroke.dashes else {}


def term_entries(axis: AxisReport, terms: list[Drawn]) -> list[Any]:
    """Return the legend's entries of the terms' lines, one for each symbol."""
    from matplotlib.lines import Line2D

    entries: dict[str, Any] = {}
    for drawn in terms:
        symbol, bounded = drawn.estimate.symbol, drawn.estimate.value is None
        stroke = TERMS[symbol].stroke
        name = f"{symbol}{' bound:' if bounded else ''} {TERMS[symbol].name(axis.sensor)}"
        marker: dict[str, Any] = {"marker": "v" if bounded else "D", "markersize": 5.5}
        face = "white" if bounded else stroke.light
        entries[symbol] = Line2D(
            [],
            [],
            color=stroke.light,
            linewidth=1.3,
            label=name,
            markerfacecolor=face,
            **marker,
            **dashes(stroke),
        )
    return list(entries.values())


def drawn_terms(axis: AxisReport) -> list[Drawn]:
    """Return the lines to draw: each term of the fit, and each bound as if it were the value."""
    found = []
    by_symbol = {term.symbol: term for term in axis.fit.model.terms}
    for estimate in axis.fit.estimates:
        if TERMS[estimate.symbol].repeatable:
            term: NoiseTerm | None = numbers.gauss_markov_term(axis.fit, estimate)
        elif estimate.value is None:
            term = _bound(estimate)
        else:
            term = by_symbol.get(estimate.symbol)
        if term is not None:
            found.append(_drawn(estimate, term))
    return found


def estimate_text(
    estimate: Estimate, sensor: Sensor, units: SheetUnits, *, exponent: int | None = None
) -> str:
    """Return ``N 0.4125 ± 0.0016 deg/√h``; a Gauss-Markov term has its T on a second line."""
    quantity = units.estimate(estimate, sensor)
    text = f"{estimate.key} {numbers.with_uncertainty(quantity, exponent=exponent)}"
    if estimate.correlation_time is None:
        return text
    time = numbers.with_uncertainty(numbers.correlation_time(estimate.correlation_time))
    return f"{text}\nT {time}"


def _bound(estimate: Estimate) -> NoiseTerm | None:
    if not (math.isfinite(estimate.high) and estimate.high > 0):
        return None
    return TERMS[estimate.symbol].of(estimate.high)


def _drawn(estimate: Estimate, term: NoiseTerm) -> Drawn:
    tau_s, height = term.read_off()
    return Drawn(estimate=estimate, term=term, tau_s=tau_s, height=height)
