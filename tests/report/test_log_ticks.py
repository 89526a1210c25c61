"""Ticks of logarithmic axes for any limits."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucal.report.figure_style import new_figure, style_axes, tick_label, tick_places


@pytest.mark.parametrize(
    ("value", "label"),
    [
        (1.0, "1"),
        (0.01, "0.01"),
        (1000.0, "1000"),
        (1e4, "10⁴"),
        (1e-3, "10⁻³"),
        (2e-5, "2×10⁻⁵"),
        (0.5, "0.5"),
        (1e-12, "10⁻¹²"),
        (9000.0, "9000"),
        (0.009, "9×10⁻³"),
        # The binary value of a power of ten.
        (0.01 * (1 - 1e-12), "0.01"),
        (1e5 * (1 - 1e-12), "10⁵"),
    ],
)
def test_labels_have_the_usual_form(value: float, label: str) -> None:
    """Labels are plain from 0.01 to 1000, and powers of ten otherwise."""
    assert tick_label(value) == label


@pytest.mark.parametrize(
    ("low", "high", "major"),
    [
        (3e-3, 5e3, [0.01, 0.1, 1, 10, 100, 1000]),
        (0.8, 30, [1, 2, 5, 10, 20]),
        (1, 100, [1, 10, 100]),
        (1, 99, [1, 2, 5, 10, 20, 50]),
        (1e-3, 1e4, [1e-3, 1e-2, 0.1, 1, 10, 100, 1e3, 1e4]),
        (1e-9, 1e9, [1e-9, 1e-6, 1e-3, 1, 1e3, 1e6, 1e9]),
    ],
)
def test_ticks_are_few_and_round(low: float, high: float, major: list[float]) -> None:
    """Ticks are decades, every third decade in a large range, and 1, 2, 5 in a small one."""
    assert tick_places(low, high)[0] == pytest.approx(major)


@given(low=st.floats(1e-15, 1e12), factor=st.floats(3.0, 1e20))
def test_ticks_increase_within_the_limits(low: float, factor: float) -> None:
    """There are two to ten different labels. Plots have margins, so the ratio of their limits is above 3."""
    high = low * factor
    major, minor = tick_places(low, high)
    assert 2 <= len(major) <= 10
    assert major == sorted(set(major))
    # The tolerance of 1e-9 allows for the rounding of 10**e.
    assert all(low * (1 - 1e-9) <= place <= high * (1 + 1e-9) for place in (*major, *minor))
    assert len({tick_label(place) for place in major}) == len(major)


def test_a_plot_has_the_same_ticks() -> None:
    """Minor ticks are 2 and 5 of each decade; they have no labels."""
    axes = new_figure(10, 5).add_subplot()
    style_axes(axes, x="x", y="y", x_limits=(0.03, 300), y_limits=(0.8, 30))
    axes.figure.canvas.draw()
    shown = [text.get_text() for text in axes.get_xticklabels()]
    assert [label for label in shown if label in {"0.1", "1", "10", "100"}] == ["0.1", "1", "10", "100"]
    minor = [place for place in axes.xaxis.get_minorticklocs() if 0.1 < place < 1]
    assert minor == pytest.approx([0.2, 0.5])
    assert not any(text.get_text() for text in axes.xaxis.get_minorticklabels())
