"""Each sample's place on the even grid: where samples are missing, doubled, or the clock was set.

With x[k] = t[k]/tau - k, missing samples lift x for good, a doubled sample lowers it for good, and a late
sample lifts it only until the next ones have caught up. So a lift at k counts only where the *lowest* x
among the following samples, as many as could catch up, stays above the *highest* before.
Works block by block; memory does not grow with n.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, IntArray, distinct, median, percentile
from imucal.mapped import blocks
from imucal.readers.clocks.rate import Period

#: Samples worked on at once: what fits the processor's cache.
_BLOCK = 1 << 16
#: Samples that may catch up after a pause, at most.
_REACH = 1 << 13
#: Samples before and after a step that say where the clock stood.
_SAMPLES_AROUND = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Breaks:
    """Where the samples do not follow each other.

    Attributes
    ----------
    at, missing
        Samples before which others are missing, shape (b,), and how many, shape (b,).
    doubled
        Samples that are one too many, shape (d,).
    """

    at: IntArray
    missing: IntArray
    doubled: IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Steps:
    """What the steps from stamp to stamp show.

    Attributes
    ----------
    same, back
        Number of stamps equal to, and earlier than, the one before.
    resets
        Samples at which the clock went back for good, shape (r,).
    even
        Whether every step is between half a period and one and a half.
    """

    same: int
    back: int
    resets: IntArray
    even: bool


def step_statistics(stamps: IntArray, tau: float) -> Steps:
    """Return what all steps of stamps in ns, shape (n,), show.

    A single stamp out of order is no reset: the median of five after it is not below that of five before.
    """
    found = []
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
    resets = np.concatenate(found) if found else np.zeros(0, dtype=np.int64)
    return Steps(same=same, back=back, resets=resets, even=even)


def _resets(stamps: IntArray, at: IntArray) -> IntArray:
    """Return those of the samples `at` from which on the clock stays behind."""
    near = np.arange(5)
    base = stamps[at - 1][:, None]
    before = np.median(stamps[np.maximum(at[:, None] - 5 + near, 0)] - base, axis=1)
    after = np.median(stamps[np.minimum(at[:, None] + near, stamps.size - 1)] - base, axis=1)
    chosen: IntArray = at[after < before]
    return chosen


def find_breaks(stamps: IntArray, period: Period) -> Breaks:
    """Return the missing and doubled samples of stamps in ns, shape (n,), of one clock."""
    spread = (period.burst - 1) if period.burst > 1 else min(3 * period.jitter, 0.3)
    near = min(max(_SAMPLES_AROUND, 2 * period.burst), _REACH)
    at, missing, doubled = [], [], []
    for first, block, inner in _odd_blocks(stamps, period.tau_ns):
        lifts, counts, extra = _breaks(block, inner, period, near, spread)
        at.append(lifts + first)
        missing.append(counts)
        doubled.append(extra + first)
    empty = [np.zeros(0, dtype=np.int64)]
    return Breaks(
        at=np.concatenate(at or empty),
        missing=np.concatenate(missing or empty),
        doubled=np.concatenate(doubled or empty),
    )


#: Nothing is missing.
NO_BREAKS = Breaks(
    at=np.zeros(0, dtype=np.int64), missing=np.zeros(0, dtype=np.int64), doubled=np.zeros(0, dtype=np.int64)
)


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
    whole: _Grid | None = None
    for part in blocks(stamps.size, stamps, size=_BLOCK):
        first, block = part.start, stamps[part]
        lo, hi = np.searchsorted(starts, [first, first + block.size])
        edges = distinct(np.concatenate([[0], starts[lo:hi] - first]))
        sizes = np.diff(np.append(edges, block.size))
        lo, hi = np.searchsorted(at, [first, first + block.size])
        if hi == lo and edges.size == 1 and block.size == _BLOCK:
            # Most blocks are whole: their places are always the same.
            grid = whole = whole or _Grid(np.arange(_BLOCK, dtype=np.float64), tau, edges, sizes)
        else:
            skipped = np.zeros(block.size)
            skipped[at[lo:hi] - first] = missing[lo:hi]
            grid = _Grid(np.cumsum(skipped) + np.arange(block.size, dtype=np.float64), tau, edges, sizes)
        late = (block - block[0]).astype(np.float64)
        late -= grid.times
        _center(late, edges, sizes)
        place = _without_outliers(grid.place, late, edges, sizes)
        moment += _dot(place, late)
        weight += grid.weight if place is grid.place else _dot(place, place)
        square += _dot(late, late)
        count += block.size - edges.size
    if weight == 0 or count < 1:
        return tau, 0.0
    slope = moment / weight
    return tau + slope, float(np.sqrt(max(square - slope * moment, 0.0) / max(count, 1)))


def _dot(a: FloatArray, b: FloatArray) -> float:
    """Return the scalar product, without the threads that BLAS would start for it."""
    return float(np.einsum("i,i", a, b))


class _Grid:
    """The places of a block's samples on the grid, as floats, shape (n,), and the period times each.

    The mean of each run is taken from the places; `weight` is the sum of their squares.
    """

    def __init__(self, place: FloatArray, tau: float, edges: IntArray, sizes: IntArray) -> None:
        self.times = tau * place
        _center(place, edges, sizes)
        self.place = place
        self.weight = _dot(place, place)


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
    nothing = np.zeros(0, dtype=np.int64)
    if not odd.size:
        return nothing, nothing, nothing
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
        return lifts[real], missing, nothing
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
