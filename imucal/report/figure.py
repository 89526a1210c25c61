"""The pictures of a report: each axis alone, and the three axes of a sensor together.

They use matplotlib's Agg canvas without global state. Forked processes draw in parallel if possible.
"""

import base64
import io
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from imucal.errors import ChoiceError
from imucal.findings import Finding
from imucal.noise.terms import TERMS
from imucal.parallel import side_by_side
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.figure_curves import (
    SheetLine,
    draw_allan,
    draw_allan_overview,
    draw_psd,
    draw_psd_overview,
)
from imucal.report.figure_style import (
    INK,
    LEGEND_SIZE,
    LEGEND_STYLE,
    SMALL_SIZE,
    Style,
    marked,
    new_figure,
    write_foot,
    write_head,
)
from imucal.report.numbers import SheetUnits, sheet_units
from imucal.report.result import AxisReport, Report
from imucal.report.view import Column, Shown, View, views
from imucal.resources import threads
from imucal.side_work import try_side_work

if TYPE_CHECKING:
    from matplotlib.figure import Figure


#: Formats of pictures.
FORMATS = ("png", "svg", "pdf")
#: Width of a picture, in inches.
WIDTH = 10.0
#: Height of the plots, in inches.
_PLOT_HEIGHT = 3.3
#: Height of title, subtitle and verdict, in inches.
_HEAD = 0.72
#: Height of the labels of the lower scale, in inches.
_SCALE = 0.55
#: Height of a row of legend or table, in inches.
_ROW = 0.2
#: Left side and width of the Allan deviation, as fractions of the picture.
_ALLAN = (0.085, 0.497)
#: Left side and width of the spectrum, as fractions of the picture.
_SPECTRUM = (0.674, 0.312)
#: Left sides of the columns of the table, as fractions of the picture.
_COLUMNS = (0.1, 0.4, 0.7)
#: Most characters of a line of the verdict, which leaves space for the title.
_VERDICT = 110
#: Colour of the verdict by its grade.
_GRADES = {"good": "#1d6b35", "check": "#8a5200", "not-noise": "#b00020"}


def check_format(form: str) -> None:
    """Raise a ValueError for an unknown format."""
    if form not in FORMATS:
        raise ValueError(f"format {form!r} is not one of {', '.join(FORMATS)}")


def axis_figure(report: Report, axis: AxisReport) -> "Figure":
    """Return the Allan deviation and psd of one axis with model and terms."""
    figure, left, right = _figure(report, rows=4)
    fit, units = axis.fit, units_of(report, axis.sensor)
    recorded, structure = _recorded(axis), str(fit.model) or "no term detected"
    write_head(figure, axis_title(axis), f"{recorded}   ·   model {structure} ({fit.method.upper()})")
    entries = draw_allan(left, fit, units, _sheet_lines(report, axis))
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


def _sheet_lines(report: Report, axis: AxisReport) -> list[SheetLine]:
    """Return N and B of the data sheet that the log was compared with; nothing without `--sensor`."""
    name = report.settings.get("sensor")
    if not isinstance(name, str):
        return []
    from imucal.sensors import find_sensor

    try:
        part = find_sensor(name)
    except ChoiceError:
        # An edited report may name an unknown part: the picture has no line for it.
        return []
    terms = [term for symbol in ("N", "B") if (term := part.term(axis.sensor, symbol))]
    return [
        SheetLine(
            label=f"{term.symbol} of the data sheet, {part.name}", term=TERMS[term.symbol].of(term.reference)
        )
        for term in terms
    ]


def sensor_figure(report: Report, sensor: Sensor) -> "Figure":
    """Return the curves and psds of a sensor's axes; a ValueError if it has none."""
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


def render(figure: "Figure", form: str, *, version: str = "") -> bytes:
    """Return the content of a png, svg or pdf file; a ValueError for other formats.

    The same report always gives the same png; a palette of 256 colours reduces its size to a third.
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


def _save_png(figure: "Figure", stream: io.BytesIO, maker: str) -> None:
    """Write a png with 256 colours: a third of the size of matplotlib's, and pages contain the pictures."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    canvas: Any = figure.canvas
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    image = image.quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    # The quantizer rounds white to 254.
    image.putpalette([255 if level == 254 else level for level in image.getpalette() or []])
    info = PngInfo()
    info.add_text("Software", maker)
    image.save(stream, "png", pnginfo=info, dpi=(figure.dpi, figure.dpi))


def units_of(report: Report, sensor: Sensor) -> SheetUnits:
    """Return the data-sheet units of a sensor."""
    return sheet_units([axis.fit for axis in report.by_sensor[sensor]])


def axis_title(axis: AxisReport) -> str:
    """Return ``Gyroscope x``."""
    return f"{str(axis.sensor).capitalize()} {axis.axis}"


def _figure(report: Report, *, rows: int) -> tuple["Figure", Any, Any]:
    bottom = _SCALE + _ROW * rows + 0.1
    height = bottom + _PLOT_HEIGHT + _HEAD
    figure = new_figure(WIDTH, height)
    plots = [
        figure.add_axes((place, bottom / height, width, _PLOT_HEIGHT / height))
        for place, width in (_ALLAN, _SPECTRUM)
    ]
    write_foot(figure, report.source.name, report.version)
    # Pictures are often shared without the page.
    lines = "\n".join(textwrap.wrap(report.verdict.sentence, _VERDICT))
    style: Style = {"fontsize": SMALL_SIZE, "color": _GRADES[report.verdict.grade], "wrap": False}
    figure.text(0.988, 1 - 0.12 / height, lines, ha="right", va="top", **style)
    return figure, plots[0], plots[1]


def recording_text(duration_s: float, rate_hz: float, samples: int) -> str:
    """Return ``3 h at 200 Hz   ·   2 160 000 samples``."""
    count = f"{samples:,}".replace(",", " ")
    return f"{numbers.recorded(duration_s, rate_hz)}   ·   {count} samples"


def _recorded(axis: AxisReport) -> str:
    return recording_text(axis.duration_s, axis.rate_hz, axis.samples)


def _table_rows(seen: View) -> list[tuple[str, list[str]]]:
    """Return rows of a key and a text for each axis; notes have a row of their own."""
    rows = []
    for row in seen.rows:
        column = row.column(datasheet=True)
        rows.append((row.key, [_table_text(text, column) for text in column.texts]))
        notes = [text.note if text else "" for text in column.texts]
        if any(notes):
            rows.append(("", notes))
    return rows


def _table_text(text: Shown | None, column: Column) -> str:
    if text is None:
        return "–"
    return numbers.with_unit(f"{text.value} {text.interval}".rstrip(), column.exponent, column.unit)


def _write_table(figure: "Figure", axes: list[AxisReport], rows: list[tuple[str, list[str]]]) -> None:
    """Write the table, whose header is the legend."""
    from matplotlib.lines import Line2D

    height = figure.get_figheight()
    y = (0.42 + _ROW * len(rows)) / height
    style: Style = {"fontsize": LEGEND_SIZE, "color": INK, "va": "baseline"}
    for axis, x in zip(axes, _COLUMNS, strict=False):
        line = marked(axis.axis, linewidth=1.8, markersize=4)
        figure.add_artist(Line2D([x, x + 0.02, x + 0.04], [y + 0.045 / height] * 3, **line))
        figure.text(x + 0.048, y, axis.axis, **(style | {"fontweight": "bold"}))
    for key, texts in rows:
        y -= _ROW / height
        figure.text(0.02, y, key, **(style | {"fontweight": "bold"}))
        for text, x in zip(texts, _COLUMNS, strict=False):
            figure.text(x, y, text, **style)


#: Media types, the best first.
_SHOWN_BY_PAGES = {"png": "image/png", "svg": "image/svg+xml"}


@dataclass
class Drawings:
    """The pictures as name -> content, and a finding for each that failed."""

    files: dict[str, bytes] = field(default_factory=dict)
    failures: list[Finding] = field(default_factory=list)

    @property
    def addresses(self) -> dict[str, str]:
        """File stem -> data URL, for a page."""
        return {
            name.removesuffix(f".{form}"): f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
            for form, kind in reversed(_SHOWN_BY_PAGES.items())
            for name, content in self.files.items()
            if name.endswith(f".{form}")
        }


def picture_names(report: Report, formats: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the pictures of a report."""
    return tuple(name for item in _items(report) for name in _files(item, formats))


def _items(report: Report) -> tuple[AxisReport | Sensor, ...]:
    return (*report.axes, *report.by_sensor)


def _files(item: AxisReport | Sensor, formats: Sequence[str]) -> dict[str, str]:
    """Return file name -> format."""
    stem = item.short if isinstance(item, Sensor) else item.name
    return {f"{stem}.{form}": form for form in formats}


def draw(
    report: Report,
    formats: Sequence[str],
    *,
    page: bool = False,
    workers: int | None = None,
) -> Drawings:
    """Draw the pictures of a report in some formats.

    `page` adds png if a page can't show the formats.
    """
    wanted = tuple(formats)
    if page and not _SHOWN_BY_PAGES.keys() & set(wanted):
        wanted += ("png",)
    items = _items(report) if wanted else ()
    count = threads() if workers is None else workers
    if count > 1 and items:
        # Import once, before the fork.
        import_module("matplotlib.figure")
        import_module("matplotlib.backends.backend_agg")
    drawn = Drawings()
    for one in side_by_side(partial(_draw_one, report, formats=wanted), items, workers=count):
        drawn.files |= one.files
        drawn.failures += one.failures
    return drawn


def _draw_one(report: Report, item: AxisReport | Sensor, *, formats: tuple[str, ...]) -> Drawings:
    from matplotlib import rc_context

    @cache
    def figure() -> "Figure":
        return sensor_figure(report, item) if isinstance(item, Sensor) else axis_figure(report, item)

    result = Drawings()
    for name, form in _files(item, formats).items():
        # Hinting is invisible at this size, and slow.
        with rc_context({"text.hinting": "none"}):
            content, failed = try_side_work(
                lambda form=form: render(figure(), form, version=report.version),  # type: ignore[misc]
                None,
                what=f"{name} was left out",
                code="not-drawn",
            )
        if content is not None:
            result.files[name] = content
        result.failures += failed
    return result
