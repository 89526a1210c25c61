"""Memory of reading: small files with very much content, and a day at 200 Hz.

    python tests/benchmarks/reading_memory.py [--folder /tmp/x] [--only rows arrays] [--jobs info read]

Missing files are created (in a temporary folder that is deleted, or in `--folder`):

- ``zeros.csv.gz``: 131 million equal rows in 4 MB;
- ``zeros.npz``: 4 GB of zeros in 4 MB;
- ``rows.csv.gz``: as many rows, a repeated block of 256, with a counter and no time;
- ``stamped.csv.gz``: 20 million rows with times in seconds;
- ``day.mcap``: 17.3 million messages, 24 h at 200 Hz, zstd;
- ``day.parquet``, ``day.h5``: as many rows;
- ``long.npz``: six axes of 100 million samples, 4.8 GB, only on request.

Each job runs in a separate process, with the default limit and with ``IMUCAL_MEMORY=500M``. The script prints
CPU and wall time, the peak memory of the job and its children, and the peak of memory without a file. Memory
is the proportional set size, sampled every 20 ms.
"""

import argparse
import gzip
import os
import subprocess
import sys
import tempfile
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.benchmarks.process_memory import memory_of_family

#: Rows of the repeated block: the range of an 8-bit counter.
BLOCK = 256
ROWS = 131_000_000
#: Samples of six axes in 4 GB.
SAMPLES = 83_000_000
STAMPED = 20_000_000
LONG = 100_000_000
DAY = 24 * 3600 * 200


def _block() -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Return 256 samples of six axes at rest."""
    samples = np.random.default_rng(11).normal(0, 2e-3, (BLOCK, 6)).round(4)
    samples[:, 5] += 9.81
    return samples


def make_rows(path: Path) -> None:
    """Write the repeated rows of the block."""
    rows = [f"{i}," + ",".join(f"{value:.4g}" for value in row) for i, row in enumerate(_block())]
    _repeat(path, rows)


def make_zeros(path: Path) -> None:
    """Write the same row repeatedly."""
    _repeat(path, ["0,0,0,0,0,0,0"] * BLOCK)


def _repeat(path: Path, rows: list[str]) -> None:
    """Write rows as equal members of a gzip file; the last is shorter."""
    text = ("\n".join(rows) + "\n").encode()
    member = 4000 * BLOCK
    packed = gzip.compress(text * 4000, 9)
    with path.open("wb") as file:
        file.write(gzip.compress(b"counter,gx_rads,gy_rads,gz_rads,ax_ms2,ay_ms2,az_ms2\n"))
        for _ in range(ROWS // member):
            file.write(packed)
        file.write(gzip.compress(text * (ROWS % member // BLOCK), 9))


def make_arrays(path: Path) -> None:
    """Write two arrays of zeros of three axes, and the rate."""
    zeros = bytes(SAMPLES // 1000 * 24)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in ("gyro", "accel"):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                header = {"descr": "<f8", "fortran_order": False, "shape": (SAMPLES, 3)}
                np.lib.format.write_array_header_1_0(member, header)
                for _ in range(1000):
                    member.write(zeros)
        with archive.open("fs.npy", "w") as member:
            np.lib.format.write_array(member, np.array(200.0))


def make_long(path: Path) -> None:
    """Write two arrays of noise of three axes in blocks, and the rate."""
    rng, step = np.random.default_rng(14), 1_000_000
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name in ("gyro", "accel"):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                header = {"descr": "<f8", "fortran_order": False, "shape": (LONG, 3)}
                np.lib.format.write_array_header_1_0(member, header)
                level = np.array([0.0, 0.0, 9.81 if name == "accel" else 0.0])
                for _ in range(LONG // step):
                    walk = level + np.cumsum(rng.normal(0, 1e-7, (step, 3)), axis=0)
                    member.write((walk + rng.normal(0, 2e-3, (step, 3))).tobytes())
                    level = walk[-1]
        with archive.open("fs.npy", "w") as member:
            np.lib.format.write_array(member, np.array(200.0))


def make_stamped(path: Path) -> None:
    """Write rows with their own times, with polars."""
    import polars as pl

    names = ["gx_rads", "gy_rads", "gz_rads", "ax_ms2", "ay_ms2", "az_ms2"]
    rng = np.random.default_rng(12)
    step = 1_000_000
    machine = zlib.compressobj(1, wbits=31)
    with path.open("wb") as file:
        for start in range(0, STAMPED, step):
            samples = rng.normal(0, 2e-3, (step, 6)).round(4)
            samples[:, 5] += 9.81
            times = (start + np.arange(step)) / 200
            table = pl.DataFrame({"t_s": times, **dict(zip(names, samples.T, strict=True))})
            text = table.write_csv(include_header=start == 0)
            file.write(machine.compress(text.encode()))
        file.write(machine.flush())


def make_day(path: Path) -> None:
    """Write a day of messages, in blocks of an hour."""
    from mcap.writer import Writer
    from rosbags.typesys import Stores, get_typestore

    from imucal.simulation import Rows, ros2_messages

    definition, _ = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef("sensor_msgs/msg/Imu", ros_version=2)
    rng = np.random.default_rng(13)
    hour = 3600 * 200
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="imucal")
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", definition.encode())
        channel = writer.register_channel("/imu/data_raw", "cdr", schema)
        for start in range(0, DAY, hour):
            stamps = 1_700_000_000_000_000_000 + 5_000_000 * np.arange(start, start + hour)
            rates, forces = rng.normal(0, 2e-3, (hour, 3)), rng.normal(0, 2e-2, (hour, 3))
            forces[:, 2] += 9.81
            part = Rows(first=0, stamps=stamps, rates=rates, forces=forces)
            for stamp, message in zip(stamps.tolist(), ros2_messages(part), strict=True):
                writer.add_message(channel, stamp, message.tobytes(), stamp)
        writer.finish()  # type: ignore[no-untyped-call]


def _columns() -> dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]]:
    """Return a day of times and samples."""
    rng, names = np.random.default_rng(13), ("gx_rads", "gy_rads", "gz_rads", "ax_ms2", "ay_ms2", "az_ms2")
    columns = {"t_s": np.arange(DAY) / 200, **{name: rng.normal(0, 2e-3, DAY).round(4) for name in names}}
    columns["az_ms2"] += 9.81
    return columns


def make_parquet(path: Path) -> None:
    """Write a day of rows."""
    import polars as pl

    pl.DataFrame(_columns()).write_parquet(path)


def make_hdf5(path: Path) -> None:
    """Write a day of rows, a dataset for each column."""
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in _columns().items():
            file.create_dataset(name, data=values, chunks=(1 << 16,), compression="gzip", compression_opts=1)


#: Name -> file, function that writes it, and options for reading it.
FILES: dict[str, tuple[str, Callable[[Path], None], list[str]]] = {
    "zeros": ("zeros.csv.gz", make_zeros, ["--rate", "200"]),
    "arrays": ("zeros.npz", make_arrays, ["--gyro-unit", "rad/s", "--accel-unit", "m/s^2"]),
    "rows": ("rows.csv.gz", make_rows, ["--rate", "200"]),
    "stamped": ("stamped.csv.gz", make_stamped, []),
    "day": ("day.mcap", make_day, []),
    "parquet": ("day.parquet", make_parquet, []),
    "hdf5": ("day.h5", make_hdf5, []),
    "long": ("long.npz", make_long, ["--gyro-unit", "rad/s", "--accel-unit", "m/s^2"]),
}
_HEAD = "log                   MB  job            limit exit   CPU s  wall s  peak MB  own MB"
#: Job -> arguments of Python, before the log and its options.
JOBS = {
    "info": ["-m", "imucal", "info"],
    "info --gaps": ["-m", "imucal", "info", "--gaps"],
    "fit": ["-m", "imucal", "fit", "--json", "-q", "--no-report"],
}


def measured(arguments: list[str], limit: str | None) -> tuple[int, float, float, float, float]:
    """Return exit code, CPU and wall time in s, and peak memory in total and without a file, in MB."""
    environment = {name: value for name, value in os.environ.items() if name != "IMUCAL_MEMORY"}
    if limit is not None:
        environment["IMUCAL_MEMORY"] = limit
    start = time.perf_counter()
    command = [sys.executable, *arguments]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL)  # noqa: S603
    most = own = 0
    while True:
        done, status, used = os.wait4(process.pid, os.WNOHANG)
        if done:
            break
        whole, anonymous = memory_of_family(process.pid)
        most, own = max(most, whole), max(own, anonymous)
        time.sleep(0.02)
    process.returncode = os.waitstatus_to_exitcode(status)
    wall = time.perf_counter() - start
    cpu = used.ru_utime + used.ru_stime
    return process.returncode, cpu, wall, most / 1e6, own / 1e6


def main() -> None:
    """Write the files and print the table."""
    parser = argparse.ArgumentParser(description="Memory of reading.")
    parser.add_argument("--folder", type=Path)
    parser.add_argument(
        "--only", nargs="+", choices=FILES, default=[name for name in FILES if name != "long"]
    )
    parser.add_argument("--jobs", nargs="+", choices=JOBS, default=list(JOBS))
    parser.add_argument("--limits", nargs="+", default=["default", "500M"])
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.folder or Path(scratch)
        folder.mkdir(exist_ok=True)
        print(_HEAD)
        for name in arguments.only:
            file, make, options = FILES[name]
            log = folder / file
            if not log.exists():
                make(log)
            for job in arguments.jobs:
                for limit in arguments.limits:
                    code, cpu, wall, peak, own = measured(
                        [*JOBS[job], str(log), *options], None if limit == "default" else limit
                    )
                    size = log.stat().st_size / 1e6
                    row = f"{file:16}{size:8.1f}  {job:12}{limit:>8}{code:5}"
                    print(f"{row}{cpu:8.1f}{wall:8.1f}{peak:9.0f}{own:8.0f}", flush=True)


if __name__ == "__main__":
    main()
