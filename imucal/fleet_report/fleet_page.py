"""``fleet.html``: what the units of each sensor model are like, on one page that opens without a network.

Tables and pictures are there without any script.
"""

from imucal.fleet_report.fleet_lists import failures_section, loose_section, words_section
from imucal.fleet_report.fleet_tables import (
    by_term,
    config_table,
    detail_table,
    heat_table,
    slope_table,
    unit_logs_table,
)
from imucal.fleet_report.fleet_verdict import verdict
from imucal.fleet_report.panels import strip_panel, unit_panel
from imucal.fleet_report.shown import bound_name, median_text, p_text, percent, price_text
from imucal.fleet_report.summary import Fleet, FleetTerm, SensorModel
from imucal.noise.terms import TERMS
from imucal.report.markup import Markup, element, join
from imucal.report.page_frame import Page, Section, page_file, render_frame

_KEY = (
    ('<circle class="mark" cx="13" cy="7" r="3.2"/><line class="whisker" x1="2" y1="7" x2="24" y2="7"/>',
     "a unit with its 95 % interval"),
    ('<polygon class="mark open" points="8,7 16,3 16,11"/>', "a unit that is only bounded"),
    ('<polygon class="mark odd" points="8,7 13,2 18,7 13,12"/>', "an odd unit"),
    ('<line class="median" x1="13" y1="0" x2="13" y2="14"/>', "the median unit"),
    ('<rect class="band" x="2" y="1" width="22" height="12"/>', "where the next unit lies, 95 %"),
    ('<line class="bound" x1="13" y1="0" x2="13" y2="14"/>', "the tolerance bound"),
)  # fmt: skip


def render_fleet_page(fleet: Fleet) -> str:
    """Return the page; the same fleet always gives the same text."""
    name = fleet.folder.resolve().name
    grade, sentence = verdict(fleet)
    return render_frame(
        Page(
            title=f"{name} – fleet of IMUs",
            heading="Fleet" if name == "fleet" else f"Fleet {name}",
            grade=grade,
            sentence=sentence,
            lead=_lead(fleet),
            sections=_sections(fleet),
            version=fleet.version,
            style=page_file("fleet.css", "imucal.fleet_report"),
        )
    )


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


def _sections(fleet: Fleet) -> list[Section]:
    models = fleet.models
    found: list[Section] = []
    if models:
        note = element("p", "Bold: the number for the config of every unit. ", _few_note(fleet))
        found.append(("config", "The number for the config", join([note, *map(config_table, models)])))
    for i, model in enumerate(models):
        found.append((f"units-{i}", f"Units of {model.name}" if model.name else "Units", _units(model)))
    if len(models) > 1:
        found.append(("models", "Models side by side", _strips(models)))
    if models:
        found.append(("heat", "Units and terms", join([_heat_note(), *map(heat_table, models)])))
        found.append(("trend", "Temperature and time", slope_table(models)))
        tested = [model for model in models if any(term.unit_logs for term in model.terms)]
        if tested:
            found.append(("logs", "Several logs of one unit", join(map(unit_logs_table, tested))))
        found.append(("numbers", "All numbers", join(map(detail_table, models))))
    if fleet.loose:
        found.append(("loose", "Logs without a unit", loose_section(fleet)))
    found.append(("failed", "Logs that do not count", failures_section(fleet)))
    if fleet.findings:
        items = [element("li", finding.text) for finding in fleet.findings]
        found.append(("findings", "Findings", element("ul", *items, class_="findings warning")))
    found.append(("words", "What the words mean", words_section()))
    return found


def _few_note(fleet: Fleet) -> str:
    few = [model.title for model in fleet.models if len(model.units) < 3]
    if not few:
        return ""
    return (
        f"{', '.join(few)}: fewer than 3 units tell no spread between units, and so no bound; 10 are worth "
        "testing."
    )


def _units(model: SensorModel) -> Markup:
    key = [
        element("li", Markup(f'<svg class="units-plot" aria-hidden="true">{svg}</svg>'), f" {text}")
        for svg, text in _KEY
    ]
    parts = [element("ul", *key, class_="keyline")]
    groups = by_term(model)
    if all(len(terms) == 1 for terms in groups.values()):
        # One axis: its terms side by side.
        return join([*parts, element("div", *map(_figure, model.terms), class_="panels")])
    for (sensor, name), terms in groups.items():
        title = f"{name} {TERMS[terms[0].symbol].name(terms[0].sensor)}, {sensor}"
        parts += [element("h3", title), element("div", *map(_figure, terms), class_="panels")]
    return join(parts)


def _figure(term: FleetTerm) -> Markup:
    found = term.population
    label = f"{term.name} {term.term}: {len(found.units)} units, sorted, with 95 % intervals"
    text: list[str | Markup] = [element("b", f"{term.name} {term.term}"), ": median ", median_text(term)]
    if found.spread:
        text.append(f", units ±{percent(found.spread.value)}")
    text.append(".")
    if term.odd:
        text.append(f" Odd: {', '.join(f'{u.unit} ({p_text(u.p_odd or 0.0)})' for u in term.odd)}.")
    if term.price:
        text.append(f" Price of {bound_name(term)}: {price_text(term)}.")
    text += [f" {finding.text}" for finding in found.findings]
    return element("figure", unit_panel(term, label), element("figcaption", *text))


def _strips(models: tuple[SensorModel, ...]) -> Markup:
    keys = dict.fromkeys((term.name, term.term) for model in models for term in model.terms)
    panels = []
    for name, key in keys:
        own = [(m, t) for m in models for t in m.terms if (t.name, t.term) == (name, key)]
        label = f"{name} {key}: a row a model, a dot a unit"
        panels.append(
            element("figure", strip_panel(own, label), element("figcaption", element("b", f"{name} {key}")))
        )
    note = "A dot is a unit, the line the median unit; the next unit lies in the band with 95 % probability."
    return join([element("p", note), element("div", *panels, class_="panels")])


def _heat_note() -> Markup:
    return element(
        "p",
        "Colour: how many standard deviations of the next unit a unit lies above (warm) or below (cold) the "
        "median, one, two or three. A frame and ! mark an odd unit; seen: the unit shows a term that the "
        "logs of all units together do not.",
    )
