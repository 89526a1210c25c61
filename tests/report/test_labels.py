"""Labels use the nearest free place, and their leaders cross nothing."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.testing as npt
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from imucal.arrays import FloatArray
from imucal.report.labels import (
    Label,
    _Box,
    _box_near,
    _cross,
    _dense,
    _leader,
    _Room,
    place_labels,
)

_SIZE = (20.0, 10.0)


def _points(*points: Sequence[float]) -> FloatArray:
    return np.array(points, dtype=np.float64)


def _room() -> _Room:
    return _Room(frame=_Box(0, 0, 200, 100), scale=1.0, points=[])


def _middle(box: _Box) -> tuple[float, float]:
    return (box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2


def test_boxes_that_touch_do_not_overlap() -> None:
    """A box may touch its frame, and a point on its edge is outside."""
    box = _Box(0, 0, 4, 2)
    for other in (_Box(4, 0, 8, 2), _Box(-4, 0, 0, 2), _Box(0, 2, 4, 4), _Box(0, -2, 4, 0)):
        assert not box.overlaps(other)
        assert box.overlaps(other.grown(0.1))
        assert not box.within(other)
    assert box.within(box)
    for side in (_Box(0.1, 0, 4, 2), _Box(0, 0.1, 4, 2), _Box(0, 0, 3.9, 2), _Box(0, 0, 4, 1.9)):
        assert not box.within(side)
    assert box.grown(1.5) == _Box(-1.5, -1.5, 5.5, 3.5)
    assert box.holds(_points((1, 1), (0, 1), (4, 1), (1, 0), (1, 2), (3, 1.9))) == 2


@pytest.mark.parametrize(
    ("angle", "box"),
    [(0, (13, 19, 17, 21)), (90, (8, 23, 12, 25)), (180, (3, 19, 7, 21)), (270, (8, 15, 12, 17))],
)
def test_a_label_is_next_to_its_point(angle: float, box: tuple[float, ...]) -> None:
    """The nearest edge of the label has the distance 3 from the point (10, 20)."""
    found = _box_near(_points((10, 20))[0], (4.0, 2.0), 3.0, math.radians(angle))
    npt.assert_allclose([found.x0, found.y0, found.x1, found.y1], box, atol=1e-12)


def test_a_leader_ends_at_the_edge_of_its_box() -> None:
    """There are 40 steps to the middle at 12; those inside the box, beyond 10, are removed."""
    leader = _leader(_points((0, 0))[0], _Box(10, -1, 14, 1))
    npt.assert_allclose(leader, [(12 * k / 39, 0) for k in range(33)], atol=1e-12)
    upward = _leader(_points((0, 0))[0], _Box(-1, 10, 1, 14))
    npt.assert_allclose(upward, [(0, 12 * k / 39) for k in range(33)], atol=1e-12)
    downward = _leader(_points((0, 0))[0], _Box(-1, -14, 1, -10))
    npt.assert_allclose(downward, -upward, atol=1e-12)


@pytest.mark.parametrize(
    ("one", "other", "crosses"),
    [
        (((0, 0), (2, 2)), ((0, 2), (2, 0)), True),
        (((0, 0), (2, 2)), ((0, 1), (2, 3)), False),
        # The lines would cross if one were longer.
        (((0, 0), (1, 0)), ((2, -1), (2, 1)), False),
        (((0, 0), (1, 2)), ((3, -5), (1, 1)), False),
        # Two lines start at the same point.
        (((0, 0), (1, 1)), ((0, 0), (1, -1)), False),
        (((0, 0), (1, 1)), ((0, 0), (-1, 3)), False),
        # A leader inside its box has no points left.
        (((0, 0),), ((-1, 0), (1, 0.5)), False),
        ((), ((-1, 0), (1, 0)), False),
    ],
)
def test_crossing_lines_are_detected(
    one: Sequence[Sequence[float]], other: Sequence[Sequence[float]], *, crosses: bool
) -> None:
    """Only straight lines between the ends count; leaders start at their points."""
    first, second = _points(*one).reshape(-1, 2), _points(*other).reshape(-1, 2)
    assert _cross(first, second) is crosses
    assert _cross(second, first) is crosses


def test_the_cost_of_a_place_is_the_sum_of_its_overlaps() -> None:
    """Label 1000, edge 10 000, crossed leader 40, leader point in a box 20, line its own cost."""
    anchor, box = _points((50, 50))[0], _Box(80, 45, 100, 55)
    room = _room()
    assert room._cost(anchor, box) == 0
    assert room._cost(anchor, _Box(190, 45, 210, 55)) == 10_000
    room.points.append((_points((85, 50), (90, 50), (70, 50)), 3.0))
    assert room._cost(anchor, box) == 6
    room.leaders.append(_points((70, 40), (70, 60)))
    assert room._cost(anchor, box) == 6 + 40
    room.taken.append(_Box(46, 46, 54, 54))
    assert room._cost(anchor, box) == 6 + 40, "the leader starts in the anchor's own box"
    # The leader extends from 50 to 90 in 39 steps: two of its points lie between 60 and 62.
    room.taken.append(_Box(60, 49, 62, 51))
    assert room._cost(anchor, box) == 6 + 40 + 40
    room.taken += [_Box(90, 40, 95, 60), _Box(81, 40, 82, 60)]
    assert room._cost(anchor, box) == 2000
    assert room._cost(anchor, _Box(80, 45, 201, 55)) == 12_000


def test_a_used_place_is_kept_free() -> None:
    """The place consists of the box with a margin, and of every point of its leader."""
    room = _Room(frame=_Box(0, 0, 200, 100), scale=2.0, points=[])
    room.take(_points((50, 50))[0], _Box(80, 45, 100, 55))
    assert room.taken == [_Box(75, 40, 105, 60)]
    ((leader, cost),) = room.points
    assert cost == 6
    npt.assert_array_equal(leader, room.leaders[0])
    npt.assert_allclose(leader[0], [50, 50])


def test_the_nearest_free_place_is_used() -> None:
    """The order is up and right, then down and right. If near places are used, a farther one is chosen."""
    room, anchor = _room(), _points((100, 50))
    at, first = room.best(anchor, _SIZE)
    assert at.tolist() == [100, 50]
    assert first == _box_near(anchor[0], _SIZE, 7.0, math.radians(45))
    room.points.append((_points(_middle(first)), 1.0))
    assert room.best(anchor, _SIZE)[1] == _box_near(anchor[0], _SIZE, 7.0, math.radians(315))
    # All places nearer than 24 cover this box.
    room.taken.append(_Box(*anchor[0], *anchor[0]).grown(20))
    _, far = room.best(anchor, _SIZE)
    assert far in [_box_near(anchor[0], _SIZE, 24.0, math.radians(angle)) for angle in range(360)]


def test_a_line_is_labelled_at_its_free_point() -> None:
    """The label is next to the point without neighbours; the search stops after four distances."""
    room = _room()
    room.points.append((_points(*((x, y) for x in range(0, 120, 4) for y in range(0, 100, 4))), 5.0))
    at, box = room.best(_points((30, 50), (60, 50), (160, 50)), _SIZE)
    assert at.tolist() == [160, 50]
    assert box == _box_near(at, _SIZE, 7.0, math.radians(45))


@pytest.mark.parametrize("free", [(10, 10), (190, 90), (12, 90)])
def test_a_single_free_place_is_found_in_a_crowd(free: tuple[float, float]) -> None:
    """The place can be far from the point, with a long leader.

    The middle of the place is found up to the grid.
    """
    room = _room()
    room.taken += [
        box
        for x in range(0, 200, 8)
        for y in range(0, 100, 8)
        if not (box := _Box(x, y, x + 8, y + 8)).overlaps(_Box(*free, *free).grown(18))
    ]
    at, box = room.best(_points((100, 50)), (12.0, 6.0))
    assert at.tolist() == [100, 50]
    assert not any(box.overlaps(other) for other in room.taken)
    assert box.within(room.frame)


def test_distant_places_cover_the_frame_and_cost_their_distance() -> None:
    """A place belongs to the nearest point, and costs a thirtieth of the distance in points."""
    room = _Room(frame=_Box(10, 20, 210, 120), scale=2.0, points=[])
    anchors = _points((10, 20), (210, 120))
    places = list(room._anywhere(anchors, _SIZE))
    assert places[0][2] == _Box(10, 20, 30, 30)
    assert places[-1][2] == _Box(190, 110, 210, 120)
    assert len(places) == 12 * 24
    for cost, at, box in places:
        away = np.hypot(*(anchors - _middle(box)).T)
        assert cost == pytest.approx(away.min() / 60)
        assert at.tolist() == anchors[away.argmin()].tolist()


def test_freedom_is_the_distance_to_the_nearer_side() -> None:
    """The point with the smallest distance counts."""
    room = _Room(frame=_Box(10, 0, 110, 50), scale=1.0, points=[])
    assert room.freedom(_points((30, 20))) == 20
    assert room.freedom(_points((30, 20), (105, 20))) == 5


def _axes() -> tuple[Figure, Axes]:
    figure = Figure(figsize=(10, 5), dpi=144)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xscale="log", yscale="log", xlim=(1, 1e4), ylim=(1, 1e2))
    return figure, axes


def test_the_points_of_a_line_are_too_dense_for_a_label() -> None:
    """There is a point at least every 4 pixels. Values without a place on logarithmic axes are removed."""
    _, axes = _axes()
    x, y = _points((1, 10, 10, -1, np.nan, 3), (1, 1, 100, 5, 5, 0))
    fine = _dense(axes, x, y)
    # The line goes 360 pixels to the right, then 720 up.
    assert len(fine) == 270
    npt.assert_allclose(fine[[0, -1]], [(0, 0), (360, 720)], atol=1e-9)
    steps = np.hypot(*np.diff(fine, axis=0).T)
    assert steps.max() == pytest.approx(1080 / 269)
    assert _dense(axes, np.array([10.0, -1.0]), np.array([10.0, 1.0])).tolist() == [[360, 360]]
    assert _dense(axes, np.zeros(0), np.zeros(0)).shape == (0, 2)


def test_labels_are_next_to_their_points() -> None:
    """The mark nearest to a side comes first, lines come last. Offsets are in points, at any resolution."""
    figure, axes = _axes()

    def label(text: str, *x: float) -> Label:
        return Label(text=text, x=np.array(x), y=np.full(len(x), 10.0), colour="#123456")

    labels = [label("line", 30.0, 300.0), label("middle", 100.0), label("side", 1000.0)]
    written = place_labels(axes, labels, obstacles=[], fontsize=9.0)
    assert [text.get_text() for text in written] == ["side", "middle", "line"]
    npt.assert_allclose([text.xy for text in written[:2]], [(1000, 10), (100, 10)])
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    for text in written[:2]:
        # The label is above the mark, because at 45 degrees it would cover the line. There are 144 pixels and
        # 72 points per inch.
        npt.assert_allclose(text.xyann, [0, 7 + Text.get_window_extent(text, renderer).height / 4], atol=1e-6)
    assert place_labels(axes, [], obstacles=[], fontsize=9.0) == []


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
        label = Label(text="N", x=np.array(near[side][:1]), y=np.array(near[side][1:]), colour="k")
        (written,) = place_labels(axes, [label], obstacles=[], fontsize=8)
        written.update_positions(renderer)
        box = Text.get_window_extent(written, renderer)
        gaps = (box.x0 - frame.x0, frame.x1 - box.x1, box.y0 - frame.y0, frame.y1 - box.y1)
        # The tolerance of one pixel covers the rounding of text.
        assert min(gaps) > 2.5 * 2 - 1
        written.remove()
