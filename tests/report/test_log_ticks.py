"""Ticks of logarithmic axes for any limits."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucal.report.figure_style import draw_ticks, tick_label, tick_places


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
        (2.1, 4.9, [3, 4]),
        (0.31, 0.36, [0.31, 0.36]),
        (1, 100, [1, 10, 100]),
        (1, 99, [1, 2, 5, 10, 20, 50]),
        (1.6, 2.9, [1.6, 2.9]),
        (1e-3, 1e4, [1e-3, 1e-2, 0.1, 1, 10, 100, 1e3, 1e4]),
        (1e-3, 1e5, [1e-2, 1, 100, 1e4]),
        (1e-9, 1e9, [1e-9, 1e-6, 1e-3, 1, 1e3, 1e6, 1e9]),
    ],
)
def test_ticks_are_few_and_round(low: float, high: float, major: list[float]) -> None:
    """Ticks are decades, every third decade in a large range, and 1, 2, 5 in a small one."""
    assert tick_places(low, high)[0] == pytest.approx(major)


@pytest.mark.parametrize(
    ("low", "high", "minor"),
    [
        (0.8, 30, [0.8, 0.9, *range(1, 10), 10, 20, 30]),
        (2.1, 4.9, []),
        (1, 100, [*range(1, 10), *range(10, 100, 10), 100]),
        (1e-3, 1e5, [10.0**e for e in range(-3, 6)]),
    ],
)
def test_minor_ticks_fill_the_space(low: float, high: float, minor: list[float]) -> None:
    """Minor ticks are all digits of a decade, or decades if not all are labelled.

    There are none if every digit is labelled.
    """
    assert tick_places(low, high)[1] == pytest.approx(minor)


@given(low=st.floats(1e-15, 1e12), factor=st.floats(1.05, 1e20))
def test_ticks_increase_within_the_limits(low: float, factor: float) -> None:
    """There are two to ten different labels."""
    high = low * factor
    major, minor = tick_places(low, high)
    assert 2 <= len(major) <= 10
    assert major == sorted(set(major))
    # The tolerance of 1e-9 allows for the rounding of 10**e.
    assert all(low * (1 - 1e-9) <= place <= high * (1 + 1e-9) for place in (*major, *minor))
    assert len({tick_label(place) for place in major}) == len(major)


def test_minor_ticks_are_at_their_values_on_both_axes() -> None:
    """The tick of 2 is at log 2 of a decade, from the left edge and from the bottom."""
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    axes = Figure().add_subplot()
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(0.1, 100)
    axes.set_ylim(0.1, 100)
    draw_ticks(axes)
    (marks,) = (artist for artist in axes.collections if isinstance(artist, LineCollection))
    feet = {tuple(np.asarray(path.vertices)[0].round(6).tolist()) for path in marks.get_paths()}
    places = {round(math.log10(m * 10**e) / 3, 6) for e in range(3) for m in range(1, 10)} | {1.0}
    assert feet == {(place, 0.0) for place in places} | {(0.0, place) for place in places}
