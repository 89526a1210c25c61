"""Tests of the page of a fleet in a browser: errors, units, colours, narrow screens and paper."""

from collections.abc import Iterator
from pathlib import Path

import pytest

import imucal
from imucal.fleet.files import write_fleet
from imucal.fleet.store import RunFile
from tests.fleet.simulated_store import SETTINGS, asked, write_store
from tests.report.browser import Browser

#: A long name of a unit and of a sensor model, which is also in the paths of its logs.
LONG = "SN-2026-11-30-0123456789-ABCDEF-with-a-long-serial-number"
#: Whether nothing is wider than the screen.
INSIDE = "return document.documentElement.scrollWidth <= innerWidth"
#: Class names of the tables that are wider than their frames.
WIDE = (
    "return [...document.querySelectorAll('.scroll')].filter((s) => s.scrollWidth > s.clientWidth + 1)"
    ".map((s) => s.querySelector('table').className)"
)
PAPER = "return getComputedStyle(document.body).backgroundColor"
SIZE = "Emulation.setDeviceMetricsOverride"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Yield one browser."""
    with Browser() as session:
        yield session


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return pages of a fleet of one model, of two models with long names, and of logs without units."""
    folder = tmp_path_factory.mktemp("pages")
    write_store(folder / "one", units=9)
    names = ("gyro_x", "gyro_y", "gyro_z")
    own = [log.path for log in imucal.load_fleet(folder / "one").logs if log.unit in {"u02", "u07"}]
    # The newest labels of a log count.
    with RunFile(folder / "one", SETTINGS, [asked(path, {"unit": f"{LONG}{path[-20:-15]}"}) for path in own]):
        pass
    write_store(folder / "two", units=6, models=("ACME-6", LONG), temperatures=(25.0,), names=names)
    write_store(folder / "loose", units=2, labelled=False, models=(LONG,))
    return {
        name: write_fleet(imucal.load_fleet(folder / name), pictures=False)[-1]
        for name in ("one", "two", "loose")
    }


@pytest.mark.parametrize("name", ["one", "two", "loose"])
def test_narrow_screens_and_paper_scroll_only_vertically(
    browser: Browser, pages: dict[str, Path], name: str
) -> None:
    """Tables become cards, pictures scroll by themselves, and paper is white even after a dark screen."""
    browser.devtools("Emulation.setEmulatedMedia", media="screen")
    browser.open(pages[name].as_uri())
    browser.run("document.querySelector('input[value=dark]').click()")
    assert browser.run(PAPER) == "rgb(18, 23, 29)"
    for width in (1280, 900, 390, 320):
        browser.devtools(SIZE, width=width, height=800, deviceScaleFactor=1, mobile=False)
        assert browser.run(INSIDE), width
        assert browser.run(WIDE) == [], width
    # 186 mm at 96 px per inch.
    browser.devtools(SIZE, width=703, height=1000, deviceScaleFactor=1, mobile=False)
    browser.devtools("Emulation.setEmulatedMedia", media="print")
    assert browser.run(PAPER) == "rgb(255, 255, 255)"
    assert browser.run(INSIDE)
    assert browser.run(WIDE) == []
    browser.devtools("Emulation.setEmulatedMedia", media="screen")
    assert not [log for log in browser.logs("browser") if log["level"] == "SEVERE"]


def test_units_and_pictures_are_shown(browser: Browser, pages: dict[str, Path]) -> None:
    """All pictures are drawn, and one of both units of a number is visible."""
    browser.devtools(SIZE, width=1280, height=1000, deviceScaleFactor=1, mobile=False)
    browser.devtools("Emulation.setEmulatedMedia", media="screen")
    browser.open(pages["one"].as_uri())
    drawn = "return [...document.images].map((image) => image.complete && image.naturalWidth > 300)"
    assert browser.run(drawn) == [True] * 2
    shown = (
        "return ['.sheet', '.si'].map((unit) =>"
        " getComputedStyle(document.querySelector('table.limits td ' + unit)).display !== 'none')"
    )
    assert browser.run(shown) == [True, False]
    browser.run("document.querySelector('input[value=si]').click()")
    assert browser.run(shown) == [False, True]
    # On paper, pictures are as wide as the page, and a table's header stays with its first row.
    browser.devtools("Emulation.setEmulatedMedia", media="print")
    style = "return getComputedStyle(document.querySelector('{}')).{}"
    assert browser.run(style.format(".picture img", "maxWidth")) == "100%"
    assert browser.run(style.format("tbody tr", "breakBefore")) == "avoid"
    assert browser.run(style.format(".picture", "breakInside")) == "avoid"
