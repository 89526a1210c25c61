"""`report.html`: one page that holds everything and opens without a network.

Text, tables and pictures are there without any script. The plots that answer to the mouse are drawn by
plotly's basic script, which the package and the page carry deflated. What they draw is compact JSON: few
digits, no repetition.
"""

import base64
import json
import math
from collections.abc import Callable
from functools import partial
from importlib.resources import files

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.noise_fit import Estimate
from imucal.noise.terms import TERMS
from imucal.processes import try_side_work
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.figure import (
    DATA,
    LEFT_OUT,
    MODEL,
    UNUSED,
    Drawings,
    axis_title,
    draw,
    drawn_terms,
    estimate_text,
    shown_points,
    smooth_spectrum,
)
from imucal.report.json_file import plain
from imucal.report.markup import Markup, render
from imucal.report.page_parts import (
    axis_section,
    downstream_section,
    drift_section,
    findings_section,
    glossary_section,
    method_section,
    summary_section,
)
from imucal.report.result import AxisReport, Overview, Report
from imucal.report.sheet_units import SheetUnits, sheet_units
from imucal.units import duration, pretty

#: Points of a smooth line, per plot.
_FINE = 60
#: Gaps nearer to each other than this part of the recording are drawn as one.
_MERGED = 1 / 500
#: A stretch stands out when its extreme is this many robust deviations from its neighbours'.
_STANDS_OUT = 8.0
_NEIGHBOURS = 25


def page_data(report: Report) -> str:
    """Return the JSON text of all plots; safe inside a script element."""
    strokes = {symbol: [term.stroke.light, term.stroke.dark] for symbol, term in TERMS.items()}
    document = {
        "colours": {
            **strokes,
            "data": [DATA.light, DATA.dark],
            "model": [MODEL.light, MODEL.dark],
            "unused": [UNUSED, "#5d6873"],
            "line": [LEFT_OUT, "#ff7b86"],
        },
        "axes": {
            axis.name: _axis(axis, sheet_units([each.fit for each in report.by_sensor[axis.sensor]]))
            for axis in report.axes
        },
    }
    text = json.dumps(document, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    return text.replace("<", "\\u003c")


def standing_out(overview: Overview, std: float) -> FloatArray:
    """Return the times of stretches whose extremes stand out from their neighbours', in s.

    Extremes are compared with the running median of theirs, in units of their own median absolute
    deviation, or of an eighth of `std` where that is larger.
    """
    found = np.zeros(overview.time_s.size, dtype=bool)
    if found.size < _NEIGHBOURS:
        return overview.time_s[found]
    for extreme in (overview.low, overview.high):
        away = np.abs(extreme - _running_median(extreme))
        known = away[np.isfinite(away)]
        if known.size:
            spread = max(1.4826 * float(np.median(known)), std / 8)
            found |= np.nan_to_num(away) > _STANDS_OUT * spread
    return overview.time_s[found]


def _running_median(values: FloatArray) -> FloatArray:
    half = _NEIGHBOURS // 2
    padded = np.pad(values, half, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, _NEIGHBOURS)
    filled = np.where(np.isfinite(windows), windows, np.inf)
    middle = np.sort(filled, axis=1)
    count = np.isfinite(windows).sum(axis=1)
    return np.where(count > 0, middle[np.arange(values.size), np.maximum(count - 1, 0) // 2], np.nan)


def _axis(axis: AxisReport, units: SheetUnits) -> dict[str, object]:
    level, density = units.level, units.density
    adev, tau = axis.fit.curve.minimum
    return {
        "units": {
            "si": [pretty(axis.unit), 1, pretty(f"{axis.unit}/sqrt(Hz)"), 1],
            "sheet": [pretty(level.name), level.factor, pretty(density.name), density.factor],
        },
        "level": f"{100 * axis.fit.level:.4g}",
        "model": str(axis.fit.model),
        "curve": _curve(axis),
        "minimum": {
            "at": [float(f"{tau:.6g}"), float(f"{adev:.5g}")],
            "si": f"minimum {numbers.with_interval(numbers.minimum(axis.fit))}",
            "sheet": f"minimum {numbers.with_interval(units.minimum(axis.fit))}",
        },
        "fine": _fine(axis, units),
        "psd": _psd(axis),
        "raw": {
            "t": _round(axis.overview.time_s, 6),
            "low": _fixed(axis.overview.low, axis.std),
            "high": _fixed(axis.overview.high, axis.std),
            "gaps": _gaps(axis),
            "out": _round(standing_out(axis.overview, axis.std), 6),
        },
    }


def _curve(axis: AxisReport) -> dict[str, object]:
    curve = axis.fit.curve
    shown = shown_points(curve)
    low, high = curve.confidence_interval(axis.fit.level)
    return {
        "tau": _round(curve.tau[shown]),
        "adev": _round(curve.adev[shown]),
        "low": _round(low[shown]),
        "high": _round(high[shown]),
        "model": _round(axis.fit.model_adev()[shown]),
        "edf": _round(curve.edf[shown], 3),
        "used": np.isin(shown, axis.fit.used).astype(int).tolist(),
    }


def _labels(estimate: Estimate, units: SheetUnits, sensor: Sensor) -> dict[str, str]:
    """Return what a term's label says, line by line, as in the pictures."""
    si = f"{estimate.key} {numbers.with_uncertainty(numbers.si(estimate, sensor))}"
    sheet, *time = estimate_text(estimate, sensor, units).split("\n")
    return {"si": "<br>".join([si, *time]), "sheet": "<br>".join([sheet, *time])}


def _fine(axis: AxisReport, units: SheetUnits) -> dict[str, object]:
    """Return the model and its terms as smooth lines, and where each coefficient is read."""
    curve, rate = axis.fit.curve, axis.fit.rate_hz
    shown = shown_points(curve)
    m = np.unique(np.geomspace(curve.m[shown].min(), curve.m[shown].max(), _FINE).round())
    total = np.sqrt(axis.fit.model.avar(m, rate_hz=rate))
    frequency = axis.spectrum.frequency
    grid = np.geomspace(frequency[0], frequency[-1], _FINE) if frequency.size else np.zeros(0)
    terms = []
    for drawn in drawn_terms(axis.fit):
        estimate = drawn.estimate
        line = np.sqrt(drawn.term.avar(m, 1 / rate))
        at = drawn.tau_s
        if at is None:
            at = float(m[np.argmax(line / np.where(total > 0, total, math.inf))] / rate)
        si, sheet = numbers.si(estimate, axis.sensor), units.estimate(estimate, axis.sensor)
        terms.append(
            {
                "key": estimate.key,
                "symbol": estimate.symbol,
                "name": TERMS[estimate.symbol].name(axis.sensor),
                "bounded": estimate.value is None,
                "si": numbers.with_interval(si),
                "sheet": numbers.with_interval(sheet),
                "label": _labels(estimate, units, axis.sensor),
                "adev": _round(line, 4),
                "root": _round(np.sqrt(drawn.term.psd(grid, 1 / rate)), 4),
                "at": [float(f"{at:.4g}"), float(f"{drawn.height:.4g}")],
            }
        )
    return {
        "tau": _round(m / rate, 4),
        "adev": _round(total, 4),
        "f": _round(grid, 4),
        "root": _round(np.sqrt(axis.fit.model.psd(grid, rate_hz=rate)), 4),
        "terms": terms,
    }


def _psd(axis: AxisReport) -> dict[str, object]:
    smooth, fit = smooth_spectrum(axis), axis.fit
    response = fit.response
    return {
        "f": _round(smooth.frequency, 4),
        "root": _round(smooth.root, 4),
        "low": _round(smooth.low, 4),
        "high": _round(smooth.high, 4),
        "model": _round(np.sqrt(fit.model.psd(smooth.frequency, rate_hz=fit.rate_hz)), 4),
        "band": plain(fit.goodness.band_hz),
        "lines": [[line.frequency_hz, plain(line.amplitude)] for line in fit.goodness.lines],
        "filter": response and [response.kind, plain(response.cutoff_hz)],
    }


def _gaps(axis: AxisReport) -> list[list[float]]:
    """Return start and end of the gaps, those too near to tell apart as one."""
    merged: list[list[float]] = []
    for gap in axis.gaps:
        start, end = gap.start_s, gap.start_s + gap.duration_s
        if merged and start - merged[-1][1] < _MERGED * axis.duration_s:
            merged[-1][1] = round(end, 4)
        else:
            merged.append([round(start, 4), round(end, 4)])
    return merged


def _round(values: FloatArray, digits: int = 5) -> list[float | None]:
    """Return numbers of so many significant digits, null where unknown."""
    return [float(f"{value:.{digits}g}") if math.isfinite(value) else None for value in values.tolist()]


def _fixed(values: FloatArray, std: float) -> list[float | None]:
    """Return numbers as fine as a hundredth of `std`: a signal on top of a large mean."""
    places = 9 if not (math.isfinite(std) and std > 0) else min(15, max(0, 2 - math.floor(math.log10(std))))
    return [round(value, places) if math.isfinite(value) else None for value in values.tolist()]


def render_page(report: Report, *, drawings: Drawings | None = None) -> str:
    """Return the page; the same report always gives the same text.

    It shows what was drawn for the folder, where `drawings` are given; otherwise its pictures are drawn here.
    """
    pictures = (drawings or draw(report, ("png",))).addresses
    drifts = "What this does to a filter"
    makers: list[tuple[str, str, Callable[[], Markup | None]]] = [
        ("summary", "Summary", lambda: summary_section(report, pictures)),
        ("findings", "Findings", lambda: findings_section(report)),
        ("drift", drifts, lambda: drift_section(report)),
        ("downstream", "Which number goes where", lambda: downstream_section(report)),
        *(
            (axis.name, axis_title(axis), partial(axis_section, report, axis, pictures))
            for axis in report.axes
        ),
        ("terms", "What the terms mean", glossary_section),
        ("method", "How the numbers were made", lambda: method_section(report)),
    ]
    made = [(anchor, title, _made(make, title)) for anchor, title, make in makers]
    recorded = (f"{a.sensor}: {duration(a.duration_s)} at {a.rate_hz:.6g} Hz" for a in report.axes)
    packed = files("imucal.report").joinpath("plotly", "plotly-basic.min.js.zlib")
    return render(
        "report.html",
        title=f"{report.source.name} – IMU noise report",
        heading=report.source.name,
        grade=report.verdict.grade,
        sentence=report.verdict.sentence,
        lead=" · ".join(dict.fromkeys(recorded)) or "No axis could be analysed.",
        sections=[section for section in made if section[2]],
        folded=(*(axis.name for axis in report.axes), "terms", "method"),
        version=report.version,
        data=Markup(page_data(report)),
        # Deflated, as the package has it.
        plotly=Markup(base64.b64encode(packed.read_bytes()).decode("ascii")),
    )


def _made(make: Callable[[], Markup | None], title: str) -> Markup | None:
    """Return a section, or a notice in its place that says why it is missing: one section costs no page."""
    body, failed = try_side_work(make, None, what=f"This section is missing: {title}", code="not-drawn")
    return Markup('<p class="notice">{}</p>').format(failed[0].text) if failed else body
