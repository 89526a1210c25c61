"""PX4 ULog files: raw IMU samples of the flight controller, read by pyulog.

pyulog may loop for ever on a damaged file, so it runs in a child process. Messages: ``sensor_combined`` (the
estimator's choice), ``sensor_gyro`` and ``sensor_accel`` (each sensor), ``sensor_gyro_fifo`` and
``sensor_accel_fifo`` (every sample of its buffer), ``vehicle_imu`` (integrals, divided by their time here).
One instance of a message is named ``sensor_gyro:1``. Source: PX4's message definitions
(`msg/SensorCombined.msg`, `SensorGyro.msg`, `SensorGyroFifo.msg`, `VehicleImu.msg`, and those of the
accelerometer): microseconds since boot, rad/s, m/s^2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray
from imucal.errors import ChoiceError, DataError, ReadError
from imucal.findings import Finding
from imucal.readers.builder import RecordingBuilder
from imucal.readers.clocks import ClockReading, clock_from_stamps, repeats
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.isolation import isolated
from imucal.readers.read_options import ReadOptions
from imucal.readers.scales import UnitGuess, Unscaled
from imucal.recording import AXES, Recording, Sensor

__all__ = ["MESSAGES", "describe", "read"]

_GYRO, _ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER

#: Message -> what it measures.
MESSAGES: dict[str, tuple[Sensor, ...]] = {
    "sensor_combined": (_GYRO, _ACCEL),
    "sensor_gyro": (_GYRO,),
    "sensor_accel": (_ACCEL,),
    "sensor_gyro_fifo": (_GYRO,),
    "sensor_accel_fifo": (_ACCEL,),
    "vehicle_imu": (_GYRO, _ACCEL),
}

#: The fields of a sensor in messages of both; in messages of one they are x, y and z.
_FIELDS = {
    "sensor_combined": {_GYRO: "gyro_rad", _ACCEL: "accelerometer_m_s2"},
    "vehicle_imu": {_GYRO: "delta_angle", _ACCEL: "delta_velocity"},
}

#: No board runs longer, in microseconds: a stamp beyond it is damaged. About 140 years.
_LATEST_US = 1 << 52
#: An instance logged at less than this share of the fastest rate is a health check, not a recording.
_TOO_SLOW = 0.2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Samples:
    """What one message instance gives for one sensor: stamps in ns, samples (n, 3), temperature."""

    stamps: IntArray
    vectors: FloatArray
    temperature: FloatArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Instance:
    """One instance of a message in the log, which may hold `several`: its fields, shape (n,) each."""

    message: str
    multi: int
    several: bool
    data: dict[str, NDArray[Any]]

    @property
    def name(self) -> str:
        """``sensor_gyro:1``; without the number where there is one instance only."""
        return f"{self.message}:{self.multi}" if self.several else self.message

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        return MESSAGES[self.message]

    @property
    def count(self) -> int:
        """Samples: of a fifo message all that it carries."""
        samples = self.data.get("samples")
        if self.message.endswith("_fifo") and samples is not None:
            return int(np.asarray(samples, dtype=np.int64).sum())
        return int(self.data["timestamp"].size)

    @property
    def duration_s(self) -> float:
        stamps = self.data["timestamp"]
        good = stamps[stamps < _LATEST_US].astype(np.int64)
        return float(good[-1] - good[0]) * 1e-6 if good.size > 1 else 0.0

    @property
    def rate_hz(self) -> float | None:
        return (self.count - 1) / self.duration_s if self.duration_s > 0 else None

    def answers_to(self, topic: str) -> bool:
        """Return whether a user's name for a topic means this instance."""
        return topic.strip("/") in {self.name, f"{self.message}:{self.multi}"}

    def columns(self, names: Sequence[str]) -> FloatArray:
        """Return some fields side by side, shape (n, fields)."""
        return np.stack([np.asarray(self.data[name], dtype=np.float64) for name in names], axis=1)

    def times(self) -> IntArray:
        """Return when samples were taken, in ns; -1 where the stamp is damaged."""
        taken = self.data.get("timestamp_sample")
        stamps = taken if taken is not None and bool(np.all(taken)) else self.data["timestamp"]
        return np.where(stamps < _LATEST_US, stamps, 0).astype(np.int64) * 1000 - (stamps >= _LATEST_US)


def samples_of(instance: Instance, sensor: Sensor) -> Samples:
    """Return the samples of a sensor in one instance of a message, in SI units."""
    if instance.message.endswith("_fifo"):
        return _of_fifo(instance)
    data, stamps = instance.data, instance.times()
    keep = stamps >= 0
    field = _FIELDS.get(instance.message, {}).get(sensor)
    vectors = instance.columns([f"{field}[{i}]" for i in range(3)] if field else AXES)
    if instance.message == "vehicle_imu":
        # Integrals over a time; those over no time have no rate.
        over = np.asarray(data[f"{field}_dt"], dtype=np.float64) * 1e-6
        keep &= over > 0
        return Samples(stamps=stamps[keep], vectors=vectors[keep] / over[keep, None])
    warmth = data.get("temperature")
    temperature = np.asarray(warmth, dtype=np.float64)[keep] if warmth is not None else None
    return Samples(stamps=stamps[keep], vectors=vectors[keep], temperature=temperature)


def _of_fifo(instance: Instance) -> Samples:
    """Return every sample of a sensor's buffer: the stamp is the last one's, the others go before it."""
    data, last = instance.data, instance.times()
    count = np.asarray(data["samples"], dtype=np.int64)
    index = np.arange(sum(1 for name in data if name.startswith("x[")))
    step = np.asarray(data["dt"], dtype=np.float64) * 1e3
    good = (last >= 0) & np.isfinite(step) & (count > 0) & (count <= index.size)
    filled = (index < count[:, None]) & good[:, None]
    before = (count[:, None] - 1 - index) * np.where(good, step, 0.0)[:, None]
    stamps = (last[:, None] - np.round(before).astype(np.int64))[filled]
    scale = np.asarray(data["scale"], dtype=np.float64)[:, None]
    axes = [(instance.columns([f"{axis}[{i}]" for i in index]) * scale)[filled] for axis in AXES]
    return Samples(stamps=stamps, vectors=np.stack(axes, axis=1))


class UlogContent(NamedTuple):
    """What a ULog file holds: IMU messages, whether parts are damaged, and dropouts of the logger in ms."""

    instances: list[Instance]
    damaged: bool
    dropouts: list[int]


def ulog_content(path: Path) -> UlogContent:
    """Return the IMU messages of a ULog file."""
    from pyulog import ULog

    with path.open("rb") as file:
        log = ULog(file, message_name_filter_list=list(MESSAGES))
    known = [e for e in log.data_list if e.name in MESSAGES and np.size(e.data.get("timestamp", ()))]
    names = [entry.name for entry in known]
    return UlogContent(
        instances=[
            Instance(
                message=entry.name,
                multi=int(entry.multi_id),
                several=names.count(entry.name) > 1,
                # Copies: the fields of pyulog are views of all messages together.
                data={name: np.ascontiguousarray(values) for name, values in entry.data.items()},
            )
            for entry in known
        ],
        damaged=bool(log.file_corruption),
        dropouts=[int(dropout.duration) for dropout in log.dropouts],
    )


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
    _refuse_options(path, options, log.instances)
    findings = _log_findings(log)
    if options.strict and any(finding.level == "warning" for finding in findings):
        msg = f"{path}: {findings[0].text} Expected an undamaged log"
        raise ReadError(msg)
    chosen = _choose(path, log.instances, options)
    work = RecordingBuilder(path=str(path), format="ulog", options=options, findings=findings)
    how = "as asked" if options.topics else "the only ones logged at the full rate"
    work.decisions.append(("topics", f"{', '.join(one.name for one in chosen)}, {how}"))
    timed = _timed(path, chosen, options)
    work.add(
        [
            Unscaled(
                sensor=sensor,
                rows=timed[sensor][0].vectors.T,
                clock=timed[sensor][1].clock,
                order=timed[sensor][1].order,
                stated=UnitGuess(unit=sensor.unit, reason="as PX4 logs it"),
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


def _refuse_options(path: Path, options: ReadOptions, instances: Sequence[Instance]) -> None:
    time = None if options.time == "header" else options.time
    given = {"columns": options.columns, "time": time, "time unit": options.time_unit}
    for what, value in given.items():
        if value is not None:
            msg = (
                f"{path}: a ULog has messages with one clock in us, but {what} {value!r} was asked for; "
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
    """Return the IMU messages of a ULog file."""
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
        format="ulog",
        size_bytes=path.stat().st_size,
        topics=topics,
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
    pair = {instance.sensors: instance for instance in fast}
    if len(fast) == 2 and pair.keys() == {(_GYRO,), (_ACCEL,)}:
        return [pair[_GYRO,], pair[_ACCEL,]]
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
