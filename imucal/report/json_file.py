"""`report.json`: written with stable key order, and read back into the same report."""

import json
import math
from pathlib import Path

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.allan.dct import Spectrum
from imucal.clock import Gap
from imucal.errors import ReadError
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
    TermHomogeneity,
    Trace,
)
from imucal.noise.model import NoiseModel
from imucal.noise.terms import ALWAYS, TERMS
from imucal.recording import Axis, LogFileInfo, ReadRange, Sensor, Source
from imucal.report.document import SCHEMA
from imucal.report.reading import Node
from imucal.report.result import AxisReport, Overview, Report
from imucal.report.stored_bins import read_bins

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
