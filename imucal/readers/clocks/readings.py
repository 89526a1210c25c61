"""Choose between two readings of the stamps, *late* and *lost*, or ask.

*Late*: every sample is in the log. *Lost*: steps are whole periods. For most logs the two agree. Otherwise
the stamps decide if only one reading is possible; if both are, the user must give the rate.
"""

from dataclasses import replace

import numpy as np

from imucal.arrays import IntArray, median
from imucal.errors import ChoiceError
from imucal.readers.clocks.late import late_reading
from imucal.readers.clocks.lost import lost_reading
from imucal.readers.clocks.period import LIKELY_RATES, RATES, SAME, Period
from imucal.readers.clocks.runs import Runs, runs_of
from imucal.readers.clocks.ticks import CoarseClock, coarse_clock
from imucal.readers.clocks.wander import MAX_WANDER
from imucal.readers.fixes import give_rates

#: The same if some ticks have two samples: with the tick as the period, these would be dropped.
_SAME_WITH_DOUBLES = 0.001
#: Steps within this share of the usual one are equal to it.
_EQUAL = 0.05
#: Least share of such steps.
_MIN_EQUAL = 0.6
#: Up to this share of lost samples, they are lost one by one.
_MAX_LOST = 0.55
#: Longest step within a batch, in ns: a bus delivers the samples of a buffer faster.
_MAX_BATCH_STEP = 1_500_000
#: Largest usual batch of a buffer, in samples: more may be the samples of a trial.
_MAX_BUFFER = 200
#: Fewest samples of a trial at such a rate.
_MIN_TRIAL = 20
#: Scatter of the batches of a buffer, in batches: pauses between trials scatter more.
_UNEVEN = 0.4
#: Longest step between samples of a trial, in periods.
_MAX_STEP = 4
#: Fewest pauses that show whether they are even.
_MANY_PAUSES = 20
#: Shortest tick that may be taken for a period, in mean steps: up to half of the samples may be lost.
_MIN_TICK = 0.4
#: Longest tick that may be taken for a period, in mean steps.
_MAX_TICK = 1.6
#: A tick that is more likely a clock's than a sensor's period, in ns.
_CLOCK_TICK = 1_000_000


def estimate_period(
    stamps: IntArray, rate_hz: float | None = None, *, unit_is_known: bool = True
) -> Period | None:
    """Return the sampling period of stamps in ns, shape (n,); None if they do not advance.

    Stamps of an unknown unit do not show whether a step is too short for a sensor. Raises ChoiceError if two
    readings are possible and `rate_hz` is not given.
    """
    runs = runs_of(stamps)
    if runs is None:
        return None
    late = late_reading(runs)
    lost = lost_reading(runs)
    chosen = _chosen(late, lost, runs, rate_hz, unit_is_known=unit_is_known)
    if rate_hz is not None and _shows_losses(late, chosen, rate_hz):
        chosen = replace(late, tau_ns=1e9 / rate_hz)
    usual = median(runs.steps)
    equal = np.mean(np.abs(runs.steps - usual) < _EQUAL * usual) > _MIN_EQUAL
    return replace(chosen, resolution_ns=runs.quantum_ns, usual_ns=usual if equal else 0.0)


def _shows_losses(late: Period, chosen: Period, rate_hz: float) -> bool:
    """Return whether losses make the mean rate lower than the given one, which no reading has."""
    is_far = abs(chosen.rate_hz / rate_hz - 1) > SAME
    return is_far and late.wander > MAX_WANDER and late.rate_hz < rate_hz < late.rate_hz / (1 - _MAX_LOST)


def _chosen(
    late: Period, lost: Period | None, runs: Runs, rate_hz: float | None, *, unit_is_known: bool
) -> Period:
    clock = _coarse_clock(late, lost, runs)
    if clock is None and lost is None:
        return late
    if lost is None:
        lost = Period(tau_ns=clock.tick_ns) if clock is not None else late
    share = 1 - lost.tau_ns / late.tau_ns
    if share < SAME and clock is None:
        return lost if lost.free else late
    if clock is not None:
        late, possible = _of_coarse_clock(clock, late, lost)
    elif share <= _MAX_LOST:
        possible = [lost]
    else:
        possible = _of_mostly_lost(late, lost, runs) if unit_is_known else [late, lost]
    if rate_hz is not None:
        nearest = min(late, lost, key=lambda reading: abs(np.log(reading.rate_hz / rate_hz)))
        return replace(nearest, other_ns=0.0)
    if len(possible) > 1:
        raise two_readings(late, lost)
    return possible[0]


def _coarse_clock(late: Period, lost: Period | None, runs: Runs) -> CoarseClock | None:
    """Return the coarse clock of the stamps if its tick is not the period; None if there is none."""
    if lost is not None and lost.half_ticks:
        return None
    quantum = float(runs.quantum_ns)
    usual = lost.tau_ns if lost is not None else quantum
    for unit in (quantum, usual):
        if _MIN_TICK * late.tau_ns < unit < _MAX_TICK * late.tau_ns:
            clock = coarse_clock(runs, unit)
            if clock is None:
                continue
            has_doubles = not clock.single and clock.tick_ns > clock.tau_ns
            least = _SAME_WITH_DOUBLES if has_doubles else SAME
            if _differs(clock.tau_ns, clock.tick_ns, least) and _differs(clock.tau_ns, usual, least):
                return clock
    return None


def _differs(first: float, second: float, least: float = SAME) -> bool:
    return abs(first / second - 1) > least


def _of_coarse_clock(clock: CoarseClock, late: Period, lost: Period) -> tuple[Period, list[Period]]:
    """Return the reading *late* for a coarse clock, and the possible readings."""
    ticks = clock.tick_ns / clock.tau_ns
    if clock.single and ticks < 1:
        read = Period(tau_ns=clock.tau_ns, tick_ns=clock.tick_ns)
    elif _differs(clock.tau_ns, late.tau_ns):
        # The stamps of a sample are spread evenly over a tick.
        read = Period(tau_ns=clock.tau_ns, jitter=ticks / np.sqrt(12), coherent=True)
    else:
        read = late
    if not clock.regular or ticks > 1:
        return read, [read]
    if clock.single and round(clock.tick_ns) == _CLOCK_TICK:
        read = replace(read, other_ns=lost.tau_ns)
        return read, [read]
    return read, [read, lost]


def _of_mostly_lost(late: Period, lost: Period, runs: Runs) -> list[Period]:
    """Return the possible readings if more than half of the samples would be lost."""
    if lost.rate_hz > LIKELY_RATES[1]:
        return [late]
    if late.rate_hz < RATES[0]:
        return [lost]
    if lost.paused:
        if late.rate_hz < LIKELY_RATES[0] or lost.tau_ns > _MAX_BATCH_STEP:
            return [lost]
        is_uneven = late.burst == 1 or late.loose > _UNEVEN * late.burst
        if is_uneven:
            # A few batches with a gap are uneven, too.
            are_many = np.count_nonzero(runs.steps > _MAX_STEP * lost.tau_ns) >= _MANY_PAUSES
            return [lost] if are_many and late.wander > MAX_WANDER else [late, lost]
    is_buffer = 1 < late.burst <= _MAX_BUFFER and late.wander <= MAX_WANDER
    if is_buffer and lost.tau_ns <= _MAX_BATCH_STEP:
        is_long = lost.paused and late.burst >= _MIN_TRIAL
        return [replace(late, other_ns=lost.tau_ns) if is_long else late]
    return [late, lost]


def two_readings(late: Period, lost: Period) -> ChoiceError:
    """Return the error for a log with two possible rates."""
    share = 1 - lost.tau_ns / late.tau_ns
    kind = f"in batches of about {late.burst}" if late.burst > 1 else "with uneven time stamps"
    if late.tick_ns:
        kind = f"on a clock with ticks of {late.tick_ns / 1e6:.4g} ms"
    return ChoiceError(
        f"the time stamps fit two rates: {lost.rate_hz:.6g} Hz with {share:.0%} of the samples missing, or "
        f"{late.rate_hz:.6g} Hz {kind}; expected one",
        fixes=give_rates(lost.rate_hz, late.rate_hz),
    )
