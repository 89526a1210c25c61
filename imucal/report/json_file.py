"""`report.json`: SI units, keys in a stable order, NaN as null; written, and read back into the same report.

The layout is pinned by ``schema/report-1.schema.json``; a change that an old reader would misunderstand
raises the number in `SCHEMA`. A value of the document knows its place: ``node["fit"]["method"].text()``
raises `ReadError` with the place, what was found and what was expected, so no caller needs to check types.
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path, PurePath
from typing import Generic, NoReturn, TypeVar

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
from imucal.prediction.filter_numbers import FilterNumbers, usual_pairs
from imucal.recording import Axis, LogFileInfo, ReadRange, Sensor, Source
from imucal.report import numbers
from imucal.report.result import AxisReport, Overview, Report

#: Name and number of the layout.
SCHEMA = "imucal/report/1"
#: Most signs of a wrong value that a message shows.
_SHOWN = 40

A = TypeVar("A")
B = TypeVar("B")
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

    def get(self, key: str, read: Callable[["Node"], A], default: B) -> A | B:
        """Return what `read` makes of the value under `key`; `default` where it is not there."""
        return read(self[key]) if key in self.table() else default

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


@dataclass(frozen=True, slots=True)
class Layout(Generic[A]):
    """An object of the document that is one value of ours: each key is an attribute, with how it is read."""

    make: Callable[..., A]
    keys: Mapping[str, Callable[[Node], object]]

    def read(self, node: Node, **known: object) -> A:
        """Return the value of an object; `known` are attributes that do not stand in it."""
        return self.make(**{key: read(node[key]) for key, read in self.keys.items()}, **known)

    def write(self, value: A) -> dict[str, object]:
        """Return the value as an object."""
        return {key: getattr(value, key) for key in self.keys}

    def read_all(self, node: Node) -> tuple[A, ...]:
        """Return the values of a list of objects."""
        return tuple(self.read(item) for item in node)

    def write_all(self, values: Iterable[A]) -> list[dict[str, object]]:
        """Return the values as a list of objects."""
        return [self.write(value) for value in values]


def _one_of(*allowed: str) -> Callable[[Node], str]:
    return lambda node: node.text(*allowed)


def _maybe(read: Callable[[Node], A]) -> Callable[[Node], A | None]:
    return lambda node: node.maybe(read)


def _or_nan(node: Node) -> float:
    return node.number(null=math.nan)


#: Type of an attribute -> how its value is read, where nothing else is said.
_READ: dict[object, Callable[[Node], object]] = {
    str: Node.text,
    int: Node.count,
    float: Node.number,
    str | None: _maybe(Node.text),
    int | None: _maybe(Node.integer),
    tuple[float, float]: Node.pair,
    tuple[float, float] | None: _maybe(Node.pair),
}


def _layout(make: type[A], keys: str, **read: Callable[[Node], object]) -> Layout[A]:
    """Return the layout of a dataclass, whose attributes are read by their types or as is said here."""
    types = {each.name: each.type for each in fields(make)}  # type: ignore[arg-type]
    return Layout(make, {key: read.get(key) or _READ[types[key]] for key in keys.split()})


_FINDING = _layout(Finding, "level code axis text advice keep_s", level=_one_of("info", "warning", "error"))
_RANGE = _layout(ReadRange, "from_s duration_s start_ns end_ns")
_FILE = _layout(LogFileInfo, "path size_bytes blake2b")
_GAP = _layout(Gap, "start_s duration_s missing")
_LINE = _layout(Line, "frequency_hz amplitude", amplitude=_or_nan)
_RESPONSE = _layout(Response, "kind cutoff_hz")
_GOODNESS = _layout(
    Goodness,
    "statistic p_value chi2_per_bin band_hz tau_s lines",
    **dict.fromkeys(("statistic", "p_value", "chi2_per_bin"), _or_nan),
    lines=_LINE.read_all,
)
_HOMOGENEITY = _layout(
    TermHomogeneity,
    "symbol statistic dof p_value spread factor highest_s lowest_s",
    symbol=_one_of(*TERMS),
)
_INTERVAL = _layout(Interval, "value low high", low=_or_nan, high=lambda node: node.number(null=math.inf))


def _bins_document(bins: Bins) -> dict[str, object]:
    """Return the JSON values of bins; of the symmetric `gram` the rows of its lower triangle."""
    return {
        "version": bins.version,
        "scale": bins.scale,
        "tau0_s": bins.tau0,
        "widening": bins.widening,
        "n": bins.n,
        "start": bins.start,
        "first": bins.first,
        "size": bins.size,
        "power": bins.power,
        "regressors": bins.names,
        "cross": bins.cross,
        "gram": bins.gram[np.tril_indices(len(bins.names))],
    }


def _bins(node: Node) -> Bins:
    """Return the bins of a document, whose lists must belong together."""
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


def to_document(report: Report) -> dict[str, object]:
    """Return the whole report as JSON values, keys in a stable order."""
    report = replace(report, axes=tuple(map(_as_held, report.axes)))
    axes = [_axis_entry(axis, bins=_with_bins(report)) for axis in report.axes]
    pairs = list(_pair_entries(report)) if report.verdict.usable else []
    findings = _FINDING.write_all(report.findings)
    return _object({**_header(report), "filter_numbers": pairs, "axes": axes, "findings": findings})


def axis_document(report: Report, axis: AxisReport) -> dict[str, object]:
    """Return the document of one axis: the header of the report and the axis's own entry."""
    return _object({**_header(report), **_axis_entry(_as_held(axis), bins=_with_bins(report))})


def _with_bins(report: Report) -> bool:
    """Whether the report was asked to hold the bins of its fits."""
    return report.settings.get("bins") is True


def _object(document: Mapping[str, object]) -> dict[str, object]:
    return {key: plain(value) for key, value in document.items()}


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
    source, verdict = report.source, report.verdict
    return {
        "schema": SCHEMA,
        "version": report.version,
        "verdict": verdict.grade,
        "verdict_sentence": verdict.sentence,
        "source": {
            "path": source.path,
            "format": source.format,
            "topics": source.topics,
            "message_types": source.message_types,
            "decisions": [{"choice": choice, "reason": reason} for choice, reason in source.decisions],
            "files": [
                _FILE.write(f) | ({"etag": f.etag} if f.etag is not None else {}) for f in source.files
            ],
            "range": source.read and _RANGE.write(source.read),
        },
        "settings": report.settings,
    }


def _as_held(axis: AxisReport) -> AxisReport:
    """Return an axis as it will be read back, so that reading and writing again changes nothing.

    The file holds deviations. Squaring them first does it, because the square root of a squared float is
    that float, while the converse does not hold.
    """
    curve = replace(axis.fit.curve, avar=axis.fit.curve.adev**2)
    return replace(axis, fit=replace(axis.fit, curve=curve))


def _pair_entries(report: Report) -> Iterator[dict[str, object]]:
    """Yield what covers each sensor's spectrum, for filters that coast for a minute and for five."""
    for sensor, axes in report.by_sensor.items():
        for pair in usual_pairs([axis.fit for axis in axes]):
            units = {"white_unit": TERMS["N"].unit(sensor), "walk_unit": TERMS["K"].unit(sensor)}
            names = [axis.name for axis in axes]
            yield {"sensor": str(sensor), "axes": names, **pair_document(pair), **units}


def pair_document(pair: FilterNumbers) -> dict[str, object]:
    """Return the two numbers for a filter, and what they cost, as JSON values."""
    return {
        "horizon_s": pair.horizon_s,
        "step_s": pair.step_s,
        "white": pair.white,
        "walk": pair.walk,
        "basis": pair.basis,
        "ratios": [{"time_s": time, "ratio": ratio} for time, ratio in pair.ratios],
    }


def _axis_entry(axis: AxisReport, *, bins: bool) -> dict[str, object]:
    fit, curve = axis.fit, axis.fit.curve
    floor, level = numbers.minimum(fit), TERMS["B"].datasheet_unit(axis.sensor)
    low, high = curve.confidence_interval(fit.level)
    return {
        "name": axis.name,
        "sensor": str(axis.sensor),
        "axis": axis.axis,
        "unit": axis.unit,
        "samples": axis.samples,
        "rate_hz": axis.rate_hz,
        "duration_s": axis.duration_s,
        "mean": axis.mean,
        "std": axis.std,
        "gaps": _GAP.write_all(axis.gaps),
        "curve": {
            "level": fit.level,
            "estimator": curve.estimator,
            "computed": curve.computed,
            "edf_method": curve.edf_method,
            "n": curve.n,
            "tau_s": curve.tau,
            "m": curve.m,
            "adev": curve.adev,
            "low": low,
            "high": high,
            "edf": curve.edf,
            "model_adev": fit.model_adev(),
            "used": fit.used,
        },
        "minimum": {
            "adev": floor.value,
            "tau_s": curve.minimum[1],
            "low": floor.low,
            "high": floor.high,
            "datasheet": _quantity(floor.scaled(level.factor, level.name)),
        },
        "spectrum": {
            "sides": 2,
            "frequency_hz": axis.spectrum.frequency,
            "psd": axis.spectrum.psd,
            "count": axis.spectrum.count,
            "model_psd": fit.model.psd(axis.spectrum.frequency, rate_hz=fit.rate_hz),
        },
        "overview": {"time_s": axis.overview.time_s, "low": axis.overview.low, "high": axis.overview.high},
        "fit": _fit_entry(fit, axis.sensor, bins=bins),
        "findings": _FINDING.write_all(axis.findings),
    }


def _fit_entry(fit: NoiseFit, sensor: Sensor, *, bins: bool) -> dict[str, object]:
    return {
        "method": fit.method,
        "model": str(fit.model),
        "expression": fit.model.text(),
        "rate_hz": fit.rate_hz,
        "level": fit.level,
        "criterion": fit.criterion,
        "goodness": _GOODNESS.write(fit.goodness) | {"lines": _LINE.write_all(fit.goodness.lines)},
        "terms": {estimate.key: _term_entry(estimate, fit, sensor) for estimate in fit.estimates},
        "parameters": fit.parameters,
        "covariance": fit.covariance,
        "response": fit.response and _RESPONSE.write(fit.response),
        "candidates": [{"model": c.structure, "delta": c.delta} for c in fit.candidates],
        "segments": fit.segments and _segments_entry(fit.segments, fit.level, sensor),
        "settings": fit.settings,
        "findings": _FINDING.write_all(fit.findings),
        **({"bins": _bins_document(fit.bins)} if bins and fit.bins else {}),
    }


def _term_entry(estimate: Estimate, fit: NoiseFit, sensor: Sensor) -> dict[str, object]:
    entry: dict[str, object] = {
        "symbol": estimate.symbol,
        "name": TERMS[estimate.symbol].name(sensor),
        "status": estimate.status,
        "value": estimate.value,
        "low": estimate.low,
        "high": estimate.high,
        "unit": TERMS[estimate.symbol].unit(sensor),
        "datasheet": _quantity(numbers.datasheet(estimate, sensor)),
        "drawn": estimate.drawn,
        "alternatives": estimate.alternatives,
        "horizon_s": estimate.horizon_s,
        "widening": estimate.widening,
    }
    if len(TERMS[estimate.symbol].parameters()) > 1:
        # What a filter's state needs: T, and phi and q of x[t+1] = phi x[t] + q w[t].
        time, term = estimate.correlation_time, numbers.gauss_markov_term(fit, estimate)
        entry["correlation_time"] = time and _quantity(numbers.correlation_time(time))
        entry["phi"] = term and term.phi(1 / fit.rate_hz)
        entry["q"] = term and term.q(1 / fit.rate_hz)
    return entry


def _quantity(quantity: numbers.Quantity) -> dict[str, object]:
    return {name: getattr(quantity, name) for name in ("value", "low", "high", "unit")}


def _segments_entry(segments: Segments, level: float, sensor: Sensor) -> dict[str, object]:
    white, floor = segments.white, segments.floor
    return {
        "level": level,
        "start_s": segments.start_s,
        "end_s": segments.end_s,
        "N": white and _trace_entry(white, TERMS["N"].unit(sensor)),
        "floor": floor and {"tau_s": segments.floor_tau_s, **_trace_entry(floor, sensor.unit)},
        "terms": {term.key: _HOMOGENEITY.write(term) for term in segments.terms},
    }


def _trace_entry(trace: Trace, unit: str) -> dict[str, object]:
    return {"value": trace.value, "low": trace.low, "high": trace.high, "unit": unit}


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
        findings=_FINDING.read_all(root["findings"]),
        version=root["version"].text(),
    )


def _refuse_constant(name: str) -> NoReturn:
    msg = f"it holds {name}"
    raise ValueError(msg)


def _text(value: object, indent: str) -> str:
    inner = f"{indent}  "
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
        files=node.get("files", _files, ()),
        read=node.get("range", _maybe(_RANGE.read), None),
    )


def _files(node: Node) -> tuple[LogFileInfo, ...]:
    return tuple(_FILE.read(file, etag=file.get("etag", Node.text, None)) for file in node)


def _axis(node: Node) -> AxisReport:
    sensor = Sensor(node["sensor"].text(*Sensor))
    return AxisReport(
        sensor=sensor,
        axis=_AXES[node["axis"].text(*_AXES)],
        samples=node["samples"].count(),
        rate_hz=node["rate_hz"].positive(),
        duration_s=node["duration_s"].number(),
        mean=_or_nan(node["mean"]),
        std=_or_nan(node["std"]),
        gaps=_GAP.read_all(node["gaps"]),
        spectrum=Spectrum(**_alike(node["spectrum"], frequency="frequency_hz", psd="psd", count="count")),
        overview=Overview(**_alike(node["overview"], time_s="time_s", low="low", high="high")),
        fit=_fit(node["fit"], node["curve"], sensor),
        findings=_FINDING.read_all(node["findings"]),
    )


def _alike(node: Node, **keys: str) -> dict[str, FloatArray]:
    """Return lists that stand under `keys` by the names of their values, each as long as the first."""
    first = node[next(iter(keys.values()))].array()
    return {name: node[key].array(like=first.size) for name, key in keys.items()}


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
        goodness=_GOODNESS.read(node["goodness"]),
        curve=curve,
        used=used,
        response=node["response"].maybe(_RESPONSE.read),
        candidates=tuple(
            Candidate(structure=c["model"].text(), delta=_or_nan(c["delta"])) for c in node["candidates"]
        ),
        criterion=node["criterion"].text(),
        findings=_FINDING.read_all(node["findings"]),
        settings=node["settings"].table(),
        segments=node.get("segments", _maybe(_segments), None),
        bins=node.get("bins", _bins, None),
    )


def _segments(node: Node) -> Segments:
    start = node["start_s"].array()
    floor = node["floor"]
    return Segments(
        start_s=start,
        end_s=node["end_s"].array(like=start.size),
        white=node["N"].maybe(lambda white: _trace(white, start.size)),
        floor=floor.maybe(lambda floor: _trace(floor, start.size)),
        floor_tau_s=math.nan if floor.value is None else floor["tau_s"].positive(),
        terms=tuple(_HOMOGENEITY.read(node["terms"][key], key=key) for key in node["terms"].table()),
    )


def _trace(node: Node, size: int) -> Trace:
    return Trace(**{name: node[name].array(like=size) for name in ("value", "low", "high")})


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
    return Estimate(
        key=key,
        symbol=node["symbol"].text(*TERMS),
        status="bounded" if value is None else "estimated",
        value=value,
        low=_or_nan(node["low"]),
        high=node["high"].number(null=math.inf),
        correlation_time=node.get("correlation_time", _maybe(_INTERVAL.read), None),
        alternatives=node.get("alternatives", lambda found: tuple(map(_one_of(*TERMS), found)), ()),
        horizon_s=node.get("horizon_s", lambda found: found.number(null=math.inf), math.inf),
        widening=node.get("widening", Node.number, 1.0),
    )
