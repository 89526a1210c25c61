"""Place labels next to their points, inside the plot and without overlap.

Each label takes the cheapest of some hundred boxes around its points. Positions are in pixels, so the layout
of the figure must be final.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from imucal.arrays import BoolArray, FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backend_bases import RendererBase
    from matplotlib.text import Annotation

#: Distances between a point and its label, in points.
_DISTANCES = np.array([7.0, 14.0, 24.0, 36.0, 50.0, 68.0, 90.0, 115.0, 145.0, 180.0])
#: Directions from a point to its label; of equal places the first is taken.
_ANGLES = np.deg2rad([45, 315, 135, 225, 90, 270, 0, 180, 22, 338, 158, 202, 67, 293, 113, 247])
#: Space around a label, and between a label and the frame, in points.
_PAD = 2.5
#: Half the size of the mark of a point, in points.
_MARK = 4.0
#: Distance between two points of a line, in points; less than the height of a label.
_STEP = 2.0
#: Cost of leaving the plot.
_OUTSIDE = 1e4
#: Cost of covering another label.
_TAKEN = 1e3
#: Cost of a leader that crosses another label or another leader.
_CROSSED = 100.0
#: Cost of each point of a leader that a label covers.
_LEADER = 6.0
#: Cost of each point of distance.
_AWAY = 1 / 15


class Label(NamedTuple):
    """A text for one point of the data (a mark), or for the best of k points of a line."""

    text: str
    x: float | FloatArray
    y: float | FloatArray
    colour: str


class Obstacle(NamedTuple):
    """A line of the data to avoid; `cost` is that of each covered point."""

    x: FloatArray
    y: FloatArray
    cost: float


def place_labels(
    axes: "Axes", labels: Sequence[Label], *, obstacles: Sequence[Obstacle], fontsize: float
) -> list["Annotation"]:
    """Write `labels` where they cover least; the limits and the position of `axes` must be final."""
    if not labels:
        return []
    figure = axes.figure.figure
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    plot = _Plot(axes, figure.dpi / 72, obstacles)
    anchors = [axes.transData.transform(np.column_stack([label.x, label.y])) for label in labels]
    marks = [points[0] for points in anchors if len(points) == 1]
    plot.boxes += [_grown(np.tile(mark, 2), _MARK * plot.scale) for mark in marks]
    written = []
    # Labels with fewer free places come first: those of marks, and of marks near a side.
    pairs = zip(labels, anchors, strict=True)
    for label, points in sorted(pairs, key=lambda pair: (len(pair[1]) > 1, plot.distance_to_side(pair[1]))):
        anchor, box = plot.place(points, _size(axes, label.text, fontsize, renderer))
        place = axes.transData.inverted().transform(anchor)
        written.append(_write(axes, label, place, (_middle(box) - anchor) / plot.scale, fontsize))
    return written


class _Plot:
    """The contents of a plot in pixels. A box is x0, y0, x1, y1; boxes have shape (k, 4)."""

    def __init__(self, axes: "Axes", scale: float, obstacles: Sequence[Obstacle]) -> None:
        self.scale = scale
        self.frame = _grown(np.array(axes.get_window_extent().extents), -_PAD * scale)
        self.boxes: list[FloatArray] = []
        self.leaders: list[tuple[FloatArray, FloatArray]] = []
        lines = [_dense(axes, obstacle.x, obstacle.y, _STEP * scale) for obstacle in obstacles]
        self.points = np.concatenate([np.zeros((0, 2)), *lines])
        costs = [np.full(len(line), each.cost) for line, each in zip(lines, obstacles, strict=True)]
        self.costs = np.concatenate([np.zeros(0), *costs])

    def distance_to_side(self, points: FloatArray) -> float:
        left, _, right, _ = self.frame
        return float(np.minimum(points[:, 0] - left, right - points[:, 0]).min())

    def place(self, anchors: FloatArray, size: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the anchor and the box of a label, and keep their space free."""
        points, distances, angles = (
            grid.ravel() for grid in np.meshgrid(np.arange(len(anchors)), _DISTANCES, _ANGLES, indexing="ij")
        )
        anchor = anchors[points]
        direction = np.column_stack([np.cos(angles), np.sin(angles)])
        middle = anchor + direction * (distances[:, None] * self.scale + size / 2)
        boxes = np.hstack([middle - size / 2, middle + size / 2])
        cost = _AWAY * distances + self._cost(boxes, anchor)
        best = int(np.argmin(cost))
        self._keep_free(anchor[best], boxes[best])
        return anchor[best], boxes[best]

    def _cost(self, boxes: FloatArray, anchors: FloatArray) -> FloatArray:
        """Return the cost of each box, shape (k,)."""
        inside = np.all((boxes[:, :2] >= self.frame[:2]) & (boxes[:, 2:] <= self.frame[2:]), axis=1)
        cost = np.where(inside, 0.0, _OUTSIDE) + _contain(boxes, self.points) @ self.costs
        middles = _middle(boxes)
        for box in self.boxes:
            overlap = np.all((boxes[:, :2] < box[2:]) & (box[:2] < boxes[:, 2:]), axis=1)
            cost += _TAKEN * overlap
            # A leader may start in the box of its own mark.
            other = ~_contain(box, anchors)
            for corners in (box, box[[0, 3, 2, 1]]):
                cost += _CROSSED / 2 * (other & _cross(anchors, middles, corners[:2], corners[2:]))
        for start, end in self.leaders:
            cost += _CROSSED * _cross(anchors, middles, start, end)
        return np.asarray(cost)

    def _keep_free(self, anchor: FloatArray, box: FloatArray) -> None:
        self.boxes.append(_grown(box, _PAD * self.scale))
        self.leaders.append((anchor, _middle(box)))
        leader = np.linspace(anchor, _middle(box), 40)
        leader = leader[~_contain(box, leader)]
        self.points = np.concatenate([self.points, leader])
        self.costs = np.concatenate([self.costs, np.full(len(leader), _LEADER)])


def _middle(boxes: FloatArray) -> FloatArray:
    return np.asarray((boxes[..., :2] + boxes[..., 2:]) / 2)


def _grown(box: FloatArray, pad: float) -> FloatArray:
    return box + pad * np.array([-1, -1, 1, 1])


def _contain(boxes: FloatArray, points: FloatArray) -> BoolArray:
    """Return whether boxes, shape (…, 4), contain points, shape (n, 2), as a matrix, shape (…, n)."""
    x0, y0, x1, y1 = np.moveaxis(boxes[..., None], -2, 0)
    x, y = points.T
    return np.asarray((x > x0) & (x < x1) & (y > y0) & (y < y1))


def _cross(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> BoolArray:
    """Return whether each straight line from `a` to `b`, shape (k, 2), crosses the one from `c` to `d`."""

    def left(p: FloatArray, q: FloatArray, r: FloatArray) -> BoolArray:
        (px, py), (qx, qy), (rx, ry) = p.T, q.T, r.T
        return np.asarray((qx - px) * (ry - py) > (qy - py) * (rx - px))

    return np.asarray((left(a, b, c) != left(a, b, d)) & (left(c, d, a) != left(c, d, b)))


def _dense(axes: "Axes", x: FloatArray, y: FloatArray, step: float) -> FloatArray:
    """Return the line in pixels, shape (k, 2), with a point every `step` pixels."""
    drawn = np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)
    points = np.asarray(axes.transData.transform(np.column_stack([x[drawn], y[drawn]])))
    if len(points) < 2:
        return points.reshape(-1, 2)
    lengths = np.hypot(*np.diff(points, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    fine = np.linspace(0, along[-1], min(2000, max(2, int(along[-1] / step))))
    return np.column_stack([np.interp(fine, along, points[:, 0]), np.interp(fine, along, points[:, 1])])


def _size(axes: "Axes", text: str, fontsize: float, renderer: "RendererBase") -> FloatArray:
    trial = axes.text(0.5, 0.5, text, fontsize=fontsize, transform=axes.transAxes)
    extent = trial.get_window_extent(renderer)
    trial.remove()
    return np.array([extent.width, extent.height])


def _write(
    axes: "Axes", label: Label, place: FloatArray, offset: FloatArray, fontsize: float
) -> "Annotation":
    return axes.annotate(
        label.text,
        place.tolist(),
        xytext=offset.tolist(),
        textcoords="offset points",
        annotation_clip=False,
        ha="center",
        va="center",
        fontsize=fontsize,
        color=label.colour,
        zorder=20,
        bbox={"boxstyle": "square,pad=0.12", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        arrowprops={"arrowstyle": "-", "color": label.colour, "linewidth": 0.7, "shrinkA": 0, "shrinkB": 3},
    )
