"""Tests of corrected logs of messages: only the samples of the IMU change, in every container."""

import hashlib
import re
import shutil
import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard

import imucal
from imucal.arrays import FloatArray
from imucal.calibration.document import Intrinsics
from imucal.correction.rewriting import apply_to_log
from imucal.errors import ArgumentError, DataError, ReadError, WriteError
from imucal.readers.containers.mcap import CHUNK, MAGIC, each_record, unpack, walk_records
from imucal.readers.read_options import ReadOptions
from tests.calibration.test_exports import FOUND
from tests.raising import raises
from tests.readers.logs import (
    Message,
    Samples,
    header,
    imu_messages,
    samples,
    store,
    write_bag,
    write_db3,
    write_mcap,
)

IMAGE = "sensor_msgs/msg/Image"
CAMERA = "/camera/image"
OPTIONS = ReadOptions()


def images(truth: Samples, *, ros1: bool) -> list[Message]:
    """Return an image after every tenth sample, of random bytes."""
    types = store(ros1=ros1)
    rng = np.random.default_rng(5)
    messages = []
    for log in truth.log[::10].tolist():
        image = types.types[IMAGE](
            header=header(types, log, "camera"),
            height=16,
            width=32,
            encoding="mono8",
            is_bigendian=0,
            step=32,
            data=rng.integers(0, 256, 512).astype(np.uint8),
        )
        data = types.serialize_ros1(image, IMAGE) if ros1 else types.serialize_cdr(image, IMAGE)
        encoding = "ros1" if ros1 else "cdr"
        messages.append(Message(topic=CAMERA, type=IMAGE, log=log + 1, data=bytes(data), encoding=encoding))
    return messages


def with_camera(truth: Samples, *, ros1: bool = False, **options: Any) -> list[Message]:  # noqa: ANN401
    """Return the messages of an IMU and a camera in the order of their times."""
    every = [*imu_messages(truth, ros1=ros1, **options), *images(truth, ros1=ros1)]
    return sorted(every, key=lambda message: message.log)


def _mcap(folder: Path, truth: Samples, **options: Any) -> Path:  # noqa: ANN401
    return write_mcap(folder / "log.mcap", with_camera(truth), **options)


#: Name of a container -> function that writes a log with a camera.
LOGS: dict[str, Callable[[Path, Samples], Path]] = {
    "mcap-zstd": _mcap,
    "mcap-lz4": lambda folder, truth: _mcap(folder, truth, compression="lz4"),
    "mcap-none": lambda folder, truth: _mcap(folder, truth, compression="none"),
    "mcap-without-chunks": lambda folder, truth: _mcap(folder, truth, use_chunking=False),
    "mcap-without-index": lambda folder, truth: _mcap(
        folder, truth, use_summary_offsets=False, use_statistics=False
    ),
    "mcap-big-endian": lambda folder, truth: write_mcap(
        folder / "log.mcap", with_camera(truth, little_endian=False, frames=("imu", "another"))
    ),
    "bag-none": lambda folder, truth: write_bag(folder / "log.bag", with_camera(truth, ros1=True)),
    "bag-lz4": lambda folder, truth: write_bag(
        folder / "log.bag", with_camera(truth, ros1=True), compression="lz4"
    ),
    "bag-bz2": lambda folder, truth: write_bag(
        folder / "log.bag", with_camera(truth, ros1=True), compression="bz2"
    ),
    "db3": lambda folder, truth: write_db3(folder / "bag", with_camera(truth)),
    "db3-file": lambda folder, truth: write_db3(folder / "bag", with_camera(truth), compression="file"),
    "db3-message": lambda folder, truth: write_db3(folder / "bag", with_camera(truth), compression="message"),
    "rosbag2-mcap": lambda folder, truth: write_db3(folder / "bag", with_camera(truth), mcap=True),
    "rosbag2-mcap-file": lambda folder, truth: write_db3(
        folder / "bag", with_camera(truth), mcap=True, compression="file"
    ),
}


def contents(path: Path) -> list[tuple[str, int, str]]:
    """Return topic, log time and checksum of each message, read by rosbags or the mcap package."""
    if path.suffix == ".mcap":
        from mcap.reader import make_reader

        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            found = [
                (channel.topic, message.log_time, message.data)
                for _, channel, message in reader.iter_messages(log_time_order=False)
            ]
    else:
        from rosbags.highlevel import AnyReader

        with AnyReader([path], default_typestore=store()) as bag:
            found = [(one.topic, time, bytes(data)) for one, time, data in bag.messages()]
    return [(topic, time, hashlib.sha256(data).hexdigest()) for topic, time, data in found]


def values(path: Path) -> FloatArray:
    """Return the six axes of a log, shape (n, 6)."""
    return np.column_stack([series.samples for series in imucal.read(path).series])


def expected(truth: Samples, found: Intrinsics = FOUND) -> FloatArray:
    """Return the corrected axes: f = C (raw - b), w = C (raw - b - G f)."""
    assert found.C_g is not None
    assert found.b_g is not None
    assert found.G is not None
    force = (truth.accel - found.b_a) @ found.C_a.T
    rate = (truth.gyro - found.b_g - force @ found.G.T) @ found.C_g.T
    return np.hstack([rate, force])


@pytest.mark.parametrize("name", LOGS)
def test_only_samples_of_the_imu_change(name: str, tmp_path: Path) -> None:
    """Other topics, times and the order are equal; the result is not corrected again."""
    truth = samples(300, seed=81)
    log = LOGS[name](tmp_path, truth)
    out = tmp_path / ("out" + log.suffix)
    done = apply_to_log(FOUND, log, out, OPTIONS)
    assert (done.path, done.samples, done.corrected) == (out, 300, ("/imu/data",))
    np.testing.assert_allclose(values(out), expected(truth), rtol=1e-13, atol=1e-13)
    before, after = contents(log), contents(out)
    assert [one[:2] for one in before] == [one[:2] for one in after]
    assert [one for one in before if one[0] == CAMERA] == [one for one in after if one[0] == CAMERA]
    assert len([one for one in after if one[0] == CAMERA]) == 30
    assert imucal.read(out).findings == imucal.read(log).findings
    with raises(DataError, "already corrected"):
        apply_to_log(FOUND, out, tmp_path / "twice", OPTIONS)
    assert not (tmp_path / "twice").exists()


def test_the_chunks_of_a_bag_are_frames_that_ros1_reads(tmp_path: Path) -> None:
    """roslz4 refuses a frame with its size, with linked blocks, or without a checksum of its content."""
    log = LOGS["bag-lz4"](tmp_path, samples(3000, seed=90))
    out = tmp_path / "out.bag"
    apply_to_log(FOUND, log, out, OPTIONS)
    changed = frames(out.read_bytes())
    assert len(changed) > 0
    assert set(changed) == {0b01100100}


def test_a_packed_file_states_its_size(tmp_path: Path) -> None:
    """Some versions of rosbag2 need it."""
    log = LOGS["db3-file"](tmp_path, samples(300, seed=91))
    apply_to_log(FOUND, log, tmp_path / "out", OPTIONS)
    (file,) = (tmp_path / "out").glob("*.zstd")
    head = zstandard.get_frame_parameters(file.read_bytes()[:18])
    assert head.content_size not in {zstandard.CONTENTSIZE_UNKNOWN, 0}


def frames(data: bytes) -> list[int]:
    """Return the flags of all lz4 frames in a file: version, independent blocks, checksums and size."""
    return [data[match.end()] for match in re.finditer(rb"\x04\x22\x4d\x18", data)]


def test_a_file_without_the_imu_stays_byte_for_byte(tmp_path: Path) -> None:
    """Chunks that contain no sample are copied, and the positions of the index are moved by as much."""
    truth = samples(400, seed=82)
    messages = imu_messages(truth)
    # All images come after the samples, in chunks of their own.
    late = [replace(one, log=one.log + 10**10) for one in images(truth, ros1=False)]
    log = write_mcap(tmp_path / "log.mcap", [*messages, *late], chunk_size=4096)
    out = tmp_path / "out.mcap"
    apply_to_log(FOUND, log, out, OPTIONS)
    before, after = log.read_bytes(), out.read_bytes()
    records = [before[at + len(MAGIC) : end + len(MAGIC)] for _, at, end in each_record(before[len(MAGIC) :])]
    kept = [one for one in records if one[0] == CHUNK and 1 not in walk_records(unpack(memoryview(one)))]
    assert len(kept) >= 4
    assert all(one in after for one in kept)
    assert contents(out)[-40:] == contents(log)[-40:]


def test_attachments_and_metadata_are_kept(tmp_path: Path) -> None:
    """Their positions in the index are valid."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    truth = samples(50, seed=83)
    types = store()
    text, _ = types.generate_msgdef("sensor_msgs/msg/Imu", ros_version=2)
    log = tmp_path / "log.mcap"
    with log.open("wb") as file:
        writer = Writer(file, chunk_size=2048)
        writer.start("ros2", "test")
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", text.encode())
        channel = writer.register_channel("/imu/data", "cdr", schema)
        for number, message in enumerate(imu_messages(truth)):
            writer.add_message(channel, message.log, message.data, message.log, number)
            if number == 25:
                writer.add_attachment(1, 2, "notes.txt", "text/plain", b"a note")
                writer.add_metadata("robot", {"name": "r2"})
        writer.finish()  # type: ignore[no-untyped-call]
    out = tmp_path / "out.mcap"
    apply_to_log(FOUND, log, out, OPTIONS)
    with out.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert [(one.name, one.data) for one in reader.iter_attachments()] == [("notes.txt", b"a note")]
        metadata = {one.name: dict(one.metadata) for one in reader.iter_metadata()}
        summary = reader.get_summary()
    assert metadata["robot"] == {"name": "r2"}
    assert "calibration poses.mcap" in metadata["imucal-corrected"]["corrected"]
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.metadata_count == 2
    assert len(summary.metadata_indexes) == 2


def test_two_topics_of_different_rates(tmp_path: Path) -> None:
    """The force is interpolated at the stamps of the gyroscope, for g-sensitivity."""
    fast, slow = samples(400, rate=400.0, seed=84), samples(100, rate=100.0, seed=85)
    messages = [
        *imu_messages(replace(fast, accel=np.zeros_like(fast.accel)), topic="/gyro"),
        *imu_messages(replace(slow, gyro=np.zeros_like(slow.gyro)), topic="/accel"),
    ]
    log = write_mcap(tmp_path / "log.mcap", sorted(messages, key=lambda one: one.log))
    out = tmp_path / "out.mcap"
    options = ReadOptions(topics=("/gyro", "/accel"))
    apply_to_log(FOUND, log, out, options)
    recording = imucal.read(out, topic=["/gyro", "/accel"])
    rate = np.column_stack([one.samples for one in recording.series[:3]])
    force = np.column_stack([one.samples for one in recording.series[3:]])
    assert FOUND.C_g is not None
    assert FOUND.b_g is not None
    assert FOUND.G is not None
    np.testing.assert_allclose(force, (slow.accel - FOUND.b_a) @ FOUND.C_a.T, rtol=1e-13)
    between = np.column_stack([np.interp(fast.stamps, slow.stamps, column) for column in force.T])
    wanted = (fast.gyro - FOUND.b_g - between @ FOUND.G.T) @ FOUND.C_g.T
    np.testing.assert_allclose(rate, wanted, atol=1e-12)


def test_damaged_and_unfit_logs_are_refused(tmp_path: Path) -> None:
    """Nothing is written."""
    truth = samples(300, seed=86)
    whole = LOGS["mcap-zstd"](tmp_path, truth)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[:-2000])
    out = tmp_path / "out"
    with raises(DataError, "is damaged", place="cut.mcap"):
        apply_to_log(FOUND, cut, out, OPTIONS)
    bag = LOGS["bag-none"](tmp_path, truth)
    short = tmp_path / "short.bag"
    short.write_bytes(bag.read_bytes()[:-200])
    with raises(DataError, "is damaged", place="short.bag"):
        apply_to_log(FOUND, short, out, OPTIONS)
    columns = {"time (s)": np.arange(300) / 100, "gz (rad/s)": truth.gyro[:, 0]}
    np.savez(tmp_path / "log.npz", **columns)  # type: ignore[arg-type] # its last argument is a flag
    with raises(DataError, "only the axes z"):
        apply_to_log(FOUND, tmp_path / "log.npz", out, OPTIONS)
    packed = write_db3(tmp_path / "packed", imu_messages(truth), mcap=True, compression="message")
    with raises(DataError, "compressed one by one"):
        apply_to_log(FOUND, packed, out, OPTIONS)
    with raises(WriteError, "exists already"):
        apply_to_log(FOUND, bag, short, OPTIONS)
    counts = replace(FOUND, said_si=False)
    with raises(DataError, "the calibration poses.mcap is in raw counts"):
        apply_to_log(counts, whole, out, OPTIONS)
    assert not out.exists()


@pytest.mark.parametrize(("log", "out"), [("mcap-zstd", "out.csv"), ("bag-none", "out.MCAP")])
def test_a_name_of_another_format_is_refused(log: str, out: str, tmp_path: Path) -> None:
    """The corrected log has the format of the log; nothing is written."""
    path = LOGS[log](tmp_path, samples(50, seed=92))
    with raises(ArgumentError, f"name it out{path.suffix}"):
        apply_to_log(FOUND, path, tmp_path / out, OPTIONS)
    assert not (tmp_path / out).exists()


def test_other_formats_are_refused(tmp_path: Path) -> None:
    """They have no writer."""
    truth = samples(300, seed=87)
    columns = {"time (s)": np.arange(300) / 100, "gyro (rad/s)": truth.gyro, "accel (m/s^2)": truth.accel}
    np.savez(tmp_path / "log.npz", **columns)  # type: ignore[arg-type] # its last argument is a flag
    with raises(ReadError, "the format npz can't be written"):
        apply_to_log(FOUND, tmp_path / "log.npz", tmp_path / "out.npz", OPTIONS)


def test_messages_that_are_only_in_the_log_of_sqlite(tmp_path: Path) -> None:
    """A database that was not closed keeps its last messages in a file of its own."""
    truth = samples(200, seed=88)
    folder = LOGS["db3"](tmp_path, truth)
    (file,) = folder.glob("*.db3")
    base = sqlite3.connect(file)
    base.execute("pragma journal_mode=wal")
    base.execute("update topics set offered_qos_profiles = 'changed'")
    base.commit()
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    base.close()
    assert list(copy.glob("*-wal"))
    out = tmp_path / "out"
    apply_to_log(FOUND, copy, out, OPTIONS)
    np.testing.assert_allclose(values(out), expected(truth), rtol=1e-13, atol=1e-13)


def test_the_progress_ends_at_the_size_of_the_log(tmp_path: Path) -> None:
    """It never goes back."""
    log = LOGS["mcap-zstd"](tmp_path, samples(300, seed=89))
    seen: list[tuple[int, int]] = []
    apply_to_log(
        FOUND,
        log,
        tmp_path / "out.mcap",
        ReadOptions(progress=lambda done, total: seen.append((done, total))),
    )
    assert seen[-1] == (2 * log.stat().st_size, 2 * log.stat().st_size)
    shares = [done / total for done, total in seen]
    assert shares == sorted(shares)
