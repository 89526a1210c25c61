"""What a caller may say about a log; every reader takes the same options."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

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
    message_definitions
        ``.msg`` files, or folders of them, for message types whose definitions the log doesn't carry.
    fields
        Texts such as ``gyro=gx,gy,gz accel=ax,ay,az`` that say which fields of messages are which.
    join
        Take several logs as parts of one recording, whatever speaks against it.
    strict
        Refuse a log that is damaged instead of recovering what is whole.
    memory_limit
        Bytes of samples to hold in memory before a temporary file takes them; None for
        `imucal.resources.column_limit`.
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
    message_definitions: tuple[Path, ...] = ()
    fields: tuple[str, ...] = ()
    join: bool = False
    strict: bool = False
    memory_limit: int | None = None
    progress: Progress | None = None

    def unit_of(self, sensor: Sensor) -> str | None:
        """Return the unit that is given for a sensor's samples."""
        return self.gyro_unit if sensor is Sensor.GYROSCOPE else self.accel_unit

    def scale_of(self, sensor: Sensor) -> float | None:
        """Return the SI per count that is given for a sensor's samples."""
        return self.gyro_scale if sensor is Sensor.GYROSCOPE else self.accel_scale


def options_of(
    *,
    topic: str | Sequence[str] | None = None,
    message_definition: str | Path | Sequence[str | Path] | None = None,
    fields: str | Sequence[str] | None = None,
    **others: Any,  # noqa: ANN401 - the fields of `ReadOptions`
) -> ReadOptions:
    """Return the arguments of `imucal.read` as one value."""
    return ReadOptions(
        topics=(topic,) if isinstance(topic, str) else tuple(topic or ()),
        message_definitions=_paths(message_definition),
        fields=(fields,) if isinstance(fields, str) else tuple(fields or ()),
        **others,
    )


def _paths(given: str | Path | Sequence[str | Path] | None) -> tuple[Path, ...]:
    several = (given,) if isinstance(given, str | Path) else tuple(given or ())
    return tuple(Path(path) for path in several)
