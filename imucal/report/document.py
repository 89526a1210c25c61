"""A report as a JSON document: the layout of `report.json`, SI units, NaN as null.

The layout is pinned by ``schema/report-1.schema.json``; a change that an old reader would
misunderstand raises the number in `SCHEMA`. Reading is in `json_file`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import PurePath

import numpy as np

from imucal.findings import Finding
from imucal.fitting.noise_fit import Estimate, Goodness, NoiseFit, Segments, TermHomogeneity, Trace
from imucal.noise.terms import TERMS
from imucal.recording import ReadRange, Sensor, Source
from imucal.report import numbers
from imucal.report.result import AxisReport, Report
from imucal.report.stored_bins import bins_document

#: Name and number of the layout.
SCHEMA = "imucal/report/1"


def to_document(report: Report) -> dict[str, object]:
    """Return the whole report as JSON values, keys in a stable order."""
    return {
        **_header(report),
        "axes": [_axis(axis, bins=_with_bins(report)) for axis in report.axes],
        "findings": [_finding(f) for f in report.findings],
    }


def axis_document(report: Report, axis: AxisReport) -> dict[str, object]:
    """Return the document of one axis: the header of the report and the axis's own entry."""
    return {**_header(report), **_axis(axis, bins=_with_bins(report))}


def _with_bins(report: Report) -> bool:
    """Whether the report was asked to hold the bins of its fits."""
    return report.settings.get("bins") is True


def plain(value: object) -> object:
    """Return `value` as JSON knows it: arrays as lists, not-a-number and infinity as null.

    Raises
    ------
    TypeError
        If the value is of a kind that JSON can't hold.
    """
    if value is None or isinstance(value, bool | str | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, Sequence):
        return [plain(item) for item in value]
    if isinstance(value, PurePath):
        return str(value)
    msg = f"{type(value).__name__} has no place in a report: {value!r}"
    raise TypeError(msg)


def _header(report: Report) -> dict[str, object]:
    verdict = report.verdict
    return {
        "schema": SCHEMA,
        "version": report.version,
        "verdict": verdict.grade,
        "verdict_sentence": verdict.sentence,
        "source": _source(report.source),
        "settings": plain(report.settings),
    }


def _source(source: Source) -> dict[str, object]:
    return {
        "path": source.path,
        "format": source.format,
        "topics": list(source.topics),
        "message_types": list(source.message_types),
        "decisions": [{"choice": choice, "reason": reason} for choice, reason in source.decisions],
        "files": [
            {"path": file.path, "size_bytes": file.size_bytes, "blake2b": file.blake2b}
            | ({} if file.etag is None else {"etag": file.etag})
            for file in source.files
        ],
        "range": None if source.read is None else _range(source.read),
    }


def _range(read: ReadRange) -> dict[str, object]:
    return {
        "from_s": plain(read.from_s),
        "duration_s": plain(read.duration_s),
        "start_ns": read.start_ns,
        "end_ns": read.end_ns,
    }


def _axis(axis: AxisReport, *, bins: bool) -> dict[str, object]:
    # The file holds deviations. Squaring them first makes reading and writing again change nothing,
    # because the square root of a squared float is that float, while the converse does not hold.
    curve = replace(axis.fit.curve, avar=axis.fit.curve.adev**2)
    axis = replace(axis, fit=replace(axis.fit, curve=curve))
    floor, sheet = numbers.minimum(axis)
    return {
        "name": axis.name,
        "sensor": str(axis.sensor),
        "axis": axis.axis,
        "unit": axis.unit,
        "samples": axis.samples,
        "rate_hz": plain(axis.rate_hz),
        "duration_s": plain(axis.duration_s),
        "mean": plain(axis.mean),
        "std": plain(axis.std),
        "gaps": [{"start_s": g.start_s, "duration_s": g.duration_s, "missing": g.missing} for g in axis.gaps],
        "curve": _curve(axis.fit),
        "minimum": {
            "adev": plain(floor.value),
            "tau_s": plain(curve.minimum[1]),
            "low": plain(floor.low),
            "high": plain(floor.high),
            "datasheet": _quantity(sheet),
        },
        "spectrum": {
            "sides": 2,
            "frequency_hz": plain(axis.spectrum.frequency),
            "psd": plain(axis.spectrum.psd),
            "count": plain(axis.spectrum.count),
            "model_psd": plain(axis.fit.model.psd(axis.spectrum.frequency, rate_hz=axis.fit.rate_hz)),
        },
        "overview": {
            "time_s": plain(axis.overview.time_s),
            "low": plain(axis.overview.low),
            "high": plain(axis.overview.high),
        },
        "fit": _fit(axis.fit, axis.sensor, bins=bins),
        "findings": [_finding(f) for f in axis.findings],
    }


def _curve(fit: NoiseFit) -> dict[str, object]:
    curve = fit.curve
    low, high = curve.confidence_interval(fit.level)
    return {
        "level": fit.level,
        "estimator": curve.estimator,
        "computed": curve.computed,
        "edf_method": curve.edf_method,
        "n": curve.n,
        "tau_s": plain(curve.tau),
        "m": plain(curve.m),
        "adev": plain(curve.adev),
        "low": plain(low),
        "high": plain(high),
        "edf": plain(curve.edf),
        "model_adev": plain(fit.model_adev()),
        "used": plain(fit.used),
    }


def _fit(fit: NoiseFit, sensor: Sensor, *, bins: bool) -> dict[str, object]:
    response = fit.response
    return {
        "method": fit.method,
        "model": str(fit.model),
        "expression": fit.model.text(),
        "rate_hz": fit.rate_hz,
        "level": fit.level,
        "criterion": fit.criterion,
        "goodness": _goodness(fit.goodness),
        "terms": _terms(fit, sensor),
        "parameters": list(fit.parameters),
        "covariance": plain(fit.covariance),
        "response": response and {"kind": response.kind, "cutoff_hz": plain(response.cutoff_hz)},
        "candidates": [{"model": c.structure, "delta": plain(c.delta)} for c in fit.candidates],
        "segments": fit.segments and _segments(fit.segments, fit, sensor),
        "settings": plain(fit.settings),
        "findings": [_finding(f) for f in fit.findings],
        **({"bins": bins_document(fit.bins)} if bins and fit.bins else {}),
    }


def _goodness(goodness: Goodness) -> dict[str, object]:
    return {
        "statistic": plain(goodness.statistic),
        "p_value": plain(goodness.p_value),
        "chi2_per_bin": plain(goodness.chi2_per_bin),
        "band_hz": plain(goodness.band_hz),
        "tau_s": plain(goodness.tau_s),
        "lines": [
            {"frequency_hz": plain(line.frequency_hz), "amplitude": plain(line.amplitude)}
            for line in goodness.lines
        ],
    }


def _terms(fit: NoiseFit, sensor: Sensor) -> dict[str, object]:
    found: dict[str, object] = {}
    for estimate in fit.estimates:
        entry = _term(estimate, sensor)
        if estimate.symbol == "GM":
            entry |= _gauss_markov(estimate, fit)
        found[estimate.key] = entry
    return found


def _term(estimate: Estimate, sensor: Sensor) -> dict[str, object]:
    plain_si, sheet = numbers.si(estimate, sensor), numbers.datasheet(estimate, sensor)
    return {
        "symbol": estimate.symbol,
        "name": TERMS[estimate.symbol].name(sensor),
        "status": estimate.status,
        "value": plain(estimate.value),
        "low": plain(estimate.low),
        "high": plain(estimate.high),
        "unit": plain_si.unit,
        "datasheet": _quantity(sheet),
        "alternatives": list(estimate.alternatives),
        "widening": plain(estimate.widening),
    }


def _gauss_markov(estimate: Estimate, fit: NoiseFit) -> dict[str, object]:
    """Return what a filter's state needs: T, and phi and q of x[t+1] = phi x[t] + q w[t]."""
    time, term, tau0 = estimate.correlation_time, numbers.gauss_markov_term(fit, estimate), 1 / fit.rate_hz
    return {
        "correlation_time": time and _quantity(numbers.correlation_time(time)),
        "phi": term and plain(term.phi(tau0)),
        "q": term and plain(term.q(tau0)),
    }


def _segments(segments: Segments, fit: NoiseFit, sensor: Sensor) -> dict[str, object]:
    return {
        "level": fit.level,
        "start_s": plain(segments.start_s),
        "end_s": plain(segments.end_s),
        "N": segments.white and _trace(segments.white, TERMS["N"].unit(sensor)),
        "floor": segments.floor
        and {"tau_s": plain(segments.floor_tau_s), **_trace(segments.floor, sensor.unit)},
        "terms": {term.key: _homogeneity(term) for term in segments.terms},
    }


def _trace(trace: Trace, unit: str) -> dict[str, object]:
    return {
        "value": plain(trace.value),
        "low": plain(trace.low),
        "high": plain(trace.high),
        "unit": unit,
    }


def _homogeneity(term: TermHomogeneity) -> dict[str, object]:
    return {
        "symbol": term.symbol,
        "statistic": plain(term.statistic),
        "dof": term.dof,
        "p_value": plain(term.p_value),
        "spread": plain(term.spread),
        "factor": plain(term.factor),
        "highest_s": plain(term.highest_s),
        "lowest_s": plain(term.lowest_s),
    }


def _quantity(quantity: numbers.Quantity) -> dict[str, object]:
    return {
        "value": plain(quantity.value),
        "low": plain(quantity.low),
        "high": plain(quantity.high),
        "unit": quantity.unit,
    }


def _finding(finding: Finding) -> dict[str, object]:
    return {
        "level": finding.level,
        "code": finding.code,
        "axis": finding.axis,
        "text": finding.text,
        "advice": finding.advice,
        "keep_s": plain(finding.keep_s),
    }
