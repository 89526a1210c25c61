"""The clock of a sensor in a table: from its time columns, or from a counter and a rate."""

from dataclasses import replace

import numpy as np

from imucal.clock import Clock
from imucal.errors import ChoiceError, Fix
from imucal.findings import Finding
from imucal.readers.clocks import LOG_TIME, ClockReading, clock_from_stamps, compare_clocks, stamp_trace
from imucal.readers.files import refused
from imucal.readers.fixes import GIVE_RATE, NAME_TIME, TIME_UNIT
from imucal.readers.repeated_rows import sent_twice
from imucal.readers.sensor_rows import SensorRows
from imucal.readers.table_stamps import SECOND, stamps_of
from imucal.readers.tables.stamps import unwrapped
from imucal.readers.work import Work
from imucal.units import LONG_TIME_UNITS_NS, TIME_UNITS_NS, time_unit_ns

#: Least share of steps of one for a counter to count samples.
_MIN_SINGLE_STEPS = 0.9


def table_clock(work: Work, columns: SensorRows) -> ClockReading:
    """Return the clock of a sensor's samples from its time columns, or from a counter and a rate.

    Raises ChoiceError if the time is ambiguous or missing; DataError if it gives no rate.
    """
    plan, unit = columns.plan, work.options.time_unit
    if plan.time is None or (plan.time.kind == "counter" and unit is None):
        return _counted_clock(work, columns)
    if unit is not None and time_unit_ns(unit) is None:
        known = ", ".join(TIME_UNITS_NS | LONG_TIME_UNITS_NS) + ", or a number of them such as 100ns"
        text = f"{unit!r} is not a time unit; expected one of {known}"
        raise refused(columns.place, text, ChoiceError, TIME_UNIT)
    if unit is not None and plan.time.kind not in {"stamp", "counter"}:
        has = f"the {plan.triad.sensor} has the time {plan.time.name}, {plan.time.words}"
        text = f"the time unit {unit} does not apply: {has}"
        raise refused(columns.place, text, ChoiceError, Fix("omit it"), NAME_TIME)
    source = columns.source or f"column {plan.time.name}"
    sensor = plan.triad.sensor
    stamps = stamps_of(work, columns.place, plan.time, columns.time, sensor)
    log = stamps_of(work, columns.place, plan.log_time, columns.log_time, sensor)
    stamps, source = (log, LOG_TIME) if stamps is None else (stamps, source)
    if stamps is None:
        return _counted_clock(work, replace(columns, plan=replace(plan, time=None)))
    reading = clock_from_stamps(
        stamps,
        source=source,
        where=columns.place,
        log_ns=log,
        rate_hz=work.options.rate_hz,
        repeated=sent_twice(work, stamps, columns),
    )
    if log is not None and reading.clock.source == source:
        reading = replace(reading, findings=(*reading.findings, *compare_clocks(stamps, log)))
    reading = replace(reading, trace=stamp_trace(stamps, log if source != LOG_TIME else None))
    work.decide("time", reading.clock.source if columns.source else f"{source}, {plan.time.words}")
    _compare_rates(work, columns.rate_hz, reading.clock.rate_hz)
    return reading


def _compare_rates(work: Work, stated: float | None, measured: float) -> None:
    if stated is not None and work.options.rate_hz is None and abs(measured / stated - 1) > 0.02:
        text = (
            f"The log declares {stated:g} Hz, its time stamps give {measured:.6g} Hz; the time stamps are "
            "used."
        )
        advice = "Give the sampling rate if the time stamps are wrong."
        work.findings.append(Finding("warning", "rate-differs", text, advice))


def _counted_clock(work: Work, columns: SensorRows) -> ClockReading:
    plan = columns.plan
    rate, source = work.options.rate_hz, "given rate"
    if rate is None:
        rate, source = columns.rate_hz, "rate in the log"
    if rate is None:
        what = f"only a counter ({plan.time.name})" if plan.time else "no time column"
        what += f" ({plan.untimed})" if plan.untimed else ""
        sensor = plan.triad.sensor
        lack = f"and no sampling rate for the {sensor}; expected time stamps or a rate"
        raise refused(columns.place, f"{what} {lack}", ChoiceError, GIVE_RATE)
    work.decide("time", f"{rate:g} Hz, the {source}")
    even = ClockReading(clock=Clock.even(columns.n, rate, source=source))
    if plan.time is None or not columns.time or columns.time[0].dtype.kind != "i":
        return even
    counts, _ = unwrapped(columns.time[0].astype(np.int64, copy=False))
    single_steps = int(np.count_nonzero(np.diff(counts) == 1))
    if counts.size < 2 or single_steps < _MIN_SINGLE_STEPS * (counts.size - 1):
        more = f"Counter {plan.time.name} does not count samples, so it can't show gaps"
        work.findings.append(Finding("info", "counter-unused", f"{more}; only the rate is used."))
        return even
    since_first = (counts - counts[0]) * (SECOND / rate)
    reading = clock_from_stamps(
        SECOND + np.round(since_first).astype(np.int64),
        source=f"counter {plan.time.name} at the {source}",
        rate_hz=rate,
    )
    return replace(reading, clock=replace(reading.clock, start_ns=None, jitter_s=None))
