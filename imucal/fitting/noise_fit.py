"""NoiseFit: what explains an axis, with an interval on each number; Segments: what its parts say of it."""

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
from imucal.frozen import frozen, frozen_alone
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.units import find_unit

#: Chance that a term of a stationary record is found to change.
CHANCE = 0.01
#: Score of a misfit from which the model does not describe the axis.
MISFIT = 3.0


def is_slow(symbol: str) -> bool:
    """Whether a term is slower than white noise: what of that changed in a segment is not told."""
    slope = TERMS[symbol].slope
    return slope is None or slope >= 0


class _Keyed(Protocol):
    @property
    def key(self) -> str: ...


_K = TypeVar("_K", bound=_Keyed)


def keyed(parts: Iterable[_K], key: str, whole: str) -> _K:
    """Return the one of that key; a KeyError says, after `whole`, which there are."""
    found = {part.key: part for part in parts}
    if key not in found:
        raise MissingError(f"no term {key!r}; {whole} {', '.join(found)}")
    return found[key]


@frozen
class TermHomogeneity:
    """How much a term, by `key` and `symbol` that of an estimate, changes from segment to segment.

    Q, its `statistic`, is chi-squared with `dof` degrees of freedom where the term is the same in all
    segments, and so large by chance with a probability of `p_value`. `spread` is the relative standard
    deviation of the coefficient between segments beyond what chance gives, `factor` the Birge ratio
    sqrt(Q/dof), 1 where chance explains Q. The segments where it is largest and smallest begin and end at
    `highest_s` and `lowest_s`, in s from the first sample. `shift` says when, in s, and by what factor it
    changes once and stays; else it is None. The report's JSON has it in the words of the finding alone.
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


@frozen_alone
class Trace(ReadOnlyArrays):
    """A quantity in each segment: value and limits, shape (s,) each, in SI."""

    value: FloatArray
    low: FloatArray
    high: FloatArray


@frozen_alone
class Segments(ReadOnlyArrays):
    """What the segments of a record say of its noise.

    Each begins and ends at `start_s` and `end_s`, shape (s,), in s from the first sample. `white` is N in
    each, None where the fit has no N. `floor` is the Allan deviation of the model in each at `floor_tau_s`,
    in s, where it is lowest, or a quarter of a segment; None, and NaN, where the fit has no slow noise.
    `terms` has one for each term that was tested.
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
        """The terms that change by more than chance, the one that changes most surely first."""
        return tuple(sorted((t for t in self.terms if t.factor > 1), key=lambda t: -t.factor))

    def widening(self, symbol: str) -> float:
        """Return by what factor the intervals of a term are wider: its own, of slow terms the largest."""
        slow = is_slow(symbol)
        alike = (t for t in self.terms if t.symbol == symbol or (slow and is_slow(t.symbol)))
        return max((term.factor for term in alike), default=1.0)


Status: TypeAlias = Literal["estimated", "bounded"]


@frozen
class Interval:
    """A value and its confidence limits."""

    value: float
    low: float
    high: float


@frozen
class InUnits:
    """A coefficient in a unit; `value` is None if only the upper bound `high` is known."""

    value: float | None
    low: float
    high: float
    unit: str


@frozen
class Estimate:
    """One term's coefficient.

    By its `key` it is ``N`` … ``R``, ``GM``, or ``GM1``, ``GM2`` where there are several, by rising T; by its
    `symbol` ``N`` … ``R`` or ``GM``. Its `status` is ``estimated``, or ``bounded`` where the data do not show
    the term. `value`, `low` and `high` are the coefficient (sigma for GM) in SI and its limits; of a bounded
    one None, 0 and the upper bound at the level. `correlation_time` is T of a Gauss-Markov term, in s, None
    for others; `alternatives` are symbols of terms that may stand in this one's place: to this record they
    are one thing.

    `drawn` is the coefficient that the fit's model has, in SI: also of a bounded term, whose interval holds
    zero, where the model without it would be less likely. None where the model has no such term: an estimate
    with a value is then another name of what other terms are, as the walk that a slow Gauss-Markov term
    begins with is, and adds nothing to them. The `NoiseFit` that it belongs to sets it.

    `horizon_s` is the longest time for which the coefficient holds, in s: a walk that may be the beginning of
    a Gauss-Markov term holds up to the least T that such a term may have; infinite where nothing limits it.
    `widening` is by what factor the interval is wider than the likelihood says, because the record's segments
    differ or the model does not describe it. `origin` says what the number is, where it is no estimate of one
    record: a bound over many units. `sensor` is that of the `NoiseFit`, which sets it.
    """

    key: str
    symbol: str
    status: Status
    value: float | None
    low: float
    high: float
    correlation_time: Interval | None = None
    alternatives: tuple[str, ...] = ()
    drawn: float | None = None
    horizon_s: float = np.inf
    widening: float = 1.0
    origin: str = ""
    sensor: Sensor | None = field(default=None, compare=False, repr=False)

    @classmethod
    def bounded(cls, key: str, symbol: str, high: float) -> "Estimate":
        """Return the estimate of a term that the data do not show: below `high`."""
        return cls(key=key, symbol=symbol, status="bounded", value=None, low=0.0, high=high)

    def in_units(self, unit: str | None = None) -> "InUnits":
        """Return the coefficient and its limits in another unit, by default in that of data sheets.

        Parameters
        ----------
        unit
            Any unit of this term, such as ``deg/sqrt(h)``, ``mdps/rtHz`` or ``ug/sqrt(Hz)``.

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
        """Return the term with this coefficient, in SI, and the estimate's correlation time."""
        time = self.correlation_time
        return TERMS[self.symbol].of(coefficient, *([time.value] if time else []))

    def slopes(self) -> dict[str, float]:
        """Return each parameter's derivative in its log variance or log time, by its name in a fit."""
        times = [self.correlation_time.value] if self.correlation_time else []
        names = TERMS[self.symbol].parameter_names(self.key)
        return dict(zip(names, [0.5 * (self.value or 0.0), *times], strict=True))

    def __post_init__(self) -> None:
        if (self.value is None) != (self.status == "bounded"):
            raise ValueError(f"{self.key}: value must be None if bounded, and only then: {self}")


@frozen
class Line:
    """A spectral line that the fit left out: frequency in Hz, amplitude (of the sine) in U."""

    frequency_hz: float
    amplitude: float


@frozen
class Response:
    """The output filter that the fit found: kind (``one-pole``, ``butterworth-2`` …), -3 dB corner in Hz."""

    kind: str
    cutoff_hz: float


@frozen
class Goodness:
    """How well the model describes what it was fitted to.

    `statistic` is a standard-normal score of the misfit: above 3 the model does not describe the axis. So
    large a misfit has the probability `p_value` when the model is right; `chi2_per_bin`, the mean squared
    standardised residual, is 1 then. `band_hz` are the lowest and highest frequency that was used, in Hz,
    None for a fit of the curve; `tau_s` the shortest and longest averaging time, in s, None for a fit of the
    spectrum. `lines` are the spectral lines left out.
    """

    statistic: float
    p_value: float
    chi2_per_bin: float
    band_hz: tuple[float, float] | None = None
    tau_s: tuple[float, float] | None = None
    lines: tuple[Line, ...] = ()


@frozen
class Candidate:
    """Another model that was tried: its structure text and how much worse its criterion is."""

    structure: str
    delta: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class NoiseFit(Displayed):
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
        ``chance``, ``bic``, ``hq``, ``aic``, or ``given`` when the model was fixed by the caller.
    findings
        What the fit showed.
    noise_share
        Share of each of the curve's Allan variances that is the model's noise, and not an output filter's
        or a line's doing, shape (k,); None where neither was found.
    taken_out
        Regressors that were taken out of the samples with the fit -> their coefficients in U; the names
        are those of `imucal.fitting.spectral.ordinates`.
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
        return keyed(self.estimates, key, "the fit has")

    def __post_init__(self) -> None:
        coefficients = {key: abs(term.coefficient) for key, term in self.drawn.items()}
        estimates = tuple(
            replace(e, drawn=coefficients.get(e.key), sensor=self.sensor) for e in self.estimates
        )
        object.__setattr__(self, "estimates", estimates)

    @property
    def drawn(self) -> dict[str, NoiseTerm]:
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
