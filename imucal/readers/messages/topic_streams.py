"""How to decode the messages of a topic."""

from collections.abc import Sequence
from dataclasses import replace

from imucal.errors import ReadError
from imucal.readers.containers import Channel
from imucal.readers.messages import protobuf_messages, ros_trees
from imucal.readers.messages.channel_definitions import definition_of_channel
from imucal.readers.messages.decoder import BinaryDecoder, Shape, reachable
from imucal.readers.messages.definitions import (
    DefinitionError,
    Field,
    built_in,
    flatten,
)
from imucal.readers.messages.list_messages import tree_decoder
from imucal.readers.messages.loader import Decoder, Stream
from imucal.readers.messages.message_types import ImuFields, find_imus
from imucal.readers.messages.topics import Topic
from imucal.readers.messages.tree_messages import JSON_FIELDS, TreeDecoder
from imucal.readers.read_options import ReadOptions
from imucal.recording import Sensor


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
