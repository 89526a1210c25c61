"""The style of pictures: colours, text sizes, ticks of logarithmic scales, header and footer.

Colours are from Okabe & Ito (2008), "Color universal design", darkened for a contrast with white above 4.5.
Every colour also has its own line style or marker.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from imucal.arrays import FloatArray
from imucal.noise.term import Stroke
from imucal.printable import printable
from imucal.recording import Axis
from imucal.report import numbers
from imucal.report.result import AxisReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator


#: Colour of text.
INK = "#1c2733"
#: Measured values.
DATA = Stroke("#33414f", "#c9d4df", ())
#: The fitted model.
MODEL = Stroke("#0063a3", "#5db6f2", ())
#: Colour of remarks.
FADED = "#66717d"
#: Colour of data that the fit did not use.
UNUSED = "#b4bcc5"
#: Colour of spectral lines that the fit left out.
LEFT_OUT = "#b00020"
#: Colour of grid lines.
GRID = "#e3e7ec"
#: Colour of the frame and of minor ticks.
FRAME = "#9aa5b1"
#: Colours and dashes of the axes of a sensor, in pictures with all three.
AXES: dict[str, Stroke] = {
    "x": Stroke("#b84300", "#ff9157", ()),
    "y": Stroke("#0063a3", "#5db6f2", (6, 2)),
    "z": Stroke("#00734f", "#36c99a", (2, 1.5)),
}
#: Markers of the axes of a sensor, in pictures with all three.
MARKERS = {"x": "o", "y": "s", "z": "^"}
#: Size of the title, in points, for a figure 10 inches wide.
TITLE_SIZE = 13.0
#: Size of the labels of scales, in points.
LABEL_SIZE = 9.5
#: Size of legends and of labels in plots, in points.
LEGEND_SIZE = 9.0
#: Size of remarks, in points.
SMALL_SIZE = 8.5
#: Arguments of matplotlib.
Style: TypeAlias = dict[str, Any]
#: Labels of scales.
LABEL_STYLE: Style = {"fontsize": LABEL_SIZE, "color": INK, "labelpad": 3}
#: Legends.
LEGEND_STYLE: Style = {"fontsize": LEGEND_SIZE, "frameon": False, "labelcolor": INK}
#: Points of a curve.
DOTS: Style = {"marker": "o", "markersize": 4.4, "linestyle": "none"}
#: Size of the labels of ticks, in points.
_SIZE = 9.0
#: Digits of ticks without a label: drawing all nine takes a second per report.
_MINOR = (1, 2, 5)
#: Largest number of labelled ticks of decades; more would touch each other in the narrower plot.
_MAX_TICKS = 8
#: Digits whose ticks are labelled, and the fewest ticks in view; with fewer, the next digits are tried.
_LABELLED: tuple[tuple[Sequence[int], int], ...] = (((1,), 3), ((1, 2, 5), 2), (range(1, 10), 1))


def draw_ticks(axes: "Axes") -> None:
    """Set ticks and grid lines of logarithmic axes, whose limits must be final."""
    from matplotlib.ticker import FuncFormatter, NullFormatter

    for axis in (axes.xaxis, axes.yaxis):
        major, minor = _locators(*axis.get_view_interval())
        axis.set_major_locator(major)
        axis.set_major_formatter(FuncFormatter(lambda value, _: tick_label(value)))
        axis.set_minor_locator(minor)
        axis.set_minor_formatter(NullFormatter())
    axes.tick_params(labelsize=_SIZE, colors=INK)
    axes.tick_params(which="minor", color=FRAME)
    axes.grid(visible=True, which="major", color=GRID, linewidth=0.8)


def _locators(low: float, high: float) -> "tuple[LogLocator, LogLocator]":
    """Return the locators of labelled and of minor ticks between two positive limits."""
    from matplotlib.ticker import LogLocator

    for digits, fewest in _LABELLED:
        major = LogLocator(subs=digits, numticks=_MAX_TICKS)
        if len(_in_view(major, low, high)) >= fewest:
            break
    return major, LogLocator(subs=_MINOR, numticks=_MAX_TICKS)


def tick_places(low: float, high: float) -> tuple[list[float], list[float]]:
    """Return the positions of labelled and of minor ticks, for axes that are not logarithmic themselves."""
    major, minor = _locators(low, high)
    return _in_view(major, low, high), _in_view(minor, low, high)


def _in_view(locator: "LogLocator", low: float, high: float) -> list[float]:
    places = [float(place) for place in locator.tick_values(low, high)]
    return [place for place in places if low <= place <= high]


def tick_label(value: float) -> str:
    """Return ``0.01`` … ``1000`` as decimals, others as ``10⁻⁵`` or ``2×10⁻⁵``."""
    exponent = math.floor(math.log10(value) + 1e-9)
    if -2 <= exponent <= 3:
        return f"{value:.6g}"
    factor = round(value / 10.0**exponent, 6)
    power = numbers.ten_to(exponent)
    return power if factor == 1 else f"{factor:g}×{power}"


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
    """Make both scales logarithmic; set labels, light grid lines and final limits."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(*x_limits)
    axes.set_ylim(*y_limits)
    quiet_frame(axes)
    axes.set_xlabel(x, **LABEL_STYLE)
    axes.set_ylabel(y, **LABEL_STYLE)
    draw_ticks(axes)


def quiet_frame(axes: "Axes") -> None:
    """Keep only the left and lower side of the frame."""
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(FRAME)


def write_head(figure: "Figure", title: str, subtitle: str, *, below: float = 0.38) -> None:
    """Write title and subtitle, which is `below` inches under the edge."""
    height = figure.get_figheight()
    style: Style = {"color": INK, "va": "top"}
    figure.text(0.012, 1 - 0.10 / height, title, fontsize=TITLE_SIZE, fontweight="bold", **style)
    figure.text(0.012, 1 - below / height, subtitle, fontsize=LEGEND_SIZE, **style)


def write_foot(figure: "Figure", source: str, version: str) -> None:
    """Write the log's name, shortened at its start, and imucal's version."""
    name = printable(source)
    shown = name if len(name) <= 90 else f"…{name[-89:]}"
    # A dollar sign in a name must not start a formula.
    style: Style = {"fontsize": SMALL_SIZE, "color": FADED, "va": "bottom", "parse_math": False}
    y = 0.07 / figure.get_figheight()
    figure.text(0.012, y, shown, **style)
    figure.text(0.988, y, f"imucal {version}", ha="right", **style)


def limits(values: FloatArray, *, below: float, above: float) -> tuple[float, float]:
    """Return limits around positive `values`, with margins by the factors `below` and `above`."""
    positive = values[np.isfinite(values) & (values > 0)]
    if not positive.size:
        return 0.1, 10.0
    return float(positive.min() / below), float(positive.max() * above)


def stroked(stroke: Stroke, **style: object) -> Style:
    """Return the style of a line with a stroke's colour and dashes."""
    return {"color": stroke.light, **style, **({"dashes": stroke.dashes} if stroke.dashes else {})}


def marked(axis: Axis, **style: object) -> Style:
    """Return the style of an axis's line in an overview."""
    return stroked(AXES[axis], marker=MARKERS[axis], markerfacecolor="white", **style)


def name_axes(axes: "Axes", reports: list[AxisReport], **style: object) -> None:
    """Add a legend of the axes in an overview."""
    for axis in reports:
        axes.plot([], [], label=axis.axis, **marked(axis.axis, **style))
    axes.legend(loc="upper right", **LEGEND_STYLE)
