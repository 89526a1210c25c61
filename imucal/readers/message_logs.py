"""Logs of messages -> Recording: choose topics, decode them in order, and give each sensor its clock."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imucal.arrays import IntArray, blocks, release
from imucal.errors import ChoiceError, DataError, ReadError
from imucal.findings import Finding
from imucal.readers.builder import RecordingBuilder
from imucal.readers.clocks import LOG_TIME, ClockReading, clock_from_stamps, compare_clocks, repeats
from imucal.readers.containers.container import Container, Loss, OpenFiles
from imucal.readers.contents import LogContents, TopicContents
from imucal.readers.files import refused
from imucal.readers.messages import (
    Choice,
    Topic,
    choose,
    decode,
    find_topics,
    live_sensors,
    read_temperature,
    stream_of,
)
from imucal.readers.messages.leaves import MOST
from imucal.readers.messages.loader import Stream, first_message
from imucal.readers.messages.message_types import EACH, ImuFields, parse_fields_text
from imucal.readers.messages.topic_streams import first_frames
from imucal.readers.messages.trees import TreeDecoder, spread_times
from imucal.readers.read_options import ReadOptions
from imucal.readers.scales import UnitGuess, Unscaled
from imucal.readers.store import Columns, Room, is_constant
from imucal.recording import Recording, Sensor

#: Codes of findings that say a log is damaged.
DAMAGE = frozenset({"truncated", "unindexed", "crc", "damaged", "index", "compression", "encapsulation",
                    "definition"})  # fmt: skip

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
        contents = [_contents(containers, topic) for topic in topics]
    if not any(entry.sensors for entry in contents):
        contents = [_with_proposal(entry, topic) for entry, topic in zip(contents, topics, strict=True)]
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


def _with_proposal(entry: TopicContents, topic: Topic) -> TopicContents:
    """Return an entry with the fields text that might read it, where nothing else is said of it."""
    text = topic.proposal if topic.count and not entry.note else None
    return replace(entry, note=f"can be read with a fields text such as {text!r}") if text else entry


def _contents(containers: Sequence[Container], topic: Topic) -> TopicContents:
    sensors: tuple[Sensor, ...] = ()
    note = topic.reason
    if topic.imu is not None and topic.count != 0:
        try:
            alive = live_sensors(containers, topic)
        except ReadError as error:
            alive, note = frozenset(), str(error)
        sensors = tuple(sensor for sensor in topic.imu.sensors if sensor in alive)
        silent = [sensor for sensor in topic.imu.sensors if sensor not in alive]
        note = note or (" and ".join(silent) + " constant: no data" if silent else "")
        note = note or ("read only if it is named" if topic.imu.plain else "")
    return TopicContents(
        name=topic.name,
        type=topic.type,
        count=topic.count,
        rate_hz=topic.rate_hz,
        duration_s=topic.duration_s,
        sensors=sensors,
        note=note,
        fields=tuple(map(str, topic.leaves.all[:MOST])),
    )


def _read(containers: Sequence[Container], path: Path, options: ReadOptions, form: str) -> Recording:
    _refuse_options(path, options)
    with _naming(path):
        topics = find_topics(containers, options)
        choices = choose(path, topics, options, lambda topic: live_sensors(containers, topic))
        streams = [stream_of(choice.topic, choice.sensors) for choice in choices]
    decodings = decode(containers, streams, limit=options.memory_limit, progress=options.progress)
    work = RecordingBuilder(path=str(path), format=form, options=options)
    work.findings += [finding for container in containers for finding in container.findings]
    work.decisions += [("topic", f"{choice.topic.name}: {choice.how}") for choice in choices]
    work.decisions += first_frames(containers, choices)
    for choice, stream, decoding in zip(choices, streams, decodings, strict=True):
        work.findings += [
            *_loss_findings(decoding.losses, decoding.missing),
            *_other_elements(containers, choice.topic, stream),
        ]
        if not decoding.columns.n:
            seen = [loss.text for loss in decoding.losses] + [finding.text for finding in work.findings]
            why = next(iter(seen), "the log has none")
            raise refused(path, f"no message of topic {choice.topic.name} could be read: {why}")
        _add_topic(work, choice, decoding.columns, options, alone=len(choices) == 1)
    beside = None
    if work.temperature is None:
        beside = read_temperature(containers, topics, choices[0].topic.name)
    if beside is not None:
        work.temperature, name = beside
        work.decisions.append(("temperature", f"{name}: the only one besides the IMU's"))
    _require_samples(work, path, options)
    return work.build(
        topics=[choice.topic.name for choice in choices],
        message_types=[choice.topic.type for choice in choices],
    )


def _require_samples(work: RecordingBuilder, path: Path, options: ReadOptions) -> None:
    """Refuse a damaged log where that is asked for, and one in which nothing changes."""
    damage = [finding for finding in work.findings if finding.code in DAMAGE]
    if options.strict and damage:
        raise refused(path, f"the log is damaged, and strict reading was requested: {damage[0].text}")
    if not work.series:
        texts = "; ".join(finding.text for finding in work.findings) or "no data"
        raise refused(path, f"no sensor has samples that change: {texts}", DataError)


def _refuse_options(path: Path, options: ReadOptions) -> None:
    named = parse_fields_text(options.fields)
    if options.time_unit is not None and (named is None or len(named.time) != 1):
        msg = (
            f"{path}: the time unit {options.time_unit} does not apply: time stamps are seconds and "
            "nanoseconds; omit it, or name a time of one number in a fields text"
        )
        raise ChoiceError(msg)
    if options.time not in {None, "header", "log"}:
        raise ChoiceError(f"{path}: messages have no time called {options.time!r}; expected header or log")
    if options.columns is not None:
        msg = f"{path}: messages have no columns; omit {options.columns!r}, or give the name of a topic"
        raise ChoiceError(msg)


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


def _add_topic(
    work: RecordingBuilder, choice: Choice, columns: Columns, options: ReadOptions, *, alone: bool
) -> None:
    """Add the sensors of one topic."""
    topic = choice.topic
    imu = topic.imu or ImuFields(stamp=None, vectors=())
    vectors = {vector.sensor: vector for vector in imu.vectors}
    work.findings += _other_vectors(topic, imu)
    work.findings += in_time_order(columns, work.room)
    spread_lists(imu, columns, work.room)
    reading = _clock(work, topic, columns, options)
    clock, order = reading.clock, reading.order
    label = choice.sensors[0].short if not alone and len(choice.sensors) == 1 else None
    work.findings += [replace(finding, axis=label) for finding in reading.findings]
    if clock.source == HEADER:
        work.findings += compare_clocks(columns.stamps, columns.log)
    release(*columns.rows)
    work.decisions.append(("time", clock.source))
    usual = "from the message type" if imu.standard else "assumed for this message type"
    unscaled = []
    for sensor, rows in columns.vectors.items():
        if is_constant(rows):
            value = ", ".join(f"{row[0]:g}" for row in rows)
            text = f"The {sensor} of topic {topic.name} is always ({value}): no data."
            work.findings.append(Finding("warning", "no-data", text, axis=sensor.short))
            continue
        vector = vectors[sensor]
        stated: UnitGuess | None = UnitGuess(usual, sensor.unit, assumed=not imu.standard)
        if imu.asked:
            # Nothing is known of fields that a user named but what stands in their names.
            own = UnitGuess("from the column header", vector.unit)
            stated = own if vector.unit else None
        unscaled.append(
            Unscaled(sensor=sensor, rows=rows, clock=clock, order=order, axes=vector.axes, stated=stated)
        )
    work.add(unscaled, where=f"{work.path}: topic {topic.name}")
    if columns.temperature is not None and columns.temperature.any():
        work.add_temperature(columns.temperature, clock, order=order)


def _other_vectors(topic: Topic, imu: ImuFields) -> Iterator[Finding]:
    if imu.others:
        read = " and ".join(vector.field for vector in imu.vectors)
        text = f"Messages of {topic.name} also contain {', '.join(imu.others)}; {read} were read."
        yield Finding("warning", "other-vectors", text)


def _other_elements(containers: Sequence[Container], topic: Topic, stream: Stream) -> list[Finding]:
    """Return a finding for each list of which one element was read and others were not."""
    lengths: dict[str, int] = {}
    for (number, key), decoder in stream.decoders.items():
        if isinstance(decoder, TreeDecoder):
            lengths |= decoder.lengths(first_message(containers[number], key) or b"")
    texts = [
        f"Messages of {topic.name} contain {count} elements of {name}; one was read. If all are samples of "
        f"one sensor, use {name}{EACH}."
        for name, count in lengths.items()
        if count > 1
    ]
    return [Finding("warning", "other-vectors", text) for text in texts]


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


def spread_lists(imu: ImuFields, columns: Columns, room: Room) -> None:
    """Give the elements of lists that have no stamps of their own their times."""
    if not imu.lists:
        return
    stamps, log = room.copied(columns.stamps), room.copied(columns.log)
    if imu.stamp is None or EACH not in imu.stamp.sec:
        spread_times(columns.stamps, (stamps, log))
    spread_times(columns.log, (log,))


def in_time_order(columns: Columns, room: Room) -> list[Finding]:
    """Sort samples by log time where the file does not hold them in that order, in place.

    Files are joined, channels merged and chunks written by several threads; a recorder's clock that was
    set back is none of these. So nothing is sorted where it brings the stamps out of order.
    """
    late = steps_back(columns.log)
    if not late:
        return []
    orders = [
        (first, np.argsort(columns.log[first:stop], kind="stable")) for first, stop in unsorted(columns.log)
    ]
    sorted_stamps = room.copied(columns.stamps)
    for first, order in orders:
        sorted_stamps[first : first + order.size] = columns.stamps[first + order]
    if steps_back(sorted_stamps) > steps_back(columns.stamps):
        text = (
            f"The log time goes back {late} times and the time stamps do not; the order of the file is kept."
        )
    else:
        for first, order in orders:
            columns.reorder(first, order)
        text = f"{late} messages were out of order; they were sorted by log time."
    return [Finding("info", "log-out-of-order", text)]


def _clock(work: RecordingBuilder, topic: Topic, columns: Columns, options: ReadOptions) -> ClockReading:
    """Return the clock of a topic's samples: by their stamps, or by the log time where that is wanted."""
    own = topic.imu is not None and topic.imu.stamp is not None
    by_log = options.time == "log"
    # A sensor alone may well give the same values twice.
    rows = [row for rows in columns.vectors.values() for row in rows] if len(columns.vectors) > 1 else []
    return clock_from_stamps(
        columns.log if by_log else columns.stamps,
        source=LOG_TIME if by_log else (HEADER if own else "stamp"),
        where=f"{work.path}: topic {topic.name}",
        log_ns=columns.log,
        rate_hz=options.rate_hz,
        repeated=repeats(columns.stamps, rows, work.room) if rows else None,
        room=work.room,
    )
