"""A topic as a table: one column per number in its messages; column names identify the sensors."""

import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucal.errors import ChoiceError, Fix, ReadError
from imucal.frozen import frozen_alone
from imucal.readers.containers import Channel, Container
from imucal.readers.messages import schemas
from imucal.readers.messages.definitions import (
    DefinitionError,
    definition_of_channel,
    plain_type,
    read_definitions,
)
from imucal.readers.messages.loader import Decoder, Stream, decode, first_message
from imucal.readers.messages.plain import BinaryDecoder, is_reachable
from imucal.readers.messages.trees import TIME, Leaf, TreeDecoder, leaves_of_tree
from imucal.readers.read_options import ReadOptions
from imucal.readers.store import Block, is_constant
from imucal.readers.tables.columns import ColumnsError, NamedTable, parse_columns_text
from imucal.readers.tables.dialects import Dialect
from imucal.readers.tables.names import parse_column
from imucal.readers.tables.plan import TablePlan, find_bare_triads, find_triads, make_plan
from imucal.recording import Sensor

_ENCODINGS = ("cdr", "ros1", "json", "protobuf")
#: Separators in a columns text.
_MARKS = r"[,+=@:]"
#: Times that are not columns.
_CLOCKS = (None, "header", "log")
#: Elements of longer arrays are columns only if they are named.
_MAX_ELEMENTS = 9
#: Messages examined.
_HEAD = 100
#: Chunks read for them, first a few, then more.
_LOOKS = (1, 32)
#: Rows examined of a table in memory.
HELD_ROWS = 400
#: Packages of general vectors, read only if the user names the topic.
_PLAIN = ("geometry_msgs/", "nav_msgs/")
_ROS = Dialect(name="ROS", headers=(), gyro_unit="rad/s", accel_unit="m/s^2", has_log_time=True)
#: Package -> units and times: REP 103; PX4 uses microseconds since boot.
_PACKAGES = {
    **dict.fromkeys(("sensor_msgs", "geometry_msgs", "nav_msgs"), _ROS),
    "px4_msgs": replace(_ROS, name="PX4", time_ns=(("timestamp", 1_000), ("timestamp_sample", 1_000))),
}
#: PX4 increment -> its rate, and its duration in µs.
_INCREMENTS = {
    "delta_angle": ("gyro_rad", ("delta_angle_dt",)),
    "delta_velocity": ("accelerometer_m_s2", ("delta_velocity_dt", "dt")),
}


class Column(NamedTuple):
    """A number in messages: column name, path for the decoders, type and unit."""

    name: str
    path: str
    type: str
    unit: str | None = None


@frozen_alone
class Topic:
    """A topic over all files of a log."""

    name: str
    type: str
    channels: tuple[tuple[int, Channel], ...]
    leaves: tuple[Leaf, ...] = ()
    columns: tuple[Column, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    #: Whether its vectors are general: read only if the user names the topic.
    plain: bool = False
    #: Why its messages can't be read; otherwise empty.
    reason: str = ""
    #: What helps, if it can't be read.
    fixes: tuple[Fix, ...] = ()
    #: The sensor requested by the user.
    wanted: Sensor | None = None
    given: Mapping[str, str] = field(default_factory=dict)
    #: Columns in memory, shape (n,) each; if `sparse`, rows without values are not samples.
    held: tuple[NDArray[Any], ...] = ()
    sparse: bool = False
    #: None if type or names decide.
    dialect: Dialect | None = None
    #: The file of a table, with the shapes of its arrays.
    file: str = ""
    shapes: str = ""

    @property
    def where(self) -> str:
        return self.file or f"topic {self.name}"

    @property
    def count(self) -> int | None:
        counts = [channel.count for _, channel in self.channels]
        known = [count for count in counts if count is not None]
        return sum(known) if len(known) == len(counts) else None

    @property
    def duration_s(self) -> float | None:
        firsts = [channel.first_ns for _, channel in self.channels if channel.first_ns is not None]
        lasts = [channel.last_ns for _, channel in self.channels if channel.last_ns is not None]
        return (max(lasts) - min(firsts)) / 1e9 if firsts and lasts else None

    @property
    def rate_hz(self) -> float | None:
        count, duration = self.count, self.duration_s
        return (count - 1) / duration if count and duration and count > 1 else None

    def table(self, heads: Block = ()) -> NamedTable:
        def cells(index: int) -> Sequence[str]:
            return cells_of(heads[index][: HELD_ROWS if self.held else _HEAD]) if heads else ()

        units = ["ns" if column.type == TIME else column.unit for column in self.columns]
        names = [column.name for column in self.columns]
        table = NamedTable.of(self.where, names, cells, units=units)
        dialect = self.dialect or _PACKAGES.get(self.type.partition("/")[0], table.dialect)
        if dialect is not None and not self.held:
            dialect = replace(dialect, unit_source="from the message type", may_be_g=False)
        return replace(table, dialect=dialect)

    def stream(self, columns: Sequence[Column]) -> Stream:
        """Return the decoders of some columns; raises ReadError."""
        paths = [column.path for column in columns]
        try:
            decoders = {(at, channel.key): self._decoder(channel, paths) for at, channel in self.channels}
        except DefinitionError as error:
            text = f"topic {self.name} of type {self.type} can't be decoded: {error.problem}"
            raise ReadError(text, fixes=error.fixes) from error
        floats = [column.type.startswith(("float", "double")) or "/" in column.path for column in columns]
        return Stream([np.float64 if one else np.int64 for one in floats], decoders)

    def _decoder(self, channel: Channel, paths: Sequence[str]) -> Decoder:
        if channel.encoding == "json":
            return TreeDecoder(paths)
        if channel.encoding == "protobuf":
            return TreeDecoder(paths, schemas.protobuf_parser(channel), "protobuf")
        definition = definition_of_channel(channel, self.given)
        fields = definition.fields()
        if not is_reachable(paths, fields):
            return TreeDecoder(paths, schemas.ros_parser(definition), "ROS")
        return BinaryDecoder(fields, paths, ros1=channel.encoding == "ros1")


def cells_of(values: NDArray[Any]) -> list[str]:
    """Return values as text; a column without values counts as zero."""
    cells = values.tolist()
    return ["" if cell is None or cell != cell else str(cell) for cell in cells] or ["0"]  # noqa: PLR0124 - NaN


def held_topic(
    name: str,
    kind: str,
    columns: Mapping[Column, NDArray[Any]],
    options: ReadOptions,
    **more: Any,  # noqa: ANN401 - fields of `Topic`
) -> Topic:
    """Return a topic in memory with its sensors; its first stamps, in ns, give its duration."""
    arrays = tuple(columns.values())
    stamps = next((values for column, values in columns.items() if column.type == TIME), arrays[0][:0])
    first, last = (int(stamps[0]), int(stamps[-1])) if stamps.size else (None, None)
    channel = Channel(
        key=0, topic=name, type=kind, encoding="", count=arrays[0].size, first_ns=first, last_ns=last
    )
    topic = Topic(
        name=name,
        type=kind,
        channels=((0, channel),),
        leaves=tuple(Leaf(column.name, column.type) for column in columns),
        columns=tuple(columns),
        held=arrays,
        **more,
    )
    try:
        plan, _ = plan_of((), topic, options)
    except ColumnsError as error:
        # For a file, the error about the choice lists its columns.
        return topic if topic.file or options.columns is None else replace(topic, reason=error.wrong)
    except ChoiceError:
        return topic
    return replace(topic, sensors=tuple(sensor.triad.sensor for sensor in plan.sensors))


def find_topics(containers: Sequence[Container], options: ReadOptions) -> list[Topic]:
    """Return all topics of a log, in the order of its first file."""
    given = read_definitions(options.message_definitions)
    groups: dict[tuple[str, str], list[tuple[int, Channel]]] = {}
    for number, container in enumerate(containers):
        for channel in container.channels:
            groups.setdefault((channel.topic, plain_type(channel.type)), []).append((number, channel))
    found = []
    for channels in groups.values():
        number, channel = channels[0]
        topic = Topic(name=channel.topic, type=channel.type, channels=tuple(channels), given=given)
        try:
            leaves = tuple(_leaves(channel, containers[number], given))
            found.append(_with_sensors(replace(topic, leaves=leaves), options))
        except DefinitionError as error:
            found.append(replace(topic, reason=error.problem, fixes=error.fixes))
    return found


def _leaves(channel: Channel, container: Container, given: Mapping[str, str]) -> Sequence[Leaf]:
    """Return the numbers in a channel's messages; raises DefinitionError."""
    if channel.encoding == "json":
        first = first_message(container, channel.key)
        try:
            return list(leaves_of_tree(json.loads(first))) if first is not None else []
        except (ValueError, RecursionError) as error:
            raise DefinitionError(f"its first message is no JSON: {error}") from error
    if channel.encoding == "protobuf":
        return schemas.protobuf_leaves(channel)
    if channel.encoding not in _ENCODINGS:
        msg = (
            f"messages are encoded as {channel.encoding!r}; expected one of {', '.join(_ENCODINGS)}; "
            "convert the log to CSV with a row per message, or to JSON messages"
        )
        raise DefinitionError(msg)
    definition = definition_of_channel(channel, given)
    definition.fields()
    return schemas.ros_leaves(definition)


def _columns(topic: Topic, text: str | None) -> Iterator[Column]:
    """Yield the columns of a topic; elements of long arrays and lists only if they are named."""
    kind = plain_type(topic.type)
    # Its field names do not contain the quantity.
    prefix = "accel." if kind == "geometry_msgs/Accel" else ""
    named = re.split(_MARKS, text or "")
    indices = sorted({0, *map(int, re.findall(r"\[(\d{1,6})\]\.", text or ""))})
    for leaf in topic.leaves:
        listed = (leaf.path.replace("[0].", f"[{index}].", 1) for index in indices if text)
        for path in listed if "]." in leaf.path else [leaf.path]:
            yield from (Column(prefix + name, name, base) for name, base in _elements(path, leaf, named))
    if kind.startswith("px4_msgs/"):
        yield from _rates({leaf.path for leaf in topic.leaves})


def _rates(paths: Collection[str]) -> Iterator[Column]:
    for step, (rate, spans) in _INCREMENTS.items():
        for span in [span for span in spans if step in paths and span in paths][:1]:
            yield from (Column(f"{rate}[{i}]", f"{step}[{i}]/{span}", "float32") for i in range(3))


def _elements(path: str, leaf: Leaf, named: Sequence[str]) -> Iterator[tuple[str, str]]:
    base, bracket, count = leaf.type.rstrip("]").partition("[")
    if not bracket:
        yield path, base
        return
    element = re.compile(re.escape(path) + r"\[(\d{1,6})\]")
    found = {int(match[1]) for one in named if (match := element.fullmatch(one))}
    found |= {0, 1, 2} if found or path in named else set()
    if count:
        found = {i for i in found if i < int(count)} if int(count) > _MAX_ELEMENTS else set(range(int(count)))
    yield from ((f"{path}[{index}]", base) for index in sorted(found))


def _with_sensors(topic: Topic, options: ReadOptions) -> Topic:
    # Column numbers must not depend on the columns text.
    columns = dict.fromkeys([*_columns(topic, None), *_columns(topic, options.columns)])
    topic = replace(topic, columns=tuple(columns))
    if len(options.topics) == 2 and topic.name in options.topics:
        # The first of two topics is the gyroscope, unless names decide.
        topic = replace(topic, wanted=tuple(Sensor)[options.topics.index(topic.name)])
    if options.columns is None:
        return _by_name(topic, named=topic.name in options.topics)
    try:
        triads, _, _ = parse_columns_text(options.columns, topic.table())
    except ColumnsError as error:
        return replace(topic, reason=error.wrong)
    return replace(topic, sensors=tuple(triad.sensor for triad in triads))


def _by_name(topic: Topic, *, named: bool) -> Topic:
    kind = plain_type(topic.type)
    last = kind.rpartition("/")[2]
    if is_command(topic.name) and "imu" not in last.lower() and not named:
        return topic
    table = topic.table()
    try:
        triads = find_triads(table, units_given=tuple(Sensor))
        found = {triad.sensor for triad in triads}
        bare = set() if found else set(find_bare_triads(table, _word(topic))[0])
    except ChoiceError:
        return topic
    if len(found) == 1 and all(len("".join(triad.columns[0].words)) == 1 for triad in triads):
        # ax, ay, az alone may be the acceleration of a position.
        return topic
    vague = bool(bare) and parse_column(f"{last}.x", 0).sensor is None
    sensors = tuple(sensor for sensor in Sensor if sensor in found | bare)
    return replace(topic, sensors=sensors, plain=vague or kind.startswith(_PLAIN))


def _word(topic: Topic) -> str:
    """Return the sensor requested by the user or named by topic or type, or an empty text."""
    last = plain_type(topic.type).rpartition("/")[2]
    candidates = (topic.wanted, *(parse_column(f"{name}.x", 0).sensor for name in (topic.name, last)))
    return str(next(filter(None, candidates), ""))


def is_command(topic: str) -> bool:
    """Return whether a topic's name indicates commands instead of measurements."""
    return re.search(r"(^|[/_])(cmd|command|setpoint|desired|target)s?([/_]|$)", topic.lower()) is not None


def plan_of(
    containers: Sequence[Container], topic: Topic, options: ReadOptions
) -> tuple[TablePlan, frozenset[Sensor]]:
    """Choose the columns of a topic; also return the sensors whose first samples change.

    Raises ChoiceError.
    """
    heads = topic.held or _heads(containers, topic, options.columns or "")
    time = None if options.time in _CLOCKS and not topic.held else options.time
    name = _word(topic) or topic.name
    plan = make_plan(topic.table(heads), replace(options, time=time), name=name, shape=topic.shapes)
    alive = []
    for triad in (sensor.triad for sensor in plan.sensors):
        # Columns in memory may be text.
        rows = [heads[index] for index in triad.indices if heads[index].dtype.kind in "biuf"]
        alive += [triad.sensor] if not rows or rows[0].size < 2 or not is_constant(rows) else []
    return plan, frozenset(alive)


def _heads(containers: Sequence[Container], topic: Topic, text: str) -> Block:
    """Return the first values of each column; empty for lists that are not named."""
    names = {*re.split(_MARKS, text)}
    fixed = {leaf.path for leaf in topic.leaves if "]." not in leaf.path and not leaf.type.endswith("[]")}
    wanted = [
        column
        for column in topic.columns
        if column.path.partition("[")[0] in fixed or names & {column.name, _owner(column.name)}
    ]
    stream = topic.stream(wanted)
    for chunks in _LOOKS:
        log, *heads = decode(containers, [stream], most_chunks=chunks)[0].columns
        if log.size >= _HEAD:
            break
    values = dict(zip(wanted, heads, strict=True))
    return [values.get(column, log[:0]) for column in topic.columns]


def _owner(name: str) -> str:
    """Return ``imu.gyro`` of ``imu.gyro.x``."""
    return re.sub(r"(\[\d+\]|\.\w+)$", "", name)
