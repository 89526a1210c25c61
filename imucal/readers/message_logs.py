"""Logs of messages -> Recording: choose topics, decode them in order, and give each sensor its clock."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray, blocks, release
from imucal.errors import ChoiceError, DataError, ReadError
from imucal.findings import Finding
from imucal.readers.builder import RecordingBuilder
from imucal.readers.clocks import LOG_TIME, ClockReading, clock_from_stamps, compare_clocks, repeats
from imucal.readers.containers.container import Container, Loss, OpenFiles
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.files import refused
from imucal.readers.messages.choice import Choice, choose
from imucal.readers.messages.loader import decode
from imucal.readers.messages.surroundings import first_frames, read_temperature, temperature_beside
from imucal.readers.messages.topics import Column, Topic, find_topics, plan_of
from imucal.readers.messages.trees import TIME
from imucal.readers.read_options import ReadOptions
from imucal.readers.scales import Unscaled
from imucal.readers.store import Block, Room, count, is_constant
from imucal.readers.tables.plan import TablePlan
from imucal.readers.tables.stamps import TimeChoice
from imucal.readers.tables.tabular import add_temperature, stamps_of
from imucal.recording import Recording, Sensor

#: Codes of findings that say a log is damaged.
DAMAGE = frozenset({"truncated", "unindexed", "crc", "damaged", "index", "compression", "encapsulation",
                    "definition"})  # fmt: skip

#: Fields of messages that are listed.
_MOST = 60

#: Name of the time in the messages.
HEADER = "header stamp"


@dataclass(frozen=True, slots=True)
class MessageReader:
    """The reader of a format whose files are containers of messages."""

    open_files: OpenFiles

    def read(self, path: Path, options: ReadOptions) -> Recording:
        """Read the IMU topic of a log.

        Raises ReadError if the log can't be read; ChoiceError if several topics fit or none does.
        """
        containers, form = self.open_files(path, options.progress)
        with _closing(containers):
            return _read(containers, path, options, form)

    def describe(self, path: Path, options: ReadOptions) -> LogContents:
        """Return the topics of a log, by its index."""
        containers, form = self.open_files(path, options.progress)
        return describe_logs(containers, path, options, form=form)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Name the log in errors that know only its topics."""
    try:
        yield
    except ReadError as error:
        if str(error).startswith(str(path)):
            raise
        raise type(error)(f"{path}: {error}") from error


def _closing(containers: Sequence[Container]) -> ExitStack:
    """Return what closes containers at the end of its block."""
    closed = ExitStack()
    for container in containers:
        closed.callback(container.close)
    return closed


def describe_logs(
    containers: Sequence[Container], path: Path, options: ReadOptions, *, form: str
) -> LogContents:
    """Return the topics of the files of one log, which the user named `path`, and close them."""
    with _closing(containers):
        with _naming(path):
            topics = find_topics(containers, options)
        contents = [_contents(containers, topic, options) for topic in topics]
    starts = [c.start_ns for c in containers if c.start_ns is not None]
    ends = [c.end_ns for c in containers if c.end_ns is not None]
    return LogContents(
        path=str(path),
        format=form,
        size_bytes=sum(container.size for container in containers),
        topics=tuple(contents),
        start_ns=min(starts, default=None),
        duration_s=(max(ends) - min(starts)) / 1e9 if starts and ends else None,
        compression=", ".join(sorted({container.compression for container in containers})),
        findings=tuple(finding for container in containers for finding in container.findings),
    )


def _contents(containers: Sequence[Container], topic: Topic, options: ReadOptions) -> TopicContents:
    sensors: tuple[Sensor, ...] = ()
    note = topic.reason
    if topic.sensors and topic.count != 0:
        try:
            plan, alive = plan_of(containers, topic, options)
        except ReadError as error:
            alive, note = frozenset(), str(error).removeprefix(f"topic {topic.name}: ")
        else:
            silent = [one.triad.sensor for one in plan.sensors if one.triad.sensor not in alive]
            note = " and ".join(silent) + " constant: no data" if silent else ""
        sensors = tuple(sensor for sensor in topic.sensors if sensor in alive)
        note = note or ("read only if it is named" if topic.plain else "")
    return TopicContents(
        name=topic.name,
        type=topic.type,
        count=topic.count,
        rate_hz=topic.rate_hz,
        duration_s=topic.duration_s,
        sensors=sensors,
        note=note,
        fields=tuple(map(str, topic.leaves[:_MOST])),
    )


def _live(containers: Sequence[Container], topic: Topic, options: ReadOptions) -> frozenset[Sensor]:
    """Return the sensors of a topic whose samples change; all if it is not clear which columns are theirs."""
    try:
        return plan_of(containers, topic, options)[1]
    except ChoiceError:
        return frozenset(topic.sensors)


def _read(containers: Sequence[Container], path: Path, options: ReadOptions, form: str) -> Recording:
    with _naming(path):
        topics = find_topics(containers, options)
        choices = choose(path, topics, options, lambda topic: _live(containers, topic, options))
        jobs = [_job(containers, choice, options) for choice in choices]
        streams = [job.topic.stream(job.columns) for job in jobs]
    decodings = decode(containers, streams, limit=options.memory_limit, progress=options.progress)
    work = RecordingBuilder(path=str(path), format=form, options=options)
    work.findings += [finding for container in containers for finding in container.findings]
    work.decisions += [("topic", f"{choice.topic.name}: {choice.how}") for choice in choices]
    work.decisions += first_frames(containers, [choice.topic for choice in choices])
    for job, decoding in zip(jobs, decodings, strict=True):
        work.findings += _loss_findings(decoding.losses, decoding.missing)
        if not decoding.columns[0].size:
            seen = [loss.text for loss in decoding.losses] + [finding.text for finding in work.findings]
            why = next(iter(seen), "the log has none")
            raise refused(path, f"no message of topic {job.topic.name} could be read: {why}")
        with _naming(path):
            _add_topic(work, job, decoding.columns, alone=len(jobs) == 1)
    beside = temperature_beside(topics, jobs[0].topic.name) if work.temperature is None else None
    if beside is not None:
        work.temperature = read_temperature(containers, beside)
        if work.temperature is not None:
            work.decisions.append(("temperature", f"{beside.name}: the only one besides the IMU's"))
    _require_samples(work, path, options)
    return work.build(
        topics=[choice.topic.name for choice in choices],
        message_types=[choice.topic.type for choice in choices],
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    """What to read of a topic: the plan of its sensors, their time, and the columns to decode."""

    topic: Topic
    plan: TablePlan
    #: None for the log time.
    time: TimeChoice | None
    columns: Sequence[Column]

    def places(self, *indices: int) -> list[int]:
        """Return the places of columns of the table in a block of decoded columns."""
        return [1 + self.columns.index(self.topic.columns[index]) for index in indices]


def _job(containers: Sequence[Container], choice: Choice, options: ReadOptions) -> _Job:
    """Return what to read of a chosen topic; raises ChoiceError if it is not clear."""
    topic = choice.topic
    plan, _ = plan_of(containers, topic, options)
    sensors = tuple(sensor for sensor in plan.sensors if sensor.triad.sensor in choice.sensors)
    plan = replace(plan, sensors=sensors)
    # A count of samples, or their steps, is less than the log time.
    time = sensors[0].time
    time = None if time is None or time.kind in {"counter", "steps"} else time
    if options.time_unit is not None and (time is None or topic.columns[time.indices[0]].type == TIME):
        msg = (
            f"the time unit {options.time_unit} does not apply: time stamps are seconds and nanoseconds; "
            "omit it, or name a time of one number in a columns text"
        )
        raise ChoiceError(msg)
    rows = {sensor.triad.rows for sensor in sensors}
    if len(rows) > 1 or any(one is not None and one[0] < 0 for one in rows):
        msg = f"topic {topic.name}: rows of messages are chosen by one number for both sensors, such as @id:1"
        raise ChoiceError(msg)
    wanted = [*(time.indices if time else ()), *(i for sensor in sensors for i in sensor.triad.indices)]
    wanted += [one[0] for one in rows if one is not None]
    wanted += [] if plan.temperature is None else [plan.temperature]
    return _Job(topic, plan, time, [topic.columns[index] for index in dict.fromkeys(wanted)])


def _require_samples(work: RecordingBuilder, path: Path, options: ReadOptions) -> None:
    """Refuse a damaged log where that is asked for, and one in which nothing changes."""
    damage = [finding for finding in work.findings if finding.code in DAMAGE]
    if options.strict and damage:
        raise refused(path, f"the log is damaged, and strict reading was requested: {damage[0].text}")
    if not work.series:
        texts = "; ".join(finding.text for finding in work.findings) or "no data"
        raise refused(path, f"no sensor has samples that change: {texts}", DataError)


def _loss_findings(losses: Sequence[Loss], missing: int | None = None) -> list[Finding]:
    """Return one finding for each kind of loss; `missing` messages are in parts that could not be read."""
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
            # The file's count does not distinguish the reasons.
            count = _lost(lost + missing) if len(unread) == 1 else f"{_lost(missing)} in all unreadable parts"
        text = f"The log is damaged in {where}: {same[0].text}; {count}."
        findings.append(Finding("warning", code, text))
    return findings


def _lost(n: int) -> str:
    return f"about {n} messages are lost" if n else "no message is lost"


def _add_topic(work: RecordingBuilder, job: _Job, block: Block, *, alone: bool) -> None:
    """Add the sensors of one topic."""
    topic, plan, sensors = job.topic, job.plan, job.plan.sensors
    block, lost = _chosen_rows(job, block, work.room)
    log = block[0]
    own = [block[at] for at in job.places(*job.time.indices)] if job.time else []
    stamps: IntArray | None = log
    if job.time and topic.columns[job.time.indices[0]].type == TIME:
        stamps = own[0]
    elif job.time:
        stamps = stamps_of(work, job.time, own, sensors[0].triad.sensor)
    times = log if stamps is None else stamps
    used = job.places(*(i for sensor in sensors for i in sensor.triad.indices))
    heat = None if plan.temperature is None else block[job.places(plan.temperature)[0]]
    rest = [block[at] for at in dict.fromkeys(used)] + ([] if heat is None else [heat])
    work.findings += [*lost, *in_time_order(times, log, rest, work.room)]
    axes = {
        sensor.triad.sensor: [np.asarray(block[at], np.float64) for at in job.places(*sensor.triad.indices)]
        for sensor in sensors
    }
    reading = _clock(work, job, times, log, axes)
    clock, order = reading.clock, reading.order
    label = sensors[0].triad.sensor.short if not alone and len(sensors) == 1 else None
    work.findings += [replace(finding, axis=label) for finding in reading.findings]
    if clock.source == HEADER:
        work.findings += compare_clocks(times, log)
    release(times, log, *rest)
    work.decisions.append(("time", clock.source))
    if plan.dialect is None:
        work.decisions += plan.decisions
    work.findings += plan.findings if alone else ()
    unscaled = []
    for sensor in sensors:
        triad, rows = sensor.triad, axes[sensor.triad.sensor]
        if is_constant(rows):
            value = ", ".join(f"{row[0]:g}" for row in rows)
            text = f"The {triad.sensor} of topic {topic.name} is always ({value}): no data."
            work.findings.append(Finding("warning", "no-data", text, axis=triad.sensor.short))
            continue
        entry = Unscaled(sensor=triad.sensor, rows=rows, clock=clock, order=order, axes=triad.axes)
        unscaled.append(replace(entry, stated=sensor.stated))
    work.add(unscaled, where=f"{work.path}: topic {topic.name}")
    if heat is not None and heat.any():
        add_temperature(work, heat, reading)


def _chosen_rows(job: _Job, block: Block, room: Room) -> tuple[Block, list[Finding]]:
    """Return the messages that a columns text chooses and that have a finite time."""
    keep: BoolArray | None = None
    rows = job.plan.sensors[0].triad.rows
    if rows is not None:
        keep = block[job.places(rows[0])[0]] == float(rows[1])
    times = [block[at] for at in job.places(*(job.time.indices if job.time else ()))]
    findings = []
    for column in times:
        finite = np.isfinite(column) if column.dtype.kind == "f" else None
        if finite is not None and not finite.all():
            text = f"{count(~finite)} messages have no finite time; they were dropped."
            findings.append(Finding("warning", "bad-rows", text))
            keep = finite if keep is None else keep & finite
    return (block if keep is None else [room.chosen(column, keep) for column in block]), findings


def steps_back(times: IntArray) -> int:
    """Return how many times are earlier than the one before."""
    return sum(
        int(np.count_nonzero(times[part.start + 1 : part.stop + 1] < times[part]))
        for part in blocks(times.size - 1, times)
    )


def unsorted(times: IntArray) -> Iterator[tuple[int, int]]:
    """Yield the parts (start, stop) that must be sorted, each for itself, so that all times are in order.

    A cut is a place before which nothing is later than anything after it; between two cuts lies a part.
    """
    lowest = [int(times[part].min()) for part in blocks(times.size, times)]
    # The lowest of all times behind each block.
    behind = [*np.minimum.accumulate(lowest[::-1])[::-1].tolist()[1:], np.iinfo(np.int64).max]
    begun, highest = 0, np.iinfo(np.int64).min
    for part, low in zip(blocks(times.size, times), behind, strict=True):
        block = times[part]
        before = np.maximum.accumulate(np.concatenate([[highest], block]))
        after = np.minimum(np.minimum.accumulate(block[::-1])[::-1], low)
        cuts = np.concatenate([[begun], np.flatnonzero(before[:-1] <= after) + part.start])
        long = np.flatnonzero(np.diff(cuts) > 1)
        yield from zip(cuts[long].tolist(), cuts[long + 1].tolist(), strict=True)
        begun, highest = int(cuts[-1]), before[-1]
    if times.size - begun > 1:
        yield begun, times.size


def in_time_order(stamps: IntArray, log: IntArray, others: Block, room: Room) -> list[Finding]:
    """Sort samples by log time where the file does not hold them in that order, in place.

    Files are joined, channels merged and chunks written by several threads; a recorder's clock that was
    set back is none of these. So nothing is sorted where it brings the stamps out of order.
    """
    late = steps_back(log)
    if not late:
        return []
    orders = [(first, np.argsort(log[first:stop], kind="stable")) for first, stop in unsorted(log)]
    sorted_stamps = room.copied(stamps)
    for first, order in orders:
        sorted_stamps[first : first + order.size] = stamps[first + order]
    if steps_back(sorted_stamps) > steps_back(stamps):
        text = (
            f"The log time goes back {late} times and the time stamps do not; the order of the file is kept."
        )
    else:
        for row in {id(row): row for row in (stamps, log, *others)}.values():
            for first, order in orders:
                part = row[first : first + order.size]
                part[:] = part[order]
        text = f"{late} messages were out of order; they were sorted by log time."
    return [Finding("info", "log-out-of-order", text)]


def _clock(
    work: RecordingBuilder,
    job: _Job,
    stamps: IntArray,
    log: IntArray,
    axes: Mapping[Sensor, Sequence[FloatArray]],
) -> ClockReading:
    """Return the clock of a topic's samples: by their stamps, or by the log time where that is wanted."""
    by_log = work.options.time == "log"
    # A sensor alone may well give the same values twice.
    rows = [row for rows in axes.values() for row in rows] if len(axes) > 1 else []
    return clock_from_stamps(
        log if by_log else stamps,
        source=LOG_TIME if by_log or job.time is None else HEADER,
        where=f"{work.path}: topic {job.topic.name}",
        log_ns=log,
        rate_hz=work.options.rate_hz,
        repeated=repeats(stamps, rows, work.room) if rows else None,
        room=work.room,
    )
