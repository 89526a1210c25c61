"""The pictures of a report: each axis by itself, and the three axes of a sensor together.

Drawn through matplotlib's object interface on the Agg canvas: no window, no pyplot, no state that
outlives a call. Sizes are chosen so that the smallest text has 9 px at a width of 800 px.
"""

import io
import textwrap
from typing import TYPE_CHECKING, Any

from imucal.fitting.noise_fit import Estimate
from imucal.noise.terms import TERMS
from imucal.printable import printable
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.figure_allan import MARKERS, draw_allan, draw_allan_overview
from imucal.report.figure_parts import LEGEND_SIZE, SMALL_SIZE, TITLE_SIZE, dashes, estimate_text, new_figure
from imucal.report.figure_psd import draw_psd, draw_psd_overview
from imucal.report.palette import AXES, FADED, INK
from imucal.report.result import AxisReport, Report
from imucal.report.sheet_units import SheetUnits, sheet_units
from imucal.units import duration

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: What `render` can make.
FORMATS = ("png", "svg", "pdf")

#: Inches.
_WIDTH = 10.0
_PLOT_HEIGHT, _HEAD, _AXIS_ROOM, _ROW = 3.3, 0.72, 0.55, 0.2
_DPI = 160
#: Of the pictures within the page.
_SMALL_DPI = 110
#: Grade -> colour of the verdict.
_GRADES = {"good": "#1d6b35", "look": "#8a5200", "not-noise": "#b00020"}
#: Left edge and width of the two plots, in parts of the figure.
_LEFT, _RIGHT = (0.085, 0.497), (0.674, 0.312)


def axis_figure(report: Report, axis: AxisReport) -> "Figure":
    """Return the Allan deviation and the psd of one axis, with all that the fit says about them."""
    figure, left, right = _figure(report, rows=4)
    _verdict(figure, report)
    fit, units = axis.fit, sheet_units(report, axis.sensor)
    structure = str(fit.model) or "no term shown"
    _head(figure, axis_title(axis), f"{_recording_text(axis)}   ·   model {structure} ({fit.method.upper()})")
    entries = draw_allan(left, axis, units)
    names = {str(entry.get_label()) for entry in entries}
    entries += [entry for entry in draw_psd(right, axis, units) if str(entry.get_label()) not in names]
    figure.legend(
        handles=entries,
        loc="lower center",
        bbox_to_anchor=(0.5, 0.24 / figure.get_figheight()),
        ncols=min(4, len(entries)),
        columnspacing=1.6,
        handlelength=3.2,
        fontsize=LEGEND_SIZE,
        frameon=False,
        labelcolor=INK,
    )
    return figure


def sensor_figure(report: Report, sensor: Sensor) -> "Figure":
    """Return the Allan deviations and psds of a sensor's axes in one picture.

    Raises
    ------
    ValueError
        If the report has no axis of `sensor`.
    """
    axes = [axis for axis in report.axes if axis.sensor is sensor]
    if not axes:
        msg = f"the report has no {sensor} axis"
        raise ValueError(msg)
    units = sheet_units(report, sensor)
    rows = _rows(axes, units)
    figure, left, right = _figure(report, rows=len(rows) + 2)
    _verdict(figure, report)
    _head(figure, str(sensor).capitalize(), _recording_text(axes[0]))
    draw_allan_overview(left, axes, units)
    draw_psd_overview(right, axes, units)
    _write_table(figure, axes, rows)
    return figure


def render(figure: "Figure", form: str, *, version: str = "") -> bytes:
    """Return the picture's file: png, svg or pdf; the same report always gives the same png.

    Raises
    ------
    ValueError
        If `form` is none of `FORMATS`.
    """
    if form not in FORMATS:
        msg = f"format {form!r} is not one of {', '.join(FORMATS)}"
        raise ValueError(msg)
    maker = f"imucal {version}".strip()
    metadata: dict[str, dict[str, str | None]] = {
        "png": {"Software": maker},
        "svg": {"Creator": maker, "Date": None},
        "pdf": {"Creator": maker, "CreationDate": None},
    }
    stream = io.BytesIO()
    figure.savefig(stream, format=form, dpi=figure.dpi, metadata=metadata[form])
    return stream.getvalue()


def render_small(figure: "Figure") -> bytes:
    """Return a picture as WebP without loss, small enough to be part of a page."""
    stream = io.BytesIO()
    figure.savefig(stream, format="webp", dpi=_SMALL_DPI, pil_kwargs={"lossless": True})
    return stream.getvalue()


def axis_title(axis: AxisReport) -> str:
    """Return ``Gyroscope x``."""
    return f"{str(axis.sensor).capitalize()} {axis.axis}"


def _figure(report: Report, *, rows: int) -> tuple["Figure", Any, Any]:
    """Return a figure with two plots and room for `rows` lines of text under them."""
    bottom = _AXIS_ROOM + _ROW * rows + 0.1
    height = bottom + _PLOT_HEIGHT + _HEAD
    figure = new_figure(_WIDTH, height, _DPI)
    plots = [
        figure.add_axes((place, bottom / height, width, _PLOT_HEIGHT / height))
        for place, width in (_LEFT, _RIGHT)
    ]
    name = printable(report.source.name)
    shown = name if len(name) <= 90 else f"…{name[-89:]}"
    # A dollar sign in a name starts no formula.
    style: dict[str, Any] = {"fontsize": SMALL_SIZE, "color": FADED, "va": "bottom", "parse_math": False}
    figure.text(0.012, 0.07 / height, shown, **style)
    figure.text(0.988, 0.07 / height, f"imucal {report.version}", ha="right", **style)
    return figure, plots[0], plots[1]


def _verdict(figure: "Figure", report: Report) -> None:
    """Write the verdict at the top right: a picture is passed on without its page."""
    text, height = report.verdict.sentence, figure.get_figheight()
    style: dict[str, Any] = {"fontsize": SMALL_SIZE, "color": _GRADES[report.verdict.grade], "wrap": False}
    lines = textwrap.wrap(text, 110)
    figure.text(0.988, 1 - 0.12 / height, "\n".join(lines), ha="right", va="top", **style)


def _head(figure: "Figure", title: str, subtitle: str) -> None:
    height = figure.get_figheight()
    style: dict[str, Any] = {"color": INK, "va": "top"}
    figure.text(0.012, 1 - 0.10 / height, title, fontsize=TITLE_SIZE, fontweight="bold", **style)
    figure.text(0.012, 1 - 0.38 / height, subtitle, fontsize=LEGEND_SIZE, **style)


def _recording_text(axis: AxisReport) -> str:
    count = f"{axis.samples:,}".replace(",", " ")
    return f"{duration(axis.duration_s)} at {axis.rate_hz:.6g} Hz   ·   {count} samples"


def _rows(axes: list[AxisReport], units: SheetUnits) -> list[tuple[str, list[str]]]:
    """Return the rows under an overview: a name, and a text for each axis."""
    estimates = [estimate for axis in axes for estimate in axis.fit.estimates]
    rows = []
    for key in dict.fromkeys(e.key for symbol in TERMS for e in estimates if e.symbol == symbol):
        found = [next((e for e in axis.fit.estimates if e.key == key), None) for axis in axes]
        rows.append((key, _row(found, axes[0].sensor, units)))
    lowest = [units.minimum(axis) for axis in axes]
    shared = numbers.engineering_exponent(lowest)
    return [*rows, ("minimum", [numbers.with_interval(each, exponent=shared) for each in lowest])]


def _row(found: list[Estimate | None], sensor: Sensor, units: SheetUnits) -> list[str]:
    """Return a term of each axis in one unit, with one power of ten."""
    shared = numbers.engineering_exponent(units.estimate(e, sensor) for e in found if e)
    texts = [estimate_text(e, sensor, units, exponent=shared) if e else "–" for e in found]
    keys = [f"{e.key} " if e else "" for e in found]
    return [text.removeprefix(key).replace("\n", ",  ") for text, key in zip(texts, keys, strict=True)]


def _write_table(figure: "Figure", axes: list[AxisReport], rows: list[tuple[str, list[str]]]) -> None:
    """Write the table that also serves as the legend: its head draws each axis's line."""
    from matplotlib.lines import Line2D

    height = figure.get_figheight()
    columns = [0.1, 0.4, 0.7]
    y = (0.42 + _ROW * len(rows)) / height
    style: dict[str, Any] = {"fontsize": LEGEND_SIZE, "color": INK, "va": "baseline"}
    for axis, x in zip(axes, columns, strict=False):
        stroke, middle = AXES[axis.axis], y + 0.045 / height
        marker = {"marker": MARKERS[axis.axis], "markersize": 4, "markerfacecolor": "white"}
        line = {"color": stroke.light, "linewidth": 1.8, **marker, **dashes(stroke)}
        figure.add_artist(Line2D([x, x + 0.02, x + 0.04], [middle] * 3, **line))
        figure.text(x + 0.048, y, axis.axis, **(style | {"fontweight": "bold"}))
    for key, texts in rows:
        y -= _ROW / height
        figure.text(0.02, y, key, **(style | {"fontweight": "bold"}))
        for text, x in zip(texts, columns, strict=False):
            figure.text(x, y, text, **style)
