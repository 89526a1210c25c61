"""The table of a temperature ramp for the terminal and the page."""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from imucal.findings import phrase_of
from imucal.recording import Sensor
from imucal.temperature.curve import Curve
from imucal.temperature.result import VERDICTS, AxisThermal, Thermal
from imucal.units import G0, duration

__all__ = ["COLUMNS", "UNITS", "Row", "headline", "rows", "sentence", "table"]

#: Sensor -> unit in the table, and its factor.
UNITS: dict[Sensor, tuple[str, float]] = {
    Sensor.GYROSCOPE: ("deg/h", math.degrees(3600.0)),
    Sensor.ACCELEROMETER: ("mg", 1e3 / G0),
}
#: Titles of the columns.
COLUMNS = ("axis", "before", "after", "unseen", "cubic", "hysteresis", "unit", "order")
#: Digits of a number.
_DIGITS = 3
#: Text of an unknown number.
_UNKNOWN = "?"


@dataclass(frozen=True, kw_only=True)
class Row:
    """One axis as texts: rms of the bias before and after, and in unseen parts, that of the cubic there."""

    axis: str
    before: str
    after: str
    unseen: str
    cubic: str
    hysteresis: str
    unit: str
    curve: str

    @property
    def cells(self) -> tuple[str, ...]:
        return (
            self.axis,
            self.before,
            self.after,
            self.unseen,
            self.cubic,
            self.hysteresis,
            self.unit,
            self.curve,
        )


def sentence(found: Thermal) -> str:
    """Return the verdict with its reasons, such as ``Check first: the ramp is fast``."""
    codes = dict.fromkeys(each.code for each in found.findings if each.level != "info")
    reasons = f": {', '.join(map(phrase_of, codes))}" if codes else ""
    word = VERDICTS[found.verdict]
    return f"{word[:1].upper()}{word[1:]}{reasons}"


def headline(found: Thermal) -> str:
    """Return ``ramp.csv: 1 h 11 min, 51 -> -18 -> 74 -> 36 °C, at most 8.5 K/min``."""
    turns = [found.branches[0].from_c, *(branch.to_c for branch in found.branches)]
    path = " → ".join(f"{turn:.0f}" for turn in turns)
    length = duration(found.branches[-1].end_s)
    return f"{found.source.name}: {length}, {path} °C, at most {60 * found.fastest_k_per_s:.2g} K/min"


def rows(found: Thermal) -> tuple[Row, ...]:
    """Return the row of each axis."""
    return tuple(map(_row, found.axes))


def _row(axis: AxisThermal) -> Row:
    unit, factor = UNITS[axis.sensor]

    def text(value: float | None) -> str:
        return _UNKNOWN if value is None else f"{float(f'{value * factor:.{_DIGITS}g}'):g}"

    hysteresis = text(axis.hysteresis)
    if axis.hysteresis is not None:
        hysteresis += f" → {text(axis.hysteresis_left)}"
    return Row(
        axis=axis.name,
        before=text(axis.before),
        after=text(axis.left),
        unseen=text(axis.held_out),
        cubic=text(axis.cubic_held_out),
        hysteresis=hysteresis,
        unit=unit,
        curve=_curve(axis.curve),
    )


def _curve(curve: Curve) -> str:
    match curve.kind:
        case "present":
            return f"{curve.order}"
        case "lagged":
            return f"{curve.order}, lag {curve.lag_s:.0f} s"
        case "gradient":
            return f"{curve.order}, gradient {curve.lag_s:.0f} s"


def table(found: Thermal, width: int) -> str:
    """Return the rows as a table, or as a paragraph per axis if the terminal is narrow."""
    every = rows(found)
    cells = [COLUMNS, *(row.cells for row in every)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = [_line(line, widths) for line in cells]
    if max(map(len, lines)) > width:
        lines = [line for row in every for line in textwrap.wrap(_paragraph(row), width)]
    return "\n".join(lines)


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    # Texts are on the left, numbers on the right.
    first, *numbers = zip(cells, widths, strict=True)
    shown = [first[0].ljust(first[1])]
    shown += [cell.rjust(size) for cell, size in numbers[:-2]]
    shown += [cell.ljust(size) for cell, size in numbers[-2:]]
    return "  ".join(shown).rstrip()


def _paragraph(row: Row) -> str:
    return (
        f"{row.axis}: {row.before}, after {row.after}, unseen {row.unseen} (cubic {row.cubic}), "
        f"hysteresis {row.hysteresis} {row.unit}; order {row.curve}"
    )
