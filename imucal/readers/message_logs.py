"""Logs of messages -> Recording: choose topics, decode them in order, and report losses."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from imucal.errors import ChoiceError, DataError, ReadError
from imucal.findings import Finding
from imucal.readers.builder import RecordingBuilder
from imucal.readers.containers.container import Container, Loss, OpenFiles
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.files import refused
from imucal.readers.message_samples import Job, job_of, sensor_columns
from imucal.readers.messages import Topic, choose, decode, find_topics, plan_of
from imucal.readers.messages.loader import Decoding
from imucal.readers.messages.surroundings import first_frames, read_temperature, temperature_topic
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.tabular import SensorColumns, assemble
from imucal.recording import Recording, Sensor

#: Most topics of a log; finding the sensors of one takes 1 ms.
_MAX_TOPICS = 5000
DAMAGE = frozenset({"truncated", "unindexed", "crc", "damaged", "index", "compression", "encapsulation",
                    "definition"})  # fmt: skip

_MAX_FIELDS = 60


@dataclass(frozen=True, slots=True)
class MessageReader:
    """Reader of a format whose files contain messages."""

    open_files: OpenFiles

    def read(self, path: Path, options: ReadOptions) -> Recording:
        """Read the IMU topic of a log.

        Raises ReadError if the log can't be read; ChoiceError if several topics fit or none does.
        """
        containers, form = self.open_files(path, options.progress)
        with _opened(containers, path, options, form) as log:
            return read_log(log, options)

    def describe(self, path: Path, options: ReadOptions) -> LogContents:
        containers, form = self.open_files(path, options.progress)
        return describe_logs(containers, path, options, form=form)


@dataclass(frozen=True, slots=True, eq=False)
class OpenLog:
    """An open log: the path as given, its format, topics and files."""

    path: Path
    form: str
    topics: Sequence[Topic]
    findings: Sequence[Finding] = ()
    #: Empty if the topics are in memory.
    containers: Sequence[Container] = ()
    #: Sampling rate in the log, in Hz.
    rate_hz: float | None = None


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    try:
        yield
    except ReadError as error:
        # The place may be a file in a folder.
        if error.place.startswith(str(path)):
            raise
        raise error.within(path) from error


def describe_logs(
    containers: Sequence[Container], path: Path, options: ReadOptions, *, form: str
) -> LogContents:
    """Return the topics of a log's files, and close them."""
    with _opened(containers, path, options, form) as log:
        topics = describe_topics(log, options)
    starts = [c.start_ns for c in containers if c.start_ns is not None]
    ends = [c.end_ns for c in containers if c.end_ns is not None]
    return LogContents(
        path=str(path),
        format=form,
        size_bytes=sum(container.size for container in containers),
        topics=topics,
        start_ns=min(starts, default=None),
        duration_s=(max(ends) - min(starts)) / 1e9 if starts and ends else None,
        compression=", ".join(sorted({container.compression for container in containers})),
        findings=tuple(log.findings),
    )


@contextmanager
def _opened(
    containers: Sequence[Container], path: Path, options: ReadOptions, form: str
) -> Iterator[OpenLog]:
    with ExitStack() as closed:
        for container in containers:
            closed.callback(container.close)
        _refuse_many_topics(path, containers)
        with _naming(path):
            topics = find_topics(containers, options)
        findings = [finding for container in containers for finding in container.findings]
        yield OpenLog(path, form, topics, findings, containers)


def _refuse_many_topics(path: Path, containers: Sequence[Container]) -> None:
    n = max((len(container.channels) for container in containers), default=0)
    if n > _MAX_TOPICS:
        way = "copy those of the IMU to another log, such as with `mcap filter` or `ros2 bag convert`"
        raise refused(path, f"it contains {n} topics; expected at most {_MAX_TOPICS}; {way}")


def describe_topics(log: OpenLog, options: ReadOptions) -> tuple[TopicContents, ...]:
    """Describe all topics of a log."""
    return tuple(_contents(log.containers, topic, options) for topic in log.topics)


def _contents(containers: Sequence[Container], topic: Topic, options: ReadOptions) -> TopicContents:
    contents = TopicContents(
        name=topic.name,
        type=topic.type,
        count=topic.count,
        rate_hz=topic.rate_hz,
        duration_s=topic.duration_s,
        fields=tuple(map(str, topic.leaves[:_MAX_FIELDS])),
    )
    if not topic.sensors or topic.count == 0:
        return contents.refused(ReadError(topic.reason, fixes=topic.fixes)) if topic.reason else contents
    try:
        plan, alive = plan_of(containers, topic, options)
    except ReadError as error:
        return contents.refused(error)
    silent = [one.triad.sensor for one in plan.sensors if one.triad.sensor not in alive]
    note = "read only if it is named" if topic.plain else ""
    if silent:
        note = " and ".join(silent) + " constant: no data"
    sensors = tuple(sensor for sensor in topic.sensors if sensor in alive)
    return replace(contents, sensors=sensors, note=note)


def _live(containers: Sequence[Container], topic: Topic, options: ReadOptions) -> frozenset[Sensor]:
    """Return the sensors whose samples change; all if the columns are ambiguous."""
    try:
        return plan_of(containers, topic, options)[1]
    except ChoiceError:
        return frozenset(topic.sensors)


def read_log(log: OpenLog, options: ReadOptions) -> Recording:
    """Read the IMU topics of an open log."""
    path, containers = log.path, log.containers
    with _naming(path):
        choices = choose(path, log.topics, options, lambda topic: _live(containers, topic, options))
        jobs = [job_of(containers, choice, options) for choice in choices]
        decodings = _decoded(log, jobs, options)
    work = RecordingBuilder(path=str(path), format=log.form, options=options, rate_hz=log.rate_hz)
    work.findings += log.findings
    work.decisions += [("topic", f"{one.topic.name}: {one.how}") for one in choices if not one.topic.file]
    for frame in first_frames(containers, [choice.topic for choice in choices]):
        work.decide("frame", frame, value=frame)
    sensors = _sensors(work, jobs, decodings)
    where = f"{path}: {jobs[0].topic.where}" if len(jobs) == 1 and not jobs[0].topic.file else ""
    with _naming(path):
        assemble(work, [job.plan for job in jobs], sensors, where=where)
    _add_temperature(work, containers, log.topics, jobs[0].topic)
    _require_samples(work, path, options)
    if jobs[0].topic.file:
        return work.build(topics=[name for job in jobs for name in job.plan.topics])
    return work.build(
        topics=[choice.topic.name for choice in choices],
        message_types=[choice.topic.type for choice in choices],
    )


def _sensors(
    work: RecordingBuilder, jobs: Sequence[Job], decodings: Sequence[Decoding]
) -> list[SensorColumns]:
    sensors: list[SensorColumns] = []
    for job, decoding in zip(jobs, decodings, strict=True):
        work.findings += _loss_findings(decoding.losses, decoding.missing)
        work.findings += _count_findings(job.topic, decoding)
        if not decoding.columns[0].size:
            seen = [loss.text for loss in decoding.losses] + [finding.text for finding in work.findings]
            why = next(iter(seen), "the log has none")
            raise refused(work.path, f"no message of topic {job.topic.name} could be read: {why}")
        sensors += sensor_columns(work, job, decoding.columns)
    # Another topic may contain the missing sensor.
    found = {columns.plan.triad.sensor.short for columns in sensors if len(jobs) > 1}
    work.findings += [one for job in jobs for one in job.plan.findings if one.axis not in found]
    return sensors


def _decoded(log: OpenLog, jobs: Sequence[Job], options: ReadOptions) -> Sequence[Decoding]:
    if not log.containers:
        return [Decoding([job.topic.held[index] for index in job.indices], [], None) for job in jobs]
    streams = [job.topic.stream(job.columns) for job in jobs]
    return decode(log.containers, streams, limit=options.memory_limit, progress=options.progress)


def _add_temperature(
    work: RecordingBuilder, containers: Sequence[Container], topics: Sequence[Topic], imu: Topic
) -> None:
    if work.temperature is None and (topic := temperature_topic(topics, imu.name)):
        work.temperature = read_temperature(containers, topic)
        if work.temperature:
            work.decisions.append(("temperature", f"{topic.name}: the only one besides the IMU's"))


def _require_samples(work: RecordingBuilder, path: Path, options: ReadOptions) -> None:
    damage = [finding for finding in work.findings if finding.code in DAMAGE]
    if options.strict and damage:
        raise refused(path, f"the log is damaged, and strict reading was requested: {damage[0].text}")
    if not work.series:
        texts = "; ".join(finding.text for finding in work.findings) or "no data"
        raise refused(path, f"no sensor has samples that change: {texts}", DataError)


def _loss_findings(losses: Sequence[Loss], missing: int | None = None) -> list[Finding]:
    """Return one finding per kind of loss; `missing` messages are in unreadable parts."""
    findings = []
    unread = {loss.code for loss in losses if loss.messages is None}
    for code in dict.fromkeys(loss.code for loss in losses):
        same = [loss for loss in losses if loss.code == code]
        where = f"{len(same)} places" if len(same) > 1 else "one place"
        lost = sum(loss.messages or 0 for loss in same)
        if code not in unread:
            count = _lost(lost)
        elif missing is None:
            count = "the number of lost messages is unknown"
        else:
            # The count does not distinguish the reasons.
            count = _lost(lost + missing) if len(unread) == 1 else f"{_lost(missing)} in all unreadable parts"
        text = f"The log is damaged in {where}: {same[0].text}; {count}."
        findings.append(Finding("warning", code, text))
    return findings


def _count_findings(topic: Topic, decoding: Decoding) -> list[Finding]:
    """Return a finding if the log counts more messages of a topic than were found or reported as lost."""
    reported = [loss.messages for loss in decoding.losses]
    if decoding.missing is None or None in reported:
        return []
    lost = decoding.missing - sum(number or 0 for number in reported)
    if lost <= 0:
        return []
    text = f"The log counts {topic.count} messages of topic {topic.name}, and {lost} of them were not found."
    return [Finding("warning", "damaged", text, "Copy the log again.")]


def _lost(n: int) -> str:
    return f"about {n} messages are lost" if n else "no message is lost"
