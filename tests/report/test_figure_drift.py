"""The picture of a drift: plots, lines, marks and reproducibility."""

from dataclasses import replace

import numpy as np
import numpy.testing as npt

import imucal
from imucal.noise.model import NoiseModel
from imucal.report.figure import render
from imucal.report.figure_drift import drift_figure
from tests.report.synthetic import consumer_report, shortest_report, small_report


def test_each_kind_of_quantity_has_its_plot() -> None:
    """The plots are angle, velocity and position, each with its parts and their total."""
    figure = drift_figure(consumer_report(), imucal.drift(consumer_report()))
    assert [axes.get_ylabel() for axes in figure.axes] == ["angle (deg)", "velocity (m/s)", "position (m)"]
    legends = [axes.get_legend_handles_labels()[1] for axes in figure.axes]
    assert legends == [["heading", "tilt"], *[["accelerometer", "tilt", "both"]] * 2]
    alone = drift_figure(shortest_report(4), imucal.drift(shortest_report(4)))
    assert [axes.get_ylabel() for axes in alone.axes] == ["velocity (m/s)", "position (m)"]


def test_lines_go_through_the_computed_drift() -> None:
    """The requested times are marked and labelled, with the dominant term."""
    report = consumer_report()
    found = imucal.drift(report, [2.0, 30.0])
    for axes, name, factor in zip(
        drift_figure(report, found).axes,
        ("heading", "velocity, both", "position, both"),
        (180 / np.pi, 1.0, 1.0),
        strict=True,
    ):
        points = next(one.points for one in found.quantities if one.name == name)
        expected = [factor * (point.value or np.nan) for point in points]
        marks = np.concatenate([line.get_xydata() for line in axes.lines if line.get_marker() == "o"])
        npt.assert_allclose(marks, np.transpose([[2.0, 30.0], expected]))
        assert [text.get_text().split("\n")[1] for text in axes.texts] == [p.term for p in points]
        (main,) = (
            np.array(line.get_xydata()) for line in axes.lines if line.get_label() in {"heading", "both"}
        )
        npt.assert_allclose(main[[0, -1]], marks)


def test_times_beyond_the_record_are_shaded() -> None:
    """If the record is long enough, nothing is shaded."""
    short = drift_figure(small_report(), imucal.drift(small_report()))
    assert all(axes.texts[-1].get_text().strip() == "extrapolated" for axes in short.axes)
    seen = drift_figure(consumer_report(), imucal.drift(consumer_report()))
    assert all("extrapolated" not in text.get_text() for axes in seen.axes for text in axes.texts)


def test_a_single_time_and_a_bound_are_drawn() -> None:
    """A single time has a mark without a line, and a bound is marked as a bound."""
    report = small_report()
    white = replace(report.axes[0].fit["N"], status="bounded", value=None, low=0.0)
    fit = replace(report.axes[0].fit, model=NoiseModel(terms=()), estimates=(white,))
    bounded = replace(report, axes=(replace(report.axes[0], fit=fit),))
    axes = drift_figure(bounded, imucal.drift(bounded, [5.0])).axes[0]
    assert axes.texts[0].get_text().startswith("< ")


def test_the_picture_of_a_drift_is_reproducible() -> None:
    """Two renderings are equal byte by byte, and contain the log's name at the bottom."""
    one, other = (drift_figure(small_report(), imucal.drift(small_report())) for _ in range(2))
    assert render(one, "png") == render(other, "png")
    assert "still_night.mcap" in [text.get_text() for text in one.texts]
