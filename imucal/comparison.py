"""compare: two reports -> the terms that differ, and the p-values.

The standard deviation of a difference follows from the lower limit of the larger value and the upper limit of
the smaller (Zou & Donner 2008, the MOVER method). Two-sided p-values are adjusted for the number of tested
terms (Holm 1979): two reports of the same sensor show any difference with probability `alpha`.

A term that one report estimates and the other bounds is tested against zero with the width of the bound.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

from imucal.errors import ArgumentError, DataError
from imucal.fitting.noise_fit import Estimate
from imucal.multiple_tests import holm
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report.given import GIVEN
from imucal.report.numbers import Quantity
from imucal.report.result import AxisReport, Report

#: ``bounded``: neither report shows the term; ``only-a``: report b lacks the term or axis.
Outcome: TypeAlias = Literal["differs", "same", "bounded", "only-a", "only-b"]

_TIME = ".T"


#: Most rows in a short text.
_SHOWN = 10


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One term of one axis in both reports: the estimates a and b, None if a report has none.

    `axis`, `key` and `symbol` are, for example, ``gyro_x``, ``GM1`` (or ``GM1.T``, its correlation time) and
    ``GM``; the unit is SI. `z` is the score of the difference beyond the tolerance, `p` the two-sided
    p-value, `p_adjusted` the p-value after Holm's adjustment; all are None without a test.
    """

    axis: str
    key: str
    symbol: str
    sensor: Sensor
    unit: str
    a: Estimate | None
    b: Estimate | None
    z: float | None
    p: float | None
    p_adjusted: float | None = None
    outcome: Outcome

    @property
    def ratio(self) -> float | None:
        """The ratio b / a of the values; None if either is bounded or missing, or a is zero."""
        if self.a is None or self.b is None or not self.a.value or self.b.value is None:
            return None
        return self.b.value / self.a.value


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """The comparison of the reports of two logs with the paths `a` and `b`.

    `alpha` is the probability of any false difference, `tolerance` the relative difference that is ignored.
    `differences` has an entry for each term of each axis, `notes` sentences on other causes of differences.
    """

    a: str
    b: str
    alpha: float
    tolerance: float
    differences: tuple[Difference, ...]
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        lines = [
            f"Comparison of {self.b} with {self.a}: {len(self.significant)} of {self.tested} terms differ"
        ]
        for each in self.significant[:_SHOWN]:
            ratio = "" if each.ratio is None else f", {each.ratio:.3g} times"
            lines.append(f"{each.axis} {each.key}: p = {each.p_adjusted:.2g}{ratio}")
        return "\n".join(lines)

    @property
    def tested(self) -> int:
        """Number of tested terms."""
        return sum(difference.p is not None for difference in self.differences)

    @property
    def significant(self) -> tuple[Difference, ...]:
        """The terms that differ."""
        return tuple(difference for difference in self.differences if difference.outcome == "differs")


def compare(a: Report, b: Report, *, alpha: float = 0.05, tolerance: float = 0.0) -> Comparison:
    """Compare two reports, axis by axis and term by term.

    Parameters
    ----------
    a, b
        The reports; b is judged against a.
    alpha
        Probability of any false difference.
    tolerance
        Relative difference that is ignored, such as 0.05. Another day or another temperature may change a
        sensor by more than its intervals.

    Raises
    ------
    DataError
        If the reports have no axis in common.
    ValueError
        If `alpha` isn't between 0 and 1, or `tolerance` is negative.
    """
    if not 0 < alpha < 1:
        raise ArgumentError(f"alpha must be between 0 and 1, got {alpha}")
    if not (tolerance >= 0 and math.isfinite(tolerance)):
        raise ArgumentError(f"tolerance must be 0 or more, got {tolerance}")
    axes_a, axes_b = ({axis.name: axis for axis in report.axes} for report in (a, b))
    if not axes_a.keys() & axes_b.keys():
        msg = (
            f"{a.source.path} and {b.source.path} have no axis in common: the first has "
            f"{', '.join(axes_a) or 'none'}, the second {', '.join(axes_b) or 'none'}; "
            "compare logs of the same sensor"
        )
        raise DataError(msg)
    differences = [
        difference
        for name in dict.fromkeys([*axes_a, *axes_b])
        for difference in _axis(axes_a.get(name), axes_b.get(name), tolerance)
    ]
    return Comparison(
        a=a.source.path,
        b=b.source.path,
        alpha=alpha,
        tolerance=tolerance,
        differences=tuple(_judged(differences, alpha)),
        notes=tuple(_notes(axes_a, axes_b)),
    )


def _notes(a: Mapping[str, AxisReport], b: Mapping[str, AxisReport]) -> Iterator[str]:
    both = [(a[name], b[name]) for name in a if name in b]
    pairs = {
        "fitted by": {(one.fit.method, other.fit.method) for one, other in both},
        "sampled at": {(f"{one.rate_hz:.4g} Hz", f"{other.rate_hz:.4g} Hz") for one, other in both},
    }
    for what, found in pairs.items():
        for one, other in sorted(found):
            if one != other and GIVEN not in (one, other):
                yield f"A was {what} {one}, B {what} {other}; this may cause differences"


def _axis(a: AxisReport | None, b: AxisReport | None, tolerance: float) -> list[Difference]:
    axis = a or b
    assert axis is not None  # noqa: S101 - the name came from one of them
    differences = []
    for key, first, second in paired(a, b):
        symbol = _symbol(key)
        z = None
        if a is not None and b is not None and first is not None and second is not None:
            z = _score(first, second, (a.fit.level, b.fit.level), tolerance)
        differences.append(
            Difference(
                axis=axis.name,
                key=key,
                symbol=symbol,
                sensor=axis.sensor,
                unit="s" if key.endswith(_TIME) else TERMS[symbol].unit(axis.sensor),
                a=first,
                b=second,
                z=z,
                p=None if z is None else math.erfc(abs(z) / math.sqrt(2)),
                outcome="only-b" if first is None else "only-a" if second is None else "bounded",
            )
        )
    return differences


def paired(
    a: AxisReport | None, b: AxisReport | None
) -> Iterator[tuple[str, Estimate | None, Estimate | None]]:
    """Yield the key of each term of two axes with both estimates, in the order of the terms."""
    in_a, in_b = _estimates(a), _estimates(b)
    for key in sorted(in_a.keys() | in_b.keys(), key=lambda key: (list(TERMS).index(_symbol(key)), key)):
        yield key, in_a.get(key), in_b.get(key)


def ratio(now: Quantity, before: Quantity) -> Quantity:
    """Return the ratio of two independent quantities with its interval.

    The distances to the limits of both add in quadrature on the logarithmic scale (Zou & Donner 2008). A
    bound is between 0 and its upper limit.
    """
    if now.value is None or before.value is None:
        low = now.low / before.high if before.high else math.inf
        high = now.high / before.low if before.low else math.inf
        return Quantity(value=None, low=low, high=high)
    middle = now.value / before.value if before.value else math.inf
    down = math.hypot(_distance(now.low, now.value), _distance(before.value, before.high))
    up = math.hypot(_distance(now.value, now.high), _distance(before.low, before.value))
    high = middle * (math.exp(up) if up < 700 else math.inf)
    return Quantity(value=middle, low=middle * math.exp(-down), high=high)


def _distance(low: float, high: float) -> float:
    return math.log(high / low) if low > 0 else math.inf


def _estimates(axis: AxisReport | None) -> dict[str, Estimate]:
    """Return estimates by key; a correlation time has its own, such as ``GM.T``."""
    found: dict[str, Estimate] = {}
    for estimate in () if axis is None else axis.fit.estimates:
        if not estimate.high and estimate.value is None:
            continue  # not in the given model
        found[estimate.key] = estimate
        if (time := estimate.correlation_time) is not None:
            key = estimate.key + _TIME
            found[key] = replace(
                estimate, key=key, status="estimated", value=time.value, low=time.low, high=time.high
            )
    return found


def _symbol(key: str) -> str:
    """Return ``GM`` for ``GM2.T``."""
    return key.removesuffix(_TIME).rstrip("0123456789")


def _score(a: Estimate, b: Estimate, levels: tuple[float, float], tolerance: float) -> float | None:
    """Return the score of b - a beyond the tolerance; None if both are bounds."""
    if a.value is None and b.value is None:
        return None
    first, second = a.value or 0.0, b.value or 0.0
    beyond = abs(second - first) - tolerance * abs(first)
    if beyond <= 0:
        return 0.0
    sides = ((a, levels[0]), (b, levels[1]))
    (larger, level), (smaller, level_smaller) = sides[::-1] if second > first else sides
    if smaller.value is None and level_smaller > 0.5:
        # A bound is one-sided.
        level_smaller = 2 * level_smaller - 1
    down = ((larger.value or 0.0) - larger.low) / _quantile(level)
    up = (smaller.high - (smaller.value or 0.0)) / _quantile(level_smaller)
    deviation = math.hypot(down, up)
    if math.isnan(deviation):
        return None
    score = beyond / deviation if deviation > 0 else math.inf
    return math.copysign(score, second - first)


def _quantile(level: float) -> float:
    """Return the number of standard deviations from the middle to a two-sided limit."""
    from statistics import NormalDist

    return NormalDist().inv_cdf((1 + level) / 2)


def _judged(differences: Sequence[Difference], alpha: float) -> Iterator[Difference]:
    adjusted = iter(holm([difference.p for difference in differences if difference.p is not None]))
    for difference in differences:
        if difference.p is None:
            yield difference
        else:
            p = next(adjusted)
            yield replace(difference, p_adjusted=p, outcome="differs" if p < alpha else "same")
