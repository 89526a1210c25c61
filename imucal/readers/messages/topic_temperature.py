"""The temperature that a topic beside an IMU's carries."""

from collections.abc import Sequence

from imucal.errors import DataError
from imucal.readers.clocks import clock_from_stamps
from imucal.readers.containers import Container
from imucal.readers.messages.decoder import BinaryDecoder, Shape
from imucal.readers.messages.definitions import (
    BUILT_IN,
    built_in,
    flatten,
    plain_type,
)
from imucal.readers.messages.loader import Decoder, Stream, decode
from imucal.readers.messages.message_types import ImuFields, Stamp
from imucal.readers.messages.topics import Topic
from imucal.recording import Temperature

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
        text = built_in(_TEMPERATURE, ros1=ros1) or BUILT_IN[_TEMPERATURE]
        shape = Shape(flatten(_TEMPERATURE, text, ros1=ros1), _TEMPERATURE_FIELDS)
        decoders[number, channel.key] = BinaryDecoder([shape], ros1=ros1, exact=True)
    return Stream(imu=_TEMPERATURE_FIELDS, decoders=decoders)
