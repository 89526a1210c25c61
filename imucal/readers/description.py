"""Describe logs for `imucal info`: their topics, or the recording in a table."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from imucal.errors import ChoiceError, DataError, ImucalError, ReadError
from imucal.readers.assemble import assemble
from imucal.readers.candidates import Candidate
from imucal.readers.choose import candidates_of, choose
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.read_options import ReadOptions
from imucal.readers.table import Log
from imucal.readers.tables import text_table
from imucal.readers.tables.text_source import LongerError
from imucal.recording import Recording

#: Largest unpacked text that is read completely to describe it, in bytes.
_SMALL = 64 << 20


def describe_log(
    path: Path, options: ReadOptions, open_log: Callable[[Path, ReadOptions], Log]
) -> LogContents:
    """Return the contents of a log that `open_log` opens; the samples of topics are not read.

    Raises ReadError if it can't be opened.
    """
    with open_log(path, options) as log:
        tables = log.tables
        if tables and not tables[0].is_topic:
            return _of_recording(log, _recorded(log, options))
        topics = tuple(_of_topic(candidate) for candidate in candidates_of(log, options))
        durations = [topic.duration_s for topic in topics if topic.duration_s is not None]
        duration = max(durations, default=None)
        if log.start_ns is not None and log.end_ns is not None:
            duration = (log.end_ns - log.start_ns) / 1e9
        contents = replace(_of_file(log), topics=topics, start_ns=log.start_ns, duration_s=duration)
        return replace(contents, findings=tuple(log.findings))


def describe_text(path: Path, options: ReadOptions) -> LogContents:
    """Return the contents of a text, or of the texts of an app; only the start of a long one is read.

    A note explains why a table can't be read. Raises ReadError if it can't be opened or is not a table.
    """
    try:
        with text_table.open_log(path, options, most=_SMALL) as log:
            size = log.unpacked_bytes if log.is_set else log.size_bytes
            log.head = size is None or size > _SMALL
            return _of_text(log, options)
    except LongerError:
        # A small file may unpack to a huge one.
        with text_table.open_log(path, options) as log:
            log.head = True
            return _of_text(log, options)
    except ChoiceError as error:
        size = path.stat().st_size if path.is_file() else None
        contents = LogContents(path=str(path), format=text_table.TextLog.form, size_bytes=size)
        topic = TopicContents(name=path.name, type="table")
        return replace(contents, topics=(topic.refused(error),))


def _of_text(log: text_table.TextLog, options: ReadOptions) -> LogContents:
    contents = _of_recording(log, _recorded(log, options))
    if not log.head:
        return contents
    unpacked = log.unpacked_bytes or max(log.size_bytes or 0, _SMALL + 1)
    topics = tuple(replace(topic, count=None, duration_s=None) for topic in contents.topics)
    return replace(contents, topics=topics, duration_s=None, unpacked_bytes=unpacked)


def _recorded(log: Log, options: ReadOptions) -> Recording | ImucalError:
    """Return the recording in the tables of a file, or the reason why it can't be read."""
    try:
        return assemble(log, choose(log, options), options)
    except (ChoiceError, DataError) as error:
        return error


def _of_file(log: Log) -> LogContents:
    return LogContents(
        path=str(log.path),
        format=log.form,
        size_bytes=log.size_bytes,
        unpacked_bytes=log.unpacked_bytes,
        compression=log.compression,
    )


def _of_recording(log: Log, found: Recording | ImucalError) -> LogContents:
    """Return a description of a table, from its recording or the reason why it can't be read."""
    contents, topic = _of_file(log), TopicContents(name=log.path.name, type="table")
    if isinstance(found, ImucalError):
        return replace(contents, topics=(topic.refused(found),))
    first = found.series[0]
    units = tuple((what, how) for what, how in found.source.decisions if what.endswith("unit"))
    topic = replace(
        topic,
        type=found.source.values.get("layout", "table"),
        count=first.n,
        rate_hz=first.rate_hz,
        duration_s=first.duration_s,
        sensors=tuple(dict.fromkeys(series.sensor for series in found.series)),
        note="; ".join(f"{what} {how}" for what, how in units),
        decisions=units,
    )
    return replace(contents, topics=(topic,), start_ns=first.clock.start_ns, duration_s=first.duration_s)


def _of_topic(candidate: Candidate) -> TopicContents:
    table = candidate.table
    contents = TopicContents(
        name=table.name,
        type=table.kind,
        count=table.count,
        rate_hz=table.measured_hz,
        duration_s=table.duration_s,
        fields=table.fields,
    )
    if not candidate.sensors or candidate.is_empty:
        if not candidate.reason:
            return contents
        return contents.refused(ReadError(candidate.reason, fixes=candidate.fixes))
    try:
        planned = [sensor.triad.sensor for sensor in candidate.plan.sensors]
    except ReadError as error:
        return contents.refused(error)
    silent = [sensor for sensor in planned if sensor not in candidate.alive]
    note = "read only if it is named" if candidate.weak else ""
    if silent:
        note = " and ".join(silent) + " constant: no data"
    sensors = tuple(sensor for sensor in candidate.sensors if sensor in candidate.alive)
    return replace(contents, sensors=sensors, note=note)
