"""Whether a record is one stationary noise: what its segments say, and how much wider intervals become.

The likelihood's interval says how well one stationary process describes this record; a user reads it
as what the next record will give. Where the segments of a record differ by more than chance, the
interval is widened by the Birge ratio sqrt(Q/dof), as if each segment's error were so many times what
it is. Where the model does not describe the spectrum, the misfit asks for wider intervals as well;
the larger of both counts, since what changes over time is also one reason why a model does not fit.

Noise may change faster than the segments of a record show. The mean squares of the samples' steps in
short windows are known to within chance alone where the noise is stationary, whatever its tails and its
filter are; then neighbouring windows differ as much as distant ones. Where they differ less, the variance
follows something.

Sources: Cochran (1954), Biometrics 10, 101 (Q); Birge (1932), Physical Review 40, 207 (the ratio);
DerSimonian & Laird (1986), Controlled Clinical Trials 7, 177 (the spread between segments); Bartlett
(1937), Proc. R. Soc. A 160, 268, eq. (16) ff. (small samples); von Neumann (1941), Annals of Mathematical
Statistics 12, 367 (the ratio of the mean square successive difference to the variance).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy

from imucal.arrays import FloatArray
from imucal.findings import Finding, Level
from imucal.fitting.noise_fit import CHANCE, Estimate, Interval, Segments, TermHomogeneity, is_slow
from imucal.frozen import frozen
from imucal.recording import AxisSeries

#: Most windows, fewest, and fewest samples of a window.
_MOST, _FEWEST, _SAMPLES = 1024, 24, 128
#: Steps that are squared at a time.
_PART = 1 << 16
#: Score of von Neumann's ratio from which chance does not explain it.
_SCORE = 5.0
#: Least relative standard deviation of the noise that is worth a word.
_NOTABLE_CHANGE = 0.1
#: Share of the variance in one period from which the change is called a swing of that period.
_PERIODIC = 0.5
#: The interval of a slow term that reaches down to less than this part of its value is widened about the
#: deviation, in which a weak term's is symmetric; others about the deviation's logarithm.
_NARROW = 0.8
#: A lower limit of less than this part of the upper one is none.
NOUGHT = 0.02
#: Units of time: up to how many seconds each is used, its size in s, and its name; hours beyond.
_UNITS = ((120.0, 1.0, "s"), (7200.0, 60.0, "min"))
#: Standard error of a log below which a segment tells a term by itself.
SURE = 0.1
#: Share of Q that one shift must explain: a steady trend over eight segments leaves 17 % of it.
_ONE_SHIFT = 0.85
#: Relative spread between segments from which a user should look before using the numbers.
_NOTABLE_SPREAD = 0.05


@frozen
class VarianceChange:
    """A change of the noise's variance over time.

    `score` is that of von Neumann's ratio, standard normal where the variance is constant; `low` and `high`
    are the 10 % and 90 % quantiles of the noise of a window, relative to their median; `period_s` is the
    period of its swing, in s, None where it has none.
    """

    score: float
    low: float
    high: float
    period_s: float | None


def find_variance_change(series: AxisSeries) -> VarianceChange | None:
    """Return how the variance of an axis's steps changes; None where chance explains it or it is small.

    Steps across gaps are steps as well. O(n).
    """
    count = min(_MOST, (series.n - 1) // _SAMPLES)
    if count < _FEWEST:
        return None
    edges = np.linspace(0, series.n - 1, count + 1).round().astype(np.int64)
    squares = np.empty(count)
    # In parts that stay in the cache.
    first = 0
    while first < count:
        last = max(int(np.searchsorted(edges, edges[first] + _PART, side="right")) - 1, first + 1)
        steps = np.diff(series.samples[edges[first] : edges[last] + 1])
        steps *= steps
        squares[first:last] = np.add.reduceat(steps, edges[first:last] - edges[first])
        first = last
    mean = squares / np.diff(edges)
    if not np.all(mean > 0):
        return None
    logs = np.log(mean) / 2
    logs -= logs.mean()
    square = float(np.sum(logs * logs))
    if not square > 0:
        return None
    ratio = float(np.sum(np.diff(logs) ** 2)) / square / 2
    score = (1 - ratio) / math.sqrt((count - 2) / (count**2 - 1))
    spread = math.sqrt(square / count)
    if score < _SCORE or spread * math.sqrt(max(1 - ratio, 0.0)) < _NOTABLE_CHANGE:
        return None
    low, middle, high = np.quantile(logs, [0.1, 0.5, 0.9]).tolist()
    return VarianceChange(
        score=score,
        low=math.exp(low - middle),
        high=math.exp(high - middle),
        period_s=_period(logs, series.duration_s),
    )


def _period(logs: FloatArray, duration_s: float) -> float | None:
    """Return the period that makes most of the logs' variance, where there are some periods of it."""
    power = np.square(np.abs(np.fft.rfft(logs)))[1:]
    near = np.convolve(power, np.ones(3), "same")
    top = int(np.argmax(near))
    if top < 2 or near[top] < _PERIODIC * power.sum():
        return None
    around = np.arange(top - 1, min(top + 2, power.size))
    frequency = float(np.average(around + 1, weights=power[around]))
    return duration_s / frequency


def homogeneity(
    key: str, statistic: float, logs: FloatArray, weight: FloatArray, spans: FloatArray
) -> TermHomogeneity:
    """Return what Q, the logs of a coefficient in s segments and their weights say, shape (s,) each.

    `weight` is the inverse variance of each log, `spans`, shape (s, 2), when each segment begins and ends.
    """
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
    """Return when a coefficient changes once, in s, and by what factor; None where that is not all.

    The segment in which it changes has some of both levels, which tells the time inside it; all before
    and all after it must be alike but for chance.
    """
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
    # What comes and goes within one segment stands out of both levels.
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
    estimates: Iterable[Estimate], segments: Segments | None, misfits: Mapping[str, float] | None = None
) -> tuple[Estimate, ...]:
    """Return the estimates with intervals as wide as the segments and the misfit ask for.

    A slow term that then reaches down to zero is bounded. `misfits`, a symbol -> its factor, are those of a
    model that does not describe the record.
    """
    return tuple(_wider(estimate, _factor(estimate.symbol, segments, misfits)) for estimate in estimates)


def widened_covariance(
    names: tuple[str, ...],
    covariance: FloatArray,
    segments: Segments | None,
    misfits: Mapping[str, float] | None = None,
) -> FloatArray:
    """Return the covariance of parameters, shape (p, p), that belongs to the wider intervals."""
    factor = np.array([_factor(symbol_of(name), segments, misfits) for name in names])
    return np.asarray(covariance * np.outer(factor, factor))


def _factor(symbol: str, segments: Segments | None, misfits: Mapping[str, float] | None) -> float:
    return max(segments.widening(symbol) if segments else 1.0, (misfits or {}).get(symbol, 1.0))


def nonstationary_finding(
    segments: Segments | None, change: VarianceChange | None, axis: str
) -> tuple[Finding, ...]:
    """Say which terms change over the record, by how much, and when they are large and small."""
    changing = segments.changing if segments else ()
    said = []
    if segments and changing:
        factors = {
            "slow terms" if is_slow(symbol) else symbol: segments.widening(symbol)
            for symbol in dict.fromkeys(term.symbol for term in changing)
        }
        wider = ", ".join(f"{whose} {factor:.3g}" for whose, factor in factors.items())
        said.append(
            f"The noise is not the same in {segments.start_s.size} parts of the record: "
            f"{'; '.join(map(_said, changing))}. The intervals are wider to allow for it: {wider} times."
        )
    if change:
        over = f"swings with a period of {change.period_s:.3g} s" if change.period_s else "changes over time"
        said.append(
            f"The variance of the noise {over}: in short windows the noise is {change.low:.2g} to "
            f"{change.high:.2g} times its median."
        )
    if not said:
        return ()
    notable = change is not None or any(term.spread > _NOTABLE_SPREAD for term in changing)
    level: Level = "warning" if notable else "info"
    advice = "Find the cause (temperature, vibration, supply). Another record may differ as much."
    return (Finding(level, "nonstationary", " ".join(said), advice, axis=axis),)


def _said(term: TermHomogeneity) -> str:
    if term.shift:
        time, factor = term.shift
        unit, name = _unit(time)
        return f"{term.key} shifts once, at about {time / unit:.3g} {name}, to {factor:.3g} times as much"
    by = f"by {100 * term.spread:.2g} %" if term.spread < 1 else "by 100 % or more"
    return f"{term.key} varies {by} (largest {_span(term.highest_s)}, smallest {_span(term.lowest_s)})"


def _span(span: tuple[float, float]) -> str:
    """Return ``from 0 to 45 min``."""
    unit, name = _unit(span[1])
    return f"from {span[0] / unit:.3g} to {span[1] / unit:.3g} {name}"


def _unit(time_s: float) -> tuple[float, str]:
    """Return the unit of time for a number of seconds, in s, and its name."""
    return next(((size, name) for most, size, name in _UNITS if time_s < most), (3600.0, "h"))


def _wider(estimate: Estimate, factor: float) -> Estimate:
    """Return an estimate with limits so many times as far from its value."""
    if factor <= 1:
        return estimate
    if estimate.value is None:
        return replace(estimate, high=estimate.high * factor, widening=factor)
    value, low, high = estimate.value, estimate.low, estimate.high
    if is_slow(estimate.symbol) and low < _NARROW * value:
        low, high = value - factor * (value - low), value + factor * (high - value)
    else:
        low, high = (_stretched(value, end, factor) for end in (low, high))
    if is_slow(estimate.symbol) and low <= NOUGHT * high:
        bounded = Estimate.bounded(estimate.key, estimate.symbol, high)
        return replace(bounded, alternatives=estimate.alternatives, widening=factor)
    time = estimate.correlation_time
    if time is not None:
        ends = [_stretched(time.value, end, factor) for end in (time.low, time.high)]
        time = Interval(value=time.value, low=ends[0], high=ends[1])
    return replace(estimate, low=low, high=high, correlation_time=time, widening=factor)


def _stretched(value: float, end: float, factor: float) -> float:
    """Return a limit so many times as far from its value in logarithms; infinite beyond the largest float."""
    with np.errstate(over="ignore"):
        return float(value * np.power(np.float64(end / value), factor))


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values adjusted for their number. Source: Holm (1979), Scand. J. Statistics 6, 65."""
    order = sorted(range(len(p_values)), key=p_values.__getitem__)
    result, largest = [0.0] * len(p_values), 0.0
    for rank, place in enumerate(order):
        largest = max(largest, min(1.0, (len(order) - rank) * p_values[place]))
        result[place] = largest
    return result
