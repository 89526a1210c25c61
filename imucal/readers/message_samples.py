"""Columns of a topic -> the columns of its sensors, in time order."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import BoolArray, FloatArray, IntArray, blocks
from imucal.errors import ChoiceError
from imucal.findings import Finding
from imucal.readers.builder import RecordingBuilder
from imucal.readers.clocks import LOG_TIME
from imucal.readers.containers import Container
from imucal.readers.fixes import COLUMNS
from imucal.readers.messages import Choice, Column, Topic, plan_of
from imucal.readers.messages.topics import HELD_ROWS, cells_of
from imucal.readers.messages.trees import TIME
from imucal.readers.read_options import ReadOptions
from imucal.readers.store import Block, Room, is_constant, join_rows
from imucal.readers.tables.dates import parse_texts, text_kind
from imucal.readers.tables.layout import is_number
from imucal.readers.tables.plan import SensorPlan, TablePlan
from imucal.readers.tables.stamps import Numbers, TimeChoice
from imucal.readers.tables.tabular import SensorColumns
from imucal.recording import Sensor
from imucal.resources import column_limit

HEADER = "header stamp"
#: The time of recording, which is not a column.
LOG = TimeChoice(kind="ns", indices=(), name=LOG_TIME)


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """The columns to read of a topic."""

    topic: Topic
    plan: TablePlan
    indices: tuple[int, ...]

    @property
    def columns(self) -> list[Column]:
        return [self.topic.columns[index] for index in self.indices]


def job_of(containers: Sequence[Container], choice: Choice, options: ReadOptions) -> Job:
    """Return the columns to read of a chosen topic; raises ChoiceError."""
    topic = choice.topic
    plan, _ = plan_of(containers, topic, options)
    chosen = [sensor for sensor in plan.sensors if sensor.triad.sensor in choice.sensors]
    if not topic.held:
        chosen = [_with_times(topic, chosen[0], sensor, options) for sensor in chosen]
    chosen = [replace(sensor, time=_in_ns(topic, sensor.time)) for sensor in chosen]
    indices: list[int] = []
    for sensor in chosen:
        indices += [*(sensor.time.indices if sensor.time else ()), *sensor.triad.indices]
        indices += [*(sensor.log_time.indices if sensor.log_time else ()), *_row_column(topic, sensor)]
    indices += [] if plan.temperature is None else [plan.temperature]
    decisions = plan.decisions if topic.file or plan.dialect is None else ()
    plan = replace(plan, sensors=tuple(chosen), decisions=decisions)
    return Job(topic, plan, tuple(dict.fromkeys(indices)))


def _with_times(topic: Topic, first: SensorPlan, sensor: SensorPlan, options: ReadOptions) -> SensorPlan:
    """Use the first sensor's time for a sensor in messages, or log time."""
    if sensor.triad.rows != first.triad.rows:
        raise _of_other_rows(topic)
    # Log time is better than a count of samples.
    own = first.time is not None and first.time.kind != "counter" and options.time != "log"
    return replace(sensor, time=first.time if own else LOG, log_time=LOG)


def _in_ns(topic: Topic, time: TimeChoice | None) -> TimeChoice | None:
    stamp = time is not None and time.indices and topic.columns[time.indices[0]].type == TIME
    return replace(time, kind="ns") if time is not None and stamp else time


def _row_column(topic: Topic, sensor: SensorPlan) -> list[int]:
    rows = sensor.triad.rows
    if rows is not None and (rows[0] < 0 or not (topic.held or is_number(rows[1]))):
        raise _of_other_rows(topic)
    return [] if rows is None else [rows[0]]


def _of_other_rows(topic: Topic) -> ChoiceError:
    text = "messages are selected by one number for both sensors, such as @id:1"
    return ChoiceError(text, place=topic.where, fix=COLUMNS)


@dataclass(frozen=True, slots=True, eq=False)
class _Values:
    """Columns read of a topic by index, and the log times."""

    topic: Topic
    temperature: int | None
    columns: Mapping[int, NDArray[Any]]
    log: Sequence[IntArray]

    def of(self, sensor: SensorPlan, axes: Mapping[Sensor, list[FloatArray]], room: Room) -> SensorColumns:
        topic, heat, rows = self.topic, None, sensor.triad.rows
        if self.temperature is not None:
            heat = np.asarray(self.columns[self.temperature], np.float64)
        # One sensor alone may repeat values by chance.
        compared = list(chain.from_iterable(axes.values())) if len(axes) > 1 else []
        columns = SensorColumns(
            plan=sensor,
            axes=axes[sensor.triad.sensor],
            time=self.times(sensor.time),
            log_time=self.times(sensor.log_time),
            temperature=heat if heat is not None and heat.any() else None,
            sparse=topic.sparse,
            table="" if topic.file else topic.where,
            source=self.source(sensor.time),
            compared=None if topic.held else compared,
        )
        return columns if rows is None else columns.rows(self.rows(rows), room)

    def axes(self, sensor: SensorPlan, limit: int) -> list[FloatArray]:
        """Return a sensor's samples; copies if in memory, because samples are scaled in place."""
        rows = [self.columns[index] for index in sensor.triad.indices]
        if not self.topic.held:
            return [np.asarray(row, np.float64) for row in rows]
        try:
            return join_rows([[row] for row in rows], limit=limit)
        except ValueError as error:
            text = f"the columns of the {sensor.triad.sensor} are not numbers: {error}"
            raise ChoiceError(text, place=self.topic.where, fix=COLUMNS) from error

    def times(self, time: TimeChoice | None) -> Sequence[Numbers]:
        if time is None or time is LOG:
            return [] if time is None else self.log
        found: list[Numbers] = []
        for column in map(self.columns.__getitem__, time.indices):
            if time.kind == "text":
                kind = text_kind(cells_of(column[:HELD_ROWS]))
                found.append(parse_texts(list(map(str, column)), kind, by_day=time.by_day))
            elif column.dtype.kind in "iu":
                found.append(column.astype(np.int64, copy=False))
            else:
                found.append(column.astype(np.float64, copy=False))
        return found

    def source(self, time: TimeChoice | None) -> str:
        """Return the source of a clock; empty for a file's own columns."""
        if self.topic.held:
            return "" if self.topic.file or time is None else f"{time.name} of {self.topic.name}"
        return LOG_TIME if time is LOG else HEADER

    def rows(self, rows: tuple[int, str]) -> BoolArray:
        column, tag = self.columns[rows[0]], rows[1]
        if column.dtype.kind in "iuf" and is_number(tag):
            return np.asarray(column == float(tag), np.bool_)
        return np.array([str(value) == tag for value in column], np.bool_)


def sensor_columns(work: RecordingBuilder, job: Job, block: Block) -> list[SensorColumns]:
    """Return the columns of each sensor; constant samples become a finding."""
    topic, plan = job.topic, job.plan
    log = [] if topic.held else [block[0]]
    columns = dict(zip(job.indices, block[len(log) :], strict=True))
    values = _Values(topic, plan.temperature, columns, log)
    if log:
        time = plan.sensors[0].time
        stamps = values.columns[time.indices[0]] if time and time.indices else log[0]
        work.findings += in_time_order(stamps, log[0], block[1:], work.room)
    limit = (work.options.memory_limit or column_limit()) // 2
    axes = {sensor.triad.sensor: values.axes(sensor, limit) for sensor in plan.sensors}
    # A single sample is no evidence; the screening reports constant sensors of tables.
    constant = [
        one for one, rows in axes.items() if rows[0].size > 1 and is_constant(rows) and not topic.file
    ]
    work.findings += [_without_data(topic, sensor, axes[sensor]) for sensor in constant]
    living = [sensor for sensor in plan.sensors if sensor.triad.sensor not in constant]
    return [values.of(sensor, axes, work.room) for sensor in living]


def _without_data(topic: Topic, sensor: Sensor, rows: Sequence[FloatArray]) -> Finding:
    value = ", ".join(f"{row[0]:g}" for row in rows)
    text = f"The {sensor} of {topic.where} is always ({value}): no data."
    return Finding("warning", "no-data", text, axis=sensor.short)


def steps_back(times: IntArray) -> int:
    """Return the number of times earlier than the previous one."""
    return sum(
        int(np.count_nonzero(times[part.start + 1 : part.stop + 1] < times[part]))
        for part in blocks(times.size - 1, times)
    )


def unsorted(times: IntArray) -> Iterator[tuple[int, int]]:
    """Yield the parts (start, stop) to be sorted separately so that all times are in order."""
    lowest = [int(times[part].min()) for part in blocks(times.size, times)]
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
    """Sort samples by log time in place if joined files or parallel writers disordered them.

    If that disorders the stamps, the recorder's clock was set back: nothing is sorted.
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
