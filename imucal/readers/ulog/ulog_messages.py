"""The samples in the IMU messages of a ULog file.

Source: PX4's message definitions (`msg/SensorCombined.msg`, `SensorGyro.msg`, `SensorGyroFifo.msg`,
`VehicleImu.msg`, and those of the accelerometer): microseconds since boot, rad/s, m/s^2.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray
from imucal.recording import Sensor

_GYRO, _ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER

_AXES = ("x", "y", "z")

#: Message -> what it measures.
MESSAGES: dict[str, tuple[Sensor, ...]] = {
    "sensor_combined": (_GYRO, _ACCEL),
    "sensor_gyro": (_GYRO,),
    "sensor_accel": (_ACCEL,),
    "sensor_gyro_fifo": (_GYRO,),
    "sensor_accel_fifo": (_ACCEL,),
    "vehicle_imu": (_GYRO, _ACCEL),
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
    """One instance of a message in the log."""

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
        stamps = _good_stamps(self.data["timestamp"])
        return float(stamps[-1] - stamps[0]) * 1e-6 if stamps.size > 1 else 0.0

    @property
    def rate_hz(self) -> float | None:
        return (self.count - 1) / self.duration_s if self.duration_s > 0 else None

    def answers_to(self, topic: str) -> bool:
        """Return whether a user's name for a topic means this instance."""
        wanted = topic.strip("/")
        return wanted == f"{self.message}:{self.multi}" or (wanted == self.message and not self.several)


def _good_stamps(stamps: NDArray[Any]) -> IntArray:
    return np.asarray(stamps[stamps < _LATEST_US], dtype=np.int64)


def samples_of(instance: Instance, sensor: Sensor) -> Samples:
    """Return the samples of a sensor in one instance of a message, in SI units."""
    data = instance.data
    if instance.message.endswith("_fifo"):
        return _of_fifo(data)
    stamps = _sample_times(data)
    if instance.message == "vehicle_imu":
        return _of_integrals(data, stamps, "delta_angle" if sensor is _GYRO else "delta_velocity")
    field = {_GYRO: "gyro_rad", _ACCEL: "accelerometer_m_s2"}[sensor]
    names = [f"{field}[{i}]" for i in range(3)] if instance.message == "sensor_combined" else list("xyz")
    keep = stamps >= 0
    vectors = np.stack([np.asarray(data[name], dtype=np.float64) for name in names], axis=1)
    warmth = data.get("temperature")
    temperature = np.asarray(warmth, dtype=np.float64)[keep] if warmth is not None else None
    return Samples(stamps=stamps[keep], vectors=vectors[keep], temperature=temperature)


def _sample_times(data: dict[str, NDArray[Any]]) -> IntArray:
    """Return when samples were taken, in ns; -1 where the stamp is damaged."""
    taken = data.get("timestamp_sample")
    stamps = taken if taken is not None and bool(np.all(taken)) else data["timestamp"]
    return np.where(stamps < _LATEST_US, stamps, 0).astype(np.int64) * 1000 - (stamps >= _LATEST_US)


def _of_integrals(data: dict[str, NDArray[Any]], stamps: IntArray, field: str) -> Samples:
    """Return mean rates from integrals over a time; an integral over no time has none."""
    over = np.asarray(data[f"{field}_dt"], dtype=np.float64) * 1e-6
    keep = (over > 0) & (stamps >= 0)
    vectors = np.stack([np.asarray(data[f"{field}[{i}]"], dtype=np.float64)[keep] for i in range(3)], axis=1)
    return Samples(stamps=stamps[keep], vectors=vectors / over[keep, None])


def _of_fifo(data: dict[str, NDArray[Any]]) -> Samples:
    """Return every sample of a sensor's buffer: the stamp is the last one's, the others go before it."""
    count = np.asarray(data["samples"], dtype=np.int64)
    depth = sum(1 for name in data if name.startswith("x["))
    step = np.asarray(data["dt"], dtype=np.float64) * 1e3
    last = _sample_times(data)
    good = (last >= 0) & np.isfinite(step) & (count > 0) & (count <= depth)
    index = np.arange(depth)
    filled = (index < count[:, None]) & good[:, None]
    before = (count[:, None] - 1 - index) * np.where(good, step, 0.0)[:, None]
    stamps = (last[:, None] - np.round(before).astype(np.int64))[filled]
    scale = np.asarray(data["scale"], dtype=np.float64)[:, None]
    axes = [
        (np.stack([np.asarray(data[f"{axis}[{i}]"], dtype=np.float64) for i in index], axis=1) * scale)[
            filled
        ]
        for axis in _AXES
    ]
    return Samples(stamps=stamps, vectors=np.stack(axes, axis=1))
