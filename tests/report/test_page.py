"""The HTML page is valid, readable without scripts, and works in a real browser."""

import base64
import itertools
import json
import re
import zlib
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from lxml import html

from imucal.allan.dct import Spectrum
from imucal.clock import Gap
from imucal.findings import Finding
from imucal.fitting.noise_fit import Candidate, Line
from imucal.prediction import filter_numbers
from imucal.recording import Sensor
from imucal.report.exports import TARGETS
from imucal.report.figure_curves import estimate_text
from imucal.report.numbers import scientific, sheet_units, with_interval
from imucal.report.page import (
    axis_section,
    findings_section,
    method_section,
    render_page,
    summary_section,
)
from imucal.report.plot_data import page_data, standing_out
from imucal.report.result import AxisReport, Overview, Report
from tests.report.browser import Browser
from tests.report.pages import consumer_page, small_page
from tests.report.synthetic import consumer_report, shortest_report, small_report

_CSS = Path(__file__).resolve().parents[2] / "imucal" / "report" / "templates" / "frame.css"


@pytest.fixture(scope="module")
def page() -> html.HtmlElement:
    """Return the parsed page of a report with all features."""
    return html.document_fromstring(consumer_page())


def test_the_page_loads_nothing_from_other_places(page: html.HtmlElement) -> None:
    """Every link points into the page, and the content policy forbids others."""
    links = [link for _, _, link, _ in page.iterlinks()]
    assert all(link.startswith(("#", "data:")) for link in links)
    policy = page.xpath("//meta[@http-equiv='Content-Security-Policy']/@content")[0]
    assert policy.startswith("default-src 'none'")


def test_a_page_is_small_enough_to_mail() -> None:
    """The plot script has half a megabyte; eight pictures and the data of six axes add one more."""
    report = consumer_report()
    assert len(page_data(report)) < 200_000
    assert len(consumer_page()) < 1_600_000


def test_the_plot_script_is_the_published_plotly() -> None:
    """The licence of Plotly is included."""
    folder = files("imucal.report").joinpath("plotly")
    script = zlib.decompress(folder.joinpath("plotly-basic.min.js.zlib").read_bytes()).decode()
    assert script.startswith("/**\n* plotly.js (basic - minified) v4")
    assert "Plotly Technologies Inc." in folder.joinpath("LICENSE").read_text(encoding="utf-8")


def test_the_structure_supports_screen_readers(page: html.HtmlElement) -> None:
    """Required: language, one h1, ordered headings, named sections, captions, scopes, labels, unique ids."""
    assert page.get("lang") == "en"
    levels = [int(node.tag[1]) for node in page.xpath("//h1|//h2|//h3|//h4")]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))
    ids = page.xpath("//@id")
    assert len(set(ids)) == len(ids)
    for attribute in ("aria-labelledby", "aria-describedby"):
        assert set(page.xpath(f"//@{attribute}")) <= set(ids)
    assert {link.removeprefix("#") for link in page.xpath("//nav//a/@href")} <= set(ids)
    assert page.xpath("count(//table)") == page.xpath("count(//table[caption[normalize-space()]])")
    assert not page.xpath("//th[not(@scope)]")
    assert not page.xpath("//input[not(ancestor::label)]")
    assert not page.xpath("//fieldset[not(legend)]")
    assert page.xpath("//main")
    assert page.xpath("//a[@class='skip']")[0].get("href") == "#summary"
    assert set(page.xpath("//@tabindex")) == {"0"}
    assert not page.xpath("//div[contains(@class, 'plot')][not(@aria-labelledby)]")


def test_tables_contain_both_units_and_the_bounds(page: html.HtmlElement) -> None:
    """N of gyro x is 1.2e-4 rad/s/√Hz and 0.4125 deg/√h; an undetected term is a bound."""
    table = page.xpath("//table[@class='summary']")[0]
    row = table.xpath(".//tr[th/b='N']")[0]
    assert row.xpath("td[1]/span[@class='sheet']")[0].text_content() == "0.4125[0.4109, 0.4141]"
    assert row.xpath("td[1]/span[@class='si']")[0].text_content() == "120.0[119.5, 120.5]"
    assert "deg/√h" in row.xpath("th")[0].text_content()
    assert "10−6 rad/s/√Hz" in row.xpath("th")[0].text_content()
    bound = table.xpath(".//tr[th/b='K']/td[2]/span[@class='sheet']")[0].text_content()
    assert bound == "< 5.1not detected; upper bound"


def test_findings_have_text_axis_and_advice(page: html.HtmlElement) -> None:
    """Findings include the usable part of the log, and warnings come before infos."""
    section = page.get_element_by_id("findings")
    text = " ".join(section.text_content().split())
    assert "Warnings (2)" in text
    assert "warm-up accel_z The mean drifts by 0.021 m/s² in the first 14 minutes." in text
    assert "Try --skip 840s --take 9960s." in text
    assert text.index("Warnings") < text.index("Notes")


def test_findings_with_the_same_advice_are_grouped() -> None:
    """Axes with the same advice are one item, and axes with the same text share a sentence."""
    report = consumer_report()
    finding = replace(report.axes[0].findings[0], code="odd", axis=None, advice="Look at it.")
    axes = [
        replace(axis, findings=(replace(finding, text="Odd." if i else "All is odd."),))
        for i, axis in enumerate(report.axes[:3])
    ]
    section = html.fromstring(findings_section(replace(report, axes=tuple(axes), findings=())))
    items = section.xpath(".//li[not(ancestor::li)]")
    assert [" ".join(item.text_content().split()) for item in items] == [
        "odd gyro_x All is odd. gyro_y gyro_z Odd. Look at it."
    ]
    calm = replace(report, axes=tuple(replace(axis, findings=()) for axis in report.axes[:2]), findings=())
    assert "No findings: no gap" in findings_section(calm)


def test_the_page_contains_the_numbers_for_each_program(page: html.HtmlElement) -> None:
    """The formulas are evaluated at 200 Hz for the worst axis."""
    rows = {
        row.xpath("th")[0].text_content(): [cell.text_content() for cell in row.xpath("td")]
        for row in page.get_element_by_id("downstream").xpath("(.//table)[2]/tbody/tr")
    }
    # The numbers cover all axes and equal those in the JSON and in a file for PX4.
    pair = filter_numbers([axis.fit for axis in consumer_report().axes[:3]])
    white, walk = pair.white, pair.walk
    assert rows["N"][1] == f"{scientific(white)} rad/s/√Hz, x y z"
    assert rows["K"][1] == f"{scientific(walk)} rad/s/√s, x y z"
    assert rows["N √f"][1].startswith(f"{scientific(white * 200**0.5)} rad/s,")
    assert rows["N √(2f)"][1].startswith(f"{scientific(white * 400**0.5)} rad/s,")
    assert rows["N² f"][1].startswith(f"{scientific(white**2 * 200)} rad²/s²,")
    assert rows["K √f"][1].startswith(f"{scientific(walk * 200**0.5)} rad/s,")
    assert rows["N / √0.01 s"][1].startswith(f"{scientific(white / 0.1)} rad/s,")
    assert rows["N"][0].startswith("continuous")
    # This is the slowest term of gyro z; no accelerometer axis has one.
    assert rows["σ, T"][1:3] == ["6.00 ×10⁻⁵ rad/s, 1500 s, z", "–"]
    assert rows["N² f"][0].startswith("discrete")


def test_the_page_has_a_row_for_every_export(page: html.HtmlElement) -> None:
    """The row contains the formulas of the exported file."""
    rows = page.get_element_by_id("downstream").xpath("(.//details)[2]//tbody/tr")
    texts = {row.xpath(".//code")[0].text_content(): row.text_content() for row in rows}
    assert list(texts) == list(TARGETS)
    for name, target in TARGETS.items():
        assert target.title in texts[name]
        assert "; ".join(target.formulas) in texts[name]


def test_the_tables_come_before_the_pictures(page: html.HtmlElement) -> None:
    """Readers look for the numbers first."""
    parts = page.get_element_by_id("summary").xpath(".//table | .//img")
    assert [part.tag for part in parts] == ["table", "table", "img", "img"]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0332, "0.0332"), (1.4878e-5, "1.49 ×10⁻⁵"), (9.999e-4, "0.001"), (0.0, "0"), (12345.0, "1.23 ×10⁴")],
)
def test_numbers_of_the_page_have_three_digits(value: float, text: str) -> None:
    """No number has an exponent with an e."""
    assert scientific(value) == text


def test_a_worst_axis_with_only_a_bound_is_marked() -> None:
    page = html.document_fromstring(small_page())
    cells = page.get_element_by_id("downstream").xpath("(.//table)[2]/tbody/tr[th='B']/td/span/text()")
    assert cells[1].startswith("≤ ")


def test_names_of_the_log_are_escaped() -> None:
    """A path must not become a tag or end a script."""
    report = small_report()
    evil = "</script><img src=x onerror=alert(1)>&$title.csv"
    report = replace(report, source=replace(report.source, path=evil))
    page = html.document_fromstring(render_page(report))
    assert {image.get("src")[:16] for image in page.xpath("//img")} == {"data:image/png;b"}
    assert page.xpath("//h1")[0].text_content() == evil.rsplit("/", 1)[-1]


def test_the_page_is_reproducible() -> None:
    """The page contains no date and no random name."""
    assert render_page(small_report()) == small_page()


def test_the_data_of_the_page_is_json_and_can_not_end_the_script() -> None:
    """All gaps are included; adjacent gaps too close to distinguish are merged."""
    axis = consumer_report().axes[0]
    gaps = tuple(Gap(start_s=s, missing=10, duration_s=0.05) for s in (100.0, 101.0, 9000.0))
    report = replace(consumer_report(), axes=(replace(axis, gaps=gaps),))
    text = page_data(report)
    assert "<" not in text
    assert json.loads(text)["axes"]["gyro_x"]["raw"]["gaps"] == [[100.0, 101.05], [9000.0, 9000.05]]


@pytest.mark.parametrize(
    ("std", "number"),
    [
        (0.02, 1.2346),
        (1.0, 1.23),
        (9.9, 1.23),
        (10.0, 1.2),
        (5e4, 1.0),
        (0.0, 1.23456789),
        (np.nan, 1.23456789),
    ],
)
def test_the_raw_signal_is_rounded_to_a_hundredth_of_its_noise(std: float, number: float) -> None:
    """If the standard deviation is unknown or zero, there are nine digits."""
    axis = consumer_report().axes[0]
    values = np.array([1.23456789012, np.nan])
    overview = Overview(time_s=np.array([0.5, 1234.5678]), low=values, high=values)
    report = replace(consumer_report(), axes=(replace(axis, overview=overview, std=std),))
    raw = json.loads(page_data(report))["axes"]["gyro_x"]["raw"]
    assert (raw["low"], raw["t"]) == ([number, None], [0.5, 1234.57])


@pytest.mark.parametrize(("apart", "count"), [(19.9, 1), (20.1, 2)])
def test_gaps_closer_than_a_five_hundredth_are_merged(apart: float, count: int) -> None:
    """In a recording of 10 000 s this is 20 s from the end of a gap to the start of the next."""
    axis = consumer_report().axes[0]
    gaps = tuple(Gap(start_s=s, missing=10, duration_s=5.0) for s in (100.0, 105.0 + apart))
    report = replace(consumer_report(), axes=(replace(axis, gaps=gaps, duration_s=10_000.0),))
    assert len(json.loads(page_data(report))["axes"]["gyro_x"]["raw"]["gaps"]) == count


@pytest.mark.parametrize(("height", "count"), [(7.9, 0), (8.1, 1)])
def test_a_spike_of_eight_deviations_is_found(height: float, count: int) -> None:
    """The robust deviation is an eighth of std here, because all neighbours are equal."""
    values = np.zeros(25)
    values[3] = height / 8
    overview = Overview(time_s=np.arange(25.0), low=np.zeros(25), high=values)
    assert standing_out(overview, 1.0).size == count
    assert standing_out(Overview(time_s=np.arange(24.0), low=np.zeros(24), high=values[:24]), 1.0).size == 0
    # For -1, 0, 1 repeated, the median is 0 and the median distance from it is 1.
    restless = np.arange(200.0) % 3 - 1
    restless[100] = 1.4826 * height
    overview = Overview(time_s=np.arange(200.0), low=-np.ones(200), high=restless)
    assert standing_out(overview, 0.1).size == count


@pytest.mark.parametrize(
    ("count", "named", "counted"),
    [
        (0, "", "none"),
        (6, "1 Hz, 2 Hz, 3 Hz, 4 Hz, 5 Hz, 6 Hz", ""),
        (8, "1 Hz, 2 Hz", "5 Hz, 6 Hz and 2 more"),
    ],
)
def test_six_spectral_lines_are_listed_and_the_others_counted(count: int, named: str, counted: str) -> None:
    """The rule applies to the table of fits and to the caption of the plot."""
    axis = consumer_report().axes[0]
    lines = tuple(Line(frequency_hz=float(k + 1), amplitude=1e-5) for k in range(count))
    fit = replace(
        axis.fit,
        goodness=replace(axis.fit.goodness, lines=lines, band_hz=None),
        candidates=tuple(Candidate(structure=f"M{k}", delta=float(k)) for k in range(6)),
    )
    page = _page(replace(axis, fit=fit, gaps=axis.gaps * 2))
    cells = page.xpath("//table[caption='The fits']/tbody/tr/td/span/text()")
    assert cells[1] == "2, 240 s"
    assert cells[3] == "all"
    assert cells[4].startswith(named)
    assert cells[4].endswith(counted)
    assert len(cells[4]) == len(named) or counted
    assert cells[-1] == "M1 (+1.0), M2 (+2.0), M3 (+3.0)"
    captions = " ".join(node.text_content() for node in page.xpath("//figcaption"))
    assert ("Lines left out at" in captions) is bool(count)
    assert ("6 Hz." in captions) is bool(count)


@pytest.mark.parametrize(
    ("score", "text"),
    [
        (-0.04, "0.0 (the model fits)"),
        (-1.26, "−1.3 (the model fits)"),
        (3.0, "3.0 (the model fits)"),
        (3.14, "3.1 (the model does not fit)"),
    ],
)
def test_the_misfit_score_is_explained(score: float, text: str) -> None:
    """A score above 3 means that the data contain something that the model lacks."""
    axis = consumer_report().axes[0]
    fit = replace(axis.fit, goodness=replace(axis.fit.goodness, statistic=score))
    page = _page(replace(axis, fit=fit))
    assert page.xpath("//table[@class='summary']//tr[th='misfit score']/td/text()") == [text]


@pytest.mark.parametrize(("count", "text"), [(0, "no gaps."), (1, "1 gap."), (2, "2 gaps.")])
def test_the_caption_of_the_raw_signal_contains_the_number_of_gaps(count: int, text: str) -> None:
    axis = consumer_report().axes[0]
    page = _page(replace(axis, gaps=axis.gaps * count))
    assert page.xpath("//figcaption")[3].text_content().endswith(text)


def _page(axis: AxisReport) -> html.HtmlElement:
    """Return the sections of one axis, without the large script."""
    report = replace(consumer_report(), axes=(axis,))
    sections = (summary_section(report, {}), axis_section(report, axis, {}), method_section(report))
    return html.document_fromstring("".join(sections))


def test_the_page_explains_the_effect_on_a_filter(page: html.HtmlElement) -> None:
    """Quantities at four times have limits and the dominant term; a drift that is not noise has no row."""
    section = page.get_element_by_id("drift")
    rows = {row.findtext("th"): row.xpath("string(td[3])") for row in section.xpath(".//tbody/tr")}
    assert rows == {
        "Heading": "0.132 [0.123, 0.139] deg GM1",
        "Tilt": "0.1107 [0.1083, 0.1133] deg B",
        "Velocity": "0.580 [0.569, 0.592] m/s gyro_x N",
        "Position": "12.20 [11.99, 12.43] m gyro_x N",
    }
    short = html.document_fromstring(small_page()).get_element_by_id("drift")
    assert short.xpath("string(.//tbody/tr[1]/td[4])").endswith(" deg N, extrapolated")
    moved = Finding(level="error", code="motion", axis="gyro_x", text="it moved")
    page = html.document_fromstring(render_page(replace(small_report(), findings=(moved,))))
    assert not page.xpath("//*[@id='drift']")


def test_spikes_are_marked_and_drift_is_not() -> None:
    """A stretch is marked if its extreme differs much from those of its neighbours."""
    rng = np.random.default_rng(5)
    time = np.arange(1000.0)
    drift = 5 * np.sin(time / 200)
    low, high = drift - 4 + 0.2 * rng.standard_normal(1000), drift + 4 + 0.2 * rng.standard_normal(1000)
    calm = Overview(time_s=time, low=low, high=high)
    assert standing_out(calm, 1.0).size == 0
    high[400] += 12
    low[700:703] -= 9
    high[500:520] = low[500:520] = np.nan
    spiky = Overview(time_s=time, low=low, high=high)
    assert standing_out(spiky, 1.0).tolist() == [400.0, 700.0, 701.0, 702.0]
    short = Overview(time_s=time[:5], low=low[:5], high=high[:5])
    assert standing_out(short, 1.0).size == 0


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_texts_have_sufficient_contrast(theme: str) -> None:
    """WCAG 2.2, AA, requires 4.5 between text and background, in both themes."""
    css = _CSS.read_text(encoding="utf-8")
    blocks = re.findall(r"\{([^{}]*--paper[^{}]*)\}", css)
    values = dict(re.findall(r"--([\w-]+):\s*(#\w{6})", blocks[0 if theme == "light" else 1]))
    for text, ground in [
        ("ink", "paper"),
        ("second", "paper"),
        ("accent", "paper"),
        ("second", "warning-soft"),
        ("second", "error-soft"),
        ("second", "info-soft"),
        ("warning", "paper"),
    ]:
        assert _contrast(values[text], values[ground]) >= 4.5, (text, ground)


def test_an_axis_without_spectrum_and_signal_has_a_page() -> None:
    """A curve of another tool has no samples, and four samples give two points."""
    assert "Gyroscope x" in render_page(_bare())
    page = html.document_fromstring(render_page(shortest_report(4)))
    assert page.xpath("//table[@class='summary']//tr[th='misfit score']/td/text()") == ["unknown"]


def _bare() -> Report:
    report = small_report()
    empty = np.zeros(0)
    axis = replace(
        report.axes[0],
        spectrum=Spectrum(frequency=empty, psd=empty, count=empty),
        overview=Overview(time_s=empty, low=empty, high=empty),
    )
    return replace(report, axes=(axis,))


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Yield one browser for the tests of this file."""
    with Browser() as session:
        yield session


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the address of a page in a folder, as users open it."""
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(consumer_page(), encoding="utf-8")
    return path.as_uri()


def _load(browser: Browser, address: str) -> None:
    browser.open(address)
    browser.wait("return document.documentElement.dataset.ready")


def _show(browser: Browser, plot: str) -> None:
    # Scroll at each attempt, because other plots that are drawn above can move this one out of view.
    browser.run(f"document.getElementById('{plot}').closest('details').open = true")
    browser.wait(
        f"document.getElementById('{plot}').scrollIntoView({{block: 'center'}});"
        f"return document.querySelector('#{plot} .main-svg') !== null"
    )


def test_every_plot_is_drawn_without_an_error_or_a_request(browser: Browser, address: str) -> None:
    """There are 18 plots, the console is empty, and the only request is the page itself."""
    _load(browser, address)
    plots = browser.run("return [...document.querySelectorAll('.plot')].map((p) => p.id)")
    assert len(plots) == 18
    for plot in plots:
        _show(browser, plot)
    assert (
        browser.run("return document.querySelectorAll('.plot .errorbars, .plot .scatterlayer path').length")
        > 50
    )
    assert browser.run("return document.getElementById('no-plots').hidden")
    assert [entry["message"] for entry in browser.logs("browser")] == []
    asked = browser.requests()
    assert asked[0] == address
    assert [url for url in asked[1:] if not url.startswith(("data:", "blob:"))] == []


def test_hover_shows_tau_deviation_interval_and_model(browser: Browser, address: str) -> None:
    """The mouse is on a point."""
    _load(browser, address)
    _show(browser, "gyro_x-allan")
    place = """
        const plot = document.getElementById('gyro_x-allan');
        const points = plot.querySelectorAll('.scatterlayer .trace .points path');
        const box = points[5].getBoundingClientRect();
        return [box.x + box.width / 2, box.y + box.height / 2];
    """
    browser.point_at(*browser.run(place))
    text = browser.wait(
        "return [...document.querySelectorAll('#gyro_x-allan .hoverlayer tspan')]"
        ".map((t) => t.textContent).join('|')"
    )
    # The used points come first; the sixth of them is m = 64 at 200 Hz.
    assert "τ = 0.3200 s" in text
    assert "deg/h" in text
    assert re.search(r"95 %: [\d.]+ to [\d.]+", text)
    assert re.search(r"model: [\d.]+", text)


def test_a_plot_has_two_tab_stops(browser: Browser, address: str) -> None:
    """The tab stops are the plot and its buttons; arrow keys move between the buttons."""
    _load(browser, address)
    stops = """
        return [...document.querySelectorAll('#gyro_x-allan, #gyro_x-allan *')].filter((e) => e.tabIndex >= 0)
            .map((e) => e.className)
    """
    _show(browser, "gyro_x-allan")
    browser.wait("return document.querySelectorAll('#gyro_x-allan .annotation-text').length > 0")
    assert browser.run(stops) == ["plot allan js-plotly-plot", "modebar-btn"]
    browser.run("document.querySelector('#gyro_x-allan .modebar-btn').focus()")
    first = browser.run("return document.activeElement.getAttribute('aria-label')")
    browser.press("right")
    assert browser.run("return document.activeElement.getAttribute('aria-label')") != first
    assert len(browser.run(stops)) == 2


def test_plots_have_the_labels_and_marks_of_the_pictures(browser: Browser, address: str) -> None:
    """Each term has its value with uncertainty, the minimum has a ring, and no label covers another."""
    _load(browser, address)
    axis = consumer_report().axes[0]
    units = sheet_units([each.fit for each in consumer_report().axes[:3]])
    expected = {estimate_text(estimate, axis.sensor, units) for estimate in axis.fit.estimates}
    expected.add(f"minimum {with_interval(units.minimum(axis.fit))}")
    _show(browser, "gyro_x-allan")
    script = """
        return [...document.querySelectorAll('#gyro_x-allan .annotation')].map((a) => {
            const box = a.querySelector('.annotation-text-g rect').getBoundingClientRect();
            const text = a.querySelector('.annotation-text').textContent;
            return [text, box.left, box.top, box.right, box.bottom];
        })
    """
    browser.wait("return document.querySelectorAll('#gyro_x-allan .annotation').length > 0")
    found = browser.run(script)
    assert {text for text, *_ in found} == expected
    for (_, l1, t1, r1, b1), (_, l2, t2, r2, b2) in itertools.combinations(found, 2):
        assert r1 <= l2 + 1 or r2 <= l1 + 1 or b1 <= t2 + 1 or b2 <= t1 + 1
    rings = "document.getElementById('gyro_x-allan').data.filter((t) => t.marker?.symbol === 'circle-open')"
    assert browser.run(f"return {rings}.length") == 1


def test_arrow_keys_move_through_the_points(browser: Browser, address: str) -> None:
    """The shown values are announced to a screen reader."""
    _load(browser, address)
    for plot, expected in [("gyro_y-allan", "τ = 0.01000 s"), ("gyro_y-psd", "Hz"), ("gyro_y-raw", "deg/h")]:
        _show(browser, plot)
        browser.run("document.getElementById(arguments[0]).focus()", plot)
        browser.press("right")
        browser.press("right")
        text = browser.wait("return document.getElementById('announcement').textContent")
        assert expected in text
        assert browser.wait(f"return document.querySelector('#{plot} .hoverlayer text') !== null")
        browser.run("document.getElementById('announcement').textContent = ''")


def test_the_unit_switch_changes_tables_and_plots(browser: Browser, address: str) -> None:
    """Data-sheet units are the default; the switch shows SI."""
    _load(browser, address)
    _show(browser, "gyro_x-allan")
    cell = "return document.querySelector('.summary tbody td').innerText"
    title = "return document.querySelector('#gyro_x-allan .ytitle').textContent"
    assert browser.run(cell).startswith("0.4125")
    assert "deg/h" in browser.run(title)
    browser.run("document.querySelector('input[value=si]').click()")
    assert browser.run(cell).startswith("120.0")
    assert "rad/s" in browser.wait(title)


def test_the_theme_follows_the_system_and_the_switch(browser: Browser, address: str) -> None:
    """Page and plots change together."""
    _load(browser, address)
    _show(browser, "gyro_x-allan")
    paper = "return getComputedStyle(document.body).backgroundColor"
    ink = "return document.querySelector('#gyro_x-allan .xtitle').style.fill"
    assert browser.run(paper) == "rgb(255, 255, 255)"
    light = browser.run(ink)
    browser.devtools(
        "Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}]
    )
    assert browser.run(paper) == "rgb(18, 23, 29)"
    browser.wait(f"{ink} !== {json.dumps(light)}")
    browser.run("document.querySelector('input[value=light]').click()")
    assert browser.run(paper) == "rgb(255, 255, 255)"
    browser.devtools("Emulation.setEmulatedMedia", features=[])


def test_narrow_screens_need_no_horizontal_scrolling(browser: Browser, address: str) -> None:
    """On a phone, rows become cards, with each number below its title."""
    _load(browser, address)
    browser.devtools(
        "Emulation.setDeviceMetricsOverride", width=390, height=800, deviceScaleFactor=1, mobile=False
    )
    _show(browser, "accel_z-raw")
    assert browser.run("return innerWidth") == 390
    assert browser.run("return document.documentElement.scrollWidth <= innerWidth")
    wide = "[...document.querySelectorAll('.scroll')].filter((s) => s.scrollWidth > s.clientWidth + 1).length"
    browser.run("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert browser.run(f"return {wide}") == 0
    cell = "document.querySelector('#downstream .cards td')"
    assert browser.run(f"return getComputedStyle({cell}, '::before').content") == '"White noise"'
    browser.devtools("Emulation.clearDeviceMetricsOverride")


def test_pictures_replace_charts_without_scripts(browser: Browser, address: str) -> None:
    """Both overviews and a picture per axis are shown, but no empty plot and no useless switch."""
    browser.devtools("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(address)
        tree = browser.devtools("Accessibility.getFullAXTree")["nodes"]
    finally:
        browser.devtools("Emulation.setScriptExecutionDisabled", value=False)
    images = [node["name"]["value"] for node in tree if node["role"]["value"] == "image"]
    assert images == [f"Allan deviations and spectra of the {sensor}'s axes" for sensor in Sensor]
    assert "radio" not in {n["role"]["value"] for n in tree if not n.get("ignored")}
    page = html.document_fromstring(Path(address.removeprefix("file://")).read_text(encoding="utf-8"))
    for axis in consumer_report().axes:
        (image,) = page.xpath(f"//section[@id='{axis.name}']//figure[@class='static']//img")
        where = f"{axis.sensor} {axis.axis}"
        assert image.get("alt") == f"Allan deviation and power spectral density of {where}"


def test_the_printed_page_has_every_picture_on_eight_sheets(browser: Browser, address: str) -> None:
    """Print is light even if the screen is dark; folded sections are opened and closed again."""
    _load(browser, address)
    browser.run("document.querySelector('input[value=dark]').click()")
    answer = browser.devtools("Page.printToPDF", preferCSSPageSize=True)
    pdf = base64.b64decode(answer["data"])
    assert len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 8
    folds = "return [...document.querySelectorAll('.folded')].map((fold) => fold.open)"
    assert set(browser.run(folds)) == {False}
    browser.devtools("Emulation.setEmulatedMedia", media="print")
    browser.run("dispatchEvent(new Event('beforeprint'))")
    assert set(browser.run(folds)) == {True}
    shown = (
        "return [...document.querySelectorAll('main img')].filter((image) => image.clientHeight > 100).length"
    )
    assert browser.run(shown) == 8
    assert browser.run("return getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    browser.run("dispatchEvent(new Event('afterprint'))")
    browser.devtools("Emulation.setEmulatedMedia", media="")
    assert set(browser.run(folds)) == {False}
    assert browser.run("return getComputedStyle(document.body).backgroundColor") == "rgb(18, 23, 29)"


@pytest.mark.parametrize(("width", "first", "height"), [(1400, 900, 6000), (390, 900, 9000)])
def test_the_table_is_visible_and_the_page_is_short(
    browser: Browser, address: str, width: int, first: int, height: int
) -> None:
    """Order: verdict, tables, pictures; axes are folded. Sizes: desktop and phone."""
    browser.devtools(
        "Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False
    )
    _load(browser, address)
    assert browser.run("return document.querySelector('main table').getBoundingClientRect().top") < first
    assert browser.run("return document.documentElement.scrollHeight") < height
    browser.devtools("Emulation.clearDeviceMetricsOverride")


def test_a_link_opens_its_folded_section(browser: Browser, address: str) -> None:
    """The link is in the navigation, or in another page."""
    _load(browser, address)
    browser.run("document.querySelector('nav a[href=\"#accel_y\"]').click()")
    assert browser.wait("return document.querySelector('#accel_y > .folded').open")
    assert browser.wait("return document.querySelector('#accel_y-allan .main-svg') !== null")


def test_every_focusable_element_has_a_name(browser: Browser, address: str) -> None:
    """Screen readers use Chromium's accessibility tree."""
    _load(browser, address)
    tree = browser.devtools("Accessibility.getFullAXTree")["nodes"]
    focusable = [n for n in tree if any(p["name"] == "focusable" for p in n.get("properties", []))]
    nameless = [
        node["role"]["value"]
        for node in focusable
        if not node.get("ignored") and not node.get("name", {}).get("value")
    ]
    assert len(focusable) > 30
    assert set(nameless) <= {"RootWebArea"}


def test_a_page_without_samples_has_no_errors(browser: Browser, tmp_path: Path) -> None:
    """Cases: a curve of another tool, and four samples, which have no spectrum and no signal."""
    path = tmp_path / "report.html"
    for report in (_bare(), shortest_report(4)):
        path.write_text(render_page(report), encoding="utf-8")
        _load(browser, path.as_uri())
        for plot in ("allan", "psd", "raw"):
            _show(browser, f"{report.axes[0].name}-{plot}")
    assert [entry["message"] for entry in browser.logs("browser")] == []


def _contrast(one: str, other: str) -> float:
    def luminance(colour: str) -> float:
        rgb = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    light, dark = sorted([luminance(one), luminance(other)], reverse=True)
    return (light + 0.05) / (dark + 0.05)
