"""PX4 ULog files, through pyulog: raw IMU samples of the flight controller.

Messages (PX4 message definitions, `msg/`): ``sensor_combined`` (the estimator's choice),
``sensor_gyro`` and ``sensor_accel`` (each sensor), ``sensor_gyro_fifo`` and ``sensor_accel_fifo`` (every
sample of its buffer), ``vehicle_imu`` (integrals, divided by their time here). Times are microseconds
since boot. One instance of a message is named ``sensor_gyro:1``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imucal.errors import ChoiceError, DataError, ReadError
from imucal.findings import Finding
from imucal.readers.builder import RecordingBuilder
from imucal.readers.clocks import ClockReading, clock_from_stamps
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.isolation import isolated
from imucal.readers.read_options import ReadOptions
from imucal.readers.ulog.ulog_content import UlogContent, ulog_content
from imucal.readers.ulog.ulog_messages import MESSAGES, Instance, Samples, samples_of
from imucal.recording import Recording, Sensor
from imucal.units import SAMPLE_UNITS, parse_sample_unit

_GYRO, _ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER

#: An instance logged at less than this share of the fastest rate is a health check, not a recording.
_TOO_SLOW = 0.2


def read(path: Path, options: ReadOptions) -> Recording:
    """Read the IMU of a ULog file.

    Raises
    ------
    ReadError
        If it is no ULog file.
    ChoiceError
        If several message instances could be meant, or none fits.
    DataError
        If there are no samples.
    """
    log = _load(path)
    _refuse_options(path, options, _instances(log))
    findings = _log_findings(log)
    if options.strict and any(finding.level == "warning" for finding in findings):
        msg = f"{path}: {findings[0].text} Expected an undamaged log"
        raise ReadError(msg)
    chosen = _choose(path, _instances(log), options)
    work = RecordingBuilder(path=str(path), format="ulog", findings=findings)
    how = "as asked" if options.topics else "the only ones logged at the full rate"
    work.decisions.append(("topics", f"{', '.join(one.name for one in chosen)}, {how}"))
    timed = _timed(path, chosen, options)
    scales = _scales(path, options)
    work.decisions += [(f"{sensor} unit", f"{unit}, as given") for sensor, (unit, _) in scales.items()]
    for entry in sorted(timed, key=lambda entry: entry.sensor is _ACCEL):
        _, scale = scales.get(entry.sensor, ("", 1.0))
        work.add_sensor(
            entry.sensor, entry.samples.vectors.T, entry.reading.clock, order=entry.reading.order, scale=scale
        )
        if entry.sensor not in scales:
            work.decisions.append((f"{entry.sensor} unit", f"{entry.sensor.unit}, as PX4 logs it"))
    for entry in timed:
        work.findings += entry.reading.findings
        temperature = entry.samples.temperature
        if temperature is not None and np.isfinite(temperature).any():
            work.add_temperature(temperature, entry.reading.clock, order=entry.reading.order)
    return work.build(
        topics=[instance.name for instance in chosen], message_types=[instance.message for instance in chosen]
    )


def _refuse_options(path: Path, options: ReadOptions, instances: Sequence[Instance]) -> None:
    asked = [
        f"{what} {value!r}"
        for what, value in (
            ("columns", options.columns),
            ("time", None if options.time == "header" else options.time),
            ("time unit", options.time_unit),
        )
        if value is not None
    ]
    if asked:
        names = _listed(instances) or "none of an IMU"
        msg = (
            f"{path}: a ULog has messages with one clock in us, but {asked[0]} was asked for; "
            f"expected nothing, or the name of a message; found {names}"
        )
        raise ChoiceError(msg)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Timed:
    """The samples of a sensor and their clock."""

    sensor: Sensor
    samples: Samples
    reading: ClockReading


def _timed(path: Path, chosen: Sequence[Instance], options: ReadOptions) -> list[_Timed]:
    """Return each sensor of the chosen instances once; equal stamps share a clock."""
    done: list[_Timed] = []
    for instance in chosen:
        for sensor in instance.sensors:
            if any(entry.sensor is sensor for entry in done):
                continue
            samples = samples_of(instance, sensor)
            if not samples.stamps.size:
                msg = f"{path}: {instance.name} holds no samples of the {sensor}; expected a recording"
                raise DataError(msg)
            same = (one.reading for one in done if np.array_equal(one.samples.stamps, samples.stamps))
            reading = next(same, None)
            if reading is None or reading.order is not None:
                reading = _clock(path, instance, samples, options)
            done.append(_Timed(sensor=sensor, samples=samples, reading=reading))
    return done


def describe(path: Path, options: ReadOptions) -> LogContents:  # noqa: ARG001 - every reader takes options
    """Return the IMU messages of a ULog file."""
    log = _load(path)
    topics = [
        TopicContents(
            name=instance.name,
            type=instance.message,
            count=instance.count,
            rate_hz=instance.rate_hz,
            duration_s=instance.duration_s,
            sensors=instance.sensors,
        )
        for instance in _instances(log)
    ]
    return LogContents(
        path=str(path),
        format="ulog",
        size_bytes=path.stat().st_size,
        topics=tuple(topics),
        duration_s=max((topic.duration_s or 0.0 for topic in topics), default=None),
        compression="none",
        findings=tuple(_log_findings(log)),
    )


def _load(path: Path) -> UlogContent:
    try:
        path.open("rb").close()
    except OSError as error:
        msg = f"{path}: can't be opened: {error.strerror or error}"
        raise ReadError(msg) from error
    return isolated(path, ulog_content, "ULog")(path)


def _log_findings(log: UlogContent) -> list[Finding]:
    findings = []
    if log.damaged:
        text = "Parts of the log are damaged; what could be read around them was read."
        findings.append(Finding(level="warning", code="damaged", text=text))
    if log.dropouts:
        lost = sum(log.dropouts) / 1000
        count = "a dropout" if len(log.dropouts) == 1 else f"{len(log.dropouts)} dropouts"
        text = f"The logger reports {count} of {lost:.3g} s in all: its card was too slow."
        advice = "Use a faster card or log fewer topics."
        findings.append(Finding(level="info", code="dropouts", text=text, advice=advice))
    return findings


def _instances(log: UlogContent) -> list[Instance]:
    known = [entry for entry in log.messages if np.size(entry.data.get("timestamp", ()))]
    names = [entry.name for entry in known]
    return [
        Instance(
            message=entry.name,
            multi=entry.multi,
            several=names.count(entry.name) > 1,
            data=entry.data,
        )
        for entry in known
    ]


def _choose(path: Path, instances: Sequence[Instance], options: ReadOptions) -> list[Instance]:
    """Return the instances to read: those asked for, or the only set that was logged fast."""
    if options.topics:
        return _asked(path, instances, options.topics)
    if not instances:
        msg = (
            f"{path}: no IMU messages; expected one of {', '.join(MESSAGES)}; "
            "log them with the sensor profile of the logger"
        )
        raise ChoiceError(msg)
    fastest = max(instance.rate_hz or 0.0 for instance in instances)
    fast = [instance for instance in instances if (instance.rate_hz or 0.0) >= _TOO_SLOW * fastest]
    if len(fast) == 1:
        return fast
    gyros = [instance for instance in fast if instance.sensors == (_GYRO,)]
    accels = [instance for instance in fast if instance.sensors == (_ACCEL,)]
    if len(fast) == 2 and len(gyros) == len(accels) == 1:
        return [*gyros, *accels]
    msg = f"{path}: several IMU messages: {_listed(fast)}; name one, or one for each sensor"
    raise ChoiceError(msg)


def _asked(path: Path, instances: Sequence[Instance], topics: Sequence[str]) -> list[Instance]:
    chosen = []
    for topic in topics:
        found = [instance for instance in instances if instance.answers_to(topic)]
        if not found:
            msg = f"{path}: no message {topic!r}; found {_listed(instances) or 'no IMU messages'}"
            raise ChoiceError(msg)
        chosen += found
    return chosen


def _listed(instances: Sequence[Instance]) -> str:
    return ", ".join(
        f"{instance.name} ({' and '.join(instance.sensors)}, {instance.count} samples"
        + (f", {instance.rate_hz:.4g} Hz)" if instance.rate_hz else ")")
        for instance in instances
    )


def _clock(path: Path, instance: Instance, samples: Samples, options: ReadOptions) -> ClockReading:
    same = np.zeros(samples.stamps.size, dtype=np.bool_)
    same[1:] = (np.diff(samples.stamps) == 0) & (samples.vectors[1:] == samples.vectors[:-1]).all(axis=1)
    return clock_from_stamps(
        samples.stamps,
        source=f"timestamp of {instance.name}",
        where=f"{path}: {instance.name}",
        rate_hz=options.rate_hz,
        repeated=same if same.any() else None,
    )


def _scales(path: Path, options: ReadOptions) -> dict[Sensor, tuple[str, float]]:
    """Return what a user says the samples are instead of SI: the unit in words, and SI per unit."""
    scales = {}
    for sensor in (_GYRO, _ACCEL):
        unit, scale = options.unit_of(sensor), options.scale_of(sensor)
        if scale is not None:
            scales[sensor] = (f"{scale:g} {sensor.unit} per count", scale)
        elif unit is not None:
            parsed = parse_sample_unit(unit)
            if parsed is None or parsed[0] is not sensor:
                known = ", ".join(SAMPLE_UNITS[sensor])
                msg = f"{path}: {unit!r} is no unit of the {sensor}; expected one of {known}"
                raise ChoiceError(msg)
            scales[sensor] = (parsed[1], SAMPLE_UNITS[sensor][parsed[1]])
    return scales
