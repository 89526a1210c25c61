"""Small logs in every format, written by other packages, and their true samples."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from imucal.arrays import FloatArray, IntArray

__all__ = [
    "CONTAINERS",
    "START",
    "TOPIC",
    "Message",
    "Samples",
    "imu_messages",
    "samples",
    "store",
    "write_bag",
    "write_db3",
    "write_mcap",
]

TOPIC = "/imu/data"
START = 1_700_000_000_000_000_000
IMU = "sensor_msgs/msg/Imu"


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """Stamps and log times in ns, shape (n,), and gyroscope and accelerometer, shape (n, 3)."""

    stamps: IntArray
    log: IntArray
    gyro: FloatArray
    accel: FloatArray

    @property
    def all(self) -> FloatArray:
        """The six axes, shape (n, 6)."""
        return np.hstack([self.gyro, self.accel])


@dataclass(frozen=True, kw_only=True)
class Message:
    """A message to write: topic, type, log time and bytes."""

    topic: str
    type: str
    log: int
    data: bytes
    encoding: str = "cdr"
    extra: dict[str, Any] = field(default_factory=dict)


def samples(n: int = 200, *, rate: float = 100.0, seed: int = 7) -> Samples:
    """Return samples of a sensor at rest."""
    rng = np.random.default_rng(seed)
    stamps = START + np.round(np.arange(n) * 1e9 / rate).astype(np.int64)
    gravity = np.array([0.1, -0.2, 9.81])
    gyro, accel = rng.normal(0, 0.01, (n, 3)), rng.normal(0, 0.05, (n, 3)) + gravity
    return Samples(stamps=stamps, log=stamps + 300_000, gyro=gyro, accel=accel)


def store(*, ros1: bool = False, **more: str) -> Any:  # noqa: ANN401 - rosbags' own type is long
    """Return the message types of a ROS version, and the additional types of `more`: name -> definition."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for name, text in more.items():
        types.register(get_types_from_msg(text, name.replace("__", "/")))
    return types


def imu(types: Any, stamp: int, gyro: FloatArray, accel: FloatArray, frame: str = "imu") -> Any:  # noqa: ANN401
    """Return an Imu message."""
    known = types.types
    vector, cov = known["geometry_msgs/msg/Vector3"], np.zeros(9)
    return known[IMU](
        header=header(types, stamp, frame),
        orientation=known["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=cov,
        angular_velocity=vector(*gyro.tolist()),
        angular_velocity_covariance=cov,
        linear_acceleration=vector(*accel.tolist()),
        linear_acceleration_covariance=cov,
    )


def header(types: Any, stamp: int, frame: str = "imu") -> Any:  # noqa: ANN401
    """Return a header."""
    known = types.types
    time = known["builtin_interfaces/msg/Time"](sec=int(stamp) // 10**9, nanosec=int(stamp) % 10**9)
    fields = known["std_msgs/msg/Header"].__dataclass_fields__
    seq = {"seq": 0} if "seq" in fields else {}
    return known["std_msgs/msg/Header"](stamp=time, frame_id=frame, **seq)


def imu_messages(
    truth: Samples,
    *,
    topic: str = TOPIC,
    ros1: bool = False,
    frames: Sequence[str] = ("imu",),
    little_endian: bool = True,
    types: Any = None,  # noqa: ANN401
) -> list[Message]:
    """Return the samples as Imu messages with alternating frame ids."""
    types = types or store(ros1=ros1)
    messages = []
    for row, (stamp, log) in enumerate(zip(truth.stamps.tolist(), truth.log.tolist(), strict=True)):
        message = imu(types, stamp, truth.gyro[row], truth.accel[row], frames[row % len(frames)])
        if ros1:
            data = bytes(types.serialize_ros1(message, IMU))
        else:
            data = bytes(types.serialize_cdr(message, IMU, little_endian=little_endian))
        messages.append(
            Message(topic=topic, type=IMU, log=log, data=data, encoding="ros1" if ros1 else "cdr")
        )
    return messages


def write_mcap(
    path: Path,
    messages: Sequence[Message],
    *,
    compression: str = "zstd",
    ros1: bool = False,
    types: Any = None,  # noqa: ANN401
    chunk_size: int = 8192,
    definitions: dict[str, tuple[str, str]] | None = None,
    **options: Any,  # noqa: ANN401
) -> Path:
    """Write an MCAP file; `definitions` has type -> encoding and text for types that the store lacks."""
    from mcap.writer import CompressionType, Writer

    types = types or store(ros1=ros1)
    kinds = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_size, compression=kinds[compression], **options)
        writer.start("ros1" if ros1 else "ros2", "test")
        channels: dict[tuple[str, str], int] = {}
        for number, message in enumerate(messages):
            key = message.topic, message.type
            if key not in channels:
                kind, text = (definitions or {}).get(message.type) or _definition(
                    types, message.type, ros1=ros1
                )
                name = message.type.replace("/msg/", "/") if ros1 else message.type
                schema = writer.register_schema(name, kind, text.encode())
                channels[key] = writer.register_channel(message.topic, message.encoding, schema)
            writer.add_message(channels[key], message.log, message.data, message.log, number)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _definition(types: Any, name: str, *, ros1: bool) -> tuple[str, str]:  # noqa: ANN401
    text, _ = types.generate_msgdef(name, ros_version=1 if ros1 else 2)
    return "ros1msg" if ros1 else "ros2msg", text


def write_bag(
    path: Path,
    messages: Sequence[Message],
    *,
    compression: str = "none",
    types: Any = None,  # noqa: ANN401
    chunk_size: int = 8192,
) -> Path:
    """Write a ROS 1 bag."""
    from rosbags.rosbag1 import Writer

    types = types or store(ros1=True)
    writer = Writer(path)
    writer.chunk_threshold = chunk_size
    if compression != "none":
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    with writer:
        connections: dict[tuple[str, str], Any] = {}
        for message in messages:
            key = message.topic, message.type
            if key not in connections:
                connections[key] = writer.add_connection(message.topic, message.type, typestore=types)
            writer.write(connections[key], message.log, message.data)
    return path


def write_db3(
    path: Path,
    messages: Sequence[Message],
    *,
    compression: str = "none",
    types: Any = None,  # noqa: ANN401
    mcap: bool = False,
) -> Path:
    """Write the folder of a ROS 2 bag; `compression` is none, file or message."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    types = types or store()
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3)
    if compression != "none":
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        connections: dict[tuple[str, str], Any] = {}
        for message in messages:
            key = message.topic, message.type
            if key not in connections:
                connections[key] = writer.add_connection(message.topic, message.type, typestore=types)
            writer.write(connections[key], message.log, message.data)
    return path


def _mcap(compression: str, *, ros1: bool = False) -> Callable[[Path, Samples], Path]:
    def write(folder: Path, truth: Samples) -> Path:
        messages = imu_messages(truth, ros1=ros1)
        return write_mcap(folder / "log.mcap", messages, compression=compression, ros1=ros1)

    return write


def _bag(compression: str) -> Callable[[Path, Samples], Path]:
    def write(folder: Path, truth: Samples) -> Path:
        return write_bag(folder / "log.bag", imu_messages(truth, ros1=True), compression=compression)

    return write


def _db3(compression: str, *, mcap: bool = False) -> Callable[[Path, Samples], Path]:
    def write(folder: Path, truth: Samples) -> Path:
        return write_db3(folder / "bag", imu_messages(truth), compression=compression, mcap=mcap)

    return write


#: Name -> function that writes a log of some samples into a folder and returns its path.
CONTAINERS: dict[str, Callable[[Path, Samples], Path]] = {
    "mcap-zstd": _mcap("zstd"),
    "mcap-lz4": _mcap("lz4"),
    "mcap-none": _mcap("none"),
    "mcap-ros1": _mcap("lz4", ros1=True),
    "bag-none": _bag("none"),
    "bag-lz4": _bag("lz4"),
    "bag-bz2": _bag("bz2"),
    "db3": _db3("none"),
    "db3-file": _db3("file"),
    "db3-message": _db3("message"),
    "rosbag2-mcap": _db3("none", mcap=True),
}
