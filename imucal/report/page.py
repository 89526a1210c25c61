"""`report.html`: one page that contains everything and opens without a network.

Values are in data-sheet units and in SI; the page shows one or the other.
"""

import base64
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from importlib.resources import files
from typing import TypeAlias

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.findings import Finding, options_to_keep
from imucal.fitting.noise_fit import Estimate, NoiseFit, Segments, Trace
from imucal.noise.terms import TERMS
from imucal.prediction import drift
from imucal.recording import Sensor
from imucal.report import figure, numbers
from imucal.report.exports import TARGETS
from imucal.report.exports.config_numbers import DEFAULT_OPTIONS, Numbers
from imucal.report.exports.target import FORMULAS, itself, price
from imucal.report.figure import axis_title, units_of
from imucal.report.figure_curves import shown_points
from imucal.report.markup import Markup, both_units, render
from imucal.report.numbers import SheetUnits
from imucal.report.plot_data import page_data
from imucal.report.result import AxisReport, Report
from imucal.report.view import View, views
from imucal.side_work import try_side_work
from imucal.units import DatasheetUnit, duration, pretty, time_unit

_Row: TypeAlias = tuple[str, list[str]]
#: Findings are grouped by level, code, advice and the part of the log to keep.
_Kind: TypeAlias = tuple[str, str, str, tuple[float, float] | None]
#: Level of a finding -> heading of its list.
_HEADINGS = {"error": "Errors", "warning": "Warnings", "info": "Notes"}
#: A cell without a value.
_NOTHING = "–"
#: Width of the SVG, in its own units.
_WIDTH = 640
#: Height of a row, in units of the SVG.
_ROW = 86
#: Space for the percentages, in units of the SVG.
_LEFT = 56
#: Space right of the last segment, in units of the SVG.
_RIGHT = 12
#: Space for the name of a row, in units of the SVG.
_TOP = 24
#: Space for the times, in units of the SVG.
_BOTTOM = 22
#: Least half-height of a row, as a logarithm: smaller changes look like none.
_MIN_HEIGHT = 0.02
#: Largest half-height of a row, as a ratio.
_MAX_HEIGHT = 4.0
#: Most intervals between the times.
_MARKS = 6
#: Percentages of ticks; the largest below the half-height of a row is used.
_PERCENTAGES = (200, 100, 50, 20, 10, 5, 2, 1, 0.5)


def render_page(report: Report, *, drawings: figure.Drawings | None = None) -> str:
    """Return the page; the same report always gives the same text."""
    pictures = (drawings or figure.draw(report, ("png",))).addresses
    makers: list[tuple[str, str, Callable[[], Markup | None]]] = [
        ("summary", "Summary", lambda: summary_section(report, pictures)),
        ("findings", "Findings", lambda: findings_section(report)),
        ("drift", "Effect on a filter", lambda: drift_section(report)),
        ("downstream", "Numbers for your program", lambda: downstream_section(report)),
        *(
            (axis.name, axis_title(axis), partial(axis_section, report, axis, pictures))
            for axis in report.axes
        ),
        ("terms", "Terms", glossary_section),
        ("method", "Method", lambda: method_section(report)),
    ]
    made = [(anchor, title, _made(make, title)) for anchor, title, make in makers]
    packed = files("imucal.report").joinpath("plotly", "plotly-basic.min.js.zlib")
    return render(
        "report.html",
        title=f"{report.source.name} – IMU noise report",
        heading=report.source.name,
        grade=report.verdict.grade,
        sentence=report.verdict.sentence,
        lead=" · ".join(dict.fromkeys(_recorded(report))) or "No axis could be analysed.",
        sections=[section for section in made if section[2]],
        folded=(*(axis.name for axis in report.axes), "terms", "method"),
        version=report.version,
        data=Markup(page_data(report)),
        plotly=Markup(base64.b64encode(packed.read_bytes()).decode("ascii")),
    )


def _recorded(report: Report) -> Iterator[str]:
    for axis in report.axes:
        yield f"{axis.sensor}: {numbers.recorded(axis.duration_s, axis.rate_hz)}"
    if (read := report.source.read) is not None and read.from_s > 0:
        yield f"times start at {read.from_s:.10g} s of the log"


def _made(make: Callable[[], Markup | None], title: str) -> Markup | None:
    """Return a section, or a notice that explains why it is missing."""
    body, failed = try_side_work(make, None, what=f"This section is missing: {title}", code="not-drawn")
    return Markup('<p class="notice">{}</p>').format(failed[0].text) if failed else body


def summary_section(report: Report, pictures: Mapping[str, str]) -> Markup:
    """Return the pictures and both sensors' tables; `pictures` is name -> data URL."""
    tables = [
        (
            *(seen, axes[0], [f"{axis.rate_hz:.6g}" for axis in axes]),
            {row.key: _states(seen, row.key) for row in seen.rows if row.key.endswith(" T")},
        )
        for seen, axes in zip(views(report), report.by_sensor.values(), strict=True)
    ]
    return render("summary.html", tables=tables, pictures=pictures)


def _states(seen: View, key: str) -> list[tuple[float, float] | None]:
    """Return phi and q of a Gauss-Markov term for each axis, at the sampling rate, or None."""
    found = []
    for fit in seen.fits:
        estimate = next((e for e in fit.estimates if key == f"{e.key} T"), None)
        term = estimate and numbers.gauss_markov_term(fit, estimate)
        found.append((term.phi(1 / fit.rate_hz), term.q(1 / fit.rate_hz)) if term else None)
    return found


def findings_section(report: Report) -> Markup:
    """Return all findings."""
    return listed_findings(_all_findings(report))


def listed_findings(findings: Iterable[Finding]) -> Markup:
    """Return findings as a list: errors first, one entry per advice, axes with the same text together."""
    grouped: dict[_Kind, dict[str, list[str]]] = {}
    for finding in findings:
        kind = (finding.level, finding.code, finding.advice, finding.keep_s)
        axes = grouped.setdefault(kind, {}).setdefault(finding.text, [])
        axes += [finding.axis] if finding.axis else []
    groups = []
    for level, heading in _HEADINGS.items():
        items = [
            {
                "code": code,
                "sentences": [(" ".join(dict.fromkeys(axes)), pretty(text)) for text, axes in texts.items()],
                "advice": pretty(advice),
                "keep": options_to_keep(keep) if keep else "",
            }
            for (of_level, code, advice, keep), texts in grouped.items()
            if of_level == level
        ]
        if items:
            groups.append((level, heading, items))
    return render("findings.html", groups=groups)


def _all_findings(report: Report) -> Iterator[Finding]:
    yield from report.findings
    for axis in report.axes:
        for finding in dict.fromkeys((*axis.findings, *axis.fit.findings)):
            yield replace(finding, axis=finding.axis or axis.name)


def glossary_section() -> Markup:
    """Return the explanation of the terms."""
    return render("terms.html", terms=TERMS.items(), sensors=tuple(Sensor))


def method_section(report: Report) -> Markup:
    """Return the description of log, curve, fit and settings."""
    return render(
        "method.html",
        source=report.source,
        axes=report.axes,
        settings={key: json.dumps(value, default=str) for key, value in report.settings.items()},
    )


def axis_section(report: Report, axis: AxisReport, pictures: Mapping[str, str]) -> Markup:
    """Return the plots of one axis, and the curve as a table."""
    units = units_of(report, axis.sensor)
    lowest = (units.minimum(axis.fit), numbers.minimum(axis.fit))
    return render(
        "axis.html",
        axis=axis,
        pictures=pictures,
        where=axis_title(axis),
        minimum=[numbers.with_interval(quantity) for quantity in lowest],
        minimum_s=numbers.seconds(axis.fit.curve.minimum[1]),
        conventions=(units.level, DatasheetUnit(axis.unit, 1.0)),
        over_time=segments_figure(axis),
        unit=pretty(axis.unit),
        points=list(_curve_rows(axis)),
    )


def _curve_rows(axis: AxisReport) -> Iterator[_Row]:
    curve, used = axis.fit.curve, set(axis.fit.used.tolist())
    low, high = curve.confidence_interval(axis.fit.level)
    deviations = np.stack([curve.adev, low, high, axis.fit.model_adev()], axis=1)
    for i in shown_points(curve).tolist():
        values = [f"{value:.4g}" for value in deviations[i]]
        cells = [str(curve.m[i]), *values, f"{curve.edf[i]:.3g}", "yes" if i in used else "no"]
        yield f"{curve.tau[i]:.6g}", cells


def segments_figure(axis: AxisReport) -> Markup | None:
    """Return N and the floor over time; None if the record was not cut into segments."""
    segments = axis.fit.segments
    if segments is None or segments.white is None:
        return None
    rows = [_segments_row(segments, segments.white, "N", _TOP, whole=axis.fit["N"])]
    if segments.floor is not None:
        name = f"floor (Allan deviation at {numbers.seconds(segments.floor_tau_s)})"
        rows.append(_segments_row(segments, segments.floor, name, _ROW + 2 * _TOP))
    return render(
        "over_time.html",
        axis=axis,
        where=axis_title(axis),
        segments=segments,
        width=_WIDTH,
        height=len(rows) * (_ROW + _TOP) + _BOTTOM,
        left=_LEFT,
        right=_WIDTH - _RIGHT,
        rows=rows,
        times=_times(segments),
    )


def _segments_row(
    segments: Segments, trace: Trace, name: str, top: int, *, whole: Estimate | None = None
) -> dict[str, object]:
    """Return one row: a bar per segment, the interval of the whole record, and a relative scale."""
    mean = float(np.exp(np.mean(np.log(trace.value))))
    band = (whole.low / mean, whole.high / mean) if whole else ()
    ratios = np.stack([trace.low, trace.value, trace.high], axis=1) / mean
    ends = np.array([*ratios[:, 0], *ratios[:, 2], *band])
    reach = float(
        np.clip(np.nanmax(np.abs(np.log(np.clip(ends, 1e-3, 1e3)))), _MIN_HEIGHT, math.log(_MAX_HEIGHT))
    )

    def y(ratio: float) -> float:
        part = math.log(max(ratio, 1e-9)) / (1.08 * reach)
        return round(top + _ROW * (0.5 - 0.5 * max(-1.0, min(part, 1.0))), 1)

    starts, stops = _x(segments, segments.start_s), _x(segments, segments.end_s)
    return {
        "name": name,
        "top": top,
        "ticks": [(y(1 + percent / 100), percent) for percent in _ticks(reach)],
        "band": [y(end) for end in band],
        "bars": [
            (start, stop, *map(y, three)) for start, stop, three in zip(starts, stops, ratios, strict=True)
        ],
    }


def _ticks(reach: float) -> list[float]:
    """Return zero and a round percentage on each side."""
    above = 100 * math.expm1(reach)
    step = next(step for step in _PERCENTAGES if step <= above)
    below = -step if step < 100 else -50.0
    return [step, 0.0, below]


def _times(segments: Segments) -> list[tuple[float, str]]:
    """Return the places and texts of round times."""
    from matplotlib.ticker import MaxNLocator

    end = float(segments.end_s[-1])
    unit, name = time_unit(end)
    marks = MaxNLocator(_MARKS, steps=[1, 2, 5, 10]).tick_values(0.0, end / unit)
    times = np.array([mark for mark in marks if mark <= end / unit])
    places = _x(segments, times * unit)
    return [(place, f"{time:g} {name}") for place, time in zip(places, times.tolist(), strict=True)]


def _x(segments: Segments, seconds: FloatArray) -> list[float]:
    end = float(segments.end_s[-1])
    places: list[float] = (_LEFT + seconds / end * (_WIDTH - _RIGHT - _LEFT)).round(1).tolist()
    return places


def drift_section(report: Report) -> Markup | None:
    """Return the drift of dead reckoning after a rest, for the worst axes; None without noise."""
    if not report.verdict.usable or not report.axes:
        return None
    found = drift(report)
    # The last quantity of a kind is the total.
    last = {quantity.kind: quantity for quantity in found.quantities}
    titles = ["Error", *(f"after {duration(point.time_s)}" for point in found.quantities[0].points)]
    return render("drift.html", drift=found, quantities=last.values(), titles=titles, numbers=numbers)


def downstream_section(report: Report) -> Markup:
    """Return the numbers for config files with their formulas, only if the data are noise."""
    if not report.verdict.usable:
        message = f"{report.verdict.sentence}. No filter should be given its numbers."
        return Markup("<p>{}</p>").format(message)
    chosen = Numbers(report=report, options=DEFAULT_OPTIONS, target="the page", covers=True)
    return render(
        "downstream.html",
        chosen=chosen,
        pairs=[
            (sensor, pair, itself(axes, numbers.scientific), price(pair).replace(" x ", " × "))
            for sensor, axes in report.by_sensor.items()
            for pair in report.usual_pairs(axes)
        ],
        terms=TERMS,
        scientific=numbers.scientific,
        use=partial(_use, chosen),
        slowest=partial(_slowest, chosen),
        programs=TARGETS.values(),
        floors=[
            (f"{seen.sensor.short}_{name}", _floors(fit, seen.units))
            for seen in views(report)
            if seen.sensor
            for name, fit in zip(seen.names, seen.fits, strict=True)
        ],
    )


def _use(chosen: Numbers, sensor: Sensor, symbol: str, formula: str, unit: str) -> str:
    try:
        number = chosen.one(sensor, symbol)
    except DataError:
        return _NOTHING
    bound = "≤ " if number.bounded and not number.covers else ""
    value = FORMULAS[formula].of(number.value, chosen.rate_hz(sensor))
    where = " ".join(name.split("_")[1] for name in number.axes)
    shown = pretty(unit.format(u=sensor.unit)).replace("(rad/s)²", "rad²/s²").replace("(m/s²)²", "m²/s⁴")
    return Markup("{}{} <small>{}, {}</small>").format(bound, numbers.scientific(value), shown, where)


def _slowest(chosen: Numbers, sensor: Sensor) -> tuple[tuple[float, float], str] | None:
    """Return ((sigma, T), axis) of the largest slowest Gauss-Markov term."""
    known = ((chosen.slowest(axis), axis.axis) for axis in chosen.axes(sensor))
    return max((((term.sigma, term.T), axis) for term, axis in known if term), default=None)


def _floors(fit: NoiseFit, units: SheetUnits) -> list[Markup]:
    """Return B, 0.664 B, the curve's minimum, and the minimum over 0.664."""
    flicker = (units.estimate(fit["B"], fit.sensor), numbers.si(fit["B"], fit.sensor))
    lowest = (units.minimum(fit), numbers.minimum(fit))
    columns = [
        [quantity.scaled(factor, quantity.unit) for quantity in pair]
        for pair, factor in ((flicker, 1.0), (flicker, 0.664), (lowest, 1.0), (lowest, 1 / 0.664))
    ]
    exponents = [numbers.engineering_exponent(side) for side in zip(*columns, strict=True)]
    return [
        both_units(*(numbers.with_interval(q, exponent=e) for q, e in zip(pair, exponents, strict=True)))
        for pair in columns
    ]
