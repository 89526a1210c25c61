"""Pictures drawn in parallel equal those drawn one by one, and so do the errors."""

import base64
import os
from dataclasses import replace
from pathlib import Path

import pytest

from imucal.recording import Sensor
from imucal.report import figure
from imucal.report import figure as drawings
from imucal.report.figure import draw, picture_names
from imucal.report.result import AxisReport, Report
from imucal.report.writer import write_report
from tests.report.synthetic import consumer_report, small_report


def _two_axes() -> Report:
    report = consumer_report()
    return replace(report, axes=report.axes[2:4])


@pytest.mark.usefixtures("forks")
def test_the_number_of_workers_does_not_change_the_files(tmp_path: Path) -> None:
    """Every file of a report is equal byte by byte."""
    one = write_report(_two_axes(), tmp_path / "one", workers=1)
    two = write_report(_two_axes(), tmp_path / "two", workers=2)
    assert [path.name for path in one] == [path.name for path in two]
    assert all(a.read_bytes() == b.read_bytes() for a, b in zip(one, two, strict=True))


@pytest.mark.usefixtures("forks")
def test_pictures_are_drawn_in_other_processes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Two workers draw two pictures at a time; the results keep the order of the files."""
    marks = tmp_path / "marks"
    marks.mkdir()
    work = drawings._draw_one

    def marked(*arguments: object, **named: object) -> object:
        (marks / str(os.getpid())).touch()
        return work(*arguments, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(drawings, "_draw_one", marked)
    report = _two_axes()
    found = draw(report, ("png",), page=True, workers=2)
    assert 1 <= len(list(marks.iterdir())) <= 2
    assert str(os.getpid()) not in {mark.name for mark in marks.iterdir()}
    assert tuple(found.files) == picture_names(report, ("png",))
    assert set(found.addresses) == {name.removesuffix(".png") for name in found.files}


@pytest.mark.usefixtures("forks")
@pytest.mark.parametrize("workers", [1, 2])
def test_a_failed_picture_is_reported(monkeypatch: pytest.MonkeyPatch, workers: int) -> None:
    """The error names all its formats, and the other pictures are drawn."""
    monkeypatch.delenv("IMUCAL_DEBUG", raising=False)
    original = figure.axis_figure

    def fails(report: Report, axis: AxisReport) -> object:
        if axis.sensor is Sensor.GYROSCOPE:
            raise ArithmeticError
        return original(report, axis)

    monkeypatch.setattr(figure, "axis_figure", fails)
    report = _two_axes()
    found = draw(report, ("png", "svg"), page=True, workers=workers)
    missing = {f"{axis.name}.{form}" for axis in report.axes[:1] for form in ("png", "svg")}
    assert set(picture_names(report, ("png", "svg"))) - set(found.files) == missing
    assert [finding.text.split()[0] for finding in found.failures] == sorted(missing)
    assert set(found.addresses) == {report.axes[1].name, "gyro", "accel"}


def test_without_formats_and_page_nothing_is_drawn() -> None:
    assert draw(small_report(), ()).files == {}
    assert picture_names(small_report(), ()) == ()


@pytest.mark.parametrize(
    ("formats", "drawn", "kind"),
    [
        (("png",), {"png"}, "png"),
        (("svg", "pdf"), {"svg", "pdf"}, "svg+xml"),
        (("pdf",), {"pdf", "png"}, "png"),
    ],
)
def test_the_page_uses_the_pictures_of_the_folder(
    formats: tuple[str, ...], drawn: set[str], kind: str
) -> None:
    """A figure is rendered once per format. A PNG is added only if browsers can't show the format."""
    found = draw(small_report(), formats, page=True, workers=1)
    assert {name.partition(".")[2] for name in found.files} == drawn
    assert found.addresses["gyro_x"].startswith(f"data:image/{kind};base64,")
    held = base64.b64decode(found.addresses["gyro_x"].partition(",")[2])
    assert held == found.files[f"gyro_x.{kind.partition('+')[0]}"]
