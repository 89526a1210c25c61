"""Labels use the nearest free place, and their leaders cross nothing."""

import itertools

import numpy as np
import numpy.testing as npt
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Bbox

from imucal.arrays import FloatArray
from imucal.report.labels import Label, Obstacle, place_labels

#: Pixels per point.
_SCALE = 2


def _axes() -> tuple[Figure, Axes]:
    """Return logarithmic axes, 1440 pixels wide and 720 high: 360 pixels a decade."""
    figure = Figure(figsize=(10, 5), dpi=144)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xscale="log", yscale="log", xlim=(1, 1e4), ylim=(1, 1e2))
    return figure, axes


def _label(text: str, *x: float, y: float = 10.0) -> Label:
    return Label(text=text, x=np.array(x), y=np.full(len(x), y), colour="#123456")


def _place(axes: Axes, *labels: Label, obstacles: tuple[Obstacle, ...] = ()) -> list[Annotation]:
    return place_labels(axes, labels, obstacles=obstacles, fontsize=9.0)


def _box(text: Annotation) -> Bbox:
    """Return the box of the words, without the leader."""
    renderer = text.figure.figure.canvas.get_renderer()  # type: ignore[attr-defined]
    text.update_positions(renderer)
    return Text.get_window_extent(text, renderer)


def _middle(box: Bbox) -> FloatArray:
    return np.array([(box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2])


def test_labels_are_next_to_their_points() -> None:
    """The mark nearest to a side comes first, lines come last. Offsets are in points, at any resolution."""
    _, axes = _axes()
    written = _place(axes, _label("line", 30.0, 300.0), _label("middle", 100.0), _label("side", 1000.0))
    assert [text.get_text() for text in written] == ["side", "middle", "line"]
    npt.assert_allclose([text.xy for text in written[:2]], [(1000, 10), (100, 10)])
    for text in written[:2]:
        # Above the mark, because at 45 degrees the label would cover a corner of the mark.
        npt.assert_allclose(text.xyann, [0, 7 + _box(text).height / _SCALE / 2], atol=1e-6)
    assert _place(axes) == []


def test_a_label_avoids_a_line() -> None:
    """A line through the first place moves the label to the other side of its point."""
    _, axes = _axes()
    obstacle = Obstacle(np.array([100.0, 1e4]), np.array([11.0, 12.0]), 2.0)
    (written,) = _place(axes, _label("N", 100.0), obstacles=(obstacle,))
    assert written.xyann[1] < 0


def test_an_obstacle_without_a_place_on_logarithmic_axes_is_ignored() -> None:
    _, axes = _axes()
    nowhere = Obstacle(np.array([10.0, -1.0, np.nan]), np.array([0.0, 5.0, 5.0]), 2.0)
    (free,) = _place(axes, _label("N", 100.0))
    (written,) = _place(
        axes, _label("N", 100.0), obstacles=(nowhere, Obstacle(np.zeros(0), np.zeros(0), 2.0))
    )
    assert written.xyann == free.xyann


def test_a_line_is_labelled_at_its_free_point() -> None:
    """The two other points are between lines that are closer than the height of a label."""
    _, axes = _axes()
    lines = [Obstacle(np.array([1.0, 300.0]), np.full(2, y), 2.0) for y in np.geomspace(1, 100, 60)]
    (written,) = _place(axes, _label("K", 3.0, 30.0, 3000.0), obstacles=tuple(lines))
    assert written.xy[0] == pytest.approx(3000)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_labels_of_the_same_point_do_not_overlap(count: int) -> None:
    """They are around the point, and no leader crosses another label."""
    _, axes = _axes()
    written = _place(axes, *(_label(f"label {i}", 100.0) for i in range(count)))
    boxes = [_box(text) for text in written]
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))
    point = axes.transData.transform((100.0, 10.0))
    for own, other in itertools.permutations(boxes, 2):
        leader = np.linspace(point, _middle(own), 100)
        assert not any(other.contains(*place) for place in leader)


def test_leaders_do_not_cross() -> None:
    """Marks side by side have leaders in the order of the marks."""
    _, axes = _axes()
    written = _place(axes, *(_label(f"{x:.4g} Hz, a tone", x) for x in (100.0, 104.0, 108.0, 112.0)))
    ends = [(axes.transData.transform(text.xy), _middle(_box(text))) for text in written]
    for (a, b), (c, d) in itertools.combinations(ends, 2):
        along, across = np.linalg.lstsq(np.column_stack([b - a, c - d]), c - a)[0]
        meet = np.allclose(a + along * (b - a), c + across * (d - c))
        assert not (meet and 0 < along < 1 and 0 < across < 1)


@pytest.mark.parametrize("side", ["left", "right", "bottom", "top"])
def test_labels_keep_a_distance_from_the_frame(side: str) -> None:
    """The distance is 2.5 points on each side for any mark; the text itself gives its extent."""
    figure = Figure(figsize=(4, 3), dpi=144)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))
    axes.set(xlim=(0, 1), ylim=(0, 1))
    renderer = canvas.get_renderer()  # type: ignore[no-untyped-call]
    frame = axes.get_window_extent(renderer)
    for away in np.linspace(0.005, 0.3, 40):
        near = {"left": (away, 0.5), "right": (1 - away, 0.5), "bottom": (0.5, away), "top": (0.5, 1 - away)}
        x, y = near[side]
        (written,) = _place(axes, _label("N", x, y=y))
        box = _box(written)
        gaps = (box.x0 - frame.x0, frame.x1 - box.x1, box.y0 - frame.y0, frame.y1 - box.y1)
        # The tolerance of one pixel covers the rounding of text.
        assert min(gaps) > 2.5 * _SCALE - 1
        written.remove()
