"""Bytes fetched from an object store and a web server, and seconds, for `info`, `fit` and `imucal.read`.

    python -m tests.benchmarks.remote_logs --minutes 10 --camera 20000

Both servers run on this machine (moto emulates S3), so the seconds are those of imucal and the servers; a
network adds bytes/bandwidth. The logs are MCAP files and a ROS 1 bag at 200 Hz, of the IMU only and with a
camera at 20 Hz with incompressible messages of `--camera` bytes. Every command is run twice: with an empty
cache, and again.
"""

import argparse
import logging
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fsspec
import numpy as np

import imucal
from imucal.readers import describe, read
from imucal.remote.stores import Store
from imucal.simulation import Rows, ros2_messages, write_log
from tests.cli.run import SAMPLE_LOGS, run
from tests.remote.web_server import web_server

RATE, CAMERA_RATE = 200, 20


def with_camera(path: Path, minutes: float, camera: int) -> None:
    """Write an MCAP log of an IMU and a camera."""
    from mcap.writer import Writer
    from rosbags.typesys import Stores, get_typestore

    rng = np.random.default_rng(1405)
    n = round(minutes * 60 * RATE)
    stamps = 1_700_000_000_000_000_000 + np.arange(n) * (10**9 // RATE)
    rates, forces = 1e-3 * rng.standard_normal((n, 3)), 1e-2 * rng.standard_normal((n, 3)) + [0, 0, 9.81]
    store = get_typestore(Stores.ROS2_HUMBLE)
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="benchmark")
        channels = []
        for topic, kind in (("/imu", "sensor_msgs/msg/Imu"), ("/image", "sensor_msgs/msg/CompressedImage")):
            definition, _ = store.generate_msgdef(kind, ros_version=2)
            schema = writer.register_schema(kind, "ros2msg", definition.encode())
            channels.append(writer.register_channel(topic, "cdr", schema))
        for i, message in enumerate(ros2_messages(Rows(first=0, stamps=stamps, rates=rates, forces=forces))):
            stamp = int(stamps[i])
            writer.add_message(channels[0], stamp, message.tobytes(), stamp)
            if not i % (RATE // CAMERA_RATE):
                writer.add_message(channels[1], stamp, rng.bytes(camera), stamp)
        writer.finish()  # type: ignore[no-untyped-call]


def logs(folder: Path, minutes: float, camera: int) -> list[Path]:
    """Write the logs."""
    with_camera(folder / "camera.mcap", minutes, camera)
    recording = read(folder / "camera.mcap")
    for name in ("imu.mcap", "imu.bag"):
        write_log(recording, folder / name)
    (folder / "sample.mcap").write_bytes((SAMPLE_LOGS / "consumer_mems.mcap").read_bytes())
    return [folder / name for name in ("camera.mcap", "imu.mcap", "imu.bag", "sample.mcap")]


def measure(name: str, url: str, fetched: Callable[[], int], place: Path, size: int) -> None:
    """Print a row for each command, with an empty cache and a full one."""
    cache = place / f"cache-{name}"
    os.environ["IMUCAL_CACHE"] = str(cache)
    fit = ("--model", "N + B", "--no-report", "--force", "-q")
    jobs: list[tuple[str, Callable[[], Any]]] = [
        ("info", lambda: run("info", url, cwd=place)),
        ("describe", lambda: describe(url)),
        ("read", lambda: imucal.read(url)),
        ("read again", lambda: imucal.read(url)),
        ("fit again", lambda: run("fit", url, *fit, cwd=place)),
    ]
    for job, work in jobs:
        before, start = fetched(), time.perf_counter()
        done = work()
        seconds = time.perf_counter() - start
        assert getattr(done, "returncode", 0) == 0, done.stderr
        count = fetched() - before
        print(f"| {name} | {job} | {count / 1e6:.3f} | {count / size:.2%} | {seconds:.2f} |", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--camera", type=int, default=20_000)
    arguments = parser.parse_args()
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        os.environ[name] = "testing"
    os.environ |= {"AWS_DEFAULT_REGION": "us-east-1", "AWS_EC2_METADATA_DISABLED": "true"}
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    os.environ["AWS_ENDPOINT_URL"] = "http://{}:{}".format(*server.get_host_and_port())
    counted = {"bytes": 0}
    part = Store._part

    def counting(self: Store, *arguments: Any) -> bytes:  # noqa: ANN401
        data = part(self, *arguments)
        counted["bytes"] += len(data)
        return data

    Store._part = counting  # type: ignore[method-assign,assignment]
    with tempfile.TemporaryDirectory() as folder, web_server() as web:
        files = fsspec.filesystem("s3", use_listings_cache=False)
        files.mkdir("logs")
        print("| log | command | MB fetched | of the log | s |\n|---|---|---|---|---|")
        for log in logs(Path(folder), arguments.minutes, arguments.camera):
            size = log.stat().st_size
            files.put_file(log, f"logs/{log.name}")
            label = f"{log.name} ({size / 1e6:.3g} MB)"
            addresses = {"s3": f"s3://logs/{log.name}", "http": web.add(f"/{log.name}", log.read_bytes())}
            for store, url in addresses.items():
                measure(f"{store} {label}", url, lambda: counted["bytes"], Path(folder), size)
    server.stop()
    sys.stdout.flush()


if __name__ == "__main__":
    main()
