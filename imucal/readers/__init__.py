"""Log file -> Recording: what was recorded.

`read` and `describe` look at the first bytes of a file, choose its format in `imucal.readers.formats`
and call the module that knows it.
"""

from collections.abc import Sequence
from pathlib import Path

from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.formats import FORMATS, Format, detect, load
from imucal.readers.read_options import Progress, ReadOptions, options_of
from imucal.recording import Recording

__all__ = [
    "FORMATS",
    "Format",
    "LogContents",
    "Progress",
    "ReadOptions",
    "TopicContents",
    "describe",
    "read",
]


def read(
    *paths: str | Path,
    topic: str | Sequence[str] | None = None,
    time: str | None = None,
    time_unit: str | None = None,
    rate_hz: float | None = None,
    gyro_unit: str | None = None,
    accel_unit: str | None = None,
    gyro_scale: float | None = None,
    accel_scale: float | None = None,
    columns: str | None = None,
    message_definition: str | Path | Sequence[str | Path] | None = None,
    fields: str | Sequence[str] | None = None,
    strict: bool = False,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Recording:
    """Read the IMU samples of a log.

    Parameters
    ----------
    paths
        One log (a file, or the folder of a ROS 2 bag), or several files of one recording, which are
        read in the order of their names and joined with gaps between them; ``-`` is standard input.
    topic
        Topic to read, or two of them where gyroscope and accelerometer are apart.
    time, time_unit, rate_hz, gyro_unit, accel_unit, gyro_scale, accel_scale, columns, message_definition, \
    fields
        What the log doesn't say or says wrongly; see `ReadOptions`.
    strict
        Refuse a damaged log instead of recovering what is whole.
    memory_limit
        Bytes of samples to hold in memory before a temporary file takes them.
    progress
        Called with bytes done and bytes in all.

    Raises
    ------
    ReadError
        If a file is missing, damaged beyond reading or of an unknown format.
    ChoiceError
        If several topics or columns could be meant, or none fits.
    DataError
        If there are no samples, or no rate can be measured.
    """
    options = options_of(
        topic=topic,
        time=time,
        time_unit=time_unit,
        rate_hz=rate_hz,
        gyro_unit=gyro_unit,
        accel_unit=accel_unit,
        gyro_scale=gyro_scale,
        accel_scale=accel_scale,
        columns=columns,
        message_definition=message_definition,
        fields=fields,
        strict=strict,
        memory_limit=memory_limit,
        progress=progress,
    )
    if not paths:
        msg = "no log: name at least one file"
        raise ValueError(msg)
    if len(paths) == 1:
        path = Path(paths[0])
        return load(detect(path)).read(path, options)
    from imucal.readers.split import read_all

    return read_all([Path(path) for path in paths], options)


def describe(path: str | Path, options: ReadOptions | None = None) -> LogContents:
    """Return what is in a log; reads its index, not its samples.

    Raises
    ------
    ReadError
        If the file is missing, damaged beyond reading or of an unknown format.
    """
    path = Path(path)
    return load(detect(path)).describe(path, options or ReadOptions())
