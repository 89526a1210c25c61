"""Stamps -> clock: the rate, what is missing, and what the stamps look like.

Samples keep the order of the log: it is the order in which the sensor gave them, while stamps jitter.
The rate comes from `imucal.readers.clocks.rate`, each sample's place on the even grid from
`imucal.readers.clocks.placing`.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import IntArray
from imucal.clock import Clock, Segment
from imucal.errors import DataError
from imucal.findings import Finding
from imucal.readers.clocks.clock_notes import (
    gap_notes,
    jump_notes,
    log_time_note,
    rate_note,
    repeated_note,
    stamp_notes,
    zero_note,
)
from imucal.readers.clocks.placing import NO_BREAKS, Breaks, find_breaks, fit_period, step_statistics
from imucal.readers.clocks.rate import Period, estimate_period

#: Name of the time at which a message was recorded.
LOG_TIME = "log time"

#: Share of zero stamps above which stamps are of no use.
_ZEROS = 0.01
#: A jump forward longer than this, in ns, is the clock being set, not a gap. One day.
_DAY = 86_400 * 10**9
#: More resets of a clock than one in so many samples: the stamps are noise.
_RESETS = 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClockReading:
    """What stamps say.

    Attributes
    ----------
    clock
        The clock of the samples that are kept.
    order
        Samples to keep, in order, shape (clock.n,); None where all are kept as they are.
    findings
        What was seen; `Finding.axis` is None.
    """

    clock: Clock
    order: IntArray | None
    findings: tuple[Finding, ...]


def clock_from_stamps(
    stamps_ns: IntArray,
    *,
    source: str,
    where: str = "",
    log_ns: IntArray | None = None,
    rate_hz: float | None = None,
    repeated: NDArray[np.bool_] | None = None,
) -> ClockReading:
    """Return the clock of samples from their stamps.

    Parameters
    ----------
    stamps_ns
        Shape (n,), int64, in ns, in the order of the log.
    source
        What the stamps are, in words: ``header stamp``, ``log time``, ``column time_us``.
    where
        What stands in front of an error's message, such as the file.
    log_ns
        When each sample was recorded, shape (n,); used where stamps are zero or constant, and to measure
        how far a clock was set.
    rate_hz
        Sampling rate that overrides the measured one.
    repeated
        Samples with the stamp *and* the values of the one before, shape (n,); they are dropped.

    Raises
    ------
    DataError
        If there is no sample, or no rate can be measured and none is given.
    """
    try:
        return _clock(np.ascontiguousarray(stamps_ns, dtype=np.int64), source, log_ns, rate_hz, repeated)
    except DataError as error:
        if not where:
            raise
        msg = f"{where}: {error}"
        raise DataError(msg) from error


def _clock(
    stamps: IntArray,
    source: str,
    log_ns: IntArray | None,
    rate_hz: float | None,
    repeated: NDArray[np.bool_] | None,
) -> ClockReading:
    notes: list[Finding] = []
    if not stamps.size:
        msg = f"no samples to take the {source} of; expected at least two"
        raise DataError(msg)
    order: IntArray | None = None
    if repeated is not None and repeated.any():
        order = np.flatnonzero(~repeated)
        notes.append(repeated_note(stamps.size - order.size, stamps.size))
        stamps = stamps[order]
        log_ns = log_ns[order] if log_ns is not None else None
    stamps, source, period = _advancing(*_usable(stamps, source, log_ns, notes), log_ns, notes)
    if period is None and rate_hz is None:
        less = "one sample" if stamps.size == 1 else f"{stamps.size} samples whose stamps do not advance"
        msg = f"{less} ({source}); expected stamps that give a rate, or the rate itself"
        raise DataError(msg)
    if period is None:
        clock = Clock.even(stamps.size, float(rate_hz or 1.0))
        return ClockReading(clock=clock, order=order, findings=tuple(notes))
    return _read(stamps, source, log_ns, period, rate_hz, order, notes)


def _advancing(
    stamps: IntArray, source: str, log_ns: IntArray | None, notes: list[Finding]
) -> tuple[IntArray, str, Period | None]:
    """Return stamps with their period, those of the log where the others give none."""
    period = estimate_period(stamps)
    if period is None and log_ns is not None and source != LOG_TIME and stamps.size > 1:
        notes.append(log_time_note(f"The stamps ({source}) do not advance"))
        stamps, source = np.ascontiguousarray(log_ns, dtype=np.int64), LOG_TIME
        period = estimate_period(stamps)
    return stamps, source, period


def _usable(
    stamps: IntArray, source: str, log_ns: IntArray | None, notes: list[Finding]
) -> tuple[IntArray, str]:
    """Return stamps that advance: log time instead of zeros or constants, single zeros filled."""
    zeros = int(np.count_nonzero(stamps == 0))
    constant = stamps.size > 1 and bool((stamps == stamps[0]).all())
    if (zeros > _ZEROS * stamps.size or constant) and log_ns is not None:
        what = "are all the same" if constant and not zeros else f"{zeros} of {stamps.size} are zero"
        what = "are all zero" if zeros == stamps.size else what
        notes.append(log_time_note(f"The stamps ({source}) {what}"))
        return np.ascontiguousarray(log_ns, dtype=np.int64), LOG_TIME
    if 0 < zeros <= _ZEROS * stamps.size:
        stamps = _filled(stamps)
        notes.append(zero_note(zeros, stamps.size))
    return stamps, source


def _filled(stamps: IntArray) -> IntArray:
    """Put zero stamps between their neighbours; before the first and after the last, go on evenly."""
    good, bad = np.flatnonzero(stamps), np.flatnonzero(stamps == 0)
    since = stamps[good] - stamps[good[0]]
    step = float(since[-1]) / max(int(good[-1] - good[0]), 1)
    between = np.interp(bad, good, since)
    between += np.minimum(bad - good[0], 0) * step + np.maximum(bad - good[-1], 0) * step
    filled = stamps.copy()
    filled[bad] = stamps[good[0]] + np.round(between).astype(np.int64)
    return filled


def _read(  # noqa: PLR0917 - all that is known of the samples
    stamps: IntArray,
    source: str,
    log_ns: IntArray | None,
    period: Period,
    rate_hz: float | None,
    order: IntArray | None,
    notes: list[Finding],
) -> ClockReading:
    """Place every sample on the grid, twice: the second time with the rate that the first gave."""
    steps = step_statistics(stamps, period.tau_ns)
    resets = steps.resets
    if resets.size > max(1000, stamps.size // _RESETS):
        msg = f"the stamps ({source}) go back {resets.size} times in {stamps.size} samples; expected a clock"
        raise DataError(msg)
    edges = [0, *resets.tolist(), stamps.size]
    breaks = NO_BREAKS
    # The first estimate of the period is good to a percent: gaps of a hundred samples to one.
    for longest in (10,) if steps.even else (10, 1000):
        breaks = breaks if steps.even else _all_breaks(stamps, edges, period)
        tau, jitter = fit_period(stamps, period.tau_ns, breaks, resets, longest=longest)
        if not 0.5 < tau / period.tau_ns < 2:
            tau = period.tau_ns
        period = replace(period, tau_ns=tau)
    missing, jumps = _believable(
        stamps, log_ns if source != LOG_TIME else None, breaks, resets, period.tau_ns
    )
    notes += stamp_notes(steps, stamps.size, breaks, period)
    notes += jump_notes(stamps, jumps)
    segments = _segments(stamps.size, breaks, missing, jumps)
    measured = 1e9 / period.tau_ns
    if rate_hz is not None and abs(measured / rate_hz - 1) > 0.01:
        notes.append(rate_note(rate_hz, measured))
    clock = Clock(
        source=source,
        rate_hz=rate_hz or measured,
        segments=segments,
        start_ns=int(stamps[0]),
        jitter_s=jitter / 1e9,
    )
    notes += gap_notes(clock)
    if breaks.doubled.size:
        kept = np.delete(np.arange(stamps.size), breaks.doubled)
        order = kept if order is None else order[kept]
    return ClockReading(clock=clock, order=order, findings=tuple(notes))


def _all_breaks(stamps: IntArray, edges: list[int], period: Period) -> Breaks:
    """Find breaks in each stretch between two settings of the clock."""
    parts = []
    for first, last in pairwise(edges):
        part = find_breaks(stamps[first:last], period)
        parts.append(replace(part, at=part.at + first, doubled=part.doubled + first))
    return Breaks(
        at=np.concatenate([part.at for part in parts]),
        missing=np.concatenate([part.missing for part in parts]),
        doubled=np.concatenate([part.doubled for part in parts]),
    )


def _believable(
    stamps: IntArray, log_ns: IntArray | None, breaks: Breaks, resets: IntArray, tau: float
) -> tuple[IntArray, dict[int, int]]:
    """Return how many samples each break misses, and sample -> missing for each setting of the clock.

    A clock was set where it goes back, or where it goes ahead by far more than the log time does, or by
    more than a day. How much is missing there only the log time knows; without it one sample is.
    """

    def by_log(at: int) -> int:
        if log_ns is None:
            return 1
        return max(round((int(log_ns[at]) - int(log_ns[at - 1])) / tau) - 1, 1)

    missing = breaks.missing.copy()
    jumps = {at: by_log(at) for at in resets.tolist()}
    typical = 10 * tau * stamps.size
    for index in np.flatnonzero(missing >= 10).tolist():
        at = int(breaks.at[index])
        step = int(stamps[at]) - int(stamps[at - 1])
        if log_ns is not None:
            wrong = by_log(at) < missing[index] / 2 and step > 1e9
        else:
            wrong = step > max(_DAY, typical)
        if wrong:
            missing[index] = jumps[at] = by_log(at)
    return missing, jumps


def _segments(n: int, breaks: Breaks, missing: IntArray, jumps: dict[int, int]) -> tuple[Segment, ...]:
    """Return the runs between breaks, numbered in the samples that are kept."""
    lost = dict(zip(breaks.at.tolist(), missing.tolist(), strict=True)) | jumps
    ends = [*sorted(lost), n]
    stops = (np.array(ends) - np.searchsorted(np.sort(breaks.doubled), ends)).tolist()
    segments, start, offset = [], 0, 0
    for stop, end in zip(stops, ends, strict=True):
        if stop > start:
            segments.append(Segment(start=start, stop=stop, offset=offset))
        offset += stop - start + lost.get(end, 0)
        start = stop
    return tuple(segments)
