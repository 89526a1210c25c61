"""An axis cut into short windows: the small table that most checks work on instead of the samples."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, IntArray, read_only
from imucal.clock import Segment
from imucal.recording import AxisSeries

#: Length of a window, in s: long against a knock's ringing, short against what one wants to keep.
_LENGTH_S = 0.5
#: Least samples of a window: its variance then has 15 degrees of freedom.
_LEAST = 16
#: Windows wanted of a short log.
_WANTED = 64
#: Samples worked on at a time: they stay in the cache, and a mapped file is never in memory as a whole.
_BLOCK = 1 << 17


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Windows:
    """Statistics of each window of an axis; all arrays have shape (k,), in order of time.

    Attributes
    ----------
    width
        Samples in a window.
    length_s
        Time a window without missing samples spans, in s.
    start
        Index of the first sample.
    time_s
        When that was taken, in s from the first sample of the axis.
    mean, variance
        Of the samples, in U and U².
    step_variance
        Half the mean square of successive differences, in U²: the variance of white noise.
    repeats
        Samples that equal the one before.
    low, high
        Extremes, in U.
    """

    width: int
    length_s: float
    start: IntArray
    time_s: FloatArray
    mean: FloatArray
    variance: FloatArray
    step_variance: FloatArray
    repeats: IntArray
    low: FloatArray
    high: FloatArray

    def __post_init__(self) -> None:
        for name in ("mean", "variance", "step_variance", "low", "high", "time_s"):
            object.__setattr__(self, name, read_only(np.asarray(getattr(self, name), dtype=np.float64)))

    @property
    def size(self) -> int:
        """Number of windows."""
        return self.start.size

    @property
    def end_s(self) -> FloatArray:
        """End of each window, shape (k,), in s."""
        return self.time_s + self.length_s


def cut(series: AxisSeries) -> Windows:
    """Return the windows of an axis without NaN; none where it has less than 16 samples in a row.

    A window never spans a gap longer than a quarter of itself; windows over shorter gaps count as
    whole ones. The last window of a stretch is set to its end, so that no sample is left out: it
    may overlap the one before. O(n), one pass, in blocks.
    """
    width = max(_LEAST, min(round(series.rate_hz * _LENGTH_S), series.n // _WANTED))
    starts = _starts(series.clock.segments, width)
    batches = _batches(starts, max(1, _BLOCK // width))
    columns = [_statistics(series.samples, batch, width) for batch in batches]
    mean, variance, step_variance, repeats, low, high = np.concatenate([np.empty((6, 0)), *columns], axis=1)
    return Windows(
        width=width,
        length_s=width * series.tau0,
        start=starts,
        time_s=_places(series.clock.segments, starts) * series.tau0,
        mean=mean,
        variance=variance,
        step_variance=step_variance,
        repeats=repeats.astype(np.int64),
        low=low,
        high=high,
    )


def _starts(segments: tuple[Segment, ...], width: int) -> IntArray:
    """Return where windows start, keeping clear of long gaps."""
    if not segments:
        return np.zeros(0, dtype=np.int64)
    table = np.array([(s.start, s.stop, s.offset) for s in segments], dtype=np.int64)
    missing = table[1:, 2] - (table[:-1, 2] + table[:-1, 1] - table[:-1, 0])
    breaks = np.flatnonzero(missing > width // 4) + 1
    firsts = table[np.r_[0, breaks], 0]
    stops = table[np.r_[breaks - 1, len(table) - 1], 1]
    starts = [np.zeros(0, dtype=np.int64)]
    for first, stop in zip(firsts.tolist(), stops.tolist(), strict=True):
        if stop - first >= width:
            even = np.arange(first, stop - width + 1, width)
            rest = (stop - first) % width
            starts.append(np.append(even, stop - width) if rest else even)
    return np.concatenate(starts)


def _places(segments: tuple[Segment, ...], index: IntArray) -> FloatArray:
    """Return the places of samples on the clock's grid, from the first sample."""
    if not segments:
        return np.zeros(0)
    starts = np.array([s.start for s in segments])
    shifts = np.array([s.offset - s.start for s in segments])
    shift = shifts[np.searchsorted(starts, index, side="right") - 1]
    places: FloatArray = (index + shift - shifts[0]).astype(np.float64)
    return places


def _batches(starts: IntArray, size: int) -> Iterator[IntArray]:
    for first in range(0, starts.size, size):
        yield starts[first : first + size]


def _statistics(samples: FloatArray, starts: IntArray, width: int) -> FloatArray:
    """Return mean, variance, step variance, repeats, low and high of some windows, shape (6, k)."""
    even = starts.size * width
    block = samples[starts[0] : starts[-1] + width]
    if block.size == even and np.all(np.diff(starts) == width):
        table = np.asarray(block).reshape(starts.size, width)
    else:
        table = np.lib.stride_tricks.sliding_window_view(block, width)[starts - starts[0]]
    # The first sample is taken off before squaring: an offset of 1e6 noise deviations costs no digits.
    mean = table[:, 0] + (table - table[:, :1]).mean(axis=1)
    rest = table - mean[:, None]
    steps = np.diff(table, axis=1)
    return np.stack(
        [
            mean,
            np.einsum("ij,ij->i", rest, rest) / (width - 1),
            np.einsum("ij,ij->i", steps, steps) / (2 * (width - 1)),
            (steps == 0).sum(axis=1),
            table.min(axis=1),
            table.max(axis=1),
        ]
    )
