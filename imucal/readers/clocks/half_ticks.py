"""Ticks of half a period: jitter moves stamps to the tick before or after.

The steps of one, two and three ticks have no line at the period, but each period has at most one sample.
"""

import numpy as np

from imucal.arrays import IntArray, median
from imucal.readers.clocks.runs import Runs

#: Shortest usual step, in ticks.
_MIN_USUAL_STEP = 2
#: Longest usual step, in ticks: at most half of the samples are lost.
_MAX_USUAL_STEP = 4
#: Least share of steps of one tick, if jitter moves some stamps by a tick.
_MIN_SINGLE = 0.002
#: Most steps of an odd number of ticks per step of one tick: four if half of the samples are lost.
_MAX_ODD = 5
#: Stamps whose periods begin at ticks of the same parity.
_WINDOW = 64
#: Most samples that share a period, per step of one tick: half of them at any other period.
_MAX_SHARED = 0.2


def is_half_a_period(runs: Runs) -> bool:
    """Return whether the resolution of stamps is half a period, and jitter moves stamps by one tick."""
    if not _MIN_USUAL_STEP <= median(runs.steps) / runs.quantum_ns <= _MAX_USUAL_STEP:
        return False
    single = np.mean(runs.steps == runs.quantum_ns)
    odd = np.mean(runs.steps // runs.quantum_ns % 2 == 1)
    if single < _MIN_SINGLE or odd > _MAX_ODD * single:
        return False
    shared = median([_shared(part // runs.quantum_ns) for part in runs.parts])
    return bool(shared < _MAX_SHARED * single)


def _shared(ticks: IntArray) -> float:
    """Return the share of samples in the same period as the previous one."""
    return float(np.min(_shared_by_parity(ticks), axis=0).sum() / ticks.size)


def _shared_by_parity(ticks: IntArray) -> IntArray:
    """Return the number of samples in the same period as the previous one, shape (2, windows).

    Periods begin at even ticks in the first row, at odd ticks in the second.
    """
    at = np.arange(1, ticks.size)
    count = -(-ticks.size // _WINDOW)
    both = []
    for parity in (0, 1):
        same = np.diff((ticks + parity) // 2) == 0
        both.append(np.bincount(at[same] // _WINDOW, minlength=count))
    return np.array(both)


def without_half_ticks(stamps: IntArray, tick: int) -> IntArray:
    """Return stamps in ns, shape (n,), moved to the beginnings of their periods of two ticks."""
    ticks = stamps // tick
    even, odd = _shared_by_parity(ticks)
    # A window without a sample per period in either parity follows the previous one.
    better = np.where(even < odd, 0, np.where(odd < even, 1, -1))
    known = np.maximum.accumulate(np.where(better >= 0, np.arange(better.size), 0))
    parity = np.repeat(np.maximum(better[known], 0), _WINDOW)[: ticks.size]
    moved: IntArray = ((ticks + parity) // 2 * 2 - parity) * tick
    return moved
