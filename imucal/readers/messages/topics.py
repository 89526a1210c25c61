"""The topics of a log: which carry IMU samples, in which numbers, and which to read; never a silent pick."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from imucal.errors import ChoiceError
from imucal.frozen import frozen_alone
from imucal.readers.containers import Channel, Container
from imucal.readers.files import refused
from imucal.readers.messages import schemas
from imucal.readers.messages.definitions import (
    DefinitionError,
    definition_of,
    definition_of_channel,
    plain_type,
    read_definitions,
)
from imucal.readers.messages.leaves import Leaves, leaves_of_tree
from imucal.readers.messages.loader import first_message
from imucal.readers.messages.message_types import (
    FieldsText,
    ImuFields,
    find_imus,
    is_command,
    parse_fields_text,
)
from imucal.readers.messages.trees import JSON_FIELDS
from imucal.readers.read_options import ReadOptions
from imucal.recording import Sensor

_ENCODINGS = ("cdr", "ros1", "json", "protobuf")
_GYRO, _ACCEL = Sensor.GYROSCOPE, Sensor.ACCELEROMETER
#: Topics listed in a message.
_MOST = 24


@frozen_alone
class Topic:
    """A topic of a log, over all its files, or one IMU of a topic whose messages hold several."""

    #: Such as ``/imu/data`` and ``sensor_msgs/msg/Imu``; ``/imus:left`` for a part of a message.
    name: str
    type: str
    #: Number of the container, and channel.
    channels: tuple[tuple[int, Channel], ...]
    #: What its messages can give; None where nothing, or not known how.
    imu: ImuFields | None = None
    #: Why its messages can't be read, though its type looks like an IMU's; else empty.
    reason: str = ""
    #: The field of a message that holds this IMU; empty where there is one only.
    part: str = ""
    #: The numbers in its messages.
    leaves: Leaves = field(default_factory=lambda: Leaves(()))
    #: The definitions of types that the user gives.
    given: Mapping[str, str] = field(default_factory=dict)

    @property
    def proposal(self) -> str:
        """A fields text that might read its messages; empty if there is none."""
        return self.leaves.proposal() if self.count != 0 and not is_command(self.name) else ""

    @property
    def count(self) -> int | None:
        """Number of messages, where it is known."""
        counts = [channel.count for _, channel in self.channels]
        known = [count for count in counts if count is not None]
        return sum(known) if len(known) == len(counts) else None

    @property
    def duration_s(self) -> float | None:
        """From the first message to the last, in s, where it is known."""
        firsts = [channel.first_ns for _, channel in self.channels if channel.first_ns is not None]
        lasts = [channel.last_ns for _, channel in self.channels if channel.last_ns is not None]
        return (max(lasts) - min(firsts)) / 1e9 if firsts and lasts else None

    @property
    def rate_hz(self) -> float | None:
        """Messages per second, where it is known."""
        count, duration = self.count, self.duration_s
        return (count - 1) / duration if count and duration and count > 1 else None


def find_topics(containers: Sequence[Container], options: ReadOptions) -> list[Topic]:
    """Return all topics of a log, in the order of its first file."""
    wanted = parse_fields_text(options.fields)
    given = read_definitions(options.message_definitions)
    groups: dict[tuple[str, str], list[tuple[int, Channel]]] = {}
    for number, container in enumerate(containers):
        for channel in container.channels:
            groups.setdefault((channel.topic, plain_type(channel.type)), []).append((number, channel))
    topics = [
        topic
        for channels in groups.values()
        for topic in _topics(channels, containers[channels[0][0]], options, wanted, given)
    ]
    imus = [topic.imu for topic in topics if topic.imu is not None]
    if wanted and wanted.temperature and imus and not any(imu.temperature for imu in imus):
        shown = next(topic.leaves.shown() for topic in topics if topic.imu is not None)
        msg = f"there is no temperature {wanted.temperature} in the messages with the samples; found {shown}"
        raise ChoiceError(msg)
    return topics


def _topics(
    channels: list[tuple[int, Channel]],
    container: Container,
    options: ReadOptions,
    wanted: FieldsText | None,
    given: Mapping[str, str],
) -> list[Topic]:
    """Return a topic as one entry for each IMU that its messages hold; one without IMU samples as it is."""
    channel = channels[0][1]
    name = channel.topic
    whole = Topic(name=name, type=channel.type, channels=tuple(channels), given=given)
    imus: dict[str, ImuFields] = {}
    try:
        leaves = _leaves(channel, container, whole.given)
        whole = replace(whole, leaves=leaves)
        if wanted is not None:
            asked = leaves.asked(wanted, options.time_unit)
            imus, reason = ({"": asked}, "") if isinstance(asked, ImuFields) else ({}, f"it has no {asked}")
        else:
            imus, reason = _known(channel, whole, options), ""
            if not imus:
                how = leaves.proposal()
                reason = (
                    "it has no fields named as angular velocity or linear acceleration; name them in a "
                    f"fields text{f' such as {how!r}' if how else ''}; found {leaves.shown()}"
                )
    except DefinitionError as error:
        reason = str(error)
    if not imus:
        meant = (
            wanted
            or _looks_like_imu(channel)
            or name in options.topics
            or definition_of(channel.type, whole.given)
        )
        return [replace(whole, reason=reason if meant else "")]
    return [
        replace(whole, name=f"{name}:{part}" if part else name, imu=imu, part=part)
        for part, imu in imus.items()
    ]


def _leaves(channel: Channel, container: Container, given: Mapping[str, str]) -> Leaves:
    """Return the numbers in the messages of a channel; those of JSON are those of the first message.

    Raises DefinitionError if the messages can't be read.
    """
    if channel.encoding == "json":
        first = first_message(container, channel.key)
        try:
            return Leaves(leaves_of_tree(json.loads(first)) if first is not None else ())
        except (ValueError, RecursionError):
            return Leaves(())
    if channel.encoding == "protobuf":
        return Leaves(schemas.protobuf_leaves(channel))
    if channel.encoding not in _ENCODINGS:
        msg = (
            f"messages are encoded as {channel.encoding!r}; expected one of {', '.join(_ENCODINGS)}; "
            "convert the log to CSV with a row per message, or to JSON messages"
        )
        raise DefinitionError(msg)
    definition = definition_of_channel(channel, given)
    # The flat fields say whether the definition is whole.
    definition.fields()
    return Leaves(schemas.ros_leaves(definition))


def _known(channel: Channel, topic: Topic, options: ReadOptions) -> dict[str, ImuFields]:
    """Return the IMUs that the fields of a channel's messages are recognised as."""
    if channel.encoding == "json":
        vectors = tuple(v for v in JSON_FIELDS.vectors if topic.leaves.vector(v.paths) is not None)
        known = len(vectors) == 2 or (not topic.leaves.all and _looks_like_imu(channel))
        return {"": JSON_FIELDS} if known else {}
    if channel.encoding == "protobuf":
        fields = tuple(schemas.protobuf_fields(channel))
    else:
        fields = definition_of_channel(channel, topic.given).fields()
    found = find_imus(channel.type, fields, channel.topic, _said(channel.topic, options))
    command = is_command(channel.topic) and channel.topic not in options.topics
    return {} if command and all(imu.plain for imu in found.values()) else found


def _said(name: str, options: ReadOptions) -> Sensor | None:
    """Return the sensor that the caller names a topic for: the first of two is the gyroscope."""
    if len(options.topics) == 2 and name in options.topics:
        return (Sensor.GYROSCOPE, Sensor.ACCELEROMETER)[options.topics.index(name)]
    return None


def _looks_like_imu(channel: Channel) -> bool:
    name = plain_type(channel.type).lower()
    return "imu" in name.rpartition("/")[2] or name.endswith(("sensorcombined", "vehicleimu"))


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """A topic to read, the sensors to take from it, and how it was chosen."""

    topic: Topic
    sensors: tuple[Sensor, ...]
    how: str


def choose(
    path: Path,
    topics: Sequence[Topic],
    options: ReadOptions,
    live: Callable[[Topic], frozenset[Sensor]],
) -> list[Choice]:
    """Choose topics; `live` says which sensors of a topic have data that change.

    Raises ChoiceError if several topics could be meant, or none fits; the message lists them.
    """
    if options.topics:
        return _named(path, topics, options, live)
    carrying = [topic for topic in topics if topic.imu is not None and topic.count != 0]
    fitting = [topic for topic in carrying if topic.imu is not None and not topic.imu.plain]
    if len(fitting) == 1:
        return [_whole(fitting[0], "the only topic with IMU samples")]
    if fitting:
        return _among(path, fitting, live)
    if carrying:
        why = (
            "no topic carries IMU messages, only vectors without a known meaning; choose one of these topics"
        )
        raise refused(path, f"{why}\n{table(carrying)}", ChoiceError)
    raise _nothing(path, topics, options)


def _nothing(path: Path, topics: Sequence[Topic], options: ReadOptions) -> ChoiceError:
    """Return the error of a log in which no topic can be meant."""
    if options.fields:
        lines = [
            f"  {topic.name} ({topic.type}): {topic.reason}; found {topic.leaves.shown()}"
            for topic in topics
            if topic.leaves.all or topic.reason
        ]
        listed = "\n".join(lines[:_MOST]) or "  nothing that can be read"
        why = "no topic has the fields in the fields text; found these topics"
        return refused(path, f"{why}\n{listed}", ChoiceError)
    unreadable = [topic for topic in topics if topic.reason and topic.count != 0]
    if unreadable:
        return _unreadable(path, unreadable[0], unreadable[0].reason)
    listed = table(topics) or "  no topics"
    able = [(topic.name, text) for topic in topics if (text := topic.proposal)]
    how = "".join(f"\n{name} can be read with a fields text such as {text!r}" for name, text in able[:3])
    why = "no topic carries a gyroscope or an accelerometer; found"
    return refused(path, f"{why}\n{listed}{how}", ChoiceError)


def table(topics: Sequence[Topic]) -> str:
    """Return the topics as lines of name, type, messages, rate and duration."""
    rows = []
    for topic in topics[:_MOST]:
        count = "? messages" if topic.count is None else f"{topic.count} messages"
        rate = "" if topic.rate_hz is None else f"{topic.rate_hz:.4g} Hz"
        duration = "" if topic.duration_s is None else f"{topic.duration_s:.4g} s"
        rows.append((topic.name, topic.type, count, rate, duration))
    a, b, c, d, _ = (max(map(len, column)) for column in zip(*rows, strict=True)) if rows else [0] * 5
    lines = [
        f"  {n:{a}}  {t:{b}}  {count:>{c}}  {rate:>{d}}  {last}".rstrip() for n, t, count, rate, last in rows
    ]
    if len(topics) > _MOST:
        lines.append(f"  and {len(topics) - _MOST} more")
    return "\n".join(lines)


def _whole(topic: Topic, how: str) -> Choice:
    sensors = topic.imu.sensors if topic.imu is not None else ()
    return Choice(topic, sensors, how)


def _unreadable(path: Path, topic: Topic, why: str) -> ChoiceError:
    return ChoiceError(f"{path}: topic {topic.name} of type {topic.type or 'unknown'} can't be read: {why}")


def _named(
    path: Path, topics: Sequence[Topic], options: ReadOptions, live: Callable[[Topic], frozenset[Sensor]]
) -> list[Choice]:
    """Take the topics the caller names: one, or one for each sensor."""
    if len(options.topics) > 2:
        msg = f"{path}: {len(options.topics)} topics are named; expected one, or one for each sensor"
        raise ChoiceError(msg)
    found = [_find(path, topics, name) for name in options.topics]
    for topic in found:
        if topic.imu is None:
            why = topic.reason or "its messages have no angular velocity or linear acceleration"
            why += f"; found {topic.leaves.shown()}" if options.fields else ""
            raise _unreadable(path, topic, why)
        if topic.count == 0:
            raise refused(path, f"topic {topic.name} has no messages; found\n{table(topics)}", ChoiceError)
    if len(found) == 1:
        return [_whole(found[0], "as given")]
    alive = [live(topic) for topic in found]
    for gyro, accel in ((0, 1), (1, 0)):
        if _GYRO in alive[gyro] and _ACCEL in alive[accel]:
            return _pair(found[gyro], found[accel], "as given")
    what = "; ".join(
        f"{topic.name}: {' and '.join(sorted(sensors)) or 'no samples that change'}"
        for topic, sensors in zip(found, alive, strict=True)
    )
    raise refused(path, f"the two topics are not a gyroscope and an accelerometer ({what})", ChoiceError)


def _find(path: Path, topics: Sequence[Topic], name: str) -> Topic:
    same = [topic for topic in topics if topic.name.strip("/") == name.strip("/")]
    if not same:
        listed = table(topics) or "  no topics"
        raise refused(path, f"there is no topic {name}; choose one of these topics\n{listed}", ChoiceError)
    return next((topic for topic in same if topic.imu is not None), same[0])


def _among(path: Path, fitting: Sequence[Topic], live: Callable[[Topic], frozenset[Sensor]]) -> list[Choice]:
    """Choose where several topics fit only if their data leave one way."""
    alive = {topic.name: live(topic) for topic in fitting}
    useful = [topic for topic in fitting if alive[topic.name]]
    if len(useful) == 1:
        return [_whole(useful[0], "the only topic whose samples change")]
    gyros = [topic for topic in useful if _GYRO in alive[topic.name]]
    accels = [topic for topic in useful if _ACCEL in alive[topic.name]]
    if len(gyros) == len(accels) == 1 and gyros[0] is not accels[0]:
        return _pair(gyros[0], accels[0], "the only topic of this sensor")
    msg = f"{path}: {len(fitting)} topics carry IMU samples; choose one of these topics\n{table(fitting)}"
    raise ChoiceError(msg)


def _pair(gyro: Topic, accel: Topic, how: str) -> list[Choice]:
    return [
        Choice(gyro, (_GYRO,), f"gyroscope, {how}"),
        Choice(accel, (_ACCEL,), f"accelerometer, {how}"),
    ]
