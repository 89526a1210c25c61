"""`report.json` and `signal.json`: SI units, keys in a stable order; written and read back."""

import json
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import NoReturn, TypeVar

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.allan.dct import Spectrum
from imucal.arrays import FloatArray
from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.fitting.noise_fit import Estimate, Interval, NoiseFit, Segments
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS, TERMS
from imucal.recording import Sensor
from imucal.report import numbers
from imucal.report.document import (
    SCHEMA,
    SIGNAL_SCHEMA,
    AxisEntry,
    CurveEntry,
    Document,
    FilterEntry,
    FitEntry,
    Header,
    MinimumEntry,
    QuantityEntry,
    SignalDocument,
    SpectrumEntry,
    SummaryEntry,
    TermEntry,
)
from imucal.report.result import AxisReport, Overview, Report
from imucal.report.typed_json import JsonObject, Place, check_length, from_json, hints_of, to_json

#: Pictures need the raw signals, scripts do not.
SIGNAL_FILE = "signal.json"
#: Digits of spectra and signals: enough for pictures, and half the size.
_DIGITS = 8
#: What to do about a wrong file.
_FIX = "run 'imucal fit' again"

A = TypeVar("A")


def to_document(report: Report) -> JsonObject:
    """Return the whole report as JSON values."""
    header = _header(report, report.all_findings)
    filter_numbers = tuple(_filter_entries(report)) if report.verdict.usable else ()
    axes = tuple(_axis_entry(axis) for axis in report.axes)
    document = _converted(
        Document, header, summary=_summary(report), filter_numbers=filter_numbers, axes=axes
    )
    return _object(document)


def axis_document(report: Report, axis: AxisReport) -> JsonObject:
    """Return the header, the findings about the axis, and its entry."""
    about = {None, axis.sensor.short, axis.name}
    findings = tuple(finding for finding in report.all_findings if finding.axis in about)
    return _object(_header(report, findings)) | _object(_axis_entry(axis))


def signal_document(report: Report) -> JsonObject:
    """Return the raw signals."""
    axes = {}
    for axis in report.axes:
        signal = {name: _rounded(getattr(axis.overview, name)) for name in hints_of(Overview)}
        axes[axis.name] = Overview(**signal)
    return _object(SignalDocument(schema=SIGNAL_SCHEMA, version=report.version, axes=axes))


def _object(value: object) -> JsonObject:
    document: JsonObject = to_json(value)
    return document


def _converted(kind: type[A], source: object, **others: object) -> A:
    """Return a dataclass with the attributes of another one; `others` replace them."""
    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    shared = {name: getattr(source, name) for name in names if hasattr(source, name)}
    return kind(**{**shared, **others})


def _rounded(values: FloatArray) -> FloatArray:
    return np.array([float(f"{value:.{_DIGITS}g}") for value in values.tolist()])


def _header(report: Report, findings: tuple[Finding, ...]) -> Header:
    return Header(
        schema=SCHEMA,
        version=report.version,
        verdict=report.verdict.grade,
        verdict_sentence=report.verdict.sentence,
        source=report.source,
        settings=report.settings,
        findings=tuple(dict.fromkeys(findings)),
    )


def _summary(report: Report) -> dict[str, dict[str, SummaryEntry]]:
    return {
        axis.name: {
            term.key: _converted(SummaryEntry, term, unit=TERMS[term.symbol].unit(axis.sensor))
            for term in axis.fit.estimates
        }
        for axis in report.axes
        if axis.name in report.verdict.axes
    }


def _filter_entries(report: Report) -> Iterator[FilterEntry]:
    """Yield the numbers for coasting for 1 min and 5 min."""
    for sensor, axes in report.by_sensor.items():
        names = tuple(axis.name for axis in axes)
        white_unit, walk_unit = TERMS["N"].unit(sensor), TERMS["K"].unit(sensor)
        for pair in report.usual_pairs(axes):
            yield _converted(
                FilterEntry, pair, sensor=sensor, axes=names, white_unit=white_unit, walk_unit=walk_unit
            )


def _axis_entry(axis: AxisReport) -> AxisEntry:
    """Return the entry of an axis; reading and writing it again changes nothing.

    Deviations are squared first: the root of a squared float is exact, the square of a root is not.
    """
    fit = replace(axis.fit, curve=replace(axis.fit.curve, avar=axis.fit.curve.adev**2))
    frequency_hz = _rounded(axis.spectrum.frequency)
    spectrum = SpectrumEntry(
        sides=2,
        frequency_hz=frequency_hz,
        psd=_rounded(axis.spectrum.psd),
        count=axis.spectrum.count,
        model_psd=_rounded(fit.model.psd(frequency_hz, rate_hz=fit.rate_hz)),
    )
    return _converted(
        AxisEntry,
        axis,
        curve=_curve_entry(fit),
        minimum=_minimum_entry(fit, axis.sensor),
        spectrum=spectrum,
        fit=_fit_entry(fit, axis.sensor),
    )


def _curve_entry(fit: NoiseFit) -> CurveEntry:
    low, high = fit.curve.confidence_interval(fit.level)
    return _converted(
        CurveEntry,
        fit.curve,
        level=fit.level,
        tau_s=fit.curve.tau,
        low=low,
        high=high,
        model_adev=fit.model_adev(),
        used=fit.used,
    )


def _minimum_entry(fit: NoiseFit, sensor: Sensor) -> MinimumEntry:
    floor, unit = numbers.minimum(fit), TERMS["B"].datasheet_unit(sensor)
    adev, tau_s = fit.curve.minimum
    datasheet = _converted(QuantityEntry, floor.scaled(unit.factor, unit.name))
    return MinimumEntry(adev=adev, tau_s=tau_s, low=floor.low, high=floor.high, datasheet=datasheet)


def _fit_entry(fit: NoiseFit, sensor: Sensor) -> FitEntry:
    return _converted(
        FitEntry,
        fit,
        model=str(fit.model),
        expression=fit.model.text(),
        terms={estimate.key: _term_entry(estimate, fit, sensor) for estimate in fit.estimates},
        covariance=tuple(fit.covariance),
    )


def _term_entry(estimate: Estimate, fit: NoiseFit, sensor: Sensor) -> TermEntry:
    kind, time = TERMS[estimate.symbol], estimate.correlation_time
    term = numbers.gauss_markov_term(fit, estimate)
    tau0 = 1 / fit.rate_hz
    return _converted(
        TermEntry,
        estimate,
        name=kind.name(sensor),
        unit=kind.unit(sensor),
        datasheet=_converted(QuantityEntry, numbers.datasheet(estimate, sensor)),
        correlation_time=time and _converted(QuantityEntry, numbers.correlation_time(time)),
        # State of a filter: x[t+1] = phi x[t] + q w[t].
        phi=term and term.phi(tau0),
        q=term and term.q(tau0),
    )


def schema() -> JsonObject:
    """Return the JSON Schema of `report.json`."""
    from importlib.resources import files

    text = files("imucal.report").joinpath("schema", "report-4.schema.json").read_text(encoding="utf-8")
    document: JsonObject = json.loads(text)
    return document


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
    root = Place(file, _FIX)
    root.check_schema(document, SCHEMA)
    entries = from_json(Document, document, root)
    axes = []
    for index, entry in enumerate(entries.axes):
        axis = _axis(entry, root.key("axes").item(index))
        findings = tuple(finding for finding in entries.findings if finding.axis == axis.name)
        axes.append(replace(axis, findings=findings))
    names = {axis.name for axis in axes}
    others = tuple(finding for finding in entries.findings if finding.axis not in names)
    return _converted(Report, entries, axes=tuple(axes), findings=others)


def _axis(entry: AxisEntry, place: Place) -> AxisReport:
    spectrum = entry.spectrum
    return _converted(
        AxisReport,
        entry,
        spectrum=Spectrum(frequency=spectrum.frequency_hz, psd=spectrum.psd, count=spectrum.count),
        overview=Overview.none(),
        fit=_fit(entry, place),
    )


def _fit(axis: AxisEntry, place: Place) -> NoiseFit:
    entry, inner = axis.fit, place.key("fit")
    size = len(entry.parameters)
    check_length(entry.covariance, size, inner.key("covariance"))
    for index, row in enumerate(entry.covariance):
        check_length(row, size, inner.key("covariance").item(index))
    if entry.segments is not None:
        _check_segments(entry.segments, inner.key("segments"))
    return _converted(
        NoiseFit,
        entry,
        sensor=axis.sensor,
        model=_model(entry.expression, inner.key("expression")),
        estimates=_estimates(entry, inner.key("terms")),
        covariance=np.array(entry.covariance, dtype=np.float64).reshape(size, size),
        curve=_curve(axis.curve, place.key("curve")),
        used=axis.curve.used,
    )


def _curve(entry: CurveEntry, place: Place) -> AllanCurve:
    if not np.all(np.diff(entry.tau_s) > 0):
        place.key("tau_s").refuse("found averaging times that do not increase", "increasing ones")
    if entry.used.size and entry.used.max() >= entry.tau_s.size:
        place.key("used").refuse(f"found the index {entry.used.max()}", f"less than {entry.tau_s.size}")
    return _converted(AllanCurve, entry, tau=entry.tau_s, avar=entry.adev**2)


def _model(expression: str, place: Place) -> NoiseModel:
    if not expression:
        return NoiseModel(terms=())
    try:
        return NoiseModel.parse(expression)
    except ValueError as error:
        place.refuse(f"found a model that can't be read ({error})", "a sum of terms with values")


def _estimates(fit: FitEntry, place: Place) -> tuple[Estimate, ...]:
    for always in ALWAYS:
        if always not in fit.terms:
            place.refuse(f"found {', '.join(fit.terms) or 'no keys'}", f"the key {always!r}")
    return tuple(_estimate(key, entry, place.key(key)) for key, entry in fit.terms.items())


def _estimate(key: str, entry: TermEntry, place: Place) -> Estimate:
    if (entry.value is None) != (entry.status == "bounded"):
        place.key("value").refuse_value(entry.value, f"a value that fits {entry.status!r}")
    time = entry.correlation_time
    if time is not None and time.value is None:
        place.key("correlation_time").key("value").refuse_value(None, "a number")
    return _converted(Estimate, entry, key=key, correlation_time=time and _converted(Interval, time))


def _check_segments(segments: Segments, place: Place) -> None:
    for index, term in enumerate(segments.terms):
        if term.symbol not in TERMS:
            place.key("terms").item(index).key("symbol").refuse_value(term.symbol, " or ".join(TERMS))
    size = segments.start_s.size
    check_length(segments.end_s, size, place.key("end_s"))
    for name, trace in (("white", segments.white), ("floor", segments.floor)):
        if trace is not None:
            for limit in ("value", "low", "high"):
                check_length(getattr(trace, limit), size, place.key(name).key(limit))


def _with_signals(report: Report, file: Path) -> Report:
    root = Place(str(file), _FIX)
    document = _parsed(file, "the signal.json that imucal writes")
    root.check_schema(document, SIGNAL_SCHEMA)
    signals = from_json(SignalDocument, document, root).axes
    for name, signal in signals.items():
        for limit in ("low", "high"):
            place = root.key("axes").key(name).key(limit)
            check_length(getattr(signal, limit), signal.time_s.size, place)
    axes = tuple(replace(axis, overview=signals.get(axis.name, axis.overview)) for axis in report.axes)
    return replace(report, axes=axes)


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"it contains {name}")
