"""Columns of numbers -> Recording: units, stamps, clocks, temperature, and how each was decided."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray
from imucal.errors import ChoiceError, DataError, ReadError
from imucal.findings import Finding
from imucal.readers.clock import ClockReading, clock_from_stamps
from imucal.readers.inference import infer_accel_unit, infer_gyro_unit, sample_of
from imucal.readers.options import ReadOptions
from imucal.readers.plan import SensorPlan
from imucal.readers.signatures import Signature
from imucal.readers.stamps import infer_time_unit, midnight_rolled, to_ns, unwrapped, week_rolled
from imucal.readers.timing import TimeChoice
from imucal.recording import Axis, AxisSeries, Clock, Recording, Sensor, Source, Temperature
from imucal.units import SAMPLE_UNITS, TIME_UNITS_NS, parse_sample_unit

__all__ = ["SensorColumns", "assemble"]

#: A column of counts or values.
Numbers: TypeAlias = NDArray[np.int64] | FloatArray

_AXES: tuple[Axis, ...] = ("x", "y", "z")

#: Temperatures in which electronics work, in degrees Celsius; others are raw counts.
_TEMPERATURES = (-80.0, 200.0)


#: Share of repeated rows up to which they are samples sent twice; beyond, the sensor is slower than the log.
_SENT_TWICE = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorColumns:
    """The columns of one sensor, as read.

    Attributes
    ----------
    plan
        Which columns they are.
    axes
        x, y and z, in the unit of the log; shape (n,) each.
    time, log_time
        The columns of the plan's times; empty where there are none.
    temperature
        The temperature of the same rows, or None.
    sparse
        Whether rows with no value of the sensor belong to other sensors.
    """

    plan: SensorPlan
    axes: tuple[FloatArray, FloatArray, FloatArray]
    time: tuple[Numbers, ...] = ()
    log_time: tuple[Numbers, ...] = ()
    temperature: FloatArray | None = None
    sparse: bool = False


@dataclass(slots=True, kw_only=True)
class _Work:
    """What is known while a recording is put together."""

    path: str
    options: ReadOptions
    signature: Signature | None
    rate_hz: float | None
    decisions: list[tuple[str, str]] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    clocks: dict[tuple[Any, ...], tuple[Clock, IntArray | None]] = field(default_factory=dict)

    def decide(self, what: str, how: str) -> None:
        if (what, how) not in self.decisions:
            self.decisions.append((what, how))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Timed:
    """A sensor's samples with their clock, still in the unit of the log."""

    columns: SensorColumns
    axes: list[FloatArray]
    clock: Clock
    temperature: FloatArray | None


def assemble(
    source: Source,
    sensors: Sequence[SensorColumns],
    options: ReadOptions,
    *,
    signature: Signature | None = None,
    rate_hz: float | None = None,
    findings: Sequence[Finding] = (),
) -> Recording:
    """Put a recording together.

    Parameters
    ----------
    source
        Path, format and the decisions so far.
    sensors
        Columns of the gyroscope, the accelerometer, or both.
    options
        What the user said.
    signature
        The format that the column names show.
    rate_hz
        Sampling rate that the log itself states.
    findings
        What reading has shown so far.

    Raises
    ------
    ChoiceError
        If a unit or the time of the samples is open.
    DataError
        If there are no samples, or no rate.
    """
    work = _Work(path=source.path, options=options, signature=signature, rate_hz=rate_hz)
    work.decisions.extend(source.decisions)
    work.findings.extend(findings)
    timed = [_timed(work, columns) for columns in sensors]
    scales = _scales(work, timed)
    series = []
    for entry in timed:
        scale = scales[entry.columns.plan.triad.sensor]
        for axis, samples in zip(_AXES, entry.axes, strict=True):
            series.append(
                AxisSeries(
                    sensor=entry.columns.plan.triad.sensor,
                    axis=axis,
                    samples=_scaled(samples, scale),
                    clock=entry.clock,
                )
            )
    return Recording(
        source=replace(source, decisions=tuple(work.decisions)),
        series=tuple(series),
        temperature=_temperature(work, timed),
        findings=tuple(work.findings),
    )


def _scaled(samples: FloatArray, scale: float) -> FloatArray:
    """Return samples in SI; in place where they are this reader's own memory."""
    if scale == 1.0:
        return samples
    if samples.flags.writeable:
        np.multiply(samples, scale, out=samples)
        return samples
    return samples * scale


def _timed(work: _Work, columns: SensorColumns) -> _Timed:
    """Drop rows that are none of the sensor's, and read its clock."""
    sensor = columns.plan.triad.sensor
    axes = list(columns.axes)
    time, log_time, temperature = list(columns.time), list(columns.log_time), columns.temperature
    keep = _rows_of_sensor(work, columns)
    if keep is not None:
        axes = [axis[keep] for axis in axes]
        time = [cast("Numbers", column[keep]) for column in time]
        log_time = [cast("Numbers", column[keep]) for column in log_time]
        temperature = temperature[keep] if temperature is not None else None
    if not axes[0].size:
        msg = f"{work.path}: the columns of the {sensor} ({', '.join(columns.plan.triad.headers)}) hold no samples"
        raise DataError(msg)
    key = (columns.plan.time, columns.plan.triad.rows, None if keep is None else keep.tobytes(), axes[0].size)
    if key not in work.clocks:
        reading = _clock(work, columns.plan, axes, time, log_time)
        work.findings.extend(reading.findings)
        work.clocks[key] = (reading.clock, reading.order)
    clock, order = work.clocks[key]
    if order is not None:
        axes = [axis[order] for axis in axes]
        temperature = temperature[order] if temperature is not None else None
    return _Timed(columns=columns, axes=axes, clock=clock, temperature=temperature)


def _rows_of_sensor(work: _Work, columns: SensorColumns) -> NDArray[np.bool_] | None:
    """Return which rows are samples of the sensor; None where all are."""
    keep: NDArray[np.bool_] | None = None
    if columns.sparse:
        keep = ~(np.isnan(columns.axes[0]) & np.isnan(columns.axes[1]) & np.isnan(columns.axes[2]))
    for column in columns.time:
        if column.dtype.kind == "f":
            finite = np.isfinite(column)
            if not finite.all():
                lost = int(np.count_nonzero(~finite if keep is None else keep & ~finite))
                keep = finite if keep is None else keep & finite
                if lost:
                    text = f"{lost} rows have no finite time; they were dropped."
                    work.findings.append(Finding(level="warning", code="bad-rows", text=text))
    return None if keep is None or bool(keep.all()) else keep


def _clock(
    work: _Work, plan: SensorPlan, axes: Sequence[FloatArray], time: Sequence[Numbers], log: Sequence[Numbers]
) -> ClockReading:
    n = axes[0].size
    if plan.time is None or plan.time.kind == "counter":
        return _counted_clock(work, plan, n, time)
    source = f"column {plan.time.name}"
    stamps = _stamps(work, plan.time, time, plan.triad.sensor)
    log_ns = _stamps(work, plan.log_time, log, plan.triad.sensor) if plan.log_time and log else None
    # A device's clock may start at zero, which is a stamp like any other.
    shift = 1_000_000_000 if stamps.min() == 0 and stamps[0] == 0 and stamps.any() and log_ns is None else 0
    stamps = stamps + shift
    same = _sent_twice(work, stamps, axes, plan.triad.sensor)
    try:
        reading = clock_from_stamps(
            stamps, source=source, log_ns=log_ns, rate_hz=work.options.rate_hz, repeated=same
        )
    except DataError as error:
        msg = f"{work.path}: {error}"
        raise DataError(msg) from error
    if shift and reading.clock.start_ns is not None:
        reading = replace(reading, clock=replace(reading.clock, start_ns=reading.clock.start_ns - shift))
    work.decide("time", f"{source}, {_time_words(plan.time)}")
    _compare_rates(work, reading.clock.rate_hz)
    return reading


def _sent_twice(
    work: _Work, stamps: IntArray, axes: Sequence[FloatArray], sensor: Sensor
) -> NDArray[np.bool_] | None:
    """Return which samples are the one before, sent again; None where there are none."""
    still = stamps[1:] == stamps[:-1]
    if not still.any():
        return None
    same = np.zeros(stamps.size, dtype=np.bool_)
    same[1:] = still & _repeats(axes)
    share = float(np.mean(same))
    if share <= _SENT_TWICE:
        return same if share else None
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


def _compare_rates(work: _Work, measured: float) -> None:
    stated = work.rate_hz
    if stated is not None and work.options.rate_hz is None and abs(measured / stated - 1) > 0.02:
        text = f"The log states {stated:g} Hz, its stamps give {measured:.6g} Hz; the stamps are used."
        finding = Finding(
            level="warning",
            code="rate-differs",
            text=text,
            advice="Give the sampling rate if the stamps are wrong.",
        )
        if finding not in work.findings:
            work.findings.append(finding)


def _stamps(work: _Work, time: TimeChoice, columns: Sequence[Numbers], sensor: Sensor) -> IntArray:
    """Return the stamps of a time in ns."""
    if time.kind == "text":
        return midnight_rolled(cast("IntArray", columns[0]))
    if time.kind == "pair":
        return to_ns(columns[0], TIME_UNITS_NS["s"]) + to_ns(columns[1], 1)
    if time.kind == "week":
        ns = _ns_per_count(work, time, columns[1], sensor)
        tow = to_ns(columns[1], ns)
        weeks = to_ns(columns[0], 604_800 * TIME_UNITS_NS["s"])
        # A receiver without a fix leaves the week at zero or at its last value.
        return week_rolled(tow) if bool((weeks == weeks[0]).all()) else weeks + tow
    values = columns[0]
    if values.dtype.kind == "i":
        values, wraps = unwrapped(cast("IntArray", values))
        if wraps:
            text = f"Column {time.name} started again {wraps} times at the end of its range; it was put in order."
            work.findings.append(Finding(level="info", code="wrapped", text=text))
    return to_ns(values, _ns_per_count(work, time, values, sensor))


def _ns_per_count(work: _Work, time: TimeChoice, values: Numbers, sensor: Sensor) -> int:
    if time.ns is not None:
        unit = next((unit for unit, ns in TIME_UNITS_NS.items() if ns == time.ns), f"{time.ns} ns")
        work.decide("time unit", f"{unit} for {time.name}, {time.ns_source}")
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
    fitting = f"which fits {' and '.join(fits)}" if fits else "which fits none of s, ms, us and ns for an IMU"
    msg = (
        f"{work.path}: {found}, {fitting}; expected a unit in its name, such as {time.name.strip()}_ms; "
        "name the unit in the header, choose another time column, or give columns without a time and the sampling rate"
    )
    raise ChoiceError(msg)


def _counted_clock(work: _Work, plan: SensorPlan, n: int, time: Sequence[Numbers]) -> ClockReading:
    """Return the clock of samples that have no stamps: by their counter and a rate, or by a rate alone."""
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
        text = f"Counter {plan.time.name} counts more than the samples, so it can't show gaps; the rate alone is used."
        work.findings.append(Finding(level="info", code="counter-unused", text=text))
    return ClockReading(clock=Clock.even(n, rate, source=source), order=None, findings=())


def _scales(work: _Work, timed: Sequence[_Timed]) -> dict[Sensor, float]:
    """Return SI per unit of the log for each sensor; the accelerometer first, as it tells of the other."""
    scales: dict[Sensor, float] = {}
    accel_unit: str | None = None
    for entry in sorted(timed, key=lambda entry: entry.columns.plan.triad.sensor is Sensor.GYROSCOPE):
        sensor = entry.columns.plan.triad.sensor
        stated = _stated_scale(work, entry)
        if stated is None:
            stated = _inferred_accel(work, entry) if sensor is Sensor.ACCELEROMETER else None
        if stated is None:
            stated = _inferred_gyro(work, entry, accel_unit)
        unit, scales[sensor], reason = stated
        if sensor is Sensor.ACCELEROMETER:
            accel_unit = unit
        work.decide(f"{sensor} unit", f"{unit}, {reason}")
    return scales


def _stated_scale(work: _Work, entry: _Timed) -> tuple[str, float, str] | None:
    """Return unit, scale and reason where the user, the header or the format states the unit."""
    triad = entry.columns.plan.triad
    gyro = triad.sensor is Sensor.GYROSCOPE
    options, signature = work.options, work.signature
    unit = options.gyro_unit if gyro else options.accel_unit
    scale = options.gyro_scale if gyro else options.accel_scale
    if unit is not None and scale is not None:
        msg = f"{work.path}: both a unit ({unit}) and a scale ({scale:g}) are given for the {triad.sensor}; give one"
        raise ChoiceError(msg)
    if scale is not None:
        return "count", scale, f"{scale:g} {triad.sensor.unit} per count as given"
    if unit is not None:
        parsed = parse_sample_unit(unit)
        if parsed is None or parsed[0] is not triad.sensor:
            known = ", ".join(SAMPLE_UNITS[triad.sensor])
            msg = f"{work.path}: {unit!r} is no unit of the {triad.sensor}; expected one of {known}"
            raise ChoiceError(msg)
        return parsed[1], SAMPLE_UNITS[triad.sensor][parsed[1]], "as given"
    if triad.unit is not None:
        return triad.unit, SAMPLE_UNITS[triad.sensor][triad.unit], "from the column header"
    known_unit = None if signature is None else signature.gyro_unit if gyro else signature.accel_unit
    if known_unit is not None and signature is not None:
        return known_unit, SAMPLE_UNITS[triad.sensor][known_unit], f"as {signature.name} logs it"
    return None


def _inferred_accel(work: _Work, entry: _Timed) -> tuple[str, float, str]:
    found = infer_accel_unit(sample_of(entry.axes))
    if found.unit is None:
        known = ", ".join(SAMPLE_UNITS[Sensor.ACCELEROMETER])
        msg = (
            f"{work.path}: the unit of the accelerometer is open: no header says it, and {found.reason}; "
            f"expected one of {known}; give its unit, or the scale of its counts in m/s^2 per count"
        )
        raise ChoiceError(msg)
    scale = found.scale if found.scale is not None else SAMPLE_UNITS[Sensor.ACCELEROMETER][found.unit]
    return found.unit, scale, f"inferred: {found.reason}"


def _inferred_gyro(work: _Work, entry: _Timed, accel_unit: str | None) -> tuple[str, float, str]:
    found = infer_gyro_unit(sample_of(entry.axes), rate_hz=entry.clock.rate_hz, accel_unit=accel_unit)
    if found.unit is None:
        known = ", ".join(SAMPLE_UNITS[Sensor.GYROSCOPE])
        msg = (
            f"{work.path}: the unit of the gyroscope is open: no header says it, and {found.reason}; "
            f"expected one of {known}; give its unit, or the scale of its counts in rad/s per count"
        )
        raise ChoiceError(msg)
    if not found.sure:
        text = f"The unit of the gyroscope is taken to be {found.unit}: {found.reason}."
        advice = "Give its unit if that is wrong: deg/s instead of rad/s changes every result by 57."
        work.findings.append(
            Finding(level="warning", code="unit-assumed", axis="gyro", text=text, advice=advice)
        )
    return found.unit, SAMPLE_UNITS[Sensor.GYROSCOPE][found.unit], f"inferred: {found.reason}"


def _temperature(work: _Work, timed: Sequence[_Timed]) -> Temperature | None:
    """Return the temperature, where its column holds degrees."""
    for entry in timed:
        if entry.temperature is None:
            continue
        values = np.asarray(entry.temperature, dtype=np.float64)
        finite = values[np.isfinite(values)]
        if not finite.size:
            return None
        usual = float(np.median(finite))
        if not _TEMPERATURES[0] <= usual <= _TEMPERATURES[1]:
            work.decide("temperature", f"left out: a median of {usual:.4g} is not in degrees Celsius")
            return None
        return Temperature(samples=values, clock=entry.clock)
    return None


def not_read(path: str, reason: str) -> ReadError:
    """Return the error for a table that can't be read."""
    return ReadError(f"{path}: {reason}")
