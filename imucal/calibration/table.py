"""The table of a calibration for the terminal, notebooks and the page."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import zip_longest
from typing import TYPE_CHECKING

import numpy as np

from imucal.calibration.parameters import Parameter
from imucal.calibration.poses import attitudes
from imucal.calibration.result import Calibration, rms
from imucal.report.markup import Markup, render
from imucal.report.numbers import value_and_half
from imucal.units import G0, duration

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Row", "frame_of", "headline", "html_of", "readable", "remarks", "rows", "table", "text_of"]

#: Unit of a parameter -> unit in the table, and its factor.
_UNITS = {
    "m/s^2": ("mm/s²", 1e3),
    "rad/s": ("deg/s", math.degrees(1.0)),
    "(rad/s)/(m/s^2)": ("deg/s/g", math.degrees(G0)),
    "raw/(m/s^2)": ("per m/s²", 1.0),
    "raw/(rad/s)": ("per rad/s", 1.0),
}
#: Columns of the left half of a wide table.
_HALF = 39
#: Columns of the name of a parameter.
_NAME = 16
#: Columns for two blocks side by side.
_WIDE = 80
#: Statuses that the table shows.
_LISTED = ("weak",)


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line of the table; `half` is half of the 95 % interval."""

    name: str
    value: str
    half: str
    remark: str = ""

    def text(self) -> str:
        """Return the line, such as ``scale x          -0.133 % ± 0.011``."""
        half = f" ± {self.half}" if self.half else ""
        remark = f"  ({self.remark})" if self.remark else ""
        return f"{self.name:<{_NAME}} {self.value}{half}{remark}"


def rows(found: Calibration) -> tuple[tuple[str, tuple[Row, ...]], ...]:
    """Return the rows of each sensor, with its name."""
    accel = [_row(name, each) for name, each in _in_order(found.accelerometer.parameters)]
    blocks = [("accelerometer", tuple(accel))]
    if found.gyroscope is not None:
        every = found.gyroscope.parameters
        shown = {name: each for name, each in every.items() if not name.startswith("g_sens")}
        gyro = [_row(name, each) for name, each in _in_order(shown)]
        sensitivity = [each for name, each in every.items() if name.startswith("g_sens")]
        blocks.append(("gyroscope", (*gyro, _sensitivity(sensitivity))))
    return tuple(blocks)


def readable(value: float, unit: str) -> tuple[float, str]:
    """Return a value of a parameter in the unit of the table."""
    name, factor = _UNITS.get(unit, (unit, 1.0))
    return value * factor, name


def headline(found: Calibration) -> str:
    """Return ``poses.mcap: 8 min 32 s, 46 rests (1.1 to 45.9 s) in 18 attitudes, 45 turns``."""
    used = [rest for rest in found.rests if rest.used]
    lengths = [rest.end_s - rest.start_s for rest in found.rests]
    length_s = found.source.read.duration_s if found.source.read else found.rests[-1].end_s
    ends = [f"{length:.1f}" for length in (min(lengths), max(lengths))]
    count = attitudes(np.array([rest.up for rest in used]))
    rests = f"{len(found.rests)} rests ({' to '.join(dict.fromkeys(ends))} s) in {count} attitudes"
    turns = f", {len(found.turns)} turns" if found.turns else ""
    return f"{found.source.name}: {duration(round(length_s))}, {rests}{turns}"


def remarks(found: Calibration) -> Iterator[str]:
    """Yield the errors before and after, and the rest that would help most."""
    used = [rest for rest in found.rests if rest.used]
    after = rms(rest.residual for rest in used)
    if found.accelerometer.parameters["bias_x"].unit == "raw":
        yield f"|f| at rest: {_mm(after)} rms from gravity after calibration."
    else:
        before = max(abs(rest.before) for rest in used)
        yield f"|f| at rest: error up to {_mm(before)} before, {_mm(after)} rms after."
    turns = [turn for turn in found.turns if turn.used]
    both = [
        rms(math.hypot(*each) for turn in turns if (each := getattr(turn, name)) is not None)
        for name in ("before_deg", "residual_deg")
    ]
    if turns:
        known = sum(turn.known_deg is not None for turn in turns)
        angles = f" ({known} by a known angle)" if known else ""
        yield f"Turns{angles}: {both[0]:.2g} deg rms before, {both[1]:.2g} after."
    add = found.accelerometer.suggestion
    name = add.parameter.replace("_", " ")
    percent = f"{100 - 100 * add.ratio:.0f} %"
    yield f"One more rest with {add.text} reduces the largest uncertainty ({name}) by {percent}."


def table(found: Calibration, columns: int = _WIDE) -> str:
    """Return the table of both sensors: side by side from 80 columns on."""
    wide = columns >= _WIDE
    each = _HALF if wide else columns
    blocks = [[f"{name.upper()} (± 95 %)", *_fitted(own, each)] for name, own in rows(found)]
    if not wide or len(blocks) == 1:
        return "\n\n".join("\n".join(block) for block in blocks)
    pairs = zip_longest(*blocks, fillvalue="")
    return "\n".join(f"{left:<{_HALF}} {right}".rstrip() for left, right in pairs)


def text_of(found: Calibration) -> str:
    """Return the result in at most twelve lines."""
    lines = [f"Calibration of {headline(found)}: {found.verdict_text}"]
    for name, own in rows(found):
        for kind in ("scale", "misalignment", "bias", "g-sensitivity"):
            of_kind = [row for row in own if row.name.startswith(kind)]
            values = ", ".join(f"{row.value} ± {row.half}" if row.half else row.value for row in of_kind)
            lines += [f"{name} {kind}: {values}"] if of_kind else []
    codes = ", ".join(dict.fromkeys(f"{finding.level} {finding.code}" for finding in found.findings))
    return "\n".join([*lines, f"findings: {codes or 'none'}"])


def html_of(found: Calibration) -> Markup:
    """Return the table for notebooks."""
    body = [
        (f"{name} {row.name}", (row.value, row.half, row.remark)) for name, own in rows(found) for row in own
    ]
    caption = f"Calibration of {headline(found)}"
    return render("notebook.html", caption=caption, titles=("", "value", "± 95 %", ""), rows=body)


def frame_of(found: Calibration) -> "pl.DataFrame":
    """Return every parameter with its interval, in the units of `Parameter`."""
    import polars as pl

    sensors = {"accelerometer": found.accelerometer.parameters}
    if found.gyroscope is not None:
        sensors["gyroscope"] = found.gyroscope.parameters
    names = ("value", "low", "high", "unit", "status")
    return pl.DataFrame(
        [
            {"sensor": sensor, "parameter": name, **{key: getattr(one, key) for key in names}}
            for sensor, every in sensors.items()
            for name, one in every.items()
        ]
    )


def _in_order(parameters: Mapping[str, Parameter]) -> list[tuple[str, Parameter]]:
    kinds = ("scale", "misalignment", "bias")
    return [(name, each) for kind in kinds for name, each in parameters.items() if name.startswith(kind)]


def _row(name: str, found: Parameter) -> Row:
    title = name.replace("_", " ")
    if found.value is None or found.half_width is None:
        return Row(name=title, value="not observable", half="")
    (number, unit), (width, _) = readable(found.value, found.unit), readable(found.half_width, found.unit)
    value, half = value_and_half(number, width)
    remark = found.status if found.status in _LISTED else ""
    return Row(name=title, value=f"{value} {unit}", half=half, remark=remark)


def _sensitivity(found: list[Parameter]) -> Row:
    name = "g-sensitivity"
    known = [each for each in found if each.value is not None]
    if not known:
        return Row(name=name, value="not observable", half="")
    unit, factor = _UNITS.get(known[0].unit, (known[0].unit, 1.0))
    if known[0].status == "not-significant":
        most = max(abs(end) for each in known for end in (each.low, each.high) if end is not None)
        return Row(name=name, value=f"none, < {most * factor:.2g} {unit}", half="")
    worst = max(known, key=lambda each: abs(each.value or 0.0))
    value, half = value_and_half(abs(worst.value or 0.0) * factor, (worst.half_width or 0.0) * factor)
    return Row(name=name, value=f"up to {value} {unit}", half=half)


def _fitted(own: Iterable[Row], columns: int) -> Iterator[str]:
    for row in own:
        if len(line := row.text()) <= columns:
            yield line
        else:
            yield row.name
            yield f"  {line[_NAME + 1 :]}"


def _mm(size: float) -> str:
    return f"{1e3 * size:.3g} mm/s²"
