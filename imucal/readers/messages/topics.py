"""The topics of a log: which of them carry IMU samples, and which numbers those are."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field

from imucal.readers.containers import Channel, Container
from imucal.readers.messages import protobuf_messages, ros_trees
from imucal.readers.messages.channel_definitions import definition_of_channel, is_given
from imucal.readers.messages.definitions import (
    DefinitionError,
    plain_type,
)
from imucal.readers.messages.fields_text import FieldsText, parse_fields_text
from imucal.readers.messages.leaves import Leaves, leaves_of_tree
from imucal.readers.messages.loader import first_message
from imucal.readers.messages.message_types import ImuFields, find_imus
from imucal.readers.messages.tree_messages import JSON_FIELDS
from imucal.readers.read_options import ReadOptions
from imucal.recording import Sensor

_ENCODINGS = ("cdr", "ros1", "json", "protobuf")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Topic:
    """A topic of a log, over all its files, or one IMU of a topic whose messages hold several.

    Attributes
    ----------
    name, type
        Such as ``/imu/data`` and ``sensor_msgs/msg/Imu``; ``/imus:left`` for a part of a message.
    part
        The field of a message that holds this IMU; empty where there is one only.
    channels
        Number of the container, and channel.
    imu
        What its messages can give; None where nothing, or not known how.
    reason
        Why its messages can't be read, though its type looks like an IMU's; else empty.
    leaves
        The numbers in its messages.
    """

    name: str
    type: str
    channels: tuple[tuple[int, Channel], ...]
    imu: ImuFields | None = None
    reason: str = ""
    part: str = ""
    leaves: Leaves = field(default_factory=lambda: Leaves(()))

    @property
    def count(self) -> int | None:
        """Number of messages, where it is known."""
        counts = [channel.count for _, channel in self.channels]
        known = [count for count in counts if count is not None]
        return sum(known) if len(known) == len(counts) else None

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Time of the first and the last message, where it is known."""
        firsts = [channel.first_ns for _, channel in self.channels if channel.first_ns is not None]
        lasts = [channel.last_ns for _, channel in self.channels if channel.last_ns is not None]
        return (min(firsts), max(lasts)) if firsts and lasts else None

    @property
    def duration_s(self) -> float | None:
        """From the first message to the last, in s."""
        span = self.span_ns
        return (span[1] - span[0]) / 1e9 if span else None

    @property
    def rate_hz(self) -> float | None:
        """Messages per second, where it is known."""
        count, duration = self.count, self.duration_s
        return (count - 1) / duration if count and duration and count > 1 else None


def find_topics(containers: Sequence[Container], options: ReadOptions) -> list[Topic]:
    """Return all topics of a log, in the order of its first file."""
    wanted = parse_fields_text(options.fields)
    groups: dict[tuple[str, str], list[tuple[int, Channel]]] = {}
    for number, container in enumerate(containers):
        for channel in container.channels:
            groups.setdefault((channel.topic, plain_type(channel.type)), []).append((number, channel))
    return [
        topic
        for (name, _), channels in groups.items()
        for topic in _topics(name, channels, containers, options, wanted)
    ]


def _topics(
    name: str,
    channels: list[tuple[int, Channel]],
    containers: Sequence[Container],
    options: ReadOptions,
    wanted: FieldsText | None,
) -> list[Topic]:
    """Return a topic as one entry for each IMU that its messages hold; one without IMU samples as it is."""
    number, channel = channels[0]
    imus: dict[str, ImuFields] = {}
    leaves, reason = Leaves(()), ""
    try:
        leaves = _leaves(channel, containers[number], options)
        if wanted is not None:
            asked = leaves.asked(wanted, options.time_unit)
            imus, reason = ({"": asked}, "") if isinstance(asked, ImuFields) else ({}, f"it has no {asked}")
        else:
            imus = _known(name, channel, leaves, options)
            reason = "" if imus else _unreachable(leaves)
    except DefinitionError as error:
        reason = str(error)
    if not imus:
        meant = wanted or _looks_like_imu(channel) or name in options.topics or is_given(channel, options)
        said = reason if meant else ""
        return [Topic(name=name, type=channel.type, channels=tuple(channels), reason=said, leaves=leaves)]
    return [
        Topic(
            name=f"{name}:{part}" if part else name,
            type=channel.type,
            channels=tuple(channels),
            imu=imu,
            part=part,
            leaves=leaves,
        )
        for part, imu in imus.items()
    ]


def _leaves(channel: Channel, container: Container, options: ReadOptions) -> Leaves:
    """Return the numbers in the messages of a channel; those of JSON are those of the first message.

    Raises
    ------
    DefinitionError
        If the messages can't be read.
    """
    if channel.encoding == "json":
        first = first_message(container, channel.key)
        try:
            return Leaves(leaves_of_tree(json.loads(first)) if first is not None else ())
        except (ValueError, RecursionError):
            return Leaves(())
    if channel.encoding == "protobuf":
        return Leaves(protobuf_messages.leaves_of(channel))
    if channel.encoding not in _ENCODINGS:
        msg = (
            f"messages are encoded as {channel.encoding!r}; expected one of {', '.join(_ENCODINGS)}; convert "
            "the log with what wrote it: to a CSV with a row per message, or to JSON messages"
        )
        raise DefinitionError(msg)
    definition = definition_of_channel(channel, options)
    # The flat fields say whether the definition is whole.
    definition.fields(channel)
    ros1 = channel.encoding == "ros1"
    return Leaves(ros_trees.leaves_of(channel.type, definition.text, definition.more, ros1=ros1))


def _known(name: str, channel: Channel, leaves: Leaves, options: ReadOptions) -> dict[str, ImuFields]:
    """Return the IMUs that the fields of a channel's messages are recognised as."""
    if channel.encoding == "json":
        vectors = tuple(v for v in JSON_FIELDS.vectors if leaves.vector(v.paths) is not None)
        known = len(vectors) == 2 or (not leaves.all and _looks_like_imu(channel))
        return {"": JSON_FIELDS} if known else {}
    said = _said(name, options)
    if channel.encoding == "protobuf":
        return find_imus(channel.type, protobuf_messages.fields_of(channel), name, said)
    return find_imus(channel.type, definition_of_channel(channel, options).fields(channel), name, said)


def _said(name: str, options: ReadOptions) -> Sensor | None:
    """Return the sensor that the caller names a topic for: the first of two is the gyroscope."""
    if len(options.topics) == 2 and name in options.topics:
        return (Sensor.GYROSCOPE, Sensor.ACCELEROMETER)[options.topics.index(name)]
    return None


def _looks_like_imu(channel: Channel) -> bool:
    name = plain_type(channel.type).lower()
    return "imu" in name.rpartition("/")[2] or name.endswith(("sensorcombined", "vehicleimu"))


def _unreachable(leaves: Leaves) -> str:
    """Return why nothing of a message is known as an IMU's, and what to say."""
    how = leaves.proposal()
    example = f" such as {how!r}" if how else ""
    return (
        "it has no angular velocity or linear acceleration by name; say which of its fields they are by a "
        f"fields text{example}; found {leaves.shown()}"
    )
