"""Place labels next to their points, inside the plot and without overlap.

Each label takes the cheapest position on circles around its anchor. Positions are in pixels, so the layout of
the figure must be final.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from imucal.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backend_bases import RendererBase
    from matplotlib.text import Annotation

#: From the anchor, in points.
_DISTANCES = (7.0, 14.0, 24.0, 36.0, 50.0, 68.0, 90.0, 115.0, 145.0, 180.0)
_ANGLES = np.deg2rad([45, 315, 135, 225, 90, 270, 0, 180, 22, 338, 158, 202, 67, 293, 113, 247])
_PAD = 2.5
#: Cost of covering another label; leaving the plot costs ten times as much.
_TAKEN = 1e3


class Label(NamedTuple):
    """A text for one point of the data (a mark), or for the best of k points of a line."""

    text: str
    x: float | FloatArray
    y: float | FloatArray
    colour: str


class _Box(NamedTuple):
    x0: float
    y0: float
    x1: float
    y1: float

    def overlaps(self, other: "_Box") -> bool:
        return self.x0 < other.x1 and other.x0 < self.x1 and self.y0 < other.y1 and other.y0 < self.y1

    def within(self, frame: "_Box") -> bool:
        return frame.x0 <= self.x0 and self.x1 <= frame.x1 and frame.y0 <= self.y0 and self.y1 <= frame.y1

    @property
    def middle(self) -> FloatArray:
        return np.array([(self.x0 + self.x1) / 2, (self.y0 + self.y1) / 2])

    def grown(self, pad: float) -> "_Box":
        return _Box(self.x0 - pad, self.y0 - pad, self.x1 + pad, self.y1 + pad)

    def holds(self, points: FloatArray) -> int:
        x, y = points[:, 0], points[:, 1]
        return int(np.count_nonzero((x > self.x0) & (x < self.x1) & (y > self.y0) & (y < self.y1)))


def place_labels(
    axes: "Axes",
    labels: list[Label],
    *,
    obstacles: list[tuple[FloatArray, FloatArray, float]],
    fontsize: float,
) -> list["Annotation"]:
    """Write `labels` where they cover least; the limits and the position of `axes` must be final.

    `obstacles` are lines to avoid: x and y of the data, and the cost per covered point.
    """
    if not labels:
        return []
    figure = axes.figure.figure
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    scale = figure.dpi / 72
    room = _Room(
        frame=_Box(*axes.get_window_extent(renderer).extents).grown(-_PAD * scale),
        scale=scale,
        points=[(_dense(axes, x, y), cost) for x, y, cost in obstacles],
    )
    anchors = [axes.transData.transform(np.column_stack([label.x, label.y])) for label in labels]
    room.taken += [_Box(x, y, x, y).grown(4 * scale) for (x, y), *more in anchors if not more]
    written = []
    # Labels of lines are more flexible than marks.
    pairs = zip(labels, anchors, strict=True)
    for label, points in sorted(pairs, key=lambda pair: (len(pair[1]) > 1, room.freedom(pair[1]))):
        anchor, box = room.best(points, _size(axes, label.text, fontsize, renderer))
        room.take(anchor, box)
        offset = (box.middle - anchor) / scale
        place = axes.transData.inverted().transform(anchor)
        written.append(_write(axes, label, place, offset, fontsize))
    return written


_Place: TypeAlias = tuple[float, FloatArray, _Box]


@dataclass(kw_only=True)
class _Room:
    frame: _Box
    scale: float
    points: list[tuple[FloatArray, float]]
    taken: list[_Box] = field(default_factory=list)
    leaders: list[FloatArray] = field(default_factory=list)

    def freedom(self, anchors: FloatArray) -> float:
        x = anchors[:, 0]
        return float(np.minimum(x - self.frame.x0, self.frame.x1 - x).min())

    def best(self, anchors: FloatArray, size: tuple[float, float]) -> tuple[FloatArray, _Box]:
        distances = _DISTANCES if len(anchors) == 1 else _DISTANCES[:4]
        near = (
            (distance / 30, anchor, _box_near(anchor, size, distance * self.scale, float(angle)))
            for anchor in anchors
            for distance in distances
            for angle in _ANGLES
        )
        lowest, anchor, box = self._lowest(near)
        if lowest >= _TAKEN:
            farther = self._lowest(self._anywhere(anchors, size))
            return (anchor, box) if lowest <= farther[0] else farther[1:]
        return anchor, box

    def _lowest(self, places: Iterable[_Place]) -> _Place:
        best = (math.inf, np.zeros(2), _Box(0, 0, 0, 0))
        for cost, anchor, box in places:
            if cost < best[0] and (total := cost + self._cost(anchor, box)) < best[0]:
                best = (total, anchor, box)
        return best

    def _anywhere(self, anchors: FloatArray, size: tuple[float, float]) -> Iterator[_Place]:
        frame = self.frame
        for x in np.linspace(frame.x0, frame.x1 - size[0], 12):
            for y in np.linspace(frame.y0, frame.y1 - size[1], 24):
                box = _Box(x, y, x + size[0], y + size[1])
                away = np.hypot(anchors[:, 0] - x - size[0] / 2, anchors[:, 1] - y - size[1] / 2)
                nearest = int(np.argmin(away))
                yield float(away[nearest]) / 30 / self.scale, anchors[nearest], box

    def take(self, anchor: FloatArray, box: _Box) -> None:
        self.taken.append(box.grown(_PAD * self.scale))
        leader = _leader(anchor, box)
        self.points.append((leader, 6.0))
        self.leaders.append(leader)

    def _cost(self, anchor: FloatArray, box: _Box) -> float:
        cost = 10 * _TAKEN * (not box.within(self.frame))
        cost += _TAKEN * sum(box.overlaps(other) for other in self.taken)
        if cost:
            return cost
        leader = _leader(anchor, box)
        others = [other for other in self.taken if not other.holds(anchor[None, :])]
        crossed = sum(other.holds(leader) for other in others)
        crossed += 2 * sum(_cross(leader, other) for other in self.leaders)
        return 20.0 * crossed + sum(box.holds(points) * weight for points, weight in self.points)


def _leader(anchor: FloatArray, box: _Box) -> FloatArray:
    steps = np.linspace(0, 1, 40)[:, None]
    line = anchor + steps * (box.middle - anchor)
    inside = (line[:, 0] > box.x0) & (line[:, 0] < box.x1) & (line[:, 1] > box.y0) & (line[:, 1] < box.y1)
    return np.asarray(line[~inside], dtype=np.float64)


def _cross(one: FloatArray, other: FloatArray) -> bool:
    """Return whether two straight lines cross, given by points, shape (k, 2)."""
    if len(one) < 2 or len(other) < 2:
        return False
    (a, b), (c, d) = one[[0, -1]], other[[0, -1]]

    def side(p: FloatArray, q: FloatArray, r: FloatArray) -> bool:
        return bool((q[0] - p[0]) * (r[1] - p[1]) > (q[1] - p[1]) * (r[0] - p[0]))

    return side(a, b, c) != side(a, b, d) and side(c, d, a) != side(c, d, b)


def _box_near(anchor: FloatArray, size: tuple[float, float], distance: float, angle: float) -> _Box:
    """Return the box whose nearest edge is `distance` from the anchor, in direction `angle`."""
    x = anchor[0] + math.cos(angle) * (distance + size[0] / 2)
    y = anchor[1] + math.sin(angle) * (distance + size[1] / 2)
    return _Box(x - size[0] / 2, y - size[1] / 2, x + size[0] / 2, y + size[1] / 2)


def _dense(axes: "Axes", x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the line in pixels, shape (k, 2), so dense that no label fits between two points."""
    finite = np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)
    points = axes.transData.transform(np.column_stack([x[finite], y[finite]]))
    if len(points) < 2:
        return np.asarray(points, dtype=np.float64).reshape(-1, 2)
    steps = np.hypot(*np.diff(points, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    fine = np.linspace(0, along[-1], min(2000, max(2, int(along[-1] / 4))))
    return np.column_stack([np.interp(fine, along, points[:, 0]), np.interp(fine, along, points[:, 1])])


def _size(axes: "Axes", text: str, fontsize: float, renderer: "RendererBase") -> tuple[float, float]:
    trial = axes.text(0.5, 0.5, text, fontsize=fontsize, transform=axes.transAxes)
    extent = trial.get_window_extent(renderer)
    trial.remove()
    return extent.width, extent.height


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
