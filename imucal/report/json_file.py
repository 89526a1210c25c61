"""`report.json` and `signal.json`: SI units, keys in a stable order; written and read back.

A change that an old reader would misunderstand needs another number in `SCHEMA`.
"""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import NoReturn, get_args

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.allan.dct import Spectrum
from imucal.arguments import takes
from imucal.arrays import FloatArray
from imucal.clock import Gap
from imucal.errors import Fix, ReadError
from imucal.findings import Finding
from imucal.fitting.noise_fit import (
    Candidate,
    Estimate,
    Goodness,
    Interval,
    Line,
    NoiseFit,
    Response,
    Segments,
    Status,
    TermHomogeneity,
    Trace,
)
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS, TERMS
from imucal.prediction.filter_numbers import FilterNumbers
from imucal.recording import LogFileInfo, ReadRange, Sensor, Source
from imucal.report import numbers
from imucal.report.json_node import (
    OR_INFINITE,
    OR_NAN,
    JsonObject,
    Node,
    layout_of,
    list_of,
    maybe,
    one_of,
    picked,
    plain,
)
from imucal.report.numbers import Quantity
from imucal.report.result import AxisReport, Overview, Report

SCHEMA = "imucal/report/2"
#: Pictures need the raw signals, scripts do not.
SIGNAL_SCHEMA, SIGNAL_FILE = "imucal/signal/1", "signal.json"
#: Digits of spectra and signals: enough for pictures, and half the size.
_DIGITS = 8


def _axis(node: Node) -> AxisReport:
    fit = _fit(node["fit"], node["curve"], Sensor(node["sensor"].text(*Sensor)))
    return _AXIS.read(node, fit=fit, overview=Overview.none(), findings=())


def _fit(node: Node, curve_node: Node, sensor: Sensor) -> NoiseFit:
    curve, used = _CURVE.read(curve_node), curve_node["used"].counts()
    if used.size and used.max() >= curve.tau.size:
        curve_node["used"].fail(f"found the index {used.max()}", f"less than {curve.tau.size}")
    parameters = node["parameters"].texts()
    covariance = node["covariance"].matrix(len(parameters))
    return _FIT.read(node, sensor=sensor, curve=curve, used=used, covariance=covariance)


def _rising(node: Node) -> FloatArray:
    tau = node.array()
    if not np.all(np.diff(tau) > 0):
        node.fail("found averaging times that do not increase", "increasing ones")
    return tau


def _level(node: Node) -> float:
    level = node.number()
    if not 0 < level < 1:
        node.fail(f"found {level}", "a number between 0 and 1")
    return level


def _model(node: Node) -> NoiseModel:
    text = node.text()
    if not text:
        return NoiseModel(terms=())
    try:
        return NoiseModel.parse(text)
    except ValueError as error:
        node.fail(f"found a model that can't be read ({error})", "a sum of terms with values")


def _estimates(node: Node) -> tuple[Estimate, ...]:
    for always in ALWAYS:
        node[always].table()
    return tuple(_estimate(node[key], key) for key in node.table())


def _estimate(node: Node, key: str) -> Estimate:
    status, value = node["status"].text(*get_args(Status)), node["value"].maybe(Node.number)
    if (value is None) != (status == "bounded"):
        node["value"].fail(f"found {json.dumps(node['value'].value)}", f"a value that fits {status!r}")
    return _TERM.read(node, key=key)


def _segments(node: Node) -> Segments:
    floor, terms = node["floor"], node["terms"]
    size = node["start_s"].array().size
    for trace in (node["N"], floor):
        for name in ("value", "low", "high") if trace.value is not None else ():
            trace[name].array(like=size)
    return _SEGMENTS.read(
        node,
        floor_tau_s=math.nan if floor.value is None else floor["tau_s"].positive(),
        terms=tuple(_HOMOGENEITY.read(terms[key], key=key) for key in terms.table()),
    )


layout_of(Quantity, "value low high unit")
layout_of(Interval, "value low high", low=OR_NAN, high=OR_INFINITE)
layout_of(Fix, "text argument value")
_FINDING = layout_of(Finding, "level code axis text advice keep_s fix?")
layout_of(ReadRange, "from_s duration_s start_ns end_ns")
layout_of(LogFileInfo, "path size_bytes blake2b etag?")
_SOURCE = layout_of(
    Source,
    "path format topics message_types decisions files? range?=read",
    decisions=list_of(lambda node: (node["choice"].text(), node["reason"].text())),
)
layout_of(Gap, "start_s duration_s missing")
_OVERVIEW = layout_of(Overview, "time_s low~time_s high~time_s")
_SPECTRUM = layout_of(
    Spectrum, "sides= frequency_hz=frequency psd~frequency_hz count~frequency_hz model_psd="
)
layout_of(Line, "frequency_hz amplitude", amplitude=OR_NAN)
layout_of(Response, "kind cutoff_hz")
layout_of(Candidate, "model=structure delta", delta=OR_NAN)
_GOODNESS = layout_of(
    Goodness,
    "misfit_score=statistic p_value chi2_per_bin band_hz tau_s lines",
    **dict.fromkeys(("misfit_score", "p_value", "chi2_per_bin"), OR_NAN),
)
_HOMOGENEITY = layout_of(
    TermHomogeneity, "symbol statistic dof p_value spread factor highest_s lowest_s", symbol=one_of(*TERMS)
)
_TRACE = layout_of(Trace, "tau_s= value low high unit=")
_SEGMENTS = layout_of(Segments, "level= start_s end_s~start_s N=white floor terms")
_CURVE = layout_of(
    AllanCurve,
    "level= estimator computed edf_method n tau_s=tau m~tau_s adev=avar~tau_s low= high= edf~tau_s "
    "model_adev= used=",
    tau_s=_rising,
    adev=lambda node: node.array() ** 2,
)
_TERM = layout_of(
    Estimate,
    "symbol name= status value low high unit= datasheet= in_model= alternatives? horizon_s? widening? "
    "correlation_time? phi= q=",
    symbol=one_of(*TERMS),
    low=OR_NAN,
    high=OR_INFINITE,
    alternatives=list_of(one_of(*TERMS)),
    horizon_s=OR_INFINITE,
)
_FIT = layout_of(
    NoiseFit,
    "method model= expression=model rate_hz level criterion goodness terms=estimates parameters covariance "
    "response candidates segments? settings",
    expression=_model,
    goodness=_GOODNESS.read,
    rate_hz=Node.positive,
    level=_level,
    terms=_estimates,
    segments=maybe(_segments),
)
_AXIS = layout_of(
    AxisReport,
    "name sensor axis unit samples rate_hz duration_s mean std gaps curve= minimum= spectrum fit",
    rate_hz=Node.positive,
    mean=OR_NAN,
    std=OR_NAN,
)
_REPORT = layout_of(Report, "version source settings axes findings", axes=list_of(_axis))
_PAIR = layout_of(FilterNumbers, "horizon_s step_s white walk basis ratios")


def to_document(report: Report) -> JsonObject:
    """Return the whole report as JSON values."""
    return _object(
        {
            **_header(report),
            "summary": _summary(report),
            "findings": list(dict.fromkeys(report.all_findings)),
            "filter_numbers": list(_pair_entries(report)) if report.verdict.usable else [],
            "axes": [_axis_entry(axis) for axis in report.axes],
        }
    )


def axis_document(report: Report, axis: AxisReport) -> JsonObject:
    """Return the header, the findings about the axis, and its entry."""
    about = {None, axis.sensor.short, axis.name}
    findings = [f for f in dict.fromkeys(report.all_findings) if f.axis in about]
    return _object({**_header(report), "findings": findings, **_axis_entry(axis)})


def signal_document(report: Report) -> JsonObject:
    """Return the raw signals."""
    axes = {
        axis.name: {field.name: _rounded(getattr(axis.overview, field.name)) for field in fields(Overview)}
        for axis in report.axes
    }
    return _object({"schema": SIGNAL_SCHEMA, "version": report.version, "axes": axes})


def _summary(report: Report) -> JsonObject:
    return {
        axis.name: {
            term.key: {"status": term.status, **picked(term, "value low high"), "unit": unit}
            for term in axis.fit.estimates
            for unit in (TERMS[term.symbol].unit(axis.sensor),)
        }
        for axis in report.axes
        if axis.name in report.verdict.axes
    }


def _rounded(values: FloatArray) -> FloatArray:
    return np.array([float(f"{value:.{_DIGITS}g}") for value in values.tolist()])


def _object(document: Mapping[str, object]) -> JsonObject:
    return {key: plain(value) for key, value in document.items()}


def _header(report: Report) -> JsonObject:
    source, verdict = report.source, report.verdict
    decisions = [{"choice": choice, "reason": reason} for choice, reason in source.decisions]
    return {
        "schema": SCHEMA,
        "version": report.version,
        "verdict": verdict.grade,
        "verdict_sentence": verdict.sentence,
        "source": _SOURCE.write(source, decisions=decisions, range=source.read),
        "settings": report.settings,
    }


def _pair_entries(report: Report) -> Iterator[JsonObject]:
    """Yield the numbers for coasting for 1 min and 5 min."""
    for sensor, axes in report.by_sensor.items():
        for pair in report.usual_pairs(axes):
            units = {"white_unit": TERMS["N"].unit(sensor), "walk_unit": TERMS["K"].unit(sensor)}
            names = [axis.name for axis in axes]
            yield {"sensor": sensor, "axes": names, **_pair_document(pair), **units}


def _pair_document(pair: FilterNumbers) -> JsonObject:
    return _PAIR.write(pair, ratios=[{"time_s": time, "ratio": ratio} for time, ratio in pair.ratios])


def _axis_entry(axis: AxisReport) -> JsonObject:
    """Return the entry of an axis; reading and writing it again changes nothing.

    Deviations are squared first: the root of a squared float is exact, the square of a root is not.
    """
    curve = replace(axis.fit.curve, avar=axis.fit.curve.adev**2)
    spectrum = axis.spectrum
    spectrum = replace(spectrum, frequency=_rounded(spectrum.frequency), psd=_rounded(spectrum.psd))
    fit = replace(axis.fit, curve=curve)
    floor, unit = numbers.minimum(fit), TERMS["B"].datasheet_unit(axis.sensor)
    low, high = curve.confidence_interval(fit.level)
    known = {"level": fit.level, "low": low, "high": high, "model_adev": fit.model_adev(), "used": fit.used}
    return _AXIS.write(
        axis,
        curve=_CURVE.write(curve, adev=curve.adev, **known),
        minimum={
            "adev": floor.value,
            "tau_s": curve.minimum[1],
            "low": floor.low,
            "high": floor.high,
            "datasheet": floor.scaled(unit.factor, unit.name),
        },
        spectrum=_SPECTRUM.write(
            spectrum, sides=2, model_psd=_rounded(fit.model.psd(spectrum.frequency, rate_hz=fit.rate_hz))
        ),
        fit=_fit_entry(fit, axis.sensor),
    )


def _fit_entry(fit: NoiseFit, sensor: Sensor) -> JsonObject:
    return _FIT.write(
        fit,
        model=str(fit.model),
        expression=fit.model.text(),
        terms={estimate.key: _term_entry(estimate, fit, sensor) for estimate in fit.estimates},
        segments=fit.segments and _segments_entry(fit.segments, fit.level, sensor),
    )


def _term_entry(estimate: Estimate, fit: NoiseFit, sensor: Sensor) -> JsonObject:
    kind = TERMS[estimate.symbol]
    message: JsonObject = {
        "name": kind.name(sensor),
        "unit": kind.unit(sensor),
        "in_model": estimate.in_model,
    }
    if len(kind.parameters()) > 1:
        # State of a filter: x[t+1] = phi x[t] + q w[t].
        time, term = estimate.correlation_time, numbers.gauss_markov_term(fit, estimate)
        message["correlation_time"] = time and numbers.correlation_time(time)
        message["phi"] = term and term.phi(1 / fit.rate_hz)
        message["q"] = term and term.q(1 / fit.rate_hz)
    return _TERM.write(estimate, datasheet=numbers.datasheet(estimate, sensor), **message)


def _segments_entry(segments: Segments, level: float, sensor: Sensor) -> JsonObject:
    white, floor = segments.white, segments.floor
    return _SEGMENTS.write(
        segments,
        level=level,
        N=white and _TRACE.write(white, unit=TERMS["N"].unit(sensor)),
        floor=floor and _TRACE.write(floor, tau_s=segments.floor_tau_s, unit=sensor.unit),
        terms={term.key: term for term in segments.terms},
    )


def schema() -> JsonObject:
    """Return the JSON Schema of `report.json`."""
    from importlib.resources import files

    text = files("imucal.report").joinpath("schema", "report-2.schema.json").read_text(encoding="utf-8")
    document: JsonObject = json.loads(text)
    return document


@takes('imucal.load_report("folder")', path=(str, Path))
def load(path: str | Path) -> Report:
    """Read a report back; `path` is a ``report.json`` or its folder.

    Raw signals are empty without ``signal.json`` next to it.

    Raises
    ------
    ReadError
        If the file is missing, is not JSON, or has a schema that this version does not support.
    """
    path = Path(path)
    file = path / "report.json" if path.is_dir() else path
    report = from_document(_parsed(file, "the report.json that imucal writes"), file=str(file))
    signal = file.with_name(SIGNAL_FILE)
    return _with_signals(report, signal) if signal.exists() else report


def _parsed(file: Path, expected: str) -> object:
    try:
        return json.loads(file.read_bytes(), parse_constant=_refuse_constant)
    except FileNotFoundError:
        wrong = "no such file"
    except OSError as error:
        wrong = f"can't be read ({error.strerror})"
    except (ValueError, RecursionError) as error:
        wrong = f"not JSON ({error})"
    raise ReadError(f"{wrong}, expected {expected}", place=file)


def from_document(document: object, *, file: str = "report") -> Report:
    """Return the report of a JSON document, without raw signals.

    Raises ReadError, with the name `file`, if the document has another schema.
    """
    root = Node(document, file)
    found = root.table().get("schema")
    if found != SCHEMA:
        root.fail(f"the schema is {json.dumps(found)}", f'"{SCHEMA}"')
    report = _REPORT.read(root)
    names = {axis.name for axis in report.axes}
    axes = []
    for axis in report.axes:
        own = tuple(finding for finding in report.findings if finding.axis == axis.name)
        axes.append(replace(axis, findings=own))
    others = tuple(finding for finding in report.findings if finding.axis not in names)
    return replace(report, axes=tuple(axes), findings=others)


def _with_signals(report: Report, file: Path) -> Report:
    root = Node(_parsed(file, "the signal.json that imucal writes"), str(file))
    root["schema"].text(SIGNAL_SCHEMA)
    signals = root["axes"].table()
    axes = [
        replace(axis, overview=_OVERVIEW.read(root["axes"][axis.name])) if axis.name in signals else axis
        for axis in report.axes
    ]
    return replace(report, axes=tuple(axes))


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"it contains {name}")
