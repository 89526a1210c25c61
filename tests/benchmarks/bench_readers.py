"""Cost of reading: imucal compared with bare decompression and other readers, with targets.

    python -m tests.benchmarks.bench_readers --n 2000000 --peers 60000 --formats mcap-zstd bag-lz4

The script writes logs of `sensor_msgs/Imu` at 200 Hz among other topics to a temporary folder, with chunk
checksums if the format has them. Every run is a separate process; readers alternate, and the best run
counts: CPU time on one thread, and for imucal also wall time on all threads of the machine. Peers only read
the first `--peers` messages, because their cost per message does not depend on the length. Every result of
imucal is compared exactly with the truth.
"""

import argparse
import bz2
import importlib.util
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from imucal.recording import Recording
from tests.benchmarks.imu_logs import TOPIC, euroc, truth, write

MODULE = "tests.benchmarks.bench_readers"
#: Threads of imucal for wall times: those of the machine, at most 4.
THREADS = min(os.cpu_count() or 1, 4)
FORMATS = ("mcap-zstd", "mcap-lz4", "mcap-none", "bag-none", "bag-lz4", "bag-bz2", "db3", "euroc", "camera")


@dataclass(frozen=True)
class Target:
    """Target of imucal relative to another reader of the same log."""

    text: str
    peer: str
    ratio: float
    #: Whether the ratio is an upper limit of imucal's cost; otherwise it is a lower limit of the other's.
    at_most: bool

    def rows(self, own: tuple[float, ...], peer: tuple[float, ...], shared: tuple[float, ...]) -> str:
        """Return table rows with the target: CPU on one thread, and wall time on all threads.

        Each tuple has CPU time, wall time and memory; the other reader has one thread.
        """
        return (
            self._row(own[0], peer[0], "CPU")
            + "\n"
            + self._row(shared[1], peer[1], f"wall, {THREADS} threads")
        )

    def _row(self, own: float, peer: float, what: str) -> str:
        found = own / peer if self.at_most else peer / own
        met = found <= self.ratio if self.at_most else found >= self.ratio
        sign = "≤" if self.at_most else "≥"
        return f"| {self.text}, {what} | {sign} {self.ratio:g} | {found:.2f} | {'yes' if met else 'no'} |"


TARGETS = {
    "mcap-zstd": Target("MCAP zstd with CRC / bare decompression", "bare", 2, at_most=True),
    "bag-lz4": Target("bag lz4 / bare decompression", "bare", 1.3, at_most=True),
    "db3": Target("rosbags / db3", "rosbags", 8, at_most=False),
    "euroc": Target("`np.loadtxt` / EuRoC CSV", "loadtxt", 5, at_most=False),
    "camera": Target("chunks without IMU messages that are read", "skipped", 0, at_most=True),
}
#: Other readers of each kind of log; `SLOW` ones read a few messages only.
PEERS = {
    "mcap": ("bare", "rosbags", "mcap"),
    "bag": ("bare", "rosbags"),
    "db3": ("bare", "rosbags"),
    "euroc": ("bare", "loadtxt"),
    "camera": ("bare", "mcap"),
}
SLOW = frozenset({"rosbags", "mcap", "loadtxt"})


def read_imucal(path: Path, n: int) -> Recording:
    """Read with imucal."""
    del n
    from imucal.readers import read

    return read(path)


def check(recording: Recording, n: int) -> None:
    """Compare exactly with the truth."""
    _, samples = euroc(n) if recording.source.path.endswith(".csv") else truth(n)
    for place, series in enumerate(recording.series):
        if not np.array_equal(series.samples, samples[:, place]):
            msg = f"{recording.source.path}: {series.name} differs from the truth"
            raise SystemExit(msg)


def read_rosbags(path: Path, n: int) -> None:
    """Read with rosbags, as in its documentation."""
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
    """Read with mcap and mcap_ros2, as in their documentation."""
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
    """Read and decompress all chunks only."""
    del n
    from imucal.readers.compression import keep_freed_memory

    keep_freed_memory()
    if path.suffix == ".mcap":
        _decompress_mcap(path)
    elif path.suffix == ".bag":
        _decompress_bag(path)
    elif path.suffix == ".csv":
        _parse(path)
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
    unpack = _unpackers()
    with path.open("rb", buffering=0) as file:
        for position, size, kind in bag_chunks(path):
            file.seek(position)
            unpack[kind](file.read(size))


def bag_chunks(path: Path) -> list[tuple[int, int, str]]:
    """Return position, size and compression of each chunk's data in a bag."""
    found: list[tuple[int, int, str]] = []
    place = 13
    with path.open("rb") as file:
        while True:
            file.seek(place)
            start = file.read(4)
            if len(start) < 4:
                return found
            head = file.read(int.from_bytes(start, "little"))
            size = int.from_bytes(file.read(4), "little")
            place = file.tell()
            if b"op=\x05" in head:
                kind = next(kind for kind in ("none", "lz4", "bz2") if b"=" + kind.encode() in head)
                found.append((place, size, kind))
            place += size


def _parse(path: Path) -> None:
    """Parse a table of numbers with polars only."""
    import polars as pl

    schema = {str(i): pl.Float64 if i else pl.Int64 for i in range(7)}
    pl.read_csv(path, has_header=False, skip_rows=1, schema=schema, quote_char=None)


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


def read_loadtxt(path: Path, n: int) -> None:
    """Read a table with NumPy."""
    np.loadtxt(path, delimiter=",", skiprows=1, max_rows=n)


def idle_chunks_read(path: Path) -> tuple[int, int]:
    """Return the number of chunks without IMU messages that are read from an MCAP file, and their total."""
    from mcap.reader import make_reader

    from imucal.readers import read
    from imucal.readers.files import LogFile

    spans: list[tuple[int, int]] = []
    read_bytes = LogFile.read

    def noted(file: LogFile, position: int, size: int) -> bytes:
        spans.append((position, position + size))
        return read_bytes(file, position, size)

    with mock.patch.object(LogFile, "read", noted):
        read(path)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    if summary is None:
        msg = f"{path}: no summary"
        raise SystemExit(msg)
    wanted = next(key for key, channel in summary.channels.items() if channel.topic == TOPIC)
    idle = [chunk for chunk in summary.chunk_indexes if wanted not in chunk.message_index_offsets]
    first = np.array([start for start, _ in spans])
    last = np.array([stop for _, stop in spans])
    read_of = [
        bool(((first < c.chunk_start_offset + c.chunk_length) & (last > c.chunk_start_offset)).any())
        for c in idle
    ]
    return sum(read_of), len(idle)


READERS: dict[str, Callable[[Path, int], Recording | None]] = {
    "imucal": read_imucal,
    "rosbags": read_rosbags,
    "mcap": read_mcap,
    "bare": decompress,
    "loadtxt": read_loadtxt,
}


def measure(reader: str, path: Path, n: int, threads: int = 1) -> tuple[float, float, float]:
    """Return CPU ns per message, wall ns per message and peak memory in MB of a fresh process."""
    done = subprocess.run(  # noqa: S603 - our own script
        [sys.executable, "-m", MODULE, "--one", reader, "--path", str(path), "--n", str(n)],
        capture_output=True,
        cwd=Path(__file__).parents[2],
        env={**os.environ, "IMUCAL_THREADS": str(threads), "POLARS_MAX_THREADS": str(threads)},
        encoding="utf-8",
        check=False,
    )
    if done.returncode:
        raise SystemExit(done.stderr or done.stdout)
    cpu, wall, memory = map(float, done.stdout.split())
    return cpu / n * 1e9, wall / n * 1e9, memory


def one(reader: str, path: Path, n: int) -> None:
    """Read once in this process; imports are not counted."""
    import polars as pl
    import zstandard  # noqa: F401

    import imucal.readers.containers.mcap
    import imucal.readers.containers.ros1
    import imucal.readers.containers.ros2_bag
    import imucal.readers.message_logs
    import imucal.readers.tables.text_table  # noqa: F401

    pl.Series([0.0])
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
    """Print one line per format and reader, and the table of targets."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--n", type=int, default=1_000_000, help="messages in each log")
    parser.add_argument("--peers", type=int, default=40_000, help="messages that peers read")
    parser.add_argument("--repeat", type=int, default=5, help="runs, of which the best counts")
    parser.add_argument("--formats", nargs="*", default=tuple(TARGETS), choices=FORMATS)
    parser.add_argument("--log", type=Path, help="read this log, and compare with AllanTools' oadev")
    parser.add_argument("--folder", type=Path, help="keep logs here between runs")
    parser.add_argument("--one", choices=tuple(READERS), help=argparse.SUPPRESS)
    parser.add_argument("--path", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        one(given.one, given.path, given.n)
        return
    if given.log:
        long_log(given.log)
        return
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        print(f"{given.n} messages; peers read {given.peers}; best of {given.repeat}; CPU ns per message\n")
        print(
            f"| log | imucal | wall, {THREADS} threads | MB | bare decompression | imucal / bare | others |"
        )
        print("|---|---|---|---|---|---|---|")
        rows = [_report(name, folder, given) for name in given.formats]
    print("\n| what | wanted | measured | met |\n|---|---|---|---|")
    print("\n".join(row for row in rows if row))


def long_log(path: Path) -> None:
    """Print the cost of reading a log, on one and more threads, in y; see `bench_job`."""
    from tests.benchmarks.bench_job import yardstick

    y = yardstick()
    print(f"y = {y:.2f} s\n\n| threads | CPU, s | CPU, y | wall, s | peak, MB |\n|---|---|---|---|---|")
    for threads in (1, 2):
        cpu, wall, memory = measure("imucal", path, 10**9, threads)
        print(f"| {threads} | {cpu:.2f} | {cpu / y:.2f} | {wall:.2f} | {memory:.0f} |", flush=True)


def _report(name: str, folder: Path, given: argparse.Namespace) -> str:
    """Print the cost of each reader for a log; return its row of the table of targets."""
    kind = name.partition("-")[0]
    # A log with pictures is large.
    n = given.n if kind != "camera" else min(given.n, 2000)
    path, small = _log(name, folder, n), _log(name, folder, min(given.peers, n))
    wanted = [peer for peer in PEERS[kind] if peer != "mcap" or importlib.util.find_spec("mcap_ros2")]
    runs = {peer: (small, min(given.peers, n)) if peer in SLOW else (path, n) for peer in ("imucal", *wanted)}
    costs: dict[str, list[tuple[float, ...]]] = {reader: [] for reader in runs}
    shared: list[tuple[float, ...]] = []
    for turn in range(given.repeat):
        shared.append(measure("imucal", path, n, THREADS))
        for reader, (log, count) in runs.items():
            if reader not in SLOW or turn == 0 or reader == "loadtxt":
                costs[reader].append(measure(reader, log, count))
    best = {reader: min(found) for reader, found in costs.items()}
    own = best["imucal"]
    together = min(shared, key=lambda found: found[1])
    cells = [f"{name} | {own[0]:.0f} | {together[1]:.0f} | {own[2]:.0f} | {best['bare'][0]:.0f}"]
    cells += [f"{own[0] / best['bare'][0]:.2f}"]
    others = [reader for reader in wanted if reader in SLOW]
    cells += [", ".join(f"{r} {best[r][0]:.0f} ({best[r][0] / own[0]:.1f} x)" for r in others)]
    print(f"| {' | '.join(cells)} |", flush=True)
    target = TARGETS.get(name)
    if name == "camera":
        idle, chunks = idle_chunks_read(path)
        return f"| {TARGETS[name].text} | 0 | {idle} of {chunks} | {'no' if idle else 'yes'} |"
    if target is None:
        return ""
    walls = tuple(min(found) for found in zip(*costs[target.peer], strict=True))
    return target.rows(own, walls, together)


def _log(name: str, folder: Path, n: int) -> Path:
    suffix = {"mcap": ".mcap", "bag": ".bag", "euroc": ".csv", "camera": ".mcap"}
    path = folder / f"{name}-{n}{suffix.get(name.partition('-')[0], '')}"
    if not path.exists():
        write(name, path, n)
    return path


if __name__ == "__main__":
    main()
