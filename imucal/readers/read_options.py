"""What a caller may say about a log; every reader takes the same options."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from imucal.recording import Sensor

#: Called with bytes done and bytes in all, now and then, from the reading thread.
Progress: TypeAlias = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadOptions:
    """What a caller may say about a log; None leaves a choice to the reader.

    Attributes
    ----------
    topics
        Topics (or ULog message instances such as ``sensor_combined``) to read; one, or one for
        the gyroscope and one for the accelerometer.
    time
        ``header`` or ``log`` for messages; for a table the name of its time column.
    time_unit
        Unit of the time's counts, a key of `imucal.units.TIME_UNITS_NS`; goes before one that the log states.
    rate_hz
        Sampling rate that overrides the measured one (or supplies it where there are no stamps).
    gyro_unit, accel_unit
        Unit of the samples, a key of `imucal.units.SAMPLE_UNITS`.
    gyro_scale, accel_scale
        SI per count, for raw integer counts.
    columns
        Columns of a table, such as ``t=0,g=1:4,a=4:7`` (numbers from 0, or names).
    message_definition
        A ``.msg`` file for a message type whose definition the log doesn't carry.
    strict
        Refuse a log that is damaged instead of recovering what is whole.
    memory_limit
        Bytes of samples to hold in memory before a temporary file takes them; None for a quarter
        of the machine's memory.
    progress
        Called now and then while reading.
    """

    topics: tuple[str, ...] = ()
    time: str | None = None
    time_unit: str | None = None
    rate_hz: float | None = None
    gyro_unit: str | None = None
    accel_unit: str | None = None
    gyro_scale: float | None = None
    accel_scale: float | None = None
    columns: str | None = None
    message_definition: Path | None = None
    strict: bool = False
    memory_limit: int | None = None
    progress: Progress | None = None

    def unit_of(self, sensor: Sensor) -> str | None:
        """Return the unit that is given for a sensor's samples."""
        return self.gyro_unit if sensor is Sensor.GYROSCOPE else self.accel_unit

    def scale_of(self, sensor: Sensor) -> float | None:
        """Return the SI per count that is given for a sensor's samples."""
        return self.gyro_scale if sensor is Sensor.GYROSCOPE else self.accel_scale
