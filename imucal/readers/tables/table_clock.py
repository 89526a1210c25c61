"""The clock of a table's samples: from its time columns, or from a counter and a rate."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray
from imucal.clock import Clock
from imucal.errors import ChoiceError
from imucal.findings import Finding
from imucal.readers.clocks import ClockReading, clock_from_stamps
from imucal.readers.tables.column_plan import SensorPlan
from imucal.readers.tables.scales import Work
from imucal.readers.tables.stamps import (
    DAY,
    WEEK,
    Numbers,
    date_stamps,
    infer_time_unit,
    rolled,
    to_ns,
    unwrapped,
)
from imucal.readers.tables.timing import TimeChoice
from imucal.recording import Sensor
from imucal.units import TIME_UNITS_NS

#: Share of repeated rows up to which they are samples sent twice; beyond, the sensor is slower than the log.
_SENT_TWICE = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorColumns:
    """The columns of one sensor, as read, shape (n,) each.

    The axes are in the unit of the log; `time` and `log_time` are the columns of the plan's times, empty
    where there are none. Of a `sparse` sensor the rows without any value belong to other sensors.
    """

    plan: SensorPlan
    axes: Sequence[FloatArray]
    time: Sequence[Numbers] = ()
    log_time: Sequence[Numbers] = ()
    temperature: FloatArray | None = None
    sparse: bool = False

    def rows(self, chosen: NDArray[np.bool_] | IntArray) -> "SensorColumns":
        """Return some rows of the columns."""
        return replace(
            self,
            axes=[axis[chosen] for axis in self.axes],
            time=[column[chosen] for column in self.time],
            log_time=[column[chosen] for column in self.log_time],
            temperature=self.temperature[chosen] if self.temperature is not None else None,
        )


def table_clock(work: Work, columns: SensorColumns) -> ClockReading:
    """Return the clock of a sensor's samples from the columns of its times, or from a counter and a rate.

    Raises
    ------
    ChoiceError
        If the unit of the time is open, or there is neither time nor rate.
    DataError
        If no rate can be measured.
    """
    plan, sensor = columns.plan, columns.plan.triad.sensor
    if plan.time is None or plan.time.kind == "counter":
        return _counted_clock(work, columns)
    source = f"column {plan.time.name}"
    stamps = _stamps(work, plan.time, columns.time, sensor)
    log = columns.log_time
    log_ns = _stamps(work, plan.log_time, log, sensor) if plan.log_time and log else None
    # A device's clock may start at zero, which is a stamp like any other.
    shift = 1_000_000_000 if stamps.min() == 0 and stamps[0] == 0 and stamps.any() and log_ns is None else 0
    if shift:
        stamps = stamps + shift
    reading = clock_from_stamps(
        stamps,
        source=source,
        where=work.path,
        log_ns=log_ns,
        rate_hz=work.options.rate_hz,
        repeated=_sent_twice(work, stamps, columns),
    )
    if shift and reading.clock.start_ns is not None:
        reading = replace(reading, clock=replace(reading.clock, start_ns=reading.clock.start_ns - shift))
    work.decide("time", f"{source}, {_time_words(plan.time)}")
    _compare_rates(work, reading.clock.rate_hz)
    return reading


def _sent_twice(work: Work, stamps: IntArray, columns: SensorColumns) -> NDArray[np.bool_] | None:
    """Return which samples are the one before, sent again; None where there are none."""
    still = stamps[1:] == stamps[:-1]
    if not still.any():
        return None
    same = np.zeros(stamps.size, dtype=np.bool_)
    same[1:] = still & _repeats(columns.axes)
    share = float(np.mean(same))
    if share <= _SENT_TWICE:
        return same if share else None
    sensor = columns.plan.triad.sensor
    text = (
        f"{share:.0%} of the rows of the {sensor} repeat the stamp and the values of the row before: "
        "the log was written faster than the sensor was read."
    )
    advice = "Log each sample once: held samples falsify the curve at short averaging times."
    work.findings.append(
        Finding(level="warning", code="held-samples", axis=sensor.short, text=text, advice=advice)
    )
    return None


def _repeats(axes: Sequence[FloatArray]) -> NDArray[np.bool_]:
    """Return which samples, from the second on, have the values of the one before."""
    same: NDArray[np.bool_] = axes[0][1:] == axes[0][:-1]
    for axis in axes[1:]:
        same &= axis[1:] == axis[:-1]
    return same


def _time_words(time: TimeChoice) -> str:
    return {
        "pair": "seconds + nanoseconds",
        "week": "GPS week and time of week",
        "text": "date and time",
    }.get(time.kind, "stamps")


def _compare_rates(work: Work, measured: float) -> None:
    stated = work.rate_hz
    if stated is not None and work.options.rate_hz is None and abs(measured / stated - 1) > 0.02:
        text = f"The log states {stated:g} Hz, its stamps give {measured:.6g} Hz; the stamps are used."
        advice = "Give the sampling rate if the stamps are wrong."
        finding = Finding(level="warning", code="rate-differs", text=text, advice=advice)
        if finding not in work.findings:
            work.findings.append(finding)


def _stamps(work: Work, time: TimeChoice, columns: Sequence[Numbers], sensor: Sensor) -> IntArray:
    """Return the stamps of a time in ns."""
    if time.kind == "text":
        return rolled(cast("IntArray", columns[0]), DAY)
    if time.kind == "pair":
        return to_ns(columns[0], TIME_UNITS_NS["s"]) + to_ns(columns[1], 1)
    if time.kind == "date":
        return date_stamps(columns)
    if time.kind == "week":
        ns = _ns_per_count(work, time, columns[1], sensor)
        tow = to_ns(columns[1], ns)
        weeks = to_ns(columns[0], WEEK)
        # A receiver without a fix leaves the week at zero or at its last value.
        return rolled(tow, WEEK) if bool((weeks == weeks[0]).all()) else weeks + tow
    values = columns[0]
    if values.dtype.kind == "i":
        values, wraps = unwrapped(cast("IntArray", values))
        if wraps:
            text = (
                f"Column {time.name} started again {wraps} times at the end of its range; "
                "it was put in order."
            )
            work.findings.append(Finding(level="info", code="wrapped", text=text))
    return to_ns(values, _ns_per_count(work, time, values, sensor))


def _ns_per_count(work: Work, time: TimeChoice, values: Numbers, sensor: Sensor) -> int:
    if time.ns is not None:
        count = next((name for name, ns in TIME_UNITS_NS.items() if ns == time.ns), f"{time.ns} ns")
        work.decide("time unit", f"{count} for {time.name}, {time.ns_source}")
        return time.ns
    unit, fits = infer_time_unit(values)
    if unit is not None:
        work.decide("time unit", f"{unit} for {time.name}, inferred from its size and its steps")
        return TIME_UNITS_NS[unit]
    steps = np.diff(values[:20_000])
    step = float(np.median(steps)) if steps.size else 0.0
    found = f"column {time.name!r}, the time of the {sensor}, has no unit, and goes on by {step:g} a row"
    if step == 1 and values.dtype.kind == "i" and work.options.rate_hz is not None:
        work.decide("time unit", f"{time.name} counts samples at the given rate")
        return max(1, round(1e9 / work.options.rate_hz))
    units = " and ".join(fits) if fits else "none of s, ms, us and ns for an IMU"
    msg = (
        f"{work.path}: {found}, which fits {units}; "
        f"expected a unit in its name, such as {time.name.strip()}_ms; "
        "name the unit in the header, choose another time column, or give columns without a time and the rate"
    )
    raise ChoiceError(msg)


def _counted_clock(work: Work, columns: SensorColumns) -> ClockReading:
    """Return the clock of samples that have no stamps: by their counter and a rate, or by a rate alone."""
    plan, time = columns.plan, columns.time
    rate, source = work.options.rate_hz, "given rate"
    if rate is None:
        rate, source = work.rate_hz, "rate that the log states"
    if rate is None:
        what = f"only a counter ({plan.time.name})" if plan.time else "no time column"
        msg = (
            f"{work.path}: {what} and no sampling rate for the {plan.triad.sensor}; "
            "expected stamps or a rate; give the sampling rate"
        )
        raise ChoiceError(msg)
    work.decide("time", f"{rate:g} Hz, the {source}")
    if plan.time is not None and time and time[0].dtype.kind == "i":
        counts, _ = unwrapped(cast("IntArray", time[0]))
        steps = np.diff(counts)
        if steps.size and float(np.mean(steps == 1)) >= 0.9:
            reading = clock_from_stamps(
                1_000_000_000 + np.round((counts - counts[0]) * (1e9 / rate)).astype(np.int64),
                source=f"counter {plan.time.name} at the {source}",
                rate_hz=rate,
            )
            return replace(reading, clock=replace(reading.clock, start_ns=None, jitter_s=None))
        text = (
            f"Counter {plan.time.name} counts more than the samples, so it can't show gaps; "
            "the rate alone is used."
        )
        work.findings.append(Finding(level="info", code="counter-unused", text=text))
    return ClockReading(clock=Clock.even(columns.axes[0].size, rate, source=source), order=None, findings=())
