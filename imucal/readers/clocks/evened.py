"""Replace the stamps of batches and of coarse clocks by the times of sampling."""

import numpy as np

from imucal.arrays import IntArray
from imucal.readers.clocks.half_ticks import without_half_ticks
from imucal.readers.clocks.late import batches
from imucal.readers.clocks.period import Period

#: Stamps in a piece of evened ticks: over more, the period must be known too exactly.
_PIECE = 4096
#: A longer gap, in periods, separates pieces of evened ticks.
_LONG_GAP = 64


def evened(stamps: IntArray, period: Period) -> IntArray:
    """Return stamps in ns, shape (n,), with batches and coarse ticks replaced by the times of sampling."""
    if period.tick_ns:
        return _without_ticks(stamps, period)
    if period.half_ticks:
        return without_half_ticks(stamps, period.resolution_ns)
    if period.burst > 1:
        return _without_batches(stamps, period)
    return stamps


def _without_batches(stamps: IntArray, period: Period) -> IntArray:
    first, last = batches(stamps, period.pause_ns)
    sizes = last - first + 1
    times = stamps[last if period.last_stamp else first]
    places = last if period.last_place else first
    if times.size > 2:
        # Incomplete batches at the ends follow their neighbours, except after a gap.
        for end, near in ((0, 1), (-1, -2)):
            follows = times[near] + round((places[end] - places[near]) * period.tau_ns)
            if abs(follows - times[end]) < 2 * period.burst * period.tau_ns:
                times[end] = follows
    behind = np.arange(stamps.size) - np.repeat(places, sizes)
    return np.asarray(np.repeat(times, sizes) + np.round(behind * period.tau_ns).astype(np.int64))


def _without_ticks(stamps: IntArray, period: Period) -> IntArray:
    """Return stamps on an even grid in each piece, from stamps rounded down to a tick.

    The times of sampling are in a range of phases as wide as a tick, so the widest free range of phases shows
    the phase of the grid.
    """
    tau = period.tau_ns
    gaps = np.flatnonzero(np.abs(np.diff(stamps)) > _LONG_GAP * tau) + 1
    regular = np.arange(_PIECE, stamps.size - _PIECE // 2, _PIECE)
    even = []
    for piece in np.split(stamps, np.unique(np.concatenate([gaps, regular])).tolist()):
        places = (piece - piece[0]) / tau
        phases = np.sort(places % 1.0)
        free = np.diff(phases, append=phases[0] + 1)
        widest = int(np.argmax(free))
        edge = phases[widest] + free[widest] / 2
        even.append(piece[0] + np.round((np.floor(places - edge) + edge + 0.5) * tau))
    return np.concatenate(even).astype(np.int64)
