"""A topic as a table: one column per number in its messages."""

import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucal.errors import Fix, ReadError
from imucal.readers.containers import Channel, Container
from imucal.readers.messages import schemas
from imucal.readers.messages.definitions import (
    DefinitionError,
    definition_of_channel,
    plain_type,
    read_definitions,
)
from imucal.readers.messages.loader import Decoder, Stream, decode, first_message
from imucal.readers.messages.plain import BinaryDecoder, frame_of, is_reachable
from imucal.readers.messages.trees import TIME, Leaf, TreeDecoder, leaves_of_tree
from imucal.readers.read_options import ReadOptions
from imucal.readers.table import STAMPS, Column, Table
from imucal.readers.tables.dialects import Dialect

_ENCODINGS = ("cdr", "ros1", "json", "protobuf")
#: Separators in a columns text.
_MARKS = r"[,+=@:]"
#: Elements of longer arrays are columns only if they are named.
_MAX_ELEMENTS = 9
#: Most fields of a topic that are listed.
_MAX_FIELDS = 60
#: Messages examined.
_HEAD = 100
#: Chunks read for them, first a few, then more.
_LOOKS = (1, 32)
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


class Number(NamedTuple):
    """A number in messages: name of its column, path for the decoders, and type."""

    name: str
    path: str
    type: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Topic:
    """A topic over all files of a log."""

    name: str
    type: str
    #: Index of each container with its channel.
    channels: tuple[tuple[int, Channel], ...]
    leaves: tuple[Leaf, ...] = ()
    numbers: tuple[Number, ...] = ()
    #: Why its messages can't be read, and what helps; otherwise empty.
    reason: str = ""
    fixes: tuple[Fix, ...] = ()
    #: Definitions by type, given by the user.
    given: Mapping[str, str] = field(default_factory=dict)

    @property
    def count(self) -> int | None:
        counts = [channel.count for _, channel in self.channels]
        known = [count for count in counts if count is not None]
        return sum(known) if len(known) == len(counts) else None

    def table(self, containers: Sequence[Container], options: ReadOptions) -> Table:
        """Return the topic as a table, whose last column is the log time."""
        firsts = [channel.first_ns for _, channel in self.channels if channel.first_ns is not None]
        lasts = [channel.last_ns for _, channel in self.channels if channel.last_ns is not None]
        return Table(
            name=self.name,
            kind=self.type,
            place=f"topic {self.name}",
            columns=tuple(
                Column(name=one.name, type=one.type, unit=STAMPS if one.type == TIME else None)
                for one in self.numbers
            ),
            head=lambda: self._head(containers, options.columns or ""),
            is_topic=True,
            log_time=len(self.numbers),
            count=self.count,
            first_ns=min(firsts, default=None),
            last_ns=max(lasts, default=None),
            dialect=_PACKAGES.get(self.type.partition("/")[0]),
            reason=self.reason,
            fixes=self.fixes,
            fields=tuple(map(str, self.leaves[:_MAX_FIELDS])),
            frame=lambda: self._frame(containers),
        )

    def stream(self, numbers: Sequence[Number]) -> Stream:
        """Return the decoders of some numbers; raises ReadError."""
        paths = [number.path for number in numbers]
        try:
            decoders = {(at, channel.key): self._decoder(channel, paths) for at, channel in self.channels}
        except DefinitionError as error:
            text = f"topic {self.name} of type {self.type} can't be decoded: {error.problem}"
            raise ReadError(text, fixes=error.fixes) from error
        floats = [number.type.startswith(("float", "double")) or "/" in number.path for number in numbers]
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

    def _head(self, containers: Sequence[Container], text: str) -> list[NDArray[np.generic]]:
        """Return the first values of each column; empty for lists that a columns text does not name."""
        names = {*re.split(_MARKS, text)}
        fixed = {leaf.path for leaf in self.leaves if "]." not in leaf.path and not leaf.type.endswith("[]")}
        wanted = [
            number
            for number in self.numbers
            if number.path.partition("[")[0] in fixed or names & {number.name, _owner(number.name)}
        ]
        stream = self.stream(wanted)
        for chunks in _LOOKS:
            log, *heads = decode(containers, [stream], most_chunks=chunks)[0].columns
            if log.size >= _HEAD:
                break
        values = dict(zip(wanted, heads, strict=True))
        return [values.get(number, log[:0]) for number in self.numbers]

    def _frame(self, containers: Sequence[Container]) -> str:
        """Return the frame in the first message; empty if the type has none."""
        if not self.leaves or not self.leaves[0].path.startswith("header."):
            return ""
        for number, channel in self.channels:
            message = first_message(containers[number], channel.key, chunks=None)
            if message is not None:
                return frame_of(message, channel.encoding)
        return ""


def _owner(name: str) -> str:
    """Return ``imu.gyro`` of ``imu.gyro.x``."""
    return re.sub(r"(\[\d+\]|\.\w+)$", "", name)


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
        except DefinitionError as error:
            found.append(replace(topic, reason=error.problem, fixes=error.fixes))
            continue
        # Column numbers must not depend on the columns text.
        numbers = [*_numbers(topic.type, leaves, None), *_numbers(topic.type, leaves, options.columns)]
        found.append(replace(topic, leaves=leaves, numbers=tuple(dict.fromkeys(numbers))))
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


def _numbers(kind: str, leaves: Sequence[Leaf], text: str | None) -> Iterator[Number]:
    """Yield the numbers in messages; elements of long arrays and lists only if they are named."""
    kind = plain_type(kind)
    # Its field names do not contain the quantity.
    prefix = "accel." if kind == "geometry_msgs/Accel" else ""
    named = re.split(_MARKS, text or "")
    indices = sorted({0, *map(int, re.findall(r"\[(\d{1,6})\]\.", text or ""))})
    for leaf in leaves:
        listed = (leaf.path.replace("[0].", f"[{index}].", 1) for index in indices if text)
        for path in listed if "]." in leaf.path else [leaf.path]:
            yield from (Number(prefix + name, name, base) for name, base in _elements(path, leaf, named))
    if kind.startswith("px4_msgs/"):
        yield from _rates({leaf.path for leaf in leaves})


def _rates(paths: Collection[str]) -> Iterator[Number]:
    for step, (rate, spans) in _INCREMENTS.items():
        for span in [span for span in spans if step in paths and span in paths][:1]:
            yield from (Number(f"{rate}[{i}]", f"{step}[{i}]/{span}", "float32") for i in range(3))


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
