"""The sampling period from stamps that jitter, repeat, come in bursts or skip samples.

Let s(W) be the median over k of (t[k+W] - t[k]) / W. A clean log has s(W) = tau0 for every W. Bursts make
s(1) too short and s(W) right for W beyond a burst; missing samples make s(1) right and s(W) too long. The
two are told apart by conservation: where bursts only delay samples, t[k] - k tau0 stays bounded.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from imucal.arrays import FloatArray, IntArray, median, percentile

#: Blocks of neighbouring samples looked at, and samples in each; all samples where there are fewer.
_BLOCKS = 10
_BLOCK = 4096

#: Relative difference of two slopes that counts as the same.
_SAME = 0.03


@dataclass(frozen=True, slots=True, kw_only=True)
class Period:
    """A first estimate of the sampling period.

    Attributes
    ----------
    tau_ns
        Sampling period, in ns; good to about one percent.
    jitter
        Standard deviation of a stamp about its neighbours, in samples.
    burst
        Samples that arrive together; 1 where they arrive one by one.
    resolution_ns
        Greatest common divisor of the steps, in ns.
    """

    tau_ns: float
    jitter: float
    burst: int
    resolution_ns: int


def estimate_period(stamps: IntArray) -> Period | None:
    """Return the sampling period of stamps in ns, shape (n,); None where they don't advance."""
    blocks = _blocks(stamps)
    steps = np.concatenate([np.diff(block) for block in blocks])
    positive = steps[steps > 0]
    if not positive.size:
        return None
    quantum = resolution(steps)
    short, wide = _slope(blocks, 1), _plateau(blocks)
    if not wide > 0:
        return None
    unit = median(positive[positive <= 1.5 * percentile(positive, 10)])
    if unit < 0.97 * wide and _skips(steps, unit) and not _only_late(blocks, steps, wide, unit, quantum):
        near = positive[np.abs(positive / unit - 1) < 0.25]
        unit = float(near.mean())
        return Period(tau_ns=unit, jitter=_jitter(near, unit), burst=1, resolution_ns=quantum)
    if short > 0 and abs(wide / short - 1) <= _SAME:
        return Period(tau_ns=wide, jitter=_jitter(steps, wide), burst=1, resolution_ns=quantum)
    pauses = steps[steps > 1.5 * wide]
    burst = int(np.ceil(percentile(pauses, 75) / wide)) if pauses.size > steps.size / 1000 else 1
    return Period(tau_ns=wide, jitter=_jitter(steps, wide), burst=burst, resolution_ns=quantum)


def resolution(steps: IntArray) -> int:
    """Return the greatest common divisor of the steps, in ns; 0 where all are zero."""
    return int(np.gcd.reduce(np.abs(steps[:100_000])))


def _blocks(stamps: IntArray) -> list[IntArray]:
    """Return runs of neighbouring stamps, spread over the log."""
    if stamps.size <= _BLOCKS * _BLOCK:
        return [stamps]
    starts = np.linspace(0, stamps.size - _BLOCK, _BLOCKS).astype(np.int64)
    return [stamps[start : start + _BLOCK] for start in starts.tolist()]


def _slope(blocks: list[IntArray], width: int) -> float:
    """Return the median of (t[k+W] - t[k]) / W, in ns per sample; NaN where no block is long enough."""
    spans = [block[width:] - block[:-width] for block in blocks if block.size > width]
    return median(np.concatenate(spans)) / width if spans else np.nan


def _plateau(blocks: list[IntArray]) -> float:
    """Return the slope at the first width from which a wider window changes nothing, in ns per sample."""
    longest = max(block.size for block in blocks)
    widths = [w for w in (16, 32, 64, 128, 256, 512, 1024, 2048) if w <= longest // 3]
    if not widths:
        block = max(blocks, key=len)
        return (int(block[-1]) - int(block[0])) / (block.size - 1)
    slopes = [_slope(blocks, width) for width in widths]
    changes = [abs(b / a - 1) if a > 0 else np.inf for a, b in pairwise(slopes)]
    for index, change in enumerate(changes):
        if change <= _SAME:
            return slopes[index + 1]
    best = int(np.argmin(changes)) + 1 if changes else 0
    return slopes[best]


def _skips(steps: IntArray, unit: float) -> bool:
    """Say whether many steps are one unit and the others whole multiples, as where samples are missing."""
    ratio = steps / unit
    single = np.mean(np.abs(ratio - 1) < 0.25)
    longer = ratio[ratio > 1.4]
    whole = np.mean(np.abs(longer - np.round(longer)) < 0.25) if longer.size else 0.0
    return bool(single >= 0.3 and whole >= 0.9)


def _only_late(blocks: list[IntArray], steps: IntArray, tau: float, unit: float, quantum: int) -> bool:
    """Say whether steps that look like whole multiples come from bursts, or from coarse stamps, instead.

    Coarse stamps are multiples of a power of ten, such as 1 ms; a sampling period seldom is one of the two
    at once. Pauses between bursts are several units long, and there is more than a pair of them.
    """
    longer = steps[steps > 1.4 * unit]
    if not _conserved(blocks, tau) or longer.size < 3:
        return False
    coarse = quantum > unit / 2 and np.log10(quantum) % 1 == 0
    return bool(coarse or median(longer) >= 4 * unit)


def _conserved(blocks: list[IntArray], tau: float) -> bool:
    """Say whether t[k] - k tau stays within a few pauses: samples are late, none is missing."""
    ranges: list[float] = []
    pauses: list[float] = []
    for block in blocks:
        for start in range(0, max(block.size - 1024, 0) + 1, 2048):
            part = (block[start : start + 2048] - block[start]) / tau
            if part.size < 3:
                continue
            late = part - np.linspace(0.0, part[-1], part.size)
            ranges.append(float(np.ptp(late)))
            pauses.append(percentile(np.diff(part), 95))
    return bool(ranges) and median(ranges) <= 3 * median(pauses) + 2


def _jitter(steps: IntArray | FloatArray, tau: float) -> float:
    """Return the standard deviation of one stamp in samples, from the median absolute deviation of steps."""
    deviation = 1.4826 * median(np.abs(steps - median(steps)))
    return deviation / math.sqrt(2) / tau
