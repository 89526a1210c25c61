"""Nanoseconds of CPU per IMU message: imucal, rosbags, mcap and the bare decompression, side by side.

    python tests/benchmarks/bench_readers.py --n 2000000 --peers 60000 --formats mcap-zstd bag-lz4

Writes logs of `sensor_msgs/Imu` at 200 Hz among other topics to a temporary folder. Peers read the first
`--peers` messages only: their cost per message does not depend on the length. Every result of imucal is
compared with the truth, bit by bit.
"""

import argparse
import bz2
import importlib.util
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, cast

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.recording import Recording

FORMATS = ("mcap-zstd", "mcap-lz4", "mcap-none", "bag-none", "bag-lz4", "bag-bz2", "db3")
RATE = 200
START = 1_700_000_000_000_000_000
TOPIC = "/imu/data"


def truth(n: int) -> tuple[IntArray, FloatArray]:
    """Return stamps in ns, shape (n,), and samples, shape (n, 6), as a 16-bit sensor gives them."""
    rng = np.random.default_rng(20240607)
    stamps = START + np.arange(n, dtype=np.int64) * (10**9 // RATE) + rng.normal(0, 20e3, n).astype(np.int64)
    samples = rng.normal(0, 0.01, (n, 6)) + np.array([0.003, -0.002, 0.001, 0.02, -0.05, 9.81])
    steps = np.deg2rad(250) / 32768, 4 * 9.80665 / 32768
    samples[:, :3] = np.rint(samples[:, :3] / steps[0]) * steps[0]
    samples[:, 3:] = np.rint(samples[:, 3:] / steps[1]) * steps[1]
    return stamps, samples


def payloads(n: int, *, ros1: bool) -> Iterator[tuple[int, bytes]]:
    """Yield log time and payload of every IMU message."""
    head = ["seq", "sec", "nsec", "len", "frame"] if ros1 else ["enc", "sec", "nsec", "len", "frame"]
    form = ["<u4", "<u4", "<u4", "<u4", "S8"] if ros1 else ["<u4", "<i4", "<u4", "<u4", "S9"]
    places = [0, 4, 8, 12, 16]
    body = 24 if ros1 else 28
    kind = np.dtype(
        {
            "names": [*head, "d"],
            "formats": [*form, ("<f8", 37)],
            "offsets": [*places, body],
            "itemsize": body + 296,
        }
    )
    stamps, samples = truth(n)
    rng = np.random.default_rng(5)
    variances = ((4, 1e-4), (16, 2.5e-6), (28, 2.9e-4))
    angles = np.cumsum(rng.normal(0, 1e-5, (n, 3)), axis=0)
    for first in range(0, n, 100_000):
        part = slice(first, min(first + 100_000, n))
        data = np.zeros(part.stop - first, dtype=kind)
        data[head[0]] = np.arange(first, part.stop) if ros1 else 0x0100
        data["sec"], data["nsec"] = stamps[part] // 10**9, stamps[part] % 10**9
        data["len"], data["frame"] = (8, b"imu_link") if ros1 else (9, b"imu_link")
        data["d"][:, :3], data["d"][:, 3] = angles[part] / 2, np.sqrt(1 - (angles[part] ** 2).sum(1) / 4)
        for place, variance in variances:
            data["d"][:, place : place + 9 : 4] = variance
        data["d"][:, 13:16], data["d"][:, 25:28] = samples[part, :3], samples[part, 3:]
        size, raw = kind.itemsize, data.tobytes()
        for row in range(part.stop - first):
            yield int(stamps[first + row]) + 300_000, raw[row * size : (row + 1) * size]


def write(name: str, path: Path, n: int) -> None:
    """Write a log."""
    kind, _, compression = name.partition("-")
    if kind == "mcap":
        _write_mcap(path, compression, n)
    elif kind == "bag":
        _write_bag(path, compression, n)
    else:
        _write_db3(path, n)


def _write_mcap(path: Path, compression: str, n: int) -> None:
    from mcap.writer import CompressionType, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=786_432, compression=kinds[compression], enable_crcs=False)
        writer.start("ros2", "bench")
        text, _ = store.generate_msgdef("sensor_msgs/msg/Imu", ros_version=2)
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", text.encode())
        imu = writer.register_channel(TOPIC, "cdr", schema)
        text, _ = store.generate_msgdef("std_msgs/msg/String", ros_version=2)
        other = writer.register_channel(
            "/chatter", "cdr", writer.register_schema("std_msgs/msg/String", "ros2msg", text.encode())
        )
        noise = b"\x00\x01\x00\x00" + (60).to_bytes(4, "little") + b"x" * 59 + b"\0"
        for row, (log, data) in enumerate(payloads(n, ros1=False)):
            writer.add_message(imu, log, data, log, row)
            if row % 4 == 0:
                writer.add_message(other, log + 1, noise, log + 1, row)
        writer.finish()  # type: ignore[no-untyped-call]


def _write_bag(path: Path, compression: str, n: int) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer(path)
    if compression != "none":
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    noise = (60).to_bytes(4, "little") + b"x" * 60
    with writer:
        imu = writer.add_connection(TOPIC, "sensor_msgs/msg/Imu", typestore=store)
        other = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        for row, (log, data) in enumerate(payloads(n, ros1=True)):
            writer.write(imu, log, data)
            if row % 4 == 0:
                writer.write(other, log + 1, noise)


def _write_db3(path: Path, n: int) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    noise = b"\x00\x01\x00\x00" + (60).to_bytes(4, "little") + b"x" * 59 + b"\0"
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        imu = writer.add_connection(TOPIC, "sensor_msgs/msg/Imu", typestore=store)
        other = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        for row, (log, data) in enumerate(payloads(n, ros1=False)):
            writer.write(imu, log, data)
            if row % 4 == 0:
                writer.write(other, log + 1, noise)


def read_imucal(path: Path, n: int) -> Recording:
    """Read by imucal."""
    del n
    from imucal.readers import read

    return read(path)


def check(recording: Recording, n: int) -> None:
    """Compare with the truth, bit by bit."""
    _, samples = truth(n)
    for place, series in enumerate(recording.series):
        if not np.array_equal(series.samples, samples[:, place]):
            msg = f"{recording.source.path}: {series.name} differs from the truth"
            raise SystemExit(msg)


def read_rosbags(path: Path, n: int) -> None:
    """Read by rosbags, as its documentation shows."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    rows = []
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        wanted = [c for c in reader.connections if c.topic == TOPIC]
        for connection, _, raw in reader.messages(connections=wanted):
            m: Any = reader.deserialize(raw, connection.msgtype)
            w, a, s = m.angular_velocity, m.linear_acceleration, m.header.stamp
            rows.append((s.sec * 10**9 + s.nanosec, w.x, w.y, w.z, a.x, a.y, a.z))
            if len(rows) == n:
                break


def read_mcap(path: Path, n: int) -> None:
    """Read by mcap and mcap_ros2, as their documentation shows."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    rows = []
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, _, _, m in reader.iter_decoded_messages(topics=[TOPIC]):
            w, a, s = m.angular_velocity, m.linear_acceleration, m.header.stamp
            rows.append((s.sec * 10**9 + s.nanosec, w.x, w.y, w.z, a.x, a.y, a.z))
            if len(rows) == n:
                break


def decompress(path: Path, n: int) -> None:
    """Read all chunks and decompress them, nothing else."""
    del n
    from imucal.readers.compression import keep_freed_memory

    keep_freed_memory()
    if path.suffix == ".mcap":
        _decompress_mcap(path)
    elif path.suffix == ".bag":
        _decompress_bag(path)
    else:
        _read_file(next(path.glob("*.db3")) if path.is_dir() else path)


def _decompress_mcap(path: Path) -> None:
    from mcap.reader import make_reader

    unpack = _unpackers()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    if summary is None:
        msg = f"{path}: no summary"
        raise SystemExit(msg)
    with path.open("rb", buffering=0) as file:
        for chunk in summary.chunk_indexes:
            file.seek(chunk.chunk_start_offset + 9 + 28 + 4 + len(chunk.compression) + 8)
            unpack[chunk.compression or "none"](file.read(chunk.compressed_size))


def _decompress_bag(path: Path) -> None:
    from imucal.readers.containers.ros1_chunks import BagChunkTask, unpack
    from imucal.readers.containers.ros1_file import BagFile
    from imucal.readers.files import LogFile, Scratch

    bag, scratch = BagFile(path), Scratch()
    with closing(LogFile(path)) as file:
        for task in bag.tasks(frozenset(channel.key for channel in bag.channels)):
            chunk = cast("BagChunkTask", task)
            region = scratch.buffer(chunk.size)
            file.into(chunk.position, region)
            unpack(region)


def _unpackers() -> dict[str, Callable[[bytes], object]]:
    import lz4.frame
    import zstandard

    return {
        "none": len,
        "lz4": lz4.frame.decompress,
        "bz2": bz2.decompress,
        "zstd": lambda data: zstandard.ZstdDecompressor().decompress(data, max_output_size=1 << 24),
    }


def _read_file(path: Path) -> None:
    buffer = bytearray(1 << 22)
    with path.open("rb", buffering=0) as file:
        while file.readinto(buffer):
            pass


READERS: dict[str, Callable[[Path, int], Recording | None]] = {
    "imucal": read_imucal,
    "rosbags": read_rosbags,
    "mcap": read_mcap,
    "bare": decompress,
}


def measure(reader: str, path: Path, n: int) -> tuple[float, float, float]:
    """Return CPU ns per message, wall ns per message and peak memory in MB of a fresh process."""
    done = subprocess.run(  # noqa: S603 - our own script
        [sys.executable, __file__, "--one", reader, "--path", str(path), "--n", str(n)],
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    if done.returncode:
        raise SystemExit(done.stderr or done.stdout)
    cpu, wall, memory = map(float, done.stdout.split())
    return cpu / n * 1e9, wall / n * 1e9, memory


def one(reader: str, path: Path, n: int) -> None:
    """Read once in this process; imports are not counted."""
    import imucal.readers.containers.mcap_file
    import imucal.readers.containers.ros1_file
    import imucal.readers.containers.ros2_bag
    import imucal.readers.message_logs  # noqa: F401

    cpu, wall = time.process_time(), time.perf_counter()
    found = READERS[reader](path, n)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    print(cpu, wall, peak_memory())
    if found is not None and n <= 2_000_000:
        check(found, n)


def peak_memory() -> float:
    """Return the peak memory of this process in MB; `ru_maxrss` would count the parent's too."""
    status = Path("/proc/self/status")
    if not status.exists():
        return float("nan")
    line = next(line for line in status.read_text(encoding="utf-8").splitlines() if "VmHWM" in line)
    return int(line.split()[1]) / 1e3


def main() -> None:
    """Print one line a format and reader, and the ratios to imucal."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--n", type=int, default=400_000, help="messages in each log")
    parser.add_argument("--peers", type=int, default=40_000, help="messages that peers read")
    parser.add_argument("--repeat", type=int, default=3, help="runs, of which the best counts")
    parser.add_argument("--formats", nargs="*", default=FORMATS, choices=FORMATS)
    parser.add_argument("--folder", type=Path, help="keep logs here between runs")
    parser.add_argument("--one", choices=tuple(READERS), help=argparse.SUPPRESS)
    parser.add_argument("--path", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        one(given.one, given.path, given.n)
        return
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        print(f"{given.n} messages; peers read {given.peers}; best of {given.repeat}; CPU ns per message")
        for name in given.formats:
            _report(name, folder, given)


def _report(name: str, folder: Path, given: argparse.Namespace) -> None:
    suffix = {"mcap": ".mcap", "bag": ".bag"}.get(name.partition("-")[0], "")
    path, small = folder / f"{name}-{given.n}{suffix}", folder / f"{name}-{given.peers}{suffix}"
    for log, n in ((path, given.n), (small, given.peers)):
        if not log.exists():
            write(name, log, n)
    runs = [("imucal", path, given.n), ("bare", path, given.n), ("rosbags", small, given.peers)]
    if name.startswith("mcap") and importlib.util.find_spec("mcap_ros2"):
        runs.append(("mcap", small, given.peers))
    best = {
        reader: min(measure(reader, log, n) for _ in range(given.repeat if log is path else 1))
        for reader, log, n in runs
    }
    own = best["imucal"]
    print(f"{name:10} imucal {own[0]:8.0f} (wall {own[1]:.0f}, {own[2]:.0f} MB)", end="")
    for reader, found in best.items():
        if reader == "bare":
            print(f"   bare {found[0]:.0f}: {own[0] / found[0]:.2f}x of it", end="")
        elif reader != "imucal":
            print(f"   {reader} {found[0]:.0f}: {found[0] / own[0]:.0f}x faster", end="")
    print(flush=True)


if __name__ == "__main__":
    main()
