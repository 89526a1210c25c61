"""The layout of `report.json`: its dataclasses, whose attributes are the keys.

A change that an old reader would misunderstand needs another number in `SCHEMA`. After a change, type
``python -m tests.benchmarks.report_schema``.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, TypeAlias

from imucal.arrays import FloatArray, IntArray
from imucal.clock import Gap
from imucal.findings import Finding
from imucal.fitting.noise_fit import Candidate, Goodness, Response, Segments, Status
from imucal.grading import Grade
from imucal.noise.terms import TERMS
from imucal.recording import Axis, Sensor, Source
from imucal.report.result import Overview
from imucal.report.typed_json import Key

SCHEMA = "imucal/report/4"
SIGNAL_SCHEMA = "imucal/signal/1"

Finite: TypeAlias = Annotated[float, Key(null=None)]
Positive: TypeAlias = Annotated[float, Key(null=None, above=0)]
Share: TypeAlias = Annotated[float, Key(null=None, above=0, below=1)]
OrInfinite: TypeAlias = Annotated[float, Key(null=math.inf)]
Count: TypeAlias = Annotated[int, Key(least=0)]
Symbol: TypeAlias = Annotated[str, Key(choices=tuple(TERMS))]
OfTau: TypeAlias = Annotated[FloatArray, Key(like="tau_s")]
OfFrequency: TypeAlias = Annotated[FloatArray, Key(like="frequency_hz")]


@dataclass(frozen=True, kw_only=True)
class QuantityEntry:
    """A value with its limits and unit; `value` is None if only the bound `high` is known."""

    value: float | None
    low: float
    high: OrInfinite
    unit: str


@dataclass(frozen=True, kw_only=True)
class SummaryEntry(QuantityEntry):
    """The numbers of a term in SI."""

    status: Status


@dataclass(frozen=True, kw_only=True)
class FilterEntry:
    """The two numbers for a filter; `ratios` are pairs of time and ratio."""

    sensor: Sensor
    axes: tuple[str, ...]
    horizon_s: Positive
    step_s: Positive
    white: Positive
    white_unit: str
    walk: Positive
    walk_unit: str
    basis: str
    ratios: tuple[tuple[float, float], ...]


@dataclass(frozen=True, kw_only=True)
class TermEntry:
    """An estimate in SI and in the unit of data sheets."""

    symbol: Symbol
    name: str
    status: Status
    value: float | None
    low: float
    high: OrInfinite
    unit: str
    datasheet: QuantityEntry
    in_model: float | None
    alternatives: tuple[Symbol, ...] = ()
    horizon_s: OrInfinite = math.inf
    widening: Finite = 1.0
    correlation_time: QuantityEntry | None = None
    phi: float | None = None
    q: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class CurveEntry:
    """The Allan deviation, its limits and the model's, shape (k,) each; `used` has shape (j,)."""

    level: Share
    estimator: str
    computed: str
    edf_method: str
    n: Count
    tau_s: FloatArray
    m: Annotated[IntArray, Key(least=0, like="tau_s")]
    adev: OfTau
    low: OfTau
    high: OfTau
    edf: OfTau
    model_adev: OfTau
    used: Annotated[IntArray, Key(least=0)]


@dataclass(frozen=True, kw_only=True)
class MinimumEntry:
    """The lowest point of the curve."""

    adev: float
    tau_s: float
    low: float
    high: float
    datasheet: QuantityEntry


@dataclass(frozen=True, kw_only=True, eq=False)
class SpectrumEntry:
    """The two-sided spectrum and the model's, shape (k,) each."""

    sides: int
    frequency_hz: FloatArray
    psd: OfFrequency
    count: OfFrequency
    model_psd: OfFrequency


@dataclass(frozen=True, kw_only=True, eq=False)
class FitEntry:
    """A fit; `model` has the terms, `expression` also their values. `covariance` is a list of rows."""

    method: str
    model: str
    expression: str
    rate_hz: Positive
    level: Share
    criterion: str
    goodness: Goodness
    terms: Mapping[str, TermEntry]
    parameters: tuple[str, ...]
    covariance: tuple[FloatArray, ...]
    response: Response | None
    candidates: tuple[Candidate, ...]
    segments: Segments | None = None
    settings: Mapping[str, object]


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisEntry:
    """The results of one axis."""

    name: str
    sensor: Sensor
    axis: Axis
    unit: str
    samples: Count
    rate_hz: Positive
    duration_s: Finite
    mean: float
    std: float
    gaps: tuple[Gap, ...]
    curve: CurveEntry
    minimum: MinimumEntry
    spectrum: SpectrumEntry
    fit: FitEntry


@dataclass(frozen=True, kw_only=True)
class Header:
    """The keys that the files of a report have in common."""

    schema: str
    version: str
    verdict: Grade
    verdict_sentence: str
    source: Source
    settings: Mapping[str, object]
    findings: tuple[Finding, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Document(Header):
    """The whole report."""

    summary: Mapping[str, Mapping[str, SummaryEntry]]
    filter_numbers: tuple[FilterEntry, ...]
    axes: tuple[AxisEntry, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class SignalDocument:
    """The raw signals of `signal.json`."""

    schema: str
    version: str
    axes: Mapping[str, Overview]
