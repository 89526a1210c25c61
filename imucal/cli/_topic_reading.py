"""What reading each topic of a log shows."""

from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from imucal.cli._progress import download_progress
from imucal.errors import ImucalError
from imucal.readers import LogContents, read
from imucal.readers.remote_logs import local_logs
from imucal.recording import Recording
from imucal.remote import is_url


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicReading:
    """What reading a topic showed: its recording, or why there is none."""

    recording: Recording | None = None
    error: str = ""


def read_topics(log: str, contents: LogContents, reading: dict[str, Any]) -> dict[str, TopicReading]:
    """Read every topic that carries IMU samples; a table is read as a whole."""
    found = {}
    with ExitStack() as stack:
        with download_progress(quiet=not is_url(log)) as progress:
            logs = stack.enter_context(local_logs([log], progress=progress))
        for topic in contents.imu_topics:
            named = topic.name if len(contents.topics) > 1 else None
            try:
                recording = logs.named(read(*logs.paths, topic=named, **reading))
                found[topic.name] = TopicReading(recording=recording)
            except ImucalError as error:
                found[topic.name] = TopicReading(error=logs.said(str(error)))
    return found
