"""Messages -> columns: which carry IMU samples, and where their numbers lie in the bytes."""

from imucal.readers.messages.choice import Choice, choose
from imucal.readers.messages.loader import decode
from imucal.readers.messages.sensor_liveness import live_sensors
from imucal.readers.messages.topic_streams import stream_of
from imucal.readers.messages.topic_temperature import read_temperature
from imucal.readers.messages.topics import Topic, find_topics

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
