"""The pictures of a fleet: the units of each sensor model, sorted by each term."""

import io
import itertools
import math
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from imucal.fleet.page import bound_name, sheet_unit
from imucal.fleet.population import UnitValue
from imucal.fleet.summary import Fleet, FleetTerm, SensorModel
from imucal.recording import Sensor
from imucal.report.figure_style import (
    DATA,
    GRID,
    INK,
    LABEL_SIZE,
    LEFT_OUT,
    MODEL,
    SMALL_SIZE,
    TITLE_SIZE,
    Style,
    new_figure,
    quiet_frame,
    tick_label,
    tick_places,
)
from imucal.units import DatasheetUnit, pretty

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DPI = 110
_BOUND = "#8a5200"
#: Most units with names: the names of more would be too small to read.
_NAMED = 60
#: Height of a row in inches: a line of the smallest text.
_ROW = 0.17
#: Height of the tallest panel in inches: a page.
_TALLEST = 9.0
#: Most characters of a name.
_LONGEST = 20
_SMALL: Style = {"fontsize": SMALL_SIZE, "color": INK}
_LABEL: Style = {"fontsize": LABEL_SIZE, "color": INK}
_NEAR: Style = {"fontsize": SMALL_SIZE, "textcoords": "offset points"}
#: Factor by which a whisker or bound ends below the lowest value.
_BELOW = 3.0


class Picture(NamedTuple):
    """A picture of the units of a sensor model: the name of its file, and a description."""

    name: str
    model: SensorModel
    shows: str
    draw: Callable[[], "Figure"]


def fleet_pictures(fleet: Fleet) -> Iterator[Picture]:
    """Yield the pictures, one for each sensor of each model, in the order of their files."""
    for model in fleet.models:
        name = re.sub(r"[^\w.-]|_", "-", model.name).strip(".") or "model"
        end = f"-{name}" if len(fleet.models) > 1 else ""
        for sensor in dict.fromkeys(term.sensor for term in model.terms):
            shows = f"{model.title}, {sensor}: units sorted, each with its 95 % interval"
            yield Picture(f"units-{sensor.short}{end}", model, shows, partial(units_figure, model, sensor))


def drawn_as(draw: Callable[[], "Figure"], forms: Sequence[str]) -> dict[str, bytes]:
    """Return a picture in some formats; the same picture always gives the same bytes."""
    from matplotlib import rc_context

    files = {}
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "imucal"}), warnings.catch_warnings():
        # Letters that the font lacks are boxes in the PNG; the page and the tables have them.
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        figure = draw()
        for form in forms:
            stream = io.BytesIO()
            metadata = {"Software": None} if form == "png" else {"Date": None, "Creator": None}
            figure.savefig(stream, format=form, metadata=metadata)
            files[form] = stream.getvalue()
    return files


def units_figure(model: SensorModel, sensor: Sensor) -> "Figure":
    """Return a sensor's terms by axes: units sorted, with intervals, band, median and bound."""
    own = (term for term in model.terms if term.sensor is sensor)
    groups = [list(terms) for _, terms in itertools.groupby(own, lambda term: term.term)]
    columns = max(len(terms) for terms in groups)
    tall = min(_TALLEST, max(1.4, _ROW * len(model.units)))
    figure = new_figure(4.0 * columns, (tall + 0.95) * len(groups) + 0.9, _DPI)
    axes = figure.subplots(len(groups), columns, squeeze=False)
    for row, terms in zip(axes, groups, strict=True):
        for place, term in zip(row, terms, strict=False):
            _draw_units(place, term)
        for place in row[len(terms) :]:
            place.set_visible(False)
    # In inches: figures of many units are tall.
    top = 1 - 0.1 / figure.get_figheight()
    title = f"{model.title}, {sensor}: {len(model.units)} units"
    figure.suptitle(title, y=top, fontsize=TITLE_SIZE, color=INK)
    _key(figure, columns)
    figure.tight_layout(rect=(0, 0.3 * (1 + (columns == 1)) / figure.get_figheight(), 1, top))
    return figure


def _key(figure: "Figure", columns: int) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    marks = {
        "unit": Line2D([], [], color=DATA.light, linewidth=1, marker="o", markersize=4.5),
        "upper bound": Line2D([], [], color=DATA.light, linestyle="", marker="<", markerfacecolor="white"),
        "odd unit": Line2D([], [], color=LEFT_OUT, linestyle="", marker="D", markersize=4.5),
        "median unit": Line2D([], [], color=MODEL.light, linewidth=1.4),
        "next unit, 95 %": Patch(facecolor=MODEL.light, alpha=0.13),
        "tolerance bound": Line2D([], [], color=_BOUND, linewidth=1.5, linestyle="--"),
    }
    figure.legend(
        list(marks.values()),
        list(marks),
        loc="lower center",
        ncols=3 if columns == 1 else len(marks),
        frameon=False,
        fontsize=SMALL_SIZE,
        labelcolor=INK,
        columnspacing=1.2,
        handletextpad=0.5,
    )


def _draw_units(axes: "Axes", term: FleetTerm) -> None:
    unit, found = sheet_unit(term), term.population
    units = sorted_units(term)[::-1]
    factor = unit.factor
    low, high = (limit * factor for limit in span(term))
    _draw_marks(axes, units, factor, low)
    if found.prediction:
        band = [max(limit * factor, low) for limit in found.prediction]
        axes.axvspan(*band, color=MODEL.light, alpha=0.13, linewidth=0)
    if found.middle:
        axes.axvline(found.middle * factor, color=MODEL.light, linewidth=1.4)
    if found.tolerance:
        axes.axvline(found.tolerance * factor, color=_BOUND, linewidth=1.5, linestyle="--")
        at, units_of = (found.tolerance * factor, 1.0), ("data", "axes fraction")
        axes.annotate(bound_name(term), at, (0, 2), units_of, ha="center", color=_BOUND, **_NEAR)
    named = {i: _shortened(one.unit) for i, one in enumerate(units) if len(units) <= _NAMED or one.odd}
    axes.set_yticks([*named], [*named.values()], fontsize=SMALL_SIZE - 1, color=INK)
    _log_axis(axes, term, unit, low, high)
    axes.set_ylim(-0.8, len(units) - 0.2)


def _shortened(name: str) -> str:
    """Return a name without its middle if it would need the space of the panel."""
    return name if len(name) <= _LONGEST else f"{name[: _LONGEST // 2]}…{name[-_LONGEST // 2 + 1 :]}"


def _draw_marks(axes: "Axes", units: Sequence[UnitValue], factor: float, least: float) -> None:
    """Draw a dot and an interval per unit: a diamond for an odd one, an open triangle for a bound.

    Intervals of bounds start at `least`.
    """
    kinds: dict[tuple[bool, bool], list[tuple[int, UnitValue]]] = {}
    for row, unit in enumerate(units):
        kinds.setdefault((unit.value is None, unit.odd), []).append((row, unit))
    for (bounded, odd), own in kinds.items():
        colour = LEFT_OUT if odd else DATA.light
        rows = [row for row, _ in own]
        starts = [least if bounded else unit.low * factor for _, unit in own]
        ends = [unit.high * factor for _, unit in own]
        axes.hlines(rows, starts, ends, colors=colour, linewidth=1, linestyles=":" if bounded else "-")
        axes.plot(
            [(unit.value or unit.high) * factor for _, unit in own],
            rows,
            marker="<" if bounded else "D" if odd else "o",
            markersize=4.5,
            color=colour,
            markerfacecolor="white" if bounded else colour,
            linestyle="",
        )


def _style(axes: "Axes", x: str, title: str) -> None:
    axes.set_xlabel(x, **_LABEL)
    axes.set_title(title, fontsize=LABEL_SIZE + 1, color=INK, loc="left", pad=12)
    axes.grid(visible=True, axis="x", color=GRID, linewidth=0.8)
    axes.tick_params(labelsize=SMALL_SIZE, colors=INK, length=3)
    quiet_frame(axes)
    axes.spines["left"].set_visible(False)


def _log_axis(axes: "Axes", term: FleetTerm, unit: DatasheetUnit, low: float, high: float) -> None:
    places, labels, power = labelled_ticks(low, high)
    _style(axes, f"{term.term} in {power}{pretty(unit.name)}", f"{term.name} {term.term}")
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    axes.set_xticks(places, labels)
    axes.set_xticks([], minor=True)


def sorted_units(term: FleetTerm) -> list[UnitValue]:
    """Return the units from the largest to the smallest; bounded units by their upper limits."""
    return sorted(term.population.units, key=lambda unit: -(unit.value or unit.high))


def span(term: FleetTerm) -> tuple[float, float]:
    """Return the limits of a scale, which may cut whiskers."""
    found = term.population
    values = [unit.value or unit.high for unit in found.units]
    values += [found.median.value, *(found.prediction or ()), *([found.tolerance] if found.tolerance else ())]
    low, high = min(value for value in values if value > 0), max(values)
    shown = [unit for unit in found.units if unit.value]
    low = max(min([low, *(unit.low for unit in shown)]), low / _BELOW)
    high = min(max([high, *(unit.high for unit in shown)]), high * _BELOW)
    return low / 1.06, high * 1.06


def labelled_ticks(low: float, high: float) -> tuple[list[float], list[str], str]:
    """Return places, labels, and the power of ten before the unit, such as ``10⁻³ ``."""
    places = _round_ticks(low, high)
    power = math.floor(math.log10(min(places)) + 1e-9)
    if -2 <= power <= 3:
        # Plain numbers: 8000, 10000, and not 8000, 10⁴.
        plain = max(places) < 1e6
        return places, [f"{place:.6g}" if plain else tick_label(place) for place in places], ""
    labels = [f"{place / 10.0**power:.4g}" for place in places]
    return places, labels, f"{tick_label(10.0**power)} "


def _round_ticks(low: float, high: float) -> list[float]:
    """Return three to six round values between two limits; fewer if the limits are close."""
    places = tick_places(low, high)[0]
    if len(places) >= 3 and high / low >= 3:
        return places[:: math.ceil(len(places) / 6)]
    step = 10.0 ** math.floor(math.log10(high - low))
    for part in (0.1, 0.2, 0.5, 1.0, 2.0):
        size = part * step
        first, last = math.ceil(low / size), math.floor(high / size)
        if last - first + 1 <= 5:
            return [float(f"{i * size:.6g}") for i in range(first, last + 1)]
    return places
