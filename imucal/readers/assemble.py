"""Chosen tables -> Recording: rows, clocks, units, temperature, and the reasons of decisions."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.clock import Clock
from imucal.errors import ChoiceError, DataError, ReadError, joined
from imucal.readers.choose import Choice
from imucal.readers.clocks import ClockReading, clock_from_stamps
from imucal.readers.clocks.period import RATES
from imucal.readers.files import refused
from imucal.readers.fixes import GIVE_RATE
from imucal.readers.loaded_rows import HEADER, parts_of, rows_of_sensors
from imucal.readers.messages.definitions import plain_type
from imucal.readers.read_options import ReadOptions
from imucal.readers.scales import Unscaled, find_units
from imucal.readers.sensor_rows import SensorRows
from imucal.readers.table import Log, Request, Table
from imucal.readers.table_clock import table_clock
from imucal.readers.tables.stamps import TimeChoice
from imucal.readers.work import Work
from imucal.recording import AxisSeries, Recording, Sensor, Source, Temperature, span_ns

#: Codes of findings about damage, which strict reading refuses.
DAMAGE = frozenset(
    {"truncated", "unindexed", "crc", "damaged", "index", "compression", "encapsulation", "definition"}
)
#: Usual rate of an IMU, in Hz, with which units are inferred if the rate is unknown.
_USUAL_RATE_HZ = 100.0
#: Allowed distance from the usual rates of IMUs, relative.
_NEAR_RATES = 0.02
#: Lowest operating temperature of electronics, in degrees Celsius; lower values are raw counts.
_COLDEST = -80.0
#: Highest operating temperature of electronics, in degrees Celsius; higher values are raw counts.
_HOTTEST = 200.0
#: The median of temperatures is taken of at least this many values.
_LOOKED_AT = 1_000_000


def assemble(log: Log, choices: Sequence[Choice], options: ReadOptions) -> Recording:
    """Read the chosen tables of a log as one recording.

    Raises ReadError if they can't be read; ChoiceError if a unit or the clock is ambiguous; DataError if
    there are no samples, or no rate.
    """
    work = Work(options=options, findings=[*log.findings])
    for choice in choices:
        _decide(work, choice)
    _report_missing(work, choices)
    parts = [part for choice in choices for part in parts_of(choice)]
    loaded = log.read([part.request for part in parts])
    sensors = rows_of_sensors(work, log, parts, loaded)
    try:
        series, temperature = _in_si(work, log, sensors)
    except ChoiceError as error:
        cut = [ChoiceError(one.text, place=log.name) for one in work.findings if one.code == "truncated"]
        raise joined(log.name, [error, *cut]) from error
    _refuse_other_times(log, choices, series)
    if temperature is None:
        temperature = _other_temperature(work, log, choices[0].table)
    _refuse_damage(work, log)
    return Recording(
        source=_source(work, log, choices),
        series=tuple(one for _, one in series),
        temperature=temperature,
        findings=tuple(dict.fromkeys(work.findings)),
        stamps=tuple(work.stamps),
    )


def _decide(work: Work, choice: Choice) -> None:
    """Add the reasons for a table and its columns."""
    table = choice.table
    if table.is_topic:
        work.decide("topic", f"{table.name}: {choice.how}")
    if frame := table.frame():
        work.decide("frame", frame, value=frame)
    for what, how in choice.plan.decisions:
        work.decide(what, how, value=choice.plan.layout if what == "layout" else "")


def _report_missing(work: Work, choices: Sequence[Choice]) -> None:
    """Add the findings about missing sensors, unless another table contains them."""
    found = {one.triad.sensor.short for choice in choices for one in choice.plan.sensors}
    for finding in chain.from_iterable(choice.plan.findings for choice in choices):
        if len(choices) == 1 or finding.axis not in found:
            work.findings.append(finding)


def _refuse_damage(work: Work, log: Log) -> None:
    """Raise ReadError for a damaged log if strict reading was requested."""
    damage = [finding for finding in work.findings if finding.code in DAMAGE]
    if work.options.strict and damage:
        raise refused(log.name, f"the log is damaged, and strict reading was requested: {damage[0].text}")


def _source(work: Work, log: Log, choices: Sequence[Choice]) -> Source:
    members = [choice.table.name for choice in choices if choice.table.is_member]
    files = [("files", ", ".join(members))] if len(members) > 1 else []
    topics = [choice.table for choice in choices if choice.table.is_topic]
    headers = chain.from_iterable(choice.plan.topics for choice in choices)
    return Source(
        path=log.name,
        format=log.form,
        topics=tuple(table.name for table in topics) or tuple(headers),
        message_types=tuple(table.kind for table in topics),
        decisions=(*files, *work.decisions),
        values=work.values,
        files=log.files(),
    )


def _in_si(
    work: Work, log: Log, sensors: Sequence[SensorRows]
) -> tuple[list[tuple[str, AxisSeries]], Temperature | None]:
    """Return the axes in SI with their clocks, by table, and the temperature.

    Raises ChoiceError with everything that is missing.
    """
    lacking: list[ChoiceError] = []
    readings = _clocks(work, sensors, lacking)
    unscaled = [
        Unscaled(
            sensor=columns.plan.triad.sensor,
            rows=columns.axes,
            clock=reading.clock,
            order=reading.order,
            axes=columns.plan.triad.axes,
            stated=columns.plan.stated,
        )
        for columns, reading in zip(sensors, readings, strict=True)
    ]
    places = {columns.place for columns in sensors}
    place = places.pop() if len(places) == 1 else log.name
    series: list[tuple[str, AxisSeries]] = []
    try:
        _require_usual_rate(work, place, unscaled)
        units = find_units(place, work.options, unscaled, work.findings)
    except ChoiceError as error:
        lacking.append(error)
    if lacking:
        raise joined(log.name, lacking)
    for columns, entry in zip(sensors, unscaled, strict=True):
        unit = units[entry.sensor]
        work.decide(f"{entry.sensor} unit", unit.described(entry.sensor), value=unit.value)
        factor = unit.factor(entry.sensor, entry.clock.rate_hz)
        series += [(columns.table, one) for one in _scaled(entry, factor)]
    series.sort(key=lambda pair: pair[1].sensor is Sensor.ACCELEROMETER)
    for columns, reading in zip(sensors, readings, strict=True):
        if columns.temperature is not None:
            return series, _temperature(work, columns.temperature, reading)
    return series, None


def _clocks(work: Work, sensors: Sequence[SensorRows], lacking: list[ChoiceError]) -> list[ClockReading]:
    """Return the clock of each sensor, shared if time and rows are; ambiguities are added to `lacking`."""
    keys = [(one.table, one.plan.time, one.plan.triad.rows, one.rows_left, one.n) for one in sensors]
    clocks: dict[tuple[Any, ...], ClockReading] = {}
    for columns, key in zip(sensors, keys, strict=True):
        if key in clocks:
            continue
        triad = columns.plan.triad
        if not columns.n:
            names = f"the columns of the {triad.sensor} ({', '.join(triad.headers)})"
            raise refused(columns.place, f"{names} have no samples; expected a row per sample", DataError)
        try:
            reading = table_clock(work, columns)
        except ChoiceError as error:
            lacking.append(error)
            reading = ClockReading(clock=Clock.even(columns.n, _USUAL_RATE_HZ, source=""))
        # Files with equal times share one clock.
        equal = next((one.clock for one in clocks.values() if one.clock == reading.clock), reading.clock)
        clocks[key] = replace(reading, clock=equal)
        if reading.trace is not None:
            work.stamps.append(reading.trace)
        own = columns.is_topic and len({*keys}) > keys.count(key) == 1
        axis = triad.sensor.short if own else None
        work.findings += [replace(finding, axis=axis) for finding in reading.findings]
    return [clocks[key] for key in keys]


def _require_usual_rate(work: Work, place: str, samples: Sequence[Unscaled]) -> None:
    """Raise ChoiceError if a measured rate is not that of an IMU, unless a rate or a time unit is given."""
    if work.options.rate_hz is not None or work.options.time_unit is not None:
        return
    slowest, fastest = RATES
    for clock in (entry.clock for entry in samples):
        usual = slowest * (1 - _NEAR_RATES) <= clock.rate_hz <= fastest * (1 + _NEAR_RATES)
        if clock.jitter_s is not None and not usual:
            raise ChoiceError(
                f"{clock.source} gives {clock.rate_hz:.6g} Hz; expected the rate of an IMU, "
                f"{slowest:g} Hz to {fastest:g} Hz",
                place=place,
                fix=GIVE_RATE,
            )


def _scaled(entry: Unscaled, factor: float) -> list[AxisSeries]:
    """Return the axes of a sensor in SI; the columns as read are scaled in place."""
    series = []
    for axis, values in zip(entry.axes, entry.rows, strict=True):
        samples = _ordered(values, entry.order)
        if factor != 1.0:
            samples *= factor
        series.append(AxisSeries(sensor=entry.sensor, axis=axis, samples=samples, clock=entry.clock))
    return series


def _ordered(values: FloatArray, order: IntArray | None) -> FloatArray:
    return np.ascontiguousarray(values) if order is None else values[order]


def _temperature(work: Work, values: FloatArray, reading: ClockReading) -> Temperature | None:
    """Return a temperature in degrees Celsius; None if the values are in another unit."""
    some = values[:: max(1, values.size // _LOOKED_AT)]
    finite = some[np.isfinite(some)]
    if not finite.size:
        return None
    usual = float(np.median(finite))
    if not _COLDEST <= usual <= _HOTTEST:
        work.decide("temperature", f"left out: a median of {usual:.4g} is not in degrees Celsius")
        return None
    return Temperature(samples=_ordered(values, reading.order), clock=reading.clock)


def _other_temperature(work: Work, log: Log, imu: Table) -> Temperature | None:
    """Read the topic of an IMU's temperature, the only one in its namespace; None if there is none."""
    space = imu.name.rpartition("/")[0]
    found = [
        table
        for table in log.tables
        if plain_type(table.kind) == "sensor_msgs/Temperature"
        and table.count != 0
        and table.name.startswith(space + "/")
    ]
    if len(found) != 1 or not space:
        return None
    (table,) = found
    names = [column.name for column in table.columns]
    with suppress(DataError, ReadError, ValueError):
        stamps, heat = names.index("header.stamp"), names.index("temperature")
        times = [TimeChoice(kind="ns", indices=(at,), name="") for at in (stamps, table.log_time or 0)]
        (data,) = log.read([Request(table=table, samples=(heat,), times=tuple(times))])
        if data.n < 2:
            return None
        log_ns = None if table.log_time is None else data.columns[table.log_time]
        reading = clock_from_stamps(data.columns[stamps], source=HEADER, log_ns=log_ns)
        work.decide("temperature", f"{table.name}: the only one besides the IMU's")
        samples = _ordered(np.asarray(data.columns[heat], np.float64), reading.order)
        return Temperature(samples=samples, clock=reading.clock)
    return None


def _refuse_other_times(
    log: Log, choices: Sequence[Choice], series: Sequence[tuple[str, AxisSeries]]
) -> None:
    """Raise ChoiceError if the files of an app were not recorded at the same time."""
    names = [choice.table.name for choice in choices if choice.table.is_member]
    spans = [span for name in names if (span := span_ns([one for table, one in series if table == name]))]
    if len(spans) > 1 and len(spans) == len(names) and min(end for _, end in spans) < max(spans)[0]:
        apart = f"{' and '.join(names)} were not recorded at the same time"
        raise refused(log.name, f"{apart}; expected one recording; read one file at a time", ChoiceError)
