"""How to decode a topic; its frame, which of its sensors have data, and the temperature beside it."""

from collections.abc import Sequence
from dataclasses import replace

from imucal.errors import DataError, ReadError
from imucal.readers.clocks import clock_from_stamps
from imucal.readers.containers import Channel, Container
from imucal.readers.messages import schemas
from imucal.readers.messages.definitions import (
    DefinitionError,
    definition_of_channel,
    plain_type,
)
from imucal.readers.messages.loader import Decoder, Stream, decode, first_message
from imucal.readers.messages.message_types import ImuFields, Stamp, find_imus
from imucal.readers.messages.plain import BinaryDecoder, is_reachable
from imucal.readers.messages.topics import Choice, Topic
from imucal.readers.messages.trees import JSON_FIELDS, TreeDecoder, tree_decoder
from imucal.readers.store import is_constant
from imucal.recording import Sensor, Temperature

#: Bytes of a ROS 1 header, and of a ROS 2 header with its encapsulation, before the frame's length.
_BEFORE = 12
#: A longer name of a frame is a damaged one.
_LONGEST = 256
#: Chunks looked into to see whether a sensor has data: more where a few hold too few messages.
_LOOKS, _ENOUGH = (2, 32), 100

_TEMPERATURE = "sensor_msgs/Temperature"
_TEMPERATURE_FIELDS = ImuFields(
    stamp=Stamp("header.stamp.sec", "header.stamp.nanosec"),
    vectors=(),
    temperature="temperature",
    asked=True,
)


def stream_of(topic: Topic, sensors: Sequence[Sensor]) -> Stream:
    """Return how to decode some sensors of a topic.

    Raises ReadError if its messages can't be decoded.
    """
    if topic.imu is None:
        msg = f"topic {topic.name} of type {topic.type} can't be decoded: {topic.reason or 'no IMU samples'}"
        raise ReadError(msg)
    decoders: dict[tuple[int, int], Decoder] = {}
    imu = _only(topic.imu, sensors)
    for number, channel in topic.channels:
        try:
            decoder = _decoder(channel, topic, sensors)
        except DefinitionError as error:
            raise ReadError(f"topic {topic.name} of type {channel.type} can't be decoded: {error}") from error
        if isinstance(decoder, BinaryDecoder):
            imu = decoder.imu
        decoders[number, channel.key] = decoder
    return Stream(imu=imu, decoders=decoders)


def _decoder(channel: Channel, topic: Topic, sensors: Sequence[Sensor]) -> BinaryDecoder | TreeDecoder:
    """Return what decodes the messages of one channel of a topic."""
    imu = _only(topic.imu or JSON_FIELDS, sensors)
    if channel.encoding == "json":
        return tree_decoder(imu)
    if channel.encoding == "protobuf":
        return tree_decoder(imu, schemas.protobuf_parser(channel), "protobuf")
    ros1 = channel.encoding == "ros1"
    definition = definition_of_channel(channel, topic.given)
    fields = definition.fields()
    if imu.asked:
        if not is_reachable(imu, fields):
            return tree_decoder(imu, schemas.ros_parser(definition), "ROS")
        return BinaryDecoder(fields, imu, ros1=ros1)
    sensor = sensors[0] if len(sensors) == 1 else None
    found = find_imus(channel.type, fields, topic.name, sensor).get(topic.part)
    if found is None:
        raise ReadError(f"topic {topic.name}: the files define {channel.type} differently")
    return BinaryDecoder(fields, _only(found, sensors), ros1=ros1)


def _only(imu: ImuFields, sensors: Sequence[Sensor]) -> ImuFields:
    return replace(imu, vectors=tuple(v for v in imu.vectors if v.sensor in sensors))


def first_frames(containers: Sequence[Container], choices: Sequence[Choice]) -> list[tuple[str, str]]:
    """Return the frames of what was chosen as decisions of a recording; none of a topic without a frame."""
    frames = []
    for imu, channels in ((choice.topic.imu, choice.topic.channels) for choice in choices):
        headed = imu is not None and imu.stamp is not None and imu.stamp.sec.startswith("header.")
        for number, channel in channels if headed else ():
            message = first_message(containers[number], channel.key, chunks=None)
            if message is not None:
                frames.append(_frame(message, channel.encoding))
                break
    return [("frame", frame) for frame in frames if frame]


def _frame(message: bytes, encoding: str) -> str:
    """Return the frame in a header; nothing is taken on trust: what can't be a name is none."""
    if encoding not in {"ros1", "cdr"} or len(message) < _BEFORE + 4:
        return ""
    # ROS 1 is little endian; CDR says which it is in the second byte of its encapsulation.
    little = encoding == "ros1" or message[1] & 1
    end = _BEFORE + 4 + int.from_bytes(message[_BEFORE : _BEFORE + 4], "little" if little else "big")
    name = message[_BEFORE + 4 : end].rstrip(b"\x00")
    if not 0 < end - _BEFORE - 4 <= _LONGEST or end > len(message):
        return ""
    text = name.decode("utf-8", "replace")
    return text if text.isprintable() else ""


def live_sensors(containers: Sequence[Container], topic: Topic) -> frozenset[Sensor]:
    """Return the sensors whose samples change in the first chunks of a topic.

    One sample, or none that can be decoded, tells nothing: the type is believed then.
    """
    if topic.imu is None:
        return frozenset()
    stream = stream_of(topic, topic.imu.sensors)
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
    topic = replace(beside[0], imu=_TEMPERATURE_FIELDS)
    try:
        columns = decode(containers, [stream_of(topic, ())])[0].columns
        if columns.temperature is None or columns.n < 2:
            return None
        reading = clock_from_stamps(columns.stamps, source="header stamp", log_ns=columns.log)
    except (DataError, ReadError):
        return None
    samples = columns.temperature if reading.order is None else columns.temperature[reading.order]
    return Temperature(samples=samples, clock=reading.clock), topic.name
