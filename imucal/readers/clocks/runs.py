"""Runs of stamps that represent a log."""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import IntArray, median

#: Number of runs, spread over the log.
_RUNS = 10
#: Stamps in each run; a log that is shorter than all runs is examined completely.
_RUN = 4096
#: Samples in a mean step: many more than in a batch.
_WINDOW = 512
#: Gaps of a run that a mean step leaves out: a buffer has more pauses.
_FEW_GAPS = 8
#: A gap is this many times longer than the longest other steps.
_GAP_RATIO = 8
#: Steps of which the greatest common divisor is computed.
_EXAMINED = 100_000
#: Largest error of stamps in whole microseconds that went through a float, in ns.
_FLOAT_ERROR_NS = 250


@dataclass(frozen=True, kw_only=True, eq=False)
class Runs:
    """Runs of a log's stamps in ns."""

    parts: tuple[IntArray, ...]
    #: Steps within the runs.
    steps: IntArray
    #: Mean step without gaps; not positive if the stamps do not advance.
    mean_ns: float
    #: Greatest common divisor of the steps.
    quantum_ns: int


def runs_of(stamps: IntArray) -> Runs | None:
    """Return runs of stamps in ns, shape (n,); None if they do not advance."""
    if stamps.size <= _RUNS * _RUN:
        parts = [stamps]
    else:
        starts = np.linspace(0, stamps.size - _RUN, _RUNS).astype(np.int64)
        parts = [stamps[start : start + _RUN] for start in starts.tolist()]
    steps = np.concatenate([np.diff(part) for part in parts])
    if not np.any(steps > 0):
        return None
    mean = _mean_step(parts)
    if not mean > 0:
        return None
    return Runs(parts=tuple(parts), steps=steps, mean_ns=mean, quantum_ns=_quantum(steps))


def _mean_step(parts: list[IntArray]) -> float:
    """Return the median of mean steps in windows."""
    means = []
    for part in parts:
        steps = np.diff(part)
        # Stamps of a damaged log may be so large that a multiple of a step is no integer of 64 bits.
        lengths = np.abs(steps.astype(np.float64))
        longest = np.sort(lengths)[::-1]
        if steps.size > 2 * _FEW_GAPS and longest[0] > _GAP_RATIO * longest[_FEW_GAPS]:
            steps = steps[lengths <= _GAP_RATIO * longest[_FEW_GAPS]]
        ends = np.concatenate([[0], np.cumsum(steps)])
        width = max(min(_WINDOW, steps.size // 8), min(16, steps.size))
        means.append((ends[width:] - ends[:-width]) / width)
    usual = median(np.concatenate(means))
    if usual > 0:
        return usual
    longest_part = max(parts, key=len)
    return float(longest_part[-1] - longest_part[0]) / max(longest_part.size - 1, 1)


def _quantum(steps: IntArray) -> int:
    some = steps[:_EXAMINED]
    whole = 1000 * np.rint(some / 1000).astype(np.int64)
    in_microseconds = whole.any() and np.abs(some - whole).max() <= _FLOAT_ERROR_NS
    return int(np.gcd.reduce(np.abs(whole if in_microseconds else some)))
