"""A log with cameras: chunks without IMU messages are neither read nor unpacked."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest

from imucal.readers import read
from imucal.readers.files import LogFile
from tests.readers.logs import Message, imu_messages, samples, store, write_bag, write_mcap

TRUTH = samples(200)
#: Larger than a chunk of the writers, and not compressible.
PICTURE = np.random.default_rng(20261122).integers(0, 256, 20_000, dtype=np.uint8)
#: IMU messages between two pictures of each of three cameras.
BETWEEN = 20


def with_cameras(*, ros1: bool) -> list[Message]:
    """Return IMU messages with three pictures at a time in between."""
    types: Any = store(ros1=ros1)
    kind = "std_msgs/msg/UInt8MultiArray"
    dimensions = types.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    picture = types.types[kind](layout=dimensions, data=PICTURE)
    data = bytes((types.serialize_ros1 if ros1 else types.serialize_cdr)(picture, kind))
    messages: list[Message] = []
    for row, message in enumerate(imu_messages(TRUTH, ros1=ros1)):
        messages.append(message)
        if row % BETWEEN == 0:
            encoding = "ros1" if ros1 else "cdr"
            messages += [
                Message(topic=f"/camera{i}", type=kind, log=message.log, data=data, encoding=encoding)
                for i in range(3)
            ]
    return messages


def mcap(path: Path, messages: Sequence[Message]) -> Path:
    return write_mcap(path / "log.mcap", messages)


def bag(path: Path, messages: Sequence[Message]) -> Path:
    return write_bag(path / "log.bag", messages, compression="lz4")


@pytest.mark.parametrize(("write", "ros1"), [(mcap, False), (bag, True)])
def test_a_chunk_without_imu_messages_is_not_read(
    write: Callable[[Path, Sequence[Message]], Path],
    ros1: bool,  # noqa: FBT001
    tmp_path: Path,
) -> None:
    """At most one of three pictures shares a chunk with IMU messages, and every sample is read."""
    pictures = 3 * (TRUTH.stamps.size // BETWEEN) * PICTURE.size
    # A third of the pictures is in a chunk with IMU messages and must be unpacked.
    assert pictures / 6 < bytes_read(write(tmp_path, with_cameras(ros1=ros1))) < pictures / 2


def test_pictures_outside_chunks_are_not_read(tmp_path: Path) -> None:
    """Only the heads of their records are read, and every sample is."""
    messages = with_cameras(ros1=False)
    path = write_mcap(tmp_path / "log.mcap", messages, use_chunking=False)
    of_imu = sum(len(message.data) + 200 for message in messages if "camera" not in message.topic)
    assert bytes_read(path) < of_imu + 20_000


def bytes_read(path: Path) -> int:
    """Read a log, compare its samples with the truth, and return the number of different bytes read."""
    sizes: list[tuple[int, int]] = []
    read_bytes = LogFile.read

    def noted(file: LogFile, position: int, size: int) -> bytes:
        sizes.append((position, position + size))
        return read_bytes(file, position, size)

    with mock.patch.object(LogFile, "read", noted):
        recording = read(path)
    assert np.array_equal([series.samples for series in recording.series], TRUTH.all.T)
    read_of = np.zeros(path.stat().st_size, dtype=np.bool_)
    for first, last in sizes:
        read_of[first:last] = True
    return int(np.count_nonzero(read_of))
