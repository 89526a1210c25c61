"""Logs of flight controllers: PX4's ULog, read by pyulog, and ArduPilot's, read by pymavlink, an extra.

Either package may loop for ever on a damaged file, so they run in a child process.

Messages of PX4: ``sensor_combined`` (the estimator's choice), ``sensor_gyro`` and ``sensor_accel`` (each
sensor), ``sensor_gyro_fifo`` and ``sensor_accel_fifo`` (every sample of its buffer), ``vehicle_imu``
(integrals, divided by their time here). One instance of a message is named ``sensor_gyro:1``. Source: PX4's
message definitions (`msg/SensorCombined.msg`, `SensorGyro.msg`, `SensorGyroFifo.msg`, `VehicleImu.msg`, and
those of the accelerometer): microseconds since boot, rad/s and m/s^2.

Messages of ArduPilot's ``.bin``, from the board's memory: ``IMU``, or ``GYR`` and ``ACC`` of a batch log, in
SI; the package finds the records and says what each kind holds, and they are taken out in one go. Of its
``.tlog``, what was sent to the ground: ``HIGHRES_IMU`` in SI, ``SCALED_IMU`` in mg and mrad/s, and
``RAW_IMU``, which ArduPilot sends in these units and others in counts. Source: ArduPilot,
`AP_InertialSensor/LogStructure.h` and `GCS_Common.cpp` (`send_raw_imu`); MAVLink, `common.xml`.
"""

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray
from imucal.errors import ChoiceError, DataError
from imucal.findings import Finding
from imucal.frozen import frozen, frozen_alone
from imucal.readers.builder import RecordingBuilder
from imucal.readers.clocks import ClockReading, clock_from_stamps, repeats
from imucal.readers.containers.container import gather
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.files import first_bytes, refused
from imucal.readers.isolation import isolated, require
from imucal.readers.read_options import ReadOptions
from imucal.readers.scales import UnitGuess, Unscaled
from imucal.recording import AXES, Recording, Sensor

#: The first bytes of a ULog.
ULOG = b"ULog\x01\x12\x35"

#: An instance logged at less than this share of the fastest rate is a health check, not a recording.
_TOO_SLOW = 0.2

_GYRO, _ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER


@frozen
class Message:
    """What a message measures: the fields of each sensor's x, y, z, and those of its stamps, best first.

    Stamps are in us, or in ms where their name ends so. `units` are those of the samples; None where the log
    leaves them open.
    """

    fields: dict[Sensor, tuple[str, ...]]
    times: tuple[str, ...] = ("timestamp_sample", "timestamp")
    units: dict[Sensor, str | None] = field(
        default_factory=lambda: {sensor: sensor.unit for sensor in Sensor}
    )


def _both(gyro: str, accel: str) -> Message:
    """Return a message with an array of each sensor."""
    arrays = {_GYRO: gyro, _ACCEL: accel}
    return Message(fields={of: tuple(f"{name}[{i}]" for i in range(3)) for of, name in arrays.items()})


#: Message of PX4 -> what it measures.
PX4 = {
    "sensor_combined": _both("gyro_rad", "accelerometer_m_s2"),
    **dict.fromkeys(("sensor_gyro", "sensor_gyro_fifo"), Message(fields={_GYRO: AXES})),
    **dict.fromkeys(("sensor_accel", "sensor_accel_fifo"), Message(fields={_ACCEL: AXES})),
    "vehicle_imu": _both("delta_angle", "delta_velocity"),
}

#: No board runs longer, in microseconds: a stamp beyond it is damaged. About 140 years.
_LATEST_US = 1 << 52


@frozen_alone
class Samples:
    """What one message instance gives for one sensor: stamps in ns, samples (n, 3), their unit, temperature.

    The unit is None where the log leaves it open.
    """

    stamps: IntArray
    vectors: FloatArray
    unit: str | None
    temperature: FloatArray | None = None


@frozen_alone
class Instance:
    """One instance of a message in the log, which may hold `several`: its fields, shape (n,) each."""

    message: str
    multi: int
    several: bool
    data: dict[str, NDArray[Any]]
    kind: Message

    @property
    def is_whole(self) -> bool:
        """Whether it has stamps, and the fields of its sensors where they have names of their own."""
        fifo = self.message.endswith("_fifo")
        fields = {"samples", "dt", "scale"} if fifo else {*chain(*self.kind.fields.values())}
        return self.data.keys() >= fields and any(name in self.data for name in self.kind.times)

    @property
    def name(self) -> str:
        """``sensor_gyro:1``; without the number where there is one instance only."""
        return f"{self.message}:{self.multi}" if self.several else self.message

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        return tuple(self.kind.fields)

    @property
    def count(self) -> int:
        """Samples: of a fifo message all that it carries."""
        samples = self.data.get("samples")
        if self.message.endswith("_fifo") and samples is not None:
            return int(np.asarray(samples, np.int64).sum())
        return int(self.times().size)

    @property
    def duration_s(self) -> float:
        stamps = self.times()
        good = stamps[stamps >= 0]
        return float(good[-1] - good[0]) / 1e9 if good.size > 1 else 0.0

    @property
    def rate_hz(self) -> float | None:
        return (self.count - 1) / self.duration_s if self.duration_s > 0 else None

    def answers_to(self, topic: str) -> bool:
        """Return whether a user's name for a topic means this instance."""
        return topic.strip("/") in {self.name, f"{self.message}:{self.multi}"}

    def columns(self, names: Sequence[str]) -> FloatArray:
        """Return some fields side by side, shape (n, fields)."""
        return np.stack([np.asarray(self.data[name], np.float64) for name in names], axis=1)

    def times(self) -> IntArray:
        """Return when samples were taken, in ns; -1 where the stamp is damaged."""
        there = [name for name in self.kind.times if name in self.data]
        name = next((name for name in there if bool(np.all(self.data[name]))), there[-1])
        stamps, ns = self.data[name], 1_000_000 if name.lower().endswith("ms") else 1000
        return np.where(stamps < _LATEST_US, stamps, 0).astype(np.int64) * ns - (stamps >= _LATEST_US)


def samples_of(instance: Instance, sensor: Sensor) -> Samples:
    """Return the samples of a sensor in one instance of a message, in SI units."""
    unit = instance.kind.units[sensor]
    if instance.message.endswith("_fifo"):
        return _of_fifo(instance, unit)
    data, stamps = instance.data, instance.times()
    keep = stamps >= 0
    fields = instance.kind.fields[sensor]
    vectors = instance.columns(fields)
    if instance.message == "vehicle_imu":
        # Integrals over a time; those over no time have no rate.
        over = np.asarray(data[fields[0].replace("[0]", "_dt")], np.float64) * 1e-6
        keep &= over > 0
        return Samples(stamps=stamps[keep], vectors=vectors[keep] / over[keep, None], unit=unit)
    warmth = data.get("temperature")
    temperature = np.asarray(warmth, np.float64)[keep] if warmth is not None else None
    return Samples(stamps=stamps[keep], vectors=vectors[keep], unit=unit, temperature=temperature)


def _of_fifo(instance: Instance, unit: str | None) -> Samples:
    """Return every sample of a sensor's buffer: the stamp is the last one's, the others go before it."""
    data, last = instance.data, instance.times()
    count = np.asarray(data["samples"], np.int64)
    index = np.arange(sum(1 for name in data if name.startswith("x[")))
    step = np.asarray(data["dt"], np.float64) * 1e3
    good = (last >= 0) & np.isfinite(step) & (count > 0) & (count <= index.size)
    filled = (index < count[:, None]) & good[:, None]
    before = (count[:, None] - 1 - index) * np.where(good, step, 0.0)[:, None]
    stamps = (last[:, None] - np.round(before).astype(np.int64))[filled]
    scale = np.asarray(data["scale"], np.float64)[:, None]
    axes = [(instance.columns([f"{axis}[{i}]" for i in index]) * scale)[filled] for axis in AXES]
    return Samples(stamps=stamps, vectors=np.stack(axes, axis=1), unit=unit)


class FlightLog(NamedTuple):
    """What a log holds: its format, its IMU messages, whether it is damaged, the logger's dropouts in ms."""

    format: str
    instances: list[Instance]
    damaged: bool
    dropouts: list[int]


def ulog_content(path: Path) -> FlightLog:
    """Return the IMU messages of a ULog file."""
    from pyulog import ULog

    with path.open("rb") as file:
        log = ULog(file, message_name_filter_list=list(PX4))
    known = [e for e in log.data_list if e.name in PX4 and np.size(e.data.get("timestamp", ()))]
    # Copies: the fields of pyulog are views of all messages together.
    found = {
        (entry.name, int(entry.multi_id)): {k: np.ascontiguousarray(v) for k, v in entry.data.items()}
        for entry in known
    }
    dropouts = [int(dropout.duration) for dropout in log.dropouts]
    return flight_log("ulog", found, PX4, damaged=bool(log.file_corruption), dropouts=dropouts)


def flight_log(
    form: str,
    found: Mapping[tuple[str, int], dict[str, NDArray[Any]]],
    kinds: Mapping[str, Message],
    *,
    damaged: bool,
    dropouts: Sequence[int] = (),
) -> FlightLog:
    """Return a log of the instances that were found; one whose fields are not all there is damaged."""
    names = [name for name, _ in found]
    instances = [
        Instance(message=name, multi=multi, several=names.count(name) > 1, data=data, kind=kinds[name])
        for (name, multi), data in found.items()
    ]
    whole = [instance for instance in instances if instance.is_whole]
    damaged = damaged or len(whole) < len(instances)
    return FlightLog(format=form, instances=whole, damaged=damaged, dropouts=[*dropouts])


#: The first bytes of each record of a dataflash log.
DATAFLASH = b"\xa3\x95"
#: A log ends with up to so many bytes of an unfinished page.
_PAGE = 528

_OF_BOARD = {_GYRO: tuple(f"Gyr{axis}" for axis in "XYZ"), _ACCEL: tuple(f"Acc{axis}" for axis in "XYZ")}
_STAMPS = ("SampleUS", "TimeUS", "TimeMS")
_BOARD = {
    "IMU": Message(fields=_OF_BOARD, times=_STAMPS),
    "GYR": Message(fields={_GYRO: _OF_BOARD[_GYRO]}, times=_STAMPS),
    "ACC": Message(fields={_ACCEL: _OF_BOARD[_ACCEL]}, times=_STAMPS),
}
_SENT = Message(
    fields={_GYRO: tuple(f"{axis}gyro" for axis in AXES), _ACCEL: tuple(f"{axis}acc" for axis in AXES)},
    times=("time_usec", "time_boot_ms"),
)
_MILLI = replace(_SENT, units={_GYRO: "mrad/s", _ACCEL: "mg"})
_IN_MILLI = ("SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "RAW_IMU")
_TELEMETRY = {"HIGHRES_IMU": _SENT, **dict.fromkeys(_IN_MILLI, _MILLI)}
#: MAV_AUTOPILOT_ARDUPILOTMEGA: only this autopilot's RAW_IMU has units.
_ARDUPILOT = 3


def dataflash_content(path: Path) -> FlightLog:
    """Return the IMU messages of a ``.bin``; a part that is none of its records is damage."""
    from pymavlink.DFReader import DFReader_binary

    class Index(DFReader_binary):  # type: ignore[misc]
        def init_clock(self) -> None:
            """Pass over the records once, not twice: the time since 1970 is not needed."""

    log = Index(str(path))
    found: dict[tuple[str, int], dict[str, NDArray[Any]]] = {}
    spans: list[NDArray[np.int64]] = []
    for number, form in log.formats.items():
        starts = np.asarray(log.offsets[number], np.int64)
        starts = starts[starts + form.len <= log.data_len]
        spans.append(np.stack([starts, starts + form.len]))
        # Old logs have a message for each IMU: IMU2, IMU3.
        name, last = form.name.rstrip("123"), form.name[-1:]
        if name in _BOARD and starts.size:
            data = _columns(log.data_map, starts, form)
            instances = data.get("I", np.full(starts.size, int(last) - 1 if last.isdigit() else 0))
            for multi in np.unique(instances).tolist():
                own = {key: values[instances == multi] for key, values in data.items()}
                found[name, multi] = own | ({"temperature": own["T"]} if "T" in own else {})
    begun, ended = np.sort(np.concatenate(spans, axis=1), axis=1)
    whole = begun.size and not (begun[1:] - ended[:-1]).any() and log.data_len - ended[-1] <= _PAGE
    return flight_log("dataflash", found, _BOARD, damaged=not whole)


def _columns(buffer: bytes, starts: IntArray, form: Any) -> dict[str, NDArray[Any]]:  # noqa: ANN401 - of the package
    """Return the numbers of all records of one kind by their names, shape (n,) each."""
    codes = re.findall(r"\d*[a-zA-Z]", form.msg_struct)
    types = [f"S{code[:-1]}" if code.endswith("s") else f"<{code}" for code in codes]
    row = np.dtype({"names": form.columns, "formats": types, "itemsize": form.len - 3})
    records = gather(buffer, starts + 3, row.itemsize).view(row)
    kinds = zip(form.columns, types, form.msg_mults, strict=True)
    return {name: records[name] * (scale or 1) for name, kind, scale in kinds if not kind.startswith("S")}


def telemetry_content(path: Path) -> FlightLog:
    """Return the IMU messages of a ``.tlog``; those of several vehicles are instances."""
    from pymavlink.mavutil import mavlogfile

    log = mavlogfile(str(path))
    rows: dict[tuple[str, int], list[Any]] = defaultdict(list)
    makers: dict[int, int] = {}
    while (message := log.recv_msg()) is not None:
        name = message.get_type()
        if name == "HEARTBEAT":
            makers.setdefault(message.get_srcSystem(), message.autopilot)
        elif name in _TELEMETRY:
            rows[name, message.get_srcSystem()].append(message)
    kinds = dict(_TELEMETRY)
    if _ARDUPILOT not in makers.values():
        kinds["RAW_IMU"] = replace(_SENT, units=dict.fromkeys(Sensor))
    found: dict[tuple[str, int], dict[str, NDArray[Any]]] = {}
    for key, sent in rows.items():
        kind = kinds[key[0]]
        names = [*chain(*kind.fields.values()), *(name for name in kind.times if hasattr(sent[0], name))]
        found[key] = {name: np.array([getattr(one, name) for one in sent]) for name in names}
    return flight_log("tlog", found, kinds, damaged=bool(log.mav.total_receive_errors))


def read(path: Path, options: ReadOptions) -> Recording:
    """Read the IMU of a flight controller's log.

    Raises ReadError if it can't be read, or the package that reads it is not installed; ChoiceError if
    several message instances could be meant, or none fits; DataError if there are no samples.
    """
    log = _load(path)
    _refuse_options(path, options, log.instances)
    findings = _log_findings(log)
    if options.strict and any(finding.level == "warning" for finding in findings):
        raise refused(path, f"{findings[0].text} Expected an undamaged log")
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
                rows=samples.vectors.T,
                clock=reading.clock,
                order=reading.order,
                stated=UnitGuess(unit=samples.unit, reason=f"as {maker} logs it") if samples.unit else None,
            )
            for sensor, (samples, reading) in timed.items()
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
                f"{path}: a flight log has no {what} {value!r}; give the name of a message, or nothing; "
                f"found {_listed(instances) or 'none of an IMU'}"
            )
            raise ChoiceError(msg)


def _timed(
    path: Path, chosen: Sequence[Instance], options: ReadOptions
) -> dict[Sensor, tuple[Samples, ClockReading]]:
    """Return the samples and the clock of each sensor once, gyroscope first; equal stamps share a clock."""
    done: dict[Sensor, tuple[Samples, ClockReading]] = {}
    for instance in chosen:
        for sensor in instance.sensors:
            if sensor in done:
                continue
            samples = samples_of(instance, sensor)
            if not samples.stamps.size:
                msg = f"{path}: {instance.name} has no samples of the {sensor}; expected a recording"
                raise DataError(msg)
            same = (read for known, read in done.values() if np.array_equal(known.stamps, samples.stamps))
            reading = next(same, None)
            if reading is None or reading.order is not None:
                reading = clock_from_stamps(
                    samples.stamps,
                    source=f"timestamp of {instance.name}",
                    where=f"{path}: {instance.name}",
                    rate_hz=options.rate_hz,
                    repeated=repeats(samples.stamps, samples.vectors.T),
                )
            done[sensor] = (samples, reading)
    return {sensor: done[sensor] for sensor in Sensor if sensor in done}


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
    head = first_bytes(path, len(ULOG))
    if head.startswith(ULOG[:4]):
        return isolated(path, ulog_content, "ULog")(path)
    require(path, "pymavlink", "a log of ArduPilot", extra="ardupilot")
    if head.startswith(DATAFLASH):
        return isolated(path, dataflash_content, "ArduPilot")(path)
    return isolated(path, telemetry_content, "ArduPilot telemetry")(path)


def _log_findings(log: FlightLog) -> list[Finding]:
    findings = []
    if log.damaged:
        text = "Parts of the log are damaged; the readable parts were read."
        findings.append(Finding("warning", "damaged", text))
    if log.dropouts:
        lost = sum(log.dropouts) / 1000
        count = "a dropout" if len(log.dropouts) == 1 else f"{len(log.dropouts)} dropouts"
        text = f"The logger reports {count} of {lost:.3g} s in all: its card was too slow."
        findings.append(Finding("info", "dropouts", text, "Use a faster card or log fewer topics."))
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
    raise ChoiceError(f"{path}: several IMU messages: {_listed(fast)}; name one, or one for each sensor")


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
