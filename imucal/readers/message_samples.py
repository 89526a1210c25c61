"""Decoded columns of a topic -> sensors of a recording: their rows, their order and their clock."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import BoolArray, FloatArray, IntArray, blocks, release
from imucal.errors import ChoiceError
from imucal.findings import Finding
from imucal.readers.builder import RecordingBuilder
from imucal.readers.clocks import LOG_TIME, ClockReading, clock_from_stamps, compare_clocks, repeats
from imucal.readers.containers import Container
from imucal.readers.messages import Choice, Column, Topic, plan_of
from imucal.readers.messages.trees import TIME
from imucal.readers.read_options import ReadOptions
from imucal.readers.scales import Unscaled
from imucal.readers.store import Block, Room, count, is_constant
from imucal.readers.tables.layout import is_number
from imucal.readers.tables.plan import SensorPlan, TablePlan
from imucal.readers.tables.stamps import TimeChoice
from imucal.readers.tables.tabular import add_temperature, stamps_of
from imucal.recording import Sensor

#: Name of the time in the messages.
HEADER = "header stamp"


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """What to read of a topic: the plan of its sensors, their time, and the columns to decode."""

    topic: Topic
    plan: TablePlan
    #: None for the log time.
    time: TimeChoice | None
    columns: Sequence[Column]

    def of(self, block: Block, indices: Sequence[int]) -> list[NDArray[Any]]:
        """Return columns of the table in a block of decoded ones, which begins with the log time."""
        return [block[1 + self.columns.index(self.topic.columns[index])] for index in indices]

    def times(self, block: Block) -> list[NDArray[Any]]:
        """Return the columns of the time."""
        return self.of(block, self.time.indices) if self.time else []

    def axes(self, block: Block) -> dict[Sensor, list[FloatArray]]:
        """Return the samples of each sensor."""
        triads = [sensor.triad for sensor in self.plan.sensors]
        return {
            triad.sensor: [np.asarray(axis, np.float64) for axis in self.of(block, triad.indices)]
            for triad in triads
        }

    @property
    def has_stamp(self) -> bool:
        """Whether the time is a stamp of seconds and nanoseconds, which was decoded as ns."""
        return self.time is not None and self.topic.columns[self.time.indices[0]].type == TIME


def job_of(containers: Sequence[Container], choice: Choice, options: ReadOptions) -> Job:
    """Return what to read of a chosen topic; raises ChoiceError if it is not clear."""
    topic = choice.topic
    plan, _ = plan_of(containers, topic, options)
    sensors = tuple(sensor for sensor in plan.sensors if sensor.triad.sensor in choice.sensors)
    # The log time is better than a count of samples, or their steps.
    time = sensors[0].time
    time = None if time is None or time.kind in {"counter", "steps"} else time
    indices = [*(time.indices if time else ())]
    for sensor in sensors:
        indices += [*sensor.triad.indices, *_row_columns(topic, sensors, sensor)]
    indices += [] if plan.temperature is None else [plan.temperature]
    columns = [topic.columns[index] for index in dict.fromkeys(indices)]
    job = Job(topic, replace(plan, sensors=sensors), time, columns)
    if options.time_unit is not None and (time is None or job.has_stamp):
        msg = (
            f"the time unit {options.time_unit} does not apply: time stamps are seconds and nanoseconds; "
            "omit it, or name a time of one number in a columns text"
        )
        raise ChoiceError(msg)
    return job


def _row_columns(topic: Topic, sensors: Sequence[SensorPlan], sensor: SensorPlan) -> list[int]:
    """Return the column that selects the messages of a sensor, if there is one."""
    rows = sensor.triad.rows
    if rows is None and sensors[0].triad.rows is None:
        return []
    if rows is None or rows[0] < 0 or rows != sensors[0].triad.rows or not is_number(rows[1]):
        msg = f"topic {topic.name}: messages are selected by one number for both sensors, such as @id:1"
        raise ChoiceError(msg)
    return [rows[0]]


def add_topic(work: RecordingBuilder, job: Job, block: Block, *, alone: bool) -> None:
    """Add the sensors of one topic; `alone` if it is the only one."""
    plan, sensors = job.plan, job.plan.sensors
    block = _chosen_rows(work, job, block)
    log, times = block[0], _times(work, job, block)
    heat = job.of(block, [] if plan.temperature is None else [plan.temperature])
    work.findings += in_time_order(times, log, block[1:], work.room)
    axes = job.axes(block)
    reading = _clock(work, job, times, log, axes)
    label = sensors[0].triad.sensor.short if not alone and len(sensors) == 1 else None
    work.findings += [replace(finding, axis=label) for finding in reading.findings]
    if reading.clock.source == HEADER:
        work.findings += compare_clocks(times, log)
    release(times, *block)
    work.decisions.append(("time", reading.clock.source))
    work.decisions += plan.decisions if plan.dialect is None else ()
    work.findings += plan.findings if alone else ()
    for sensor in sensors:
        work.findings += _without_data(job.topic, sensor.triad.sensor, axes)
    unscaled = [
        Unscaled(
            sensor=sensor.triad.sensor,
            rows=axes[sensor.triad.sensor],
            clock=reading.clock,
            order=reading.order,
            axes=sensor.triad.axes,
            stated=sensor.stated,
        )
        for sensor in sensors
        if not is_constant(axes[sensor.triad.sensor])
    ]
    work.add(unscaled, where=f"{work.path}: topic {job.topic.name}")
    if heat and heat[0].any():
        add_temperature(work, heat[0], reading)


def _without_data(
    topic: Topic, sensor: Sensor, axes: Mapping[Sensor, Sequence[FloatArray]]
) -> Iterator[Finding]:
    """Yield the finding of a sensor whose samples never change."""
    if is_constant(axes[sensor]):
        value = ", ".join(f"{row[0]:g}" for row in axes[sensor])
        text = f"The {sensor} of topic {topic.name} is always ({value}): no data."
        yield Finding("warning", "no-data", text, axis=sensor.short)


def _chosen_rows(work: RecordingBuilder, job: Job, block: Block) -> Block:
    """Return the messages that a columns text selects and that have a finite time."""
    keep: BoolArray | None = None
    rows = job.plan.sensors[0].triad.rows
    if rows is not None:
        keep = job.of(block, [rows[0]])[0] == float(rows[1])
    for column in job.times(block):
        finite = np.isfinite(column) if column.dtype.kind == "f" else None
        if finite is not None and not finite.all():
            text = f"{count(~finite)} messages have no finite time; they were dropped."
            work.findings.append(Finding("warning", "bad-rows", text))
            keep = finite if keep is None else keep & finite
    return block if keep is None else [work.room.chosen(column, keep) for column in block]


def _times(work: RecordingBuilder, job: Job, block: Block) -> IntArray:
    """Return the times of messages in ns: their stamps, or the log times."""
    columns = job.times(block)
    if job.time is None or job.has_stamp:
        return columns[0] if columns else block[0]
    stamps = stamps_of(work, job.time, columns, job.plan.sensors[0].triad.sensor)
    return block[0] if stamps is None else stamps


def _clock(
    work: RecordingBuilder,
    job: Job,
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
