"""`report.html`: one page that holds everything and opens without a network.

Text and tables are there without any script. The plots are drawn by plotly's own script, which the
page carries deflated: two megabytes instead of five.
"""

import base64
import zlib
from collections.abc import Mapping
from functools import cache

from imucal.report import numbers
from imucal.report.figure import axis_figure, axis_title, render_small
from imucal.report.figure_allan import shown_points
from imucal.report.markup import Markup, both_units, element, join, labelled, row, table
from imucal.report.page_data import page_data
from imucal.report.page_downstream import downstream_section
from imucal.report.page_frame import Page, page_file, render_frame
from imucal.report.page_segments import segments_figure
from imucal.report.page_summary import findings_section, summary_section
from imucal.report.page_words import glossary_section, method_section
from imucal.report.result import AxisReport, Report
from imucal.report.sheet_units import sheet_units
from imucal.side_work import try_side_work
from imucal.units import DatasheetUnit, duration, pretty


def render_page(report: Report, *, pictures: Mapping[str, bytes] | None = None) -> str:
    """Return the page; the same report always gives the same text.

    `pictures` has those of the axes (`render_small`), by name, that are drawn already: pages show them where
    scripts are off.
    """
    drawn = pictures or {}
    sections = [
        ("summary", "Summary", summary_section(report)),
        ("findings", "Findings", findings_section(report)),
        ("downstream", "Which number goes where", downstream_section(report)),
        *(
            (
                axis.name,
                axis_title(axis),
                join([_static(report, axis, drawn.get(axis.name)), _axis_section(report, axis)]),
            )
            for axis in report.axes
        ),
        ("terms", "What the terms mean", glossary_section()),
        ("method", "How the numbers were made", method_section(report)),
    ]
    data = [
        element("script", Markup(page_data(report)), type="application/json", id="imucal-data"),
        element("script", Markup(_plotly()), type="text/plain", id="imucal-plotly"),
    ]
    return render_frame(
        Page(
            title=f"{report.source.name} – IMU noise report",
            heading=report.source.name,
            grade=report.verdict.grade,
            sentence=report.verdict.sentence,
            lead=_lead(report),
            sections=sections,
            version=report.version,
            style=page_file("page.css"),
            script=page_file("page.js"),
            notices=Markup(page_file("notices.html")),
            data=join(data),
        )
    )


@cache
def _plotly() -> str:
    """Return plotly's script, deflated and in base64; kept, since it is the same for every page."""
    from plotly.offline import get_plotlyjs

    return base64.b64encode(zlib.compress(get_plotlyjs().encode(), 7)).decode("ascii")


def _lead(report: Report) -> str:
    """Return one line on what was recorded."""
    texts = []
    for axis in report.axes:
        text = f"{axis.sensor}: {duration(axis.duration_s)} at {axis.rate_hz:.6g} Hz"
        if text not in texts:
            texts.append(text)
    return " · ".join(texts) or "No axis could be analysed."


def _axis_section(report: Report, axis: AxisReport) -> Markup:
    """Return the plots of one axis, each with a caption, and the curve as a table."""
    where = axis_title(axis)
    tau = axis.fit.curve.minimum[1]
    units = sheet_units(report, axis.sensor)
    sheet, plain = units.minimum(axis), numbers.minimum(axis)[0]
    curve = join(
        [
            f"Allan deviation of {where.lower()}: its minimum is ",
            both_units(numbers.with_interval(sheet), numbers.with_interval(plain)),
            f" at {numbers.seconds(tau)}. Model {str(axis.fit.model) or 'without a term'}.",
        ]
    )
    goodness = axis.fit.goodness
    psd = (
        f"Root of the two-sided power spectral density of {where.lower()}: white noise lies at the height N."
    )
    if goodness.lines:
        psd += (
            f" Lines left out at {', '.join(f'{line.frequency_hz:.4g} Hz' for line in goodness.lines[:6])}."
        )
    gaps = f"{len(axis.gaps) or 'no'} gap{'' if len(axis.gaps) == 1 else 's'}."
    raw = join(
        [
            f"Raw signal of {where.lower()}, lowest to highest sample of each stretch: ",
            both_units(_moments(axis, units.level), _moments(axis, DatasheetUnit(axis.unit, 1.0))),
            f", {gaps}",
        ]
    )
    return join(
        [
            element("div", _figure(axis, "allan", curve), _figure(axis, "psd", psd), class_="pair"),
            _figure(axis, "raw", raw),
            segments_figure(axis),
            element("details", element("summary", "The curve as a table"), _curve_table(axis)),
        ]
    )


def _moments(axis: AxisReport, unit: DatasheetUnit) -> str:
    """Return ``mean 420 deg/h, standard deviation 350 deg/h``."""
    name = pretty(unit.name)
    mean, std = axis.mean * unit.factor, axis.std * unit.factor
    return f"mean {mean:.6g} {name}, standard deviation {std:.4g} {name}"


def _static(report: Report, axis: AxisReport, drawn: bytes | None) -> Markup:
    """Return the picture of an axis that stands in for its plots where scripts are off."""
    where = axis_title(axis).lower()
    picture, failed = try_side_work(
        lambda: drawn or render_small(axis_figure(report, axis)),
        None,
        what=f"The picture of {where} is missing",
        code="not-drawn",
    )
    if picture is None:
        return element("noscript", *(element("p", finding.text, class_="notice") for finding in failed))
    source = f"data:image/webp;base64,{base64.b64encode(picture).decode('ascii')}"
    name = f"Allan deviation and power spectral density of {where}"
    return element("noscript", element("img", src=source, alt=name, width="1100", class_="static"))


def _figure(axis: AxisReport, kind: str, caption: str | Markup) -> Markup:
    anchor = f"{axis.name}-{kind}"
    plot = element(
        "div",
        class_=f"plot {kind}",
        id=anchor,
        data_axis=axis.name,
        data_plot=kind,
        tabindex="0",
        role="group",
        aria_labelledby=f"{anchor}-caption",
        aria_describedby="plot-help",
    )
    return element("figure", plot, element("figcaption", caption, id=f"{anchor}-caption"))


def _curve_table(axis: AxisReport) -> Markup:
    fit = axis.fit
    low, high = fit.curve.confidence_interval(fit.level)
    model, used = fit.model_adev(), set(fit.used.tolist())
    titles = ("τ (s)", "m", "deviation", "low", "high", "model", "degrees of freedom", "used by the fit")
    body = []
    for i in shown_points(fit.curve).tolist():
        values = (fit.curve.adev[i], low[i], high[i], model[i])
        body.append(
            row(
                element("th", f"{fit.curve.tau[i]:.6g}", scope="row"),
                *labelled(
                    titles[1:],
                    (
                        str(fit.curve.m[i]),
                        *(f"{value:.4g}" for value in values),
                        f"{fit.curve.edf[i]:.3g}",
                        "yes" if i in used else "no",
                    ),
                ),
            )
        )
    caption = f"{axis_title(axis)}: Allan deviation in {pretty(axis.unit)}, {100 * fit.level:.4g} % interval"
    return table(
        caption, [row(*(element("th", title, scope="col") for title in titles))], body, class_="cards"
    )
