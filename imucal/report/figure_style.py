"""The style of pictures: colours, text sizes, ticks of logarithmic scales, header and footer.

Colours are from Okabe & Ito (2008), "Color universal design", darkened for a contrast with white above 4.5.
Every colour also has its own line style or marker. All minor ticks are one artist, because matplotlib's own
are slow.
"""

import math
from collections.abc import Iterable
from itertools import product
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


INK = "#1c2733"
DATA = Stroke("#33414f", "#c9d4df", ())
MODEL = Stroke("#0063a3", "#5db6f2", ())
FADED = "#66717d"
#: Not used by the fit.
UNUSED = "#b4bcc5"
LEFT_OUT = "#b00020"
GRID = "#e3e7ec"
FRAME = "#9aa5b1"
AXES: dict[str, Stroke] = {
    "x": Stroke("#b84300", "#ff9157", ()),
    "y": Stroke("#0063a3", "#5db6f2", (6, 2)),
    "z": Stroke("#00734f", "#36c99a", (2, 1.5)),
}
_SIZE = 9.0
#: As a fraction of the plot's width.
_MINOR = 0.006
_MAX_TICKS = 8


def draw_ticks(axes: "Axes") -> None:
    """Draw ticks and grid lines for the current limits of the axes."""
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
            # The plot is wider than high.
            marks.append([(part, 0.0), (part, 1.5 * _MINOR)] if horizontal else [(0.0, part), (_MINOR, part)])
    axes.add_collection(
        LineCollection(marks, colors=FRAME, linewidths=0.7, transform=axes.transAxes, zorder=1.5),
        autolim=False,
    )
    axes.tick_params(labelsize=_SIZE, colors=INK)
    axes.grid(visible=True, which="major", color=GRID, linewidth=0.8)


def tick_places(low: float, high: float) -> tuple[list[float], list[float]]:
    """Return the positions of labelled and of minor ticks between two positive limits."""
    decades, inside = _multiples(low, high, (1,)), _multiples(low, high, range(1, 10))
    if len(decades) >= 3:
        step = math.ceil(len(decades) / _MAX_TICKS)
        if step == 1:
            return decades, inside
        return [place for place in decades if round(math.log10(place)) % step == 0], decades
    major = _multiples(low, high, (1, 2, 5))
    if len(major) >= 2:
        return major, inside
    return (inside if len(inside) >= 2 else [low, high]), []


def _multiples(low: float, high: float, digits: Iterable[int]) -> list[float]:
    powers = [10.0**e for e in range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)]
    return [digit * power for power, digit in product(powers, digits) if low <= digit * power <= high]


def tick_label(value: float) -> str:
    """Return ``0.01`` … ``1000`` as decimals, others as ``10⁻⁵`` or ``2×10⁻⁵``."""
    exponent = math.floor(math.log10(value) + 1e-9)
    if -2 <= exponent <= 3:
        return f"{value:.6g}"
    factor = round(value / 10.0**exponent, 6)
    power = numbers.ten_to(exponent)
    return power if factor == 1 else f"{factor:g}×{power}"


#: Points, for a figure 10 inches wide.
TITLE_SIZE, LABEL_SIZE, LEGEND_SIZE, SMALL_SIZE = 13.0, 9.5, 9.0, 8.5
Style: TypeAlias = dict[str, Any]
LABEL_STYLE: Style = {"fontsize": LABEL_SIZE, "color": INK, "labelpad": 3}
LEGEND_STYLE: Style = {"fontsize": LEGEND_SIZE, "frameon": False, "labelcolor": INK}
DOTS: Style = {"marker": "o", "markersize": 4.4, "linestyle": "none"}


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


MARKERS = {"x": "o", "y": "s", "z": "^"}
