"""Messages -> columns: which carry IMU samples, and where their numbers lie in the bytes."""

from imucal.readers.messages.choice import Choice, choose
from imucal.readers.messages.loader import decode
from imucal.readers.messages.topics import Topic, find_topics, live_sensors, read_temperature, stream_of

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
