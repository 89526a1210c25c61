"""The IMU's temperature from a topic of its own, such as ``/imu/temperature`` beside ``/imu/data``."""

from collections.abc import Sequence

from imucal.errors import DataError
from imucal.readers.clocks.from_stamps import clock_from_stamps
from imucal.readers.containers.container import Container
from imucal.readers.containers.loader import Decoder, Stream, decode
from imucal.readers.messages.decoder import BinaryDecoder, Shape
from imucal.readers.messages.definitions import BUILT_IN, built_in, flatten, plain_type
from imucal.readers.messages.message_types import Carrier, Stamp
from imucal.readers.messages.topics import Topic
from imucal.recording import Temperature

_TYPE = "sensor_msgs/Temperature"
_CARRIER = Carrier(
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
        if plain_type(topic.type) == _TYPE and topic.count != 0 and topic.name.startswith(space + "/")
    ]
    if len(beside) != 1 or not space:
        return None
    topic = beside[0]
    columns = decode(containers, [_stream(topic)])[0].columns
    if columns.temperature is None or columns.n < 2:
        return None
    try:
        reading = clock_from_stamps(columns.stamps, source="header stamp", log_ns=columns.log)
    except DataError:
        return None
    samples = columns.temperature if reading.order is None else columns.temperature[reading.order]
    return Temperature(samples=samples, clock=reading.clock), topic.name


def _stream(topic: Topic) -> Stream:
    """Return how to decode a topic by the standard definition of its type."""
    decoders: dict[tuple[int, int], Decoder] = {}
    for number, channel in topic.channels:
        ros1 = channel.encoding == "ros1"
        fields = flatten(_TYPE, built_in(_TYPE, ros1=ros1) or BUILT_IN[_TYPE], ros1=ros1)
        decoders[number, channel.key] = BinaryDecoder([Shape(fields, _CARRIER)], ros1=ros1, exact=True)
    return Stream(carrier=_CARRIER, decoders=decoders)
