"""The reading *lost*: steps are whole periods, or pauses separate trials.

The period is the usual short step.
"""

from dataclasses import replace

import numpy as np

from imucal.arrays import FloatArray, IntArray, median, percentile
from imucal.readers.clocks.half_ticks import is_half_a_period
from imucal.readers.clocks.period import Period
from imucal.readers.clocks.runs import Runs

#: Steps within this share of a period are those of one period.
_NEAR = 0.5
#: Least share of the steps that are one period.
_MIN_USUAL = 0.3
#: Above this jitter in periods, steps of one and of two periods overlap.
_MAX_JITTER = 0.12
#: The same if it is due to ticks of a clock.
_MAX_TICK_JITTER = 0.17
#: Resolution of stamps in periods above which most jitter is due to ticks.
_TICKS = 0.3
#: Least relative correction of the period by the fit that contradicts the reading.
_MIN_ERROR = 0.005
#: Least coherence of long steps with the period, relative to that of single steps.
_MIN_COHERENCE_RATIO = 0.35
#: Least length of a pause, in periods.
_MIN_PAUSE = 4
#: Fewest pauses of a log of trials.
_MIN_PAUSES = 3
#: Fewest samples of a trial, on average.
_MIN_TRIAL = 8
#: Above this mean step between pauses, in periods, samples are missing there, too.
_MAX_MEAN_STEP = 1.05
#: Largest relative correction of a period of two ticks.
_HALF_TICK_ERROR = 0.025
#: Stamps in a piece of a spectrum.
_PIECE = 1024
#: Bins of a period in a spectrum.
_BINS = 8
#: Length of a spectrum: the periods of a piece with many losses.
_SPECTRUM = 1 << 16
#: Relative distance of a line from the usual step.
_LINE_RANGE = 0.1
#: Least mean length of the phases' unit vectors at the right period.
_MIN_COHERENCE = 0.1
#: Least power of a line in units of the noise, which is 1 on average: the largest of 10⁴ is about 9.
_MIN_LINE_POWER = 10.0


def lost_reading(runs: Runs) -> Period | None:
    """Return the period of runs of stamps if steps are whole periods, or pauses are rare; None if neither."""
    if is_half_a_period(runs):
        return Period(tau_ns=2.0 * runs.quantum_ns, half_ticks=True, error=_HALF_TICK_ERROR)
    positive = runs.steps[runs.steps > 0].astype(np.float64)
    unit = _usual_step(positive)
    near = positive[np.abs(positive / unit - 1) <= _NEAR]
    jitter = float(near.std() / unit / np.sqrt(2)) if near.size else np.inf
    found = Period(tau_ns=unit, jitter=jitter, error=max(_MIN_ERROR, jitter / 10))
    if unit > runs.mean_ns:
        return found if jitter < _MAX_JITTER else None
    if near.size < _MIN_USUAL * runs.steps.size:
        return None
    is_paused = _has_rare_pauses(runs.steps, unit)
    if is_paused:
        found = replace(found, paused=True, error=max(_MIN_ERROR, jitter / 5))
    # Ticks move stamps by up to a tick, so single and double steps do not overlap.
    most = _MAX_TICK_JITTER if runs.quantum_ns > _TICKS * unit else _MAX_JITTER
    if jitter <= most and _are_whole(positive, near, unit):
        return found
    if is_paused:
        # With large jitter, steps far from the usual one are few, but not symmetric.
        between = float(runs.steps[np.abs(runs.steps) <= _MIN_PAUSE * unit].mean())
        return replace(found, free=True, tau_ns=between if jitter > _MAX_JITTER else unit)
    line = _line(runs, unit) if jitter > _MAX_JITTER else 0.0
    return replace(found, tau_ns=line, coherent=True) if line else None


def _has_rare_pauses(steps: IntArray, unit: float) -> bool:
    """Return whether few steps are pauses, and samples are complete between them."""
    pauses = np.count_nonzero(steps > _MIN_PAUSE * unit)
    if not _MIN_PAUSES <= pauses < steps.size / _MIN_TRIAL:
        return False
    others = steps[np.abs(steps) <= _MIN_PAUSE * unit]
    return bool(others.mean() < _MAX_MEAN_STEP * unit)


def _are_whole(positive: FloatArray, near: FloatArray, unit: float) -> bool:
    """Return whether steps of more than a period are whole periods, nearly as those of one period are."""
    longer = positive[positive > (1 + _NEAR) * unit]
    if not longer.size:
        return False
    coherence = float(np.cos(2 * np.pi * longer / unit).mean())
    single = float(np.cos(2 * np.pi * near / unit).mean())
    return bool(coherence > max(_MIN_COHERENCE_RATIO * single, 3 / np.sqrt(2 * longer.size)))


def _usual_step(positive: FloatArray) -> float:
    """Return the mean of the steps near the shortest usual step, in ns."""
    some = np.sort(positive)
    unit = median(some[some < 2 * percentile(some, 10)])
    sums = np.concatenate([[0.0], np.cumsum(some)])
    for _ in range(50):
        first = np.searchsorted(some, (1 - _NEAR) * unit)
        last = np.searchsorted(some, (1 + _NEAR) * unit, side="right")
        if first == last:
            break
        moved = float(sums[last] - sums[first]) / int(last - first)
        change = abs(moved / unit - 1)
        unit = moved
        if change < 1e-6:
            break
    return unit


def _line(runs: Runs, unit: float) -> float:
    """Return the period near `unit` at which the phases of the stamps agree; 0 if they do not.

    Jitter of s periods reduces the mean of the phases to exp(-(2 pi s)²/2), however many samples are missing.
    """
    power = np.zeros(_SPECTRUM // 2 + 1)
    pieces = 0
    bin_ns = round(unit) / _BINS
    for part in runs.parts:
        size = min(_PIECE, part.size)
        for start in range(0, part.size - size + 1, size):
            piece = part[start : start + size]
            bins = ((piece - piece[0]) / bin_ns).astype(np.int64)
            if bins.min() >= 0 and bins.max() < _SPECTRUM:
                # The mean of the power of incoherent phases is 1.
                power += np.abs(np.fft.rfft(np.bincount(bins), _SPECTRUM)) ** 2 / size
                pieces += 1
    rates = np.arange(power.size) * _BINS / _SPECTRUM
    power[np.abs(rates - 1) > _LINE_RANGE] = 0.0
    best = int(np.argmax(power))
    size = min(_PIECE, runs.parts[0].size)
    least = max(_MIN_COHERENCE**2 * size, 1 + (_MIN_LINE_POWER - 1) / np.sqrt(max(pieces, 1)))
    if not pieces or power[best] < least * pieces:
        return 0.0
    return round(unit) / float(rates[best])
