"""How long to record: the length that tells each term to a wanted precision, and what a record tells.

Precision is relative: 0.1 means that the standard error (or, at another level, the half-width of
the interval) is 10 % of the coefficient. All by numeric Fisher information, see
`imucal.fitting.spectral.precision`. Beyond 10 % real intervals are wider than that, and a term must also
be *shown*: an interval that reaches zero is printed as a bound, however narrow it was planned. Both are
included as the default fit was measured to do (`tests/benchmarks/planned.py`), which has to find out by
itself whether N, B and K are there.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from imucal.arguments import takes
from imucal.errors import ArgumentError
from imucal.findings import Finding
from imucal.fitting.noise_fit import NoiseFit
from imucal.fitting.spectral import named_terms, relative_deviations
from imucal.frozen import frozen
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import ALWAYS, TERMS
from imucal.recording import Sensor
from imucal.report.result import AxisReport, Report
from imucal.solvers import root, root_near

#: The level of an interval of one standard deviation to each side.
ONE_DEVIATION = math.erf(math.sqrt(0.5))
#: The relative precision that is planned for where nobody asks for another.
_SHARP = 0.1
#: Nobody records for longer, in s: ten years. Longer needs are infinite.
_LONGEST = 10 * 365.25 * 86400
#: Where the search for a length begins without a record, in s.
_USUAL = 3600.0
#: Natural logarithm of the standard error of a record that tells nothing.
_NOTHING_TOLD = 50.0
#: How exactly a needed length is found, in natural logarithm: the last step of secants may be longer, since
#: it leads far nearer; and a record has whole samples.
_TOLERANCE, _LAST_STEP = 1e-4, 5e-3
#: A record that is so much of a factor too short is worth a sentence.
_WORTH_SAYING = 1.05
#: Half of all records show a term whose standard error is the first figure; the normal law of what the
#: others need has the second as its deviation. Flicker, which looks like both its neighbours, needs more
#: than a walk; a ramp is one number, told or not. Measured at the price of chance.
_SHOWN = {"B": (0.25, 0.13), "R": (0.25, 0.07)}
_SHOWN_USUALLY = (0.305, 0.09)
#: The share of records that should show a term before a length of record is called enough for it.
MOSTLY_SHOWN = 0.8


@dataclass(frozen=True, slots=True)
class Need:
    """What one parameter needs, such as ``N``, ``GM.sigma`` or ``GM.T``, of the term with that symbol.

    `value` is its coefficient (s for a correlation time), in SI; where it is `bounded` an upper bound: a
    term that large would need so much. `needed_s` is the length of record for the wanted precision, in s,
    long enough to show the term in four of five records; infinite where no record tells it. `reached` is
    the relative precision that the record at hand gives, `shown` the share of records as long that tell the
    term from zero; the others only bound it. Both are None where no record is at hand.
    """

    name: str
    symbol: str
    value: float
    bounded: bool
    needed_s: float
    reached: float | None
    shown: float | None


@frozen
class AxisPlan:
    """The needs of one axis; `axis` is empty and `sensor` None for a model without a log."""

    axis: str = ""
    sensor: Sensor | None = None
    model: str
    rate_hz: float
    duration_s: float | None
    needs: tuple[Need, ...]


@frozen
class Plan:
    """What records of some length tell, for a relative precision at a level."""

    precision: float
    level: float
    axes: tuple[AxisPlan, ...]

    @property
    def needed_s(self) -> float:
        """The length that is enough for every parameter that was seen, in s."""
        return max((n.needed_s for a in self.axes for n in a.needs if not n.bounded), default=math.nan)


@dataclass(frozen=True, slots=True)
class _Ask:
    """What is asked of a model: rate, relative precision at a level, and the record at hand, if any."""

    rate_hz: float
    precision: float
    level: float
    duration_s: float | None
    #: Whether a length is looked for only where that of the record at hand is not enough.
    longer: bool = False

    @property
    def quantile(self) -> float:
        """Half-width of the interval, in standard deviations."""
        from scipy.special import ndtri

        return float(ndtri((1 + self.level) / 2))


@takes("imucal.plan(report)", source=(NoiseModel, NoiseFit, Report))
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
        Sampling rate; a fit's or report's own by default.
    precision
        Wanted half-width of the interval, over the coefficient.
    level
        Confidence level of that interval; by default one standard deviation.
    duration_s
        Length of a record whose precision is to be told as well; a report's own by default.

    Raises
    ------
    ValueError
        If an argument is out of range, or a model comes without a rate.
    """
    if not (precision > 0 and 0 < level < 1):
        raise ArgumentError(
            f"precision must be positive and level between 0 and 1, got {precision} and {level}"
        )

    def ask(own_rate_hz: float, own_duration_s: float | None) -> _Ask:
        duration = own_duration_s if duration_s is None else duration_s
        return _Ask(rate_hz or own_rate_hz, precision, level, duration)

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
    """Yield a report's axes by name; those of a sensor that share one model as one, by the sensor's."""
    for sensor, axes in report.by_sensor.items():
        if len(axes) > 1 and all(axis.fit is axes[0].fit for axis in axes):
            yield sensor.short, axes[0]
        else:
            yield from ((axis.name, axis) for axis in axes)


def resolution_findings(fit: NoiseFit, duration_s: float) -> tuple[Finding, ...]:
    """Say for each term whether the record was long enough, such as ``K needs 6.2 h for ±10 %, …``.

    One finding for each term of the fit that the record tells less precisely than ±10 % (one
    standard deviation); a term that was not seen is taken at its upper bound.
    """
    needs = _fit_plan(fit, _Ask(fit.rate_hz, _SHARP, ONE_DEVIATION, duration_s, longer=True)).needs
    findings = []
    for name in dict.fromkeys(need.name.partition(".")[0] for need in needs):
        own = [need for need in needs if need.name.partition(".")[0] == name]
        longest = max(own, key=lambda need: need.needed_s)
        if longest.needed_s > _WORTH_SAYING * duration_s:
            needed, had = describe_time(longest.needed_s), describe_time(duration_s)
            sharp = f"±{100 * _SHARP:.3g} %"
            text = f"{name} needs {needed} for {sharp}; this log has {had}."
            if longest.bounded:
                text = f"{name} was not detected in {had}. If it equals its bound, {needed} would "
                text += f"measure it to {sharp}."
            findings.append(Finding("info", "record-length", text))
    return tuple(findings)


def describe_time(seconds: float) -> str:
    """Return a length of record with two digits, such as ``6.2 h``; ``more than 10 years``."""
    if seconds > _LONGEST:
        return "more than 10 years"
    for unit, size, upto in (("s", 1.0, 120.0), ("min", 60.0, 7200.0), ("h", 3600.0, 48 * 3600.0)):
        if seconds < upto:
            return f"{_two_digits(seconds / size)} {unit}"
    return f"{_two_digits(seconds / 86400)} days"


def _two_digits(value: float) -> str:
    places = max(0, 1 - math.floor(math.log10(value))) if value > 0 else 0
    return f"{value:.{min(places, 3)}f}"


def _fit_plan(fit: NoiseFit, ask: _Ask) -> AxisPlan:
    """Return the needs of the terms that a fit estimated, and of those it bounded, at their bounds."""
    seen = [(e.term(e.value), False) for e in fit.estimates if e.value and e.drawn]
    unseen = [
        (e.term(e.high), True)
        for e in fit.estimates
        if e.value is None and not TERMS[e.symbol].repeatable and 0 < e.high < math.inf
    ]
    model = NoiseModel(terms=tuple(term for term, _ in seen))
    return replace(_axis_plan(model, seen + unseen, ask), sensor=fit.sensor)


def _axis_plan(model: NoiseModel, terms: list[tuple[NoiseTerm, bool]], ask: _Ask) -> AxisPlan:
    """Return the needs of terms, each of them in the model or, if bounded, added to it alone."""
    wanted = ask.precision / ask.quantile
    needs: list[Need] = []
    for term, bounded in terms:
        whole = NoiseModel(terms=(*model.terms, term)) if bounded else model
        names = next(own for other, own in named_terms(whole) if other is term)
        for name, value in zip(names, term.values, strict=True):
            reached = shown = None
            bound = math.inf
            if ask.duration_s is not None:
                bound = _bound(whole, name, ask.rate_hz, ask.duration_s)
                reached, shown = _found(bound) * ask.quantile, _share_shown(name, bound)
            near, enough = ask.duration_s or _USUAL, _largest_bound(name, wanted)
            long = ask.longer and bound <= enough
            needed = near if long else _needed(whole, name, ask.rate_hz, enough, near)
            needs.append(Need(name, term.symbol, value, bounded, needed, reached, shown))
    needs.sort(key=lambda need: list(TERMS).index(need.symbol))
    return AxisPlan(model=str(model), rate_hz=ask.rate_hz, duration_s=ask.duration_s, needs=tuple(needs))


def _bound(model: NoiseModel, name: str, rate_hz: float, duration_s: float) -> float:
    """Return the least relative standard error where N, B and K that the model lacks may be there too."""
    there = {term.symbol for term in model.terms}
    beside = [symbol for symbol in ALWAYS if symbol not in there]
    return relative_deviations(model, rate_hz=rate_hz, duration_s=duration_s, beside=beside)[name]


def _found(bound: float) -> float:
    """Return the relative standard error that a fit reports where the least one is `bound`."""
    return bound * (1 + min(max(bound - 0.1, 0.0), 0.3))


def _share_shown(name: str, bound: float) -> float:
    """Return the share of records whose interval excludes zero where the least standard error is `bound`."""
    half, width = _SHOWN.get(name, _SHOWN_USUALLY)
    return 0.5 * math.erfc((bound - half) / (math.sqrt(2) * width))


def _needed(model: NoiseModel, name: str, rate_hz: float, enough: float, near_s: float) -> float:
    """Return the length of record, in s, with which a parameter's least relative standard error is `enough`.

    The search begins at a record of `near_s`.
    """
    target = math.log(enough)

    def excess(log_duration: float) -> float:
        bound = _bound(model, name, rate_hz, math.exp(log_duration))
        # A record too short to tell anything: finite, so that the search goes on from there.
        return math.log(max(bound, 1e-300)) - target if bound < math.inf else _NOTHING_TOLD

    low, high = math.log(2 / rate_hz), math.log(_LONGEST)
    found = root_near(excess, math.log(near_s), -0.5, low=low, high=high, tolerance=_LAST_STEP)
    if found is not None:
        return math.exp(found)
    if excess(high) > 0:
        return math.inf
    return math.exp(root(excess, low, high, tolerance=_TOLERANCE)) if excess(low) > 0 else math.exp(low)


def _largest_bound(name: str, wanted: float) -> float:
    """Return the largest least standard error for a fit's to be `wanted` and most records to show it."""
    from scipy.special import ndtri

    half, width = _SHOWN.get(name, _SHOWN_USUALLY)
    most = half - width * float(ndtri(MOSTLY_SHOWN))
    # The inverse of `_found`: b where b <= 0.1, b (0.9 + b) up to 0.4, and 1.3 b beyond.
    within = wanted if wanted <= 0.1 else (math.sqrt(0.81 + 4 * wanted) - 0.9) / 2
    return min(within if within <= 0.4 else wanted / 1.3, most)
