"""Tests of stationarity, and wider intervals for records that are not stationary.

If the segments of a record differ by more than chance, the interval is widened by the Birge ratio
sqrt(Q/dof), because users read it as a prediction of the next record. A misfit of the spectrum also widens
it; the larger factor counts.

Sources: Cochran (1954), Biometrics 10, 101 (Q); Birge (1932), Physical Review 40, 207 (the ratio);
DerSimonian & Laird (1986), Controlled Clinical Trials 7, 177 (the spread between segments); Bartlett (1937),
Proc. R. Soc. A 160, 268, eq. (16) ff. (small samples).
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
import scipy

from imucal.arrays import FloatArray
from imucal.findings import Finding, Level
from imucal.fitting.noise_fit import CHANCE, Estimate, Interval, Segments, TermHomogeneity, is_slow

#: Ratio of lower limit to value below which a slow term's interval is widened linearly, not in logarithms.
_NARROW = 0.8
#: Lower limits below this share of the upper limit count as zero.
NEGLIGIBLE = 0.02
#: Units of time: upper limit and size in s, and name; hours beyond.
_UNITS = ((120.0, 1.0, "s"), (7200.0, 60.0, "min"))
#: Standard error of a log below which a single segment determines a term.
SURE = 0.1
#: Share of Q that a single shift explains.
_ONE_SHIFT = 0.85
#: Relative spread between segments from which the finding is a warning.
_NOTABLE_SPREAD = 0.05


def homogeneity(
    key: str, statistic: float, logs: FloatArray, weight: FloatArray, spans: FloatArray
) -> TermHomogeneity:
    """Return the homogeneity of a term from its `statistic` Q and its log coefficients in s segments."""
    dof = logs.size - 1
    p_value = float(scipy.special.chdtrc(dof, max(statistic, 0.0)))
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
        shift=_shift(logs, weight, spans) if p_value < CHANCE and weight.min() > SURE**-2 else None,
    )


def _shift(logs: FloatArray, weight: FloatArray, spans: FloatArray) -> tuple[float, float] | None:
    """Return time, in s, and factor of a coefficient's single change; None if it changes otherwise."""
    whole, best = cochran_q(logs, weight), (math.inf, 0)
    for at in range(1, logs.size - 1):
        before, after = slice(at), slice(at + 1, None)
        rest = cochran_q(logs[before], weight[before]) + cochran_q(logs[after], weight[after])
        best = min(best, (rest, at))
    rest, at = best
    if logs.size < 5 or rest > (1 - _ONE_SHIFT) * whole or scipy.special.chdtrc(logs.size - 3, rest) < CHANCE:
        return None
    first = float(np.average(logs[:at], weights=weight[:at]))
    last = float(np.average(logs[at + 1 :], weights=weight[at + 1 :]))
    # A passing change within one segment is outside the range of both levels.
    chance = 3 / math.sqrt(weight[at])
    if not min(first, last) - chance < logs[at] < max(first, last) + chance:
        return None
    share = np.expm1(2 * (logs[at] - last)) / np.expm1(2 * (first - last))
    time = np.interp(share, [0.0, 1.0], spans[at])
    return float(time), math.exp(last - first)


def symbol_of(key: str) -> str:
    """Return the symbol of the key of an estimate or of a parameter: ``GM`` of ``GM2`` and ``GM2.T``."""
    return key.partition(".")[0].rstrip("0123456789")


def cochran_q(logs: FloatArray, weight: FloatArray) -> float:
    """Return Cochran's Q: the weighted squares of logs about their weighted mean."""
    return float(np.sum(weight * np.square(logs - np.average(logs, weights=weight))))


def bartlett_correction(information: FloatArray) -> float:
    """Return the mean of the likelihood ratio's test of equal variances, divided by its degrees of freedom.

    `information`, shape (s,), on the log of each variance is half its degrees of freedom; at least one is
    assumed.
    """
    freedom = np.maximum(2 * information, 1.0)
    part = float(np.sum(1 / freedom)) - 1 / float(freedom.sum())
    return 1 + part / (3 * (information.size - 1))


def widened(
    estimates: Iterable[Estimate], segments: Segments | None, misfits: Mapping[str, float] | None = None
) -> tuple[Estimate, ...]:
    """Return the estimates with intervals widened for differing segments and a misfit.

    A slow term whose interval then reaches down to zero is bounded.
    """
    return tuple(_wider(estimate, _factor(estimate.symbol, segments, misfits)) for estimate in estimates)


def widened_covariance(
    names: tuple[str, ...],
    covariance: FloatArray,
    segments: Segments | None,
    misfits: Mapping[str, float] | None = None,
) -> FloatArray:
    """Return the covariance of parameters, shape (p, p), for the widened intervals."""
    factor = np.array([_factor(symbol_of(name), segments, misfits) for name in names])
    return np.asarray(covariance * np.outer(factor, factor))


def _factor(symbol: str, segments: Segments | None, misfits: Mapping[str, float] | None) -> float:
    return max(segments.widening(symbol) if segments else 1.0, (misfits or {}).get(symbol, 1.0))


def nonstationary_finding(segments: Segments | None, axis: str) -> tuple[Finding, ...]:
    """Return a finding on the terms that change."""
    changing = segments.changing if segments else ()
    if segments is None or not changing:
        return ()
    factors = {
        "slow terms" if is_slow(symbol) else symbol: segments.widening(symbol)
        for symbol in dict.fromkeys(term.symbol for term in changing)
    }
    wider = ", ".join(f"{whose} {factor:.3g}" for whose, factor in factors.items())
    text = (
        f"The noise is not the same in {segments.start_s.size} parts of the record: "
        f"{'; '.join(map(_change_of, changing))}. The intervals are wider to allow for it: {wider} times."
    )
    notable = any(term.spread > _NOTABLE_SPREAD for term in changing)
    level: Level = "warning" if notable else "info"
    advice = "Find the cause (temperature, vibration, supply). Another record may differ as much."
    return (Finding(level, "nonstationary", text, advice, axis=axis),)


def _change_of(term: TermHomogeneity) -> str:
    if term.shift:
        time, factor = term.shift
        unit, name = _unit(time)
        return f"{term.key} shifts once, at about {time / unit:.3g} {name}, to {factor:.3g} times as much"
    by = f"by {100 * term.spread:.2g} %" if term.spread < 1 else "by 100 % or more"
    return f"{term.key} varies {by} (largest {_span(term.highest_s)}, smallest {_span(term.lowest_s)})"


def _span(span: tuple[float, float]) -> str:
    unit, name = _unit(span[1])
    return f"from {span[0] / unit:.3g} to {span[1] / unit:.3g} {name}"


def _unit(time_s: float) -> tuple[float, str]:
    return next(((size, name) for most, size, name in _UNITS if time_s < most), (3600.0, "h"))


def _wider(estimate: Estimate, factor: float) -> Estimate:
    if factor <= 1:
        return estimate
    if estimate.value is None:
        return replace(estimate, high=estimate.high * factor, widening=factor)
    value, low, high = estimate.value, estimate.low, estimate.high
    if is_slow(estimate.symbol) and low < _NARROW * value:
        low, high = value - factor * (value - low), value + factor * (high - value)
    else:
        low, high = (_stretched(value, end, factor) for end in (low, high))
    if is_slow(estimate.symbol) and low <= NEGLIGIBLE * high:
        bounded = Estimate.bounded(estimate.key, estimate.symbol, high)
        return replace(bounded, alternatives=estimate.alternatives, widening=factor)
    time = estimate.correlation_time
    if time is not None:
        ends = [_stretched(time.value, end, factor) for end in (time.low, time.high)]
        time = Interval(value=time.value, low=ends[0], high=ends[1])
    return replace(estimate, low=low, high=high, correlation_time=time, widening=factor)


def _stretched(value: float, end: float, factor: float) -> float:
    """Return a limit `factor` times as far from its value in logarithms."""
    with np.errstate(over="ignore"):
        return float(value * np.power(np.float64(end / value), factor))
