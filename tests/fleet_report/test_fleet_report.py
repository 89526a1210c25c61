"""Tests of the report of a fleet: numbers, files, page, pictures, and fleets with too few data."""

import base64
import csv
import io
import json
import math
import os
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from importlib import resources
from pathlib import Path

import jsonschema
import numpy as np
import polars as pl
import pytest
import yaml
from lxml import html
from scipy import stats

import imucal
from imucal import DataError, Fleet, ReadError
from imucal.checking.verdict import judge
from imucal.errors import ChoiceError
from imucal.fitting.noise_fit import Estimate
from imucal.fleet.store import MANIFEST, FleetStore
from imucal.fleet_report import answers, pictures
from imucal.fleet_report.answers import NEAR, tolerance_excess
from imucal.fleet_report.files import fleet_csv, fleet_document
from imucal.fleet_report.pages import alone, render_fleet_page, verdict
from imucal.fleet_report.pictures import (
    drawn_as,
    fleet_pictures,
    heat_figure,
    models_figure,
    sorted_units,
    units_figure,
)
from imucal.fleet_report.summary import FleetTerm, labels_to_type
from imucal.recording import Sensor
from imucal.report.numbers import Quantity
from tests.fleet_report.simulated_store import TERMS, write_store
from tests.raising import raises
from tests.report.browser import Browser

SCHEMA = json.loads(
    (resources.files("imucal.fleet_report") / "schema" / "fleet-1.schema.json").read_text(encoding="utf-8")
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store of 24 units: u07 is odd, logs of u02 differ, five logs failed."""
    place = tmp_path_factory.mktemp("fleets") / "fleet"
    write_store(place, bins=3)
    return place


@pytest.fixture(scope="module")
def fleet(folder: Path) -> Fleet:
    """Return the loaded fleet."""
    return imucal.load_fleet(folder)


def test_medians_cover_the_truth_and_the_odd_unit_is_found(fleet: Fleet) -> None:
    """The limits of the median cover the truth in at least 14 of 18 terms."""
    model = fleet.model()
    held = [
        term.population.median.low
        <= TERMS[str(term.sensor), term.term][1] * math.exp(0.034)
        <= term.population.median.high
        for term in model.terms
    ]
    assert sum(held) >= 14
    assert model["gyro_z", "N"].odd[0].unit == "u07"
    assert model["gyro_x", "N"].differing == ("u02",)
    assert [test.unit for test in model["gyro_x", "N"].unit_logs] == ["u00", "u01", "u02"]
    with pytest.raises(KeyError, match="gyro_x N"):
        model["gyro_x", "Q"]


def test_logs_that_do_not_count_are_grouped(fleet: Fleet) -> None:
    """The most frequent reason comes first; a log that was moved is one of them."""
    assert [(kind, len(logs)) for (kind, _), logs in fleet.failures.items()] == [
        ("unreadable", 2),
        ("memory", 1),
        ("not-noise", 1),
        ("timeout", 1),
    ]
    assert ("unreadable", "the file is damaged: no footer after byte 12") in fleet.failures
    assert "u94" not in fleet.model().units
    assert verdict(fleet)[0] == "check"
    assert "u07 (gyro_z N)" in verdict(fleet)[1]
    assert "5 of 101 logs do not count" in verdict(fleet)[1]
    kept = [log for log in fleet.logs if not log.left_out]
    left_out = [log for log in fleet.logs if log.left_out]
    one = replace(fleet, logs=(*kept, *(replace(log, left_out="") for log in left_out[1:]), left_out[0]))
    assert "1 of 101 logs does not count" in verdict(one)[1]


def test_a_copy_of_a_log_is_not_unfinished(tmp_path: Path) -> None:
    """It is done with its original; other logs of the manifest without results are unfinished."""
    store = write_store(
        tmp_path / "fleet",
        units=3,
        temperatures=(25.0,),
        special=False,
        failures=False,
        weak="",
        names=("gyro_x",),
    )
    first = store.manifest()["path"][0]
    rows = [{"path": "copy.mcap", "copy_of": first}, {"path": "other.mcap", "copy_of": first}]
    store.add_to_manifest(pl.DataFrame(rows))
    fleet = imucal.load_fleet(store.folder)
    assert (fleet.asked, len(fleet.logs)) == (3, 3)
    assert "not done yet" not in render_fleet_page(fleet)
    store.add_to_manifest(pl.DataFrame({"path": ["late.mcap"]}))
    assert "1 of 4 logs are not finished" in render_fleet_page(imucal.load_fleet(store.folder))


def test_tests_of_units_do_not_depend_on_the_batch_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The limit on the number of logs in memory does not change results."""
    write_store(
        tmp_path, units=3, temperatures=(25.0, 25.0), special=False, failures=False, weak="", bins=3,
        names=("gyro_x",),
    )  # fmt: skip
    at_once = [term.unit_logs for term in imucal.load_fleet(tmp_path).model().terms]
    monkeypatch.setattr(answers, "_LOGS_IN_MEMORY", 1)
    shutil.rmtree(tmp_path / "derived")
    assert [term.unit_logs for term in imucal.load_fleet(tmp_path).model().terms] == at_once
    assert [len(tests) for tests in at_once] == [3, 3, 3]


def test_the_document_matches_its_schema(fleet: Fleet) -> None:
    jsonschema.validate(fleet_document(fleet), SCHEMA)
    document = fleet_document(fleet)
    term = document["models"][0]["terms"][0]  # type: ignore[index]
    assert term["median"]["value"] == fleet.model().terms[0].population.median.value
    assert len(term["units"]) == 24
    assert document["verdict"] == dict(zip(("grade", "text"), verdict(fleet), strict=True))


def test_a_unit_that_is_odd_by_chance_is_not_odd_overall(fleet: Fleet) -> None:
    """One in 20 terms has a false alarm, so the verdict adjusts for all units and terms."""
    (model,) = fleet.models
    by_chance = [
        replace(
            term,
            population=replace(
                term.population,
                units=tuple(
                    replace(unit, p_value=2e-3, p_odd=0.048, odd=True) if unit.unit == "u03" else unit
                    for unit in term.population.units
                ),
            ),
        )
        if (term.name, term.term) == ("accel_y", "K")
        else term
        for term in model.terms
    ]
    changed = replace(fleet, models=(replace(model, terms=tuple(by_chance)),))
    odd_units, chance = verdict(changed)[1].split("perhaps by chance: ")
    assert "u07 (gyro_z N)" in odd_units
    assert "u03 (accel_y K)" in chance
    document = fleet_document(changed)
    found = {
        (term["sensor"], term["axis"], term["term"], unit["unit"]): unit["odd_overall"]
        for term in document["models"][0]["terms"]  # type: ignore[index]
        for unit in term["units"]
        if unit["odd"]
    }
    assert found["gyroscope", "z", "N", "u07"]
    assert not found["accelerometer", "y", "K", "u03"]


def test_the_table_has_one_row_per_unit_and_term(fleet: Fleet) -> None:
    """Each row also contains the numbers of the population."""
    rows = list(csv.DictReader(io.StringIO(fleet_csv(fleet))))
    assert len(rows) == 24 * 18
    odd = [row for row in rows if row["odd"] == "1" and row["term"] == "N"]
    assert [(row["unit"], row["sensor"], row["axis"]) for row in odd] == [("u07", "gyroscope", "z")]
    found = fleet.model()["gyro_z", "N"].population
    assert float(odd[0]["tolerance"]) == found.tolerance
    assert [row["logs_differ"] for row in rows[:4]] == ["0", "0", "1", ""]


@pytest.mark.parametrize(
    ("label", "cell"),
    [
        ("=cmd()|'x'\x1b[2J", "'=cmd()|'x'\\x1b[2J"),
        ("@SUM(A1)", "'@SUM(A1)"),
        ("  +1", "'  +1"),
        ("\t=1", "'\t=1"),
        ("\r=1", "'\\r=1"),
        ("\N{FULLWIDTH EQUALS SIGN}1", "'\N{FULLWIDTH EQUALS SIGN}1"),
        ("ACME-6 = best", "ACME-6 = best"),
    ],
)
def test_labels_in_a_table_are_escaped(fleet: Fleet, label: str, cell: str) -> None:
    """Neither a spreadsheet runs their formulas nor a terminal their codes; other cells are unchanged."""
    (model,) = fleet.models
    bad = replace(fleet, models=(replace(model, name=label),))
    rows = list(csv.DictReader(io.StringIO(fleet_csv(bad))))
    assert {row["model"] for row in rows} == {cell}
    assert {row["unit"] for row in rows} == {f"u{number:02}" for number in range(24)}


def test_two_units_have_neither_spread_nor_bound(tmp_path: Path) -> None:
    """Document, page and export explain it."""
    write_store(tmp_path / "two", units=2, failures=False, special=False, weak="", names=("gyro_x",))
    fleet = imucal.load_fleet(tmp_path / "two")
    jsonschema.validate(fleet_document(fleet), SCHEMA)
    found = fleet.model().terms[0].population
    assert found.spread is None
    assert found.tolerance is None
    assert fleet.model().terms[0].price == ()
    page = html.fromstring(render_fleet_page(fleet))
    text = page.text_content()
    assert "a spread between units and a bound need at least 3 units" in text
    assert "no bound" in page.cssselect("table.config")[0].text_content()
    with pytest.raises(DataError, match=r"2 units, .* a tolerance bound"):
        imucal.fleet_as_report(fleet)
    assert imucal.fleet_as_report(fleet, value="median").axes[0].fit["N"].value == found.median.value
    report = imucal.fleet_as_report(fleet, value="median")
    with pytest.raises(DataError, match=r"2 units of ACME-6, .* to predict"):
        imucal.check_fleet(report, fleet)


def test_logs_without_a_unit_are_listed_with_the_labels_to_type(tmp_path: Path) -> None:
    """They have no population."""
    write_store(
        tmp_path / "loose", units=3, labelled=False, failures=False, special=False, weak="", names=("gyro_x",)
    )
    fleet = imucal.load_fleet(tmp_path / "loose")
    assert fleet.models == ()
    assert len(fleet.loose) == 12
    assert fleet.labels == "{unit}.mcap"
    jsonschema.validate(fleet_document(fleet), SCHEMA)
    page = html.fromstring(render_fleet_page(fleet))
    section = page.get_element_by_id("loose")
    assert "--labels '{unit}.mcap'" in section.text_content()
    assert len(section.cssselect("tbody tr")) == 12
    with raises(ChoiceError, "no log has a unit label", place="loose", argument="model"):
        fleet.model()


@pytest.mark.parametrize(
    ("paths", "text"),
    [
        (["a/u1/x.bag", "a/u2/x.bag"], "{unit}/*.bag"),
        (["a/u1/x.bag", "a/u2/y.mcap"], "{unit}/*"),
        (["u1.csv", "u2.csv"], "{unit}.csv"),
        (["logs/u1.csv", "logs/u2.csv"], "{unit}.csv"),
    ],
)
def test_suggested_labels_use_the_differing_part_of_the_path(paths: list[str], text: str) -> None:
    """It is the folder if folders differ, otherwise the file name."""
    assert labels_to_type(paths) == text


def test_folders_without_finished_logs_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match=r"manifest\.parquet: no such file"):
        imucal.load_fleet(tmp_path)
    store = FleetStore(tmp_path / "empty")
    store.create()
    store.add_to_manifest(
        pl.DataFrame({name: ["a.csv" if name == "path" else None] for name in MANIFEST}, schema=MANIFEST)
    )
    with pytest.raises(DataError, match="found 1 logs, none finished"):
        imucal.load_fleet(tmp_path / "empty")


def test_the_price_follows_from_the_noncentral_t_law() -> None:
    """The references have 5 and 50 units; with many units the price tends to 1."""
    for units, content in ((5, 0.95), (50, 0.9)):
        z = stats.norm.ppf(content)
        factor = stats.nct.ppf(0.95, units - 1, z * math.sqrt(units)) / math.sqrt(units)
        assert tolerance_excess(units, 0.3, content=content) == pytest.approx(
            math.exp(0.3 * (factor - z)), rel=1e-4
        )
    assert tolerance_excess(10_000, 0.3) < 1.01


def test_the_suggested_number_of_units_is_the_smallest(fleet: Fleet) -> None:
    """One unit less exceeds the tolerance."""
    term = fleet.model()["accel_y", "K"]
    spread = term.population.spread
    assert spread is not None
    near = next(units for units, ratio in term.price if ratio <= NEAR)
    assert tolerance_excess(near - 1, spread.value) > NEAR >= tolerance_excess(near, spread.value)
    assert [units for units, _ in term.price][:2] == [24, 48]


def test_exports_contain_the_tolerance_bound(fleet: Fleet) -> None:
    """A comment explains its origin, and every format can be written."""
    from imucal.report.exports import TARGETS, ExportOptions, render

    report = imucal.fleet_as_report(fleet)
    text = render(report, "kalibr", ExportOptions(numbers="as-fitted"))
    worst = max(fleet.model()[f"gyro_{a}", "N"].population.tolerance or 0.0 for a in "xyz")
    assert f"gyroscope_noise_density: {worst:.8g}" in text
    assert "95/95 tolerance bound of 24 units" in text
    covered = yaml.safe_load(render(report, "kalibr"))["gyroscope_noise_density"]
    assert worst < covered < 2 * worst
    assert "enough for gyro_x, gyro_y, gyro_z, 95/95 tolerance bound of 24 units" in render(report, "kalibr")
    assert "fleet of 24 units of ACME-6; every number is the 95/95 tolerance bound" in text
    for target in TARGETS:
        assert "written by imucal" in render(report, target)
    with pytest.raises(ValueError, match="is not one of tolerance, median"):
        imucal.fleet_as_report(fleet, value="mean")  # type: ignore[arg-type]


def test_gauss_markov_terms_are_exported_with_the_time_of_the_median_log(tmp_path: Path) -> None:
    """Formats without Gauss-Markov terms list them in a comment."""
    from imucal.report.exports import ExportOptions, render

    write_store(
        tmp_path, units=5, special=False, failures=False, weak="", times=(40.0, 100.0, 250.0),
        names=("gyro_x", "gyro_y"),
    )  # fmt: skip
    fleet = imucal.load_fleet(tmp_path, unit_logs=False)
    report = imucal.fleet_as_report(fleet)
    (axis,) = [axis for axis in report.axes if axis.name == "gyro_x"]
    found = axis.fit["GM"]
    assert found.value == fleet.model()["gyro_x", "GM"].population.tolerance
    assert found.correlation_time is not None
    assert found.correlation_time.value == pytest.approx(100, rel=1e-6)
    assert [axis.name for axis in report.axes if "GM" in str(axis.fit.model)] == ["gyro_x"]
    states = render(report, "gm")
    assert f"{found.value:.8g}" in states
    assert "100" in states
    fitted = render(report, "kalibr", ExportOptions(numbers="as-fitted"))
    assert "not supported by this format: B (" in fitted
    assert "GM (gyro_x)" in fitted


def test_a_model_is_selected_by_name(fleet: Fleet) -> None:
    """The error for an unknown name lists the models."""
    assert fleet.model("ACME-6") is fleet.model()
    with raises(ChoiceError, "'BOLT-9'", place="fleet", argument="model"):
        imucal.fleet_as_report(fleet, "BOLT-9")


def test_medians_of_two_fleets_are_compared(fleet: Fleet, tmp_path: Path) -> None:
    """Fleets of the same model agree; one with 1.5 times the noise differs."""
    write_store(tmp_path / "b", seed=9, special=False, failures=False, weak="", names=("gyro_x", "accel_z"))
    other = imucal.load_fleet(tmp_path / "b")
    one, same = (imucal.fleet_as_report(each, value="median") for each in (fleet, other))
    assert not imucal.compare(one, same).significant
    noisy = replace(
        same,
        axes=tuple(
            replace(
                axis,
                fit=replace(
                    axis.fit,
                    estimates=tuple(
                        replace(e, value=1.5 * (e.value or 0), low=1.5 * e.low, high=1.5 * e.high)
                        for e in axis.fit.estimates
                    ),
                ),
            )
            for axis in same.axes
        ),
    )
    found = imucal.compare(one, noisy).significant
    assert {(d.axis, d.key) for d in found} >= {("gyro_x", "N"), ("accel_z", "N")}


def test_a_typical_unit_passes_and_a_noisy_unit_fails(fleet: Fleet) -> None:
    """The check uses the unit's report; its text contains the range of the next unit."""
    report = imucal.fleet_as_report(fleet, value="median")
    rows = imucal.check_fleet(report, fleet)
    assert len(rows) == 18
    assert {row.verdict for row in rows} == {"pass"}
    axis = report.axes[0]
    noisy = tuple(
        replace(e, value=2 * (e.value or 0), low=2 * e.low, high=2 * e.high) if e.key == "N" else e
        for e in axis.fit.estimates
    )
    wrong = replace(report, axes=(replace(axis, fit=replace(axis.fit, estimates=noisy)), *report.axes[1:]))
    failed = [row for row in imucal.check_fleet(wrong, fleet) if row.verdict == "fail"]
    assert [(row.where, row.subject[:4]) for row in failed] == [("gyro_x", "N in")]
    assert "unlike the units of the fleet" in failed[0].text
    assert "the next unit of ACME-6 is in [" in failed[0].text
    with pytest.raises(DataError, match="no axis and term in common with ACME-6"):
        imucal.check_fleet(replace(report, axes=()), fleet)


def test_an_interval_beyond_the_range_is_undecided(fleet: Fleet) -> None:
    """Wide intervals and high upper bounds are undecided, as with fixed limits."""
    report = imucal.fleet_as_report(fleet, value="median")
    low, high = fleet.model()["gyro_x", "N"].population.prediction or (0.0, 0.0)

    def verdict_of(value: float | None, least: float, most: float) -> tuple[str, str]:
        axis = report.axes[0]
        own = tuple(
            (replace(e, value=value, low=least, high=most) if value else Estimate.bounded("N", "N", most))
            if e.key == "N"
            else e
            for e in axis.fit.estimates
        )
        one = replace(report, axes=(replace(axis, fit=replace(axis.fit, estimates=own)),))
        (row,) = [row for row in imucal.check_fleet(one, fleet) if row.subject.startswith("N ")]
        assert row.verdict == judge("gyro_x", "N", Quantity(value=value, low=least, high=most), side="max",
                                    limit=high).verdict or least < low  # fmt: skip
        return row.verdict, row.text

    middle = math.sqrt(low * high)
    assert verdict_of(middle, 1.01 * low, 0.99 * high)[0] == "pass"
    message = "the interval reaches beyond; record for longer to decide"
    for value, least, most in ((middle, 1.01 * low, 1.5 * high), (middle, 0.5 * low, 0.9 * high)):
        assert verdict_of(value, least, most)[0] == "undecided"
        assert verdict_of(value, least, most)[1].endswith(message)
    assert verdict_of(None, 0.0, 2 * high)[0] == "undecided"


def test_a_term_of_few_units_is_undecided(fleet: Fleet) -> None:
    """Terms of all units are still judged."""
    (model,) = fleet.models

    def of_two(term: FleetTerm) -> FleetTerm:
        if term.name != "accel_x":
            return term
        logs = tuple(log for log in term.logs if log.unit in {"u01", "u02"})
        return replace(term, logs=logs, population=imucal.population(logs))

    few = replace(fleet, models=(replace(model, terms=tuple(map(of_two, model.terms))),))
    rows = imucal.check_fleet(imucal.fleet_as_report(fleet, value="median"), few)
    assert [(row.where, row.verdict) for row in rows].count(("accel_x", "undecided")) == 3
    assert {row.verdict for row in rows if row.where != "accel_x"} == {"pass"}
    text = next(row.text for row in rows if row.where == "accel_x" and row.subject == "N")
    assert text.endswith(
        "2 units of the fleet with it, expected at least 3 to predict the next unit: not judged"
    )


@pytest.mark.slow
def test_the_false_alarm_rate_of_membership_is_five_per_cent() -> None:
    """The test draws 60 new units and uses one term."""
    from imucal.fleet.population import membership
    from tests.fleet.simulated import strong_fleet

    rng = np.random.default_rng(4601)
    p = [
        membership(imucal.population(fleet[:-1]), fleet[-1])
        for fleet in (strong_fleet(rng, units=9, tau=0.2, error=0.05) for _ in range(60))
    ]
    assert np.mean(np.array(p) < 0.05) <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / 60)
    assert 0.35 < np.mean(p) < 0.65
    with pytest.raises(ValueError, match="at least 3 units, got 2"):
        membership(imucal.population(strong_fleet(rng, units=2, tau=0.2, error=0.05)), fleet_of_one(rng))


def fleet_of_one(rng: np.random.Generator) -> imucal.LogValue:
    """Return one log."""
    from tests.fleet.simulated import strong_fleet

    return strong_fleet(rng, units=1, tau=0.1, error=0.1)[0]


@pytest.fixture(scope="module")
def written(fleet: Fleet, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    """Return the files of the fleet except pictures."""
    return imucal.write_fleet(fleet, tmp_path_factory.mktemp("page"), pictures=False)


@pytest.fixture(scope="module")
def page(written: tuple[Path, ...]) -> html.HtmlElement:
    """Return the page of the fleet."""
    return html.fromstring(written[-1].read_text(encoding="utf-8"))


def test_the_page_loads_no_external_files(page: html.HtmlElement) -> None:
    """Numbers and pictures need no script."""
    assert not page.cssselect("link[href^=http], script[src], img[src^=http], iframe")
    pictures = page.cssselect("figure img[alt]")
    assert len(pictures) == 3
    assert all((picture.get("src") or "").startswith("data:image/svg+xml;base64,") for picture in pictures)


def test_the_page_has_one_heading_and_named_sections(page: html.HtmlElement) -> None:
    """Every navigation link has a target, ids are unique, and tables have captions and scopes."""
    assert len(page.cssselect("h1")) == 1
    ids = [element.get("id") for element in page.cssselect("[id]")]
    assert len(ids) == len(set(ids))
    for link in page.cssselect("nav a"):
        assert page.get_element_by_id((link.get("href") or "")[1:]) is not None
    for table in page.cssselect("table"):
        assert table.cssselect("caption")
        assert all(th.get("scope") for th in table.cssselect("th"))
    for section in page.cssselect("section"):
        assert page.get_element_by_id(section.get("aria-labelledby") or "") is not None


def svg_of(element: html.HtmlElement) -> str:
    """Return the text of a picture of the page."""
    return base64.b64decode((element.get("src") or "").partition(",")[2]).decode()


def test_pictures_label_odd_units(fleet: Fleet, page: html.HtmlElement) -> None:
    """They have a shape and a name in addition to a colour; texts next to the pictures contain them too."""
    gyro, _ = page.cssselect("#units-0 figure img")
    assert gyro.get("alt") == "ACME-6, gyroscope: units sorted, each with its 95 % interval"
    assert all(word in svg_of(gyro) for word in (">u07<", ">odd unit<", ">95/95<", ">gyro_z N<"))
    items = [item.text_content() for item in page.cssselect("#units-0 .said li")]
    odd = [f"{term.name} {term.term}: odd: {term.odd[0].unit} (p" for term in fleet.model().terms if term.odd]
    assert [text.partition(" <")[0].partition(" =")[0] for text in items if "odd: " in text] == odd
    assert "gyro_z N: odd: u07 (p" in odd
    (heat,) = page.cssselect("#heat figure img")
    assert ">!<" in svg_of(heat)


def test_an_odd_unit_is_listed_with_its_effect_on_the_bound(fleet: Fleet, page: html.HtmlElement) -> None:
    """The page contains the bound without the odd unit, equal to a fleet without it."""
    term = fleet.model()["gyro_z", "N"]
    others = imucal.population([log for log in term.logs if log.unit != "u07"])
    assert term.without_odd == others.tolerance
    assert term.population.tolerance is not None
    assert term.without_odd is not None
    assert term.without_odd < 0.8 * term.population.tolerance
    (cell,) = [c for c in page.cssselect("table.config td small") if "without u07" in c.text_content()]
    assert cell.text_content() == f"without u07: {alone(term, term.without_odd).striptags()}"
    without_odd = {
        (t["sensor"], t["axis"], t["term"]): t["tolerance_without_odd"]
        for t in fleet_document(fleet)["models"][0]["terms"]  # type: ignore[index]
    }
    assert without_odd["gyroscope", "z", "N"] == term.without_odd
    assert without_odd["gyroscope", "x", "K"] is None


def test_units_are_sorted_by_decreasing_value(fleet: Fleet) -> None:
    values = [unit.value or unit.high for unit in sorted_units(fleet.model()["gyro_x", "B"])]
    assert values == sorted(values, reverse=True)


def test_a_failed_log_has_a_link_to_its_report(page: html.HtmlElement) -> None:
    """Failed logs without a report have no link."""
    links = [link.get("href") for link in page.get_element_by_id("failed").cssselect("a")]
    assert links == ["reports/fa/report.html", "reports/fb/report.html"]


def test_names_of_logs_are_escaped(fleet: Fleet) -> None:
    bad = replace(fleet, logs=tuple(replace(log, path="<script>x</script>") for log in fleet.logs))
    text = render_fleet_page(bad)
    assert "<script>x" not in text
    assert render_fleet_page(fleet) == render_fleet_page(fleet)


def test_pictures_of_a_thousand_units_are_readable(fleet: Fleet) -> None:
    """The height of pictures is limited, and odd units keep their names."""
    model = fleet.model()
    term = model["gyro_z", "N"]
    few = term.population.units
    many = tuple(replace(few[i % 24], unit=f"u{i:04}", odd=i == 7) for i in range(1000))
    crowd = replace(term, population=replace(term.population, units=many))
    large = replace(model, units=tuple(unit.unit for unit in many), terms=(crowd,))
    for figure in (units_figure(large, Sensor.GYROSCOPE), heat_figure(large)):
        assert figure.get_figheight() < 17
        (label,) = figure.axes[0].get_yticklabels()
        assert label.get_text() == "u0007"


@pytest.mark.filterwarnings("error")
def test_names_in_all_scripts_are_drawn(fleet: Fleet) -> None:
    """Missing fonts raise no warning, because the browser uses its own fonts."""
    model = replace(fleet.model(), name="\N{CJK UNIFIED IDEOGRAPH-4F20}\N{CJK UNIFIED IDEOGRAPH-611F} ΩЖ")
    pictures = list(fleet_pictures(replace(fleet, models=(replace(model, terms=model.terms[:2]),))))
    drawn = drawn_as(pictures[0].draw, ("png", "svg"))
    assert drawn["png"][:4] == b"\x89PNG"
    assert f">{model.name}, gyroscope: 24 units<" in drawn["svg"].decode()
    assert drawn_as(pictures[0].draw, ("png", "svg")) == drawn


def test_pictures_are_drawn(fleet: Fleet) -> None:
    """There is a panel per term and axis, and a cell per unit and term."""
    model = fleet.model()
    assert len(units_figure(model, Sensor.GYROSCOPE).axes) == 9
    heat = heat_figure(model).axes[0]
    assert heat.images[0].get_array().shape == (24, 18)  # type: ignore[union-attr]
    other = replace(model, name="BOLT-9")
    assert len(models_figure((model, other)).axes) == 18


def test_compared_models_are_drawn_in_one_unit(fleet: Fleet) -> None:
    """All units are inside the axis, although one bias is in µg and one in mg."""
    model = fleet.model()
    other = replace(model, name="BOLT-9", terms=tuple(_larger(term, 1000.0) for term in model.terms))
    axes = next(a for a in models_figure((model, other)).axes if a.get_title(loc="left") == "accel_x B")
    assert axes.get_xlabel() == "B in µg"
    low, high = axes.get_xlim()
    marked = [np.array(line.get_xdata(), float) for line in axes.lines if line.get_marker() != "None"]
    marks = np.concatenate(marked).tolist()
    assert len(marks) == 2 * len(model.units)
    assert all(low <= mark <= high for mark in marks)
    assert np.array(marks[len(model.units) :]) == pytest.approx(1000 * np.array(marks[: len(model.units)]))


def _larger(term: FleetTerm, factor: float) -> FleetTerm:
    """Return a term with coefficients multiplied by a factor."""
    found = term.population
    units = tuple(
        replace(
            unit, value=unit.value and factor * unit.value, low=factor * unit.low, high=factor * unit.high
        )
        for unit in found.units
    )
    middle = found.median
    median = replace(middle, value=factor * middle.value, low=factor * middle.low, high=factor * middle.high)
    low, high = found.prediction or (0.0, 0.0)
    tolerance = factor * (found.tolerance or 0.0)
    prediction = (factor * low, factor * high)
    return replace(
        term,
        population=replace(found, units=units, median=median, prediction=prediction, tolerance=tolerance),
    )


def test_two_models_are_compared_in_one_picture(fleet: Fleet, tmp_path: Path) -> None:
    """Every strip has one row per model, and the page contains the picture."""
    both = replace(fleet, models=(fleet.model(), replace(fleet.model(), name="BOLT-9")))
    names = [picture.name for picture in fleet_pictures(both)]
    assert names == [
        *(f"{name}-{model}" for model in ("ACME-6", "BOLT-9") for name in PICTURES),
        "models",
    ]
    strips = models_figure(both.models).axes
    assert len(strips) == 18
    assert [label.get_text() for label in strips[0].get_yticklabels()] == ["ACME-6", "BOLT-9"]
    small = replace(both, models=tuple(replace(m, terms=m.terms[:1]) for m in both.models))
    imucal.write_fleet(small, tmp_path, pictures=False)
    page = html.fromstring((tmp_path / "fleet.html").read_text(encoding="utf-8"))
    (picture,) = page.get_element_by_id("models").cssselect("figure img")
    assert ">BOLT-9<" in svg_of(picture)


#: The pictures of one model.
PICTURES = ("units-gyro", "units-accel", "heat")


def test_the_json_file_is_written_first(written: tuple[Path, ...]) -> None:
    assert [file.name for file in written] == ["fleet.json", "fleet.csv", "fleet.html"]
    assert json.loads(written[0].read_text(encoding="utf-8"))["schema"] == "imucal/fleet/1"


def test_a_failed_picture_does_not_prevent_the_others(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Document and caller are informed about missing pictures, and old ones are removed."""

    def broken(*_: object) -> None:
        raise ArithmeticError

    monkeypatch.setattr("imucal.fleet_report.pictures.heat_figure", broken)
    drawn = pictures.units_figure
    monkeypatch.setattr(
        "imucal.fleet_report.pictures.units_figure",
        lambda model, sensor: (broken if sensor is Sensor.GYROSCOPE else drawn)(model, sensor),
    )
    (tmp_path / "heat.png").write_bytes(b"of yesterday")
    texts: list[str] = []
    files = imucal.write_fleet(fleet, tmp_path, on_finding=lambda finding: texts.append(finding.text))
    assert [file.name for file in files] == ["fleet.json", "fleet.csv", "units-accel.png", "fleet.html"]
    assert not (tmp_path / "heat.png").exists()
    missing = ("units-gyro", "heat")
    assert [text.split(":")[0] for text in texts] == [f"{name}.png is missing" for name in missing]
    findings = json.loads((tmp_path / "fleet.json").read_text(encoding="utf-8"))["findings"]
    assert {finding["code"] for finding in findings} == {"not-drawn"}
    assert "The pictures are missing." in (tmp_path / "fleet.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("moved", range(3))
def test_an_interrupted_report_is_recognised_as_incomplete(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moved: int
) -> None:
    """``fleet.json`` is removed first and written last; the next report is complete."""
    # Without a model, the page has no pictures to draw.
    few = replace(fleet, models=())
    imucal.write_fleet(few, tmp_path, pictures=False)
    count = iter(range(100))

    def dying(self: Path, target: Path) -> None:
        if next(count) == moved:
            raise KeyboardInterrupt
        os.replace(self, target)  # noqa: PTH105 - what `Path.replace` does

    with monkeypatch.context() as context:
        context.setattr(Path, "replace", dying)
        with pytest.raises(KeyboardInterrupt):
            imucal.write_fleet(few, tmp_path, pictures=False)
    assert not (tmp_path / "fleet.json").exists()
    imucal.write_fleet(few, tmp_path, pictures=False)
    assert json.loads((tmp_path / "fleet.json").read_bytes())["logs"]


def test_concurrent_reports_in_one_folder_are_consistent(fleet: Fleet, tmp_path: Path) -> None:
    """All files are from the same call, whichever was the last."""
    few = replace(fleet, models=())
    each = [replace(few, version=f"0.0.{i}") for i in range(4)]
    with ThreadPoolExecutor(len(each)) as pool:
        list(pool.map(partial(imucal.write_fleet, out=tmp_path, pictures=False), each))
    version = json.loads((tmp_path / "fleet.json").read_bytes())["version"]
    assert f"imucal {version}<" in (tmp_path / "fleet.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Yield one browser."""
    with Browser() as session:
        yield session


def test_the_page_works_in_a_browser(browser: Browser, written: tuple[Path, ...]) -> None:
    """There are no errors; narrow screens only scroll vertically; paper is white and wide enough."""
    browser.open(written[-1].as_uri())
    drawn = "return [...document.images].map((image) => image.complete && image.naturalWidth > 300)"
    assert browser.run(drawn) == [True] * 3
    assert browser.run("return getComputedStyle(document.querySelector('td .si')).display") == "none"
    browser.run("document.querySelector('input[value=si]').click()")
    assert browser.run("return getComputedStyle(document.querySelector('td .sheet')).display") == "none"
    browser.run("document.querySelector('input[value=dark]').click()")
    paper = "return getComputedStyle(document.body).backgroundColor"
    assert browser.run(paper) == "rgb(18, 23, 29)"
    inside = "return document.documentElement.scrollWidth <= innerWidth"
    wide = (
        "return [...document.querySelectorAll('.scroll')].filter((s) => s.scrollWidth > s.clientWidth + 1)"
        ".map((s) => s.querySelector('table').className)"
    )
    size = "Emulation.setDeviceMetricsOverride"
    browser.devtools(size, width=390, height=800, deviceScaleFactor=1, mobile=False)
    assert browser.run(inside)
    assert browser.run(wide) == []
    # 186 mm at 96 px per inch.
    browser.devtools(size, width=703, height=1000, deviceScaleFactor=1, mobile=False)
    browser.devtools("Emulation.setEmulatedMedia", media="print")
    assert browser.run(paper) == "rgb(255, 255, 255)"
    assert browser.run(inside)
    # Pictures are as wide as the paper, and a table's header stays with its first row.
    style = "return getComputedStyle(document.querySelector('{}')).{}"
    assert browser.run(style.format(".picture img", "minWidth")) == "0px"
    assert browser.run(style.format("tbody tr", "breakBefore")) == "avoid"
    assert browser.run(style.format(".picture", "breakInside")) == "avoid"
    assert not [log for log in browser.logs("browser") if log["level"] == "SEVERE"]


def test_an_undetected_term_is_a_bound_in_all_outputs(tmp_path: Path) -> None:
    """Outputs are page, JSON, CSV, pictures and the median's export; the config uses the tolerance bound."""
    write_store(
        tmp_path, units=4, temperatures=(25.0,), special=False, failures=False, weak="", absent="y",
        names=("gyro_x", "gyro_y"),
    )  # fmt: skip
    fleet = imucal.load_fleet(tmp_path, unit_logs=False)
    term = fleet.model()["gyro_y", "K"]
    assert term.population.bounded
    document = fleet_document(fleet)
    jsonschema.validate(document, SCHEMA)
    (row,) = [
        t
        for m in document["models"]  # type: ignore[attr-defined]
        for t in m["terms"]
        if (t["sensor"], t["axis"], t["term"]) == ("gyroscope", "y", "K")
    ]
    assert row["bounded"]
    assert row["median"]["value"] is None
    assert row["spread"] is None
    rows = csv.DictReader(io.StringIO(fleet_csv(fleet)))
    cells = [row for row in rows if (row["sensor"], row["axis"], row["term"]) == ("gyroscope", "y", "K")]
    assert {(row["bounded"], row["median"]) for row in cells} == {("1", "")}
    page = render_fleet_page(fleet)
    assert "of the units only bound this term" in page
    assert all(drawn_as(picture.draw, ["svg"])["svg"] for picture in fleet_pictures(fleet))
    report = imucal.fleet_as_report(fleet, value="median")
    (axis,) = [axis for axis in report.axes if axis.name == "gyro_y"]
    assert axis.fit["K"].status == "bounded"
    (axis,) = [axis for axis in imucal.fleet_as_report(fleet).axes if axis.name == "gyro_y"]
    assert axis.fit["K"].value == term.population.tolerance


def test_tests_of_units_are_adjusted_for_all_units_and_terms(tmp_path: Path) -> None:
    """Only the last of six units differs; a rare result in one of many tests is not reported."""
    from imucal.multiple_tests import holm

    write_store(
        tmp_path, units=6, temperatures=(25.0, 25.0), special=False, failures=False, weak="", bins=6,
        names=("gyro_x",),
    )  # fmt: skip
    fleet = imucal.load_fleet(tmp_path)
    tests = [test for term in fleet.model().terms for test in term.unit_logs]
    assert len(tests) == 18
    p_values = holm([test.p_value for test in tests])
    assert [test.differs for test in tests] == [p <= 0.05 for p in p_values]
    assert {test.unit for test in tests if test.differs} == {"u05"}
    assert "u05 by" in render_fleet_page(fleet)
