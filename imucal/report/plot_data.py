"""The data of the page's interactive plots, as JSON in SI: curve, model, terms, spectrum and raw signal."""

import json
import math
import warnings

import numpy as np

from imucal.arrays import FloatArray
from imucal.fitting.noise_fit import Estimate
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.figure import units_of
from imucal.report.figure_curves import (
    drawn_terms,
    estimate_text,
    shown_points,
    smooth_adev,
    smooth_root,
)
from imucal.report.figure_style import DATA, LEFT_OUT, MODEL, UNUSED
from imucal.report.numbers import SheetUnits
from imucal.report.result import AxisReport, Overview, Report
from imucal.report.smooth_spectrum import smooth_spectrum
from imucal.report.typed_json import JsonObject, to_json
from imucal.report.view import term_name
from imucal.units import pretty

#: Points of a smooth line.
_FINE = 60
#: Gaps closer than this fraction of the recording are drawn as one.
_MERGED = 1 / 500
#: Least distance of an outlier, in robust deviations.
_STANDS_OUT = 8.0
#: Number of neighbours in a running median; odd.
_NEIGHBOURS = 25


def page_data(report: Report) -> str:
    """Return the data of all plots as JSON, safe inside a script element."""
    strokes = {symbol: term.stroke for symbol, term in TERMS.items()}
    strokes |= {"data": DATA, "model": MODEL}
    document = {
        "colours": {
            **{name: [stroke.light, stroke.dark] for name, stroke in strokes.items()},
            "unused": [UNUSED, "#5d6873"],
            "line": [LEFT_OUT, "#ff7b86"],
        },
        "axes": {axis.name: _axis(axis, units_of(report, axis.sensor)) for axis in report.axes},
    }
    text = json.dumps(document, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    return text.replace("<", "\\u003c")


def standing_out(overview: Overview, std: float) -> FloatArray:
    """Return the times of stretches with outliers, in s, shape (k,).

    Extremes are compared with their running median, in units of the median absolute deviation scaled to a
    standard deviation, or of an eighth of `std` if that is larger.
    """
    found = np.zeros(overview.time_s.size, dtype=bool)
    if found.size < _NEIGHBOURS:
        return overview.time_s[found]
    for extreme in (overview.low, overview.high):
        away = np.abs(extreme - _running_median(extreme))
        known = away[np.isfinite(away)]
        if known.size:
            spread = max(1.4826 * float(np.median(known)), std / 8)
            found |= np.nan_to_num(away) > _STANDS_OUT * spread
    return overview.time_s[found]


def _running_median(values: FloatArray) -> FloatArray:
    half = _NEIGHBOURS // 2
    padded = np.pad(values, half, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, _NEIGHBOURS)
    with warnings.catch_warnings():
        # In a long gap all neighbours are NaN.
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.asarray(np.nanmedian(windows, axis=1))


def _axis(axis: AxisReport, units: SheetUnits) -> JsonObject:
    level, density = units.level, units.density
    adev, tau = axis.fit.curve.minimum
    return {
        "units": {
            "si": [pretty(axis.unit), 1, pretty(f"{axis.unit}/sqrt(Hz)"), 1],
            "sheet": [pretty(level.name), level.factor, pretty(density.name), density.factor],
        },
        "level": f"{100 * axis.fit.level:.4g}",
        "model": str(axis.fit.model),
        "curve": _curve(axis),
        "minimum": {
            "at": [float(f"{tau:.6g}"), float(f"{adev:.5g}")],
            "si": f"minimum {numbers.with_interval(numbers.minimum(axis.fit))}",
            "sheet": f"minimum {numbers.with_interval(units.minimum(axis.fit))}",
        },
        "fine": _fine(axis, units),
        "psd": _psd(axis),
        "raw": {
            "t": _round(axis.overview.time_s, 6),
            "low": _fixed(axis.overview.low, axis.std),
            "high": _fixed(axis.overview.high, axis.std),
            "gaps": _gaps(axis),
            "out": _round(standing_out(axis.overview, axis.std), 6),
        },
    }


def _curve(axis: AxisReport) -> JsonObject:
    curve = axis.fit.curve
    shown = shown_points(curve)
    low, high = curve.confidence_interval(axis.fit.level)
    values = {"tau": curve.tau, "adev": curve.adev, "low": low, "high": high, "model": axis.fit.model_adev()}
    return {
        **_rounded(5, **{name: array[shown] for name, array in values.items()}),
        "edf": _round(curve.edf[shown], 3),
        "used": np.isin(shown, axis.fit.used).astype(int).tolist(),
    }


def _labels(estimate: Estimate, units: SheetUnits, sensor: Sensor) -> dict[str, str]:
    si = f"{estimate.key} {numbers.with_uncertainty(numbers.si(estimate, sensor))}"
    sheet, *time = estimate_text(estimate, sensor, units).split("\n")
    return {"si": "<br>".join([si, *time]), "sheet": "<br>".join([sheet, *time])}


def _fine(axis: AxisReport, units: SheetUnits) -> JsonObject:
    """Return model and terms as smooth lines, and each coefficient's read-off point."""
    curve, rate = axis.fit.curve, axis.fit.rate_hz
    m, total = smooth_adev(axis.fit, curve.m[shown_points(curve)], _FINE)
    grid, root = smooth_root(axis, _FINE)
    terms = []
    for drawn in drawn_terms(axis.fit):
        estimate, (at, height) = drawn.estimate, drawn.term.read_off()
        line = np.sqrt(drawn.term.avar(m, 1 / rate))
        if at is None:
            at = float(m[np.argmax(line / np.where(total > 0, total, math.inf))] / rate)
        terms.append(
            {
                "key": estimate.key,
                "symbol": estimate.symbol,
                "name": term_name(estimate.symbol, axis.sensor),
                "bounded": drawn.bounded,
                "si": numbers.with_interval(numbers.si(estimate, axis.sensor)),
                "sheet": numbers.with_interval(units.estimate(estimate, axis.sensor)),
                "label": _labels(estimate, units, axis.sensor),
                "adev": _round(line, 4),
                "root": _round(np.sqrt(drawn.term.psd(grid, 1 / rate)), 4),
                "at": [float(f"{at:.4g}"), float(f"{height:.4g}")],
            }
        )
    return {**_rounded(4, tau=m / rate, adev=total, f=grid, root=root), "terms": terms}


def _psd(axis: AxisReport) -> JsonObject:
    smooth, fit = smooth_spectrum(axis), axis.fit
    model, response = np.sqrt(fit.model.psd(smooth.frequency, rate_hz=fit.rate_hz)), fit.response
    return {
        **_rounded(4, f=smooth.frequency, root=smooth.root, low=smooth.low, high=smooth.high, model=model),
        "band": to_json(fit.goodness.band_hz),
        "lines": [[line.frequency_hz, to_json(line.amplitude)] for line in fit.goodness.lines],
        "filter": response and to_json(response.cutoff_hz),
    }


def _gaps(axis: AxisReport) -> list[list[float]]:
    """Return start and end of the gaps in s; close neighbours are merged."""
    merged: list[list[float]] = []
    for gap in axis.gaps:
        start, end = gap.start_s, gap.start_s + gap.duration_s
        if merged and start - merged[-1][1] < _MERGED * axis.duration_s:
            merged[-1][1] = round(end, 4)
        else:
            merged.append([round(start, 4), round(end, 4)])
    return merged


def _rounded(digits: int, **values: FloatArray) -> JsonObject:
    return {name: _round(array, digits) for name, array in values.items()}


def _round(values: FloatArray, digits: int) -> list[float | None]:
    return [float(f"{value:.{digits}g}") if math.isfinite(value) else None for value in values.tolist()]


def _fixed(values: FloatArray, std: float) -> list[float | None]:
    """Return numbers rounded to about a hundredth of `std`, because the mean may be large."""
    places = 9 if not (math.isfinite(std) and std > 0) else min(15, max(0, 2 - math.floor(math.log10(std))))
    return [round(value, places) if math.isfinite(value) else None for value in values.tolist()]
