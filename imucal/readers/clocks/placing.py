"""The sampling period of stamps, and each sample's place on the even grid.

The period comes from stamps that jitter, repeat, come in bursts or skip samples. Let s(W) be the median over
k of (t[k+W] - t[k]) / W. A clean log has s(W) = tau0 for every W. Bursts make s(1) too short and s(W) right
for W beyond a burst; missing samples make s(1) right and s(W) too long. The two are told apart by
conservation: where bursts only delay samples, t[k] - k tau0 stays bounded.

With x[k] = t[k]/tau - k, missing samples lift x for good, a doubled sample lowers it for good, and a late
sample lifts it only until the next ones have caught up. So a lift at k counts only where the *lowest* x
among the following samples, as many as could catch up, stays above the *highest* before.
Works block by block; memory does not grow with n.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from imucal.arrays import FloatArray, IntArray, blocks, distinct, median, percentile

#: Runs of neighbouring samples by which the period is estimated, and samples in each; all samples where there
#: are fewer.
_RUNS, _RUN = 10, 4096

#: Relative difference of two slopes that counts as the same.
_SAME = 0.03
#: Samples worked on at once: what fits the processor's cache.
_BLOCK = 1 << 16
#: Samples that may catch up after a pause, at most.
_REACH = 1 << 13
#: Samples before and after a step that say where the clock stood.
_SAMPLES_AROUND = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Period:
    """A first estimate of the sampling period."""

    #: Sampling period, in ns; good to about one percent.
    tau_ns: float
    #: Standard deviation of a stamp about its neighbours, in samples.
    jitter: float
    #: Samples that arrive together; 1 where they arrive one by one.
    burst: int
    #: Greatest common divisor of the steps, in ns.
    resolution_ns: int


def estimate_period(stamps: IntArray) -> Period | None:
    """Return the sampling period of stamps in ns, shape (n,); None where they don't advance."""
    runs = _runs(stamps)
    steps = np.concatenate([np.diff(run) for run in runs])
    positive = steps[steps > 0]
    if not positive.size:
        return None
    quantum = int(np.gcd.reduce(np.abs(steps[:100_000])))
    short, wide = _slope(runs, 1), _plateau(runs)
    if not wide > 0:
        return None
    unit = median(positive[positive <= 1.5 * percentile(positive, 10)])
    burst, near = 1, steps
    if unit < 0.97 * wide and _skips(steps, unit) and not _only_late(runs, steps, wide, unit, quantum):
        near = positive[np.abs(positive / unit - 1) < 0.25]
        wide = float(near.mean())
    elif not short > 0 or abs(wide / short - 1) > _SAME:
        pauses = steps[steps > 1.5 * wide]
        burst = int(np.ceil(percentile(pauses, 75) / wide)) if pauses.size > steps.size / 1000 else 1
    # The standard deviation of one stamp, from the median absolute deviation of steps.
    deviation = 1.4826 * median(np.abs(near - median(near)))
    jitter = deviation / math.sqrt(2) / wide
    return Period(tau_ns=wide, jitter=jitter, burst=burst, resolution_ns=quantum)


def _runs(stamps: IntArray) -> list[IntArray]:
    """Return runs of neighbouring stamps, spread over the log."""
    if stamps.size <= _RUNS * _RUN:
        return [stamps]
    starts = np.linspace(0, stamps.size - _RUN, _RUNS).astype(np.int64)
    return [stamps[start : start + _RUN] for start in starts.tolist()]


def _slope(runs: list[IntArray], width: int) -> float:
    """Return the median of (t[k+W] - t[k]) / W, in ns per sample; NaN where no run is long enough."""
    spans = [run[width:] - run[:-width] for run in runs if run.size > width]
    return median(np.concatenate(spans)) / width if spans else np.nan


def _plateau(runs: list[IntArray]) -> float:
    """Return the slope at the first width from which a wider window changes nothing, in ns per sample."""
    longest = max(run.size for run in runs)
    widths = [w for w in (16, 32, 64, 128, 256, 512, 1024, 2048) if w <= longest // 3]
    if not widths:
        run = max(runs, key=len)
        return (int(run[-1]) - int(run[0])) / (run.size - 1)
    slopes = [_slope(runs, width) for width in widths]
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


def _only_late(runs: list[IntArray], steps: IntArray, tau: float, unit: float, quantum: int) -> bool:
    """Say whether steps that look like whole multiples come from bursts, or from coarse stamps, instead.

    Coarse stamps are multiples of a power of ten, such as 1 ms; a sampling period seldom is one of the two
    at once. Pauses between bursts are several units long, and there is more than a pair of them.
    """
    longer = steps[steps > 1.4 * unit]
    if not _conserved(runs, tau) or longer.size < 3:
        return False
    coarse = quantum > unit / 2 and np.log10(quantum) % 1 == 0
    return bool(coarse or median(longer) >= 4 * unit)


def _conserved(runs: list[IntArray], tau: float) -> bool:
    """Say whether t[k] - k tau stays within a few pauses: samples are late, none is missing."""
    ranges: list[float] = []
    pauses: list[float] = []
    for run in runs:
        for start in range(0, max(run.size - 1024, 0) + 1, 2048):
            part = (run[start : start + 2048] - run[start]) / tau
            if part.size < 3:
                continue
            late = part - np.linspace(0.0, part[-1], part.size)
            ranges.append(float(np.ptp(late)))
            pauses.append(percentile(np.diff(part), 95))
    return bool(ranges) and median(ranges) <= 3 * median(pauses) + 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Breaks:
    """Where the samples do not follow each other."""

    #: Samples before which others are missing, shape (b,), and how many, shape (b,).
    at: IntArray
    missing: IntArray
    #: Samples that are one too many, shape (d,).
    doubled: IntArray


_NONE: IntArray = np.zeros(0, dtype=np.int64)
#: Nothing is missing.
NO_BREAKS = Breaks(at=_NONE, missing=_NONE, doubled=_NONE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Steps:
    """What the steps from stamp to stamp show."""

    #: Number of stamps equal to, and earlier than, the one before.
    same: int
    back: int
    #: Samples at which the clock went back for good, shape (r,).
    resets: IntArray
    #: Whether every step is between half a period and one and a half.
    even: bool


def step_statistics(stamps: IntArray, tau: float) -> Steps:
    """Return what all steps of stamps in ns, shape (n,), show.

    A single stamp out of order is no reset: the median of five after it is not below that of five before.
    """
    found = [_NONE]
    same = back = 0
    even = True
    for part in blocks(stamps.size - 1, stamps, size=_BLOCK):
        start = part.start
        steps = np.diff(stamps[start : start + _BLOCK + 1])
        low, high = int(steps.min()), int(steps.max())
        even = even and 0.5 * tau <= low and high <= 1.5 * tau
        if low > 0:
            continue
        same += int(np.count_nonzero(steps == 0))
        back += int(np.count_nonzero(steps < 0))
        if low < -0.5 * tau:
            found.append(_resets(stamps, np.flatnonzero(steps < -0.5 * tau) + start + 1))
    return Steps(same=same, back=back, resets=np.concatenate(found), even=even)


def _resets(stamps: IntArray, at: IntArray) -> IntArray:
    """Return those of the samples `at` from which on the clock stays behind."""
    near = np.arange(5)
    base = stamps[at - 1][:, None]
    before = np.median(stamps[np.maximum(at[:, None] - 5 + near, 0)] - base, axis=1)
    after = np.median(stamps[np.minimum(at[:, None] + near, stamps.size - 1)] - base, axis=1)
    chosen: IntArray = at[after < before]
    return chosen


def find_breaks(stamps: IntArray, period: Period, resets: IntArray | None = None) -> Breaks:
    """Return the missing and doubled samples of stamps in ns, shape (n,).

    Each stretch between two `resets`, samples at which the clock was set, shape (r,), is looked at by itself.
    """
    spread = (period.burst - 1) if period.burst > 1 else min(3 * period.jitter, 0.3)
    near = min(max(_SAMPLES_AROUND, 2 * period.burst), _REACH)
    at, missing, doubled = [_NONE], [_NONE], [_NONE]
    for start, stop in pairwise([0, *(_NONE if resets is None else resets).tolist(), stamps.size]):
        for first, block, inner in _odd_blocks(stamps[start:stop], period.tau_ns):
            lifts, counts, extra = _breaks(block, inner, period, near, spread)
            at.append(lifts + (start + first))
            missing.append(counts)
            doubled.append(extra + (start + first))
    return Breaks(at=np.concatenate(at), missing=np.concatenate(missing), doubled=np.concatenate(doubled))


def fit_period(
    stamps: IntArray, tau: float, breaks: Breaks, resets: IntArray, *, longest: int
) -> tuple[float, float]:
    """Return the least-squares period and the standard deviation about it, in ns.

    Parameters
    ----------
    stamps
        Shape (n,), in ns.
    tau
        A first estimate, in ns.
    breaks, resets
        Where samples are missing or doubled, and where the clock was set.
    longest
        Gaps up to this many samples are believed to have exactly the size found; each run between longer
        ones (and each block of a long run) has a level of its own.
    """
    exact = breaks.missing <= longest
    starts = distinct(np.concatenate([breaks.at[~exact], breaks.doubled, resets]))
    at, missing = breaks.at[exact], breaks.missing[exact]
    moment = weight = square = 0.0
    count = 0
    whole: tuple[FloatArray, FloatArray, float] | None = None
    for part in blocks(stamps.size, stamps, size=_BLOCK):
        first, block = part.start, stamps[part]
        lo, hi = np.searchsorted(starts, [first, first + block.size])
        edges = distinct(np.concatenate([[0], starts[lo:hi] - first]))
        sizes = np.diff(np.append(edges, block.size))
        lo, hi = np.searchsorted(at, [first, first + block.size])
        if hi == lo and edges.size == 1 and block.size == _BLOCK:
            # Most blocks are whole: their places are always the same.
            whole = whole or _grid(np.arange(_BLOCK, dtype=np.float64), tau, edges, sizes)
            times, centred, squares = whole
        else:
            skipped = np.zeros(block.size)
            skipped[at[lo:hi] - first] = missing[lo:hi]
            places = np.cumsum(skipped) + np.arange(block.size, dtype=np.float64)
            times, centred, squares = _grid(places, tau, edges, sizes)
        late = (block - block[0]).astype(np.float64)
        late -= times
        _center(late, edges, sizes)
        place = _without_outliers(centred, late, edges, sizes)
        moment += _dot(place, late)
        weight += squares if place is centred else _dot(place, place)
        square += _dot(late, late)
        count += block.size - edges.size
    if weight == 0 or count < 1:
        return tau, 0.0
    slope = moment / weight
    return tau + slope, float(np.sqrt(max(square - slope * moment, 0.0) / max(count, 1)))


def _dot(a: FloatArray, b: FloatArray) -> float:
    """Return the scalar product, without the threads that BLAS would start for it."""
    return float(np.einsum("i,i", a, b))


def _grid(
    place: FloatArray, tau: float, edges: IntArray, sizes: IntArray
) -> tuple[FloatArray, FloatArray, float]:
    """Return the times of places, shape (n,), these about the mean of their run, and the sum of squares."""
    times = tau * place
    _center(place, edges, sizes)
    return times, place, _dot(place, place)


def _without_outliers(place: FloatArray, late: FloatArray, edges: IntArray, sizes: IntArray) -> FloatArray:
    """Return the places with no weight for stamps that are far off, and do so with `late` in place.

    A broken stamp is not late, it is wrong.
    """
    some = late[:: max(late.size // 1000, 1)]
    middle = median(some)
    limit = 20 * percentile(np.abs(some - middle), 90) + 1
    if max(float(late.max()) - middle, middle - float(late.min())) > limit:
        far = np.abs(late - middle) > limit
        late[far] = middle
        _center(late, edges, sizes)
        place = place.copy()
        place[far] = late[far] = 0.0
    return place


def _center(values: FloatArray, edges: IntArray, sizes: IntArray) -> None:
    """Subtract from each run of `values` its mean, in place."""
    if edges.size == 1:
        values -= values.mean()
    else:
        values -= np.repeat(np.add.reduceat(values, edges) / sizes, sizes)


def _odd_blocks(stamps: IntArray, tau: float) -> Iterator[tuple[int, IntArray, slice]]:
    """Yield each block with odd steps: where it begins, its stamps and those around, and its own part."""
    n = stamps.size
    for part in blocks(n, stamps, size=_BLOCK):
        start = part.start
        steps = np.diff(stamps[max(start - 1, 0) : start + _BLOCK])
        if not steps.size or (steps.min() >= 0.5 * tau and steps.max() <= 1.5 * tau):
            continue
        first, last = max(start - _REACH, 0), min(start + _BLOCK + _REACH, n)
        yield first, stamps[first:last], slice(start - first, min(start + _BLOCK, n) - first)


def _breaks(
    block: IntArray, inner: slice, period: Period, near: int, spread: float
) -> tuple[IntArray, IntArray, IntArray]:
    """Return lifts, their sizes and doubled samples of a block, as places in it."""
    tau = period.tau_ns
    steps = np.diff(block)
    odd = np.flatnonzero((steps > 1.5 * tau) | (steps < 0.5 * tau)) + 1
    odd = odd[(odd >= max(inner.start, 1)) & (odd < inner.stop)]
    if not odd.size:
        return _NONE, _NONE, _NONE
    x = (block - block[0]) / tau
    x -= np.arange(block.size)
    jump = x[odd] - x[odd - 1]
    lifts, jumps = odd[jump > 0], jump[jump > 0]
    before = _extreme(x, np.maximum, near)
    reach = np.minimum(2 * jumps + near, _REACH).astype(np.int64)
    rise = _lowest_after(x, lifts, reach) - before[lifts]
    real = rise > 0.5
    size = np.minimum(np.round(jumps[real]), np.round(rise[real] + spread))
    missing = np.maximum(size, 1).astype(np.int64)
    if period.burst > 1:
        return lifts[real], missing, _NONE
    falls = odd[jump < 0]
    if falls.size:
        # Without the lifts that stay, x only falls for good at a doubled sample; catching up never takes
        # it below where it was before the pause.
        level = np.zeros(x.size)
        level[lifts[real]] = missing
        x -= np.cumsum(level)
        back = int(min(2 * jumps[~real].max(initial=0.0) + near, _REACH))
        after = np.maximum(_extreme(x[::-1], np.maximum, near)[::-1], x)
        fall = _extreme(x, np.minimum, back)[falls] - after[falls]
        falls = falls[fall > 0.5]
    return lifts[real], missing, falls


def _extreme(x: FloatArray, better: Callable[..., FloatArray], width: int) -> FloatArray:
    """Return, for each place, the extreme of the `width` values before it; the first value at place 0."""
    result = x.copy()
    done = 1
    while done < width:
        step = min(done, width - done)
        moved = result.copy()
        better(result[step:], moved[:-step], out=result[step:])
        done += step
    result[1:] = result[:-1].copy()
    return result


def _lowest_after(x: FloatArray, at: IntArray, reach: IntArray) -> FloatArray:
    """Return the lowest of ``x[at : at + reach]``, with `reach` rounded up to a power of two."""
    result: FloatArray = x[at].copy()
    level = np.ceil(np.log2(np.maximum(reach, 1))).astype(np.int64)
    low, width = x.copy(), 1
    for power in range(1, int(level.max(initial=0)) + 1):
        if width < low.size:
            np.minimum(low[:-width], low[width:].copy(), out=low[:-width])
        width *= 2
        chosen = level == power
        result[chosen] = low[at[chosen]]
    return result
