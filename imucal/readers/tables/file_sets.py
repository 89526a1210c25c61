"""Sets of text tables from phone apps, one per sensor; each file is a topic."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePath
from typing import NamedTuple

from imucal.readers.containers import Channel
from imucal.readers.messages import Choice, Column, Topic, choose
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.names import sensor_of_name
from imucal.recording import Sensor

#: Files without raw samples: estimates, other sensors, notes.
_LEFT_OUT = re.compile(
    r"linear|gravity|orientation|meta|annotation|magnet|baro|location|heart|pedo|step|light"
)

#: Preferred file names, best first.
_PREFERRED = {
    Sensor.GYROSCOPE: ("gyroscope", "raw data", "gyroscopeuncalibrated"),
    # Sensor Logger's Accelerometer.csv lacks gravity, TotalAcceleration.csv has it.
    Sensor.ACCELEROMETER: ("totalacceleration", "accelerometer", "accelerometeruncalibrated"),
}


class FileHead(NamedTuple):
    """The start of a text table."""

    header: str = ""
    sensors: tuple[Sensor, ...] = ()
    has_rows: bool = False


def chosen_files(path: Path, files: Mapping[str, FileHead], options: ReadOptions) -> list[Choice]:
    """Return the files named by the user as topics, or one per sensor.

    Raises ChoiceError if several files fit, or none.
    """
    topics = [_topic(name, head, options) for name, head in files.items()]
    if any(sensor_of_name(_stem(topic)) for topic in topics):
        # A file of several sensors repeats the samples of the others.
        topics = [topic if sensor_of_name(_stem(topic)) else replace(topic, plain=True) for topic in topics]
    for sensor in Sensor:
        passed_over = _worse(topics, sensor)
        topics = [replace(topic, plain=True) if topic in passed_over else topic for topic in topics]
    return choose(path, topics, options, lambda topic: frozenset(topic.sensors))


def _worse(topics: Sequence[Topic], sensor: Sensor) -> list[Topic]:
    """Return a sensor's files other than the one with the best name."""
    full = [topic for topic in topics if sensor in topic.sensors and topic.count != 0]
    for name in _PREFERRED[sensor]:
        if len(exact := [topic for topic in full if _stem(topic) == name]) == 1:
            return [topic for topic in full if topic is not exact[0]]
    return []


def _stem(topic: Topic) -> str:
    return PurePath(topic.name).stem.lower()


def _topic(name: str, head: FileHead, options: ReadOptions) -> Topic:
    channel = Channel(key=0, topic=name, type="table", encoding="", count=None if head.has_rows else 0)
    columns = (Column(head.header, "", "text"),)
    topic = Topic(name=name, type="table", channels=((0, channel),), columns=columns)
    named = sensor_of_name(_stem(topic))
    if _LEFT_OUT.search(_stem(topic)) and name not in options.topics:
        return topic
    return replace(topic, sensors=head.sensors if named is None else (named,))
