"""Which sensors of a topic have data: a driver may fill a sensor that it hasn't got with one value."""

from collections.abc import Sequence

from imucal.readers.column_store import is_constant
from imucal.readers.containers import Container
from imucal.readers.messages.loader import decode
from imucal.readers.messages.topic_streams import stream_of
from imucal.readers.messages.topics import Topic
from imucal.readers.read_options import ReadOptions
from imucal.recording import Sensor

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
