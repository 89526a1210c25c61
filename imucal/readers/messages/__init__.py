"""Messages -> columns: which carry IMU samples, and where their numbers lie in the bytes."""

from imucal.readers.messages.loader import decode
from imucal.readers.messages.topic_streams import live_sensors, read_temperature, stream_of
from imucal.readers.messages.topics import Choice, Topic, choose, find_topics

__all__ = [
    "Choice",
    "Topic",
    "choose",
    "decode",
    "find_topics",
    "live_sensors",
    "read_temperature",
    "stream_of",
]
