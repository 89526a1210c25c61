"""What is in a log, without reading its samples: the values behind `imucal info`."""

from dataclasses import dataclass

from imucal.findings import Finding
from imucal.recording import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicContents:
    """One topic of a log, one message instance of a ULog, or the table a file holds.

    Attributes
    ----------
    name
        Topic, instance (``sensor_combined``) or table (the file's name).
    type
        Message type; for a table the kind of its layout, such as ``table`` or ``EuRoC``.
    count
        Number of messages or rows; None where only reading all of them would tell.
    rate_hz
        Messages per second, from the first to the last; None where there are fewer than two.
    duration_s
        From the first message to the last, in s.
    sensors
        What it can give: gyroscope, accelerometer, both or nothing.
    note
        Units, columns, or why it can't be read; one short sentence, or empty.
    fields
        The numbers in its messages with their types, such as ``gyro_x float32``; empty for a table.
    """

    name: str
    type: str
    count: int | None = None
    rate_hz: float | None = None
    duration_s: float | None = None
    sensors: tuple[Sensor, ...] = ()
    note: str = ""
    fields: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class LogContents:
    """What a log holds.

    Attributes
    ----------
    path
        As the user named it.
    format
        ``csv``, ``mcap``, ``rosbag1``, ``rosbag2-sqlite3``, …, as in `imucal.recording.Source`.
    size_bytes
        Size of the file, or of all files of a split log; None for a stream.
    topics
        In the order of the log.
    start_ns
        Time of the first message in ns since 1970; None where the log doesn't say.
    duration_s
        From the first message of any topic to the last, in s.
    compression
        Such as ``zstd`` or ``none``.
    findings
        What is wrong with the log's own bookkeeping: no index, cut, damaged.
    """

    path: str
    format: str
    size_bytes: int | None = None
    topics: tuple[TopicContents, ...] = ()
    start_ns: int | None = None
    duration_s: float | None = None
    compression: str = ""
    findings: tuple[Finding, ...] = ()

    @property
    def imu_topics(self) -> tuple[TopicContents, ...]:
        """The topics that carry a gyroscope or an accelerometer."""
        return tuple(topic for topic in self.topics if topic.sensors)
