"""Tests of the report of a fleet: document, table, page, pictures and the display in notebooks."""

import base64
import csv
import io
import json
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jsonschema
import pytest
from lxml import html

import imucal
from imucal.fitting.noise_fit import Interval
from imucal.fleet import pictures
from imucal.fleet.files import SCHEMA, fleet_csv, fleet_document, write_fleet
from imucal.fleet.page import (
    alone,
    group_texts,
    p_text,
    percent,
    render_fleet_page,
    text_of,
    unit_verdicts,
    verdict,
)
from imucal.fleet.pictures import drawn_as, fleet_pictures, labelled_ticks, sorted_units, units_figure
from imucal.fleet.population import population
from imucal.fleet.summary import Fleet, FleetTerm, SensorModel
from imucal.fleet.values import LogValue
from imucal.recording import Sensor
from tests.fleet.simulated_store import write_store

if TYPE_CHECKING:
    from imucal.findings import Finding

_SCHEMA = json.loads(
    (resources.files("imucal.fleet") / "schema" / "fleet-1.schema.json").read_text(encoding="utf-8")
)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Fleet:
    """Return a fleet of 24 units: u07 is odd, logs of u02 differ, five logs failed.

    Unit u05 is odd in gyro_y K, but not among all units and terms.
    """
    fleet = imucal.load_fleet(write_store(tmp_path_factory.mktemp("fleets") / "fleet"))
    (model,) = fleet.models
    return replace(fleet, models=(replace(model, terms=tuple(map(_with_chance, model.terms))),))


def _with_chance(term: FleetTerm) -> FleetTerm:
    """Return a term in which u05 is odd by chance, if it is gyro_y K."""
    if (term.name, term.term) != ("gyro_y", "K"):
        return term
    units = tuple(
        replace(unit, odd=True, p_odd=0.04) if unit.unit == "u05" else unit for unit in term.population.units
    )
    return replace(term, population=replace(term.population, units=units))


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Fleet:
    """Return a fleet of six units with one axis, whose K is only bounded, and no failures."""
    place = tmp_path_factory.mktemp("fleets") / "small"
    write_store(place, units=6, special=False, failures=False, weak="", absent="z", names=("gyro_z",))
    return imucal.load_fleet(place)


@pytest.fixture(scope="module")
def two_groups(small: Fleet) -> SensorModel:
    """Return a model of twelve units; in N and B, the last four are 1.8 times larger than the others."""
    logs = [
        LogValue(unit=f"u{unit:02}", value=value, low=0.99 * value, high=1.01 * value)
        for unit in range(12)
        for value in [1e-4 * (1.8 if unit >= 8 else 1.0) * (1 + 0.01 * (unit % 4))]
    ]
    found = population(logs)
    model = small.model()
    terms = tuple(replace(t, logs=tuple(logs), population=found) for t in model.terms if t.term in "NB")
    return replace(model, units=tuple(unit.unit for unit in found.units), terms=terms)


@pytest.fixture(scope="module")
def page(fleet: Fleet, tmp_path_factory: pytest.TempPathFactory) -> html.HtmlElement:
    """Return the page of the fleet with its pictures."""
    files = write_fleet(fleet, tmp_path_factory.mktemp("page"), pictures=False)
    assert [file.name for file in files] == ["fleet.json", "fleet.csv", "fleet.html"]
    assert json.loads(files[0].read_text(encoding="utf-8")) == json.loads(json.dumps(fleet_document(fleet)))
    return html.fromstring(files[-1].read_text(encoding="utf-8"))


def section(page: html.HtmlElement, name: str) -> str:
    """Return the text of a section with single blanks."""
    return " ".join(page.get_element_by_id(name).text_content().split())


def of(fleet: Fleet, model: SensorModel) -> Fleet:
    """Return the fleet with this model alone."""
    return replace(fleet, models=(model,))


def test_the_document_matches_its_schema(fleet: Fleet, small: Fleet, two_groups: SensorModel) -> None:
    """The schema names and describes every key; all of them are required."""
    for each in (fleet, small, of(small, two_groups), replace(fleet, models=(), loose=fleet.logs)):
        jsonschema.validate(fleet_document(each), _SCHEMA)
    document = fleet_document(fleet)
    assert document["schema"] == SCHEMA
    assert document["verdict"] == dict(zip(("grade", "text"), verdict(fleet), strict=True))
    assert document["logs"] == {"asked": 101, "done": 101, "counted": 96}
    terms = {(t["sensor"], t["axis"], t["term"]): t for t in document["models"][0]["terms"]}  # type: ignore[index]
    term = terms["gyroscope", "z", "N"]
    assert term["median"]["value"] == fleet.model()["gyro_z", "N"].population.median.value
    assert term["tolerance_without_odd"] == fleet.model()["gyro_z", "N"].without_odd
    units = [(key[1:], unit) for key, each in terms.items() for unit in each["units"]]
    assert [(key, u["unit"]) for key, u in units if u["odd_overall"]] == [(("z", "N"), "u07")]
    assert [(key, u["unit"]) for key, u in units if u["logs_differ"]] == [(("x", "N"), "u02")]
    assert sum(u["odd"] for _, u in units) > 1
    for part in _objects(_SCHEMA):
        assert part["required"] == [*part["properties"]]
        assert part["additionalProperties"] is False
        assert all(part["description"] for part in part["properties"].values() if "$ref" not in part)


def _objects(schema: Any) -> list[Any]:  # noqa: ANN401 - JSON
    """Return the parts of a schema that describe objects."""
    if isinstance(schema, list):
        return [part for value in schema for part in _objects(value)]
    if not isinstance(schema, dict):
        return []
    return [*([schema] if "additionalProperties" in schema else []), *_objects([*schema.values()])]


def test_the_table_has_one_row_per_unit_and_term(fleet: Fleet, small: Fleet) -> None:
    """Each row also contains the numbers of the population; a bounded median has none."""
    rows = list(csv.DictReader(io.StringIO(fleet_csv(fleet))))
    assert len(rows) == 24 * 18
    (odd,) = [row for row in rows if row["odd"] == "1" and row["term"] == "N"]
    assert (odd["unit"], odd["sensor"], odd["axis"]) == ("u07", "gyroscope", "z")
    assert float(odd["tolerance"]) == fleet.model()["gyro_z", "N"].population.tolerance
    assert [row["unit"] for row in rows if row["logs_differ"] == "1"] == ["u02"]
    cells = [row for row in csv.DictReader(io.StringIO(fleet_csv(small))) if row["term"] == "K"]
    assert {(row["bounded"], row["median"], row["value"]) for row in cells} == {("1", "", "")}


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
def test_labels_in_a_table_are_escaped(small: Fleet, label: str, cell: str) -> None:
    """Neither a spreadsheet runs their formulas nor a terminal their codes; other cells are unchanged."""
    rows = list(csv.DictReader(io.StringIO(fleet_csv(of(small, replace(small.model(), name=label))))))
    assert {row["model"] for row in rows} == {cell}
    assert {row["unit"] for row in rows} == {f"u{number:02}" for number in range(6)}


def test_hostile_labels_are_escaped_on_the_page(fleet: Fleet) -> None:
    """They are names of models, units and logs."""
    script = "<script>x</script>"
    model = fleet.model()
    terms = tuple(
        replace(
            term,
            sure=(script,),
            differing=(script,),
            population=replace(
                term.population, units=tuple(replace(u, unit=script, odd=True) for u in term.population.units)
            ),
        )
        for term in model.terms
    )
    bad = replace(
        of(fleet, replace(model, name=script, units=(script,), logs=(), terms=terms)),
        logs=tuple(replace(log, path=script) for log in fleet.logs),
        loose=tuple(replace(log, path=script) for log in fleet.loose),
    )
    text = render_fleet_page(bad, {script: [(script, b"")]})
    assert "<script>x" not in text
    assert text.count("&lt;script&gt;x") > 10
    assert "<script>x" not in bad._repr_html_()


def test_units_are_judged_by_all_terms(fleet: Fleet) -> None:
    """Units unlike the others come first, and reasons contain ratio and probability."""
    found = {one.unit: one for one in unit_verdicts(fleet.model())}
    assert next(iter(found)) == "u07"
    assert (found["u07"].grade, found["u07"].verdict) == ("not-noise", "unlike the others")
    assert found["u07"].reasons[0].startswith("gyro_z N: 1.9 × the median unit (p < 0.0001)")
    assert (found["u02"].grade, found["u02"].reasons) == ("check", ("its logs differ in gyro_x N",))
    assert found["u05"].verdict == "far off in one of many terms, perhaps by chance"
    assert {one.verdict for one in found.values() if one.grade == "good"} == {"like the others"}
    assert {one.logs for one in found.values()} == {4}
    assert "; far off in one of many terms, perhaps by chance: u05 (gyro_y K)" in verdict(fleet)[1]


def test_two_groups_are_named_once_for_all_their_terms(small: Fleet, two_groups: SensorModel) -> None:
    """The units of the group of fewer units are marked, and the others are like the others."""
    (text,) = group_texts(two_groups)
    assert text.startswith("The units of ACME-6 form two groups in gyro_z N, gyro_z B: u00, u01, ")
    assert "; and larger, u08, u09, u10, u11. " in text
    found = unit_verdicts(two_groups)
    assert [one.unit for one in found[:4]] == ["u08", "u09", "u10", "u11"]
    assert {one.verdict for one in found[:4]} == {"of the group of fewer units"}
    assert {one.reasons for one in found[:4]} == {
        ("it is in the group of fewer units in gyro_z N, gyro_z B",)
    }
    assert {one.grade for one in found[4:]} == {"good"}
    few = two_groups.units[:3]
    swapped = replace(
        two_groups,
        terms=tuple(
            replace(term, population=replace(term.population, groups=(few, two_groups.units[3:])))
            for term in two_groups.terms
        ),
    )
    assert {
        one.unit for one in unit_verdicts(swapped) if one.verdict == "of the group of fewer units"
    } == set(few)
    both = of(small, two_groups)
    assert verdict(both) == ("check", "The units form two groups in gyro_z N, gyro_z B.")
    units = html.fromstring(render_fleet_page(both)).get_element_by_id("units")
    assert [item.text_content() for item in units.cssselect(".findings li")] == [text]
    assert "8 units of ACME-6 are like the others: u00, u01" in units.text_content()


def test_the_page_lists_units_and_limits(fleet: Fleet, page: html.HtmlElement) -> None:
    """The bound without an odd unit is below the bound."""
    assert [h2.text for h2 in page.cssselect("section h2")] == [
        "Is a unit unlike the others?",
        "Limits for the next unit",
        "Units of ACME-6",
        "Logs that do not count",
        "Glossary",
    ]
    assert page.cssselect(".lead")[0].text_content() == "ACME-6: 24 units, 96 logs that count, 200 Hz"
    heads = [row.cssselect("th")[0].text_content() for row in page.cssselect("table.units tbody tr")]
    assert heads == ["u07", "u02", "u05"]
    assert "21 units of ACME-6 are like the others: u00, u01, u03" in section(page, "units")
    rows = page.cssselect("table.limits tbody tr")
    assert [row.cssselect("th b")[0].text for row in rows] == [
        f"{term.name} {term.term}" for term in fleet.model().terms
    ]
    term = fleet.model()["gyro_z", "N"]
    (cell,) = [c for c in page.cssselect("table.limits td small") if "without u07" in c.text_content()]
    assert cell.text_content() == f"without u07: {alone(term, term.without_odd or 0.0).striptags()}"
    band = rows[1].cssselect("td[data-label^='next unit'] .sheet")[0].text_content()
    low, to, high, unit = band.split()
    assert (to, unit) == ("to", "deg/√h")
    assert float(low) < float(high)


def test_the_page_needs_no_network_and_is_accessible(page: html.HtmlElement) -> None:
    """Links have targets, ids are unique, and tables have captions and scopes."""
    assert not page.cssselect("link[href^=http], script[src], img[src^=http], iframe")
    images = page.cssselect("figure img[alt]")
    assert [image.get("alt") for image in images] == [
        f"ACME-6, {sensor}: units sorted, each with its 95 % interval"
        for sensor in ("gyroscope", "accelerometer")
    ]
    svg = base64.b64decode((images[0].get("src") or "").removeprefix("data:image/svg+xml;base64,")).decode()
    assert all(word in svg for word in (">u07<", ">odd unit<", ">95/95<", ">gyro_z N<"))
    assert len(page.cssselect("h1")) == 1
    ids = [element.get("id") for element in page.cssselect("[id]")]
    assert len(ids) == len(set(ids))
    assert all((link.get("href") or "")[1:] in ids for link in page.cssselect("nav a"))
    assert {part.get("aria-labelledby") for part in page.cssselect("section")} <= set(ids)
    for table in page.cssselect("table"):
        assert table.cssselect("caption")
        assert all(th.get("scope") for th in table.cssselect("th"))


def test_failed_logs_are_listed_with_their_reports(fleet: Fleet, page: html.HtmlElement) -> None:
    """The first five of a kind are visible, because printed pages cannot unfold lists."""
    failed = page.get_element_by_id("failed")
    assert [link.get("href") for link in failed.cssselect("a")] == [
        "reports/fa/report.html",
        "reports/fb/report.html",
    ]
    log = replace(fleet.logs[0], status="unreadable", left_out="no footer")
    many = replace(fleet, logs=tuple(replace(log, path=f"bad{i}.mcap") for i in range(7)))
    (block,) = html.fromstring(render_fleet_page(many)).cssselect("#failed .findings")
    assert [code.text for code in block.cssselect("details code")] == ["bad5.mcap", "bad6.mcap"]
    assert len(block.cssselect("code")) == 7
    assert block.cssselect("summary")[0].text == "2 more"


def test_pages_of_few_data_explain_themselves(fleet: Fleet, tmp_path: Path) -> None:
    """They are two units, logs without a unit, and logs that are not finished."""
    write_store(tmp_path / "two", units=2, failures=False, special=False, names=("gyro_x",))
    page = html.fromstring(render_fleet_page(imucal.load_fleet(tmp_path / "two")))
    assert "ACME-6: 2 units. An odd unit is found among 4 or more units." in section(page, "units")
    assert "like the others:" not in section(page, "units")
    assert "a spread between units and a bound need at least 3 units" in section(page, "limits")
    assert {row.cssselect("td")[1].text_content() for row in page.cssselect("table.limits tbody tr")} == {"–"}
    loose = replace(fleet, models=(), loose=fleet.logs[:2], labels="{unit}.mcap")
    page = html.fromstring(render_fleet_page(loose))
    assert "2 logs have no unit label and do not count" in section(page, "loose")
    assert page.cssselect("#loose pre")[0].text_content().endswith("--labels '{unit}.mcap'")
    assert len(page.cssselect("#loose li")) == 2
    assert "1 log has no unit label and does not" in render_fleet_page(replace(loose, loose=fleet.logs[:1]))
    assert "3 of 104 logs are not finished" in render_fleet_page(replace(fleet, asked=104))


def test_bounded_terms_are_drawn_and_listed_as_bounds(small: Fleet) -> None:
    """A model without a name and with one axis needs no column for others."""
    unnamed = of(small, replace(small.model(), name=""))
    page = html.fromstring(render_fleet_page(unnamed))
    *_, k = page.cssselect("table.limits tbody tr")
    next_unit, _, median, between, _ = (cell.text_content() for cell in k.cssselect("td"))
    assert next_unit.startswith("below ")
    assert median.startswith("< ")
    assert between == "–"
    assert page.cssselect(".lead")[0].text_content() == "6 units, 24 logs that count, 200 Hz"
    assert page.cssselect("#pictures-0 h2")[0].text == "Units in pictures"
    assert "The pictures are missing." in section(page, "pictures-0")
    axes = units_figure(unnamed.models[0], Sensor.GYROSCOPE).axes
    assert len(axes) == 3
    assert [line.get_marker() for line in axes[2].lines if len(line.get_ydata()) == 6] == ["<"]  # type: ignore[arg-type]


def test_pictures_mark_odd_units(fleet: Fleet) -> None:
    """They keep their names among a thousand units, and long names leave space for the panels."""
    model = fleet.model()
    assert len(units_figure(model, Sensor.GYROSCOPE).axes) == 9
    term = model["gyro_z", "N"]
    few = term.population.units
    many = tuple(replace(few[i % 24], unit=f"u{i:04}", odd=i == 7) for i in range(1000))
    crowd = replace(term, population=replace(term.population, units=many))
    large = replace(model, units=tuple(unit.unit for unit in many), terms=(crowd,))
    figure = units_figure(large, Sensor.GYROSCOPE)
    assert figure.get_figheight() < 17
    (label,) = figure.axes[0].get_yticklabels()
    assert label.get_text() == "u0007"
    assert "D" in {line.get_marker() for line in figure.axes[0].lines}
    long = tuple(replace(unit, unit=f"SN-{unit.unit:0>60}") for unit in few)
    crowd = replace(term, population=replace(term.population, units=long))
    figure = units_figure(replace(model, terms=(crowd,)), Sensor.GYROSCOPE)
    labels = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    assert sorted(labels) == [f"SN-0000000…000000u{i:02}" for i in range(24)]
    values = [unit.value or unit.high for unit in sorted_units(model["gyro_x", "B"])]
    assert values == sorted(values, reverse=True)


def test_texts_of_pictures_are_inside_their_frames(small: Fleet, fleet: Fleet) -> None:
    """Titles of narrow and of tall pictures fit, and the title is above the panels."""
    model = fleet.model()
    tall = replace(model, units=model.units * 9, terms=model.terms[:9])
    for figure in (units_figure(small.model(), Sensor.GYROSCOPE), units_figure(tall, Sensor.GYROSCOPE)):
        figure.draw_without_rendering()
        (title, *_), frame = figure.texts, figure.bbox
        panels = [axes.get_tightbbox() for axes in figure.axes]
        boxes = [title.get_window_extent(), *(key.get_window_extent() for key in figure.legends)]
        assert all(frame.x0 <= box.x0 and box.x1 <= frame.x1 + 1 and frame.y0 <= box.y0 for box in boxes)
        assert boxes[0].y1 <= frame.y1
        assert boxes[0].y0 >= max(panel.y1 for panel in panels if panel)
        assert figure.legends[0].texts[-1].get_text() == "tolerance bound"


@pytest.mark.filterwarnings("error")
def test_names_in_all_scripts_are_drawn(small: Fleet) -> None:
    """Missing fonts raise no warning, because the browser uses its own fonts."""
    model = replace(small.model(), name="\N{CJK UNIFIED IDEOGRAPH-4F20}\N{CJK UNIFIED IDEOGRAPH-611F} ΩЖ")
    (picture,) = fleet_pictures(of(small, model))
    assert f">{model.name}, gyroscope: 6 units<" in drawn_as(picture.draw, ("png", "svg"))["svg"].decode()


def test_pictures_of_several_models_have_their_names(small: Fleet) -> None:
    one = small.model()
    names = ("ACME-6", "B/9 <x>")
    both = replace(small, models=tuple(replace(one, name=name) for name in names))
    assert [picture.name for picture in fleet_pictures(both)] == ["units-gyro-ACME-6", "units-gyro-B-9--x-"]
    page = html.fromstring(render_fleet_page(both))
    assert [h2.text for h2 in page.cssselect("section h2")][2:4] == ["Units of ACME-6", "Units of B/9 <x>"]
    assert verdict(replace(both, models=tuple(replace(m, units=("u",)) for m in both.models)))[1].startswith(
        "ACME-6, B/9 <x>: too few units"
    )


def test_a_report_has_the_same_bytes_every_time(small: Fleet, tmp_path: Path) -> None:
    one, other = (write_fleet(small, tmp_path / name) for name in "ab")
    assert [file.name for file in one] == ["fleet.json", "fleet.csv", "units-gyro.png", "fleet.html"]
    assert [file.read_bytes() for file in one] == [file.read_bytes() for file in other]


def test_a_failed_picture_does_not_prevent_the_others(
    fleet: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The caller is informed about missing pictures, and old ones are removed."""
    drawn = pictures.units_figure

    def units(model: SensorModel, sensor: Sensor) -> object:
        if sensor is Sensor.GYROSCOPE:
            raise ArithmeticError
        return drawn(replace(model, terms=model.terms[-1:]), sensor)

    monkeypatch.setattr(pictures, "units_figure", units)
    (tmp_path / "units-gyro.png").write_bytes(b"of yesterday")
    found: list[Finding] = []
    files = write_fleet(fleet, tmp_path, on_finding=found.append)
    assert [file.name for file in files] == ["fleet.json", "fleet.csv", "units-accel.png", "fleet.html"]
    assert not (tmp_path / "units-gyro.png").exists()
    assert [(one.code, one.text.split(":")[0]) for one in found] == [
        ("not-drawn", "units-gyro.png is missing")
    ]
    page = html.fromstring(files[-1].read_text(encoding="utf-8"))
    assert len(page.cssselect("#pictures-0 img")) == 1


def test_a_failed_page_is_removed_and_reported(
    small: Fleet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All other files are complete."""
    write_fleet(small, tmp_path, pictures=False)
    monkeypatch.setattr("imucal.fleet.files.render_fleet_page", lambda *_: 1 / 0)
    found: list[Finding] = []
    files = write_fleet(small, tmp_path, pictures=False, on_finding=found.append)
    assert [file.name for file in files] == ["fleet.json", "fleet.csv"]
    assert not (tmp_path / "fleet.html").exists()
    assert [one.text.split(":")[0] for one in found] == ["fleet.html is missing"]


def test_a_fleet_is_displayed_in_notebooks(fleet: Fleet) -> None:
    """The table equals that of the page, and the text has at most twelve lines."""
    table = html.fromstring(fleet._repr_html_()).cssselect("table.limits")
    assert len(table[0].cssselect("tbody tr")) == 18
    frame = fleet.to_frame()
    assert frame.height == 18
    row = frame.row(2, named=True)
    assert (row["axis"], row["term"], row["units"], row["logs"]) == ("gyro_z", "N", 24, 96)
    assert row["tolerance"] == fleet.model()["gyro_z", "N"].population.tolerance
    many = replace(fleet, models=tuple(replace(fleet.model(), name=f"m{i}") for i in range(12)))
    lines = text_of(many).splitlines()
    assert (len(lines), lines[-1]) == (11, "and 3 more sensor models")


@pytest.mark.parametrize(
    ("p", "text"), [(0.0046, "p = 0.0046"), (1e-4, "p = 0.0001"), (1.4e-7, "p < 0.0001"), (0.0, "p < 0.0001")]
)
def test_a_p_value_is_never_printed_as_zero(p: float, text: str) -> None:
    """Tiny values such as 1e-58 are printed as an upper limit."""
    assert p_text(p) == text


@pytest.mark.parametrize(
    ("low", "high", "last"), [(4000.0, 12500.0, "12000"), (400.0, 1.2e4, "10000"), (2e-5, 9e-5, "8")]
)
def test_ticks_have_one_notation(low: float, high: float, last: str) -> None:
    """Labels such as 8000 and 10⁴ are not mixed."""
    places, labels, power = labelled_ticks(low, high)
    assert labels[-1] == last
    assert not any("⁰" <= c <= "⁹" or c in "²³×" for label in labels for c in label)
    factor = {"": 1.0, "10⁻⁵ ": 1e-5}[power]
    assert [float(label) * factor for label in labels] == pytest.approx(places)


def test_spreads_are_percentages() -> None:
    """Large ones have no exponent."""
    assert percent(Interval(value=0.0618, low=0.0, high=12.3)) == "6.2 [0, 1230]\N{NO-BREAK SPACE}%"


def test_the_name_of_a_model_is_not_capitalised(fleet: Fleet) -> None:
    """A sentence may begin with the name."""
    model = fleet.model()
    both = replace(fleet, models=(replace(model, name="acme-6"), replace(model, name="bolt-9")))
    assert verdict(both)[1].startswith("acme-6: odd unit u07 (gyro_z N)")
