"""Bags whose chunks hold records that are not alike: the short way for those that are must not be taken."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imucal.readers import read
from imucal.recording import Recording
from tests.readers.logs import TOPIC, Samples, imu_messages, samples, write_bag

TRUTH = samples(400, seed=20261)
#: Messages of about 380 bytes: several chunks of some eighty.
CHUNK = 1 << 15
#: Which message of a topic is made odd: the last of a chunk is the one that others are compared with.
ODD = 130
#: The fields of a message's header as the writer puts them, up to the eight bytes of the time.
HEAD = b"\4\0\0\0op=\2\x09\0\0\0conn=\0\0\0\0\x0d\0\0\0time="


def check(recording: Recording, truth: Samples = TRUTH) -> None:
    """Compare with the truth, bit by bit."""
    for place, series in enumerate(recording.series):
        np.testing.assert_array_equal(series.samples, truth.all[:, place])


def codes(recording: Recording) -> set[str]:
    """Return the codes of what was found."""
    return {finding.code for finding in recording.findings}


def changed(path: Path, change: Callable[[bytes], bytes]) -> Path:
    """Change the fields of the header of one message in the middle of a chunk."""
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
def test_messages_of_several_sizes_and_publishers_share_chunks(compression: str, tmp_path: Path) -> None:
    """Frame ids of other lengths, and a second sensor's messages in between."""
    own = imu_messages(TRUTH, ros1=True, frames=("imu", "imu", "imu", "a_longer_frame"))
    others = imu_messages(samples(400, seed=20262), ros1=True, topic="/other", frames=("x",))
    messages = [message for pair in zip(own, others, strict=True) for message in pair]
    path = write_bag(tmp_path / "log.bag", messages, compression=compression, chunk_size=CHUNK)
    recording = read(path, topic=TOPIC)
    check(recording)
    assert codes(recording) == {"delay"}


def test_a_size_may_change_from_a_chunk_to_the_next(tmp_path: Path) -> None:
    """What was learnt from one is not believed of the other."""
    short, long = (imu_messages(TRUTH, ros1=True, frames=(frame,)) for frame in ("imu", "a_longer_frame"))
    messages = [*short[:150], *long[150:250], *short[250:]]
    check(read(write_bag(tmp_path / "log.bag", messages, compression="lz4", chunk_size=CHUNK)))


def test_the_fields_of_one_header_may_have_another_order(tmp_path: Path) -> None:
    """The specification leaves the order open; nothing is lost and nothing is said."""

    def turn(fields: bytes) -> bytes:
        return fields[8:] + fields[:8]

    recording = read(changed(bag(tmp_path), turn))
    check(recording)
    assert codes(recording) == {"delay"}


def test_a_message_of_no_connection_is_lost_with_a_word(tmp_path: Path) -> None:
    """Its chunk is walked; all others are there."""
    recording = read(changed(bag(tmp_path), lambda head: head.replace(b"conn=\0", b"conn=\7")))
    assert {"index"} <= codes(recording)
    expected = np.delete(TRUTH.all, ODD, axis=0)
    for place, series in enumerate(recording.series):
        np.testing.assert_array_equal(series.samples, expected[:, place])


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_the_complete_part_of_a_truncated_bag_is_read(compression: str, tmp_path: Path) -> None:
    """The chunk in which it is cut is lost."""
    path = bag(tmp_path, compression=compression)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    recording = read(path)
    assert "truncated" in codes(recording)
    n = recording.series[0].samples.size
    assert 100 < n < 300
    for place, series in enumerate(recording.series):
        np.testing.assert_array_equal(series.samples, TRUTH.all[:n, place])
