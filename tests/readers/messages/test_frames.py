"""The frame of a topic in every container, and messages without a readable frame."""

from pathlib import Path

import pytest

from imucal.readers import read
from imucal.readers.messages.plain import frame_of
from tests.readers.logs import CONTAINERS, imu_messages, samples, write_mcap


@pytest.mark.parametrize("container", CONTAINERS)
def test_every_container_contains_the_frame(container: str, tmp_path: Path) -> None:
    """The frame is one of the decisions of a recording."""
    path = CONTAINERS[container](tmp_path, samples(20))
    assert dict(read(path).source.decisions)["frame"] == "imu"


def test_the_frame_is_read_in_both_byte_orders(tmp_path: Path) -> None:
    """An empty name is no frame."""
    for frame, little in (("imu_link", True), ("base", False)):
        messages = imu_messages(samples(20), frames=(frame,), little_endian=little)
        decisions = dict(read(write_mcap(tmp_path / "log.mcap", messages)).source.decisions)
        assert decisions["frame"] == frame
    empty = write_mcap(tmp_path / "log.mcap", imu_messages(samples(20), frames=("",)))
    assert "frame" not in dict(read(empty).source.decisions)


@pytest.mark.parametrize(
    ("payload", "encoding", "frame"),
    [
        (b"\0\1\0\0" + bytes(8) + b"\4\0\0\0imu\0", "cdr", "imu"),
        (b"\0\0\0\0" + bytes(8) + b"\0\0\0\4imu\0", "cdr", "imu"),
        (bytes(12) + b"\3\0\0\0imu", "ros1", "imu"),
        (bytes(12) + b"\3\0\0\0imu", "json", ""),
        (bytes(12) + b"\3\0\0\0im", "ros1", ""),
        (bytes(12) + b"\0\0\0\0", "ros1", ""),
        (bytes(12) + b"\3\0\0", "ros1", ""),
        (bytes(12) + b"\3\0\0\0\x1b[m", "ros1", ""),
        (bytes(12) + b"\x2c\1\0\0" + b"x" * 300, "ros1", ""),
    ],
)
def test_an_invalid_frame_name_is_ignored(payload: bytes, encoding: str, frame: str) -> None:
    """Cases: truncated, longer than the message, too long, and not printable."""
    assert frame_of(payload, encoding) == frame
