"""The sections of the page: what each template is filled with.

Numbers stand in both conventions, data sheet first, of which the page shows one. The picture of an axis's
noise over time has heights relative to the record's value: one scale for every unit.
"""

import json
import math
from collections.abc import Iterator, Mapping
from itertools import count
from typing import TypeAlias

import numpy as np
from markupsafe import Markup

from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.findings import Finding
from imucal.fitting.noise_fit import Estimate, Goodness, NoiseFit, Segments, Trace
from imucal.noise.terms import TERMS
from imucal.prediction import drift
from imucal.prediction.filter_numbers import usual_pairs
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.exports import TARGETS
from imucal.report.exports.config_numbers import COVERING, Choices, Numbers
from imucal.report.exports.target import FORMULAS, itself, price
from imucal.report.figure import axis_title, shown_points
from imucal.report.markup import both_units, render
from imucal.report.result import AxisReport, Report
from imucal.report.sheet_units import SheetUnits, sheet_units
from imucal.report.view import View, views
from imucal.units import DatasheetUnit, duration, pretty

#: Head and cells of a row.
_Row: TypeAlias = tuple[str, list[str]]
#: Level, code, advice and the part worth keeping: what findings have in common.
_Kind: TypeAlias = tuple[str, str, str, tuple[float, float] | None]
_HEADINGS = {"error": "Errors", "warning": "Warnings", "info": "Notes"}
_NOTHING = "–"


def summary_section(report: Report, pictures: Mapping[str, str]) -> Markup:
    """Return the pictures and the tables of both sensors; `pictures` has addresses by the names of files."""
    tables = [
        {
            "caption": _summary_caption(axes),
            "view": seen,
            "states": {row.key: _states(seen, row.key) for row in seen.rows if row.key.endswith(" T")},
            "scores": [_score(fit.goodness.statistic) for fit in seen.fits],
        }
        for seen, axes in zip(views(report), report.by_sensor.values(), strict=True)
    ]
    return render("summary.html", tables=tables, pictures=pictures)


def _summary_caption(axes: list[AxisReport]) -> str:
    first = axes[0]
    rates = " / ".join(dict.fromkeys(f"{axis.rate_hz:.6g}" for axis in axes))
    samples = f"{first.samples:,}".replace(",", "\N{NO-BREAK SPACE}")
    return (
        f"{str(first.sensor).capitalize()}: {duration(first.duration_s)} at {rates} Hz, {samples} samples, "
        f"{100 * first.fit.level:.4g} % intervals"
    )


def _states(seen: View, key: str) -> list[str]:
    """Return phi and q of a Gauss-Markov term on each axis, for a filter at the sampling rate."""
    texts = []
    for fit in seen.fits:
        estimate = next((e for e in fit.estimates if key == f"{e.key} T"), None)
        term = estimate and numbers.gauss_markov_term(fit, estimate)
        tau0 = 1 / fit.rate_hz
        unit = pretty(seen.sensor.unit) if seen.sensor else ""
        texts.append(f"{term.phi(tau0):.9g}, {term.q(tau0):.4g} {unit}" if term else _NOTHING)
    return texts


def _score(score: float) -> str:
    if math.isnan(score):
        return "unknown"
    text = f"{score + 0.0:.1f}".replace("-0.0", "0.0").replace("-", "−")
    return f"{text} ({'the model does not fit' if score > 3 else 'the model fits'})"


def findings_section(report: Report) -> Markup:
    """Return every finding in words, the grave ones first; those with the same advice stand together."""
    grouped: dict[_Kind, dict[str, list[str]]] = {}
    for axis, finding in _all_findings(report):
        kind = (finding.level, finding.code, finding.advice, finding.keep_s)
        grouped.setdefault(kind, {}).setdefault(finding.text, []).append(axis)
    groups = []
    for level, heading in _HEADINGS.items():
        items = [
            {
                "code": code,
                "sentences": [(_names(axes, text), _sentence(text)) for text, axes in texts.items()],
                "advice": _sentence(advice) if advice else "",
                "keep": [numbers.seconds(end) for end in keep or ()],
            }
            for (of_level, code, advice, keep), texts in grouped.items()
            if of_level == level
        ]
        if items:
            groups.append((level, heading, items))
    return render("findings.html", groups=groups)


def _all_findings(report: Report) -> Iterator[tuple[str, Finding]]:
    for finding in report.findings:
        yield finding.axis or "", finding
    for axis in report.axes:
        for finding in dict.fromkeys((*axis.findings, *axis.fit.findings)):
            yield finding.axis or axis.name, finding


def _names(axes: list[str], text: str) -> str:
    """Return the axes, unless the sentence starts with them."""
    names = " ".join(dict.fromkeys(axis for axis in axes if axis))
    return "" if text.startswith(names) else names


def _sentence(text: str) -> str:
    """Return it with a capital, unless it starts with a name, and with a full stop."""
    first = text.split(" ", 1)[0]
    text = pretty(text if "_" in first else text[:1].upper() + text[1:])
    return text if text.endswith((".", "!", "?")) else f"{text}."


def glossary_section() -> Markup:
    """Return what the terms are, in both conventions."""
    rows = []
    for symbol, term in TERMS.items():
        sheets = [term.datasheet_unit(sensor) for sensor in Sensor]
        cells = [
            term.words.in_the_curve,
            term.words.meaning,
            " · ".join(pretty(unit) for unit in term.units),
            " · ".join(f"{pretty(unit.name)} (×{unit.factor:.6g})" for unit in sheets),
            term.words.other_names,
        ]
        rows.append((Markup("<b>{}</b> {}").format(symbol, " / ".join(dict.fromkeys(term.names))), cells))
    return render("terms.html", rows=rows)


def method_section(report: Report) -> Markup:
    """Return how the numbers were made: the log, the curve, the fit, the settings."""
    return render(
        "method.html",
        source=report.source,
        fit=report.axes[0].fit if report.axes else None,
        fits=[_fit_row(axis) for axis in report.axes],
        settings={key: json.dumps(value, default=str) for key, value in report.settings.items()},
    )


def _fit_row(axis: AxisReport) -> _Row:
    fit, goodness = axis.fit, axis.fit.goodness
    more = f" and {len(goodness.lines) - 6} more" if len(goodness.lines) > 6 else ""
    others = [f"{c.structure} (+{c.delta:.1f})" for c in fit.candidates if c.delta > 0][:3]
    gaps = f"{len(axis.gaps)}, {sum(gap.duration_s for gap in axis.gaps):.3g} s" if axis.gaps else "none"
    return axis.name, [
        f"{axis.rate_hz:.8g} Hz",
        gaps,
        f"{fit.model} ({fit.method})" if fit.model.terms else "none shown",
        _used(goodness),
        f"{_first_lines(goodness)}{more}" or "none",
        f"{fit.response.kind}, {fit.response.cutoff_hz:.3g} Hz" if fit.response else "none found",
        _misfit(goodness),
        ", ".join(others) or "nothing near",
    ]


def _used(goodness: Goodness) -> str:
    used = []
    if goodness.band_hz:
        used.append(f"{goodness.band_hz[0]:.3g} to {goodness.band_hz[1]:.4g} Hz")
    if goodness.tau_s:
        used.append(f"τ {goodness.tau_s[0]:.3g} to {goodness.tau_s[1]:.4g} s")
    return "; ".join(used) or "all"


def _first_lines(goodness: Goodness) -> str:
    return ", ".join(f"{line.frequency_hz:.4g} Hz" for line in goodness.lines[:6])


def _misfit(goodness: Goodness) -> str:
    if math.isnan(goodness.statistic):
        return "unknown"
    return f"{goodness.statistic:.1f} (p = {goodness.p_value:.2g}, χ²/bin {goodness.chi2_per_bin:.3f})"


def axis_section(report: Report, axis: AxisReport, pictures: Mapping[str, str]) -> Markup:
    """Return the plots of one axis, each with a caption, and the curve as a table."""
    units = sheet_units([each.fit for each in report.by_sensor[axis.sensor]])
    lowest = (units.minimum(axis.fit), numbers.minimum(axis.fit))
    return render(
        "axis.html",
        axis=axis,
        pictures=pictures,
        where=axis_title(axis),
        minimum=[numbers.with_interval(quantity) for quantity in lowest],
        minimum_s=numbers.seconds(axis.fit.curve.minimum[1]),
        lines=_first_lines(axis.fit.goodness),
        moments=[_moments(axis, unit) for unit in (units.level, DatasheetUnit(axis.unit, 1.0))],
        over_time=segments_figure(axis),
        unit=pretty(axis.unit),
        points=list(_curve_rows(axis)),
    )


def _moments(axis: AxisReport, unit: DatasheetUnit) -> str:
    """Return ``mean 420 deg/h, standard deviation 350 deg/h``."""
    name = pretty(unit.name)
    mean, std = axis.mean * unit.factor, axis.std * unit.factor
    return f"mean {mean:.6g} {name}, standard deviation {std:.4g} {name}"


def _curve_rows(axis: AxisReport) -> Iterator[_Row]:
    curve, used = axis.fit.curve, set(axis.fit.used.tolist())
    low, high = curve.confidence_interval(axis.fit.level)
    deviations = np.stack([curve.adev, low, high, axis.fit.model_adev()], axis=1)
    for i in shown_points(curve).tolist():
        values = [f"{value:.4g}" for value in deviations[i]]
        cells = [str(curve.m[i]), *values, f"{curve.edf[i]:.3g}", "yes" if i in used else "no"]
        yield f"{curve.tau[i]:.6g}", cells


#: Size of the picture and of the margins about each of its rows, in its own units.
_WIDTH, _ROW, _LEFT, _RIGHT, _TOP, _BOTTOM = 640, 86, 56, 12, 24, 22
#: Least relative height of a row, and most: what is beyond it is cut.
_LEAST, _MOST = 0.02, 4.0
#: Most steps between the times that are named.
_MARKS = 6


def segments_figure(axis: AxisReport) -> Markup | None:
    """Return N and the floor over time with a caption; None where the record was not cut into segments."""
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
        title=_segments_title(axis, segments),
        width=_WIDTH,
        height=len(rows) * (_ROW + _TOP) + _BOTTOM,
        left=_LEFT,
        right=_WIDTH - _RIGHT,
        rows=rows,
        times=_times(segments),
    )


def _segments_title(axis: AxisReport, segments: Segments) -> str:
    text = (
        f"{axis_title(axis)} in {segments.start_s.size} parts of the record, relative to their mean: "
        f"each with its {100 * axis.fit.level:.4g} % interval; the band is the interval of the whole."
    )
    changing = [f"{t.key} ({100 * t.spread:.2g} %)" for t in segments.changing]
    return f"{text} Not the same in all parts: {', '.join(changing)}." if changing else text


def _segments_row(
    segments: Segments, trace: Trace, name: str, top: int, *, whole: Estimate | None = None
) -> dict[str, object]:
    """Return one row: a bar for each segment, the band of the whole record, a scale.

    Heights are relative to the geometric mean of the trace's values.
    """
    mean = float(np.exp(np.mean(np.log(trace.value))))
    band = (whole.low / mean, whole.high / mean) if whole else ()
    ratios = np.stack([trace.low, trace.value, trace.high], axis=1) / mean
    ends = np.array([*ratios[:, 0], *ratios[:, 2], *band])
    reach = float(np.clip(np.nanmax(np.abs(np.log(np.clip(ends, 1e-3, 1e3)))), _LEAST, math.log(_MOST)))

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
    """Return the percentages that are named: zero and a round one on each side."""
    above = 100 * math.expm1(reach)
    step = next(s for s in (200, 100, 50, 20, 10, 5, 2, 1, 0.5) if s <= above)
    return [step, 0.0, -step if step < 100 else -50.0]


def _times(segments: Segments) -> list[tuple[float, str]]:
    """Return the places and names of some round times."""
    end = float(segments.end_s[-1])
    unit, name = (3600.0, "h") if end >= 2 * 3600 else (60.0, "min") if end >= 120 else (1.0, "s")
    # 0.1, 0.2, 0.5, 1, 2, 5 and so on.
    steps = (part * 10.0**power for power in count(-1) for part in (1, 2, 5))
    step = next(s for s in steps if end / unit / s <= _MARKS)
    marks = step * unit * np.arange(math.floor(end / unit / step) + 1, dtype=np.float64)
    return [
        (x, f"{time / unit:g} {name}") for time, x in zip(marks.tolist(), _x(segments, marks), strict=True)
    ]


def _x(segments: Segments, seconds: FloatArray) -> list[float]:
    """Return the places of times across the picture."""
    end = float(segments.end_s[-1])
    places: list[float] = (_LEFT + seconds / end * (_WIDTH - _RIGHT - _LEFT)).round(1).tolist()
    return places


def drift_section(report: Report) -> Markup | None:
    """Return how far dead reckoning drifts after a rest, of the worst axes; None where it is not noise."""
    if not report.verdict.usable or not report.axes:
        return None
    found = drift(report)
    rows = []
    # The last of a kind is what all parts make together.
    for quantity in {q.name.split(" ")[0].rstrip(","): q for q in found.quantities}.values():
        known = [numbers.drifted(point, quantity.unit) for point in quantity.points]
        texts = [numbers.with_interval(each, exponent=0) for each in known]
        notes = [f"{p.term}{', extrapolated' if p.seen is False else ''}" for p in quantity.points]
        cells = map(Markup("{} <small>{}</small>").format, texts, notes)
        rows.append((quantity.name.removesuffix(", both").capitalize(), list(cells)))
    times = [f"after {duration(point.time_s)}" for point in found.quantities[0].points]
    return render("drift.html", drift=found, rest=duration(found.rest_s), titles=["Error", *times], rows=rows)


#: What filters ask for: formula and kind in words, key of `FORMULAS`, unit.
_USES = (
    ("N", "continuous: a density, the same at every rate", "", "{u}/sqrt(Hz)"),
    ("K", "continuous: a density of the bias's steps, the same at every rate", "", "{u}/sqrt(s)"),
    ("N²", "continuous: a covariance density", "^2", "({u})^2/Hz"),
    ("K²", "continuous: a covariance density", "^2", "({u})^2/s"),
    ("N √f", "discrete: the standard deviation of one sample at the rate f", " sqrt(f)", "{u}"),
    (
        "N √(2f)",
        "discrete, for VINS, which halves the white variance, so that √f alone would be √2 too low",
        *(" sqrt(2 f)", "{u}"),
    ),
    ("K √f", "discrete, as VINS integrates it", " sqrt(f)", "{u}"),
    (
        "N² f",
        "discrete: the variance of one sample, as FAST-LIO takes it; a ROS covariance has N as fitted",
        *("^2 f", "({u})^2"),
    ),
    ("K² f", "discrete, as FAST-LIO integrates it", "^2 f", "({u})^2"),
    (
        "N / √0.01 s",
        "discrete at the period of PX4's filter, 0.01 s, not at the IMU's rate",
        *(" / sqrt(0.01 s)", "{u}"),
    ),
    ("K / √0.01 s", "discrete at the period of PX4's filter, 0.01 s", " / sqrt(0.01 s)", "{u}/s"),
    ("B", "the flicker coefficient; neither a density nor the curve's minimum", "", "{u}"),
)
_MARKOV = "continuous: a bias that forgets, the slowest Gauss-Markov term; the summary has phi and q at f"


def downstream_section(report: Report) -> Markup:
    """Return which number goes into which configuration, with its formula; none where it is not noise."""
    if not report.verdict.usable:
        said = f"{report.verdict.sentence}. No filter should be given its numbers."
        return Markup("<p>{}</p>").format(said)
    chosen = Numbers(report=report, choices=Choices(), target="the page", covers=True)
    sensors = chosen.sensors
    uses = [
        (words, [kind, *(_use(chosen, sensor, words[0], formula, unit) for sensor in sensors)])
        for words, kind, formula, unit in _USES
    ]
    uses.append(("σ, T", [_MARKOV, *(_slowest(chosen, sensor) for sensor in sensors)]))
    name = Markup("{}: <code>{}</code>")
    return render(
        "downstream.html",
        rates=", ".join(f"f = {chosen.rate_hz(s):.6g} Hz ({s})" for s in sensors),
        pairs=list(_pairs(report)),
        titles=["Formula", "Kind", *(str(s).capitalize() for s in sensors)],
        uses=uses,
        programs=[
            (name.format(target.title, target.name), ["; ".join(target.formulas), target.kind])
            for target in TARGETS.values()
        ],
        floors=[
            (f"{seen.sensor.short}_{name}", _floors(fit, seen.units))
            for seen in views(report)
            if seen.sensor
            for name, fit in zip(seen.names, seen.fits, strict=True)
        ],
    )


def _pairs(report: Report) -> Iterator[tuple[str, list[str]]]:
    """Yield what each sensor's pair is, for a filter that coasts for a minute and for five."""
    for sensor, axes in report.by_sensor.items():
        for pair in usual_pairs([axis.fit for axis in axes]):
            values = [
                Markup("{:.4g} <small>{}</small>").format(value, pretty(TERMS[symbol].unit(sensor)))
                for symbol, value in zip(COVERING, (pair.white, pair.walk), strict=True)
            ]
            yield (
                f"{str(sensor).capitalize()}, {pair.horizon_s:g} s",
                [*values, price(pair).replace(" x ", " × "), itself(axes)],
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
    return Markup("{}{:.4g} <small>{}, {}</small>").format(bound, value, shown, where)


def _slowest(chosen: Numbers, sensor: Sensor) -> str:
    """Return sigma and T of the axis whose slowest Gauss-Markov term is the largest."""
    known = [(term, axis.axis) for axis in chosen.axes(sensor) if (term := chosen.gauss_markov(axis))]
    if not known:
        return _NOTHING
    (sigma, time), axis = max(known)
    text = Markup("{:.4g} <small>{}, </small>{:.4g} <small>s, {}</small>")
    return text.format(sigma, pretty(sensor.unit), time, axis)


def _floors(fit: NoiseFit, units: SheetUnits) -> list[Markup]:
    """Return B and the curve's minimum of an axis, each also by the factor between them."""
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
