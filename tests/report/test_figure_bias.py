"""The picture of a decomposition: panels, units and reproducibility."""

import numpy as np
import numpy.testing as npt
import pytest

from imucal import AxisSeries, NoiseModel, decompose
from imucal.fitting.decomposition import Decomposition
from imucal.report.figure import render
from imucal.report.figure_bias import averages, bias_figure


def _parts(text: str, *, sensor: str = "gyroscope", n: int = 2000, level: float = 0.0) -> Decomposition:
    model = NoiseModel.parse(text)
    samples = level + model.simulate(n, rate_hz=10.0, rng=np.random.default_rng(61))
    series = AxisSeries.from_samples(samples, rate_hz=10.0, sensor=sensor, axis="z")
    keep = np.ones(n, dtype=bool)
    keep[500:700] = False
    return decompose(series.keeping(keep), model)


def test_each_part_has_its_panel() -> None:
    """The bias is at the top, then each part except the level. A single part equals the bias."""
    figure = bias_figure(_parts("N=1e-3 + B=5e-4 + K=1e-4 + R=1e-6"))
    top, *parts = figure.axes
    assert top.get_ylabel() == "bias minus its mean (deg/h)"
    assert [axes.texts[0].get_text() for axes in parts] == [
        "B  flicker noise", "K  rate random walk, minus its mean", "R  rate ramp",
    ]  # fmt: skip
    assert parts[-1].get_xlabel() == "time (s)"
    assert len(bias_figure(_parts("N=1e-3 + B=5e-4")).axes) == 1


@pytest.mark.parametrize(("factor", "unit", "size"), [(1e-4, "µg", 1e6), (1.0, "µg", 1e6)])
def test_the_bias_is_drawn_in_data_sheet_units(factor: float, unit: str, size: float) -> None:
    """The mean is subtracted."""
    parts = _parts(f"N={factor:g} + B={factor / 2:g}", sensor="accelerometer", level=9.81)
    (axes,) = bias_figure(parts).axes
    assert axes.get_ylabel() == f"bias minus its mean ({unit})"
    drawn = next(line for line in axes.lines if line.get_label() == "bias, estimated from all samples")
    scale = size / 9.80665
    place = np.unique(np.linspace(0, parts.n - 1, 1500).round().astype(int))
    expected = (parts.bias.value - parts.bias.value.mean())[place] * scale
    npt.assert_allclose(np.asarray(drawn.get_ydata()), expected, atol=1e-9 * np.ptp(expected))


def test_averages_skip_missing_samples() -> None:
    """An average without samples is NaN, and the last one has fewer samples."""
    parts = _parts("N=1 + K=0.1")
    time, mean, count = averages(parts, 150)
    assert time[0] == pytest.approx(7.45)
    assert count.tolist()[:5] == [150, 150, 150, 50, 50]
    assert mean[0] == pytest.approx(parts.samples[:150].mean())
    assert np.isnan(averages(parts, 100)[1][5])
    assert count[-1] == 2000 - 13 * 150


def test_the_picture_of_a_bias_is_reproducible() -> None:
    """Two renderings are equal byte by byte, and contain the log's name at the bottom."""
    parts = _parts("N=1e-3 + B=5e-4 + K=1e-4")
    first = render(bias_figure(parts, source="a $b$ log.mcap"), "png")
    assert first == render(bias_figure(parts, source="a $b$ log.mcap"), "png")
    assert b"a $b$ log.mcap" not in first
    assert any(
        text.get_text() == "a $b$ log.mcap" for text in bias_figure(parts, source="a $b$ log.mcap").texts
    )


def test_a_constant_bias_is_drawn() -> None:
    """White noise alone gives a level with its band."""
    (axes,) = bias_figure(_parts("N=1e-3")).axes
    low, high = axes.get_ylim()
    assert low < 0 < high
