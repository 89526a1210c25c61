"""Records of containers, byte by byte: complete ones are parsed, ones a byte short are refused."""

import os
import re
import shutil
import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import numpy.testing as npt
import pytest

from imucal.errors import ReadError
from imucal.readers import describe
from imucal.readers.containers import Channel, mcap, ros1, rosbag2_folder
from imucal.readers.containers.container import Batch, gather
from imucal.readers.containers.ros2_bag import open_files
from imucal.readers.containers.rosbag2_folder import (
    MAX_METADATA,
    Metadata,
    natural,
    open_folder,
    parse_metadata,
)
from imucal.readers.files import DamagedError
from tests.raising import raises
from tests.readers.containers.mcap_bytes import channel, schema
from tests.readers.logs import imu_messages, samples, write_db3


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def test_an_mcap_record_must_have_all_its_fields() -> None:
    """At the end of a stream, the `mcap` package accepts records with missing bytes."""
    from mcap.records import Channel as ChannelRecord
    from mcap.records import Schema

    for kind, complete in ((Schema, schema(3)), (ChannelRecord, channel(7))):
        assert mcap.parsed(kind, complete).id in {3, 7}
        assert mcap.parsed(kind, complete + b"new field").id in {3, 7}
        for size in range(len(complete)):
            with pytest.raises(DamagedError, match=rf"^a {kind.__name__} record is damaged$"):
                mcap.parsed(kind, complete[:size])


def test_a_name_that_is_not_utf_8_is_damaged() -> None:
    from mcap.records import Channel as ChannelRecord

    with pytest.raises(DamagedError, match=r"^a Channel record is damaged$"):
        mcap.parsed(ChannelRecord, channel(7, b"/\xff"))


def test_a_ros1_record_is_parsed() -> None:
    head = text(text(b"op=\x02") + text(b"name=a=b"))
    found = ros1.record(b"??" + head + text(b"12345"), 2)
    assert found.fields == {b"op": b"\x02", b"name": b"a=b"}
    assert (found.start, found.end) == (2 + len(head) + 4, 2 + len(head) + 4 + 5)
    assert found.opcode == ros1.MESSAGE
    # The data may extend beyond the buffer; the header and the size may not.
    assert ros1.record(head + text(b"12345")[:4], 0).end == len(head) + 4 + 5
    for end in (0, 3, len(head) - 1, len(head) + 3):
        with pytest.raises(DamagedError, match=r"^a record header is damaged$"):
            ros1.record((head + text(b"12345"))[:end], 0)


@pytest.mark.parametrize(("size", "complete"), [(1 << 20, True), ((1 << 20) + 1, False)])
def test_a_header_has_at_most_a_megabyte(size: int, complete: bool) -> None:  # noqa: FBT001
    field = text(b"a=".ljust(size - 4, b"b"))
    buffer = text(field) + text(b"")
    if complete:
        assert len(ros1.record(buffer, 0).fields[b"a"]) == size - 6
    else:
        with pytest.raises(DamagedError, match=r"^a record header is damaged$"):
            ros1.record(buffer, 0)


@pytest.mark.parametrize("head", [b"", text(b"op="), text(b"op=\x02\x00")])
def test_a_record_without_an_opcode_is_damaged(head: bytes) -> None:
    with pytest.raises(DamagedError, match=r"^a record header is damaged$"):
        _ = ros1.Record(head, 0, 0).opcode


@pytest.mark.parametrize("broken", [text(b"op"), text(b"a=1")[:-1], text(b"")])
def test_a_field_has_a_name_and_all_its_bytes(broken: bytes) -> None:
    with pytest.raises(DamagedError, match=r"^a record header is damaged$"):
        ros1.fields(broken)


def test_a_ros1_connection_is_parsed() -> None:
    data = text(b"type=a/B") + text(b"message_definition=int8 x")
    found = ros1.Record(text(b"conn=" + struct.pack("<I", 258)) + text(b"topic=/imu"), 0, 0)
    assert ros1.connection(found, data) == Channel(
        key=258,
        topic="/imu",
        type="a/B",
        encoding="ros1",
        definition="int8 x",
        definition_kind="ros1msg",
    )
    bare = ros1.connection(ros1.Record(text(b"conn=" + bytes(4)), 0, 0), b"")
    assert bare == Channel(key=0, topic="", type="", encoding="ros1")


def test_messages_must_be_inside_their_chunk() -> None:
    buffer = bytes(range(6))
    at = np.array([0, 4])
    assert [bytes(item) for item in gather(buffer, at, 2)] == [b"\x00\x01", b"\x04\x05"]
    assert gather(b"", at[:0], 2).size == 0
    for places, width in (([5], 2), ([-1], 2), ([0], 7)):
        with pytest.raises(DamagedError, match=r"^a message extends beyond its chunk$"):
            gather(buffer, np.array(places), width)


def test_messages_of_a_batch_can_be_selected() -> None:
    starts, log = np.array([0, 10, 20]), np.array([1, 2, 3])
    batch = Batch(bytes(range(40)), starts, np.array([8, 9, 7]), log)
    for chosen in (np.array([0, 2]), slice(None, None, 2)):
        part = batch.part(chosen)
        npt.assert_array_equal(np.stack([part.starts, part.sizes, part.log_ns]), [[0, 20], [8, 7], [1, 3]])
        assert list(part.messages()) == [bytes(range(8)), bytes(range(20, 27))]


METADATA = """rosbag2_bagfile_information:
  compression_mode: 'message'
  topics_with_message_count:
    - topic_metadata:
        name: /imu
      message_count: 12
    - topic_metadata:
        name: "/gps"
      message_count: 3
"""


FILES = """  message_count: 15
  files:
    - path: a-1.db3
      message_count: 10
    - path: b.db3
      message_count: 5
"""


def test_ros2_metadata_are_parsed() -> None:
    paths = "  relative_file_paths:\n    - a-1.db3\n    - 'b.db3'\n"
    found = parse_metadata(METADATA + paths + FILES)
    assert found.files == ("a-1.db3", "b.db3")
    assert found.compression_mode == "message"
    assert found.topic_counts == {"/imu": 12, "/gps": 3}
    assert found.file_counts == {"a-1.db3": 10, "b.db3": 5}
    assert found.total == 15
    assert parse_metadata("") == Metadata()


def test_metadata_are_matched_line_by_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pattern over several lines would take minutes for 300 000 line feeds."""
    pattern, lines = rosbag2_folder._LINE, []

    def match(line: str) -> re.Match[str] | None:
        lines.append(line)
        return pattern.match(line)

    monkeypatch.setattr(rosbag2_folder, "_LINE", SimpleNamespace(match=match))
    for content in ("\n" * 300_000 + "x", "relative_file_paths:" + " \n" * 300_000 + "x"):
        lines.clear()
        assert parse_metadata(content) == Metadata()
        assert lines == content.splitlines()


def test_large_metadata_and_files_that_are_not_regular_are_refused(tmp_path: Path) -> None:
    """A link to /dev/zero has no end, and a pipe waits for its writer."""
    (tmp_path / "log.mcap").touch()
    metadata = tmp_path / "metadata.yaml"
    metadata.write_bytes(b"\n" * (MAX_METADATA + 1))
    with raises(ReadError, "more than 1 MB", place="metadata.yaml"):
        open_folder(tmp_path)
    metadata.unlink()
    metadata.symlink_to("/dev/zero")
    with raises(ReadError, "a device", place="metadata.yaml"):
        open_folder(tmp_path)
    metadata.unlink()
    os.mkfifo(metadata)
    with raises(ReadError, "a pipe", place="metadata.yaml"):
        open_folder(tmp_path)
    metadata.unlink()
    os.mkfifo(tmp_path / "more.mcap")
    with raises(ReadError, "a pipe", place="more.mcap"):
        open_folder(tmp_path)


def test_counts_in_the_metadata_that_differ_are_reported(tmp_path: Path) -> None:
    """The metadata count messages by topic, by file and in all."""
    path = write_db3(tmp_path / "bag", imu_messages(samples(5)))
    metadata = path / "metadata.yaml"
    old, new = "message_count: 5", "message_count: 6"
    assert describe(path).findings == ()
    for place in range(metadata.read_text().count(old)):
        parts = metadata.read_text().split(old)
        changed = old.join(parts[: place + 1]) + new + old.join(parts[place + 1 :])
        copy = shutil.copytree(path, tmp_path / f"copy_{place}")
        (copy / "metadata.yaml").write_text(changed)
        (finding,) = describe(copy).findings
        assert (finding.level, finding.code) == ("warning", "damaged")
        assert finding.text.startswith("metadata.yaml of the bag counts 6 messages")


def test_files_of_a_ros2_bag_are_sorted_by_number(tmp_path: Path) -> None:
    for name in ("bag_10.db3", "bag_2.db3", "bag_1.db3.zst", "notes.txt"):
        (tmp_path / name).touch()
    bare = open_folder(tmp_path)
    assert [file.name for file in bare.files] == ["bag_1.db3.zst", "bag_2.db3", "bag_10.db3"]
    assert (bare.missing, bare.per_message, bare.metadata) == ((), False, Metadata())
    metadata = tmp_path / "metadata.yaml"
    listed = METADATA + "  relative_file_paths:\n    - bag_1.db3\n    - x/bag_2.db3.zstd\n"
    metadata.write_text(listed)
    found = open_folder(tmp_path)
    assert [file.name for file in found.files] == ["bag_1.db3.zst", "bag_2.db3"]
    assert (found.missing, found.per_message) == ((), True)
    assert found.metadata.topic_counts == {"/imu": 12, "/gps": 3}
    metadata.write_text(listed + "    - bag_3.db3\n")
    found = open_folder(tmp_path)
    assert (len(found.files), found.missing) == (2, ("bag_3.db3",))


def test_numbers_in_names_sort_as_numbers() -> None:
    names = ["bag_10.db3", "bag_2.db3", "bag.db3"]
    assert sorted(names, key=lambda name: natural(Path(name))) == ["bag.db3", "bag_2.db3", "bag_10.db3"]


@pytest.mark.parametrize(("count", "named"), [(1, 1), (5, 5), (6, 5)])
def test_missing_files_of_a_bag_are_reported(count: int, named: int, tmp_path: Path) -> None:
    """The finding contains their number and at most five names."""
    write_db3(tmp_path / "bag", imu_messages(samples(5)))
    metadata = tmp_path / "bag" / "metadata.yaml"
    lost = [f"lost_{i}.db3" for i in range(count)]
    metadata.write_text(
        metadata.read_text().replace(
            "relative_file_paths:\n", "relative_file_paths:\n" + "".join(f"  - {name}\n" for name in lost)
        )
    )
    containers, _ = open_files(tmp_path / "bag")
    (finding,) = containers[0].findings
    for container in containers:
        container.close()
    assert finding.code == "file-missing"
    assert finding.text == (
        f"{count} files of the bag are missing: {', '.join(lost[:named])}; their time is a gap."
    )
