"""The page's explanations: what the terms mean, and how the numbers were made."""

import json
import math

from imucal.fitting.noise_fit import Goodness
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report.markup import Markup, element, join, labelled, row, table
from imucal.report.result import AxisReport, Report
from imucal.units import pretty

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


def _misfit(goodness: Goodness) -> str:
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
        _misfit(goodness),
        ", ".join(others) or "nothing near",
    )
    return row(element("th", axis.name, scope="row"), *labelled(_FIT_TITLES, cells))
