"""How to decode the messages of a topic.

The frame of a topic: the `frame_id` that the header of its first message states.

Which sensors of a topic have data: a driver may fill a sensor that it hasn't got with one value.

The temperature that a topic beside an IMU's carries.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from imucal.errors import DataError, ReadError
from imucal.readers.clocks import clock_from_stamps
from imucal.readers.containers import Channel, Container
from imucal.readers.containers.container import Batch
from imucal.readers.files import DamagedError, Scratch
from imucal.readers.messages import protobuf_messages, ros_trees
from imucal.readers.messages.definitions import (
    DefinitionError,
    Field,
    built_in,
    definition_of_channel,
    flatten,
    plain_type,
)
from imucal.readers.messages.loader import Decoder, Stream, decode
from imucal.readers.messages.message_types import ImuFields, Stamp, find_imus
from imucal.readers.messages.plain import BinaryDecoder, Shape, reachable
from imucal.readers.messages.topics import Choice, Topic
from imucal.readers.messages.trees import JSON_FIELDS, TreeDecoder, tree_decoder
from imucal.readers.read_options import ReadOptions
from imucal.readers.store import is_constant
from imucal.recording import Sensor, Temperature


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
    definition = definition_of_channel(channel, options)
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


def _shape(channel: Channel, fields: tuple[Field, ...], topic: Topic, sensors: Sequence[Sensor]) -> Shape:
    sensor = sensors[0] if len(sensors) == 1 else None
    imu = find_imus(channel.type, fields, topic.name, sensor).get(topic.part)
    if imu is None:
        msg = f"topic {topic.name}: the files define {channel.type} differently"
        raise ReadError(msg)
    return Shape(fields, _only(imu, sensors))


def _only(imu: ImuFields, sensors: Sequence[Sensor]) -> ImuFields:
    return replace(imu, vectors=tuple(v for v in imu.vectors if v.sensor in sensors))


#: Bytes of a ROS 1 header, and of a ROS 2 header with its encapsulation, before the frame's length.
_BEFORE = {"ros1": 12, "cdr": 12}
#: A longer name is a damaged one.
_LONGEST = 256


def first_frames(containers: Sequence[Container], choices: Sequence[Choice]) -> list[tuple[str, str]]:
    """Return the frames of what was chosen as decisions of a recording; none of a topic without a frame."""
    frames = (first_frame(containers, choice.topic) for choice in choices)
    return [("frame", frame) for frame in frames if frame]


def first_frame(containers: Sequence[Container], topic: Topic) -> str:
    """Return the frame of a topic's first message; empty where its messages have no header, or no name.

    Nothing is taken on trust: what can't be a name is none.
    """
    if topic.imu is None or topic.imu.stamp is None or not topic.imu.stamp.sec.startswith("header."):
        return ""
    for number, channel in topic.channels:
        for payload in _first_payload(containers[number], channel):
            return _frame(payload, channel.encoding)
    return ""


def _first_payload(container: Container, channel: Channel) -> Iterator[bytes]:
    """Yield the start of the first message of a channel that can be read, if there is one."""
    scratch = Scratch()
    for task in container.tasks(frozenset([channel.key])):
        try:
            for key, batch in task.load(scratch):
                checked = batch.checked() if key == channel.key else batch
                if key == channel.key and checked.n:
                    yield _start(checked)
                    return
        except DamagedError:
            continue


def _start(batch: Batch) -> bytes:
    first = int(batch.payload()[0])
    size = batch.sizes if isinstance(batch.sizes, int) else int(batch.sizes[0])
    return bytes(memoryview(batch.buffer)[first : first + min(size, _BEFORE["cdr"] + 4 + _LONGEST)])


def _frame(payload: bytes, encoding: str) -> str:
    before = _BEFORE.get(encoding)
    if before is None or len(payload) < before + 4:
        return ""
    # ROS 1 is little endian; CDR says which it is in the second byte of its encapsulation.
    order = "little" if encoding == "ros1" or payload[1] & 1 else "big"
    length = int.from_bytes(payload[before : before + 4], order)  # type: ignore[arg-type]
    name = payload[before + 4 : before + 4 + length].rstrip(b"\x00")
    if not 0 < length <= _LONGEST or before + 4 + length > len(payload):
        return ""
    text = name.decode("utf-8", "replace")
    return text if text.isprintable() else ""


#: Chunks looked into to see whether a sensor has data: more where a few hold too few messages.
_LOOKS, _ENOUGH = (2, 32), 100


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


_TEMPERATURE = "sensor_msgs/Temperature"
_TEMPERATURE_FIELDS = ImuFields(
    stamp=Stamp(sec="header.stamp.sec", nanosec="header.stamp.nanosec"), vectors=(), temperature="temperature"
)


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
        text = built_in(_TEMPERATURE, ros1=ros1) or ""
        shape = Shape(flatten(_TEMPERATURE, text, ros1=ros1), _TEMPERATURE_FIELDS)
        decoders[number, channel.key] = BinaryDecoder([shape], ros1=ros1, exact=True)
    return Stream(imu=_TEMPERATURE_FIELDS, decoders=decoders)
