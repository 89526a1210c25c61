"""NoiseFit: the noise model of an axis with intervals; Segments: changes within a record."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol, TypeAlias, TypeVar

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray, IntArray, ReadOnlyArrays
from imucal.display import Displayed
from imucal.errors import ArgumentError, MissingError
from imucal.findings import Finding
from imucal.fitting.bins import Bins
from imucal.fitting.regressors import Regressor
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.units import find_unit

#: False alarm rate of a changing term in a stationary record.
CHANCE = 0.01
#: Score of a misfit from which the model does not describe the axis.
MISFIT = 3.0


def is_slow(symbol: str) -> bool:
    """Whether a term is slower than white noise: segments can't distinguish changes of such terms."""
    slope = TERMS[symbol].slope
    return slope is None or slope >= 0


class _Keyed(Protocol):
    @property
    def key(self) -> str: ...


_K = TypeVar("_K", bound=_Keyed)


def keyed(parts: Iterable[_K], key: str, whole: str) -> _K:
    """Return the part with a key, or raise a KeyError."""
    found = {part.key: part for part in parts}
    if key not in found:
        raise MissingError(f"no term {key!r}; {whole} {', '.join(found)}")
    return found[key]


@dataclass(frozen=True, kw_only=True)
class TermHomogeneity:
    """How much a term changes between segments.

    `statistic` is chi-squared with `dof` degrees of freedom if the term is the same in all segments. `spread`
    is the relative standard deviation of the coefficient in excess of chance. `factor` is the Birge ratio
    sqrt(statistic/dof), 1 if chance explains it. `highest_s` and `lowest_s` are start and end, in s, of the
    segments with the extreme coefficients. `shift` is the time, in s, and the factor of a single change.
    """

    key: str
    symbol: str
    statistic: float
    dof: int
    p_value: float
    spread: float
    factor: float
    highest_s: tuple[float, float]
    lowest_s: tuple[float, float]
    shift: tuple[float, float] | None = field(default=None, compare=False)


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace(ReadOnlyArrays):
    """A quantity in each segment: value and limits, shape (s,) each, in SI."""

    value: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Segments(ReadOnlyArrays):
    """The noise of a record in segments.

    `start_s` and `end_s`, shape (s,), are in s from the first sample. `white` is N. `floor` is the model's
    Allan deviation at `floor_tau_s`; None and NaN without slow noise.
    """

    start_s: FloatArray
    end_s: FloatArray
    white: Trace | None
    floor: Trace | None
    floor_tau_s: float
    terms: tuple[TermHomogeneity, ...]

    def __getitem__(self, key: str) -> TermHomogeneity:
        return keyed(self.terms, key, "the segments have")

    @property
    def changing(self) -> tuple[TermHomogeneity, ...]:
        """Terms that change by more than chance, the most significant first."""
        return tuple(sorted((t for t in self.terms if t.factor > 1), key=lambda t: -t.factor))

    def widening(self, symbol: str) -> float:
        """Return the factor that widens the intervals of a term; slow terms share the largest one."""
        slow = is_slow(symbol)
        same = (t for t in self.terms if t.symbol == symbol or (slow and is_slow(t.symbol)))
        return max((term.factor for term in same), default=1.0)


Status: TypeAlias = Literal["estimated", "bounded"]


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A value and its confidence limits."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class InUnits:
    """A coefficient in a unit; `value` is None if only the upper bound `high` is known."""

    value: float | None
    low: float
    high: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """One term's coefficient.

    `key` is the `symbol`, such as ``K``; several Gauss-Markov terms are ``GM1``, ``GM2``, by rising T.
    `value`, `low` and `high` are the coefficient (sigma for GM) in SI and its limits. If the data do not show
    the term, `value` is None, `low` 0 and `high` the upper bound. `correlation_time` is T, in s.
    `alternatives` are symbols of terms that the record can't distinguish from this one.

    `in_model` is the coefficient in the fit's model, None if the model has no such term. A bounded term is in
    the model if the model without it would be less likely. The `NoiseFit` sets `in_model` and `sensor`.

    `horizon_s` is the longest time for which the coefficient is valid. `widening` is the factor by which the
    interval is wider than the likelihood's. `origin` describes a number that is not an estimate of one
    record.
    """

    key: str
    symbol: str
    status: Status
    value: float | None
    low: float
    high: float
    correlation_time: Interval | None = None
    alternatives: tuple[str, ...] = ()
    in_model: float | None = None
    horizon_s: float = np.inf
    widening: float = 1.0
    origin: str = ""
    sensor: Sensor | None = field(default=None, compare=False, repr=False)

    @classmethod
    def bounded(cls, key: str, symbol: str, high: float) -> "Estimate":
        """Return the estimate of a term that the data do not show."""
        return cls(key=key, symbol=symbol, status="bounded", value=None, low=0.0, high=high)

    def in_units(self, unit: str | None = None) -> "InUnits":
        """Return the coefficient and its limits in another unit.

        Parameters
        ----------
        unit
            A unit of this term, such as ``deg/sqrt(h)``; by default the data sheets' unit.

        Raises
        ------
        ArgumentError
            If the sensor is not known, or `unit` does not measure this term.
        """
        if self.sensor is None:
            raise ArgumentError(f"{self.key}: the sensor is unknown; use the estimate of a log's fit")
        kind = TERMS[self.symbol]
        units = kind.coefficient_units(self.sensor)
        found = find_unit(unit or kind.datasheet_unit(self.sensor).name, units)
        if found is None:
            raise ArgumentError(f"{unit!r} is no unit of {self.key}; expected one of {', '.join(units)}")
        name, factor = found
        value = None if self.value is None else self.value / factor
        return InUnits(value=value, low=self.low / factor, high=self.high / factor, unit=name)

    def term(self, coefficient: float) -> NoiseTerm:
        """Return the term with this coefficient, in SI."""
        time = self.correlation_time
        return TERMS[self.symbol].of(coefficient, *([time.value] if time else []))

    def slopes(self) -> dict[str, float]:
        """Return each parameter's derivative in its log variance or log time, by its name."""
        times = [self.correlation_time.value] if self.correlation_time else []
        names = TERMS[self.symbol].parameter_names(self.key)
        return dict(zip(names, [0.5 * (self.value or 0.0), *times], strict=True))

    def __post_init__(self) -> None:
        if (self.value is None) != (self.status == "bounded"):
            raise ValueError(f"{self.key}: value must be None if bounded, and only then: {self}")


@dataclass(frozen=True, kw_only=True)
class Line:
    """A spectral line that the fit left out: frequency in Hz, amplitude of the sine in U."""

    frequency_hz: float
    amplitude: float


@dataclass(frozen=True, kw_only=True)
class Response:
    """The output filter: its -3 dB corner in Hz."""

    cutoff_hz: float


@dataclass(frozen=True, kw_only=True)
class Goodness:
    """How well the model describes the fitted data.

    `statistic` is a standard-normal score of the misfit; `chi2_per_bin`, the mean squared standardised
    residual, is 1 if the model is right. `band_hz` or `tau_s` is the fitted range. The fit leaves out
    `lines` and spikes; `spikes` is the root of their mean square over all samples, in U.
    """

    statistic: float
    p_value: float
    chi2_per_bin: float
    band_hz: tuple[float, float] | None = None
    tau_s: tuple[float, float] | None = None
    lines: tuple[Line, ...] = ()
    spikes: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A candidate model, and how much worse its criterion is."""

    structure: str
    delta: float


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class NoiseFit(Displayed):
    """A noise model of one axis.

    Attributes
    ----------
    method
        ``mle``, ``gmwm`` or ``slope``.
    sensor
        None if unknown (a curve made by another tool).
    rate_hz
        Sampling rate: the model is exact for the process sampled at it.
    estimates
        One for each term of the model, and for N, B and K always.
    parameters, covariance
        Names such as ``N``, ``GM1.sigma``, ``GM1.T``; covariance of the coefficients in SI, shape (p, p).
    used
        Indices of the fitted points of `curve`, shape (j,).
    candidates
        Models within reach of the best, the chosen one (delta 0) first.
    criterion
        ``chance``, ``bic``, ``hq``, ``aic``, or ``given`` for a model that the caller fixed.
    noise_share
        The model's share of each of the curve's Allan variances, shape (k,). None without an output
        filter and lines.
    taken_out
        Shapes that were removed from the samples -> coefficients in U; `imucal.fitting.regressors` lists
        them.
    segments
        Changes of the terms within the record; None if not tested.
    bins
        The binned spectrum for `imucal.fleet.values.log_values`; None if not ``mle`` or read back without it.
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
    taken_out: Mapping[Regressor, float] = field(default_factory=dict)
    segments: Segments | None = None
    bins: Bins | None = None

    def __getitem__(self, key: str) -> Estimate:
        return keyed(self.estimates, key, "the fit has")

    def __post_init__(self) -> None:
        coefficients = {key: abs(term.coefficient) for key, term in self.terms_in_model.items()}
        estimates = tuple(
            replace(e, in_model=coefficients.get(e.key), sensor=self.sensor) for e in self.estimates
        )
        object.__setattr__(self, "estimates", estimates)

    @property
    def terms_in_model(self) -> dict[str, NoiseTerm]:
        """The model's terms by the keys of their estimates; those with a value come before bounded ones."""
        found: dict[str, NoiseTerm] = {}
        for symbol in dict.fromkeys(term.symbol for term in self.model.terms):
            terms = [term for term in self.model.terms if term.symbol == symbol]
            own = sorted((e.value is None, e.key) for e in self.estimates if e.symbol == symbol)
            found |= zip(sorted(key for _, key in own[: len(terms)]), terms, strict=False)
        return found

    @property
    def correlation(self) -> FloatArray:
        """Correlations of the estimated coefficients, shape (p, p)."""
        deviation = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(deviation, deviation))

    def model_adev(self) -> FloatArray:
        """Return the model's Allan deviation at the curve's averaging times, shape (k,)."""
        return np.sqrt(self.model.avar(self.curve.m.astype(np.float64), rate_hz=self.rate_hz))

    def residuals(self) -> FloatArray:
        """Return log10 of observed over modelled Allan deviation, shape (k,)."""
        return np.log10(self.curve.adev / self.model_adev())
