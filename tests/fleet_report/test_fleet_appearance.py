"""Tests of the appearance of a fleet's page and pictures: units, texts, ticks, empty columns and print."""

from dataclasses import replace

import pytest
from lxml import html

import imucal
from imucal import Fleet
from imucal.fleet_report.pages import p_text, price_text, render_fleet_page, verdict
from imucal.fleet_report.pictures import (
    heat_figure,
    labelled_ticks,
    models_figure,
    units_figure,
)
from imucal.fleet_report.summary import FleetLog
from imucal.recording import Sensor
from tests.fleet_report.simulated_store import write_store


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Fleet:
    """Return a fleet of eight units; u07 is odd."""
    place = tmp_path_factory.mktemp("fleets") / "fleet"
    write_store(place, units=8, weak="", failures=False, names=("gyro_x", "gyro_z"))
    return imucal.load_fleet(place, unit_logs=False)


@pytest.fixture(scope="module")
def one_axis(fleet: Fleet) -> Fleet:
    """Return the fleet with gyro_z only and without the model's name."""
    model = fleet.model()
    terms = tuple(term for term in model.terms if term.name == "gyro_z")
    return replace(fleet, models=(replace(model, name="", terms=terms),))


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


def test_the_name_of_a_model_is_not_capitalised(fleet: Fleet) -> None:
    """A sentence may begin with the name."""
    model = fleet.model()
    both = replace(fleet, models=(replace(model, name="acme-6"), replace(model, name="bolt-9")))
    assert verdict(fleet)[1].startswith("Odd unit u07 (gyro_z N)")
    assert verdict(both)[1].startswith("acme-6: odd unit u07 (gyro_z N)")


def test_a_fleet_of_one_axis_has_one_column(one_axis: Fleet) -> None:
    """The page has no columns for missing axes and no empty model name."""
    page = html.fromstring(render_fleet_page(one_axis))
    assert [head.text for head in page.cssselect("table.config thead th")] == ["z"]
    units = page.get_element_by_id("units-0")
    assert units.cssselect("h2")[0].text == "Units"
    assert page.cssselect(".lead")[0].text_content() == "8 units, 32 logs that count, 200 Hz"


def test_bands_and_prices_are_short(fleet: Fleet) -> None:
    """A band has its unit once, and each number of units appears once."""
    term = fleet.model()["gyro_x", "N"]
    (now, excess), *_ = term.price
    assert price_text(term).startswith(f"{excess:.2f}\N{NO-BREAK SPACE}× with {now}, ")
    page = html.fromstring(render_fleet_page(fleet))
    cells = page.cssselect("#numbers tbody tr")[0].cssselect("td")
    band = next(cell for cell in cells if cell.get("data-label") == "next unit")
    assert band.cssselect(".sheet")[0].text_content().count("deg/√h") == 1
    low, to, high, _ = band.cssselect(".sheet")[0].text_content().split()
    assert to == "to"
    assert float(low) < float(high)


def test_the_first_failures_are_visible(fleet: Fleet) -> None:
    """Printed pages cannot unfold lists."""
    log = fleet.logs[0]
    failed = tuple(_failed(log, f"bad{i}.mcap") for i in range(7))
    page = html.fromstring(render_fleet_page(replace(fleet, logs=fleet.logs + failed)))
    (block,) = page.cssselect("#failed .findings")
    folded = [code.text for code in block.cssselect("details code")]
    assert folded == ["bad5.mcap", "bad6.mcap"]
    assert len(block.cssselect("code")) == 7
    assert block.cssselect("summary")[0].text == "2 more"


def _failed(log: FleetLog, path: str) -> FleetLog:
    return replace(log, path=path, status="unreadable", reason="no footer", left_out="no footer")


def test_pictures_have_all_text_inside_their_frames(one_axis: Fleet) -> None:
    """Titles of narrow pictures fit too, and every picture has a legend."""
    model = one_axis.models[0]
    heat = heat_figure(model)
    both = (model, replace(model, name="BOLT-9"))
    for figure in (heat, units_figure(model, Sensor.GYROSCOPE), models_figure(both)):
        figure.draw_without_rendering()
        frame = figure.bbox
        texts = [*figure.texts, *(text for axes in figure.axes for text in (axes.title, axes._left_title))]  # type: ignore[attr-defined]
        boxes = [text.get_window_extent() for text in texts if text.get_text()]
        boxes += [key.get_window_extent() for key in figure.legends]
        assert all(frame.x0 <= box.x0 and box.x1 <= frame.x1 + 1 and frame.y0 <= box.y0 for box in boxes)
    assert heat.axes[0].patch.get_hatch()
    assert [text.get_text() for text in units_figure(model, Sensor.GYROSCOPE).legends[0].texts][-1] == (
        "tolerance bound"
    )
