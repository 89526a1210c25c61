"""Whether a record is one stationary noise: what its segments say, and how much wider intervals become.

The likelihood's interval says how well one stationary process describes this record; a user reads it
as what the next record will give. Where the segments of a record differ by more than chance, the
interval is widened by the Birge ratio sqrt(Q/dof), as if each segment's error were so many times what
it is. Where the model does not describe the spectrum, the misfit asks for wider intervals as well;
the larger of both counts, since what changes over time is also one reason why a model does not fit.

Sources: Cochran (1954), Biometrics 10, 101 (Q); Birge (1932), Physical Review 40, 207 (the ratio);
DerSimonian & Laird (1986), Controlled Clinical Trials 7, 177 (the spread between segments); Bartlett
(1937), Proc. R. Soc. A 160, 268, eq. (16) ff. (small samples).
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.fitting.noise_fit import Estimate, Interval
from imucal.fitting.segments import CHANCE, SLOW, Segments, TermHomogeneity
from imucal.fitting.variance_changes import VarianceChange

#: The interval of a slow term that reaches down to less than this part of its value is widened about the
#: deviation, in which a weak term's is symmetric; others about the deviation's logarithm.
_NARROW = 0.8
#: A lower limit of less than this part of the upper one is none.
_NOUGHT = 0.02
#: Relative spread between segments from which a user should look before using the numbers.
_NOTABLE = 0.05
#: Of a model that describes the record.
_NONE: Mapping[str, float] = MappingProxyType({})


def homogeneity(
    key: str, statistic: float, logs: FloatArray, weight: FloatArray, spans: FloatArray
) -> TermHomogeneity:
    """Return what Q, the logs of a coefficient in s segments and their weights say, shape (s,) each.

    `weight` is the inverse variance of each log, `spans`, shape (s, 2), when each segment begins and ends.
    """
    from scipy.special import chdtrc

    dof = logs.size - 1
    p_value = float(chdtrc(dof, max(statistic, 0.0)))
    scale = float(weight.sum() - np.square(weight).sum() / weight.sum())
    spread = math.sqrt(max(statistic - dof, 0.0) / scale)
    highest, lowest = (tuple(spans[at].tolist()) for at in (int(np.argmax(logs)), int(np.argmin(logs))))
    return TermHomogeneity(
        key=key,
        symbol=symbol_of(key),
        statistic=statistic,
        dof=dof,
        p_value=p_value,
        spread=spread,
        factor=math.sqrt(statistic / dof) if p_value < CHANCE else 1.0,
        highest_s=highest,
        lowest_s=lowest,
    )


def symbol_of(key: str) -> str:
    """Return the symbol of an estimate's key: ``GM`` of ``GM2``."""
    return key.rstrip("0123456789")


def cochran_q(logs: FloatArray, weight: FloatArray) -> float:
    """Return Cochran's Q of logs with these weights: their weighted squares about the weighted mean."""
    return float(np.sum(weight * np.square(logs - np.average(logs, weights=weight))))


def bartlett_correction(information: FloatArray) -> float:
    """Return the mean of the likelihood ratio's test of equal variances, over its degrees of freedom.

    `information`, shape (s,), of the log of each variance, is half its degrees of freedom; less than
    one of these counts as one, because the correction is that of an expansion.
    """
    freedom = np.maximum(2 * information, 1.0)
    part = float(np.sum(1 / freedom)) - 1 / float(freedom.sum())
    return 1 + part / (3 * (information.size - 1))


def widened(
    estimates: Iterable[Estimate], segments: Segments | None, misfits: Mapping[str, float] = _NONE
) -> tuple[Estimate, ...]:
    """Return the estimates with intervals as wide as the segments and the misfit ask for.

    A slow term that then reaches down to zero is bounded.

    Parameters
    ----------
    estimates
        As the likelihood gives them.
    segments
        What the parts of the record say; None for nothing.
    misfits
        Symbol -> factor where the model does not describe the record.
    """
    return tuple(_wider(estimate, _factor(estimate.symbol, segments, misfits)) for estimate in estimates)


def widened_covariance(
    names: tuple[str, ...],
    covariance: FloatArray,
    segments: Segments | None,
    misfits: Mapping[str, float] = _NONE,
) -> FloatArray:
    """Return the covariance of parameters, shape (p, p), that belongs to the wider intervals."""
    factor = np.array([_factor(symbol_of(name.partition(".")[0]), segments, misfits) for name in names])
    wider: FloatArray = covariance * np.outer(factor, factor)
    return wider


def _factor(symbol: str, segments: Segments | None, misfits: Mapping[str, float]) -> float:
    return max(segments.widening(symbol) if segments else 1.0, misfits.get(symbol, 1.0))


def nonstationary_finding(
    segments: Segments | None, change: VarianceChange | None, axis: str
) -> tuple[Finding, ...]:
    """Say which terms change over the record, by how much, and when they are large and small."""
    changing = segments.changing if segments else ()
    said = []
    if segments and changing:
        said.append(
            f"The noise is not the same in {segments.start_s.size} parts of the record: "
            f"{'; '.join(map(_said, changing))}; {_widths(segments)}."
        )
    if change:
        said.append(_swing(change))
    if not said:
        return ()
    notable = change is not None or any(term.spread > _NOTABLE for term in changing)
    return (
        Finding(
            level="warning" if notable else "info",
            code="nonstationary",
            axis=axis,
            text=" ".join(said),
            advice="Look for what changed (temperature, vibration, supply); another record may differ "
            "as much.",
        ),
    )


def _said(term: TermHomogeneity) -> str:
    return (
        f"{term.key} varies by {100 * term.spread:.2g} % (largest {_span(term.highest_s)}, "
        f"smallest {_span(term.lowest_s)})"
    )


def _widths(segments: Segments) -> str:
    """Return by what factors the intervals are wider, in words."""
    factors = {
        "of the slow terms" if symbol in SLOW else f"of {symbol}": segments.widening(symbol)
        for symbol in dict.fromkeys(term.symbol for term in segments.changing)
    }
    said = " and ".join(f"{whose} {factor:.3g}" for whose, factor in factors.items())
    return f"intervals {said} times as wide allow for that"


def _swing(change: VarianceChange) -> str:
    over = f"swings with a period of {change.period_s:.3g} s" if change.period_s else "changes over time"
    return (
        f"The variance of the noise {over}: in short windows the noise is {change.low:.2g} to "
        f"{change.high:.2g} times its median."
    )


def _span(span: tuple[float, float]) -> str:
    """Return ``from 0 to 45 min``."""
    unit, name = (60.0, "min") if span[1] < 2 * 3600 else (3600.0, "h")
    if span[1] < 120:
        unit, name = 1.0, "s"
    return f"from {span[0] / unit:.3g} to {span[1] / unit:.3g} {name}"


def _wider(estimate: Estimate, factor: float) -> Estimate:
    """Return an estimate with limits so many times as far from its value."""
    if factor <= 1:
        return estimate
    if estimate.value is None:
        return replace(estimate, high=estimate.high * factor, widening=factor)
    low, high = _limits(estimate, estimate.value, factor)
    if estimate.symbol in SLOW and low <= _NOUGHT * high:
        bounded = Estimate.bounded(estimate.key, estimate.symbol, high)
        return replace(bounded, alternatives=estimate.alternatives, widening=factor)
    time = estimate.correlation_time
    if time is not None:
        ends = [time.value * (end / time.value) ** factor for end in (time.low, time.high)]
        time = Interval(value=time.value, low=ends[0], high=ends[1])
    return replace(estimate, low=low, high=high, correlation_time=time, widening=factor)


def _limits(estimate: Estimate, value: float, factor: float) -> tuple[float, float]:
    low, high = estimate.low, estimate.high
    if estimate.symbol in SLOW and low < _NARROW * value:
        return value - factor * (value - low), value + factor * (high - value)
    return value * (low / value) ** factor, value * (high / value) ** factor
