"""The reading *late*: every sample is in the log, and some stamps are late. The period is the mean step.

If samples arrive in batches, one stamp of each batch belongs to a known sample, its first or its last.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from imucal.arrays import IntArray, median, percentile
from imucal.readers.clocks.period import Period
from imucal.readers.clocks.runs import Runs
from imucal.readers.clocks.wander import wander

#: Longest batch in samples: FIFOs of sensors hold at most 512.
_MAX_BATCH = 512
#: Fewest batches that show a period.
_MIN_BATCHES = 5
#: Most batches between the anchors of a slope.
_MAX_DISTANCE = 64
#: Longest mean step within a batch, in periods: a buffer is delivered faster than it is filled.
_MAX_INNER_STEP = 0.5
#: Least share of steps that end a batch.
_MIN_PAUSES = 1 / 5000
#: Largest share of steps back of samples in batches.
_MAX_BACK = 0.02
#: Larger moves of anchors, in large usual ones, are gaps.
_MAX_RATIO = 5
#: Largest relative correction of a mean step: the fit leaves out gaps that the mean step includes.
_MAX_ERROR = 0.1
#: Largest range of the stamps of a coarse clock about their line, in ticks.
_TICK_RANGE = 1.05
#: Anchors of a batch: its last stamp or its first, and its last sample or its first.
_ANCHORS = ((True, True), (False, False), (False, True))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Anchors:
    """The stamp of a known sample in each batch of a run: times in ns and places, shape (b,) each."""

    times: IntArray
    places: IntArray


def late_reading(runs: Runs) -> Period:
    """Return the period of runs of stamps if no sample is missing."""
    mean = runs.mean_ns
    off = np.abs(runs.steps - median(runs.steps))
    within_a_tick = all(_range(part) <= _TICK_RANGE * runs.quantum_ns for part in runs.parts)
    is_coarse = runs.quantum_ns > 0.5 * mean and np.count_nonzero(runs.steps == 0) > 2 and within_a_tick
    every = [_Anchors(times=part, places=np.arange(part.size)) for part in runs.parts]
    plain = Period(
        tau_ns=mean,
        jitter=1.4826 * median(off) / np.sqrt(2) / mean,
        loose=runs.quantum_ns / mean if is_coarse else 0.0,
        error=_MAX_ERROR,
        wander=_usual_wander(every, mean, runs.quantum_ns, most=np.inf),
    )
    return _of_batches(runs, plain) if _come_in_batches(runs) else plain


def _of_batches(runs: Runs, plain: Period) -> Period:
    """Return the reading with the anchors of least scatter; `plain` if no batches fit."""
    mean = runs.mean_ns
    best = plain
    least = np.inf
    # A batch ends at a longer step than those within it, and than the tick of a coarse clock.
    inner = median(runs.steps[runs.steps < mean])
    pauses = {mean, (inner + mean) / 2, max(mean, 1.5 * runs.quantum_ns)}
    for pause, (last_stamp, last_place) in product(sorted(pauses), _ANCHORS):
        anchors = [_anchors(part, pause, last_stamp=last_stamp, last_place=last_place) for part in runs.parts]
        tau = _slope(anchors) or mean
        sizes = np.concatenate([np.diff(each.places) for each in anchors])
        size = max(round(percentile(sizes, 75)), 2) if sizes.size >= _MIN_BATCHES else np.inf
        if size > _MAX_BATCH or runs.steps[runs.steps <= pause].mean() > _MAX_INNER_STEP * tau:
            continue
        moves = np.abs(np.concatenate([np.diff(each.times) for each in anchors]) / tau - sizes)
        most = _MAX_RATIO * percentile(moves, 80) + runs.quantum_ns / tau + 0.5
        moves = moves[moves <= most]
        scatter = median(moves)
        if scatter < 0.9 * least:
            least = scatter
            best = Period(
                tau_ns=tau,
                burst=int(size),
                pause_ns=pause,
                last_stamp=last_stamp,
                last_place=last_place,
                loose=max(2 * percentile(moves, 90), 1.0),
                free=True,
                error=_MAX_ERROR,
                wander=_usual_wander(anchors, tau, runs.quantum_ns, most=most),
            )
    return best


def _range(stamps: IntArray) -> float:
    """Return the range of stamps about their line, in ns."""
    place = np.arange(stamps.size) - (stamps.size - 1) / 2
    since = (stamps - stamps[0]).astype(np.float64)
    slope = np.einsum("i,i", place, since) / max(np.einsum("i,i", place, place), 1.0)
    return float(np.ptp(since - slope * place))


def _usual_wander(anchors: list[_Anchors], tau: float, tick: int, *, most: float) -> float:
    """Return the median wander of anchors about their places; moves above `most` periods are gaps."""
    wanders = []
    for each in anchors:
        if each.times.size > 1:
            moves = np.diff(each.times) / tau - np.diff(each.places)
            moves[np.abs(moves) > most] = 0.0
            places_per_stamp = float(each.places[-1] - each.places[0]) / (each.places.size - 1)
            wanders.append(wander(np.cumsum(moves), places_per_stamp, _resolution(each, tick) / tau))
    return median(wanders) if wanders else 0.0


def _resolution(anchors: _Anchors, tick: int) -> float:
    """Return the resolution of the times of anchors, in ns.

    If every tick has several samples, the first one after its beginning is late by less than a period.
    """
    is_batch_a_tick = median(np.diff(anchors.times)) <= tick
    samples_per_batch = median(np.diff(anchors.places))
    return tick / samples_per_batch if is_batch_a_tick else tick


def _come_in_batches(runs: Runs) -> bool:
    """Return whether samples come in batches: white jitter would cause as many long steps as short ones."""
    steps, mean = runs.steps, runs.mean_ns
    pauses = np.count_nonzero(steps > 1.5 * mean)
    if pauses < max(3, steps.size * _MIN_PAUSES) or np.mean(steps < 0) > _MAX_BACK:
        return False
    few_usual = np.mean(np.abs(steps / mean - 1) < 0.25) < 0.3
    return bool(percentile(steps, 49) < 0.97 * mean or few_usual)


def batches(stamps: IntArray, pause: float) -> tuple[IntArray, IntArray]:
    """Return the first and the last sample of each batch."""
    cuts = np.flatnonzero(np.abs(np.diff(stamps)) > pause) + 1
    return np.concatenate([[0], cuts]), np.concatenate([cuts, [stamps.size]]) - 1


def _anchors(stamps: IntArray, pause: float, *, last_stamp: bool, last_place: bool) -> _Anchors:
    """Return the anchors of complete batches."""
    first, last = batches(stamps, pause)
    first, last = first[1:-1], last[1:-1]
    return _Anchors(times=stamps[last if last_stamp else first], places=last if last_place else first)


def _slope(anchors: list[_Anchors]) -> float:
    """Return the median period between distant anchors; 0 without any."""
    slopes = []
    for each in anchors:
        far = max(min(each.times.size // 8, _MAX_DISTANCE), 1)
        slopes.append((each.times[far:] - each.times[:-far]) / (each.places[far:] - each.places[:-far]))
    every = np.concatenate(slopes)
    return median(every) if every.size else 0.0
