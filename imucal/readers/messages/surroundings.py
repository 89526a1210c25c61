"""Read the frame in a message header, and the topic of temperature."""

from collections.abc import Sequence

import numpy as np

from imucal.errors import DataError, ReadError
from imucal.readers.clocks import clock_from_stamps
from imucal.readers.containers import Container
from imucal.readers.messages.definitions import plain_type
from imucal.readers.messages.loader import decode, first_message
from imucal.readers.messages.topics import Topic
from imucal.recording import Temperature

#: Bytes before the frame's length in a ROS 1 header, or a ROS 2 header with encapsulation.
_BEFORE = 12
#: A longer frame name is damage.
_MAX_FRAME_BYTES = 256


def first_frames(containers: Sequence[Container], topics: Sequence[Topic]) -> list[str]:
    """Return the frames of topics."""
    frames = []
    for topic in topics:
        headed = topic.leaves[:1] and topic.leaves[0].path.startswith("header.")
        for number, channel in topic.channels if headed else ():
            message = first_message(containers[number], channel.key, chunks=None)
            if message is not None:
                frames.append(frame_of(message, channel.encoding))
                break
    return [frame for frame in frames if frame]


def frame_of(message: bytes, encoding: str) -> str:
    """Return the frame in a message header; empty if its bytes can't be a name."""
    if encoding not in {"ros1", "cdr"} or len(message) < _BEFORE + 4:
        return ""
    # CDR: the second byte of the encapsulation contains the byte order.
    little = encoding == "ros1" or message[1] & 1
    end = _BEFORE + 4 + int.from_bytes(message[_BEFORE : _BEFORE + 4], "little" if little else "big")
    name = message[_BEFORE + 4 : end].rstrip(b"\x00")
    if not 0 < end - _BEFORE - 4 <= _MAX_FRAME_BYTES or end > len(message):
        return ""
    text = name.decode("utf-8", "replace")
    return text if text.isprintable() else ""


def temperature_topic(topics: Sequence[Topic], imu: str) -> Topic | None:
    """Return the topic of an IMU's temperature, the only one in its namespace; None if there is none."""
    space = imu.rpartition("/")[0]
    found = [
        topic
        for topic in topics
        if plain_type(topic.type) == "sensor_msgs/Temperature"
        and topic.count != 0
        and topic.name.startswith(space + "/")
    ]
    return found[0] if len(found) == 1 and space else None


def read_temperature(containers: Sequence[Container], topic: Topic) -> Temperature | None:
    """Return the temperature in a topic; None if it can't be read."""
    columns = {column.name: column for column in topic.columns}
    try:
        stream = topic.stream([columns["header.stamp"], columns["temperature"]])
        log, stamps, samples = decode(containers, [stream])[0].columns
        if stamps.size < 2:
            return None
        reading = clock_from_stamps(stamps, source="header stamp", log_ns=log)
    except (DataError, KeyError, ReadError):
        return None
    values = samples if reading.order is None else samples[reading.order]
    return Temperature(samples=np.asarray(values, np.float64), clock=reading.clock)
