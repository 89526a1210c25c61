"""``fleet.html``: what the units of each sensor model are like, on one page that opens without a network.

Tables and pictures are there without any script: the templates lay them out, `verdict` words the numbers.
"""

import base64
import shlex
from collections.abc import Iterator, Mapping, Sequence
from typing import TypeAlias

from imucal.fleet.trend import NEAREST
from imucal.fleet_report import verdict
from imucal.fleet_report.summary import Fleet, SensorModel
from imucal.report.markup import Markup, render

#: Most logs without a label that are listed.
_MOST_LOOSE = 500
#: What the templates call, of `verdict`.
_TEXTS = (
    *("alone", "between", "bound_name", "by_term", "loose_text", "loose_value", "median_text", "p_text"),
    *("percent", "price_text", "slope_text", "term_name", "with_limits"),
)

#: Section of the page -> what each of its pictures shows, and its SVG.
Pictures: TypeAlias = Mapping[str, Sequence[tuple[str, bytes]]]


def render_fleet_page(fleet: Fleet, pictures: Pictures | None = None) -> str:
    """Return the page, with the pictures that are drawn; the same fleet always gives the same text."""
    name = fleet.folder.resolve().name
    grade, sentence = verdict.verdict(fleet)
    return _filled(
        "fleet.html",
        title=f"{name} – fleet of IMUs",
        heading="Fleet" if name == "fleet" else f"Fleet {name}",
        grade=grade,
        sentence=sentence,
        lead=_lead(fleet),
        sections=list(_sections(fleet, pictures or {})),
        version=fleet.version,
    )


def _filled(template: str, **values: object) -> Markup:
    texts = {name: getattr(verdict, name) for name in _TEXTS}
    return render(template, package="imucal.fleet_report", **texts, **values)


def _lead(fleet: Fleet) -> str:
    parts = [
        f"{f'{model.name}: ' * bool(model.name)}{len(model.units)} unit{'s' * (len(model.units) != 1)}, "
        f"{sum(not log.left_out for log in model.logs)} logs that count, {model.rate_hz:.6g} Hz"
        for model in fleet.models
    ]
    waiting = fleet.asked - len(fleet.logs)
    if waiting > 0:
        parts.append(f"{waiting} of {fleet.asked} logs are not done yet")
    return " · ".join(parts) or f"{len(fleet.logs)} logs"


def _sections(fleet: Fleet, pictures: Pictures) -> Iterator[tuple[str, str, Markup]]:
    """Yield anchor, title and body of each section."""
    models = fleet.models

    def drawn(section: str) -> Markup:
        own = pictures.get(section, ())
        encoded = [(shows, base64.b64encode(svg).decode("ascii")) for shows, svg in own]
        return _filled("pictures.html", section=section, pictures=encoded)

    if models:
        yield "config", "The number for the config", config_section(models)
    for i, model in enumerate(models):
        title = f"Units of {model.name}" if model.name else "Units"
        yield f"units-{i}", title, drawn(f"units-{i}") + _filled("units.html", model=model)
    if len(models) > 1:
        yield "models", "Models side by side", drawn("models")
    if models:
        yield "heat", "Units and terms", drawn("heat")
        yield "trend", "Temperature and time", drawn("trend") + _slopes(models)
        tested = [model for model in models if any(term.unit_logs for term in model.terms)]
        if tested:
            yield "logs", "Several logs of one unit", _filled("unit_logs.html", models=tested)
        yield "numbers", "All numbers", _filled("numbers.html", models=models)
    if fleet.loose:
        command = ["imucal", "fleet", "run", "-o", str(fleet.folder), "--labels", fleet.labels]
        logs = fleet.loose[:_MOST_LOOSE]
        columns = list(dict.fromkeys(where for one in logs for where in one.values))
        body = _filled("loose.html", fleet=fleet, logs=logs, columns=columns, command=shlex.join(command))
        yield "loose", "Logs without a unit", body
    yield "failed", "Logs that do not count", _filled("failed.html", failures=fleet.failures)
    if fleet.findings:
        yield "findings", "Findings", _filled("remarks.html", findings=fleet.findings)
    yield "words", "What the words mean", _filled("words.html")


def config_section(models: Sequence[SensorModel]) -> Markup:
    """Return the number for the config of each term and axis of sensor models, with median and spreads."""
    few = [model.title for model in models if len(model.units) < 3]
    with_axes = [(model, sorted({term.axis for term in model.terms})) for model in models]
    return _filled("config.html", models=with_axes, few=few)


def _slopes(models: Sequence[SensorModel]) -> Markup:
    """Return what temperature and time do to each term; where labels do not tell, why not."""
    every = [
        (f"{f'{model.title} ' * (len(models) > 1)}{term.name} {term.term}", term)
        for model in models
        for term in model.terms
    ]
    refused: dict[str, list[str]] = {}
    for where, term in every:
        if term.trend is None:
            refused.setdefault(term.no_trend, []).append(where)
    moving = [(where, term.trend) for where, term in every if term.trend]
    units = {label: verdict.per(label, [trend for _, trend in moving]) for label in NEAREST}
    return _filled("slopes.html", moving=moving, units=units, refused=refused)
