"""`report.json`: written with stable key order, and read back into the same report.

A cursor over a JSON document that says where something is wrong.

``node["fit"]["method"].text()`` raises `ReadError` with the place, what was found and what was
expected, so that no caller needs to check types.

The bins of a fit as JSON values, and back without losing a digit.

A report as a JSON document: the layout of `report.json`, SI units, NaN as null.

The layout is pinned by ``schema/report-1.schema.json``; a change that an old reader would
misunderstand raises the number in `SCHEMA`. Reading is in `json_file`.
"""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from imucal.allan.curve import AllanCurve
from imucal.allan.dct import Spectrum
from imucal.arrays import FloatArray, IntArray
from imucal.clock import Gap
from imucal.errors import ReadError
from imucal.findings import Finding
from imucal.fitting.bins import BINS_VERSION, Bins
from imucal.fitting.noise_fit import (
    Candidate,
    Estimate,
    Goodness,
    Interval,
    Line,
    NoiseFit,
    Response,
    Segments,
    TermHomogeneity,
    Trace,
)
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS, TERMS
from imucal.recording import Axis, LogFileInfo, ReadRange, Sensor, Source
from imucal.report import numbers
from imucal.report.result import AxisReport, Overview, Report

_SHOWN = 40

A = TypeVar("A")
T = TypeVar("T", bound=np.generic)


@dataclass(frozen=True, slots=True)
class Node:
    """A value of the document and its place, such as ``report.json: axes[2].fit.method``."""

    value: object
    file: str
    place: str = ""

    def __getitem__(self, key: str) -> "Node":
        """Return the value under `key`, which must be there."""
        table = self.table()
        if key not in table:
            keys = ", ".join(table) or "no keys"
            self.fail(f"found {keys}", f"the key {key!r}")
        return Node(table[key], self.file, f"{self.place}.{key}".lstrip("."))

    def __iter__(self) -> Iterator["Node"]:
        """Yield the items of a list."""
        if not isinstance(self.value, list):
            self._refuse("a list")
        for index, item in enumerate(self.value):
            yield Node(item, self.file, f"{self.place}[{index}]")

    def fail(self, found: str, expected: str) -> NoReturn:
        """Raise the error that names this place."""
        where = f"{self.file}: {self.place}" if self.place else self.file
        msg = f"{where}: {found}, expected {expected}; write the report again"
        raise ReadError(msg)

    def table(self) -> dict[str, object]:
        """Return the value, which must be an object."""
        if not isinstance(self.value, dict):
            self._refuse("an object")
        return self.value

    def maybe(self, read: Callable[["Node"], A]) -> A | None:
        """Return None for null, else what `read` makes of the node."""
        return None if self.value is None else read(self)

    def text(self, *allowed: str) -> str:
        """Return the value, which must be a text, one of `allowed` where given."""
        if not isinstance(self.value, str):
            self._refuse("a text")
        if allowed and self.value not in allowed:
            self._refuse(" or ".join(f'"{choice}"' for choice in allowed))
        return self.value

    def texts(self) -> tuple[str, ...]:
        """Return a list of texts."""
        return tuple(item.text() for item in self)

    def number(self, *, null: float | None = None) -> float:
        """Return the value, which must be a number; `null` stands for null where given."""
        if self.value is None and null is not None:
            return null
        if isinstance(self.value, bool) or not isinstance(self.value, int | float):
            self._refuse("a number")
        if not math.isfinite(self.value):
            self._refuse("a finite number")
        return float(self.value)

    def positive(self) -> float:
        """Return the value, which must be a number above 0."""
        value = self.number()
        if value <= 0:
            self._refuse("a number above 0")
        return value

    def count(self) -> int:
        """Return the value, which must be a whole number from 0."""
        if isinstance(self.value, bool) or not isinstance(self.value, int) or self.value < 0:
            self._refuse("a whole number from 0")
        return self.value

    def integer(self) -> int:
        """Return the value, which must be a whole number."""
        if isinstance(self.value, bool) or not isinstance(self.value, int):
            self._refuse("a whole number")
        return self.value

    def pair(self) -> tuple[float, float]:
        """Return a list of two numbers."""
        values = [item.number() for item in self]
        if len(values) != 2:
            self._refuse("a list of two numbers")
        return values[0], values[1]

    def array(self, *, like: int | None = None) -> FloatArray:
        """Return a list of numbers, null as NaN, of `like` items where given; shape (k,)."""
        return self._sized(np.array([item.number(null=math.nan) for item in self], np.float64), like)

    def counts(self, *, like: int | None = None) -> IntArray:
        """Return a list of whole numbers, of `like` items where given; shape (k,)."""
        return self._sized(np.array([item.count() for item in self], dtype=np.int64), like)

    def matrix(self, size: int) -> FloatArray:
        """Return a square list of lists of numbers, null as NaN; shape (size, size)."""
        rows = [row.array(like=size) for row in self]
        if len(rows) != size:
            self._refuse(f"{size} rows")
        return np.array(rows, dtype=np.float64).reshape(size, size)

    def _sized(self, array: NDArray[T], like: int | None) -> NDArray[T]:
        if like is not None and array.size != like:
            self.fail(f"found a list of {array.size}", f"{like} items as beside it")
        return array

    def _refuse(self, expected: str) -> NoReturn:
        found = json.dumps(self.value)
        shown = found if len(found) <= _SHOWN else f"{found[:_SHOWN]}…"
        self.fail(f"found {shown}", expected)


def bins_document(bins: Bins) -> dict[str, object]:
    """Return the JSON values of bins; of the symmetric `gram` the rows of its lower triangle."""
    rows = range(len(bins.names))
    return {
        "version": bins.version,
        "scale": bins.scale,
        "tau0_s": bins.tau0,
        "widening": bins.widening,
        "n": bins.n.tolist(),
        "start": bins.start.tolist(),
        "first": bins.first.tolist(),
        "size": bins.size.tolist(),
        "power": bins.power.tolist(),
        "regressors": list(bins.names),
        "cross": bins.cross.tolist(),
        "gram": [bins.gram[i, j].tolist() for i in rows for j in rows[: i + 1]],
    }


def read_bins(node: Node) -> Bins:
    """Return the bins of a document.

    Raises
    ------
    ReadError
        If they are of another version, or their lists do not belong together.
    """
    version = node["version"].count()
    if version != BINS_VERSION:
        node["version"].fail(f"found {version}", f"{BINS_VERSION}, as this version of imucal writes")
    names = node["regressors"].texts()
    n = node["n"].counts()
    start, first = node["start"].counts(like=n.size), node["first"].counts()
    if not n.size or start[0] != 0 or np.any(np.diff([*start, first.size]) < 1):
        node["start"].fail("found starts that are not those of blocks", "rising ones from 0")
    blocks = zip(n.tolist(), np.split(first, start[1:]), strict=True)
    if not all(own[0] >= 1 and own[-1] < size and np.all(np.diff(own) > 0) for size, own in blocks):
        node["first"].fail("found ordinates that do not rise within a block", "rising ones below its n")
    cross = [row.array(like=first.size) for row in node["cross"]]
    lower = [row.array(like=first.size) for row in node["gram"]]
    r = len(names)
    if len(cross) != r or len(lower) != r * (r + 1) // 2 or not r:
        node["cross"].fail(f"found {len(cross)} and {len(lower)} lists", f"those of {r} regressors")
    gram = np.zeros((r, r, first.size))
    for i, j, row in zip(*np.tril_indices(r), lower, strict=True):
        gram[i, j] = gram[j, i] = row
    return Bins(
        n=n,
        start=start,
        first=first,
        size=node["size"].array(like=first.size),
        power=node["power"].array(like=first.size),
        names=names,
        cross=np.array(cross),
        gram=gram,
        scale=node["scale"].positive(),
        tau0=node["tau0_s"].positive(),
        widening=node["widening"].positive(),
        version=version,
    )


#: Name and number of the layout.
SCHEMA = "imucal/report/1"


def to_document(report: Report) -> dict[str, object]:
    """Return the whole report as JSON values, keys in a stable order."""
    return {
        **_header(report),
        "axes": [_document_axis(axis, bins=_with_bins(report)) for axis in report.axes],
        "findings": [_document_finding(f) for f in report.findings],
    }


def axis_document(report: Report, axis: AxisReport) -> dict[str, object]:
    """Return the document of one axis: the header of the report and the axis's own entry."""
    return {**_header(report), **_document_axis(axis, bins=_with_bins(report))}


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
        "source": _document_source(report.source),
        "settings": plain(report.settings),
    }


def _document_source(source: Source) -> dict[str, object]:
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
        "range": None if source.read is None else _document_range(source.read),
    }


def _document_range(read: ReadRange) -> dict[str, object]:
    return {
        "from_s": plain(read.from_s),
        "duration_s": plain(read.duration_s),
        "start_ns": read.start_ns,
        "end_ns": read.end_ns,
    }


def _document_axis(axis: AxisReport, *, bins: bool) -> dict[str, object]:
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
        "curve": _document_curve(axis.fit),
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
        "fit": _document_fit(axis.fit, axis.sensor, bins=bins),
        "findings": [_document_finding(f) for f in axis.findings],
    }


def _document_curve(fit: NoiseFit) -> dict[str, object]:
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


def _document_fit(fit: NoiseFit, sensor: Sensor, *, bins: bool) -> dict[str, object]:
    response = fit.response
    return {
        "method": fit.method,
        "model": str(fit.model),
        "expression": fit.model.text(),
        "rate_hz": fit.rate_hz,
        "level": fit.level,
        "criterion": fit.criterion,
        "goodness": _document_goodness(fit.goodness),
        "terms": _terms(fit, sensor),
        "parameters": list(fit.parameters),
        "covariance": plain(fit.covariance),
        "response": response and {"kind": response.kind, "cutoff_hz": plain(response.cutoff_hz)},
        "candidates": [{"model": c.structure, "delta": plain(c.delta)} for c in fit.candidates],
        "segments": fit.segments and _document_segments(fit.segments, fit, sensor),
        "settings": plain(fit.settings),
        "findings": [_document_finding(f) for f in fit.findings],
        **({"bins": bins_document(fit.bins)} if bins and fit.bins else {}),
    }


def _document_goodness(goodness: Goodness) -> dict[str, object]:
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
        if len(TERMS[estimate.symbol].parameters()) > 1:
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


def _document_segments(segments: Segments, fit: NoiseFit, sensor: Sensor) -> dict[str, object]:
    return {
        "level": fit.level,
        "start_s": plain(segments.start_s),
        "end_s": plain(segments.end_s),
        "N": segments.white and _document_trace(segments.white, TERMS["N"].unit(sensor)),
        "floor": segments.floor
        and {"tau_s": plain(segments.floor_tau_s), **_document_trace(segments.floor, sensor.unit)},
        "terms": {term.key: _document_homogeneity(term) for term in segments.terms},
    }


def _document_trace(trace: Trace, unit: str) -> dict[str, object]:
    return {
        "value": plain(trace.value),
        "low": plain(trace.low),
        "high": plain(trace.high),
        "unit": unit,
    }


def _document_homogeneity(term: TermHomogeneity) -> dict[str, object]:
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


def _document_finding(finding: Finding) -> dict[str, object]:
    return {
        "level": finding.level,
        "code": finding.code,
        "axis": finding.axis,
        "text": finding.text,
        "advice": finding.advice,
        "keep_s": plain(finding.keep_s),
    }


_INDENT = "  "
_AXES: dict[str, Axis] = {"x": "x", "y": "y", "z": "z"}


def dumps(document: object) -> str:
    """Return the text of a JSON document: one key a line, a list of plain values on one line."""
    return _text(document, "") + "\n"


def schema() -> dict[str, object]:
    """Return the JSON Schema of `report.json`, as the package ships it."""
    from importlib.resources import files

    text = files("imucal.report").joinpath("schema", "report-1.schema.json").read_text(encoding="utf-8")
    document: dict[str, object] = json.loads(text)
    return document


def load(path: Path) -> Report:
    """Read a report back; `path` is a ``report.json`` or the report's folder.

    Raises
    ------
    ReadError
        If the file is missing, is not JSON, or is not a report of the schema this version knows.
    """
    file = path / "report.json" if path.is_dir() else path
    try:
        document = json.loads(file.read_bytes(), parse_constant=_refuse_constant)
    except FileNotFoundError:
        msg = f"{file}: no such file, expected the report.json that imucal writes"
        raise ReadError(msg) from None
    except OSError as error:
        msg = f"{file}: can't be read ({error.strerror}), expected the report.json that imucal writes"
        raise ReadError(msg) from error
    except (ValueError, RecursionError) as error:
        msg = f"{file}: not JSON ({error}), expected the report.json that imucal writes"
        raise ReadError(msg) from error
    return from_document(document, file=str(file))


def from_document(document: object, *, file: str = "report") -> Report:
    """Return the report of a JSON document; messages name `file`.

    Raises
    ------
    ReadError
        If the document is not a report of the schema this version knows.
    """
    root = Node(document, file)
    found = root.table().get("schema")
    if found != SCHEMA:
        root.fail(f"the schema is {json.dumps(found)}", f'"{SCHEMA}"')
    return Report(
        source=_source(root["source"]),
        axes=tuple(_axis(node) for node in root["axes"]),
        settings=root["settings"].table(),
        findings=_findings(root["findings"]),
        version=root["version"].text(),
    )


def _refuse_constant(name: str) -> object:
    msg = f"it holds {name}"
    raise ValueError(msg)


def _text(value: object, indent: str) -> str:
    inner = indent + _INDENT
    if isinstance(value, dict) and value:
        lines = [f"{inner}{json.dumps(k)}: {_text(v, inner)}" for k, v in value.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        lines = [inner + _text(item, inner) for item in value]
        return "[\n" + ",\n".join(lines) + f"\n{indent}]"
    return json.dumps(value, allow_nan=False, ensure_ascii=False)


def _source(node: Node) -> Source:
    return Source(
        path=node["path"].text(),
        format=node["format"].text(),
        topics=node["topics"].texts(),
        message_types=node["message_types"].texts(),
        decisions=tuple((d["choice"].text(), d["reason"].text()) for d in node["decisions"]),
        files=tuple(map(_file, node["files"])) if "files" in node.table() else (),
        read=node["range"].maybe(_range) if "range" in node.table() else None,
    )


def _file(node: Node) -> LogFileInfo:
    return LogFileInfo(
        path=node["path"].text(),
        size_bytes=node["size_bytes"].count(),
        blake2b=node["blake2b"].maybe(Node.text),
        etag=node["etag"].text() if "etag" in node.table() else None,
    )


def _range(node: Node) -> ReadRange:
    return ReadRange(
        from_s=node["from_s"].number(),
        duration_s=node["duration_s"].number(),
        start_ns=node["start_ns"].maybe(Node.integer),
        end_ns=node["end_ns"].maybe(Node.integer),
    )


def _axis(node: Node) -> AxisReport:
    sensor = Sensor(node["sensor"].text(*Sensor))
    return AxisReport(
        sensor=sensor,
        axis=_AXES[node["axis"].text(*_AXES)],
        samples=node["samples"].count(),
        rate_hz=node["rate_hz"].positive(),
        duration_s=node["duration_s"].number(),
        mean=node["mean"].number(null=math.nan),
        std=node["std"].number(null=math.nan),
        gaps=tuple(_gap(gap) for gap in node["gaps"]),
        spectrum=_spectrum(node["spectrum"]),
        overview=_overview(node["overview"]),
        fit=_fit(node["fit"], node["curve"], sensor),
        findings=_findings(node["findings"]),
    )


def _gap(node: Node) -> Gap:
    return Gap(
        start_s=node["start_s"].number(),
        duration_s=node["duration_s"].number(),
        missing=node["missing"].count(),
    )


def _spectrum(node: Node) -> Spectrum:
    frequency = node["frequency_hz"].array()
    k = frequency.size
    return Spectrum(frequency=frequency, psd=node["psd"].array(like=k), count=node["count"].array(like=k))


def _overview(node: Node) -> Overview:
    time = node["time_s"].array()
    return Overview(
        time_s=time, low=node["low"].array(like=time.size), high=node["high"].array(like=time.size)
    )


def _curve(node: Node) -> AllanCurve:
    tau = node["tau_s"].array()
    k = tau.size
    if not np.all(np.diff(tau) > 0):
        node["tau_s"].fail("found averaging times that do not rise", "rising ones")
    return AllanCurve(
        tau=tau,
        m=node["m"].counts(like=k),
        avar=node["adev"].array(like=k) ** 2,
        edf=node["edf"].array(like=k),
        n=node["n"].count(),
        estimator=node["estimator"].text(),
        computed=node["computed"].text(),
        edf_method=node["edf_method"].text(),
    )


def _fit(node: Node, curve_node: Node, sensor: Sensor) -> NoiseFit:
    curve = _curve(curve_node)
    used = curve_node["used"].counts()
    if used.size and used.max() >= curve.tau.size:
        curve_node["used"].fail(f"found the index {used.max()}", f"less than {curve.tau.size}")
    parameters = node["parameters"].texts()
    return NoiseFit(
        method=node["method"].text(),
        sensor=sensor,
        rate_hz=node["rate_hz"].positive(),
        level=_level(node["level"]),
        model=_model(node["expression"]),
        estimates=_estimates(node["terms"]),
        parameters=parameters,
        covariance=node["covariance"].matrix(len(parameters)),
        goodness=_goodness(node["goodness"]),
        curve=curve,
        used=used,
        response=node["response"].maybe(_response),
        candidates=tuple(
            Candidate(structure=c["model"].text(), delta=c["delta"].number(null=math.nan))
            for c in node["candidates"]
        ),
        criterion=node["criterion"].text(),
        findings=_findings(node["findings"]),
        settings=node["settings"].table(),
        segments=_segments(node["segments"]) if "segments" in node.table() else None,
        bins=read_bins(node["bins"]) if "bins" in node.table() else None,
    )


def _segments(node: Node) -> Segments | None:
    if node.value is None:
        return None
    start = node["start_s"].array()
    floor = node["floor"]
    return Segments(
        start_s=start,
        end_s=node["end_s"].array(like=start.size),
        white=node["N"].maybe(lambda white: _trace(white, start.size)),
        floor=floor.maybe(lambda floor: _trace(floor, start.size)),
        floor_tau_s=math.nan if floor.value is None else floor["tau_s"].positive(),
        terms=tuple(_homogeneity(node["terms"][key], key) for key in node["terms"].table()),
    )


def _trace(node: Node, size: int) -> Trace:
    value, low, high = (node[name].array(like=size) for name in ("value", "low", "high"))
    return Trace(value=value, low=low, high=high)


def _homogeneity(node: Node, key: str) -> TermHomogeneity:
    return TermHomogeneity(
        key=key,
        symbol=node["symbol"].text(*TERMS),
        statistic=node["statistic"].number(),
        dof=node["dof"].count(),
        p_value=node["p_value"].number(),
        spread=node["spread"].number(),
        factor=node["factor"].number(),
        highest_s=node["highest_s"].pair(),
        lowest_s=node["lowest_s"].pair(),
    )


def _response(node: Node) -> Response:
    return Response(kind=node["kind"].text(), cutoff_hz=node["cutoff_hz"].number())


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
        node.fail(f"found a model that can't be read ({error})", "a sum of valued terms")


def _estimates(node: Node) -> tuple[Estimate, ...]:
    for always in ALWAYS:
        node[always].table()
    return tuple(_estimate(node[key], key) for key in node.table())


def _estimate(node: Node, key: str) -> Estimate:
    status = node["status"].text("estimated", "bounded")
    value = node["value"].maybe(Node.number)
    if (value is None) != (status == "bounded"):
        node["value"].fail(f"found {json.dumps(node['value'].value)}", f"a value that fits {status!r}")
    keys = node.table().keys()
    return Estimate(
        key=key,
        symbol=node["symbol"].text(*TERMS),
        status="bounded" if value is None else "estimated",
        value=value,
        low=node["low"].number(null=math.nan),
        high=node["high"].number(null=math.inf),
        correlation_time=node["correlation_time"].maybe(_interval) if "correlation_time" in keys else None,
        alternatives=tuple(i.text(*TERMS) for i in node["alternatives"]) if "alternatives" in keys else (),
        widening=node["widening"].number() if "widening" in keys else 1.0,
    )


def _interval(node: Node) -> Interval:
    return Interval(
        value=node["value"].number(),
        low=node["low"].number(null=math.nan),
        high=node["high"].number(null=math.inf),
    )


def _goodness(node: Node) -> Goodness:
    return Goodness(
        statistic=node["statistic"].number(null=math.nan),
        p_value=node["p_value"].number(null=math.nan),
        chi2_per_bin=node["chi2_per_bin"].number(null=math.nan),
        band_hz=node["band_hz"].maybe(Node.pair),
        tau_s=node["tau_s"].maybe(Node.pair),
        lines=tuple(
            Line(
                frequency_hz=line["frequency_hz"].number(), amplitude=line["amplitude"].number(null=math.nan)
            )
            for line in node["lines"]
        ),
    )


def _findings(node: Node) -> tuple[Finding, ...]:
    return tuple(_finding(item) for item in node)


def _finding(node: Node) -> Finding:
    level = node["level"].text("info", "warning", "error")
    return Finding(
        level="info" if level == "info" else "warning" if level == "warning" else "error",
        code=node["code"].text(),
        axis=node["axis"].maybe(Node.text),
        text=node["text"].text(),
        advice=node["advice"].text(),
        keep_s=node["keep_s"].maybe(Node.pair),
    )
