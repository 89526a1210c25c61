"""Logs of `sensor_msgs/Imu` with known truth in every format, for the benchmarks of the readers."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from imucal.arrays import FloatArray, IntArray

EUROC = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n"
)
RATE = 200
START = 1_700_000_000_000_000_000
TOPIC = "/imu/data"
#: Bytes of a camera's picture: more than a chunk.
PICTURE = 1 << 18
#: Number of camera pictures in sequence, and number of IMU messages between them.
CAMERAS, BETWEEN = 3, 7


def truth(n: int) -> tuple[IntArray, FloatArray]:
    """Return stamps in ns, shape (n,), and samples, shape (n, 6), quantized as by a 16-bit sensor."""
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
    elif kind == "db3":
        _write_db3(path, n)
    elif kind == "camera":
        write_camera(path, n)
    else:
        write_euroc(path, n)


def _write_mcap(path: Path, compression: str, n: int) -> None:
    from mcap.writer import CompressionType, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=786_432, compression=kinds[compression])
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


def write_camera(path: Path, n: int) -> None:
    """Write an MCAP file like a robot with cameras: most chunks only contain a picture."""
    from mcap.writer import CompressionType, Writer
    from rosbags.typesys import Stores, get_typestore

    text, _ = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef("sensor_msgs/msg/Imu", ros_version=2)
    picture = np.random.default_rng(7).integers(0, 64, PICTURE, dtype=np.uint8).tobytes()
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=PICTURE // 2, compression=CompressionType.ZSTD)
        writer.start("ros2", "bench")
        kind = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", text.encode())
        imu = writer.register_channel(TOPIC, "cdr", kind)
        raw = writer.register_schema("Raw", "ros2msg", b"uint8[] data")
        cameras = [writer.register_channel(f"/camera{i}", "cdr", raw) for i in range(CAMERAS)]
        for row, (log, data) in enumerate(payloads(n, ros1=False)):
            writer.add_message(imu, log, data, log, row)
            if row % BETWEEN == 0:
                for camera in cameras:
                    writer.add_message(camera, log, picture, log, row)
        writer.finish()  # type: ignore[no-untyped-call]


def euroc(n: int) -> tuple[IntArray, FloatArray]:
    """Return stamps in ns, shape (n,), and samples, shape (n, 6), with all digits."""
    rng = np.random.default_rng(0)
    stamps = 1_403_715_273_262_142_976 + np.arange(n) * 5_000_000
    return stamps, rng.normal(scale=0.01, size=(n, 6)) + np.array([0, 0, 0, 0, 0, 9.8])


def write_euroc(path: Path, n: int) -> None:
    """Write a table like those of the EuRoC data set."""
    with path.open("w", encoding="utf-8") as file:
        file.write(EUROC)
        for stamp, row in zip(*(values.tolist() for values in euroc(n)), strict=True):
            file.write(f"{stamp},{','.join(map(repr, row))}\n")
