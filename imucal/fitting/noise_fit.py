"""NoiseFit: what explains an axis, with an interval on each number."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray, IntArray
from imucal.findings import Finding
from imucal.fitting.bins import Bins
from imucal.fitting.segments import Segments
from imucal.noise.model import NoiseModel
from imucal.recording import Sensor

Status: TypeAlias = Literal["estimated", "bounded"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """A value and its confidence limits."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """One term's coefficient.

    Attributes
    ----------
    key
        ``N`` … ``R``, ``GM``; ``GM1``, ``GM2`` where there are several, by rising T.
    symbol
        ``N`` … ``R`` or ``GM``.
    status
        ``estimated``; or ``bounded`` where the data do not show the term: then `value` is None,
        `low` is 0 and `high` its upper bound at the level.
    value, low, high
        The coefficient (sigma for GM) in SI, and its limits.
    correlation_time
        T of a Gauss-Markov term, in s; None for others.
    alternatives
        Symbols of terms that may stand in this one's place: to this record they are one thing.
    widening
        By what factor the interval is wider than the likelihood says, because the record's segments differ
        or the model does not describe it.
    origin
        What the number is, where it is no estimate of one record: a bound over many units.
    """

    key: str
    symbol: str
    status: Status
    value: float | None
    low: float
    high: float
    correlation_time: Interval | None = None
    alternatives: tuple[str, ...] = ()
    widening: float = 1.0
    origin: str = ""

    @classmethod
    def bounded(cls, key: str, symbol: str, high: float) -> "Estimate":
        """Return the estimate of a term that the data do not show: below `high`."""
        return cls(key=key, symbol=symbol, status="bounded", value=None, low=0.0, high=high)

    def __post_init__(self) -> None:
        if (self.value is None) != (self.status == "bounded"):
            msg = f"{self.key}: a bounded estimate has no value, an estimated one has: {self}"
            raise ValueError(msg)


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A spectral line that the fit left out: frequency in Hz, amplitude (of the sine) in U."""

    frequency_hz: float
    amplitude: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """The output filter that the fit found: kind (``one-pole``, ``butterworth-2`` …), -3 dB corner in Hz."""

    kind: str
    cutoff_hz: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Goodness:
    """How well the model describes what it was fitted to.

    Attributes
    ----------
    statistic
        A standard-normal score of the misfit: above 3 the model does not describe the axis.
    p_value
        Probability of so large a misfit when the model is right.
    chi2_per_bin
        Mean squared standardised residual; 1 when the model is right.
    band_hz
        Lowest and highest frequency that was used, in Hz; None for a fit of the curve.
    tau_s
        Shortest and longest averaging time that was used, in s; None for a fit of the spectrum.
    lines
        Spectral lines left out.
    """

    statistic: float
    p_value: float
    chi2_per_bin: float
    band_hz: tuple[float, float] | None = None
    tau_s: tuple[float, float] | None = None
    lines: tuple[Line, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """Another model that was tried: its structure text and how much worse its criterion is."""

    structure: str
    delta: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseFit:
    """A noise model of one axis.

    Attributes
    ----------
    method
        ``mle``, ``gmwm`` or ``slope``.
    sensor
        What was measured; None where unknown (a curve made by another tool).
    rate_hz
        Sampling rate: the model is exact for the process sampled at it.
    level
        Confidence level of every interval.
    model
        The terms found, with their values.
    estimates
        One for each term of the model, and for N, B and K always.
    parameters, covariance
        Names, shape (p,), such as ``N``, ``GM1.sigma``, ``GM1.T``; covariance, shape (p, p), of the
        coefficients in SI (of the estimated ones only).
    goodness
        How well it describes the data.
    curve
        The Allan curve of the samples.
    used
        Indices of the points of `curve` within the part of the data that the fit used, shape (j,).
    response
        The sensor's output filter, where one was found.
    candidates
        Models within reach of the best, the chosen one (delta 0) first.
    criterion
        ``bic``, ``hq``, ``aic``, or ``given`` when the model was fixed by the caller.
    findings
        What the fit showed.
    noise_share
        Share of each of the curve's Allan variances that is the model's noise, and not an output filter's
        or a line's doing, shape (k,); None where neither was found.
    taken_out
        Regressors that were taken out of the samples with the fit -> their coefficients in U; the names
        are those of `imucal.fitting.spectral.regressors`.
    segments
        Which terms are the same in all parts of the record; None where that was not looked at.
    bins
        The binned spectrum that was fitted, from which `imucal.pool` fits records together; of ``mle``
        only, None where the fit was read back without it.
    """

    method: str
    sensor: Sensor | None
    rate_hz: float
    level: float
    model: NoiseModel
    estimates: tuple[Estimate, ...]
    parameters: tuple[str, ...]
    covariance: FloatArray
    goodness: Goodness
    curve: AllanCurve
    used: IntArray
    response: Response | None = None
    candidates: tuple[Candidate, ...] = ()
    criterion: str = "given"
    findings: tuple[Finding, ...] = ()
    settings: Mapping[str, object] = field(default_factory=dict)
    noise_share: FloatArray | None = None
    taken_out: Mapping[str, float] = field(default_factory=dict)
    segments: Segments | None = None
    bins: Bins | None = None

    def __getitem__(self, key: str) -> Estimate:
        for estimate in self.estimates:
            if estimate.key == key:
                return estimate
        found = ", ".join(estimate.key for estimate in self.estimates)
        msg = f"{key!r}; the fit has {found}"
        raise KeyError(msg)

    @property
    def correlation(self) -> FloatArray:
        """Correlations of the estimated coefficients, shape (p, p)."""
        deviation = np.sqrt(np.diag(self.covariance))
        correlation: FloatArray = self.covariance / np.outer(deviation, deviation)
        return correlation

    def model_adev(self) -> FloatArray:
        """Return the model's Allan deviation at the curve's averaging times, shape (k,)."""
        return np.sqrt(self.model.avar(self.curve.m.astype(np.float64), rate_hz=self.rate_hz))

    def residuals(self) -> FloatArray:
        """Return log10 of observed over modelled Allan deviation, shape (k,)."""
        return np.log10(self.curve.adev / self.model_adev())
