"""The page's first part: one table a sensor, in both conventions, and the findings in words."""

import math
from collections.abc import Callable
from typing import TypeAlias

from imucal.findings import Finding
from imucal.fitting.noise_fit import Estimate
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.markup import Markup, both_units, element, join, row, table
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
    if symbol != "GM":
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
