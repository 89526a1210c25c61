"""The page's first part: one table a sensor, in both conventions, and the findings in words.

The page's explanations: what the terms mean, and how the numbers were made.

The small picture of an axis's noise over time: N and the floor in each segment of the record.

Drawn as SVG in the page itself, so that it is there without any script, in the page's own colours.
Heights are relative to the record's value: one scale for every unit.

The page's answer to the question asked most: which number goes into my configuration.
"""

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import TypeAlias

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import DataError
from imucal.findings import Finding
from imucal.fitting.noise_fit import Estimate, Goodness, Segments, Trace
from imucal.noise.terms import TERMS, GaussMarkov
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.exports import TARGETS
from imucal.report.exports.config_numbers import Choices, Number, Numbers
from imucal.report.figure import axis_title
from imucal.report.markup import Markup, both_units, element, join, labelled, row, table
from imucal.report.numbers import Quantity
from imucal.report.result import AxisReport, Report
from imucal.report.sheet_units import SheetUnits, sheet_units
from imucal.units import duration, pretty

#: Level, code, advice and the part worth keeping: what findings have in common.
_Kind: TypeAlias = tuple[str, str, str, tuple[float, float] | None]
_LEVELS = ("error", "warning", "info")
_HEADINGS = {"error": "Errors", "warning": "Warnings", "info": "Notes"}


def summary_section(report: Report) -> Markup:
    """Return the tables of both sensors."""
    tables = []
    for sensor in Sensor:
        axes = [axis for axis in report.axes if axis.sensor is sensor]
        if axes:
            tables.append(_sensor_table(sensor, axes, sheet_units(report, sensor)))
    return join(tables)


def findings_section(report: Report) -> Markup:
    """Return every finding in words, the grave ones first; those with the same advice stand together."""
    grouped: dict[_Kind, dict[str, list[str]]] = {}
    for axis, finding in _all_findings(report):
        kind = (finding.level, finding.code, finding.advice, finding.keep_s)
        grouped.setdefault(kind, {}).setdefault(finding.text, []).append(axis)
    if not grouped:
        return element("p", "Nothing to remark: no gap, no movement, no line, no doubt about the fit.")
    parts = []
    for level in _LEVELS:
        items = [_finding(kind, texts) for kind, texts in grouped.items() if kind[0] == level]
        if items:
            parts.append(element("h3", f"{_HEADINGS[level]} ({len(items)})"))
            parts.append(element("ul", *items, class_=f"findings {level}"))
    return join(parts)


def _all_findings(report: Report) -> list[tuple[str, Finding]]:
    found = [(finding.axis or "", finding) for finding in report.findings]
    for axis in report.axes:
        merged = dict.fromkeys((*axis.findings, *axis.fit.findings))
        found += [(finding.axis or axis.name, finding) for finding in merged]
    return found


def _finding(kind: _Kind, texts: dict[str, list[str]]) -> Markup:
    _, code, advice, keep = kind
    sentences = [join([_names(axes, text), _sentence(text), " "]) for text, axes in texts.items()]
    body = sentences[0] if len(sentences) == 1 else element("ul", *(element("li", s) for s in sentences))
    part = None
    if keep is not None:
        part = element(
            "span",
            f"Part worth keeping: {numbers.seconds(keep[0])} to {numbers.seconds(keep[1])}.",
            class_="keep",
        )
    hint = element("em", f"{_sentence(advice)} ") if advice else None
    return element("li", element("code", code), " ", body, hint, part)


def _names(axes: list[str], text: str) -> Markup | None:
    """Return the axes in bold, unless the sentence starts with them."""
    names = " ".join(dict.fromkeys(axis for axis in axes if axis))
    return element("strong", f"{names} ") if names and not text.startswith(names) else None


def _sentence(text: str) -> str:
    """Return it with a capital, unless it starts with a name, and with a full stop."""
    first = text.split(" ", 1)[0]
    text = pretty(text if "_" in first else text[:1].upper() + text[1:])
    return text if text.endswith((".", "!", "?")) else f"{text}."


def _sensor_table(sensor: Sensor, axes: list[AxisReport], units: SheetUnits) -> Markup:
    first = axes[0]
    head = [element("td"), *(element("th", axis.axis, scope="col") for axis in axes)]
    estimates = [estimate for axis in axes for estimate in axis.fit.estimates]
    keys = dict.fromkeys(e.key for symbol in TERMS for e in estimates if e.symbol == symbol)
    body = []
    for key in keys:
        body += _term_rows(key, axes, units)
    body.append(
        _row(
            "minimum",
            "of the curve",
            [((numbers.minimum(axis)[0], units.minimum(axis)), _at(axis)) for axis in axes],
        )
    )
    body.append(_text_row("model", axes, lambda axis: str(axis.fit.model) or "none shown"))
    body.append(_text_row("misfit score", axes, _misfit))
    rates = " / ".join(dict.fromkeys(f"{axis.rate_hz:.6g}" for axis in axes))
    samples = f"{first.samples:,}".replace(",", "\N{NO-BREAK SPACE}")
    caption = (
        f"{str(sensor).capitalize()}: {duration(first.duration_s)} at {rates} Hz, {samples} samples, "
        f"{100 * first.fit.level:.4g} % intervals"
    )
    return table(caption, [row(*head)], body, class_="summary")


def _term_rows(key: str, axes: list[AxisReport], units: SheetUnits) -> list[Markup]:
    sensor = axes[0].sensor
    found = [next((e for e in axis.fit.estimates if e.key == key), None) for axis in axes]
    symbol = next(e.symbol for e in found if e)
    cells = [
        ((numbers.si(e, sensor), units.estimate(e, sensor)), numbers.alternatives(e)) if e else None
        for e in found
    ]
    if symbol != GaussMarkov.symbol:
        return [_row(key, TERMS[symbol].name(sensor), cells)]
    times = [None if e is None else _time(e) for e in found]
    return [
        _row(f"{key} σ", "Gauss-Markov, standard deviation", cells),
        _row(f"{key} T", "its correlation time", times),
        _text_row(f"{key} φ, q", axes, lambda axis: _state(axis, key), "x[t+1] = φ x[t] + q w[t], SI"),
    ]


def _time(estimate: Estimate) -> tuple[tuple[Quantity, Quantity], str] | None:
    if estimate.correlation_time is None:
        return None
    quantity = numbers.correlation_time(estimate.correlation_time)
    return (quantity, quantity), ""


def _state(axis: AxisReport, key: str) -> str:
    """Return phi and q of a Gauss-Markov term for a filter at the sampling rate."""
    estimate = next((e for e in axis.fit.estimates if e.key == key), None)
    term = None if estimate is None else numbers.gauss_markov_term(axis.fit, estimate)
    if term is None:
        return "–"
    tau0 = 1 / axis.fit.rate_hz
    return f"{term.phi(tau0):.9g}, {term.q(tau0):.4g} {pretty(axis.unit)}"


def _at(axis: AxisReport) -> str:
    return f"at {numbers.seconds(axis.fit.curve.minimum[1])}"


def _misfit(axis: AxisReport) -> str:
    score = axis.fit.goodness.statistic
    if math.isnan(score):
        return "unknown"
    text = f"{score + 0.0:.1f}".replace("-0.0", "0.0").replace("-", "−")
    return f"{text} ({'the model does not fit' if score > 3 else 'the model fits'})"


def _text_row(key: str, axes: list[AxisReport], text: Callable[[AxisReport], str], note: str = "") -> Markup:
    head = element("th", key, element("small", note) if note else None, scope="row")
    return row(head, *(element("td", text(axis)) for axis in axes))


def _row(key: str, name: str, cells: list[tuple[tuple[Quantity, Quantity], str] | None]) -> Markup:
    """Return a row of quantities, each unit with one power of ten for all axes."""
    known = [cell for cell in cells if cell]
    heads, columns = [], []
    for index in (1, 0):
        quantities = [pair[index] for pair, _ in known]
        exponent = numbers.engineering_exponent(quantities)
        power = join(["10", element("sup", str(exponent).replace("-", "−")), " "]) if exponent else ""
        heads.append(element("small", power, pretty(quantities[0].unit), class_="unit"))
        columns.append([_cell(cell and (cell[0][index], cell[1]), exponent) for cell in cells])
    head = element("th", element("b", key), " ", name, both_units(*heads), scope="row")
    pairs = zip(*columns, strict=True)
    return row(head, *(element("td", both_units(sheet, plain)) for sheet, plain in pairs))


def _cell(cell: tuple[Quantity, str] | None, exponent: int) -> Markup:
    if cell is None:
        return Markup("–")
    quantity, note = cell
    value, interval = numbers.compact(quantity, exponent=exponent)
    if quantity.value is None:
        return join([value, element("small", "not shown; upper bound")])
    small = " ".join(part for part in (interval, note) if part)
    return join([element("b", value), element("small", small) if small else None])


_METHODS = {
    "mle": "maximum likelihood on the discrete cosine transform of the samples: each coefficient's square is "
    "compared with its exact expectation under the model",
    "gmwm": "the generalised method of moments: the model's exact Allan variances are brought as near to the "
    "measured ones as their covariance says they should be",
    "slope": "lines of fixed slope laid through the Allan curve, where it has that slope",
}
_EDF = {
    "hybrid": "from the measured spectrum at short times and from a fitted noise model at long ones",
    "model": "from a fitted noise model",
    "greenhall": "after Greenhall and Riley (2003), the noise type recognised at each time",
    "eta3": "n/m, a rule that is on the safe side",
}
_CRITERIA = {
    "given": "the model was given",
    "bic": "the model was chosen by the Bayesian criterion",
    "hq": "the model was chosen by the Hannan-Quinn criterion",
    "aic": "the model was chosen by Akaike's criterion",
}


_FIT_TITLES = (
    *("Rate", "Gaps", "Model", "Used by the fit"),
    *("Lines left out", "Output filter", "Misfit", "Also tried"),
)


def glossary_section() -> Markup:
    """Return what the terms are, in both conventions."""
    titles = ("Term", "In the curve", "What it is", "SI", "Data sheets", "Other names")
    body = []
    for symbol, term in TERMS.items():
        names = " / ".join(dict.fromkeys(term.names))
        sheets = [term.datasheet_unit(sensor) for sensor in Sensor]
        body.append(
            row(
                element("th", element("b", symbol), f" {names}", scope="row"),
                *labelled(
                    titles[1:],
                    (
                        term.words.in_the_curve,
                        term.words.meaning,
                        " · ".join(pretty(unit) for unit in term.units),
                        " · ".join(f"{pretty(u.name)} (×{u.factor:.6g})" for u in sheets),
                        term.words.other_names,
                    ),
                ),
            )
        )
    return table(
        "The terms, gyroscope · accelerometer",
        [row(*(element("th", t, scope="col") for t in titles))],
        body,
        class_="wide cards",
    )


def method_section(report: Report) -> Markup:
    """Return how the numbers were made: the log, the curve, the fit, the settings."""
    source, first = report.source, report.axes[0] if report.axes else None
    topics = ", ".join(source.topics)
    parts: list[Markup] = [
        element(
            "p",
            "Read from ",
            element("code", source.path),
            f" ({source.format}{'; ' + topics if topics else ''}).",
        )
    ]
    if source.decisions:
        body = [row(element("th", a, scope="row"), element("td", b)) for a, b in source.decisions]
        parts.append(table("Choices made while reading", [], body))
    if first is not None:
        parts += _method_paragraphs(first)
    parts.append(_fit_table(report))
    settings = [
        row(element("th", key, scope="row"), element("td", element("code", json.dumps(value, default=str))))
        for key, value in report.settings.items()
    ]
    parts.append(table("Settings: enough to repeat the run", [], settings))
    return join(parts)


def _method_paragraphs(axis: AxisReport) -> list[Markup]:
    fit = axis.fit
    level = f"{100 * fit.level:.4g}\N{NO-BREAK SPACE}%"
    return [
        element(
            "p",
            f"The curve is the {fit.curve.estimator} Allan deviation, the mean removed, gaps respected. "
            f"Its {level} intervals are chi-squared with equivalent degrees of freedom "
            f"{_EDF.get(fit.curve.edf_method, 'as far as they are known')}; "
            "points with fewer than 2 are not drawn.",
        ),
        element(
            "p",
            f"The model was fitted by {_METHODS.get(fit.method, fit.method)}; "
            f"{_CRITERIA.get(fit.criterion, fit.criterion)}. Every term is exact for the sampled "
            f"process, at the shortest times too. Each coefficient has a {level} interval. "
            "Where the data do not show a term, its upper bound stands instead: the value "
            f"is below it with {level} confidence, and may be zero.",
        ),
        element(
            "p",
            "The misfit score is a standard normal number: between −3 and 3 the model describes the data; "
            "above 3 something else is in them, and the intervals are widened to allow for it.",
        ),
    ]


def _fit_table(report: Report) -> Markup:
    body = [_fit_row(axis) for axis in report.axes]
    head = [row(*(element("th", title, scope="col") for title in ("Axis", *_FIT_TITLES)))]
    return table("The fits", head, body, class_="wide cards")


def _page_words_misfit(goodness: Goodness) -> str:
    if math.isnan(goodness.statistic):
        return "unknown"
    return f"{goodness.statistic:.1f} (p = {goodness.p_value:.2g}, χ²/bin {goodness.chi2_per_bin:.3f})"


def _fit_row(axis: AxisReport) -> Markup:
    fit, goodness = axis.fit, axis.fit.goodness
    used = []
    if goodness.band_hz:
        used.append(f"{goodness.band_hz[0]:.3g} to {goodness.band_hz[1]:.4g} Hz")
    if goodness.tau_s:
        used.append(f"τ {goodness.tau_s[0]:.3g} to {goodness.tau_s[1]:.4g} s")
    lines = ", ".join(f"{line.frequency_hz:.4g} Hz" for line in goodness.lines[:6])
    more = f" and {len(goodness.lines) - 6} more" if len(goodness.lines) > 6 else ""
    others = [f"{c.structure} (+{c.delta:.1f})" for c in fit.candidates if c.delta > 0][:3]
    gaps = f"{len(axis.gaps)}, {sum(gap.duration_s for gap in axis.gaps):.3g} s" if axis.gaps else "none"
    cells = (
        f"{axis.rate_hz:.8g} Hz",
        gaps,
        f"{fit.model} ({fit.method})" if fit.model.terms else "none shown",
        "; ".join(used) or "all",
        f"{lines}{more}" if lines else "none",
        f"{fit.response.kind}, {fit.response.cutoff_hz:.3g} Hz" if fit.response else "none found",
        _page_words_misfit(goodness),
        ", ".join(others) or "nothing near",
    )
    return row(element("th", axis.name, scope="row"), *labelled(_FIT_TITLES, cells))


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
    rows: list[tuple[str, Trace, tuple[float, float] | None]] = [
        ("N", segments.white, _band(axis, "N", segments.white))
    ]
    if segments.floor is not None:
        at = numbers.seconds(segments.floor_tau_s)
        rows.append((f"floor (Allan deviation at {at})", segments.floor, None))
    height = len(rows) * (_ROW + _TOP) + _BOTTOM
    title = _title(axis, segments)
    drawn = [_page_segments_row(segments, trace, band, name, i) for i, (name, trace, band) in enumerate(rows)]
    picture = element(
        "svg",
        *drawn,
        _times(segments, height),
        class_="over-time",
        viewBox=f"0 0 {_WIDTH} {height}",
        role="img",
        aria_label=title,
    )
    return element("figure", picture, element("figcaption", title), id=f"{axis.name}-over-time")


def _title(axis: AxisReport, segments: Segments) -> str:
    text = (
        f"{axis_title(axis)} in {segments.start_s.size} parts of the record, relative to their mean: "
        f"each with its {100 * axis.fit.level:.4g} % interval; the band is the interval of the whole."
    )
    changing = [f"{t.key} ({100 * t.spread:.2g} %)" for t in segments.changing]
    return f"{text} Not the same in all parts: {', '.join(changing)}." if changing else text


def _band(axis: AxisReport, key: str, trace: Trace) -> tuple[float, float]:
    """Return the interval of the whole record's value, relative to the segments' mean."""
    estimate, mean = axis.fit[key], _mean(trace)
    return estimate.low / mean, estimate.high / mean


def _mean(trace: Trace) -> float:
    """Return the geometric mean of a trace's values."""
    return float(np.exp(np.mean(np.log(trace.value))))


def _page_segments_row(
    segments: Segments, trace: Trace, band: tuple[float, float] | None, name: str, number: int
) -> Markup:
    """Return one row: a bar for each segment, the band of the whole record, a scale."""
    mean = _mean(trace)
    low, value, high = (array / mean for array in (trace.low, trace.value, trace.high))
    ends = np.concatenate([low, high, np.array(band or ())])
    reach = float(np.clip(np.nanmax(np.abs(np.log(np.clip(ends, 1e-3, 1e3)))), _LEAST, math.log(_MOST)))
    top = _TOP + number * (_ROW + _TOP)

    def y(ratio: float) -> float:
        part = math.log(max(ratio, 1e-9)) / (1.08 * reach)
        return round(top + _ROW * (0.5 - 0.5 * max(-1.0, min(part, 1.0))), 1)

    parts = [_text(_LEFT, top - 6, name, class_="name")]
    for percent in _ticks(reach):
        at = y(1 + percent / 100)
        parts += [
            _line(_LEFT, at, _WIDTH - _RIGHT, at, "frame"),
            _text(_LEFT - 6, at + 4, f"{percent:+g} %" if percent else "0", text_anchor="end"),
        ]
    if band:
        parts.append(
            element(
                "rect",
                class_="whole",
                x=str(_LEFT),
                y=str(y(band[1])),
                width=str(_WIDTH - _RIGHT - _LEFT),
                height=f"{max(y(band[0]) - y(band[1]), 1):.1f}",
            )
        )
    for i, (start, end) in enumerate(
        zip(_x(segments, segments.start_s), _x(segments, segments.end_s), strict=True)
    ):
        middle = (start + end) / 2
        parts += [
            _line(middle, y(low[i]), middle, y(high[i]), "limits"),
            _line(start + 2, y(value[i]), end - 2, y(value[i]), "value"),
        ]
    return join(parts)


def _ticks(reach: float) -> list[float]:
    """Return the percentages that are named: zero and a round one on each side."""
    above = 100 * math.expm1(reach)
    step = next(s for s in (200, 100, 50, 20, 10, 5, 2, 1, 0.5) if s <= above)
    below = [-step] if step < 100 else [-50.0]
    return [step, 0.0, *below]


def _times(segments: Segments, height: int) -> Markup:
    """Return the names of some round times under the rows."""
    end = float(segments.end_s[-1])
    unit, name = (3600.0, "h") if end >= 2 * 3600 else (60.0, "min") if end >= 120 else (1.0, "s")
    step = next(s for s in _round_steps() if end / unit / s <= _MARKS)
    marks = step * unit * np.arange(math.floor(end / unit / step) + 1, dtype=np.float64)
    return join(
        _text(x, height - 6, f"{time / unit:g} {name}", text_anchor="middle")
        for time, x in zip(marks.tolist(), _x(segments, marks), strict=True)
    )


def _round_steps() -> Iterator[float]:
    """Yield 0.1, 0.2, 0.5, 1, 2, 5 and so on."""
    for power in count(-1):
        yield from (part * 10.0**power for part in (1, 2, 5))


def _x(segments: Segments, seconds: FloatArray) -> list[float]:
    """Return the places of times across the picture."""
    end = float(segments.end_s[-1])
    places: list[float] = (_LEFT + seconds / end * (_WIDTH - _RIGHT - _LEFT)).round(1).tolist()
    return places


def _line(x1: float, y1: float, x2: float, y2: float, class_: str) -> Markup:
    return element("line", class_=class_, x1=f"{x1:g}", y1=f"{y1:g}", x2=f"{x2:g}", y2=f"{y2:g}")


def _text(x: float, y: float, text: str, **attributes: str) -> Markup:
    return element("text", text, x=f"{x:g}", y=f"{y:g}", **attributes)


#: PX4's EKF2 runs at this period, in s, whatever the rate of the IMU.
_PX4_PERIOD = 0.01


@dataclass(frozen=True, slots=True)
class _Use:
    """A number that filters ask for: its formula and kind, and how it follows from a term."""

    formula: str
    kind: str
    symbol: str
    value: Callable[[float, float], float]
    unit: str


_USES = (
    _Use(
        "N",
        "continuous: a density, the same at every rate",
        "N",
        lambda n, f: n,  # noqa: ARG005 - one signature for all
        "{u}/sqrt(Hz)",
    ),
    _Use(
        "K",
        "continuous: a density of the bias's steps, the same at every rate",
        "K",
        lambda k, f: k,  # noqa: ARG005
        "{u}/sqrt(s)",
    ),
    _Use(
        "N²",
        "continuous: a covariance density",
        "N",
        lambda n, f: n * n,  # noqa: ARG005
        "({u})^2/Hz",
    ),
    _Use(
        "K²",
        "continuous: a covariance density",
        "K",
        lambda k, f: k * k,  # noqa: ARG005
        "({u})^2/s",
    ),
    _Use(
        "N √f",
        "discrete: the standard deviation of one sample at the rate f",
        "N",
        lambda n, f: n * f**0.5,
        "{u}",
    ),
    _Use(
        "N √(2f)",
        "discrete, for VINS, which halves the white variance, so that √f alone would be √2 too low",
        "N",
        lambda n, f: n * (2 * f) ** 0.5,
        "{u}",
    ),
    _Use(
        "K √f",
        "discrete, as VINS integrates it",
        "K",
        lambda k, f: k * f**0.5,
        "{u}",
    ),
    _Use(
        "N² f",
        "discrete: the variance of one sample",
        "N",
        lambda n, f: n * n * f,
        "({u})^2",
    ),
    _Use(
        "K² f",
        "discrete, as FAST-LIO integrates it",
        "K",
        lambda k, f: k * k * f,
        "({u})^2",
    ),
    _Use(
        "N / √0.01 s",
        "discrete at the period of PX4's filter, 0.01 s, not at the IMU's rate",
        "N",
        lambda n, f: n / _PX4_PERIOD**0.5,  # noqa: ARG005
        "{u}",
    ),
    _Use(
        "K / √0.01 s",
        "discrete at the period of PX4's filter, 0.01 s",
        "K",
        lambda k, f: k / _PX4_PERIOD**0.5,  # noqa: ARG005
        "{u}/s",
    ),
    _Use(
        "B",
        "the flicker coefficient; neither a density nor the curve's minimum",
        "B",
        lambda b, f: b,  # noqa: ARG005
        "{u}",
    ),
)

#: Kind of a Gauss-Markov term.
_MARKOV = "continuous: a bias that forgets, the slowest Gauss-Markov term; the summary has phi and q at f"


def downstream_section(report: Report) -> Markup:
    """Return which number goes into which configuration, with its formula; none where it is not noise."""
    if not report.verdict.usable:
        return element("p", f"{report.verdict.sentence}. No filter should be given its numbers.")
    chosen = Numbers(report=report, choices=Choices(), target="the page")
    sensors = [sensor for sensor in Sensor if any(axis.sensor is sensor for axis in report.axes)]
    titles = ("Kind", *(str(s).capitalize() for s in sensors))
    head = [element("th", title, scope="col") for title in ("Formula", *titles)]
    body = []
    for use in _USES:
        values = [_use_value(chosen, sensor, use) for sensor in sensors]
        cells = labelled(titles, (use.kind, *values))
        body.append(row(element("th", use.formula, scope="row"), *cells))
    values = [_markov_value(chosen, sensor) for sensor in sensors]
    cells = labelled(titles, (_MARKOV, *values))
    body.append(row(element("th", "σ, T", scope="row"), *cells))
    rates = ", ".join(f"f = {chosen.rate_hz(s):.6g} Hz ({s})" for s in sensors)
    return join(
        [
            element(
                "p",
                "Values in SI, each from the worst of the sensor's axes; ≤ marks an upper bound where "
                f"the data do not show the term. {rates}. The export command writes these files, with "
                "the formulas in comments.",
            ),
            table("Values for filters and simulators", [row(*head)], body, class_="wide cards"),
            _programs(),
            _two_floors(report),
        ]
    )


def _markov_value(chosen: Numbers, sensor: Sensor) -> Markup:
    """Return sigma and T of the axis whose slowest Gauss-Markov term is the largest."""
    found = [(chosen.gauss_markov(axis), axis.axis) for axis in chosen.axes(sensor)]
    known = [(term, axis) for term, axis in found if term]
    if not known:
        return Markup("–")
    (sigma, time), axis = max(known)
    unit = element("small", f"{pretty(sensor.unit)}, ")
    return join([f"{sigma:.4g} ", unit, f"{time:.4g} ", element("small", f"s, {axis}")])


def _use_value(chosen: Numbers, sensor: Sensor, use: _Use) -> Markup:
    try:
        number: Number = chosen.one(sensor, use.symbol)
    except DataError:
        return Markup("–")
    value = use.value(number.value, chosen.rate_hz(sensor))
    bound = "≤ " if number.bounded else ""
    where = ", ".join(name.split("_")[1] for name in number.axes)
    unit = pretty(use.unit.format(u=sensor.unit)).replace("(rad/s)²", "rad²/s²").replace("(m/s²)²", "m²/s⁴")
    return join([f"{bound}{value:.4g} ", element("small", f"{unit}, {where}")])


def _programs() -> Markup:
    """Return each program that there is an export for, with the formulas of its own keys."""
    titles = ("Program, and its name for --to", "Its keys", "Kind")
    body = [
        row(
            element("th", join([f"{target.title}: ", element("code", target.name)]), scope="row"),
            *labelled(titles[1:], ("; ".join(target.formulas), target.kind)),
        )
        for target in TARGETS.values()
    ]
    heads = [element("th", title, scope="col") for title in titles]
    told = table("What each program's file takes", [row(*heads)], body, class_="wide cards")
    return element(
        "details", element("summary", f"By program: {len(TARGETS)} files that export writes"), told
    )


def _two_floors(report: Report) -> Markup:
    """Return B and the curve's minimum of each axis, side by side and named."""
    titles = ("Axis", "B (flicker)", "0.664 B (its floor)", "Minimum of the curve", "Minimum / 0.664")
    body = []
    for axis in report.axes:
        estimate = axis.fit["B"]
        units = sheet_units(report, axis.sensor)
        sheet, plain = units.estimate(estimate, axis.sensor), numbers.si(estimate, axis.sensor)
        low = (numbers.minimum(axis)[0], units.minimum(axis))
        pairs = (
            (sheet, plain),
            (sheet.scaled(0.664, sheet.unit), plain.scaled(0.664, plain.unit)),
            (low[1], low[0]),
            (low[1].scaled(1 / 0.664, low[1].unit), low[0].scaled(1 / 0.664, low[0].unit)),
        )
        powers = [numbers.engineering_exponent(side) for side in zip(*pairs, strict=True)]
        cells = [
            both_units(*(numbers.with_interval(q, exponent=e) for q, e in zip(pair, powers, strict=True)))
            for pair in pairs
        ]
        body.append(row(element("th", axis.name, scope="row"), *labelled(titles[1:], cells)))
    note = (
        "“Bias instability” has two meanings. B is the coefficient of flicker noise, whose floor lies at "
        "0.664 B. The minimum of the curve holds every term at once; divided by 0.664 it gives an upper "
        "estimate of B, right only where flicker alone makes the floor."
    )
    heads = [element("th", title, scope="col") for title in titles]
    return join(
        [
            element("h3", "Bias instability, both ways"),
            element("p", note),
            table("B and the minimum", [row(*heads)], body, class_="tight cards"),
        ]
    )
