"""Each sample's place on the even grid: what is missing, doubled or set, and the period between.

With x[k] = t[k]/tau - k, missing samples lift x for good, a doubled sample lowers it for good, and a late
sample lifts it only until the next ones have caught up. So a lift at k counts only where the *lowest* x
among the following samples, as many as could catch up, stays above the *highest* before.
Works block by block; memory does not grow with n.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from imucal.arrays import FloatArray, IntArray, blocks, distinct, median, percentile
from imucal.readers.clocks.period import BLOCK, REACH, Period

#: Samples before and after a step that say where the clock stood; more of them for one that is too many, as
#: a clock that is a little slow falls by a sample now and then and climbs again.
_SAMPLES_AROUND, _CLIMB = 8, 64


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
    for part in blocks(stamps.size - 1, stamps, size=BLOCK):
        start = part.start
        steps = np.diff(stamps[start : start + BLOCK + 1])
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
    at, missing, doubled = [_NONE], [_NONE], [_NONE]
    for start, stop in pairwise([0, *(_NONE if resets is None else resets).tolist(), stamps.size]):
        for first, block, inner in _odd_blocks(stamps[start:stop], period.tau_ns):
            lifts, counts, extra = _breaks(block, inner, period)
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
    for part in blocks(stamps.size, stamps, size=BLOCK):
        first, block = part.start, stamps[part]
        lo, hi = np.searchsorted(starts, [first, first + block.size])
        edges = distinct(np.concatenate([[0], starts[lo:hi] - first]))
        sizes = np.diff(np.append(edges, block.size))
        lo, hi = np.searchsorted(at, [first, first + block.size])
        place = np.arange(block.size, dtype=np.float64)
        if hi > lo:
            skipped = np.zeros(block.size)
            skipped[at[lo:hi] - first] = missing[lo:hi]
            place += np.cumsum(skipped)
        late = (block - block[0]).astype(np.float64)
        late -= tau * place
        _center(place, edges, sizes)
        _center(late, edges, sizes)
        place = _without_outliers(place, late, edges, sizes)
        moment += _dot(place, late)
        weight += _dot(place, place)
        square += _dot(late, late)
        count += block.size - edges.size
    if weight == 0 or count < 1:
        return tau, 0.0
    slope = moment / weight
    return tau + slope, float(np.sqrt(max(square - slope * moment, 0.0) / max(count, 1)))


def _dot(a: FloatArray, b: FloatArray) -> float:
    """Return the scalar product, without the threads that BLAS would start for it."""
    return float(np.einsum("i,i", a, b))


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
    for part in blocks(n, stamps, size=BLOCK):
        start = part.start
        steps = np.diff(stamps[max(start - 1, 0) : start + BLOCK])
        if not steps.size or (steps.min() >= 0.5 * tau and steps.max() <= 1.5 * tau):
            continue
        first, last = max(start - REACH, 0), min(start + BLOCK + REACH, n)
        yield first, stamps[first:last], slice(start - first, min(start + BLOCK, n) - first)


def _breaks(block: IntArray, inner: slice, period: Period) -> tuple[IntArray, IntArray, IntArray]:
    """Return lifts, their sizes and doubled samples of a block, as places in it."""
    tau = period.tau_ns
    steps = np.diff(block)
    odd = np.flatnonzero((steps > 1.5 * tau) | (steps < 0.5 * tau)) + 1
    odd = odd[(odd >= max(inner.start, 1)) & (odd < inner.stop)]
    if not odd.size:
        return _NONE, _NONE, _NONE
    near = min(max(_SAMPLES_AROUND, 2 * period.burst), REACH)
    # Extremes of stamps that jitter make a gap look smaller than it is.
    spread = period.loose or min(3 * period.jitter, 0.3)
    least = 0.5 + period.loose if period.loose else 0.5 - spread / 2
    x = (block - block[0]) / tau
    x -= np.arange(block.size)
    jump = x[odd] - x[odd - 1]
    lifts, jumps = odd[jump > 0], jump[jump > 0]
    before = _extreme(x, np.maximum, near)
    reach = np.minimum(2 * jumps + near, REACH).astype(np.int64)
    rise = _lowest_after(x, lifts, reach) - before[lifts]
    real = rise > least
    size = np.minimum(np.round(jumps[real]), np.round(rise[real] + spread))
    missing = np.maximum(size, 1).astype(np.int64)
    falls = odd[jump < 0]
    if period.loose:
        # A stamp may well be as late as a doubled sample would make it.
        falls = _NONE
    elif falls.size:
        # Without the lifts that stay, x only falls for good at a doubled sample; catching up never takes
        # it below where it was before the pause.
        level = np.zeros(x.size)
        level[lifts[real]] = missing
        x -= np.cumsum(level)
        back = int(min(2 * jumps[~real].max(initial=0.0) + _CLIMB, REACH))
        after = np.maximum(_extreme(x[::-1], np.maximum, _CLIMB)[::-1], x)
        fall = _extreme(x, np.minimum, back)[falls] - after[falls]
        falls = falls[fall > least]
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
