"""Log file -> Recording: what was recorded.

`read` and `describe` look at the first bytes of a file, choose its format in `imucal.readers.formats`
and call the module that knows it.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from imucal.readers import formats
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.formats import FORMATS, detect, load
from imucal.readers.read_options import Progress, ReadOptions, options_of
from imucal.readers.remote_logs import local_logs
from imucal.recording import Recording
from imucal.remote import RemoteLog, expand, identify, is_url

__all__ = [
    "FORMATS",
    "LogContents",
    "Progress",
    "ReadOptions",
    "TopicContents",
    "describe",
    "logs_of",
    "read",
]


def read(
    *paths: str | Path | RemoteLog,
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
    join: bool = False,
    strict: bool = False,
    memory_limit: int | None = None,
    checksums: bool = False,
    progress: Progress | None = None,
) -> Recording:
    """Read the IMU samples of a log.

    Parameters
    ----------
    paths
        One log (a file, or the folder of a ROS 2 bag), or the files of one recording, which are joined
        with gaps between them; ``-`` is standard input. A text such as ``s3://bucket/log.mcap`` (``gs://``,
        ``az://``, ``https://``) is a log in a store: wildcards and folders stand for their logs, a copy is
        kept in the cache, and what is returned names the URL without user and query.
    topic
        Topic to read, or two of them where gyroscope and accelerometer are apart.
    time, time_unit, rate_hz, gyro_unit, accel_unit, gyro_scale, accel_scale, columns, message_definition, \
    fields
        What the log doesn't say or says wrongly; see `ReadOptions`.
    join
        Take several logs as parts of one recording. Without it they are joined where their names are a
        series, topics, frames and scales are the same, and each goes on where the one before ends.
    strict
        Refuse a damaged log instead of recovering what is whole.
    memory_limit
        Bytes of samples to hold in memory before a temporary file takes them.
    checksums
        Also work out size and BLAKE2b checksum of each file, for `imucal.recording.Source.files`; they cost
        as much as reading the files once more, in a thread of their own.
    progress
        Called with bytes done and bytes in all.

    Raises
    ------
    ReadError
        If a file is missing, damaged beyond reading or of an unknown format.
    ChoiceError
        If several topics or columns could be meant, or none fits; or if several logs are not parts of
        one recording.
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
        join=join,
        strict=strict,
        memory_limit=memory_limit,
        progress=progress,
    )
    if not paths:
        msg = "no log: name at least one file"
        raise ValueError(msg)
    with local_logs(paths, progress=progress) as logs:
        if not checksums:
            return logs.named(_read(logs.paths, options))
        from imucal.readers.checksums import Checksums

        with Checksums(logs.paths) as sums:
            recording = _read(logs.paths, options)
            return logs.named(replace(recording, source=replace(recording.source, files=sums.files())))


def _read(paths: Sequence[Path], options: ReadOptions) -> Recording:
    logs = [log for path in paths for log in formats.logs_of(path)]
    if len(logs) == 1:
        return load(detect(logs[0])).read(logs[0], options)
    from imucal.readers.split import read_all

    return read_all(logs, options)


def logs_of(log: str | Path) -> list[str]:
    """Return the logs that a path or a URL stands for: itself, or those of a folder or of wildcards.

    Raises
    ------
    ReadError
        If it is a URL of none.
    """
    if is_url(log):
        return expand(str(log))
    return [str(path) for path in formats.logs_of(Path(log))]


def describe(log: str | Path | RemoteLog, options: ReadOptions | None = None) -> LogContents:
    """Return what is in a log; reads its index, not its samples.

    Of a log behind a URL parts are fetched where that saves something, else all of it.

    Raises
    ------
    ReadError
        If the file is missing, damaged beyond reading or of an unknown format.
    """
    options = options or ReadOptions()
    if isinstance(log, RemoteLog) or is_url(log):
        from imucal.readers.remote_index import index_of

        remote = log if isinstance(log, RemoteLog) else identify(str(log))
        if contents := index_of(remote, options):
            return contents
        log = remote
    with local_logs([log], progress=options.progress) as logs:
        (path,) = logs.paths
        return logs.described(load(detect(path)).describe(path, options))
