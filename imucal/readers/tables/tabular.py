"""Columns of numbers -> Recording: units, stamps, clocks, temperature, and the reasons of decisions."""

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from hashlib import blake2b
from pathlib import Path
from typing import Any, cast

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray, blocks, release
from imucal.clock import Clock
from imucal.errors import ChoiceError, DataError, Fix, ImucalError, joined
from imucal.findings import Finding
from imucal.frozen import frozen_alone
from imucal.readers.builder import RecordingBuilder
from imucal.readers.clocks import LOG_TIME, ClockReading, clock_from_stamps, compare_clocks, repeats
from imucal.readers.clocks.period import LIKELY_RATES
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.files import refused
from imucal.readers.fixes import COLUMNS, GIVE_RATE, GIVE_TIME_UNIT, NAME_TIME, TIME_UNIT
from imucal.readers.read_options import ReadOptions
from imucal.readers.scales import Unscaled
from imucal.readers.store import Room, count, extremes
from imucal.readers.tables.columns import ColumnsError
from imucal.readers.tables.plan import SensorPlan, TablePlan
from imucal.readers.tables.stamps import (
    Numbers,
    TimeChoice,
    infer_time_unit,
    pair_stamps,
    rates_by_unit,
    text_stamps,
    to_ns,
    typical_step,
    unwrapped,
)
from imucal.recording import Recording, Sensor
from imucal.units import LONG_TIME_UNITS_NS, TIME_UNITS_NS, time_unit_name, time_unit_ns

#: Largest relative difference between the given rate and the rate in a time unit.
_RATE_TOLERANCE = 0.1

_SECOND = 10**9

#: Above any sensor's rate.
_MAX_RATE_HZ = 1e6
#: About 30 years, within 64 bits.
_MAX_TIME_NS = 1e18

#: Usual rate of an IMU, in Hz, with which units are inferred if the rate is unknown.
_USUAL_RATE_HZ = 100.0

#: Above this share of repeated rows, the sensor is slower than the log; below, samples were sent twice.
_MAX_REPEATED = 0.1


@frozen_alone
class SensorColumns:
    """The columns of one sensor as read, shape (n,) each, in units of the log.

    If `sparse`, rows without values belong to other sensors. `rows_left` is a hash of the mask of kept rows,
    empty if all are kept. `table` is a name if the log has several tables. Rows are duplicates if all values
    in `compared` repeat (None: the axes).
    """

    plan: SensorPlan
    axes: Sequence[FloatArray]
    time: Sequence[Numbers] = ()
    log_time: Sequence[Numbers] = ()
    temperature: FloatArray | None = None
    sparse: bool = False
    rows_left: bytes = b""
    table: str = ""
    source: str = ""
    compared: Sequence[FloatArray] | None = None

    def rows(self, keep: BoolArray, room: Room) -> "SensorColumns":
        def kept(columns: Sequence[Any]) -> list[Any]:
            return [room.chosen(column, keep) for column in columns]

        return replace(
            self,
            axes=kept(self.axes),
            time=kept(self.time),
            log_time=kept(self.log_time),
            temperature=None if self.temperature is None else room.chosen(self.temperature, keep),
            compared=None if self.compared is None else kept(self.compared),
        )


def table_clock(work: RecordingBuilder, columns: SensorColumns) -> ClockReading:
    """Return the clock of a sensor's samples from its time columns, or from a counter and a rate.

    Raises ChoiceError if the time is ambiguous or missing; DataError if it gives no rate.
    """
    plan, unit = columns.plan, work.options.time_unit
    if plan.time is None or (plan.time.kind == "counter" and unit is None):
        return _counted_clock(work, columns)
    if unit is not None and time_unit_ns(unit) is None:
        known = ", ".join(TIME_UNITS_NS | LONG_TIME_UNITS_NS) + ", or a number of them such as 100ns"
        text = f"{unit!r} is not a time unit; expected one of {known}"
        raise refused(work.path, text, ChoiceError, TIME_UNIT)
    if unit is not None and plan.time.kind not in {"stamp", "counter"}:
        has = f"the {plan.triad.sensor} has the time {plan.time.name}, {plan.time.words}"
        text = f"the time unit {unit} does not apply: {has}"
        raise refused(work.path, text, ChoiceError, Fix("omit it"), NAME_TIME)
    source = columns.source or f"column {plan.time.name}"
    sensor = plan.triad.sensor
    stamps = stamps_of(work, plan.time, columns.time, sensor)
    log = stamps_of(work, plan.log_time, columns.log_time, sensor)
    stamps, source = (log, LOG_TIME) if stamps is None else (stamps, source)
    if stamps is None:
        return _counted_clock(work, replace(columns, plan=replace(plan, time=None)))
    reading = clock_from_stamps(
        stamps,
        source=source,
        where=f"{work.path}: {columns.table}" if columns.table else work.path,
        log_ns=log,
        rate_hz=work.options.rate_hz,
        repeated=_sent_twice(work, stamps, columns),
        room=work.room,
    )
    if log is not None and reading.clock.source == source:
        reading = replace(reading, findings=(*reading.findings, *compare_clocks(stamps, log)))
    work.decide("time", reading.clock.source if columns.source else f"{source}, {plan.time.words}")
    _compare_rates(work, reading.clock.rate_hz)
    return reading


def _sent_twice(work: RecordingBuilder, stamps: IntArray, columns: SensorColumns) -> BoolArray | None:
    """Return which samples repeat the previous one; None if none do or the sensor is slower than the log."""
    rows = columns.axes if columns.compared is None else columns.compared
    same = repeats(stamps, rows, work.room) if rows else None
    share = count(same) / same.size if same is not None else 0.0
    if share <= _MAX_REPEATED or columns.compared is not None:
        return same
    sensor = columns.plan.triad.sensor
    text = (
        f"{share:.0%} of the rows of the {sensor} repeat the previous time stamp and values: the log was "
        "written faster than the sensor was read."
    )
    advice = "Log each sample once: repeated samples distort the curve at short averaging times."
    work.findings.append(Finding("warning", "held-samples", text, advice, axis=sensor.short))
    return None


def _compare_rates(work: RecordingBuilder, measured: float) -> None:
    stated = work.rate_hz
    if stated is not None and work.options.rate_hz is None and abs(measured / stated - 1) > 0.02:
        text = (
            f"The log declares {stated:g} Hz, its time stamps give {measured:.6g} Hz; the time stamps are "
            "used."
        )
        advice = "Give the sampling rate if the time stamps are wrong."
        work.findings.append(Finding("warning", "rate-differs", text, advice))


def stamps_of(
    work: RecordingBuilder, time: TimeChoice | None, columns: Sequence[Numbers], sensor: Sensor
) -> IntArray | None:
    """Return stamps in ns; None without a time, or if the given rate contradicts the counts in every unit."""
    if time is None:
        return None
    room = work.room
    if time.kind == "ns":
        return cast("IntArray", columns[0])
    if time.kind == "text":
        return text_stamps(cast("Sequence[IntArray]", columns), room)
    if time.kind == "pair":
        return pair_stamps(columns[0], columns[1], time.ns, room, text=time.ns_source.startswith("text"))
    values = columns[0]
    if values.dtype.kind == "i":
        values, wraps = unwrapped(cast("IntArray", values), room)
        if wraps:
            again = f"Column {time.name} started again {wraps} times at the end of its range"
            work.findings.append(Finding("info", "wrapped", f"{again}; it was unwrapped."))
    ns = _ns_per_count(work, time, values, sensor)
    return None if ns is None else to_ns(values, ns, room)


def _ns_per_count(work: RecordingBuilder, time: TimeChoice, values: Numbers, sensor: Sensor) -> int | None:
    """Return ns per count; None if no unit gives the given rate. Raises ChoiceError if it is ambiguous."""
    rate = work.options.rate_hz
    stated_ns, how = time.ns, time.ns_source
    if work.options.time_unit is not None:
        stated_ns, how = time_unit_ns(work.options.time_unit), "as given"
    elif stated_ns is None and rate is not None:
        candidates = time.either_ns or tuple(TIME_UNITS_NS.values())
        stated_ns, how = _ns_of_rate(values, candidates, rate), "from the given rate"
    unclear = bool(time.either_ns or time.unknown_unit)
    fits: tuple[str, ...] = ()
    if stated_ns is None and not unclear:
        unit, fits = infer_time_unit(values)
        stated_ns = TIME_UNITS_NS[unit] if unit is not None else None
        how = "inferred from its size and its steps"
    if stated_ns is not None:
        work.decide("time unit", f"{time_unit_name(stated_ns)} for {time.name}, {how}")
        return stated_ns
    if rate is None and unclear:
        raise _unclear_unit(work.path, time, values, sensor)
    step = typical_step(values)
    if rate is None:
        raise _open_unit(work.path, time, values, fits, sensor)
    if values.dtype.kind == "i" and abs(step - 1) < 1e-3:
        work.decide("time unit", f"{time.name} counts samples at the given rate")
        return max(1, round(_SECOND / rate))
    found = f"Column {time.name} increases by {step:g} per row, which is not {rate:g} Hz in any unit"
    text = f"{found}; it is ignored, so gaps are not found."
    work.findings.append(Finding("warning", "time-unused", text))
    return None


def _ns_of_rate(values: Numbers, candidates: Sequence[int], rate_hz: float) -> int | None:
    """Return the ns per count, of some candidates, with which the counts have a rate; None if none has."""
    step = typical_step(values)
    fits = (ns for ns in candidates if step > 0 and abs(1e9 / (step * ns) / rate_hz - 1) <= _RATE_TOLERANCE)
    return next(fits, None)


def _unclear_unit(path: str, time: TimeChoice, values: Numbers, sensor: Sensor) -> ChoiceError:
    """Return the error for a time with two readings, or with an unknown unit in its name."""
    step = typical_step(values)
    if time.either_ns:
        readings = " or ".join(
            f"{1e9 / (step * ns):.6g} Hz in steps of {time_unit_name(ns)}" for ns in time.either_ns
        )
        problem = f"increases by {step:g} per row, which is {readings}"
    else:
        problem = f"increases by {step:g} per row, and {time.unknown_unit!r} in its name is not a known unit"
    text = f"column {time.name!r}, the time of the {sensor}, {problem}"
    return refused(path, text, ChoiceError, GIVE_TIME_UNIT, GIVE_RATE)


#: Period of the clocks of .NET, FILETIME and Windows' performance counter, in ns.
_TICK_NS = 100


def _with_ticks(proposed: dict[str, float], rates: Mapping[str, float]) -> dict[str, float]:
    """Return units and their rates, first ticks of 100 ns if only they give the usual rate of an IMU."""
    slowest, fastest = LIKELY_RATES
    tick_rate = rates.get("ns", 0.0) / _TICK_NS
    usual = any(slowest < rate <= fastest for rate in proposed.values())
    return (
        proposed if usual or not slowest <= tick_rate <= fastest else {f"{_TICK_NS}ns": tick_rate} | proposed
    )


def _open_unit(
    path: str, time: TimeChoice, values: Numbers, fits: Sequence[str], sensor: Sensor
) -> ChoiceError:
    """Return the error for an ambiguous time unit; each suggestion in it works on this log."""
    low, high = extremes(values)
    span = float(high - low)
    rates = {
        unit: rate
        for unit, rate in rates_by_unit(values).items()
        if rate <= _MAX_RATE_HZ and span * TIME_UNITS_NS[unit] < _MAX_TIME_NS
    }
    likely = fits or sorted(rates, key=lambda unit: abs(np.log10(rates[unit] / 100)))[:2]
    proposed = {unit: rates[unit] for unit in rates if unit in likely}
    if values.dtype.kind == "i":
        proposed = _with_ticks(proposed, rates)
    choices = " or ".join(f"{rate:.6g} Hz in {unit}" for unit, rate in proposed.items())
    name = time.name.strip().strip("\"'")
    fixes = [GIVE_TIME_UNIT, GIVE_RATE] if rates else [NAME_TIME, GIVE_RATE]
    if rates and fits and not name.isdigit():
        fixes.insert(1, Fix(f"name it in the header, such as {name}_{likely[0]}"))
    has = f"the time of the {sensor}, has no unit and increases by {typical_step(values):g} per row"
    which = choices if rates else "not a usual rate in any unit"
    return refused(path, f"column {time.name!r}, {has}, which is {which}", ChoiceError, *fixes)


def _counted_clock(work: RecordingBuilder, columns: SensorColumns) -> ClockReading:
    plan, n = columns.plan, columns.axes[0].size
    rate, source = work.options.rate_hz, "given rate"
    if rate is None:
        rate, source = work.rate_hz, "rate in the log"
    if rate is None:
        what = f"only a counter ({plan.time.name})" if plan.time else "no time column"
        what += f" ({plan.untimed})" if plan.untimed else ""
        sensor = plan.triad.sensor
        lack = f"and no sampling rate for the {sensor}; expected time stamps or a rate"
        raise refused(work.path, f"{what} {lack}", ChoiceError, GIVE_RATE)
    work.decide("time", f"{rate:g} Hz, the {source}")
    even = ClockReading(clock=Clock.even(n, rate, source=source))
    if plan.time is None or not columns.time or columns.time[0].dtype.kind != "i":
        return even
    counts, _ = unwrapped(cast("IntArray", columns.time[0]), work.room)
    rows = blocks(counts.size - 1, counts)
    single = sum(count(np.diff(counts[part.start : part.stop + 1]) == 1) for part in rows)
    if counts.size < 2 or single < 0.9 * (counts.size - 1):
        more = f"Counter {plan.time.name} does not count samples, so it can't show gaps"
        work.findings.append(Finding("info", "counter-unused", f"{more}; only the rate is used."))
        return even
    period, first = _SECOND / rate, int(counts[0])
    reading = clock_from_stamps(
        work.room.made(
            counts.size,
            np.int64,
            lambda part: _SECOND + np.round((counts[part] - first) * period).astype(np.int64),
            counts,
        ),
        source=f"counter {plan.time.name} at the {source}",
        rate_hz=rate,
        room=work.room,
    )
    return replace(reading, clock=replace(reading.clock, start_ns=None, jitter_s=None))


#: Smallest share of samples that repeat the previous one on all axes for them to be dropped.
_MIN_HELD = 0.005
#: Fewest samples that must remain.
_MIN_REMAINING = 64
#: A step that differs from the median by this share is irregular; jitter of usual drivers is smaller.
_IRREGULAR = 0.25
#: Largest share of irregular steps between the remaining samples: some samples are equal by chance.
_BY_CHANCE = 1e-3
#: Ratio of the median steps from which every sample was logged more than once.
_SLOWER = 1.5

#: Most rows with the first time stamp that are left out: headers of loggers have up to 3 such rows. More rows
#: are samples from before the clock was set.
_MAX_FIRST_ROWS = 8
#: Rows after them that must all have different stamps; otherwise the clock is coarse, and they are samples.
_ROWS_BELOW = 1000

#: Operating temperatures of electronics, in degrees Celsius; values outside are raw counts.
_TEMPERATURES = (-80.0, 200.0)
#: The median is taken of at least this many values.
_LOOKED_AT = 1_000_000


def assemble(
    work: RecordingBuilder, plans: Sequence[TablePlan], sensors: Sequence[SensorColumns], *, where: str = ""
) -> None:
    """Add the samples of the sensors to the recording; `where` begins messages about units.

    Raises ChoiceError if a unit or the clock is ambiguous; DataError if there are no samples, or no rate.
    """
    for plan in plans:
        for what, how in plan.decisions:
            work.decide(what, how, value=plan.layout if what == "layout" else "")
    samples = _without_first_rows(work, [_of_sensor(work, columns) for columns in sensors])
    kept = [_without_held(work, columns) for columns in samples]
    lacking: list[ChoiceError] = []
    both = list(zip(kept, _clocks(work, kept, lacking), strict=True))
    try:
        work.add(
            [
                Unscaled(
                    sensor=columns.plan.triad.sensor,
                    rows=columns.axes,
                    clock=reading.clock,
                    order=reading.order,
                    axes=columns.plan.triad.axes,
                    stated=columns.plan.stated,
                )
                for columns, reading in both
            ],
            where=where,
        )
    except ChoiceError as error:
        lacking.append(error)
    if lacking:
        raise joined(work.path, lacking)
    for columns, reading in both:
        if columns.temperature is not None:
            _add_temperature(work, columns.temperature, reading)
            break


def _clocks(
    work: RecordingBuilder, sensors: Sequence[SensorColumns], lacking: list[ChoiceError]
) -> list[ClockReading]:
    """Return the clock of each sensor, shared if time and rows are; ambiguities are added to `lacking`."""
    keys = [
        (one.table, one.plan.time, one.plan.triad.rows, one.rows_left, one.axes[0].size) for one in sensors
    ]
    clocks: dict[tuple[Any, ...], ClockReading] = {}
    for columns, key in zip(sensors, keys, strict=True):
        triad, n = columns.plan.triad, columns.axes[0].size
        if not n:
            names = f"the columns of the {triad.sensor} ({', '.join(triad.headers)})"
            raise refused(work.path, f"{names} have no samples; expected a row per sample", DataError)
        if key not in clocks:
            try:
                clocks[key] = table_clock(work, columns)
            except ChoiceError as error:
                lacking.append(error)
                clocks[key] = ClockReading(clock=Clock.even(n, _USUAL_RATE_HZ, source=""))
            axis = triad.sensor.short if columns.table and len({*keys}) > keys.count(key) == 1 else None
            work.findings += [replace(finding, axis=axis) for finding in clocks[key].findings]
        release(*columns.axes, *columns.time, *columns.log_time)
    return [clocks[key] for key in keys]


def with_more(
    where: str, error: ColumnsError, options: ReadOptions, reading: Callable[[ReadOptions], object]
) -> ChoiceError:
    """Return a ChoiceError for columns and for everything missing after the proposed choice."""
    lacking: list[ChoiceError] = [error]
    proposals = error.example.split(" or ")
    # Otherwise the rest depends on the user's choice of the sensor.
    if error.example and len({tuple(re.findall("[ga][xyz]?=", text)) for text in proposals}) == 1:
        # Errors of the samples are reported when they are read.
        with suppress(ImucalError):
            try:
                reading(replace(options, columns=proposals[0]))
            except ChoiceError as more:
                lacking.append(more)
    return joined(where, lacking)


def refuse_topics(path: Path, options: ReadOptions, what: str) -> None:
    """Raise ChoiceError if topics are given for a table."""
    if options.topics:
        text = f"{what} has no topics such as {', '.join(options.topics)}"
        raise refused(path, f"{text}; expected no topic, or a columns text", ChoiceError, COLUMNS)


def contents_of(
    path: Path,
    form: str,
    found: Recording | ImucalError,
    *,
    size: int | None,
    layout: str = "table",
    compression: str = "",
) -> LogContents:
    """Return a description of a table, from its recording or the reason why it can't be read."""
    topic = TopicContents(name=path.name, type=layout)
    contents = LogContents(path=str(path), format=form, size_bytes=size, compression=compression)
    if isinstance(found, ImucalError):
        return replace(contents, topics=(topic.refused(found),))
    first = found.series[0]
    units = tuple((what, how) for what, how in found.source.decisions if what.endswith("unit"))
    topic = replace(
        topic,
        count=first.n,
        rate_hz=first.rate_hz,
        duration_s=first.duration_s,
        sensors=tuple(dict.fromkeys(series.sensor for series in found.series)),
        note="; ".join(f"{what} {how}" for what, how in units),
        decisions=units,
    )
    return replace(contents, topics=(topic,), start_ns=first.clock.start_ns, duration_s=first.duration_s)


def of_a_part(contents: LogContents) -> LogContents:
    """Return a description made from the start of a table."""
    topics = tuple(replace(topic, count=None, duration_s=None) for topic in contents.topics)
    return replace(contents, topics=topics, duration_s=None)


def _of_sensor(work: RecordingBuilder, columns: SensorColumns) -> SensorColumns:
    room, n, axes = work.room, columns.axes[0].size, columns.axes
    keep = room.made(n, np.bool_, lambda _: True)
    if columns.sparse:
        keep = room.made(n, np.bool_, lambda part: ~np.all([np.isnan(a[part]) for a in axes], axis=0), *axes)
    for column in columns.time:
        if column.dtype.kind == "f":
            before = count(keep)
            for part in blocks(n, column, keep):
                keep[part] &= np.isfinite(column[part])
            if lost := before - count(keep):
                text = f"{lost} rows have no finite time; they were dropped."
                work.findings.append(Finding("warning", "bad-rows", text))
    if count(keep) == n:
        return columns
    return replace(columns.rows(keep, room), rows_left=blake2b(keep.data).digest())


def _without_first_rows(work: RecordingBuilder, sensors: Sequence[SensorColumns]) -> list[SensorColumns]:
    """Drop the first rows if they repeat one time stamp and no other row does.

    PSINS writes rows of initial values and scales, with the time zero, above the samples. At most one of the
    rows can be a sample: the last, if it is like the samples below.
    """
    if any(columns.table or columns.compared is not None for columns in sensors):
        # Messages have no such rows.
        return [*sensors]
    groups: dict[tuple[Any, ...], list[SensorColumns]] = {}
    for columns in sensors:
        groups.setdefault(_rows_of(columns), []).append(columns)
    surplus = {rows: _first_rows(group) for rows, group in groups.items()}
    for rows, first in surplus.items():
        if first:
            text = (
                f"The first rows repeat one time stamp, unlike the others: {first} of them are no samples "
                "and were left out."
            )
            axis = groups[rows][0].plan.triad.sensor.short if len(groups) > 1 else None
            work.findings.append(Finding("info", "first-rows", text, axis=axis))
    return [_from_row(work, columns, surplus[_rows_of(columns)]) for columns in sensors]


def _rows_of(columns: SensorColumns) -> tuple[Any, ...]:
    """Return a key that is equal for sensors with the same rows and time."""
    return columns.plan.time, columns.plan.triad.rows, columns.rows_left, columns.axes[0].size


def _first_rows(sensors: Sequence[SensorColumns]) -> int:
    """Return the number of first rows that are no samples of sensors with the same rows."""
    times = [column[: _MAX_FIRST_ROWS + _ROWS_BELOW] for column in sensors[0].time]
    if not times or times[0].size < _MIN_REMAINING:
        return 0
    repeated = np.all([np.diff(time) == 0 for time in times], axis=0)
    equal_stamps = int(np.argmin(repeated))
    if not 0 < equal_stamps < _MAX_FIRST_ROWS or repeated[equal_stamps:].any():
        return 0
    axes = [axis[equal_stamps : equal_stamps + _ROWS_BELOW] for columns in sensors for axis in columns.axes]
    last_is_sample = not any(_is_far(axis[0], axis[1:]) for axis in axes)
    return equal_stamps if last_is_sample else equal_stamps + 1


def _is_far(value: float, others: FloatArray) -> bool:
    """Return whether a value is further from the range of the others than the range is wide."""
    low, high = float(others.min()), float(others.max())
    return bool(value < 2 * low - high or value > 2 * high - low)


def _from_row(work: RecordingBuilder, columns: SensorColumns, first: int) -> SensorColumns:
    if not first:
        return columns
    keep = work.room.made(columns.axes[0].size, np.bool_, lambda _: True)
    keep[:first] = False
    mask = blake2b(columns.rows_left + keep.tobytes()).digest()
    return replace(columns.rows(keep, work.room), rows_left=mask)


def _without_held(work: RecordingBuilder, columns: SensorColumns) -> SensorColumns:
    """Drop samples that repeat the previous one on all axes, if the others are at least as regular in time.

    A topic or table with two sensors repeats the last sample of the slower one.
    """
    axes, n = columns.axes, columns.axes[0].size
    if len(axes) < 2 or n <= _MIN_REMAINING or work.options.rate_hz is not None:
        return columns
    together = _share_held(axes)
    stamps = _stamps_alone(work, columns) if together else None
    if stamps is None or (1 - together) * n < _MIN_REMAINING:
        return columns

    def is_new(part: slice) -> BoolArray:
        first = max(part.start, 1)
        new = np.ones(part.stop - part.start, np.bool_)
        changed = [axis[first : part.stop] != axis[first - 1 : part.stop - 1] for axis in axes]
        new[first - part.start :] = np.any(changed, axis=0)
        return new

    keep = work.room.made(n, np.bool_, is_new, *axes)
    remaining = count(keep)
    steps, own_steps = np.diff(stamps), np.diff(stamps[keep])
    sent_twice = int(np.count_nonzero((steps == 0) & ~keep[1:]))
    irregular, own_irregular = _irregular(steps), _irregular(own_steps)
    slower = float(np.median(own_steps)) >= _SLOWER * float(np.median(steps))
    # `_sent_twice` drops messages that were recorded twice.
    is_message = columns.compared is not None
    few_sent_twice = sent_twice > 0 and (is_message or sent_twice <= _MAX_REPEATED * n)
    regular = own_irregular <= _BY_CHANCE * remaining
    if few_sent_twice or not regular or not (slower or own_irregular < irregular):
        return columns
    sensor = columns.plan.triad.sensor
    text = (
        f"{n - remaining} of {n} {sensor} samples repeat the previous one on all axes, and the others are "
        "regular in time: the sensor is slower than its log. The repeats were dropped."
    )
    work.findings.append(Finding("info", "held-samples", text, axis=sensor.short))
    mask = blake2b(columns.rows_left + keep.tobytes()).digest()
    return replace(columns.rows(keep, work.room), rows_left=mask)


def _share_held(axes: Sequence[FloatArray]) -> float:
    """Return the share of samples that repeat the previous one on all axes; 0 if chance explains it."""
    some = [np.diff(axis[:_LOOKED_AT]) == 0 for axis in axes]
    shares = [float(repeated.mean()) for repeated in some]
    together, apart = float(np.all(some, axis=0).mean()), float(np.prod(shares))
    # Coarse samples repeat by chance, on each axis alone.
    by_chance = together - apart <= 0.5 * (min(shares) - apart)
    return 0.0 if together < _MIN_HELD or by_chance else together


def _irregular(steps: IntArray) -> int:
    """Return the number of steps that differ from the median."""
    usual = float(np.median(steps))
    return int(np.count_nonzero(np.abs(steps - usual) > _IRREGULAR * usual))


def _stamps_alone(work: RecordingBuilder, columns: SensorColumns) -> IntArray | None:
    """Return the stamps of a sensor in ns without findings; None if it has none, or if they are ambiguous."""
    silent = replace(work, decisions=[], findings=[])
    plan, sensor = columns.plan, columns.plan.triad.sensor
    if plan.time is None or plan.time.kind == "counter":
        return None
    try:
        return stamps_of(silent, plan.time, columns.time, sensor)
    except ChoiceError:
        return None


def _add_temperature(work: RecordingBuilder, column: FloatArray, reading: ClockReading) -> None:
    values = np.asarray(column, dtype=np.float64)
    some = values[:: max(1, values.size // _LOOKED_AT)]
    finite = some[np.isfinite(some)]
    usual = float(np.median(finite)) if finite.size else None
    if usual is not None and _TEMPERATURES[0] <= usual <= _TEMPERATURES[1]:
        work.add_temperature(values, reading.clock, order=reading.order)
    elif usual is not None:
        work.decide("temperature", f"left out: a median of {usual:.4g} is not in degrees Celsius")
