"""The topics of a log: which of them carry IMU samples, and how to decode them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from imucal.errors import ReadError
from imucal.readers.containers.container import Channel, Container
from imucal.readers.containers.loader import Decoder, Stream
from imucal.readers.messages.decoder import BinaryDecoder, Shape
from imucal.readers.messages.definitions import DefinitionError, Field, built_in, flatten, plain_type
from imucal.readers.messages.json_messages import JSON_CARRIER, JsonDecoder
from imucal.readers.messages.message_types import Carrier, find_carriers
from imucal.readers.read_options import ReadOptions
from imucal.recording import Sensor

_ENCODINGS = ("cdr", "ros1", "json")


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
    carrier
        What its messages can give; None where nothing, or not known how.
    reason
        Why its messages can't be read, though its type looks like an IMU's; else empty.
    """

    name: str
    type: str
    channels: tuple[tuple[int, Channel], ...]
    carrier: Carrier | None = None
    reason: str = ""
    part: str = ""

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
    groups: dict[tuple[str, str], list[tuple[int, Channel]]] = {}
    for number, container in enumerate(containers):
        for channel in container.channels:
            groups.setdefault((channel.topic, plain_type(channel.type)), []).append((number, channel))
    return [topic for (name, _), channels in groups.items() for topic in _topics(name, channels, options)]


def stream_of(topic: Topic, sensors: Sequence[Sensor], options: ReadOptions) -> Stream:
    """Return how to decode some sensors of a topic.

    Raises
    ------
    ReadError
        If its messages can't be decoded.
    """
    if topic.carrier is None:
        msg = f"topic {topic.name} of type {topic.type} can't be decoded: {topic.reason or 'no IMU samples'}"
        raise ReadError(msg)
    decoders: dict[tuple[int, int], Decoder] = {}
    carrier = _only(topic.carrier, sensors)
    for number, channel in topic.channels:
        if channel.encoding == "json":
            decoders[number, channel.key] = JsonDecoder(carrier)
            continue
        try:
            fields, exact = _fields(channel, options)
        except DefinitionError as error:
            msg = f"topic {topic.name} of type {channel.type} can't be decoded: {error}"
            raise ReadError(msg) from error
        shapes = [_shape(channel, fields, topic, sensors)]
        carrier = shapes[0].carrier
        ros1 = channel.encoding == "ros1"
        standard = built_in(channel.type, ros1=ros1)
        if standard is not None:
            fields = flatten(channel.type, standard, ros1=ros1)
            shapes.append(_shape(channel, fields, topic, sensors))
        decoders[number, channel.key] = BinaryDecoder(shapes, ros1=ros1, exact=exact)
    return Stream(carrier=carrier, decoders=decoders)


def _only(carrier: Carrier, sensors: Sequence[Sensor]) -> Carrier:
    return replace(carrier, vectors=tuple(v for v in carrier.vectors if v.sensor in sensors))


def _topics(name: str, channels: list[tuple[int, Channel]], options: ReadOptions) -> list[Topic]:
    """Return a topic as one entry for each IMU that its messages hold; one without IMU samples as it is."""
    channel = channels[0][1]
    carriers: dict[str, Carrier] = {}
    reason = ""
    if channel.encoding not in _ENCODINGS:
        reason = f"messages are encoded as {channel.encoding!r}; expected one of {', '.join(_ENCODINGS)}"
    elif channel.encoding == "json":
        carriers = {"": JSON_CARRIER} if _looks_like_imu(channel) else {}
    else:
        try:
            fields, _ = _fields(channel, options)
            carriers = find_carriers(channel.type, fields, name, _said(name, options))
            reason = "" if carriers else _unreachable(fields)
        except DefinitionError as error:
            reason = str(error)
    if not carriers:
        said = reason if _looks_like_imu(channel) or name in options.topics else ""
        return [Topic(name=name, type=channel.type, channels=tuple(channels), reason=said)]
    return [
        Topic(
            name=f"{name}:{part}" if part else name,
            type=channel.type,
            channels=tuple(channels),
            carrier=carrier,
            part=part,
        )
        for part, carrier in carriers.items()
    ]


def _shape(channel: Channel, fields: tuple[Field, ...], topic: Topic, sensors: Sequence[Sensor]) -> Shape:
    sensor = sensors[0] if len(sensors) == 1 else None
    carrier = find_carriers(channel.type, fields, topic.name, sensor).get(topic.part)
    if carrier is None:
        msg = f"topic {topic.name}: the files define {channel.type} differently"
        raise ReadError(msg)
    return Shape(fields, _only(carrier, sensors))


def _said(name: str, options: ReadOptions) -> Sensor | None:
    """Return the sensor that the caller names a topic for: the first of two is the gyroscope."""
    if len(options.topics) == 2 and name in options.topics:
        return (Sensor.GYROSCOPE, Sensor.ACCELEROMETER)[options.topics.index(name)]
    return None


def _fields(channel: Channel, options: ReadOptions) -> tuple[tuple[Field, ...], bool]:
    """Return the flat fields of a channel's type, and whether they are guessed from the type's name.

    Raises
    ------
    DefinitionError
        If the type has no definition, or one that can't be read.
    """
    ros1 = channel.encoding == "ros1"
    standard = built_in(channel.type, ros1=ros1)
    if channel.definition and channel.definition_kind in {"ros2msg", "ros1msg"}:
        try:
            return flatten(channel.type, channel.definition, ros1=ros1), False
        except DefinitionError:
            # A damaged definition of a well-known type loses nothing: messages must have its size.
            if standard is None:
                raise
            return flatten(channel.type, standard, ros1=ros1), True
    if options.message_definition is not None:
        try:
            text = options.message_definition.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            msg = f"{options.message_definition}: can't be read: {error}"
            raise DefinitionError(msg) from error
        return flatten(channel.type, text, ros1=ros1), True
    if standard is None:
        kind = f" but of kind {channel.definition_kind!r}" if channel.definition_kind else ""
        msg = f"the log holds no definition of {channel.type}{kind}; give its .msg file"
        raise DefinitionError(msg)
    return flatten(channel.type, standard, ros1=ros1), True


def _looks_like_imu(channel: Channel) -> bool:
    name = plain_type(channel.type).lower()
    return "imu" in name.rpartition("/")[2] or name.endswith(("sensorcombined", "vehicleimu"))


def _unreachable(fields: Sequence[Field]) -> str:
    last = fields[-1] if fields else None
    if last is not None and last.kind == "other":
        return f"the definition has a sequence of structures or strings, {last.path}, in front"
    return "its definition has no angular velocity or linear acceleration"
