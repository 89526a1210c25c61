"""How long to record: the length for a given precision of each term, and the precision of a given length.

A precision of 0.1 means that the standard error (or, at another level, the half-width of the interval) is 10
% of the coefficient. It follows from numeric Fisher information, see `imucal.fitting.spectral.precision`.
Above 10 % real intervals are wider, and a term whose interval reaches zero is only bounded; both as measured
for the default fit (`tests/benchmarks/planned.py`).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from imucal.errors import ArgumentError
from imucal.findings import Finding
from imucal.fitting.noise_fit import NoiseFit
from imucal.fitting.spectral import named_terms, relative_deviations
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import ALWAYS, TERMS
from imucal.recording import Sensor
from imucal.report.result import AxisReport, Report
from imucal.units import duration

#: One standard deviation on each side.
ONE_DEVIATION = math.erf(math.sqrt(0.5))
_SHARP = 0.1
#: Longest record, in s; longer needs are infinite.
_LONGEST = 10 * 365.25 * 86400
#: Logarithm of the standard error of a record without information.
_NO_INFORMATION = 50.0
#: Tolerance of a needed length, in natural logarithm.
_TOLERANCE = 1e-4
#: A finding reports a record that is too short by this factor.
_WORTH_SAYING = 1.05
#: Relative standard error at which half of all records show a term, and the standard deviation of this limit.
#: Flicker resembles both its neighbours and needs more than a walk.
_DETECTABLE = {"B": (0.25, 0.13), "R": (0.25, 0.07)}
_USUALLY_DETECTABLE = (0.305, 0.09)
#: Share of records that must show a term.
ENOUGH_DETECTED = 0.8


@dataclass(frozen=True)
class Need:
    """The length that a parameter such as ``N``, ``GM.sigma`` or ``GM.T`` needs.

    `value` is the coefficient in SI (a correlation time in s), or an upper bound if `bounded`. `needed_s` is
    long enough for the precision and to show the term in four of five records; infinite if no record shows
    it. `reached` is the relative precision of the present record, `detected` the share of records of this
    length that show the term; None without a record.
    """

    name: str
    symbol: str
    value: float
    bounded: bool
    needed_s: float
    reached: float | None
    detected: float | None


@dataclass(frozen=True, kw_only=True)
class AxisPlan:
    """The needs of one axis; `axis` is empty and `sensor` None for a model without a log."""

    axis: str = ""
    sensor: Sensor | None = None
    model: str
    rate_hz: float
    duration_s: float | None
    needs: tuple[Need, ...]


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The lengths of record for a relative precision at a confidence level."""

    precision: float
    level: float
    axes: tuple[AxisPlan, ...]

    def __repr__(self) -> str:
        lines = [f"Plan for ±{100 * self.precision:.3g} %: {duration(self.needed_s)}"]
        for axis in self.axes:
            needs = ", ".join(f"{need.name} {duration(need.needed_s)}" for need in axis.needs)
            lines.append(f"{axis.axis or axis.model}: {needs}")
        return "\n".join(lines)

    @property
    def needed_s(self) -> float:
        """The length that is enough for every parameter that is not bounded, in s."""
        return max((n.needed_s for a in self.axes for n in a.needs if not n.bounded), default=math.nan)


@dataclass(frozen=True)
class _Ask:
    rate_hz: float
    precision: float
    level: float
    duration_s: float | None
    longer: bool = False

    @property
    def quantile(self) -> float:
        from scipy.special import ndtri

        return float(ndtri((1 + self.level) / 2))


def plan(
    source: NoiseModel | NoiseFit | Report,
    *,
    rate_hz: float | None = None,
    precision: float = _SHARP,
    level: float = ONE_DEVIATION,
    duration_s: float | None = None,
) -> Plan:
    """Return how long to record for a relative precision of every term.

    Parameters
    ----------
    source
        The noise: a model, a fit, or a report (each of its axes).
    rate_hz
        Sampling rate; by default the rate of the fit or report.
    precision
        Wanted half-width of the interval, relative to the coefficient.
    level
        Confidence level of that interval; by default one standard deviation.
    duration_s
        Length of a record whose precision is computed; by default the length of the report's record.

    Raises
    ------
    ValueError
        If an argument is out of range, or a model is given without a rate.
    """
    if not (precision > 0 and 0 < level < 1):
        raise ArgumentError(
            f"precision must be positive and level between 0 and 1, got {precision} and {level}"
        )

    def ask(own_rate_hz: float, own_duration_s: float | None) -> _Ask:
        given_s = own_duration_s if duration_s is None else duration_s
        return _Ask(rate_hz or own_rate_hz, precision, level, given_s)

    if isinstance(source, Report):
        axes = tuple(
            replace(
                _fit_plan(axis.fit, ask(axis.rate_hz, axis.duration_s if axis.samples else None)), axis=name
            )
            for name, axis in _once_each(source)
        )
    elif isinstance(source, NoiseFit):
        axes = (_fit_plan(source, ask(source.rate_hz, None)),)
    elif rate_hz is None:
        raise ArgumentError("a model has no sampling rate; give rate_hz")
    else:
        axes = (_axis_plan(source, [(term, False) for term in source.terms], ask(rate_hz, None)),)
    return Plan(precision=precision, level=level, axes=axes)


def _once_each(report: Report) -> Iterator[tuple[str, AxisReport]]:
    """Yield the axes of a report; equal axes of a sensor once, by the sensor's name."""
    for sensor, axes in report.by_sensor.items():
        if len(axes) > 1 and all(axis.fit is axes[0].fit for axis in axes):
            yield sensor.short, axes[0]
        else:
            yield from ((axis.name, axis) for axis in axes)


def resolution_findings(fit: NoiseFit, duration_s: float) -> tuple[Finding, ...]:
    """Return a finding such as ``K needs 6.2 h for ±10 %, …`` for each term that needs a longer record.

    For a bounded term, the upper bound is used.
    """
    needs = _fit_plan(fit, _Ask(fit.rate_hz, _SHARP, ONE_DEVIATION, duration_s, longer=True)).needs
    findings = []
    for name in dict.fromkeys(need.name.partition(".")[0] for need in needs):
        own = [need for need in needs if need.name.partition(".")[0] == name]
        longest = max(own, key=lambda need: need.needed_s)
        if longest.needed_s > _WORTH_SAYING * duration_s:
            needed, had = needed_time(longest.needed_s), duration(duration_s)
            sharp = f"±{100 * _SHARP:.3g} %"
            text = f"{name} needs {needed} for {sharp}; this log has {had}."
            if longest.bounded:
                text = f"{name} was not detected in {had}. If it equals its bound, {needed} would "
                text += f"measure it to {sharp}."
            findings.append(Finding("info", "record-length", text))
    return tuple(findings)


def needed_time(seconds: float) -> str:
    """Return the length of a record that is needed, roughly: ``6 h 12 min``, ``more than 10 years``."""
    return "more than 10 years" if seconds > _LONGEST else duration(seconds, rough=True)


def _fit_plan(fit: NoiseFit, ask: _Ask) -> AxisPlan:
    seen = [(e.term(e.value), False) for e in fit.estimates if e.value and e.in_model]
    unseen = [
        (e.term(e.high), True)
        for e in fit.estimates
        if e.value is None and not TERMS[e.symbol].repeatable and 0 < e.high < math.inf
    ]
    model = NoiseModel(terms=tuple(term for term, _ in seen))
    return replace(_axis_plan(model, seen + unseen, ask), sensor=fit.sensor)


def _axis_plan(model: NoiseModel, terms: list[tuple[NoiseTerm, bool]], ask: _Ask) -> AxisPlan:
    wanted = ask.precision / ask.quantile
    needs: list[Need] = []
    for term, bounded in terms:
        whole = NoiseModel(terms=(*model.terms, term)) if bounded else model
        names = next(own for other, own in named_terms(whole) if other is term)
        for name, value in zip(names, term.values, strict=True):
            reached = detected = None
            bound = math.inf
            if ask.duration_s is not None:
                bound = _bound(whole, name, ask.rate_hz, ask.duration_s)
                reached, detected = _found(bound) * ask.quantile, _share_detected(name, bound)
            enough = _largest_bound(name, wanted)
            if ask.longer and ask.duration_s is not None and bound <= enough:
                needed = ask.duration_s
            else:
                needed = _needed(whole, name, ask.rate_hz, enough)
            needs.append(Need(name, term.symbol, value, bounded, needed, reached, detected))
    needs.sort(key=lambda need: list(TERMS).index(need.symbol))
    return AxisPlan(model=str(model), rate_hz=ask.rate_hz, duration_s=ask.duration_s, needs=tuple(needs))


def _bound(model: NoiseModel, name: str, rate_hz: float, duration_s: float) -> float:
    """Return the smallest relative standard error if missing N, B and K are estimated too."""
    there = {term.symbol for term in model.terms}
    others = [symbol for symbol in ALWAYS if symbol not in there]
    return relative_deviations(model, rate_hz=rate_hz, duration_s=duration_s, added=others)[name]


def _found(bound: float) -> float:
    """Return the relative standard error that a fit reports if the smallest one is `bound`."""
    return bound * (1 + min(max(bound - 0.1, 0.0), 0.3))


def _share_detected(name: str, bound: float) -> float:
    """Return the share of records whose interval excludes zero."""
    half, width = _DETECTABLE.get(name, _USUALLY_DETECTABLE)
    return 0.5 * math.erfc((bound - half) / (math.sqrt(2) * width))


def _needed(model: NoiseModel, name: str, rate_hz: float, enough: float) -> float:
    """Return the length of record, in s, at which the smallest relative standard error is `enough`."""
    from scipy.optimize import brentq

    target = math.log(enough)

    def excess(log_duration: float) -> float:
        bound = _bound(model, name, rate_hz, math.exp(log_duration))
        # Finite, so that the search continues.
        return math.log(max(bound, 1e-300)) - target if bound < math.inf else _NO_INFORMATION

    shortest, longest = math.log(2 / rate_hz), math.log(_LONGEST)
    if excess(longest) > 0:
        return math.inf
    if excess(shortest) <= 0:
        return math.exp(shortest)
    return math.exp(brentq(excess, shortest, longest, xtol=_TOLERANCE))


def _largest_bound(name: str, wanted: float) -> float:
    """Return the largest `bound` for which a fit reports `wanted` and most records show the term."""
    from scipy.special import ndtri

    half, width = _DETECTABLE.get(name, _USUALLY_DETECTABLE)
    most = half - width * float(ndtri(ENOUGH_DETECTED))
    # The inverse of `_found`: b where b <= 0.1, b (0.9 + b) up to 0.4, and 1.3 b beyond.
    within = wanted if wanted <= 0.1 else (math.sqrt(0.81 + 4 * wanted) - 0.9) / 2
    return min(within if within <= 0.4 else wanted / 1.3, most)
