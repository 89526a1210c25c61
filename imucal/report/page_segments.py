"""The small picture of an axis's noise over time: N and the floor in each segment of the record.

Drawn as SVG in the page itself, so that it is there without any script, in the page's own colours.
Heights are relative to the record's value: one scale for every unit.
"""

import math
from collections.abc import Iterator
from itertools import count

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.noise_fit import Segments, Trace
from imucal.report import numbers
from imucal.report.figure import axis_title
from imucal.report.markup import Markup, element, join
from imucal.report.result import AxisReport

#: Size of the picture and of the margins about each of its rows, in its own units.
_WIDTH, _ROW, _LEFT, _RIGHT, _TOP, _BOTTOM = 640, 86, 56, 12, 24, 22
#: Least relative height of a row, and most: what is beyond it is cut.
_LEAST, _MOST = 0.02, 4.0
#: Most steps between the times that are named.
_MARKS = 6


def segments_figure(axis: AxisReport) -> Markup | None:
    """Return N and the floor over time with a caption; None where the record was not cut into segments."""
    segments = axis.fit.segments
    if segments is None or segments.white is None:
        return None
    rows: list[tuple[str, Trace, tuple[float, float] | None]] = [
        ("N", segments.white, _band(axis, "N", segments.white))
    ]
    if segments.floor is not None:
        at = numbers.seconds(segments.floor_tau_s)
        rows.append((f"floor (Allan deviation at {at})", segments.floor, None))
    height = len(rows) * (_ROW + _TOP) + _BOTTOM
    title = _title(axis, segments)
    drawn = [_row(segments, trace, band, name, i) for i, (name, trace, band) in enumerate(rows)]
    picture = element(
        "svg",
        *drawn,
        _times(segments, height),
        class_="over-time",
        viewBox=f"0 0 {_WIDTH} {height}",
        role="img",
        aria_label=title,
    )
    return element("figure", picture, element("figcaption", title), id=f"{axis.name}-over-time")


def _title(axis: AxisReport, segments: Segments) -> str:
    text = (
        f"{axis_title(axis)} in {segments.start_s.size} parts of the record, relative to their mean: "
        f"each with its {100 * axis.fit.level:.4g} % interval; the band is the interval of the whole."
    )
    changing = [f"{t.key} ({100 * t.spread:.2g} %)" for t in segments.changing]
    return f"{text} Not the same in all parts: {', '.join(changing)}." if changing else text


def _band(axis: AxisReport, key: str, trace: Trace) -> tuple[float, float]:
    """Return the interval of the whole record's value, relative to the segments' mean."""
    estimate, mean = axis.fit[key], _mean(trace)
    return estimate.low / mean, estimate.high / mean


def _mean(trace: Trace) -> float:
    """Return the geometric mean of a trace's values."""
    return float(np.exp(np.mean(np.log(trace.value))))


def _row(
    segments: Segments, trace: Trace, band: tuple[float, float] | None, name: str, number: int
) -> Markup:
    """Return one row: a bar for each segment, the band of the whole record, a scale."""
    mean = _mean(trace)
    low, value, high = (array / mean for array in (trace.low, trace.value, trace.high))
    ends = np.concatenate([low, high, np.array(band or ())])
    reach = float(np.clip(np.nanmax(np.abs(np.log(np.clip(ends, 1e-3, 1e3)))), _LEAST, math.log(_MOST)))
    top = _TOP + number * (_ROW + _TOP)

    def y(ratio: float) -> float:
        part = math.log(max(ratio, 1e-9)) / (1.08 * reach)
        return round(top + _ROW * (0.5 - 0.5 * max(-1.0, min(part, 1.0))), 1)

    parts = [_text(_LEFT, top - 6, name, class_="name")]
    for percent in _ticks(reach):
        at = y(1 + percent / 100)
        parts += [
            _line(_LEFT, at, _WIDTH - _RIGHT, at, "frame"),
            _text(_LEFT - 6, at + 4, f"{percent:+g} %" if percent else "0", text_anchor="end"),
        ]
    if band:
        parts.append(
            element(
                "rect",
                class_="whole",
                x=str(_LEFT),
                y=str(y(band[1])),
                width=str(_WIDTH - _RIGHT - _LEFT),
                height=f"{max(y(band[0]) - y(band[1]), 1):.1f}",
            )
        )
    for i, (start, end) in enumerate(
        zip(_x(segments, segments.start_s), _x(segments, segments.end_s), strict=True)
    ):
        middle = (start + end) / 2
        parts += [
            _line(middle, y(low[i]), middle, y(high[i]), "limits"),
            _line(start + 2, y(value[i]), end - 2, y(value[i]), "value"),
        ]
    return join(parts)


def _ticks(reach: float) -> list[float]:
    """Return the percentages that are named: zero and a round one on each side."""
    above = 100 * math.expm1(reach)
    step = next(s for s in (200, 100, 50, 20, 10, 5, 2, 1, 0.5) if s <= above)
    below = [-step] if step < 100 else [-50.0]
    return [step, 0.0, *below]


def _times(segments: Segments, height: int) -> Markup:
    """Return the names of some round times under the rows."""
    end = float(segments.end_s[-1])
    unit, name = (3600.0, "h") if end >= 2 * 3600 else (60.0, "min") if end >= 120 else (1.0, "s")
    step = next(s for s in _round_steps() if end / unit / s <= _MARKS)
    marks = step * unit * np.arange(math.floor(end / unit / step) + 1, dtype=np.float64)
    return join(
        _text(x, height - 6, f"{time / unit:g} {name}", text_anchor="middle")
        for time, x in zip(marks.tolist(), _x(segments, marks), strict=True)
    )


def _round_steps() -> Iterator[float]:
    """Yield 0.1, 0.2, 0.5, 1, 2, 5 and so on."""
    for power in count(-1):
        yield from (part * 10.0**power for part in (1, 2, 5))


def _x(segments: Segments, seconds: FloatArray) -> list[float]:
    """Return the places of times across the picture."""
    end = float(segments.end_s[-1])
    places: list[float] = (_LEFT + seconds / end * (_WIDTH - _RIGHT - _LEFT)).round(1).tolist()
    return places


def _line(x1: float, y1: float, x2: float, y2: float, class_: str) -> Markup:
    return element("line", class_=class_, x1=f"{x1:g}", y1=f"{y1:g}", x2=f"{x2:g}", y2=f"{y2:g}")


def _text(x: float, y: float, text: str, **attributes: str) -> Markup:
    return element("text", text, x=f"{x:g}", y=f"{y:g}", **attributes)
