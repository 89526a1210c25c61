"""The pictures of a fleet: units sorted by each term, models side by side, and units against terms."""

import io
import math
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from imucal.fleet.population import Population, UnitValue
from imucal.fleet_report.pages import bound_name, by_term, sheet_unit
from imucal.fleet_report.summary import Fleet, FleetTerm, SensorModel
from imucal.recording import Sensor
from imucal.report.figure_style import (
    DATA,
    FADED,
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
#: Most units with names; height of a row and of the tallest panel, in inches.
_NAMED, _ROW, _TALLEST = 60, 0.17, 9.0
_SMALL: Style = {"fontsize": SMALL_SIZE, "color": INK}
_LABEL: Style = {"fontsize": LABEL_SIZE, "color": INK}
_NEAR: Style = {"fontsize": SMALL_SIZE, "textcoords": "offset points"}
#: Half the width of a band of 95 %, in standard deviations.
_BAND_SDS = 1.96
#: Factor by which a whisker or bound ends below the lowest value.
_BELOW = 3.0
#: Installed fonts; the last one has a box for any other sign.
_FONTS = (
    *("Noto Sans", "Noto Sans CJK SC", "Noto Sans CJK JP", "Source Han Sans SC", "WenQuanYi Zen Hei"),
    *("PingFang SC", "Hiragino Sans", "Apple SD Gothic Neo", "Microsoft YaHei", "Yu Gothic", "Malgun Gothic"),
    *("Arial Unicode MS", "Last Resort High-Efficiency"),
)


class Picture(NamedTuple):
    """A picture of a fleet and its section of the page."""

    name: str
    section: str
    shows: str
    draw: Callable[[], "Figure"]


def fleet_pictures(fleet: Fleet) -> Iterator[Picture]:
    """Yield the pictures, in the order of their files."""
    several = len(fleet.models) > 1
    for number, model in enumerate(fleet.models):
        name = re.sub(r"[^\w.-]|_", "-", model.name).strip(".") or "model"
        end = f"-{name}" if several else ""
        for sensor in dict.fromkeys(term.sensor for term in model.terms):
            shows = f"{model.title}, {sensor}: units sorted, each with its 95 % interval"
            draw = partial(units_figure, model, sensor)
            yield Picture(f"units-{sensor.short}{end}", f"units-{number}", shows, draw)
        shows = f"{model.title}: distance of each unit from the median in each term"
        yield Picture(f"heat{end}", "heat", shows, partial(heat_figure, model))
    if several:
        shows = "Each term of each axis: one row per model, one dot per unit"
        yield Picture("models", "models", shows, partial(models_figure, fleet.models))


def drawn_as(draw: Callable[[], "Figure"], forms: Sequence[str]) -> dict[str, bytes]:
    """Return a picture in some formats; the same picture always gives the same bytes.

    Characters that the usual font lacks come from other installed fonts.
    """
    from matplotlib import rc_context, rcParams
    from matplotlib.font_manager import fontManager

    installed, files = {font.name for font in fontManager.ttflist}, {}
    families = [*rcParams["font.family"], *(name for name in _FONTS if name in installed)]
    settings: Any = {"font.family": families, "svg.fonttype": "none", "svg.hashsalt": "imucal"}
    with rc_context(settings), warnings.catch_warnings():
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
    groups = [terms for terms in by_term(model).values() if terms[0].sensor is sensor]
    columns = max(len(terms) for terms in groups)
    tall = min(_TALLEST, max(1.4, _ROW * len(model.units)))
    figure = new_figure(4.0 * columns, (tall + 0.95) * len(groups) + 0.9, _DPI)
    axes = figure.subplots(len(groups), columns, squeeze=False)
    for row, terms in zip(axes, groups, strict=True):
        for place, term in zip(row, terms, strict=False):
            _draw_units(place, term)
        for place in row[len(terms) :]:
            place.set_visible(False)
    figure.suptitle(f"{model.title}, {sensor}: {len(model.units)} units", fontsize=TITLE_SIZE, color=INK)
    _key(figure, columns)
    figure.tight_layout(rect=(0, 0.3 * (1 + (columns == 1)) / figure.get_figheight(), 1, 0.99))
    return figure


def _key(figure: "Figure", columns: int, *, bound: bool = True) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    marks = {
        "unit": Line2D([], [], color=DATA.light, linewidth=1, marker="o", markersize=4.5),
        "upper bound": Line2D([], [], color=DATA.light, linestyle="", marker="<", markerfacecolor="white"),
        "odd unit": Line2D([], [], color=LEFT_OUT, linestyle="", marker="D", markersize=4.5),
        "median unit": Line2D([], [], color=MODEL.light, linewidth=1.4),
        "next unit, 95 %": Patch(facecolor=MODEL.light, alpha=0.13),
    }
    if bound:
        marks["tolerance bound"] = Line2D([], [], color=_BOUND, linewidth=1.5, linestyle="--")
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
    _draw_marks(axes, enumerate(units), factor, low)
    if found.prediction:
        band = [max(limit * factor, low) for limit in found.prediction]
        axes.axvspan(*band, color=MODEL.light, alpha=0.13, linewidth=0)
    if found.middle:
        axes.axvline(found.middle * factor, color=MODEL.light, linewidth=1.4)
    if found.tolerance:
        axes.axvline(found.tolerance * factor, color=_BOUND, linewidth=1.5, linestyle="--")
        at, units_of = (found.tolerance * factor, 1.0), ("data", "axes fraction")
        axes.annotate(bound_name(term), at, (0, 2), units_of, ha="center", color=_BOUND, **_NEAR)
    named = {i: one.unit for i, one in enumerate(units) if len(units) <= _NAMED or one.odd}
    axes.set_yticks([*named], [*named.values()], fontsize=SMALL_SIZE - 1, color=INK)
    _log_axis(axes, term, unit, low, high)
    axes.set_ylim(-0.8, len(units) - 0.2)


def models_figure(models: Sequence[SensorModel]) -> "Figure":
    """Return each term of each axis: a row per model, a dot per unit, median and band."""
    groups: dict[tuple[str, str], list[tuple[str, FleetTerm]]] = {}
    for model in models:
        for term in model.terms:
            groups.setdefault((term.name, term.term), []).append((model.title, term))
    rows = math.ceil(len(groups) / 3)
    figure = new_figure(12, (0.42 * len(models) + 0.95) * rows + 0.7, _DPI)
    axes = figure.subplots(rows, 3, squeeze=False).ravel()
    for place, own in zip(axes, groups.values(), strict=False):
        unit = sheet_unit(own[0][1])
        lows, highs = zip(*(span(term) for _, term in own), strict=True)
        for i, (_, term) in enumerate(own):
            _draw_strip(place, term.population, i, unit.factor, min(lows))
        place.set_yticks(range(len(own)), [title for title, _ in own], **_SMALL)
        _log_axis(place, own[0][1], unit, min(lows) * unit.factor, max(highs) * unit.factor)
        place.set_ylim(len(own) - 0.4, -0.6)
    for place in axes[len(groups) :]:
        place.set_visible(False)
    _key(figure, 3, bound=False)
    figure.tight_layout(rect=(0, 0.3 / figure.get_figheight(), 1, 1))
    return figure


def _draw_strip(axes: "Axes", found: Population, row: int, factor: float, lowest: float) -> None:
    if found.prediction:
        low, high = (max(limit, lowest) * factor for limit in found.prediction)
        axes.barh(row, high - low, left=low, height=0.7, color=MODEL.light, alpha=0.13)
    if found.middle:
        axes.plot([found.middle * factor] * 2, [row - 0.4, row + 0.4], color=MODEL.light, linewidth=1.4)
    # Three lanes keep equal units apart.
    lanes = [(row + 0.18 * (j % 3 - 1), unit) for j, unit in enumerate(found.units)]
    _draw_marks(axes, lanes, factor)


def _draw_marks(
    axes: "Axes", rows: Iterable[tuple[float, UnitValue]], factor: float, least: float = 0.0
) -> None:
    """Draw a dot per unit: a diamond for an odd one, an open triangle for a bound.

    Intervals are drawn if `least` is given; intervals of bounds start there.
    """
    kinds: dict[tuple[bool, bool], list[tuple[float, UnitValue]]] = {}
    for row in rows:
        kinds.setdefault((row[1].value is None, row[1].odd), []).append(row)
    for (bounded, odd), own in kinds.items():
        colour, (heights, units) = LEFT_OUT if odd else DATA.light, zip(*own, strict=True)
        if least:
            starts = [least if bounded else unit.low * factor for unit in units]
            ends = [unit.high * factor for unit in units]
            axes.hlines(heights, starts, ends, colors=colour, linewidth=1, linestyles=":" if bounded else "-")
        axes.plot(
            [(unit.value or unit.high) * factor for unit in units],
            heights,
            marker="<" if bounded else "D" if odd else "o",
            markersize=4.5 if least else 3.5,
            color=colour,
            markerfacecolor="white" if bounded else colour,
            linestyle="",
        )


def heat_figure(model: SensorModel) -> "Figure":
    """Return units × terms: distance from the median, in standard deviations of the next unit."""
    from matplotlib.patches import Rectangle

    names, terms = list(model.units), model.terms
    tall = min(14.0, max(2.0, 0.2 * len(names)))
    figure = new_figure(3.2 + 0.36 * len(terms), tall + 1.6, _DPI)
    axes = figure.subplots()
    values = np.full((len(names), len(terms)), np.nan)
    for j, term in enumerate(terms):
        found, band = term.population, term.population.prediction
        sd = math.log(band[1] / found.median.value) / _BAND_SDS if band and not found.bounded else math.nan
        for unit in found.units:
            i = names.index(unit.unit)
            values[i, j] = math.log(unit.value / found.median.value) / sd if unit.value else math.nan
            if unit.odd:
                mark = _LABEL | {"color": "white" if abs(values[i, j]) > 2 else INK}
                axes.text(j, i, "!", ha="center", va="center", **mark)
                frame = Rectangle((j - 0.5, i - 0.5), 1, 1, fill=False, edgecolor=LEFT_OUT, linewidth=1.6)
                axes.add_patch(frame)
    image = axes.imshow(np.ma.masked_invalid(values), cmap="PuOr_r", vmin=-4, vmax=4, aspect="auto")
    axes.patch.set(facecolor="white", edgecolor=FADED, hatch="////", linewidth=0)
    axes.set_xticks(range(len(terms)), [f"{term.name} {term.term}" for term in terms], rotation=90, **_SMALL)
    odd = {unit.unit for term in terms for unit in term.odd}
    named = {i: name for i, name in enumerate(names) if len(names) <= _NAMED or name in odd}
    axes.set_yticks([*named], [*named.values()], **_SMALL)
    bar = figure.colorbar(image, ax=axes, fraction=0.05, pad=0.02)
    bar.set_label("standard deviations of the next unit", **_SMALL)
    bar.ax.tick_params(labelsize=SMALL_SIZE, colors=INK)
    title = f"{model.title}: units against the median\nhatched: only bounded; !: odd"
    axes.set_title(title, loc="left", **_LABEL)
    figure.tight_layout()
    return figure


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
