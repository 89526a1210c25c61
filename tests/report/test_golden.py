"""Golden files of a report: all text of the page, all comments of exports, all lines of the pictures.

Renew with ``--update-golden`` and read the diff. Long numbers may differ in their last digits.
"""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.testing as npt
from lxml import etree, html
from matplotlib.artist import Artist
from matplotlib.collections import Collection, LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from imucal.clock import Gap
from imucal.fitting.noise_fit import Line, Response
from imucal.recording import Sensor
from imucal.report.exports import TARGETS, ExportOptions, render
from imucal.report.figure import axis_figure, sensor_figure
from imucal.report.page import render_page
from imucal.report.plot_data import page_data
from imucal.report.result import Report
from tests.report.synthetic import axis_report, consumer_report, shortest_report

_FOLDER = Path(__file__).parent / "golden"
#: Numbers with more digits than any text for users.
_LONG = re.compile(r"-?\d+\.\d{7,}(?:e[+-]?\d+)?|-?\d\.\d{5,}e[+-]?\d+")

#: Tags that are surrounded by meaningless white space.
_BLOCK = re.compile(
    r"\s*(</?(?:section|h\d|p|table|caption|thead|tbody|tr|th|td|ul|li|figure|figcaption|details|summary|div|nav"
    r"|main|noscript|svg|line|rect|text)\b[^>]*>)\s*"
)


def test_exports_equal_the_golden_file(*, update_golden: bool) -> None:
    """The exports contain bounds, unsupported terms and Gauss-Markov states; one file has all options."""
    texts = [f"=== {name}\n{render(consumer_report(), name)}" for name in TARGETS]
    chosen = render(
        consumer_report(),
        "kalibr",
        ExportOptions(axis_policy="rms", inflate={"white": 2.0, "walk": 1.0, "flicker": 3.0}, topic="/given"),
    )
    texts += [f"=== kalibr, rms\n{chosen}", "=== gm, flicker\n"]
    texts += [render(consumer_report(), "gm", ExportOptions(inflate={"flicker": 3.0}))]
    _compare("exports.txt", "\n".join(texts), update=update_golden)


def test_the_page_equals_the_golden_file(*, update_golden: bool) -> None:
    """The sections without scripts are compared, for a full report and one of four samples."""
    texts = [_sections(render_page(report)) for report in (_everything(), shortest_report(4))]
    _compare("page.txt", "\n\n=== four samples\n".join(texts), update=update_golden)


def test_the_data_of_the_plots_equal_the_golden_file(*, update_golden: bool) -> None:
    """The data are curve, model, terms, spectrum, signal, gaps and outliers, with the necessary digits."""
    short = replace(_everything(), axes=(_short_axis(),))
    documents = [json.loads(page_data(report)) for report in (short, shortest_report(4))]
    text = "\n".join(json.dumps(document, ensure_ascii=False, indent=1) for document in documents)
    # A list of numbers is on one line.
    text = re.sub(r"\[[^\[\]{}]*\]", lambda found: re.sub(r"\s+", " ", found[0]), text)
    _compare("page_data.txt", text, update=update_golden)


def test_the_contents_of_the_pictures_equal_the_golden_file(*, update_golden: bool) -> None:
    """Limits, names and positions of lines, bands and marks are compared, but not line widths."""
    report, short = consumer_report(), replace(_everything(), axes=(_short_axis(),))
    figures = [(axis.name, axis_figure(report, axis)) for axis in report.axes]
    figures += [("short", axis_figure(short, short.axes[0]))]
    figures += [("shortest", axis_figure(shortest_report(4), shortest_report(4).axes[0]))]
    figures += [(str(sensor), sensor_figure(report, sensor)) for sensor in Sensor]
    text = "\n".join(f"=== {name}\n" + "\n".join(_drawn(figure)) for name, figure in figures)
    _compare("pictures.txt", text, update=update_golden)


def _everything() -> Report:
    """Return three axes: with a bound and a filter, with Gauss-Markov terms, with findings."""
    report = consumer_report()
    return replace(report, axes=(report.axes[1], report.axes[2], report.axes[5]))


def _short_axis() -> Any:  # noqa: ANN401 - an AxisReport
    axis = axis_report(
        Sensor.GYROSCOPE,
        "z",
        "Q=2e-6 + N=1.1e-4 + GM(sigma=4e-5, T=3.0) + B=2e-5",
        bounds={"K": 6.2e-6},
        n=3000,
        mean=1.25,
        gaps=tuple(Gap(start_s=s, missing=4, duration_s=0.02) for s in (2.0, 2.04, 9.0)),
        lines=tuple(Line(frequency_hz=f, amplitude=f * 1e-6) for f in (12.5, 30.0, 49.97, 61.0)),
        response=Response(cutoff_hz=46.0),
        band_hz=(0.2, 60.0),
        overview_size=40,
    )
    high = axis.overview.high.copy()
    high[20] += 0.3
    return replace(axis, overview=replace(axis.overview, high=high))


def _sections(page: str) -> str:
    root = html.document_fromstring(page)
    for node in root.xpath("//script|//style"):
        node.drop_tree()
    for image in root.xpath("//img"):
        # The bytes of a picture depend on the library that drew it.
        image.set("src", image.get("src").partition(",")[0])
    parts = [root.xpath("//title")[0], root.xpath("//h1")[0], *root.xpath("//nav|//main")]
    text = "\n".join(etree.tostring(part, encoding="unicode") for part in parts)
    return _BLOCK.sub(r"\n\1", text)


def _drawn(figure: Figure) -> Iterator[str]:
    yield "legend: " + " | ".join(
        f"{text.get_text()}" for legend in figure.legends for text in legend.get_texts()
    )
    yield from (f"text: {text.get_text()!r}" for text in figure.texts)
    for axes in figure.axes:
        yield f"plot: {axes.get_xlabel()} | {axes.get_ylabel()}"
        yield f"limits: {_numbers([*axes.get_xlim(), *axes.get_ylim()])}"
        for line in axes.lines:
            x, y = (np.asarray(values, dtype=float) for values in line.get_data())
            marker, face = line.get_marker(), line.get_markerfacecolor()
            name = f"{line.get_color()} {marker} {face if marker != 'None' else ''}".rstrip()
            yield f"line: {_name(line)} {name} {_points(x, y)}"
        for mark in axes.collections:
            if not isinstance(mark, LineCollection):
                yield f"band: {_name(mark)} {_points(*_vertices(mark).T)}"
        yield from (
            f"span: {_name(span)} {_numbers([span.get_x(), span.get_width()])}"
            for span in axes.patches
            if isinstance(span, Rectangle)
        )
        yield from (f"label: {text.get_text()!r} {text.get_color()}" for text in axes.texts)


def _name(artist: Artist) -> str:
    """Return the artist's label in the legend; matplotlib numbers artists without one."""
    label = str(artist.get_label())
    return "" if label.startswith("_") else label


def _vertices(mark: Collection) -> Any:  # noqa: ANN401 - matplotlib's arrays
    return np.concatenate([np.asarray(path.vertices) for path in mark.get_paths()])


def _points(x: Any, y: Any) -> str:  # noqa: ANN401 - matplotlib's arrays
    """Return the number of points, both ends, and mean and spread of the heights."""
    if not x.size:
        return "none"
    return f"{x.size}: {_numbers([x[0], y[0], x[-1], y[-1], x.mean(), y.mean(), y.std()])}"


def _numbers(values: list[float]) -> str:
    # More digits than `_LONG` requires, so that they are compared as numbers.
    return " ".join(f"{value:.9e}" for value in values)


def _compare(name: str, text: str, *, update: bool) -> None:
    path = _FOLDER / name
    if update:
        path.write_text(text, encoding="utf-8")
    golden = path.read_text(encoding="utf-8")
    assert _LONG.sub("#", text).splitlines() == _LONG.sub("#", golden).splitlines()
    found, expected = ([float(number) for number in _LONG.findall(each)] for each in (text, golden))
    # Special functions differ in their last digits between versions of SciPy.
    npt.assert_allclose(found, expected, rtol=1e-7)
