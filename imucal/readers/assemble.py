"""Containers -> Recording: choose topics, decode them, and give each sensor its clock."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray
from imucal.errors import ChoiceError, DataError, ReadError
from imucal.findings import Finding
from imucal.readers.clocks.from_stamps import LOG_TIME, ClockReading, clock_from_stamps
from imucal.readers.clocks.order import in_time_order
from imucal.readers.clocks.two_clocks import compare_clocks
from imucal.readers.containers.container import Container
from imucal.readers.containers.loader import Decoding, decode
from imucal.readers.containers.store import Columns
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.losses import DAMAGE, loss_findings
from imucal.readers.messages.choice import Choice, choose
from imucal.readers.messages.temperature_topic import read_temperature
from imucal.readers.messages.topics import Topic, find_topics, stream_of
from imucal.readers.read_options import ReadOptions
from imucal.recording import Axis, AxisSeries, Recording, Sensor, Source, Temperature
from imucal.units import SAMPLE_UNITS

#: Name of the time in the messages.
HEADER = "header stamp"

#: Chunks looked into to see whether a sensor has data: more where a few hold too few messages.
_LOOKS, _ENOUGH = (2, 32), 100

_AXES: tuple[Axis, ...] = ("x", "y", "z")
_TIMES = (None, "header", "log")


def read_logs(
    containers: Sequence[Container], path: Path, options: ReadOptions, *, form: str = ""
) -> Recording:
    """Read the IMU samples of the files of one log.

    Parameters
    ----------
    path
        The log as the user named it.
    form
        Its format, where it is not the first container's.
    """
    try:
        return _read(containers, path, options, form or containers[0].format)
    finally:
        for container in containers:
            container.close()


def describe_logs(
    containers: Sequence[Container], path: Path, options: ReadOptions, *, form: str = ""
) -> LogContents:
    """Return what the files of one log hold."""
    try:
        topics = find_topics(containers, options)
        starts = [c.start_ns for c in containers if c.start_ns is not None]
        ends = [c.end_ns for c in containers if c.end_ns is not None]
        return LogContents(
            path=str(path),
            format=form or containers[0].format,
            size_bytes=sum(container.size for container in containers),
            topics=tuple(_contents(containers, topic, options) for topic in topics),
            start_ns=min(starts, default=None),
            duration_s=(max(ends) - min(starts)) / 1e9 if starts and ends else None,
            compression=", ".join(sorted({container.compression for container in containers})),
            findings=tuple(finding for container in containers for finding in container.findings),
        )
    finally:
        for container in containers:
            container.close()


def _contents(containers: Sequence[Container], topic: Topic, options: ReadOptions) -> TopicContents:
    sensors: tuple[Sensor, ...] = ()
    note = topic.reason
    if topic.carrier is not None and topic.count != 0:
        try:
            alive = _live(containers, topic, options)
        except ReadError as error:
            alive, note = frozenset(), str(error)
        sensors = tuple(sensor for sensor in topic.carrier.sensors if sensor in alive)
        silent = [sensor for sensor in topic.carrier.sensors if sensor not in alive]
        note = note or (" and ".join(silent) + " constant: no data" if silent else "")
        note = note or ("read only where it is named" if topic.carrier.plain else "")
    return TopicContents(
        name=topic.name,
        type=topic.type,
        count=topic.count,
        rate_hz=topic.rate_hz,
        duration_s=topic.duration_s,
        sensors=sensors,
        note=note,
    )


def _live(containers: Sequence[Container], topic: Topic, options: ReadOptions) -> frozenset[Sensor]:
    """Return the sensors whose samples change in the first chunks of a topic.

    One sample, or none that can be decoded, tells nothing: the type is believed then.
    """
    if topic.carrier is None:
        return frozenset()
    stream = stream_of(topic, topic.carrier.sensors, options)
    for chunks in _LOOKS:
        columns = decode(containers, [stream], most_chunks=chunks)[0].columns
        if columns.n >= _ENOUGH:
            break
    if columns.n < 2:
        return frozenset(topic.carrier.sensors)
    return frozenset(sensor for sensor, rows in columns.vectors.items() if not _constant(rows))


def _constant(rows: FloatArray) -> bool:
    """Say whether no axis ever changes."""
    return all(
        bool(_same(row[:1000], row[0]).all()) and bool(_same(row, row[0]).all()) for row in rows if row.size
    )


def _same(row: FloatArray, value: float) -> NDArray[np.bool_]:
    return np.isnan(row) if np.isnan(value) else row == value


def _read(containers: Sequence[Container], path: Path, options: ReadOptions, form: str) -> Recording:
    if options.time not in _TIMES:
        msg = f"{path}: messages have no time called {options.time!r}; expected header or log"
        raise ChoiceError(msg)
    if options.columns is not None:
        msg = (
            f"{path}: messages have no columns, but {options.columns!r} was asked for; "
            "expected the name of a topic, or nothing"
        )
        raise ChoiceError(msg)
    topics = find_topics(containers, options)
    choices = choose(path, topics, options, lambda topic: _live(containers, topic, options))
    streams = [stream_of(choice.topic, choice.sensors, options) for choice in choices]
    decodings = decode(containers, streams, limit=options.memory_limit, progress=options.progress)
    findings = [finding for container in containers for finding in container.findings]
    series: list[AxisSeries] = []
    temperature: Temperature | None = None
    decisions = [("topic", f"{choice.topic.name}: {choice.how}") for choice in choices]
    for choice, decoding in zip(choices, decodings, strict=True):
        findings += loss_findings(decoding.losses)
        _refuse_empty(path, choice, decoding, findings)
        some, heat, notes, decided = _series(path, choice, decoding.columns, options, alone=len(choices) == 1)
        series += some
        temperature = temperature or heat
        findings += notes
        decisions += decided
    if temperature is None:
        beside = read_temperature(containers, topics, choices[0].topic.name)
        if beside is not None:
            temperature, name = beside
            decisions.append(("temperature", f"{name}: the only one beside the IMU"))
    _refuse_damage(path, findings, options)
    if not series:
        msg = f"{path}: no sensor has samples that change: {'; '.join(f.text for f in findings) or 'no data'}"
        raise DataError(msg)
    source = Source(
        path=str(path),
        format=form,
        topics=tuple(choice.topic.name for choice in choices),
        message_types=tuple(choice.topic.type for choice in choices),
        decisions=tuple(decisions),
    )
    return Recording(
        source=source, series=tuple(series), temperature=temperature, findings=tuple(_unique(findings))
    )


def _refuse_empty(path: Path, choice: Choice, decoding: Decoding, findings: list[Finding]) -> None:
    if decoding.columns.n:
        return
    reasons = [loss.text for loss in decoding.losses] or [finding.text for finding in findings]
    why = reasons[0] if reasons else "the log holds none"
    msg = f"{path}: no message of topic {choice.topic.name} could be read: {why}"
    raise ReadError(msg)


def _refuse_damage(path: Path, findings: list[Finding], options: ReadOptions) -> None:
    damage = [finding for finding in findings if finding.code in DAMAGE]
    if options.strict and damage:
        msg = f"{path}: the log is damaged, and recovery was not wanted: {damage[0].text}"
        raise ReadError(msg)


def _series(
    path: Path, choice: Choice, columns: Columns, options: ReadOptions, *, alone: bool
) -> tuple[list[AxisSeries], Temperature | None, list[Finding], list[tuple[str, str]]]:
    """Return the axes of one topic."""
    findings = [*_other_vectors(choice.topic), *in_time_order(columns)]
    reading = _clock(path, choice, columns, options)
    label = choice.sensors[0].short if not alone and len(choice.sensors) == 1 else None
    findings += [replace(finding, axis=label) for finding in reading.findings]
    if reading.clock.source == HEADER:
        findings += compare_clocks(columns.stamps, columns.log)
    columns.release()
    decisions = [("time", reading.clock.source)]
    series = []
    for sensor, rows in columns.vectors.items():
        if _constant(rows):
            value = ", ".join(f"{row[0]:g}" for row in rows)
            text = f"The {sensor} of topic {choice.topic.name} is always ({value}): it has no data."
            findings.append(Finding(level="warning", code="no-data", text=text, axis=sensor.short))
            continue
        factor, how = _factor(sensor, choice.topic, options)
        decisions.append((f"{sensor} unit", how))
        for axis, row in zip(_AXES, rows, strict=True):
            if factor != 1.0:
                np.multiply(row, factor, out=row)
            samples = row if reading.order is None else row[reading.order]
            series.append(AxisSeries(sensor=sensor, axis=axis, samples=samples, clock=reading.clock))
    return series, _temperature(columns, reading), findings, decisions


def _other_vectors(topic: Topic) -> list[Finding]:
    """Return a finding for vectors of a message that could have been meant too."""
    if topic.carrier is None or not topic.carrier.others:
        return []
    read = " and ".join(vector.field for vector in topic.carrier.vectors)
    text = f"Messages of {topic.name} hold {', '.join(topic.carrier.others)} too; {read} were read."
    return [Finding(level="warning", code="other-vectors", text=text)]


def _clock(path: Path, choice: Choice, columns: Columns, options: ReadOptions) -> ClockReading:
    own = choice.topic.carrier is not None and choice.topic.carrier.stamp is not None
    by_log = options.time == "log"
    try:
        return clock_from_stamps(
            columns.log if by_log else columns.stamps,
            source=LOG_TIME if by_log else (HEADER if own else "stamp"),
            log_ns=columns.log,
            rate_hz=options.rate_hz,
            repeated=_repeated(columns),
        )
    except DataError as error:
        msg = f"{path}: topic {choice.topic.name}: {error}"
        raise DataError(msg) from error


def _repeated(columns: Columns) -> NDArray[np.bool_] | None:
    """Return the samples recorded twice: same stamp and same six values; None where there are none."""
    same = np.flatnonzero(columns.stamps[1:] == columns.stamps[:-1]) + 1
    if not same.size or len(columns.vectors) < 2:
        return None
    twin = columns.stamps[same] != 0
    for rows in columns.vectors.values():
        for row in rows:
            twin &= row[same] == row[same - 1]
    if not twin.any():
        return None
    repeated = np.zeros(columns.n, dtype=np.bool_)
    repeated[same[twin]] = True
    return repeated


def _factor(sensor: Sensor, topic: Topic, options: ReadOptions) -> tuple[float, str]:
    """Return what turns samples into SI, and why."""
    gyro = sensor is Sensor.GYROSCOPE
    scale = options.gyro_scale if gyro else options.accel_scale
    unit = options.gyro_unit if gyro else options.accel_unit
    if scale is not None:
        return scale, f"{scale:g} {sensor.unit} per count, given"
    if unit is not None:
        if unit not in SAMPLE_UNITS[sensor]:
            known = ", ".join(SAMPLE_UNITS[sensor])
            msg = f"the unit {unit!r} of the {sensor} is not known; expected one of {known}"
            raise ChoiceError(msg)
        return SAMPLE_UNITS[sensor][unit], f"{unit}, given"
    standard = topic.carrier is not None and topic.carrier.standard
    how = "from the message type" if standard else "assumed for this message type"
    return 1.0, f"{sensor.unit}, {how}"


def _temperature(columns: Columns, reading: ClockReading) -> Temperature | None:
    if columns.temperature is None or not columns.temperature.any():
        return None
    order: IntArray | None = reading.order
    samples = columns.temperature if order is None else columns.temperature[order]
    return Temperature(samples=samples, clock=reading.clock)


def _unique(findings: list[Finding]) -> list[Finding]:
    return list(dict.fromkeys(findings))
