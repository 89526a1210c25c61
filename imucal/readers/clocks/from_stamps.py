"""Compute a clock from stamps: the rate, missing samples, and findings. Samples keep the order of the log."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import BoolArray, FloatArray, IntArray, median
from imucal.clock import Clock, Segment
from imucal.errors import ChoiceError, DataError, Fix
from imucal.findings import Finding
from imucal.readers.clocks.changes import rate_change
from imucal.readers.clocks.evened import evened
from imucal.readers.clocks.notes import jitter_notes, jump_notes, rate_notes, stamp_notes, tick_notes
from imucal.readers.clocks.period import Period
from imucal.readers.clocks.placing import (
    NO_BREAKS,
    Breaks,
    Steps,
    find_breaks,
    fit_period,
    step_statistics,
)
from imucal.readers.clocks.readings import estimate_period, two_readings
from imucal.readers.clocks.wander import wander
from imucal.readers.fixes import GIVE_RATE, give_rates
from imucal.recording import StampTrace, gap_findings

LOG_TIME = "log time"

#: Share of zero stamps above which log time is used.
_MAX_ZEROS = 0.01
#: Share of samples without a time stamp of their own above which the stamps give no clock: a rate would be by
#: chance.
_MAX_SHARED = 0.5
#: Latest time in ns, in 2116: the difference of two times has 64 bits.
_LATEST = 2**62 - 1
#: Shortest sampling period in ns: half of the unit of the stamps.
_SHORTEST_PERIOD = 0.5
#: Longest sampling period in ns, 11 days: stamps that are further apart are no clock of an IMU.
_LONGEST_PERIOD = 10**15
#: Units of float32 time columns, in ns: s, ms, us, ns.
_FLOAT_UNITS_NS = (10**9, 10**6, 10**3, 1)
#: Samples at which the wander of stamps is examined.
_WANDERING = 4000
#: Fewest missing samples of a pause between trials.
_MIN_PAUSE = 3
#: One day in ns: a longer jump forward means that the clock was set.
_DAY = 86_400 * 10**9
#: Fewest samples per clock reset; with fewer the stamps are noise.
_RESETS = 20
#: Resolution of stamps, in periods, above which a contradicted rate may be any.
_COARSE = 0.3
#: Most samples whose repeated values, or delays, are examined: more do not change the decision.
_MAX_EXAMINED = 100_000
#: Shortest log for a comparison of clocks.
_MIN_DURATION_S = 60.0
#: Smallest reported relative difference of clocks: quartz is better.
_MIN_DRIFT = 5e-4
#: Number of parts of a log of which the extreme stamps are kept for pictures.
_PARTS = 1000


def repeats(stamps: IntArray, rows: Sequence[NDArray[Any]] | FloatArray) -> BoolArray | None:
    """Return which samples repeat the previous stamp and values, shape (n,); None if none was sent twice.

    `stamps` and each of the `rows` have shape (n,). Zero stamps are ignored. Equal values are due to the
    sensor's resolution if they are nearly as frequent between different stamps, or if at most half of the
    samples with equal stamps have them.
    """
    same_stamp = np.flatnonzero((stamps[1:] == stamps[:-1]) & (stamps[1:] != 0)) + 1
    same = same_stamp
    for values in rows:
        same = same[values[same] == values[same - 1]]
    if 2 * same.size <= same_stamp.size:
        return None
    some = [np.diff(column[:_MAX_EXAMINED]) for column in (stamps, *rows)]
    usual = np.all([steps == 0 for steps in some[1:]], axis=0)[some[0] != 0]
    if usual.size and 2 * usual.mean() > same.size / same_stamp.size:
        return None
    repeated = np.zeros(stamps.size, dtype=np.bool_)
    repeated[same] = True
    return repeated


def compare_clocks(stamps: IntArray, log: IntArray) -> list[Finding]:
    """Compare header stamps with log time: delay and relative rate of the clocks."""
    if stamps.size < 2 or np.array_equal(stamps, log) or not log.any():
        return []
    step = max(stamps.size // _MAX_EXAMINED, 1)
    some, recorded = stamps[::step], log[::step]
    delay = (recorded - some) / 1e9
    usual, most = median(delay), float(delay.max())
    text = (
        f"Messages were recorded {usual * 1e3:.4g} ms after their time stamps, at most {most * 1e3:.4g} ms."
    )
    if abs(usual) > 86_400:
        text = f"Time stamps and log time have different origins, {usual:.6g} s apart."
    findings = [Finding("info", "delay", text)]
    own, other = (int(some[-1]) - int(some[0])) / 1e9, (int(recorded[-1]) - int(recorded[0])) / 1e9
    if min(own, other) > _MIN_DURATION_S and abs(own / other - 1) > _MIN_DRIFT:
        ratio = f"{own / other - 1:+.2%}"
        text = f"The time stamps span {own:.6g} s, the log time {other:.6g} s: the clocks differ by {ratio}."
        findings.append(Finding("warning", "clocks-differ", text))
    return findings


def stamp_trace(stamps: IntArray, log: IntArray | None) -> StampTrace:
    """Return the extremes of stamps in ns, and of their difference from log times, both of shape (n,)."""
    places: list[int] = []
    differing: list[int] = []
    edges = np.linspace(1, stamps.size, min(_PARTS, max(stamps.size - 1, 0)) + 1).astype(np.int64)
    for first, stop in zip(edges.tolist(), edges[1:].tolist(), strict=False):
        intervals = np.diff(stamps[first - 1 : stop])
        places += sorted({first + int(intervals.argmin()), first + int(intervals.argmax())})
        if log is not None:
            late = log[first:stop] - stamps[first:stop]
            differing += sorted({first + int(late.argmin()), first + int(late.argmax())})
    index, compared = np.array(places, dtype=np.int64), np.array(differing, dtype=np.int64)
    late_s = (log[compared] - stamps[compared]) / 1e9 if log is not None else np.zeros(0)
    return StampTrace(
        index=index,
        interval_s=(stamps[index] - stamps[index - 1]) / 1e9,
        compared=compared,
        late_s=late_s,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class ClockReading:
    """The clock, the samples to keep and the findings."""

    clock: Clock
    #: Samples to keep, in order, shape (clock.n,); None keeps all.
    order: IntArray | None = None
    #: `Finding.axis` is None.
    findings: tuple[Finding, ...] = ()
    #: The stamps for pictures; None without stamps.
    trace: StampTrace | None = None


def clock_from_stamps(
    stamps_ns: IntArray,
    *,
    source: str,
    where: str = "",
    log_ns: IntArray | None = None,
    rate_hz: float | None = None,
    repeated: BoolArray | None = None,
) -> ClockReading:
    """Return the clock of samples from their stamps in ns, int64, shape (n,), in the order of the log.

    `where` is the place in errors. Log times, shape (n,), replace stamps that are zero, constant or not
    increasing. `rate_hz` overrides the measured rate. `repeated`, shape (n,), marks samples to drop because
    they repeat the previous stamp *and* values.

    Raises DataError without samples or a measurable rate; ChoiceError if the stamps fit two rates or the
    rate changes, and none is given.
    """
    try:
        return _Stamps(stamps_ns, source, log_ns).read(rate_hz, repeated)
    except (ChoiceError, DataError) as error:
        if not where:
            raise
        raise error.within(where) from error


class _Stamps:
    def __init__(self, stamps: IntArray, source: str, log_ns: IntArray | None) -> None:
        self.stamps = np.ascontiguousarray(stamps, dtype=np.int64)
        self.source = source
        self.log_ns = log_ns
        self.order: IntArray | None = None
        self.notes: list[Finding] = []

    def read(self, rate_hz: float | None, repeated: BoolArray | None) -> ClockReading:
        if not self.stamps.size:
            raise DataError(f"no samples to take the {self.source} of; expected at least two")
        if repeated is not None and repeated.any():
            twice = np.count_nonzero(repeated)
            text = f"{twice} of {self.stamps.size} samples repeat the previous time stamp and values"
            self.notes.append(Finding("warning", "duplicate-stamps", f"{text}; they are dropped."))
            self._keep(np.flatnonzero(~repeated))
        self._replace_impossible()
        self._replace_zeros()
        self._keep_one_rate(rate_hz)
        period = estimate_period(self.stamps, rate_hz)
        if period is None and self.log_ns is not None and self.source != LOG_TIME and self.stamps.size > 1:
            self._use(self.log_ns, "do not increase")
            self._keep_one_rate(rate_hz)
            period = estimate_period(self.stamps, rate_hz)
        n = self.stamps.size
        if period is not None:
            clock = self._clock(period, rate_hz)
        elif rate_hz is not None:
            clock = Clock.even(n, float(rate_hz))
        else:
            raise self._not_increasing(n)
        return ClockReading(clock=clock, order=self.order, findings=tuple(self.notes))

    def _not_increasing(self, n: int) -> DataError:
        less = "one sample" if n == 1 else f"{n} samples whose time stamps do not increase"
        return DataError(f"{less} ({self.source}); expected increasing time stamps", fix=GIVE_RATE)

    def _keep(self, places: IntArray) -> None:
        """Keep samples and their stamps."""
        self._keep_samples(places)
        self.stamps = self.stamps[places]
        self.log_ns = self.log_ns[places] if self.log_ns is not None else None

    def _keep_samples(self, places: IntArray) -> None:
        self.order = places if self.order is None else self.order[places]

    def _keep_one_rate(self, rate_hz: float | None) -> None:
        """Keep the part with the given rate; raises ChoiceError if the rate changes and none is given."""
        while (change := rate_change(self.stamps)) is not None:
            n = self.stamps.size
            before, after = change.rates_hz
            seconds = (int(self.stamps[change.end]) - int(self.stamps[0])) / 1e9
            rates = f"from {before:.5g} Hz to {after:.5g} Hz"
            if rate_hz is None:
                raise ChoiceError(
                    f"the sampling rate changes {rates} at about {seconds:.6g} s; perhaps two sensors share "
                    "one name; expected one rate",
                    fixes=give_rates(before, after),
                )
            is_first = abs(np.log(before / rate_hz)) < abs(np.log(after / rate_hz))
            first, last = (0, change.end) if is_first else (change.start, n)
            rate, other = (before, after) if is_first else (after, before)
            text = (
                f"The sampling rate changes {rates} at about {seconds:.6g} s. Samples {first} to {last - 1} "
                f"of {n} are used, at {rate:.5g} Hz; the others are left out."
            )
            advice = (
                f"To read the other part, give its rate, {other:.5g} Hz. Perhaps two sensors share one name."
            )
            self.notes.append(Finding("warning", "rate-changes", text, advice))
            self._keep(np.arange(first, last))

    def _replace_impossible(self) -> None:
        """Replace stamps that are no times by zeros, so that the difference of two stamps has 64 bits."""
        impossible = (self.stamps < -_LATEST) | (self.stamps > _LATEST)
        if impossible.any():
            self.stamps = np.where(impossible, 0, self.stamps)
            text = (
                f"{np.count_nonzero(impossible)} of {self.stamps.size} time stamps ({self.source}) are more "
                "than 146 years from 1970; they are taken as zero."
            )
            self.notes.append(Finding("warning", "zero-stamps", text))

    def _replace_zeros(self) -> None:
        """Use log time if stamps are constant or often zero; interpolate a few zeros."""
        stamps, n = self.stamps, self.stamps.size
        zeros = n - int(np.count_nonzero(stamps))
        if 0 < zeros < n and not stamps[:zeros].any() and 2 * int(stamps[zeros]) <= int(stamps[-1]):
            # A device's clock may start at zero.
            return
        constant = n > 1 and bool(np.all(stamps == stamps[0]))
        if (zeros > _MAX_ZEROS * n or constant) and self.log_ns is not None:
            what = "are all the same" if constant and not zeros else f"{zeros} of {n} are zero"
            self._use(self.log_ns, "are all zero" if zeros == n else what)
        elif 0 < zeros <= _MAX_ZEROS * n:
            self.stamps = _filled(stamps)
            text = f"{zeros} of {n} time stamps are zero; they are interpolated."
            self.notes.append(Finding("info", "zero-stamps", text))

    def _use(self, log_ns: IntArray, why: str) -> None:
        text = f"The time stamps ({self.source}) {why}; the recording time of the messages is used instead."
        advice = "The recording time includes delays of the computer; let the driver stamp the messages."
        self.notes.append(Finding("warning", "log-time-used", text, advice))
        self.stamps, self.source = np.ascontiguousarray(log_ns, dtype=np.int64), LOG_TIME

    def _clock(self, period: Period, rate_hz: float | None) -> Clock:
        """Place the samples on an even grid, in two passes: the first refines the period."""
        stamps, notes = self.stamps, self.notes
        if not _SHORTEST_PERIOD <= period.tau_ns <= _LONGEST_PERIOD:
            apart = f"{period.tau_ns / 1e9:.3g} s apart"
            raise DataError(
                f"the time stamps ({self.source}) are {apart}; expected an IMU's clock, check its unit"
            )
        steps = step_statistics(stamps, period.tau_ns)
        resets = steps.resets
        if resets.size > max(1000, stamps.size // _RESETS):
            times = f"{resets.size} times in {stamps.size} samples"
            raise DataError(f"the time stamps ({self.source}) go back {times}; expected a clock")
        stamps = evened(stamps, period)
        period, breaks, jitter = self._fitted(stamps, period, steps, rate_hz)
        if not period.tau_ns > 0:
            raise self._not_increasing(stamps.size)
        if breaks.doubled.size > _MAX_SHARED * stamps.size:
            return self._clock_of_rate(rate_hz)
        log_ns = self.log_ns if self.source != LOG_TIME else None
        missing, jumps = _believable(stamps, log_ns, breaks, resets, period.tau_ns)
        notes += stamp_notes(steps, stamps.size, breaks, period)
        uneven = jitter_notes(period, jitter, stamps.size)
        if not uneven and rate_hz is None:
            uneven = tick_notes(
                period,
                stamps.size,
                _missing_singly(breaks),
                same=steps.same,
                doubled=int(breaks.doubled.size),
            )
        notes += uneven
        notes += jump_notes(stamps, jumps)
        measured = 1e9 / period.tau_ns
        notes += rate_notes(measured, rate_hz)
        clock = Clock(
            source=self.source,
            rate_hz=rate_hz or measured,
            segments=_segments(stamps.size, breaks, missing, jumps),
            start_ns=int(self.stamps[0]),
            jitter_s=jitter / 1e9,
        )
        notes += gap_findings([clock])
        if breaks.doubled.size:
            self._keep_samples(np.delete(np.arange(stamps.size), breaks.doubled))
        return clock

    @staticmethod
    def _fitted(
        stamps: IntArray, period: Period, steps: Steps, rate_hz: float | None
    ) -> tuple[Period, Breaks, float]:
        """Return the fitted period, the missing samples, and the jitter in ns.

        Raises ChoiceError if the fit contradicts the reading of the stamps and no rate is given.
        """
        breaks = NO_BREAKS
        is_contradicted = False
        jitter = 0.0
        # The first estimate has an error of 1 %, so only short gaps have reliable counts.
        for longest in (0, 0) if period.free else (10,) if steps.even else (10, 1000):
            breaks = breaks if steps.even else find_breaks(stamps, period, steps.resets)
            tau, jitter = fit_period(stamps, period.tau_ns, breaks, steps.resets, longest=longest)
            correction = abs(tau / period.tau_ns - 1)
            if period.coherent:
                # Some places are wrong, so the measured jitter would be too large.
                jitter = period.jitter * period.tau_ns
            elif correction > period.error and (period.resolution_ns > _COARSE * tau or steps.same):
                is_contradicted = True
            elif correction > period.error and rate_hz is None:
                slow, fast = max(tau, period.tau_ns), min(tau, period.tau_ns)
                raise two_readings(replace(period, tau_ns=slow), replace(period, tau_ns=fast))
            elif 0.5 < tau / period.tau_ns < 2:
                period = replace(period, tau_ns=tau)
        # No rate explains contradicted stamps, so the mean is used, with a finding.
        wander_of_all = np.inf if is_contradicted else _wander_of(stamps, period, breaks)
        if period.burst > 1 and period.resolution_ns > period.tau_ns:
            # Batches that share a tick are known to a sample, which evened stamps don't show.
            wander_of_all = max(wander_of_all, period.wander)
        return replace(period, wander=wander_of_all), breaks, jitter

    def _clock_of_rate(self, rate_hz: float | None) -> Clock:
        """Return an even clock at the given rate; raises ChoiceError without a rate."""
        stamps, n = self.stamps, self.stamps.size
        changes = int(np.count_nonzero(np.diff(stamps)))
        step_ns = (int(stamps[-1]) - int(stamps[0])) / max(changes, 1)
        found = (
            f"the {n} samples have only {changes + 1} different time stamps ({self.source}), "
            f"{step_ns / 1e9:.4g} s apart"
        )
        way = "save a time stamp per sample"
        if any(_is_spacing(step_ns / unit, float(stamps[-1]) / unit) for unit in _FLOAT_UNITS_NS):
            found += ", which is the resolution of float32"
            way = "save the times as float64"
        if rate_hz is None:
            raise ChoiceError(f"{found}; expected one per sample", fixes=[Fix(way), GIVE_RATE])
        advice = f"{way[0].upper()}{way[1:]}."
        text = f"{found[0].upper()}{found[1:]}; they are ignored, so gaps are not found."
        self.notes.append(Finding("warning", "time-unused", text, advice))
        return Clock.even(n, float(rate_hz), source="given rate")


def _is_spacing(step: float, value: float) -> bool:
    """Return whether a step is the distance of float32 numbers near a value, in the same unit."""
    return abs(step / float(np.spacing(np.float32(value))) - 1) < 0.01


def _filled(stamps: IntArray) -> IntArray:
    bad = np.flatnonzero(stamps == 0)
    starts = bad[np.flatnonzero(np.diff(bad, prepend=-2) > 1)]
    ends = bad[np.flatnonzero(np.diff(bad, append=stamps.size + 1) > 1)]
    first = int(ends[0]) + 1 if starts[0] == 0 else 0
    last = int(starts[-1]) - 1 if ends[-1] == stamps.size - 1 else stamps.size - 1
    good = np.unique(np.concatenate([starts - 1, ends + 1, [first, last]]))
    good = good[(good >= first) & (good <= last)]
    since = stamps[good] - stamps[first]
    step = float(since[-1]) / max(last - first, 1)
    between = np.interp(bad, good, since)
    between += np.minimum(bad - first, 0) * step + np.maximum(bad - last, 0) * step
    filled = stamps.copy()
    filled[bad] = stamps[first] + np.round(between).astype(np.int64)
    return filled


def _missing_singly(breaks: Breaks) -> int:
    """Return the number of missing samples that are not in long gaps."""
    return int(breaks.missing[breaks.missing < _MIN_PAUSE].sum())


def _wander_of(stamps: IntArray, period: Period, breaks: Breaks) -> float:
    """Return the wander of stamps about the placed samples, at some of them."""
    step = max(stamps.size // _WANDERING, 1)
    some = np.arange(0, stamps.size, step)
    skipped = np.concatenate([[0], np.cumsum(breaks.missing)])
    gaps = np.searchsorted(breaks.at, some, side="right")
    places = some + skipped[gaps]
    late = (stamps[some] - stamps[0]) / period.tau_ns - places
    if period.free and period.burst == 1:
        # A trial starts at any time.
        pauses = np.searchsorted(breaks.at[breaks.missing >= _MIN_PAUSE], some, side="right")
        moves = np.diff(late, prepend=late[0])
        moves[np.diff(pauses, prepend=pauses[0]) > 0] = 0.0
        late = np.cumsum(moves)
    # Long gaps contain no stamps that wander.
    places_per_stamp = (int(some[-1]) + _missing_singly(breaks)) / max(some.size - 1, 1)
    return wander(late, places_per_stamp, period.resolution_ns / period.tau_ns)


def _believable(
    stamps: IntArray, log_ns: IntArray | None, breaks: Breaks, resets: IntArray, tau: float
) -> tuple[IntArray, dict[int, int]]:
    """Return the number of missing samples at each break, and for each clock jump.

    The clock was set if it goes back, or forward much further than log time; without log time, by more than a
    day and ten times the sampled time.
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
    lost = dict(zip(breaks.at.tolist(), missing.tolist(), strict=True)) | jumps
    ends = [*sorted(lost), n]
    stops = (np.array(ends) - np.searchsorted(np.sort(breaks.doubled), ends)).tolist()
    segments, start, offset = [], 0, 0
    for stop, end in zip(stops, ends, strict=True):
        if stop > start:
            segments.append(Segment(start, stop, offset))
        offset += stop - start + lost.get(end, 0)
        start = stop
    return tuple(segments)
