"""What a notebook shows of recordings, curves, fits and reports: text, the page's table, a data frame."""

from collections.abc import Iterator
from functools import singledispatch
from typing import TYPE_CHECKING, Any

from imucal.allan.curve import AllanCurve
from imucal.display import Displayed
from imucal.fitting.noise_fit import NoiseFit
from imucal.recording import AxisSeries, Recording
from imucal.report import numbers
from imucal.report.markup import Markup, render
from imucal.report.result import Report
from imucal.report.view import Cell, View, view, views
from imucal.units import duration

if TYPE_CHECKING:
    import polars as pl

__all__ = ["frame_of", "html_of", "text_of"]

#: Most rows of a curve's table: more are left out in the middle.
_MOST = 12


def text_of(value: Displayed) -> str:
    """Return what a value holds, in at most twelve lines."""
    return "\n".join(_lines(value))


@singledispatch
def _lines(value: object) -> Iterator[str]:
    raise TypeError(type(value).__name__)


@_lines.register(Recording)
def _(recording: Recording) -> Iterator[str]:
    yield f"Recording of {recording.source.name} ({recording.source.format})"
    for _, name, *cells in _axes_of(recording):
        yield f"{name}: {', '.join(cells)}"
    codes = ", ".join(dict.fromkeys(f"{found.level} {found.code}" for found in recording.findings))
    yield f"findings: {codes or 'none'}"


@_lines.register(AxisSeries)
def _(series: AxisSeries) -> Iterator[str]:
    _, _, *cells = _axis_row(series)
    yield f"{series.name} in {series.unit}: {', '.join(cells)}"


@_lines.register(AllanCurve)
def _(curve: AllanCurve) -> Iterator[str]:
    adev, tau = curve.minimum
    yield f"Allan curve ({curve.estimator}) of {curve.n} samples: {curve.tau.size} deviations"
    yield f"tau {curve.tau[0]:.4g} to {curve.tau[-1]:.4g} s, minimum {adev:.4g} at {numbers.seconds(tau)}"


@_lines.register(NoiseFit)
def _(fit: NoiseFit) -> Iterator[str]:
    seen = view({"": fit})
    model = str(fit.model) or "no term shown"
    yield f"{_name(seen)}: {model} ({fit.method}, {100 * fit.level:.4g} % intervals)"
    for row in seen.rows[:11]:
        for cell in row.cells:
            yield f"{row.key:7} {_said(cell)}" if cell else ""


@_lines.register(Report)
def _(report: Report) -> Iterator[str]:
    yield f"Report of {report.source.name}: {report.verdict.sentence}"
    for seen in views(report):
        for index, name in enumerate(seen.names):
            cells = ((row.key, row.cells[index]) for row in seen.rows if row.symbol)
            texts = [f"{key} {_said(cell)}" for key, cell in cells if cell]
            yield f"{seen.sensor.short if seen.sensor else ''}_{name}: {', '.join(texts)}"


def _said(cell: Cell) -> str:
    return f"{numbers.with_interval(cell.sheet)} {cell.note}".rstrip()


def _name(seen: View) -> str:
    return str(seen.sensor).capitalize() if seen.sensor else "Curve"


def _axes_of(recording: Recording) -> list[tuple[str, str, str, str, str]]:
    """Return sensor, axes, length, samples and gaps of each clock."""
    rows: dict[int, tuple[str, str, str, str, str]] = {}
    for series in recording.series:
        sensor, name, *rest = rows.get(id(series.clock), _axis_row(series))
        names = name if series.name in name else f"{name} {series.name}"
        rows[id(series.clock)] = (sensor, names, rest[0], rest[1], rest[2])
    return list(rows.values())


def _axis_row(series: AxisSeries) -> tuple[str, str, str, str, str]:
    clock = series.clock
    gaps = f"{len(clock.gaps)} gap{'s' if len(clock.gaps) > 1 else ''}, {clock.missing} missing"
    length = f"{duration(clock.duration_s)} at {clock.rate_hz:.6g} Hz"
    return str(series.sensor), series.name, length, f"{clock.n} samples", gaps if clock.gaps else "no gaps"


def html_of(value: Displayed) -> Markup:
    """Return the table that the page has of a value, with the style that it needs."""
    return render("notebook.html", **_tables(value))


@singledispatch
def _tables(value: object) -> dict[str, Any]:
    """Return what the template is filled with: views of fits, or a caption, titles and rows of text."""
    raise TypeError(type(value).__name__)


@_tables.register(Recording)
@_tables.register(AxisSeries)
def _(value: Recording | AxisSeries) -> dict[str, Any]:
    rows = _axes_of(value) if isinstance(value, Recording) else [_axis_row(value)]
    titles = ("Axes", "Length", "Samples", "Gaps")
    caption, *_ = text_of(value).split("\n")
    return {"caption": caption, "titles": titles, "rows": [(name, cells) for _, name, *cells in rows]}


@_tables.register(AllanCurve)
def _(curve: AllanCurve) -> dict[str, Any]:
    low, high = curve.confidence_interval()
    values = zip(curve.tau, curve.m, curve.adev, low, high, strict=True)
    rows = [(f"{tau:.6g}", (str(m), *(f"{each:.4g}" for each in rest))) for tau, m, *rest in values]
    if len(rows) > _MOST:
        rows = [*rows[: _MOST - 3], ("…", ("…",) * 4), *rows[-3:]]
    titles = ("τ (s)", "m", "deviation", "low (95 %)", "high (95 %)")
    return {"caption": text_of(curve).replace("\n", "; "), "titles": titles, "rows": rows}


@_tables.register(NoiseFit)
def _(fit: NoiseFit) -> dict[str, Any]:
    return {"caption": text_of(fit).split("\n")[0], "views": [view({"": fit})]}


@_tables.register(Report)
def _(report: Report) -> dict[str, Any]:
    return {"caption": report.verdict.sentence, "views": views(report)}


@singledispatch
def frame_of(value: object) -> "pl.DataFrame":
    """Return a value as a data frame: samples, the points of a curve, or a row a term of each axis, in SI."""
    raise TypeError(type(value).__name__)


@frame_of.register(AxisSeries)
def _(series: AxisSeries) -> "pl.DataFrame":
    import polars as pl

    return pl.DataFrame({"time_s": series.clock.grid() * series.tau0, series.name: series.samples})


@frame_of.register(Recording)
def _(recording: Recording) -> "pl.DataFrame":
    first, *others = (frame_of(series) for series in recording.series)
    for frame in others:
        if frame.height == first.height and (frame["time_s"] == first["time_s"]).all():
            first = first.with_columns(frame[frame.columns[1]])
        else:
            first = first.join(frame, on="time_s", how="full", coalesce=True).sort("time_s")
    return first


@frame_of.register(AllanCurve)
def _(curve: AllanCurve) -> "pl.DataFrame":
    import polars as pl

    low, high = curve.confidence_interval()
    columns = {"tau_s": curve.tau, "m": curve.m, "adev": curve.adev, "low": low, "high": high}
    return pl.DataFrame({**columns, "edf": curve.edf})


@frame_of.register(NoiseFit)
def _(fit: NoiseFit) -> "pl.DataFrame":
    return _frame([(str(fit.sensor or ""), view({"": fit}))]).drop("axis")


@frame_of.register(Report)
def _(report: Report) -> "pl.DataFrame":
    return _frame([(seen.sensor.short if seen.sensor else "", seen) for seen in views(report)])


def _frame(seen: list[tuple[str, View]]) -> "pl.DataFrame":
    """Return a row for each term and axis: value (null where only a bound is known), limits, both units."""
    import polars as pl

    rows = [
        {
            "axis": f"{prefix}_{name}",
            "term": row.key,
            "name": row.name,
            **{key: getattr(cell.si, key) for key in ("value", "low", "high", "unit")},
            **{f"sheet_{key}": getattr(cell.sheet, key) for key in ("value", "low", "high", "unit")},
            "note": cell.note,
        }
        for prefix, each in seen
        for index, name in enumerate(each.names)
        for row in each.rows
        if (cell := row.cells[index])
    ]
    numeric = dict.fromkeys(
        (f"{of}{key}" for of in ("", "sheet_") for key in ("value", "low", "high")), pl.Float64
    )
    return pl.DataFrame(rows, schema_overrides=numeric)
