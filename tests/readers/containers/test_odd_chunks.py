"""Bags with unequal records in a chunk, for which the fast decoder of equal records must not be used."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imucal.readers import read
from imucal.recording import Recording
from tests.readers.logs import TOPIC, Samples, imu_messages, samples, write_bag

TRUTH = samples(400, seed=20261)
#: Messages have about 380 bytes, so a chunk contains about eighty.
CHUNK = 1 << 15
#: The changed message: the last one of a chunk, because others are compared with it.
ODD = 130
#: The fields of a message header as written, without the eight bytes of the time.
HEAD = b"\4\0\0\0op=\2\x09\0\0\0conn=\0\0\0\0\x0d\0\0\0time="


def check(recording: Recording, truth: Samples = TRUTH) -> None:
    """Compare with the truth, bit by bit."""
    for place, series in enumerate(recording.series):
        np.testing.assert_array_equal(series.samples, truth.all[:, place])


def codes(recording: Recording) -> set[str]:
    """Return the codes of the findings."""
    return {finding.code for finding in recording.findings}


def changed(path: Path, change: Callable[[bytes], bytes]) -> Path:
    """Change the header fields of one message in the middle of a chunk."""
    data = path.read_bytes()
    heads = [place.start() for place in re.finditer(re.escape(HEAD), data)]
    assert len(heads) == TRUTH.stamps.size
    start, stop = heads[ODD], heads[ODD] + len(HEAD) + 8
    other = change(data[start:stop])
    assert len(other) == stop - start
    assert other != data[start:stop]
    path.write_bytes(data[:start] + other + data[stop:])
    return path


def bag(folder: Path, **more: str) -> Path:
    """Return a bag of one topic."""
    return write_bag(folder / "log.bag", imu_messages(TRUTH, ros1=True), chunk_size=CHUNK, **more)


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_chunks_can_contain_messages_of_several_sizes_and_publishers(
    compression: str, tmp_path: Path
) -> None:
    """Frame ids have different lengths, and messages of a second sensor are in between."""
    own = imu_messages(TRUTH, ros1=True, frames=("imu", "imu", "imu", "a_longer_frame"))
    others = imu_messages(samples(400, seed=20262), ros1=True, topic="/other", frames=("x",))
    messages = [message for pair in zip(own, others, strict=True) for message in pair]
    path = write_bag(tmp_path / "log.bag", messages, compression=compression, chunk_size=CHUNK)
    recording = read(path, topic=TOPIC)
    check(recording)
    assert codes(recording) == {"delay"}


def test_the_message_size_can_change_between_chunks(tmp_path: Path) -> None:
    """The layout of one chunk must not be applied to the next one."""
    short, long = (imu_messages(TRUTH, ros1=True, frames=(frame,)) for frame in ("imu", "a_longer_frame"))
    messages = [*short[:150], *long[150:250], *short[250:]]
    check(read(write_bag(tmp_path / "log.bag", messages, compression="lz4", chunk_size=CHUNK)))


def test_header_fields_can_have_any_order(tmp_path: Path) -> None:
    """The specification does not define the order. Nothing is lost or reported."""

    def turn(fields: bytes) -> bytes:
        return fields[8:] + fields[:8]

    recording = read(changed(bag(tmp_path), turn))
    check(recording)
    assert codes(recording) == {"delay"}


def test_a_message_of_an_unknown_connection_is_lost_and_reported(tmp_path: Path) -> None:
    """The chunk is searched record by record, and all other messages are read."""
    recording = read(changed(bag(tmp_path), lambda head: head.replace(b"conn=\0", b"conn=\7")))
    assert {"index"} <= codes(recording)
    expected = np.delete(TRUTH.all, ODD, axis=0)
    for place, series in enumerate(recording.series):
        np.testing.assert_array_equal(series.samples, expected[:, place])


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_the_complete_part_of_a_truncated_bag_is_read(compression: str, tmp_path: Path) -> None:
    """The chunk with the cut is lost."""
    path = bag(tmp_path, compression=compression)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    recording = read(path)
    assert "truncated" in codes(recording)
    n = recording.series[0].samples.size
    assert 100 < n < 300
    for place, series in enumerate(recording.series):
        np.testing.assert_array_equal(series.samples, TRUTH.all[:n, place])
