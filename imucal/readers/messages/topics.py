"""The topics of a log: which of them carry IMU samples or their temperature, and how to decode them."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from imucal.errors import DataError, ReadError
from imucal.readers.clocks import clock_from_stamps
from imucal.readers.column_store import is_constant
from imucal.readers.containers import Channel, Container
from imucal.readers.messages import protobuf_messages, ros_trees
from imucal.readers.messages.decoder import BinaryDecoder, Shape, reachable
from imucal.readers.messages.definition_files import definition_of, read_definitions
from imucal.readers.messages.definitions import (
    BUILT_IN,
    DefinitionError,
    Field,
    built_in,
    flatten,
    plain_type,
)
from imucal.readers.messages.fields_text import FieldsText, parse_fields_text
from imucal.readers.messages.leaves import Leaves, leaves_of_tree
from imucal.readers.messages.list_messages import tree_decoder
from imucal.readers.messages.loader import Decoder, Stream, decode, first_message
from imucal.readers.messages.message_types import ImuFields, Stamp, find_imus
from imucal.readers.messages.tree_messages import JSON_FIELDS, TreeDecoder
from imucal.readers.read_options import ReadOptions
from imucal.recording import Sensor, Temperature

_ENCODINGS = ("cdr", "ros1", "json", "protobuf")

#: Chunks looked into to see whether a sensor has data: more where a few hold too few messages.
_LOOKS, _ENOUGH = (2, 32), 100

_TEMPERATURE = "sensor_msgs/Temperature"
_TEMPERATURE_FIELDS = ImuFields(
    stamp=Stamp(sec="header.stamp.sec", nanosec="header.stamp.nanosec"), vectors=(), temperature="temperature"
)


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


def stream_of(topic: Topic, sensors: Sequence[Sensor], options: ReadOptions) -> Stream:
    """Return how to decode some sensors of a topic.

    Raises
    ------
    ReadError
        If its messages can't be decoded.
    """
    if topic.imu is None:
        msg = f"topic {topic.name} of type {topic.type} can't be decoded: {topic.reason or 'no IMU samples'}"
        raise ReadError(msg)
    decoders: dict[tuple[int, int], Decoder] = {}
    imu = _only(topic.imu, sensors)
    for number, channel in topic.channels:
        try:
            decoder = _decoder(channel, topic, sensors, options)
        except DefinitionError as error:
            msg = f"topic {topic.name} of type {channel.type} can't be decoded: {error}"
            raise ReadError(msg) from error
        if isinstance(decoder, BinaryDecoder):
            imu = decoder.imu
        decoders[number, channel.key] = decoder
    return Stream(imu=imu, decoders=decoders)


def _decoder(
    channel: Channel, topic: Topic, sensors: Sequence[Sensor], options: ReadOptions
) -> BinaryDecoder | TreeDecoder:
    """Return what decodes the messages of one channel of a topic."""
    imu = _only(topic.imu or JSON_FIELDS, sensors)
    if channel.encoding == "json":
        return tree_decoder(imu)
    if channel.encoding == "protobuf":
        return tree_decoder(imu, protobuf_messages.parser_of(channel), "protobuf")
    ros1 = channel.encoding == "ros1"
    definition = _definition(channel, options)
    fields = definition.fields(channel)
    if imu.asked:
        reached = reachable(imu, fields)
        if reached is None:
            parse = ros_trees.parser_of(channel.type, definition.text, definition.more, ros1=ros1)
            return tree_decoder(imu, parse, "ROS")
        return BinaryDecoder([Shape(fields, reached)], ros1=ros1, exact=definition.assumed)
    shapes = [_shape(channel, fields, topic, sensors)]
    standard = built_in(channel.type, ros1=ros1)
    if standard is not None:
        fields = flatten(channel.type, standard, ros1=ros1)
        shapes.append(_shape(channel, fields, topic, sensors))
    return BinaryDecoder(shapes, ros1=ros1, exact=definition.assumed)


def live_sensors(containers: Sequence[Container], topic: Topic, options: ReadOptions) -> frozenset[Sensor]:
    """Return the sensors whose samples change in the first chunks of a topic.

    One sample, or none that can be decoded, tells nothing: the type is believed then.
    """
    if topic.imu is None:
        return frozenset()
    stream = stream_of(topic, topic.imu.sensors, options)
    for chunks in _LOOKS:
        columns = decode(containers, [stream], most_chunks=chunks)[0].columns
        if columns.n >= _ENOUGH:
            break
    if columns.n < 2:
        return frozenset(topic.imu.sensors)
    return frozenset(sensor for sensor, rows in columns.vectors.items() if not is_constant(rows))


def read_temperature(
    containers: Sequence[Container], topics: Sequence[Topic], imu: str
) -> tuple[Temperature, str] | None:
    """Return the temperature that stands beside an IMU topic, and the name of its topic.

    It must be the only one in the IMU's own namespace: a log may hold the temperatures of other things.
    A topic that can't be read is as good as none: nothing is fitted to a temperature.
    """
    space = imu.rpartition("/")[0]
    beside = [
        topic
        for topic in topics
        if plain_type(topic.type) == _TEMPERATURE and topic.count != 0 and topic.name.startswith(space + "/")
    ]
    if len(beside) != 1 or not space:
        return None
    topic = beside[0]
    columns = decode(containers, [_temperature_stream(topic)])[0].columns
    if columns.temperature is None or columns.n < 2:
        return None
    try:
        reading = clock_from_stamps(columns.stamps, source="header stamp", log_ns=columns.log)
    except DataError:
        return None
    samples = columns.temperature if reading.order is None else columns.temperature[reading.order]
    return Temperature(samples=samples, clock=reading.clock), topic.name


def _temperature_stream(topic: Topic) -> Stream:
    """Return how to decode a topic by the standard definition of its type."""
    decoders: dict[tuple[int, int], Decoder] = {}
    for number, channel in topic.channels:
        ros1 = channel.encoding == "ros1"
        text = built_in(_TEMPERATURE, ros1=ros1) or BUILT_IN[_TEMPERATURE]
        shape = Shape(flatten(_TEMPERATURE, text, ros1=ros1), _TEMPERATURE_FIELDS)
        decoders[number, channel.key] = BinaryDecoder([shape], ros1=ros1, exact=True)
    return Stream(imu=_TEMPERATURE_FIELDS, decoders=decoders)


def _only(imu: ImuFields, sensors: Sequence[Sensor]) -> ImuFields:
    return replace(imu, vectors=tuple(v for v in imu.vectors if v.sensor in sensors))


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
        meant = wanted or _looks_like_imu(channel) or name in options.topics or _is_given(channel, options)
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
    definition = _definition(channel, options)
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
    return find_imus(channel.type, _definition(channel, options).fields(channel), name, said)


def _shape(channel: Channel, fields: tuple[Field, ...], topic: Topic, sensors: Sequence[Sensor]) -> Shape:
    sensor = sensors[0] if len(sensors) == 1 else None
    imu = find_imus(channel.type, fields, topic.name, sensor).get(topic.part)
    if imu is None:
        msg = f"topic {topic.name}: the files define {channel.type} differently"
        raise ReadError(msg)
    return Shape(fields, _only(imu, sensors))


def _said(name: str, options: ReadOptions) -> Sensor | None:
    """Return the sensor that the caller names a topic for: the first of two is the gyroscope."""
    if len(options.topics) == 2 and name in options.topics:
        return (Sensor.GYROSCOPE, Sensor.ACCELEROMETER)[options.topics.index(name)]
    return None


@dataclass(frozen=True, slots=True)
class _Definition:
    """The definition of a channel's type, and whether it is `assumed` from the type's name.

    `more` are definitions of other types; None where the log's own definition is whole.
    """

    text: str
    assumed: bool
    more: dict[str, str] | None = None

    def fields(self, channel: Channel) -> tuple[Field, ...]:
        """Return the flat fields; a DefinitionError where they can't be told."""
        return flatten(channel.type, self.text, ros1=channel.encoding == "ros1", more=self.more)


def _definition(channel: Channel, options: ReadOptions) -> _Definition:
    """Return the definition of a channel's type: the log's own, one that is given, or the standard one.

    Raises
    ------
    DefinitionError
        If the type has no definition, or one that can't be read.
    """
    standard = built_in(channel.type, ros1=channel.encoding == "ros1")
    if channel.definition and channel.definition_kind in {"ros2msg", "ros1msg"}:
        own = _Definition(channel.definition, assumed=False)
        try:
            own.fields(channel)
        except DefinitionError:
            # A damaged definition of a well-known type loses nothing: messages must have its size.
            if standard is None:
                raise
            return _Definition(standard, assumed=True)
        return own
    given = read_definitions(options.message_definitions)
    text = definition_of(channel.type, given)
    if text is not None:
        return _Definition(text, assumed=True, more=given)
    if standard is None:
        kind = f" but of kind {channel.definition_kind!r}" if channel.definition_kind else ""
        others = ", ".join(sorted(name.strip("/") for name in given)[:8])
        names = f", those that are given are of {others}" if given else ""
        last = plain_type(channel.type).rpartition("/")[2]
        msg = f"the log holds no definition of {channel.type}{kind}{names}; give its .msg file, {last}.msg"
        raise DefinitionError(msg)
    return _Definition(standard, assumed=True)


def _is_given(channel: Channel, options: ReadOptions) -> bool:
    """Return whether the user gives the definition of a channel's type."""
    return definition_of(channel.type, read_definitions(options.message_definitions)) is not None


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
