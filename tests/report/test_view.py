"""Rows of results: every term of every axis has its cells, and every output shows every row."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from lxml import html

from imucal.cli._result_table import summary_table
from imucal.noise.terms import ALWAYS, TERMS
from imucal.recording import Axis, Sensor
from imucal.report.figure import Drawings, sensor_figure
from imucal.report.notebook import frame_of, html_of
from imucal.report.numbers import Quantity, SheetUnits
from imucal.report.page import render_page
from imucal.report.result import AxisReport, Report
from imucal.report.view import ROWS, Cell, Row, Subject, view, views
from tests.report.random_reports import STATES, axis_of, random_report, report_of
from tests.report.synthetic import consumer_report

_LETTERS: tuple[Axis, ...] = ("x", "y", "z")


def _page(report: Report) -> html.HtmlElement:
    """Return the parsed page without pictures, which are slow."""
    return html.document_fromstring(render_page(report, drawings=Drawings()))


@pytest.mark.parametrize(("symbol", "state"), list(product(TERMS, STATES)))
def test_a_page_has_every_term_in_every_state(symbol: str, state: str) -> None:
    """Reports have one to six axes of one or both sensors; the first or the last axis has the state.

    Terminal and page have the same rows.
    """
    rng = np.random.default_rng([ord(symbol[0]), STATES.index(state)])
    every = list(product(Sensor, _LETTERS))
    for count in (1, 2, 5, 6):
        chosen = every[:count] if count % 2 else every[6 - count :]
        report = report_of([axis_of(*axis, {symbol: state}, rng) for axis in chosen])
        tables = _page(report).xpath("//table[@class='summary']")
        assert len(tables) == len(views(report))
        for table, seen in zip(tables, views(report), strict=True):
            heads = [head.text_content().split("\n")[0] for head in table.xpath("tbody/tr/th")]
            present = symbol in ALWAYS or state != "absent"
            assert any(head.startswith(symbol) for head in heads) is present
            assert len(table.xpath("thead//th")) == len(seen.names)
            bounds = table.xpath(f".//tr[th/b[starts-with(., '{symbol}')]]/td//text()[contains(., 'bound')]")
            assert bool(bounds) is (present and state != "estimated")
        printed = summary_table(report, datasheet=True, forced=True, encoding="utf-8")
        assert (f"{symbol}  " in printed) is present


@pytest.mark.slow
def test_random_reports_have_a_page() -> None:
    """The test uses forty reports; the script `random_reports` draws any number, with pictures."""
    rng = np.random.default_rng(2711)
    for _ in range(40):
        report = random_report(rng)
        assert len(_page(report).xpath("//table[@class='summary']")) == len(report.by_sensor)


def test_rows_contain_both_units() -> None:
    """N of gyro x is 1.2e-4 rad/s/√Hz. A term of z alone is None for other axes; bounds have no interval."""
    seen = views(consumer_report())[0]
    rows = {row.key: row for row in seen.rows}
    assert list(rows) == ["N", "minimum", "B", "GM1", "GM1 T", "GM2", "GM2 T", "K"]
    sheet, plain = rows["N"].columns
    assert [str(text) for text in sheet.texts][:1] == ["0.4125  [0.4109, 0.4141]"]
    assert (plain.unit, plain.exponent) == ("rad/s/sqrt(Hz)", -6)
    assert rows["GM1"].cells[:2] == (None, None)
    bound = rows["K"].column(datasheet=True).texts[1]
    assert bound is not None
    assert (bound.value, bound.interval, bound.bounded) == ("< 5.1", "", True)


def test_bias_instability_is_the_minimum_and_b_is_flicker_noise() -> None:
    """The two rows follow each other in every output, because they are often mistaken for each other."""
    report = consumer_report()
    outputs = [
        summary_table(report, datasheet=True, encoding="utf-8"),
        _page(report).xpath("//table[@class='summary']")[0].text_content(),
        html.fromstring(html_of(report)).text_content(),
    ]
    for text in outputs:
        words = ["data sheets call it bias instability", "flicker noise", "floor 0.664 B"]
        places = [text.index(word) for word in words]
        assert places == sorted(places)


def test_a_fit_of_an_unknown_sensor_has_a_view() -> None:
    """A curve of another tool has the unit of its numbers, whatever that is."""
    fit = replace(consumer_report().axes[0].fit, sensor=None)
    seen = view({"curve": fit})
    assert {cell.si.unit for row in seen.rows for cell in row.cells if cell} == {""}
    assert seen.rows[0].columns[0].texts == seen.rows[0].columns[1].texts


def test_a_new_row_is_shown_everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """The added row of means appears on terminal, page, picture, notebook and data frame."""

    def means(subjects: Sequence[Subject], _: SheetUnits) -> Iterator[Row]:
        quantities = [
            Quantity(value=7.25, low=7.0, high=7.5, unit=one.unit)
            for one in subjects
            if isinstance(one, AxisReport)
        ]
        if quantities:
            cells = tuple(Cell(sheet=one, si=one) for one in quantities)
            yield Row(key="mean", symbol="", name="of the samples", cells=cells)

    monkeypatch.setattr("imucal.report.view.ROWS", [means, *ROWS])
    report = consumer_report()
    axis, keys = report.axes[0], [row.key for row in views(report)[0].rows]
    assert keys[-1] == "mean"
    printed = summary_table(report, datasheet=True, forced=True, encoding="utf-8")
    assert printed.index("minimum of the curve") < printed.index("mean  of the samples")
    page = _page(report)
    assert page.xpath("//table[@class='summary']//th[b = 'mean']")
    for value in (report, axis):
        assert "<b>mean</b>" in html_of(value)
        assert "mean" in frame_of(value)["term"].to_list()
    assert 7.25 in frame_of(axis)["value"].to_list()
    texts = [text.get_text() for text in sensor_figure(report, axis.sensor).texts]
    assert "mean" in texts
    assert any(text.startswith("7.25 [7.00, 7.50]") for text in texts), texts
