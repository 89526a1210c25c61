"""The raw signal reduced to what a picture can show."""

import numpy as np

from imucal.recording import AxisSeries
from imucal.report.result import Overview


def overview(series: AxisSeries, *, stretches: int = 1000) -> Overview:
    """Return the lowest and highest sample of each of at most `stretches` equal stretches of time.

    A stretch that lies in a gap holds NaN. O(n), no copy of the samples.
    """
    clock = series.clock
    size = clock.grid_size
    if not size:
        empty = np.zeros(0)
        return Overview(time_s=empty, low=empty, high=empty)
    count = min(stretches, size)
    edges = np.linspace(0, size, count + 1).round().astype(np.int64)
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    origin = clock.segments[0].offset
    for segment in clock.segments:
        place = segment.offset - origin
        first = int(np.searchsorted(edges, place, side="right")) - 1
        last = int(np.searchsorted(edges, place + segment.size, side="left"))
        starts = np.maximum(edges[first:last] - place, 0) + segment.start
        samples = series.samples[: segment.stop]
        low[first:last] = np.minimum(low[first:last], np.minimum.reduceat(samples, starts))
        high[first:last] = np.maximum(high[first:last], np.maximum.reduceat(samples, starts))
    filled = np.isfinite(low)
    time = (edges[:-1] + edges[1:]) / 2 * clock.tau0
    return Overview(time_s=time, low=np.where(filled, low, np.nan), high=np.where(filled, high, np.nan))
