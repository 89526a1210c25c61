"""The table that a run prints: the verdict, then both sensors side by side, all with intervals."""

import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import zip_longest

from imucal.cli._printing import FULL, can_print
from imucal.noise.terms import TERMS
from imucal.report import numbers
from imucal.report.numbers import Quantity
from imucal.report.result import AxisReport, Report
from imucal.report.sheet_units import SheetUnits, sheet_units
from imucal.units import duration, pretty

#: Two columns and the space between them make 80; a narrower table has one column after the other.
_COLUMN, _SPACE = 39, 2
#: Blanks where no line breaks: of a number and its unit, and of ``3 h 2 min``.
_KEPT = re.compile(r"(?<=\d) (?=[A-Za-z%])|(?<= h) (?=\d)|(?<= d) (?=\d)|(?<= min) (?=\d)")
_Block = list[str]


def summary_table(
    report: Report,
    *,
    datasheet: bool,
    forced: bool = False,
    encoding: str | None = None,
    columns: int = FULL,
) -> str:
    """Return the table as text of at most 80 columns, or 40, without a newline at its end.

    Parameters
    ----------
    report
        What to show; an axis that could not be analysed is missing.
    datasheet
        Data-sheet units, else SI.
    forced
        Whether to show axes too whose numbers are not those of noise at rest; of a log that was moved no
        axis is left.
    encoding
        Of the place it is printed to; by default standard output's. Where it can't hold signs
        such as √ the units are written in ASCII.
    columns
        Of the terminal; with less than 80 the sensors stand one after the other, 39 columns wide.
    """
    plain, verdict = not can_print("√²³µ", encoding), report.verdict
    usable = [axis for axis in report.axes if forced or axis.name in verdict.axes]
    sensors = list(_sensors(replace(report, axes=tuple(usable)), datasheet=datasheet, plain=plain))
    sentence = verdict.sentence
    lines = _wrapped(sentence.replace("±", "+-") if plain else sentence, columns)
    if not sensors:
        return "\n".join(lines)
    lines.append("")
    for beside in [sensors] if columns >= FULL else [[one] for one in sensors]:
        for key in _order(beside):
            sides = [sensor.get(key, []) for sensor in beside]
            rows = zip_longest(*sides, fillvalue="")
            lines += [(" " * _SPACE).join(f"{text:{_COLUMN}}" for text in row).rstrip() for row in rows]
            lines.append("")
    levels = {axis.fit.level for axis in report.axes}
    shown = " and ".join(f"{100 * level:.4g} %" for level in sorted(levels))
    legend = f"[low, high]: {shown} interval; < high: not shown by the data, upper bound"
    lines += _wrapped(legend, columns)
    return "\n".join(lines)


def _sensors(report: Report, *, datasheet: bool, plain: bool) -> Iterator[dict[str, _Block]]:
    """Yield the blocks of each sensor that has axes."""
    for sensor, axes in report.by_sensor.items():
        units = sheet_units(report, sensor) if datasheet else None
        yield dict(_blocks(axes, units, plain=plain))


def _wrapped(text: str, columns: int) -> list[str]:
    """Break a text into lines; a number keeps its unit: lines break after commas and before brackets."""
    kept = _KEPT.sub("\N{NO-BREAK SPACE}", text)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in textwrap.wrap(kept, columns)]


def _order(columns: Sequence[dict[str, _Block]]) -> list[str]:
    """Return the keys of all blocks: the heading, the terms by rising slope, the minimum."""
    keys = {key for column in columns for key in column}
    first = [
        "",
        *(f"{symbol}{n}{part}" for symbol in TERMS for n in ("", *"123456789") for part in ("", " T")),
    ]
    return [key for key in first if key in keys] + ["minimum"]


def _blocks(axes: list[AxisReport], units: SheetUnits | None, *, plain: bool) -> Iterator[tuple[str, _Block]]:
    """Yield each block of a sensor's column with its key, in data-sheet units or, with None, in SI."""
    sensor, unit = axes[0].sensor, units.estimate if units else numbers.si
    yield "", _heading(axes)
    for key in dict.fromkeys(e.key for axis in axes for e in axis.fit.estimates):
        found = [(axis, e) for axis in axes for e in axis.fit.estimates if e.key == key]
        name = TERMS[found[0][1].symbol].name(sensor).replace("acceleration", "accel.")
        rows = [(a, unit(e, sensor), numbers.alternatives(e)) for a, e in found]
        yield key, _block(f"{key}  {name}", rows, plain=plain)
        timed = [(a, e.correlation_time) for a, e in found]
        times = [(a, numbers.correlation_time(time), "") for a, time in timed if time is not None]
        if times:
            yield f"{key} T", _block(f"{key}  correlation time", times, plain=plain)
    lowest = [
        (
            axis,
            units.minimum(axis) if units else numbers.minimum(axis)[0],
            f"at {numbers.seconds(axis.fit.curve.minimum[1])}",
        )
        for axis in axes
    ]
    yield "minimum", _block("minimum of the curve", lowest, plain=plain)


def _heading(axes: list[AxisReport]) -> _Block:
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


def _block(title: str, rows: list[tuple[AxisReport, Quantity, str]], *, plain: bool) -> _Block:
    """Return a title with its unit and one line an axis, all in the same power of ten."""
    quantities = [quantity for _, quantity, _ in rows]
    exponent = numbers.engineering_exponent(quantities)
    unit = quantities[0].unit if plain else pretty(quantities[0].unit)
    unit = f"1e{exponent} {unit}" if exponent else unit
    head = f"{title}  {unit}"
    lines = [head] if len(head) <= _COLUMN else [title, f"   in {unit}"]
    texts = [numbers.compact(quantity, exponent=exponent) for quantity in quantities]
    widest = max(len(value) for value, _ in texts)
    for (axis, _, note), (value, interval) in zip(rows, texts, strict=True):
        line = f"{axis.axis}  {value:{widest}}  {interval}{'  ' if note else ''}{note}".rstrip()
        fits = len(line) <= _COLUMN
        lines += [line] if fits else [line.removesuffix(note).rstrip(), *([f"   {note}"] if note else [])]
    return lines
