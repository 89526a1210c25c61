"""The evidence of a row as plain data: curves, marks and limits around the worst place of a log."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from imucal.arrays import FloatArray, IntArray, ReadOnlyArrays
from imucal.recording import AxisSeries
from imucal.units import pretty

__all__ = ["Curve", "Evidence", "Limit", "Look", "Span", "merged", "near", "samples_shown", "thinned"]

#: samples: a line, with dots if they are few; marks: the bad ones; bars: lengths with names.
Look: TypeAlias = Literal["samples", "line", "dots", "marks", "bars"]
#: Start and end, in s.
Span: TypeAlias = tuple[float, float]

#: Most points of a curve: two for each pixel of a picture of 1600 pixels.
_MOST_POINTS = 3000
#: Most marks of a curve: more can't be told apart.
_MOST_MARKS = 500
#: Most shaded spans: more can't be told apart.
_MOST_SPANS = 300
#: Samples on both sides of a bad place.
_BESIDE = 25
#: Most samples around a bad place, so that single samples can be seen.
_MOST_SAMPLES = 600


@dataclass(frozen=True, kw_only=True, eq=False)
class Curve(ReadOnlyArrays):
    """Points of one kind, shape (n,); NaN breaks a line."""

    label: str
    x: FloatArray
    y: FloatArray
    look: Look = "samples"


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A line across the picture: level, or upright at a value of x."""

    label: str
    value: float
    upright: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """What a picture of a row shows.

    Attributes
    ----------
    title
        What is drawn, in a few words.
    x_label, y_label
        Quantity and unit of the scales.
    curves, limits
        What is drawn; at most some thousand points.
    shaded, shade_label
        Spans of x with a background, such as rests, and their name.
    names
        Names of bars, from top to bottom; empty without bars.
    log_x, log_y
        Whether a scale is logarithmic.
    """

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    limits: tuple[Limit, ...] = ()
    shaded: tuple[Span, ...] = ()
    shade_label: str = "at rest"
    names: tuple[str, ...] = ()
    log_x: bool = False
    log_y: bool = False

    @property
    def marks(self) -> tuple[Curve, ...]:
        """The curves of bad points."""
        return tuple(curve for curve in self.curves if curve.look == "marks")


def thinned(x: FloatArray, y: FloatArray, *, most: int = _MOST_POINTS) -> tuple[FloatArray, FloatArray]:
    """Return at most `most` points; the lowest and the highest of each part are kept, in order."""
    if x.size <= most:
        return x, y
    size = -(-x.size // (most // 2))
    padded = np.full(-(-x.size // size) * size, np.nan)
    padded[: y.size] = y
    parts = padded.reshape(-1, size)
    firsts = np.arange(len(parts)) * size
    low = np.where(np.isnan(parts), np.inf, parts).argmin(axis=1)
    high = np.where(np.isnan(parts), -np.inf, parts).argmax(axis=1)
    keep = np.sort(np.concatenate([firsts + low, firsts + high]))
    keep = keep[keep < x.size]
    return x[keep], y[keep]


def near(first: int, stop: int, size: int) -> slice:
    """Return the samples around the bad ones from `first` to before `stop`, or around their start."""
    beside = max(_BESIDE, (stop - first) // 4)
    start = max(first - beside, 0)
    return slice(start, min(stop + beside, size, start + _MOST_SAMPLES))


def samples_shown(
    series: Sequence[AxisSeries],
    part: slice,
    *,
    bad: IntArray | None = None,
    bad_label: str = "",
    heights: FloatArray | None = None,
    title: str,
) -> Evidence:
    """Return samples of axes with one clock, with the bad ones of the first axis marked.

    `bad` contains their indices. `heights`, shape (n,), are where they are marked; by default at the samples.
    """
    first = series[0]
    clock = first.clock
    times = clock.grid(part.start, part.stop) * first.tau0
    after_gap = np.flatnonzero(np.diff(times) > 1.5 * first.tau0) + 1
    x = np.insert(times, after_gap, np.nan)
    curves = [Curve(label=one.name, x=x, y=np.insert(one.samples[part], after_gap, np.nan)) for one in series]
    if bad is not None:
        inside = bad[(bad >= part.start) & (bad < part.stop)][:_MOST_MARKS]
        y = first.samples[inside] if heights is None else heights[inside]
        curves.append(Curve(label=bad_label, x=times[inside - part.start], y=y, look="marks"))
    return Evidence(
        title=title,
        x_label="time (s)",
        y_label=f"{first.sensor} ({pretty(first.unit)})",
        curves=tuple(curves),
    )


def merged(spans: Sequence[Span]) -> tuple[Span, ...]:
    """Return spans in order of time, joined where they touch."""
    joined: list[Span] = []
    for start, end in spans:
        if joined and start <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(end, joined[-1][1])
        else:
            joined.append((float(start), float(end)))
    return tuple(joined[:_MOST_SPANS])
