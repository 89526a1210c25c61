"""The table that a run prints: the verdict, then both sensors side by side, with intervals."""

import re
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from itertools import zip_longest

from imucal.cli._printing import FULL, can_print
from imucal.report.result import AxisReport, Report
from imucal.report.view import Row, View, ordered_keys, views
from imucal.units import duration, pretty

#: Width of a column, in characters: two of them fit into 80. Narrower tables have one column.
_COLUMN = 39
#: Characters between two columns.
_SPACE = 2
#: No line breaks between a number and its unit, or in ``3 h 2 min``.
_KEPT = re.compile(r"(?<=\d) (?=[A-Za-z%])|(?<= h) (?=\d)|(?<= d) (?=\d)|(?<= min) (?=\d)")
_Block = list[str]


def summary_table(
    report: Report, *, datasheet: bool, forced: bool = False, encoding: str | None = None, columns: int = FULL
) -> str:
    """Return the table as text of at most 80 columns, or 40, without a newline at its end.

    The values are in data-sheet units or in SI. Axes that could not be analysed are missing. Axes that are
    not noise at rest, such as all axes of a log that was moved, are missing too unless `forced`. If the
    `encoding`, by default the one of standard output, lacks signs such as √, the units are ASCII. With less
    than 80 `columns`, the sensors are one below the other, 39 columns wide.
    """
    plain, verdict = not can_print("√²³µ", encoding), report.verdict
    usable = [axis for axis in report.axes if forced or axis.name in verdict.axes]
    part = replace(report, axes=tuple(usable))
    seen = views(part)
    sensors = [
        _blocks(each, axes, datasheet=datasheet, plain=plain)
        for each, axes in zip(seen, part.by_sensor.values(), strict=True)
    ]
    sentence = verdict.sentence
    lines = _wrapped(sentence.replace("±", "+-") if plain else sentence, columns)
    if not sensors:
        return "\n".join(lines)
    lines.append("")
    for group in [sensors] if columns >= FULL else [[one] for one in sensors]:
        lines += _side_by_side(group, ["", *ordered_keys(seen)])
    levels = {axis.fit.level for axis in report.axes}
    shown = " and ".join(f"{100 * level:.4g} %" for level in sorted(levels))
    legend = f"[low, high]: {shown} interval; < high: not detected, upper bound"
    lines += _wrapped(legend, columns)
    return "\n".join(lines)


def _side_by_side(sensors: Sequence[dict[str, _Block]], keys: Sequence[str]) -> list[str]:
    """Return the sensors' blocks in columns: blocks of one key side by side, then an empty line."""
    lines = []
    for key in keys:
        if not any(key in sensor for sensor in sensors):
            continue
        rows = zip_longest(*(sensor.get(key, []) for sensor in sensors), fillvalue="")
        lines += [(" " * _SPACE).join(f"{text:{_COLUMN}}" for text in row).rstrip() for row in rows]
        lines.append("")
    return lines


def _wrapped(text: str, columns: int) -> list[str]:
    """Break a text into lines, after commas or before brackets, but not between a number and its unit."""
    kept = _KEPT.sub("\N{NO-BREAK SPACE}", text)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in textwrap.wrap(kept, columns)]


def _blocks(seen: View, axes: Sequence[AxisReport], *, datasheet: bool, plain: bool) -> dict[str, _Block]:
    """Return key -> block of a sensor's column, in data-sheet units or in SI."""
    rows = {row.key: _block(row, seen.names, datasheet=datasheet, plain=plain) for row in seen.rows}
    return {"": _heading(axes), **rows}


def _heading(axes: Sequence[AxisReport]) -> _Block:
    """Return sensor, rate, duration and samples; one line for axes that share a clock."""
    lines = [str(axes[0].sensor).upper()]
    clocks: dict[str, list[str]] = {}
    for axis in axes:
        text = f"{axis.rate_hz:.6g} Hz, {axis.samples} samples, {duration(axis.duration_s)}"
        clocks.setdefault(text, []).append(axis.axis)
    for text, names in clocks.items():
        shown = text if len(clocks) == 1 else f"{','.join(names)}: {text}"
        lines += _wrapped(shown, _COLUMN)
    return lines


def _block(row: Row, names: Sequence[str], *, datasheet: bool, plain: bool) -> _Block:
    """Return a title with the unit, a remark, and one line per axis, all with the same power of ten."""
    column = row.column(datasheet=datasheet)
    unit = column.unit if plain else pretty(column.unit)
    unit = f"1e{column.exponent} {unit}" if column.exponent else unit
    key, name = row.key.removesuffix(" T"), row.name.replace("acceleration", "accel.")
    title = f"{key} {name}" if row.key == "minimum" else f"{key}  {name}"
    head = f"{title}  {unit}"
    lines = [head] if len(head) <= _COLUMN else [title, f"   in {unit}"]
    if row.remark:
        lines += _wrapped(f"({row.remark})", _COLUMN)
    widest = max(len(text.value) for text in column.texts if text)
    for axis, text in zip(names, column.texts, strict=True):
        if text is None:
            continue
        numbers = f"{axis}  {text.value:{widest}}  {text.interval}".rstrip()
        line = f"{axis}  {text.value:{widest}}  {text.interval}  {text.note}".rstrip()
        if text.note and len(line) > _COLUMN:
            lines += [numbers, f"   {text.note}"]
        else:
            lines.append(line)
    return lines
