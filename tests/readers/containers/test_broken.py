"""Logs with known damage: intact data are read, and the amount of lost data is reported."""

import shutil
import sqlite3
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucal.errors import ImucalError, ReadError
from imucal.readers import describe, read
from imucal.recording import Recording
from tests.readers.logs import (
    TOPIC,
    Message,
    imu_messages,
    samples,
    store,
    write_bag,
    write_db3,
    write_mcap,
)

TRUTH = samples(400)


def rows(recording: Recording) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the samples, shape (n, 6)."""
    return np.array([series.samples for series in recording.series]).T


def codes(recording: Recording) -> set[str]:
    """Return the codes of the findings."""
    return {finding.code for finding in recording.findings}


def cut(path: Path, size: int) -> Path:
    """Write a copy of a file that is cut to a size, and return its path."""
    copy = path.with_name(f"{size}-{path.name}")
    copy.write_bytes(path.read_bytes()[:size])
    return copy


@pytest.mark.parametrize("name", ["mcap-zstd", "mcap-none", "bag-none", "bag-lz4"])
def test_a_cut_log_gives_its_first_samples(name: str, tmp_path: Path) -> None:
    """The log is cut at forty places; a longer file gives at least as many samples."""
    kind, _, compression = name.partition("-")
    ros1 = kind == "bag"
    messages = imu_messages(TRUTH, ros1=ros1)
    if kind == "mcap":
        path = write_mcap(tmp_path / "log.mcap", messages, compression=compression)
    else:
        path = write_bag(tmp_path / "log.bag", messages, compression=compression)
    size = path.stat().st_size
    counts = []
    for share in np.linspace(0.02, 0.999, 40):
        copy = cut(path, int(size * share))
        try:
            recording = read(copy)
        except ImucalError as error:
            assert str(error).startswith(str(copy))  # noqa: PT017 - reading may also succeed
            counts.append(0)
            continue
        n = recording.series[0].n
        assert np.array_equal(rows(recording), TRUTH.all[:n])
        assert codes(recording) & {"truncated", "damaged"}
        counts.append(n)
    assert counts == sorted(counts)
    assert counts[-1] >= 380
    # At three quarters of the file, at least half of the samples are read.
    assert counts[30] >= 200


def test_a_cut_database_is_refused(tmp_path: Path) -> None:
    """SQLite can't read part of a database; the error explains how to recover it."""
    path = next(write_db3(tmp_path / "bag", imu_messages(TRUTH)).glob("*.db3"))
    size = path.stat().st_size
    for share in np.linspace(0.02, 0.999, 20):
        copy = cut(path, int(size * share))
        with pytest.raises(ReadError) as caught:
            read(copy)
        assert str(caught.value).startswith(
            f"{copy}: the SQLite database can't be read: it has {int(size * share)} of {size} bytes; "
        )
        assert ".recover | sqlite3 recovered.db3`" in str(caught.value)


@pytest.mark.parametrize("compression", ["none", "message"])
def test_a_damaged_page_of_a_database_loses_its_messages(compression: str, tmp_path: Path) -> None:
    """The number of lost messages is reported."""
    path = next(write_db3(tmp_path / "bag", imu_messages(TRUTH), compression=compression).glob("*.db3"))
    data = path.read_bytes()
    # Leaf pages of a table start with 13; the last ones contain no message definitions.
    at = [at for at in range(0, len(data), 4096) if data[at] == 13][-5]
    path.write_bytes(data[:at] + bytes(4096) + data[at + 4096 :])
    recording = read(path)
    lost = 400 - recording.series[0].n
    assert 0 < lost < 60
    assert codes(recording) >= {"damaged", "gaps"}
    damage = next(f for f in recording.findings if f.text.startswith("The log is damaged in one place"))
    assert damage.code == "damaged"
    assert ": the SQLite database can't be read at rows " in damage.text
    assert f"; about {lost} messages are lost." in damage.text


def test_a_damaged_message_of_a_database_loses_its_neighbours(tmp_path: Path) -> None:
    """A group of 64 messages is lost and reported; a database is read in parts of thousands of messages."""
    path = next(write_db3(tmp_path / "bag", imu_messages(TRUTH)).glob("*.db3"))
    base = sqlite3.connect(path)
    (data,) = base.execute("select data from messages where id = 201").fetchone()
    # The length of the frame id follows the encapsulation and the stamp.
    base.execute("update messages set data = ? where id = 201", (data[:12] + b"\xff" * 4 + data[16:],))
    base.commit()
    base.close()
    recording = read(path)
    assert np.array_equal(rows(recording), np.delete(TRUTH.all, range(192, 256), axis=0))
    damage = next(f for f in recording.findings if f.code == "damaged")
    assert damage.text.startswith("The log is damaged in one place: ")
    assert damage.text.endswith("; about 64 messages are lost.")


def test_the_samples_after_a_damaged_part_of_a_bag_are_read(tmp_path: Path) -> None:
    """Inserted bytes shift the rest of the bag; the loss is reported with its number of messages."""
    path = write_bag(tmp_path / "log.bag", imu_messages(TRUTH, ros1=True), compression="bz2")
    data = path.read_bytes()
    middle = len(data) // 2
    path.write_bytes(data[:middle] + b"inserted" + data[middle:])
    recording = read(path)
    lost = 400 - recording.series[0].n
    assert 0 < lost < 50
    (gap,) = recording.series[0].clock.gaps
    assert gap.missing == lost
    texts = [finding.text for finding in recording.findings]
    assert any(text.startswith("The bag is damaged in one place (") for text in texts)
    assert any(text.endswith(f"; about {lost} messages are lost.") for text in texts)


def test_the_lost_bytes_of_a_cut_file_are_reported(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "log.mcap", imu_messages(TRUTH), compression="none")
    copy = cut(path, path.stat().st_size // 2)
    finding = read(copy).findings[0]
    assert finding.code == "truncated"
    assert finding.text.startswith(
        "The index can't be used (the end of the file is missing); all records were scanned instead. "
        "The last "
    )
    assert finding.text.endswith(f" of {copy.stat().st_size} bytes are cut off or damaged.")


def test_zeros_after_a_crash_are_the_end_of_the_log(tmp_path: Path) -> None:
    """File systems leave zeros if the data were not written before the crash."""
    path = write_mcap(tmp_path / "log.mcap", imu_messages(TRUTH))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2] + bytes(10_000))
    recording = read(path)
    n = recording.series[0].n
    assert 100 < n < 300
    assert np.array_equal(rows(recording), TRUTH.all[:n])
    assert "truncated" in codes(recording)


@pytest.mark.parametrize(
    "options",
    [
        {"use_chunking": False},
        {"index_types": 0},
        {"use_summary_offsets": False, "repeat_channels": False, "repeat_schemas": False},
    ],
    ids=lambda options: next(iter(options)),
)
def test_reads_mcap_without_index(options: dict[str, Any], tmp_path: Path) -> None:
    """Some writers omit chunks, indexes or the summary."""
    if "index_types" in options:
        from mcap.writer import IndexType

        options = {"index_types": IndexType.NONE}
    path = write_mcap(tmp_path / "log.mcap", imu_messages(TRUTH), **options)
    recording = read(path)
    assert np.array_equal(rows(recording), TRUTH.all)
    assert describe(path).topics[0].count == 400


def chunk_of(path: Path, number: int) -> tuple[int, int]:
    """Return the offset and the size of a chunk's data in an MCAP file."""
    from mcap.reader import make_reader

    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[number]
    return chunk.chunk_start_offset + 9 + 40 + len(chunk.compression), chunk.compressed_size


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_a_chunk_with_a_wrong_checksum_is_left_out(compression: str, tmp_path: Path) -> None:
    """The lost samples are reported as a gap with their number."""
    path = write_mcap(tmp_path / "log.mcap", imu_messages(TRUTH), compression=compression)
    start, size = chunk_of(path, 3)
    data = bytearray(path.read_bytes())
    data[start + size // 2] ^= 1
    path.write_bytes(data)
    recording = read(path)
    lost = 400 - recording.series[0].n
    assert 0 < lost < 40
    (gap,) = recording.series[0].clock.gaps
    assert gap.missing == lost
    damage = next(f for f in recording.findings if f.code in {"crc", "damaged"})
    assert damage.text.endswith(f"; about {lost} messages are lost.")
    with pytest.raises(ReadError) as caught:
        read(path, strict=True)
    assert str(caught.value) == (
        f"{path}: the log is damaged, and strict reading was requested: {damage.text}"
    )


def test_a_wrong_message_index_is_ignored(tmp_path: Path) -> None:
    """The chunk itself contains the lengths of its records."""
    path = write_mcap(tmp_path / "log.mcap", imu_messages(TRUTH), compression="none")
    start, size = chunk_of(path, 1)
    data = bytearray(path.read_bytes())
    # Opcode, length, channel and size come before the entries of time and offset.
    struct.pack_into("<Q", data, start + size + 15 + 8, 12345)
    path.write_bytes(data)
    recording = read(path)
    assert np.array_equal(rows(recording), TRUTH.all)
    assert "index" in codes(recording)


def test_all_messages_are_read_if_the_index_has_too_few_entries(tmp_path: Path) -> None:
    """The index is cut in half and has one wrong entry, so the chunk contains more messages than expected."""
    path = write_mcap(tmp_path / "log.mcap", imu_messages(TRUTH), compression="none")
    start, size = chunk_of(path, 1)
    data = bytearray(path.read_bytes())
    (length,) = struct.unpack_from("<Q", data, start + size + 1)
    entries = (length - 6) // 16 // 2
    struct.pack_into("<Q", data, start + size + 1, 6 + 16 * entries)
    struct.pack_into("<I", data, start + size + 11, 16 * entries)
    struct.pack_into("<Q", data, start + size + 15 + 8, 12345)
    path.write_bytes(data)
    recording = read(path)
    assert np.array_equal(rows(recording), TRUTH.all)
    assert "index" in codes(recording)


def test_reads_an_unindexed_bag(tmp_path: Path) -> None:
    """A killed `rosbag record` leaves a `.bag.active` file without index section."""
    path = write_bag(tmp_path / "log.bag", imu_messages(TRUTH, ros1=True), compression="lz4")
    data = path.read_bytes()
    at = data.index(b"index_pos=") + len(b"index_pos=")
    index = int.from_bytes(data[at : at + 8], "little")
    active = tmp_path / "log.bag.active"
    active.write_bytes(data[:at] + bytes(8) + data[at + 8 : index])
    recording = read(active)
    assert np.array_equal(rows(recording), TRUTH.all)
    assert recording.findings[0].code == "unindexed"
    assert recording.findings[0].text == ("The bag was not closed. All complete chunks were read.")


def test_refuses_an_encrypted_bag(tmp_path: Path) -> None:
    """The bag's header contains the name of the encryption plugin."""
    head = b"".join(
        len(field).to_bytes(4, "little") + field
        for field in (b"op=\x03", b"index_pos=" + bytes(8), b"encryptor=rosbag/AesCbcEncryptor")
    )
    path = tmp_path / "secret.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + len(head).to_bytes(4, "little") + head + bytes(4))
    with pytest.raises(ReadError) as caught:
        read(path)
    assert str(caught.value) == (
        f"{path}: the bag is encrypted by rosbag/AesCbcEncryptor; expected a plain bag, decrypt it first"
    )


def test_refuses_a_bag_of_version_1(tmp_path: Path) -> None:
    """ROS used another format before 2010."""
    path = tmp_path / "old.bag"
    path.write_bytes(b"#ROSBAG V1.2\n" + bytes(100))
    with pytest.raises(ReadError) as caught:
        read(path)
    assert str(caught.value) == (f"{path}: a bag of version 1.2; expected 2.0, convert it with `rosbag fix`")


def test_reads_a_write_ahead_log(tmp_path: Path) -> None:
    """A killed recorder leaves messages in a file next to the database."""
    path = next(write_db3(tmp_path / "bag", imu_messages(TRUTH)).glob("*.db3"))
    base = sqlite3.connect(path)
    base.execute("pragma journal_mode=wal")
    base.execute("pragma wal_autocheckpoint=0")
    (last,) = base.execute("select data from messages where id = 400").fetchone()
    base.execute("delete from messages where id > 390")
    base.execute("insert into messages values (400, 1, ?, ?)", (int(TRUTH.log[-1]), last))
    base.commit()
    killed = tmp_path / "killed.db3"
    for suffix in ("", "-wal", "-shm"):
        shutil.copy(f"{path}{suffix}", f"{killed}{suffix}")
    base.close()
    recording = read(killed)
    assert np.array_equal(rows(recording), TRUTH.all[[*range(390), 399]])


def test_a_write_ahead_log_that_can_not_be_read_is_reported(tmp_path: Path) -> None:
    """The messages in the database are still read."""
    path = next(write_db3(tmp_path / "bag", imu_messages(TRUTH)).glob("*.db3"))
    path.with_name(path.name + "-wal").write_bytes(b"no write-ahead log" * 100)
    recording = read(path)
    assert np.array_equal(rows(recording), TRUTH.all)
    assert "wal-ignored" in codes(recording)


def test_rows_over_several_pages_are_read(tmp_path: Path) -> None:
    """Messages of 330 bytes do not fit in a page of 512 bytes; images never fit in one page."""
    types = store()
    kind = "std_msgs/msg/String"
    big = bytes(types.serialize_cdr(types.types[kind](data="x" * 20_000), kind))
    image = [Message(topic="/image", type=kind, log=int(TRUTH.log[row]) + 1, data=big) for row in (5, 200)]
    messages = sorted(imu_messages(TRUTH) + image, key=lambda message: message.log)
    path = next(write_db3(tmp_path / "bag", messages).glob("*.db3"))
    assert np.array_equal(rows(read(path)), TRUTH.all)
    base = sqlite3.connect(path, isolation_level=None)
    base.execute("pragma page_size=512")
    base.execute("vacuum")
    base.close()
    recording = read(path)
    assert np.array_equal(rows(recording), TRUTH.all)
    assert codes(recording) == {"delay"}


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_claims_of_impossible_sizes_take_no_memory(compression: str, tmp_path: Path) -> None:
    """The chunk's header contains a size of one exabyte."""
    import tracemalloc

    path = write_mcap(tmp_path / "log.mcap", imu_messages(TRUTH), compression=compression)
    start, _ = chunk_of(path, 2)
    data = bytearray(path.read_bytes())
    # The uncompressed size comes before the checksum, the name of the compression and the data's size.
    struct.pack_into("<Q", data, start - 8 - (len(compression) if compression != "none" else 0) - 16, 1 << 60)
    path.write_bytes(data)
    tracemalloc.start()
    recording = read(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert 300 < recording.series[0].n < 400
    assert peak < 100e6


def test_a_bag_that_claims_billions_of_messages_takes_no_memory(tmp_path: Path) -> None:
    """The counts are limited to the number of index entries that fit into the file."""
    path = write_bag(tmp_path / "log.bag", imu_messages(TRUTH, ros1=True))
    data = bytearray(path.read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    index = int.from_bytes(data[at : at + 8], "little")
    chunk = data.index(b"chunk_pos=", index)
    place = data.index((0).to_bytes(4, "little") + (23).to_bytes(4, "little"), chunk)
    struct.pack_into("<I", data, place + 4, (1 << 32) - 1)
    path.write_bytes(data)
    assert np.array_equal(rows(read(path)), TRUTH.all)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("no.mcap", b"", "the file is empty; expected a log"),
        ("no.db3", b"SQLite format 3\0" + bytes(100), "the SQLite database can't be read"),
        (
            "no.bag",
            b"hello",
            "not a ROS 1 bag (first bytes b'hello'); expected b'#ROSBAG V2.0\\n', copy or record",
        ),
        ("no.bag", b"#ROSBAG V2.0\n", "the bag is cut off or damaged: no connection was found"),
        (
            "no.mcap",
            b"\x89MCAP0\r\n",
            "the file does not start and end as an MCAP file, and no channel was found",
        ),
        ("no.bin", bytes(range(256)) * 8, "binary data of an unknown format (first bytes 00 01 02 03"),
    ],
)
def test_refuses_a_file_of_another_format(name: str, content: bytes, message: str, tmp_path: Path) -> None:
    """The files are empty or have no content after their first bytes."""
    path = tmp_path / name
    path.write_bytes(content)
    for action in (read, describe):
        with pytest.raises(ReadError) as caught:
            action(path)
        assert str(caught.value).startswith(f"{path}: {message}")


def test_a_missing_file_is_reported_with_the_reason(tmp_path: Path) -> None:
    path = tmp_path / "nowhere.mcap"
    with pytest.raises(ReadError) as caught:
        read(path)
    assert str(caught.value) == f"{path}: can't be opened: No such file or directory"


def test_a_log_without_messages_is_refused(tmp_path: Path) -> None:
    """A recorder that is started and stopped at once leaves such a log."""
    path = write_mcap(tmp_path / "log.mcap", imu_messages(samples(1))[:0])
    with pytest.raises(ReadError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert TOPIC not in str(caught.value)
