"""What a flight controller logs of its IMU: kinds of messages, their instances in a log, and their samples.

Messages of PX4: ``sensor_combined`` (the estimator's choice), ``sensor_gyro`` and ``sensor_accel`` (each
sensor), ``sensor_gyro_fifo`` and ``sensor_accel_fifo`` (every sample of its buffer), ``vehicle_imu``
(integrals, divided by their time here). One instance of a message is named ``sensor_gyro:1``. Source: PX4's
message definitions (`msg/SensorCombined.msg`, `SensorGyro.msg`, `SensorGyroFifo.msg`, `VehicleImu.msg`, and
those of the accelerometer): microseconds since boot, rad/s and m/s^2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray
from imucal.recording import AXES, Sensor

_GYRO, _ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER


@dataclass(frozen=True, slots=True, kw_only=True)
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

    @classmethod
    def of_px4(cls, **names: str) -> "Message":
        """Return a message of PX4 with the arrays of some sensors; in messages of one they are x, y and z."""
        owners = {"gyro": _GYRO, "accel": _ACCEL}
        of = {owners[k]: tuple(f"{v}[{i}]" for i in range(3)) if v else AXES for k, v in names.items()}
        return cls(fields=of)


#: Message of PX4 -> what it measures.
PX4 = {
    "sensor_combined": Message.of_px4(gyro="gyro_rad", accel="accelerometer_m_s2"),
    "sensor_gyro": Message.of_px4(gyro=""),
    "sensor_accel": Message.of_px4(accel=""),
    "sensor_gyro_fifo": Message.of_px4(gyro=""),
    "sensor_accel_fifo": Message.of_px4(accel=""),
    "vehicle_imu": Message.of_px4(gyro="delta_angle", accel="delta_velocity"),
}

#: No board runs longer, in microseconds: a stamp beyond it is damaged. About 140 years.
_LATEST_US = 1 << 52


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
    kind: Message

    @property
    def is_whole(self) -> bool:
        """Whether it has stamps, and the fields of its sensors where they have names of their own."""
        fields = [field for fields in self.kind.fields.values() for field in fields]
        fields = ["samples", "dt", "scale"] if self.message.endswith("_fifo") else fields
        return self.data.keys() >= {*fields} and any(name in self.data for name in self.kind.times)

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
            return int(np.asarray(samples, dtype=np.int64).sum())
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
        return np.stack([np.asarray(self.data[name], dtype=np.float64) for name in names], axis=1)

    def times(self) -> IntArray:
        """Return when samples were taken, in ns; -1 where the stamp is damaged."""
        there = [name for name in self.kind.times if name in self.data]
        name = next((name for name in there if bool(np.all(self.data[name]))), there[-1])
        stamps, ns = self.data[name], 1_000_000 if name.lower().endswith("ms") else 1000
        return np.where(stamps < _LATEST_US, stamps, 0).astype(np.int64) * ns - (stamps >= _LATEST_US)


def samples_of(instance: Instance, sensor: Sensor) -> Samples:
    """Return the samples of a sensor in one instance of a message, in SI units."""
    if instance.message.endswith("_fifo"):
        return _of_fifo(instance)
    data, stamps = instance.data, instance.times()
    keep = stamps >= 0
    fields = instance.kind.fields[sensor]
    vectors = instance.columns(fields)
    if instance.message == "vehicle_imu":
        # Integrals over a time; those over no time have no rate.
        over = np.asarray(data[fields[0].replace("[0]", "_dt")], dtype=np.float64) * 1e-6
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
