"""Where times go back, and which parts of a log must be sorted to put them in order."""

from collections.abc import Iterator

import numpy as np

from imucal.arrays import IntArray
from imucal.mapped import blocks


def steps_back(times: IntArray) -> int:
    """Return how many times are earlier than the one before."""
    return sum(
        int(np.count_nonzero(times[part.start + 1 : part.stop + 1] < times[part]))
        for part in blocks(times.size - 1, times)
    )


def unsorted(times: IntArray) -> Iterator[tuple[int, int]]:
    """Yield the parts (start, stop) that must be sorted, each for itself, so that all times are in order.

    A cut is a place before which nothing is later than anything after it; between two cuts lies a part.
    """
    lowest = [int(times[part].min()) for part in blocks(times.size, times)]
    # The lowest of all times behind each block.
    behind = [*np.minimum.accumulate(lowest[::-1])[::-1].tolist()[1:], np.iinfo(np.int64).max]
    begun, highest = 0, np.iinfo(np.int64).min
    for part, low in zip(blocks(times.size, times), behind, strict=True):
        block = times[part]
        before = np.maximum.accumulate(np.concatenate([[highest], block]))
        after = np.minimum(np.minimum.accumulate(block[::-1])[::-1], low)
        cuts = np.concatenate([[begun], np.flatnonzero(before[:-1] <= after) + part.start])
        long = np.flatnonzero(np.diff(cuts) > 1)
        yield from zip(cuts[long].tolist(), cuts[long + 1].tolist(), strict=True)
        begun, highest = int(cuts[-1]), before[-1]
    if times.size - begun > 1:
        yield begun, times.size
