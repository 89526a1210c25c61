"""Segments in a report: JSON and reading back, the page's picture, and users of the wider intervals."""

import json
import re
from dataclasses import replace

import jsonschema
import numpy as np
import numpy.testing as npt
import pytest

from imucal.checking.verdict import measure
from imucal.comparison import compare
from imucal.fitting.homogeneity import homogeneity, widened
from imucal.fitting.noise_fit import Segments, Trace
from imucal.report.json_file import from_document, schema, to_document
from imucal.report.page import render_page, segments_figure
from imucal.report.result import AxisReport, Report
from imucal.report.typed_json import dumps
from tests.report.pages import small_page
from tests.report.synthetic import consumer_report, small_report

_VALUES = np.array([1.0, 1.1, 0.9, 1.6])


def segments(scale: float, *, q: float = 90.0, floor: bool = True) -> Segments:
    """Return four segments of an hour whose N is about `scale`."""
    start = 3600.0 * np.arange(4.0)
    spans = np.stack([start, start + 3600], axis=1)
    trace = Trace(value=scale * _VALUES, low=0.95 * scale * _VALUES, high=1.05 * scale * _VALUES)
    term = homogeneity("N", q, np.log(_VALUES), np.full(4, 400.0), spans)
    return Segments(
        start_s=np.asarray(start, np.float64),
        end_s=np.asarray(start + 3600, np.float64),
        white=trace,
        floor=trace if floor else None,
        floor_tau_s=100.0 if floor else np.nan,
        terms=(term,),
    )


def changing(report: Report, *, q: float = 90.0, floor: bool = True) -> Report:
    """Return the report as if the N of its first axis had changed."""
    axis = report.axes[0]
    found = segments(axis.fit["N"].value or 1.0, q=q, floor=floor)
    fit = replace(axis.fit, segments=found, estimates=widened(axis.fit.estimates, found))
    return replace(report, axes=(replace(axis, fit=fit), *report.axes[1:]))


def figure(axis: AxisReport) -> str:
    """Return the picture's SVG and caption, which must exist."""
    found = segments_figure(axis)
    assert found is not None
    return found


def test_segments_are_valid_and_read_back() -> None:
    """Factors, traces and times are equal with and without a floor."""
    for floor in (True, False):
        report = changing(small_report(), floor=floor)
        document = to_document(report)
        jsonschema.Draft202012Validator(schema()).validate(document)
        text = dumps(document)
        again = from_document(json.loads(text))
        assert dumps(to_document(again)) == text
        found, given = again.axes[0].fit.segments, report.axes[0].fit.segments
        assert found is not None
        assert given is not None
        assert found.terms == given.terms
        assert (found.floor is None) != floor
        npt.assert_array_equal(
            found.white.value if found.white else (), _VALUES * report.axes[0].fit["N"].value
        )
        assert again.axes[0].fit["N"].widening == report.axes[0].fit["N"].widening > 1


def test_a_report_without_segments_is_read() -> None:
    """The report has no segments and no wider intervals."""
    document = json.loads(dumps(to_document(small_report())))
    for axis in document["axes"]:
        del axis["fit"]["segments"]
        for term in axis["fit"]["terms"].values():
            del term["widening"]
    found = from_document(document).axes[0].fit
    assert found.segments is None
    assert {e.widening for e in found.estimates} == {1.0}


def test_the_picture_has_a_bar_with_limits_for_each_segment_and_row() -> None:
    """Rows are N and the floor. N has the band of the complete log. The picture has an accessible name."""
    drawn = figure(changing(consumer_report()).axes[0])
    assert len(re.findall('class="value"', drawn)) == len(re.findall('class="limits"', drawn)) == 8
    assert len(re.findall('class="whole"', drawn)) == 1
    assert 'role="img"' in drawn
    assert "floor (Allan deviation at 100 s)" in drawn
    assert "Changes between the parts: N (" in drawn
    assert ">0 h<" in drawn
    assert ">4 h<" in drawn
    only = figure(changing(consumer_report(), floor=False).axes[0])
    assert len(re.findall('class="value"', only)) == 4


def test_bars_of_larger_values_are_higher() -> None:
    """All bars are within the picture."""
    drawn = figure(changing(consumer_report(), floor=False).axes[0])
    heights = [float(y) for y in re.findall(r'class="value" x1="[\d.]+" y1="([\d.]+)"', drawn)]
    assert np.argsort(heights).tolist() == np.argsort(-_VALUES).tolist()
    height = float(re.findall(r'viewBox="0 0 640 (\d+)"', drawn)[0])
    assert 0 < min(heights) < max(heights) < height


def test_the_picture_of_a_stationary_axis_reports_no_change() -> None:
    """Random differences must not be highlighted."""
    assert "Changes between" not in figure(changing(consumer_report(), q=2.0).axes[0])


def test_the_page_contains_a_picture_for_axes_with_segments() -> None:
    page = render_page(changing(small_report()))
    assert page.count("over-time") - small_page().count("over-time") >= 1
    assert segments_figure(consumer_report().axes[0]) is None


def test_compare_and_check_use_the_wider_interval() -> None:
    """A difference of N is significant for a constant sensor, but not for one that changes equally much."""
    report = small_report()
    axis = report.axes[0]
    n = axis.fit["N"]
    assert n.value is not None
    moved = replace(n, value=1.1 * n.value, low=1.1 * n.low, high=1.1 * n.high)
    estimates = tuple(moved if e.key == "N" else e for e in axis.fit.estimates)
    other = replace(report, axes=(replace(axis, fit=replace(axis.fit, estimates=estimates)),))
    before = {d.key: d.outcome for d in compare(report, other).differences}
    after = {d.key: d.outcome for d in compare(changing(report, q=3000), changing(other, q=3000)).differences}
    assert (before["N"], after["N"]) == ("differs", "same")
    ((_, judged),) = measure(changing(report).axes[0], "N")
    assert judged.high / judged.low == pytest.approx((n.high / n.low) ** np.sqrt(30))


def test_the_last_time_is_not_cut_off() -> None:
    """Only the text at the right edge is right-aligned, so the others must end within the picture."""
    svg = re.search(r'viewBox="0 0 (\d+) .*?</svg>', figure(changing(small_report()).axes[0]), re.DOTALL)
    assert svg is not None
    times = re.findall(r'<text x="([\d.]+)" y="[\d.]+" text-anchor="(middle|end)">(\d[^<]* h)</text>', svg[0])
    assert times[-1][2] == "4 h"
    assert [anchor for _, anchor, _ in times] == ["middle"] * (len(times) - 1) + ["end"]
    # A character is at most 7 units wide.
    assert all(float(x) + 3.5 * len(text) <= float(svg[1]) for x, anchor, text in times if anchor == "middle")
