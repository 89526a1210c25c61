"""The lists of a fleet's page: logs that do not count, logs without a unit, what the words mean."""

import shlex

from imucal.fleet.values import LogValue
from imucal.fleet_report.shown import loose_text
from imucal.fleet_report.summary import Fleet, FleetLog, LooseLog
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.markup import Markup, both_units, element, join, labelled, row, table
from imucal.report.numbers import Quantity

#: Most paths of one reason that stand in sight; most logs without a label that are listed.
_FEW, _MOST = 5, 500

_WORDS = {
    "median unit": "Half of the units of this sensor model are below it, half above; with its 95 % interval.",
    "between units": (
        "Standard deviation of the units' coefficients about the median, relative. It is what is left when "
        "the error of each log is taken out."
    ),
    "within a unit": (
        "Standard deviation between the logs of one unit beyond the error of each: day, temperature, place."
    ),
    "next unit": "A new unit of the same model lies within this band with a probability of 95 %.",
    "tolerance bound": (
        "The number for the config of every unit. 95/95: with 95 % confidence, 95 of 100 units of this model "
        "are below it. Odd units count in it, as in all numbers."
    ),
    "price": (
        "How far the tolerance bound lies above the level that those 95 of 100 units are below: with as many "
        "units as were tested, and with more. Few units make the bound large; testing more would save that."
    ),
    "odd": (
        "A unit that is not like the others, judged by what the others alone are like. In a fleet without "
        "odd units, each term of each axis has a false alarm with a probability of at most 5 %; the first "
        "line of this page names apart those that may be one of so many terms' false alarms."
    ),
    "upper bound": (
        "The logs of the unit do not show the term; it is below this. It still counts in median and spread."
    ),
}


def failures_section(fleet: Fleet) -> Markup:
    """Return the logs that do not count, grouped by reason, with links to their own reports."""
    blocks = []
    for (kind, reason), logs in fleet.failures.items():
        items = [element("li", *_path(log)) for log in logs]
        listed = element("ul", *items[:_FEW], class_="paths")
        if more := items[_FEW:]:
            rest = element("ul", *more, class_="paths")
            listed = join([listed, element("details", element("summary", f"{len(more)} more"), rest)])
        level = "warning" if kind == "not-noise" else "error"
        title = join([element("b", f"{kind}, {len(logs)} log{'s' * (len(logs) > 1)}: "), reason])
        blocks.append(element("ul", element("li", title, listed), class_=f"findings {level}"))
    return join(blocks) if blocks else element("p", "Every log that was done counts.")


def _path(log: FleetLog) -> list[str | Markup]:
    parts: list[str | Markup] = [element("code", log.path)]
    if log.report:
        parts += [" – ", element("a", "its report", href=f"{log.report}/report.html")]
    return parts


def loose_section(fleet: Fleet) -> Markup:
    """Return the logs without a unit one by one, and the labels that would make a population of them."""
    text = (
        f"{loose_text(fleet)}: which of them are of one unit is not known, so that "
        "nothing is said of the sensor model. Say where the label stands in the paths, or give a manifest "
        "with the columns path and unit:"
    )
    command = f"imucal fleet run -o {shlex.quote(str(fleet.folder))} --labels {shlex.quote(fleet.labels)}"
    shown = fleet.loose[:_MOST]
    columns = list(dict.fromkeys(where for one in shown for where in one.values))
    titles = [f"{axis} {term}" for axis, term in columns]
    body = [
        row(
            element("th", _name(one), scope="row"),
            *labelled(titles, [_loose_cell(where, one.values.get(where)) for where in columns]),
        )
        for one in shown
    ]
    head = [row(*(element("th", title, scope="col") for title in ("log", *titles)))]
    listed = table("Each log by itself, with its 95 % interval", head, body, class_="wide cards tight")
    return join([element("p", text), element("pre", element("code", command)), listed])


def _name(one: LooseLog) -> Markup:
    if not one.log.report:
        return element("code", one.log.path)
    return element("a", one.log.path, href=f"{one.log.report}/report.html")


def _loose_cell(where: tuple[str, str], value: LogValue | None) -> Markup:
    if value is None:
        return Markup("–")
    axis, term = where
    sensor = next(s for s in Sensor if axis.startswith(s.short))
    law = TERMS[term.rstrip("0123456789")]
    plain = Quantity(value=value.value, low=value.low, high=value.high, unit=law.unit(sensor))
    unit = law.datasheet_unit(sensor)
    return both_units(
        numbers.with_interval(plain.scaled(unit.factor, unit.name)), numbers.with_interval(plain)
    )


def words_section() -> Markup:
    """Return what the words of the page mean."""
    pairs = [(element("dt", element("b", word)), element("dd", text)) for word, text in _WORDS.items()]
    return element("dl", *map(join, pairs))
