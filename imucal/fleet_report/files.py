"""The files of a fleet's report, in its folder: ``fleet.json``, ``fleet.csv``, ``fleet.html``, pictures.

All numbers of JSON and CSV are in SI, in one fixed order. ``schema/fleet-1.schema.json`` pins the layout; a
change that an old reader would misunderstand raises its number.
"""

import csv
import io
import json
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from imucal.atomic import replacing
from imucal.errors import WriteError
from imucal.findings import Finding
from imucal.fleet.population import UnitValue
from imucal.fleet.trend import NEAREST, Trend
from imucal.fleet_report.pages import (
    by_term,
    labelled_ticks,
    render_fleet_page,
    same_terms,
    sorted_units,
    span,
)
from imucal.fleet_report.summary import Fleet, FleetTerm, SensorModel
from imucal.fleet_report.verdict import beyond_chance, bound_name, deviation, per, sheet_unit, verdict
from imucal.printable import printable
from imucal.processes import try_side_work
from imucal.recording import Sensor
from imucal.report.figure import (
    DATA,
    FADED,
    FRAME,
    GRID,
    INK,
    LABEL_SIZE,
    LEFT_OUT,
    MODEL,
    SMALL_SIZE,
    TITLE_SIZE,
    new_figure,
)
from imucal.report.json_file import plain
from imucal.units import pretty

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SCHEMA = "imucal/fleet/1"

_COLUMNS = (
    *("model", "sensor", "axis", "term", "unit_si", "unit", "logs", "value", "low", "high", "odd", "p_odd"),
    *("logs_differ", "median", "spread", "within", "prediction_low", "prediction_high", "tolerance"),
    *("median_low", "median_high", "bounded"),
)


def fleet_schema() -> dict[str, object]:
    """Return the JSON schema of ``fleet.json``."""
    text = files("imucal.fleet_report").joinpath("schema", "fleet-1.schema.json").read_text(encoding="utf-8")
    schema: dict[str, object] = json.loads(text)
    return schema


def fleet_document(fleet: Fleet) -> dict[str, object]:
    """Return a fleet as JSON values."""
    grade, text = verdict(fleet)
    sure = beyond_chance(fleet)
    return {
        "schema": SCHEMA,
        "version": fleet.version,
        "verdict": {"grade": grade, "text": text},
        "logs": {
            "asked": fleet.asked,
            "done": len(fleet.logs),
            "counted": sum(not log.left_out for log in fleet.logs),
        },
        "models": [
            {
                "name": model.name,
                "units": list(model.units),
                "logs": sum(not log.left_out for log in model.logs),
                "rate_hz": plain(model.rate_hz),
                "terms": [_term(term, sure) for term in model.terms],
            }
            for model in fleet.models
        ],
        "failures": [
            {"kind": kind, "reason": reason, "logs": [log.path for log in logs]}
            for (kind, reason), logs in fleet.failures.items()
        ],
        "without_unit": {
            "labels": fleet.labels,
            "logs": [
                {
                    "path": one.log.path,
                    "values": [
                        {"axis": axis, "term": term, **_limits(value)}
                        for (axis, term), value in one.values.items()
                    ],
                }
                for one in fleet.loose
            ],
        },
        "findings": _findings(fleet.findings),
    }


def fleet_json(fleet: Fleet) -> str:
    """Return the text of ``fleet.json``."""
    return json.dumps(fleet_document(fleet), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def fleet_csv(fleet: Fleet) -> str:
    """Return the text of ``fleet.csv``: a row a model, term, axis and unit, with its population beside it."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(_COLUMNS)
    for model in fleet.models:
        for term in model.terms:
            rows.writerows(_rows(model, term))
    return text.getvalue()


def _rows(model: SensorModel, term: FleetTerm) -> Iterator[list[object]]:
    """Yield the row of each unit."""
    found = term.population
    tested = {one.unit: int(one.differs) for one in term.unit_logs}
    shared = [
        None if found.bounded else found.median.value,
        found.spread.value if found.spread else None,
        found.within.value if found.within else None,
        *(found.prediction or (None, None)),
        found.tolerance,
        found.median.low,
        found.median.high,
        int(found.bounded),
    ]
    for unit in found.units:
        yield [
            *(_cell(model.name), str(term.sensor), term.axis, term.term, term.unit, _cell(unit.unit)),
            unit.logs,
            *(unit.value, unit.low, unit.high, int(unit.odd), unit.p_odd, tested.get(unit.unit)),
            *shared,
        ]


def _cell(text: str) -> str:
    """Return a label that a spreadsheet does not take for a formula, nor a terminal for a command."""
    return f"'{printable(text)}" if text.startswith(("=", "+", "-", "@")) else printable(text)


def _term(term: FleetTerm, sure: set[tuple[int, str]]) -> dict[str, object]:
    found, trend = term.population, term.trend
    median = _limits(found.median) | ({"value": None} if found.bounded else {})
    return {
        "sensor": str(term.sensor),
        **_fields(term, "axis", "term", "unit"),
        **_fields(found, "logs", "content", "confidence"),
        "median": median,
        "bounded": found.bounded,
        "spread": _limits(found.spread),
        "within": _limits(found.within),
        "prediction": found.prediction and list(found.prediction),
        **_fields(found, "quantile", "tolerance"),
        "price": [{"units": units, "ratio": ratio} for units, ratio in term.price],
        "temperature_per_c": _limits(trend and trend.temperature),
        "drift_per_year": _limits(trend and trend.drift),
        "no_trend": term.no_trend,
        "units": [
            {
                **_fields(unit, "unit", "logs", "value", "low", "high", "p_odd", "odd"),
                "odd_overall": unit.odd and (id(term), unit.unit) in sure,
            }
            for unit in found.units
        ],
        "moves": [
            {"label": mean.label, "p_value": mean.p_value, "p_adjusted": mean.p_odd, "moves": mean.odd}
            for mean in (trend.means if trend else ())
        ],
        "slopes": [
            {**_fields(slope, "unit", "label"), **_limits(slope.slope), **_fields(slope, "p_odd", "odd")}
            for slope in (trend.slopes if trend else ())
        ],
        "unit_logs": [
            _fields(one, "unit", "logs", "p_value", "differs", "spread", "value", "low", "high")
            for one in term.unit_logs
        ],
        "findings": _findings(found.findings),
    }


def _fields(value: object, *names: str) -> dict[str, Any]:
    return {name: getattr(value, name) for name in names}


def _limits(interval: object) -> Any:  # noqa: ANN401 - None of None
    return None if interval is None else _fields(interval, "value", "low", "high")


def _findings(findings: Sequence[Finding]) -> list[dict[str, Any]]:
    return [_fields(finding, "level", "code", "axis", "text") for finding in findings]


def write_fleet(
    fleet: Fleet,
    out: str | Path | None = None,
    *,
    pictures: bool = True,
    html: bool = True,
    tell: Callable[[Finding], None] | None = None,
) -> tuple[Path, ...]:
    """Write what is known of a fleet; return the files, ``fleet.json`` first.

    Each file takes its place whole. A picture or page that can't be drawn is left out, also in the place of
    an old one, and a finding in ``fleet.json`` says so.

    Parameters
    ----------
    fleet
        From `imucal.load_fleet`.
    out
        The folder; the fleet's own where none is given.
    pictures, html
        Whether to write PNGs and the page.
    tell
        Called with the finding of each picture or page that was left out.

    Raises
    ------
    WriteError
        If a file can't be written.
    """
    folder = fleet.folder if out is None else Path(out)
    tell = tell or (lambda _: None)
    drawn: dict[str, bytes | None] = {}
    for name, draw in fleet_figures(fleet).items() if pictures else ():
        fleet, drawn[name] = _drawn(fleet, name, draw, tell)
    if html:
        # Last: where it is newer than the store, all of the report is.
        told = fleet
        fleet, drawn["fleet.html"] = _drawn(
            told, "fleet.html", lambda: render_fleet_page(told).encode(), tell
        )
    drawn = {"fleet.json": fleet_json(fleet).encode(), "fleet.csv": fleet_csv(fleet).encode(), **drawn}
    for name, data in drawn.items():
        if data is None:
            _remove(folder / name)
            continue
        with replacing(folder / name) as scratch:
            scratch.write_bytes(data)
    return tuple(folder / name for name, data in drawn.items() if data is not None)


def _drawn(
    fleet: Fleet, name: str, draw: Callable[[], bytes], tell: Callable[[Finding], None]
) -> tuple[Fleet, bytes | None]:
    """Return a picture or page, and the fleet with a finding where it is None."""
    data, failed = try_side_work(draw, None, what=f"{name} is missing", code="not-drawn")
    for finding in failed:
        tell(finding)
    return replace(fleet, findings=fleet.findings + failed), data


def _remove(file: Path) -> None:
    """Remove an old picture or page: it would be taken for that of the new numbers."""
    try:
        file.unlink(missing_ok=True)
    except OSError as error:
        msg = f"{file}: can't be removed: {error.strerror or error}; remove it, it is out of date"
        raise WriteError(msg) from error


_DPI = 110
#: Colour of the tolerance bound.
_BOUND = "#8a5200"
#: Units whose names are written beside their rows; inches of a row, and most of a panel.
_NAMED, _ROW, _TALLEST = 60, 0.17, 9.0
_SMALL: dict[str, Any] = {"fontsize": SMALL_SIZE, "color": INK}
_LABEL: dict[str, Any] = {"fontsize": LABEL_SIZE, "color": INK}


def fleet_figures(fleet: Fleet) -> dict[str, "Callable[[], bytes]"]:
    """Return what draws each picture, by the name of its file."""
    drawn: dict[str, Callable[[], bytes]] = {}
    for model in fleet.models:
        end = f"-{_file_name(model.name)}" if len(fleet.models) > 1 else ""
        for sensor in Sensor:
            if any(term.sensor is sensor for term in model.terms):
                drawn[f"units-{sensor.short}{end}.png"] = partial(_png, units_figure, model, sensor)
        drawn[f"heat{end}.png"] = partial(_png, heat_figure, model)
        if any(term.trend for term in model.terms):
            drawn[f"drift{end}.png"] = partial(_png, drift_figure, model)
    if len(fleet.models) > 1:
        drawn["models.png"] = partial(_png, models_figure, fleet.models)
    return drawn


def _png(draw: "Callable[..., Figure]", *about: object) -> bytes:
    data = io.BytesIO()
    draw(*about).savefig(data, format="png", metadata={"Software": None})
    return data.getvalue()


def _file_name(model: str) -> str:
    """Return a model's name as part of a file's."""
    return re.sub(r"[^\w.-]|_", "-", model).strip(".") or "model"


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
    title = f"{model.title}, {sensor}: {len(model.units)} units"
    figure.suptitle(title, fontsize=TITLE_SIZE, color=INK)
    _key(figure, columns)
    figure.tight_layout(rect=(0, 0.3 * (1 + (columns == 1)) / figure.get_figheight(), 1, 0.99))
    return figure


def _key(figure: "Figure", columns: int, *, bound: bool = True) -> None:
    """Say at the bottom what the marks mean."""
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
    for i, one in enumerate(units):
        colour = LEFT_OUT if one.odd else DATA.light
        start, style = (low, ":") if one.value is None else (one.low * factor, "-")
        axes.plot([start, one.high * factor], [i, i], color=colour, linewidth=1, linestyle=style)
        _draw_mark(axes, one, factor, i, size=4.5)
    if found.prediction:
        band = [max(limit * factor, low) for limit in found.prediction]
        axes.axvspan(*band, color=MODEL.light, alpha=0.13, linewidth=0)
    if not found.bounded:
        axes.axvline(found.median.value * factor, color=MODEL.light, linewidth=1.4)
    if found.tolerance:
        axes.axvline(found.tolerance * factor, color=_BOUND, linewidth=1.5, linestyle="--")
        axes.annotate(
            bound_name(term),
            (found.tolerance * factor, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 2),
            textcoords="offset points",
            ha="center",
            color=_BOUND,
            fontsize=SMALL_SIZE,
        )
    named = [(i, one.unit) for i, one in enumerate(units) if len(units) <= _NAMED or one.odd]
    axes.set_yticks([i for i, _ in named], [name for _, name in named], fontsize=SMALL_SIZE - 1, color=INK)
    _style(axes, f"{term.term} in {pretty(unit.name)}", f"{term.name} {term.term}")
    _log_ticks(axes, low, high)
    axes.set_ylim(-0.8, len(units) - 0.2)


def models_figure(models: Sequence[SensorModel]) -> "Figure":
    """Return each term of each axis: a row a model, a dot a unit, the median and the next unit's band."""
    groups = same_terms(models)
    rows = math.ceil(len(groups) / 3)
    figure = new_figure(12, (0.42 * len(models) + 0.95) * rows + 0.7, _DPI)
    axes = figure.subplots(rows, 3, squeeze=False).ravel()
    for place, ((name, key), own) in zip(axes, groups.items(), strict=False):
        unit = sheet_unit(own[0][1])
        spans = [span(term) for _, term in own]
        lowest = min(s[0] for s in spans)
        for i, (_, term) in enumerate(own):
            # In one unit, whatever is usual for so small a value.
            _draw_strip(place, term, i, factor=unit.factor, lowest=lowest)
        place.set_yticks(range(len(own)), [model.title for model, _ in own], **_SMALL)
        _style(place, f"{key} in {pretty(unit.name)}", f"{name} {key}")
        _log_ticks(place, lowest * unit.factor, max(s[1] for s in spans) * unit.factor)
        place.set_ylim(len(own) - 0.4, -0.6)
    for place in axes[len(groups) :]:
        place.set_visible(False)
    _key(figure, 3, bound=False)
    figure.tight_layout(rect=(0, 0.3 / figure.get_figheight(), 1, 1))
    return figure


def _draw_strip(axes: "Axes", term: FleetTerm, row: int, *, factor: float, lowest: float) -> None:
    """Draw the units of one model as a row: a dot each, the median and the next unit's band."""
    found = term.population
    if found.prediction:
        low, high = (max(limit, lowest) * factor for limit in found.prediction)
        axes.barh(row, high - low, left=low, height=0.7, color=MODEL.light, alpha=0.13)
    if not found.bounded:
        middle = found.median.value * factor
        axes.plot([middle, middle], [row - 0.4, row + 0.4], color=MODEL.light, linewidth=1.4)
    for j, one in enumerate(found.units):
        _draw_mark(axes, one, factor, row + 0.18 * (j % 3 - 1), size=3.5)


def _draw_mark(axes: "Axes", unit: UnitValue, factor: float, y: float, *, size: float) -> None:
    """Draw a dot; a diamond for an odd unit, an open triangle for a bound."""
    colour = LEFT_OUT if unit.odd else DATA.light
    bounded = unit.value is None
    axes.plot(
        (unit.value or unit.high) * factor,
        y,
        marker="<" if bounded else "D" if unit.odd else "o",
        markersize=size,
        color=colour,
        markerfacecolor="white" if bounded else colour,
        linestyle="",
    )


def heat_figure(model: SensorModel) -> "Figure":
    """Return units × terms: how far off the median each unit lies, in standard deviations of the next."""
    from matplotlib.patches import Rectangle

    names, terms = list(model.units), model.terms
    tall = min(14.0, max(2.0, 0.2 * len(names)))
    figure = new_figure(3.2 + 0.36 * len(terms), tall + 1.6, _DPI)
    axes = figure.subplots()
    values = np.full((len(names), len(terms)), np.nan)
    for j, term in enumerate(terms):
        for unit in term.population.units:
            i = names.index(unit.unit)
            off = deviation(term, unit)
            values[i, j] = math.nan if off is None else off
            if unit.odd:
                mark = _LABEL | {"color": "white" if abs(values[i, j]) > 2 else INK, "fontweight": "bold"}
                axes.text(j, i, "!", ha="center", va="center", **mark)
                frame = Rectangle((j - 0.5, i - 0.5), 1, 1, fill=False, edgecolor=LEFT_OUT, linewidth=1.6)
                axes.add_patch(frame)
    image = axes.imshow(np.ma.masked_invalid(values), cmap="PuOr_r", vmin=-4, vmax=4, aspect="auto")
    axes.patch.set(facecolor="white", edgecolor=FADED, hatch="////", linewidth=0)
    axes.set_xticks(range(len(terms)), [f"{term.name} {term.term}" for term in terms], rotation=90, **_SMALL)
    if len(names) <= _NAMED:
        axes.set_yticks(range(len(names)), names, **_SMALL)
    bar = figure.colorbar(image, ax=axes, fraction=0.05, pad=0.02)
    bar.set_label("standard deviations of the next unit", **_SMALL)
    bar.ax.tick_params(labelsize=SMALL_SIZE, colors=INK)
    title = f"{model.title}: units against the median\nhatched: only bounded; !: odd"
    axes.set_title(title, loc="left", **_LABEL)
    figure.tight_layout()
    return figure


def drift_figure(model: SensorModel) -> "Figure":
    """Return the change of each term a °C and a year, with its interval; units that move otherwise in red."""
    moving = {f"{term.name} {term.term}": term.trend for term in model.terms if term.trend}
    trends = list(moving.values())
    labels = [label for label in NEAREST if any(m.label == label for trend in trends for m in trend.means)]
    figure = new_figure(max(5.0 * len(labels), 6.0), 0.27 * len(trends) + 1.4, _DPI)
    places = figure.subplots(1, len(labels), sharey=True, squeeze=False)[0]
    for axes, label in zip(places, labels, strict=True):
        name, part = per(label, trends)
        for i, trend in enumerate(trends):
            _draw_slopes(axes, trend, label, row=i, size=100 * part)
        axes.axvline(0, color=FADED, linewidth=1)
        _style(axes, f"% a {name}", "")
        axes.set_yticks(range(len(trends)), list(moving), fontsize=SMALL_SIZE)
        axes.set_ylim(len(trends) - 0.4, -0.6)
    figure.suptitle(f"{model.title}: temperature and time", fontsize=TITLE_SIZE, color=INK)
    figure.tight_layout()
    return figure


def _draw_slopes(axes: "Axes", trend: Trend, label: str, *, row: int, size: float) -> None:
    """Draw a term's change by one label with its interval, and the units that move otherwise.

    `size` is that of a slope of 1 in the picture.
    """
    for mean in (mean.slope for mean in trend.means if mean.label == label):
        axes.plot([size * mean.low, size * mean.high], [row, row], color=DATA.light, linewidth=1.2)
        axes.plot(size * mean.value, row, marker="o", markersize=5, color=MODEL.light)
    for slope in trend.slopes:
        if slope.odd and slope.label == label:
            at = size * slope.slope.value, row
            axes.plot(*at, marker="D", markersize=5, color=LEFT_OUT)
            near: dict[str, Any] = {"xytext": (5, 3), "textcoords": "offset points"}
            axes.annotate(slope.unit, at, fontsize=SMALL_SIZE, color=LEFT_OUT, **near)


def _style(axes: "Axes", x: str, title: str) -> None:
    axes.set_xlabel(x, **_LABEL)
    axes.set_title(title, fontsize=LABEL_SIZE + 1, color=INK, loc="left", pad=12)
    axes.grid(visible=True, axis="x", color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=SMALL_SIZE, colors=INK, length=3)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.spines["bottom"].set_color(FRAME)


def _log_ticks(axes: "Axes", low: float, high: float) -> None:
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    places, labels, power = labelled_ticks(low, high)
    axes.set_xticks(places, labels)
    axes.set_xticks([], minor=True)
    if power:
        axes.set_xlabel(axes.get_xlabel().replace(" in ", f" in {power}", 1))
