"""Recordings, curves, fits and reports in notebooks: text, HTML table, data frame."""

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, TypeAlias

from imucal.allan.curve import AllanCurve
from imucal.display import Displayed
from imucal.fitting.noise_fit import NoiseFit
from imucal.recording import AxisSeries, Recording
from imucal.report import numbers
from imucal.report.markup import Markup, render
from imucal.report.result import AxisReport, Report
from imucal.report.view import Row, View, view, views

if TYPE_CHECKING:
    import polars as pl

__all__ = ["frame_of", "html_of", "text_of"]

_Clock: TypeAlias = tuple[str, str, str, str, str]
_LINES = 12
_MAX_ROWS = 12


def text_of(value: Displayed) -> str:
    """Return a summary of at most twelve lines."""
    return "\n".join(_lines(value))


def _lines(value: Displayed) -> Iterator[str]:
    match value:
        case Recording():
            yield from _recording_lines(value)
        case AxisSeries():
            yield f"{value.name} in {value.unit}: {', '.join(_axis_row(value)[2:])}"
        case AllanCurve():
            (adev, at), tau = value.minimum, value.tau
            yield f"Allan curve ({value.estimator}) of {value.n} samples: {tau.size} deviations"
            yield f"tau {tau[0]:.4g} to {tau[-1]:.4g} s, minimum {adev:.4g} at {numbers.seconds(at)}"
        case NoiseFit():
            (seen,) = _views_of(value)
            name, model = str(seen.sensor or "curve").capitalize(), str(value.model) or "no term detected"
            yield f"{name}: {model} ({value.method}, {100 * value.level:.4g} % intervals)"
            yield from (f"{key:7} {text}" for key, text in _cells(seen.rows[:11], 0))
        case AxisReport():
            yield from _axis_report_lines(value)
        case Report():
            yield f"Report of {value.source.name}: {value.verdict.sentence}"
            yield from (line for seen in views(value) for line in _axis_lines(seen))
        case _:
            raise TypeError(type(value).__name__)


def _recording_lines(recording: Recording) -> Iterator[str]:
    yield f"Recording of {recording.source.name} ({recording.source.format})"
    for _, name, *cells in _axes_of(recording):
        yield f"{name}: {', '.join(cells)}"
    codes = ", ".join(dict.fromkeys(f"{found.level} {found.code}" for found in recording.findings))
    yield f"findings: {codes or 'none'}"


def _axis_report_lines(axis: AxisReport) -> Iterator[str]:
    length = numbers.recorded(axis.duration_s, axis.rate_hz)
    yield f"{axis.name} in {axis.unit}: {length}, {axis.samples} samples"
    yield from list(_lines(axis.fit))[: _LINES - 1]


def _axis_lines(seen: View) -> Iterator[str]:
    terms = [row for row in seen.rows if row.symbol]
    for index, name in enumerate(seen.names):
        texts = [f"{key} {text}" for key, text in _cells(terms, index)]
        yield f"{seen.sensor.short if seen.sensor else ''}_{name}: {', '.join(texts)}"


def _cells(rows: Iterable[Row], index: int) -> Iterator[tuple[str, str]]:
    for row in rows:
        if cell := row.cells[index]:
            yield row.key, f"{numbers.with_interval(cell.sheet)} {cell.note}".rstrip()


def _axes_of(recording: Recording) -> list[_Clock]:
    rows: dict[int, _Clock] = {}
    for series in recording.series:
        sensor, name, length, samples, gaps = rows.get(id(series.clock), _axis_row(series))
        names = name if series.name in name else f"{name} {series.name}"
        rows[id(series.clock)] = sensor, names, length, samples, gaps
    return list(rows.values())


def _axis_row(series: AxisSeries) -> _Clock:
    clock = series.clock
    gaps = f"{len(clock.gaps)} gap{'s' if len(clock.gaps) > 1 else ''}, {clock.missing} missing"
    length = numbers.recorded(clock.duration_s, clock.rate_hz)
    return str(series.sensor), series.name, length, f"{clock.n} samples", gaps if clock.gaps else "no gaps"


def html_of(value: Displayed) -> Markup:
    """Return an HTML table with its style sheet."""
    return render("notebook.html", **_tables(value))


def _tables(value: Displayed) -> dict[str, Any]:
    """Return views of fits, or a table of texts."""
    caption, *more = text_of(value).split("\n")
    match value:
        case Recording() | AxisSeries():
            found = _axes_of(value) if isinstance(value, Recording) else [_axis_row(value)]
            rows = [(name, tuple(cells)) for _, name, *cells in found]
            return {"caption": caption, "titles": ("Axes", "Length", "Samples", "Gaps"), "rows": rows}
        case AllanCurve():
            values = zip(value.tau, value.m, value.adev, *value.confidence_interval(), strict=True)
            rows = [(f"{tau:.6g}", (str(m), *(f"{each:.4g}" for each in rest))) for tau, m, *rest in values]
            if len(rows) > _MAX_ROWS:
                rows = [*rows[: _MAX_ROWS - 3], ("…", ("…",) * 4), *rows[-3:]]
            titles = ("τ (s)", "m", "deviation", "low (95 %)", "high (95 %)")
            return {"caption": "; ".join([caption, *more]), "titles": titles, "rows": rows}
        case Report():
            return {"caption": value.verdict.sentence, "views": views(value)}
    return {"caption": caption, "views": _views_of(value)}


def frame_of(value: Displayed) -> "pl.DataFrame":
    """Return samples, points of a curve, or one row per term and axis, in SI."""
    import polars as pl

    match value:
        case AxisSeries():
            return pl.DataFrame({"time_s": value.clock.grid() * value.tau0, value.name: value.samples})
        case Recording():
            first, *others = (frame_of(series) for series in value.series)
            for frame in others:
                if frame.height == first.height and (frame["time_s"] == first["time_s"]).all():
                    first = first.with_columns(frame[frame.columns[1]])
                else:
                    first = first.join(frame, on="time_s", how="full", coalesce=True).sort("time_s")
            return first
        case AllanCurve():
            low, high = value.confidence_interval()
            columns = {"tau_s": value.tau, "m": value.m, "adev": value.adev, "low": low, "high": high}
            return pl.DataFrame({**columns, "edf": value.edf})
    frame = _frame(_views_of(value))
    return frame.drop("axis") if isinstance(value, NoiseFit) else frame


def _views_of(value: Displayed) -> tuple[View, ...]:
    match value:
        case NoiseFit():
            return (view({"": value}),)
        case AxisReport():
            return (view({value.axis: value}),)
        case Report():
            return views(value)
    raise TypeError(type(value).__name__)


def _frame(seen: Iterable[View]) -> "pl.DataFrame":
    """Return one row per term and axis in both units; the value is null if only a bound is known."""
    import polars as pl

    parts = ("value", "low", "high", "unit")
    rows = [
        {
            "axis": f"{each.sensor.short if each.sensor else ''}_{name}",
            "term": row.key,
            "name": row.name,
            **{key: getattr(cell.si, key) for key in parts},
            **{f"sheet_{key}": getattr(cell.sheet, key) for key in parts},
            "note": cell.note,
        }
        for each in seen
        for index, name in enumerate(each.names)
        for row in each.rows
        if (cell := row.cells[index])
    ]
    numeric = {f"{of}{key}": pl.Float64 for of in ("", "sheet_") for key in parts[:3]}
    return pl.DataFrame(rows, schema_overrides=numeric)
