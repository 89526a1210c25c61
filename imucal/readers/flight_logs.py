"""Logs of flight controllers: PX4's ULog, read by pyulog, and ArduPilot's, read by pymavlink, an extra.

Either package may loop for ever on a damaged file, so they run in a child process.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from imucal.errors import ChoiceError, DataError, ReadError
from imucal.findings import Finding
from imucal.readers.ardupilot import DATAFLASH, dataflash_content, telemetry_content
from imucal.readers.builder import RecordingBuilder
from imucal.readers.clocks import ClockReading, clock_from_stamps, repeats
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.flight_messages import PX4, FlightLog, Instance, Samples, samples_of, ulog_content
from imucal.readers.isolation import isolated, require
from imucal.readers.read_options import ReadOptions
from imucal.readers.scales import UnitGuess, Unscaled
from imucal.recording import Recording, Sensor

#: The first bytes of a ULog.
ULOG = b"ULog\x01\x12\x35"

#: An instance logged at less than this share of the fastest rate is a health check, not a recording.
_TOO_SLOW = 0.2


def read(path: Path, options: ReadOptions) -> Recording:
    """Read the IMU of a flight controller's log.

    Raises
    ------
    ReadError
        If it can't be read, or the package that reads it is not installed.
    ChoiceError
        If several message instances could be meant, or none fits.
    DataError
        If there are no samples.
    """
    log = _load(path)
    _refuse_options(path, options, log.instances)
    findings = _log_findings(log)
    if options.strict and any(finding.level == "warning" for finding in findings):
        msg = f"{path}: {findings[0].text} Expected an undamaged log"
        raise ReadError(msg)
    chosen = _choose(path, log.instances, options)
    work = RecordingBuilder(path=str(path), format=log.format, options=options, findings=findings)
    how = "as asked" if options.topics else "the only ones logged at the full rate"
    work.decisions.append(("topics", f"{', '.join(one.name for one in chosen)}, {how}"))
    timed = _timed(path, chosen, options)
    maker = "PX4" if log.format == "ulog" else "ArduPilot"
    work.add(
        [
            Unscaled(
                sensor=sensor,
                rows=timed[sensor][0].vectors.T,
                clock=timed[sensor][1].clock,
                order=timed[sensor][1].order,
                stated=_stated(sensor, chosen, maker),
            )
            for sensor in Sensor
            if sensor in timed
        ]
    )
    for samples, reading in timed.values():
        work.findings += reading.findings
        temperature = samples.temperature
        if temperature is not None and np.isfinite(temperature).any():
            work.add_temperature(temperature, reading.clock, order=reading.order)
    return work.build(
        topics=[instance.name for instance in chosen], message_types=[instance.message for instance in chosen]
    )


def _stated(sensor: Sensor, chosen: Sequence[Instance], maker: str) -> UnitGuess | None:
    """Return the unit in which the message that was chosen for a sensor has its samples, if that is known."""
    kind = next(instance.kind for instance in chosen if sensor in instance.sensors)
    unit = kind.units[sensor]
    return UnitGuess(unit=unit, reason=f"as {maker} logs it") if unit else None


def _refuse_options(path: Path, options: ReadOptions, instances: Sequence[Instance]) -> None:
    time = None if options.time == "header" else options.time
    given = {"columns": options.columns, "time": time, "time unit": options.time_unit}
    for what, value in given.items():
        if value is not None:
            msg = (
                f"{path}: a flight log has messages with one clock, but {what} {value!r} was asked for; "
                f"expected nothing, or the name of a message; found {_listed(instances) or 'none of an IMU'}"
            )
            raise ChoiceError(msg)


def _timed(
    path: Path, chosen: Sequence[Instance], options: ReadOptions
) -> dict[Sensor, tuple[Samples, ClockReading]]:
    """Return the samples and the clock of each sensor once; equal stamps share a clock."""
    done: dict[Sensor, tuple[Samples, ClockReading]] = {}
    for instance in chosen:
        for sensor in instance.sensors:
            if sensor in done:
                continue
            samples = samples_of(instance, sensor)
            if not samples.stamps.size:
                msg = f"{path}: {instance.name} holds no samples of the {sensor}; expected a recording"
                raise DataError(msg)
            same = (read for known, read in done.values() if np.array_equal(known.stamps, samples.stamps))
            reading = next(same, None)
            if reading is None or reading.order is not None:
                reading = _clock(path, instance, samples, options)
            done[sensor] = (samples, reading)
    return done


def describe(path: Path, options: ReadOptions) -> LogContents:  # noqa: ARG001 - every reader takes options
    """Return the IMU messages of a flight controller's log."""
    log = _load(path)
    topics = tuple(
        TopicContents(
            name=instance.name,
            type=instance.message,
            count=instance.count,
            rate_hz=instance.rate_hz,
            duration_s=instance.duration_s,
            sensors=instance.sensors,
        )
        for instance in log.instances
    )
    return LogContents(
        path=str(path),
        format=log.format,
        size_bytes=path.stat().st_size,
        topics=topics,
        duration_s=max((topic.duration_s or 0.0 for topic in topics), default=None),
        compression="none",
        findings=tuple(_log_findings(log)),
    )


def _load(path: Path) -> FlightLog:
    try:
        with path.open("rb") as file:
            head = file.read(len(ULOG))
    except OSError as error:
        msg = f"{path}: can't be opened: {error.strerror or error}"
        raise ReadError(msg) from error
    if head.startswith(ULOG[:4]):
        return isolated(path, ulog_content, "ULog")(path)
    require(path, "pymavlink", "a log of ArduPilot", extra="ardupilot")
    if head.startswith(DATAFLASH):
        return isolated(path, dataflash_content, "ArduPilot")(path)
    return isolated(path, telemetry_content, "ArduPilot telemetry")(path)


def _log_findings(log: FlightLog) -> list[Finding]:
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


def _choose(path: Path, instances: Sequence[Instance], options: ReadOptions) -> list[Instance]:
    """Return the instances to read: those asked for, or the only set that was logged fast."""
    if options.topics:
        return _asked(path, instances, options.topics)
    if not instances:
        msg = (
            f"{path}: no IMU messages; expected one of {', '.join(PX4)}; of ArduPilot IMU, GYR or ACC; "
            "log them with the sensor profile of the logger"
        )
        raise ChoiceError(msg)
    fastest = max(instance.rate_hz or 0.0 for instance in instances)
    fast = [instance for instance in instances if (instance.rate_hz or 0.0) >= _TOO_SLOW * fastest]
    if len(fast) == 1:
        return fast
    pair = {instance.sensors: instance for instance in fast}
    if len(fast) == 2 and pair.keys() == {(Sensor.GYROSCOPE,), (Sensor.ACCELEROMETER,)}:
        return [pair[Sensor.GYROSCOPE,], pair[Sensor.ACCELEROMETER,]]
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
    return clock_from_stamps(
        samples.stamps,
        source=f"timestamp of {instance.name}",
        where=f"{path}: {instance.name}",
        rate_hz=options.rate_hz,
        repeated=repeats(samples.stamps, samples.vectors.T),
    )
