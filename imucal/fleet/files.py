"""The files of a fleet's report: ``fleet.json``, ``fleet.csv``, ``fleet.html``, pictures.

All numbers of JSON and CSV are in SI. An incompatible change of the schema raises its number.
"""

import csv
import io
import json
import re
import unicodedata
from collections.abc import Callable
from functools import partial
from pathlib import Path

from imucal.findings import Finding
from imucal.fleet.page import render_fleet_page, verdict
from imucal.fleet.pictures import drawn_as, fleet_pictures
from imucal.fleet.summary import Fleet, FleetTerm
from imucal.printable import printable
from imucal.report.out_folder import OutFolder
from imucal.report.typed_json import JsonObject, picked, to_json
from imucal.side_work import try_side_work

SCHEMA = "imucal/fleet/1"

_COLUMNS = (
    *("model", "sensor", "axis", "term", "unit_si", "unit", "logs", "value", "low", "high", "odd", "p_odd"),
    *("logs_differ", "median", "spread", "within", "prediction_low", "prediction_high", "tolerance"),
    *("median_low", "median_high", "bounded"),
)
_LIMITS, _FINDING = "value low high", "level code axis text"
_POPULATION = "logs content confidence median bounded spread within prediction quantile tolerance"


def fleet_document(fleet: Fleet) -> JsonObject:
    """Return a fleet as JSON values."""
    grade, text = verdict(fleet)
    return {
        "schema": SCHEMA,
        "version": fleet.version,
        "verdict": {"grade": grade, "text": text},
        "logs": {
            "asked": fleet.asked,
            "done": len(fleet.logs),
            "counted": sum(not log.left_out for log in fleet.logs),
        },
        "models": [
            {
                "name": model.name,
                "units": list(model.units),
                "logs": sum(not log.left_out for log in model.logs),
                "rate_hz": to_json(model.rate_hz),
                "terms": [_term(term) for term in model.terms],
            }
            for model in fleet.models
        ],
        "failures": [
            {"kind": kind, "reason": reason, "logs": [log.path for log in logs]}
            for (kind, reason), logs in fleet.failures.items()
        ],
        "without_unit": {"labels": fleet.labels, "logs": [log.path for log in fleet.loose]},
    }


def fleet_csv(fleet: Fleet) -> str:
    """Return ``fleet.csv``: a row per model, term, axis and unit, with its population."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(_COLUMNS)
    for model, term in ((m, term) for m in fleet.models for term in m.terms):
        found, first = term.population, (_cell(model.name), term.sensor, term.axis, term.term, term.unit)
        last = (
            found.middle,
            *(one and one.value for one in (found.spread, found.within)),
            *(found.prediction or (None, None)),
            *(found.tolerance, found.median.low, found.median.high, int(found.bounded)),
        )
        for unit in found.units:
            known = unit.logs, unit.value, unit.low, unit.high, int(unit.odd), unit.p_odd
            differ = None if unit.p_logs is None else int(unit.unit in term.differing)
            rows.writerow((*first, _cell(unit.unit), *known, differ, *last))
    return text.getvalue()


#: First characters of a formula in spreadsheets, in their narrow forms.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def _cell(text: str) -> str:
    """Return a label that neither a spreadsheet nor a terminal executes."""
    # Spreadsheets also accept wide letters and leading spaces.
    plain_text = unicodedata.normalize("NFKC", text).lstrip(" \n")
    return f"'{printable(text)}" if plain_text.startswith(_FORMULA) else printable(text)


def _term(term: FleetTerm) -> JsonObject:
    found = term.population
    return {
        **picked(term, "sensor axis term unit"),
        **picked(found, _POPULATION),
        "median": {"value": found.middle, **picked(found.median, "low high")},
        "tolerance_without_odd": term.without_odd,
        "units": [
            {
                **picked(unit, f"unit logs {_LIMITS} p_odd odd p_logs"),
                "odd_overall": unit.unit in term.sure,
                "logs_differ": unit.unit in term.differing,
            }
            for unit in found.units
        ],
        "findings": [picked(finding, _FINDING) for finding in found.findings],
    }


def write_fleet(
    fleet: Fleet,
    out: str | Path | None = None,
    *,
    pictures: bool = True,
    html: bool = True,
    on_finding: Callable[[Finding], None] | None = None,
) -> tuple[Path, ...]:
    """Write the report of a fleet; return the files, ``fleet.json`` first.

    If ``fleet.json`` exists, all files belong to one report. A picture or page that can't be drawn is left
    out.

    Parameters
    ----------
    fleet
        From `imucal.load_fleet`.
    out
        The folder; by default the fleet's own.
    pictures, html
        Whether to write PNGs and the page.
    on_finding
        Called with the finding of each picture or page that was left out.

    Raises
    ------
    WriteError
        If a file can't be written.
    """
    folder = fleet.folder if out is None else Path(out)
    written = _drawn(fleet, pictures=pictures, html=html, on_finding=on_finding or (lambda _: None))
    text = json.dumps(fleet_document(fleet), indent=1, allow_nan=False, ensure_ascii=False)
    contents = {"fleet.json": f"{text}\n".encode(), "fleet.csv": fleet_csv(fleet).encode()}
    contents |= {name: data for name, data in written.items() if data is not None}
    # An old picture would not match the new numbers.
    missing = re.compile("|".join(re.escape(name) for name, data in written.items() if data is None))
    return OutFolder(
        path=folder, what="fleet report", document="fleet.json", schema=SCHEMA, own=missing, shared=True
    ).write(contents)


def _drawn(
    fleet: Fleet, *, pictures: bool, html: bool, on_finding: Callable[[Finding], None]
) -> dict[str, bytes | None]:
    """Return PNGs and page, None for failed ones."""
    written: dict[str, bytes | None] = {}
    on_page: dict[str, list[tuple[str, bytes]]] = {}

    def tried(draw: Callable[[], dict[str, bytes]], name: str) -> dict[str, bytes]:
        drawn, failed = try_side_work(draw, {}, what=f"{name} is missing", code="not-drawn")
        for finding in failed:
            on_finding(finding)
        return drawn

    forms = [form for form, wanted in (("png", pictures), ("svg", html)) if wanted]
    for picture in fleet_pictures(fleet) if forms else ():
        name = f"{picture.name}.png"
        drawn = tried(partial(drawn_as, picture.draw, forms), name)
        if pictures:
            written[name] = drawn.get("png")
        if "svg" in drawn:
            on_page.setdefault(picture.model.name, []).append((picture.shows, drawn["svg"]))
    if html:
        page = tried(lambda: {"html": render_fleet_page(fleet, on_page).encode()}, "fleet.html")
        written["fleet.html"] = page.get("html")
    return written
