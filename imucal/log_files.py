"""Recording -> log file: CSV, MCAP, ROS 1 and ROS 2 bags, for logs of known truth.

The messages are `sensor_msgs/Imu` with unknown orientation. The bytes of many messages are laid
out at once in a structured array; the containers are written by `mcap` and `rosbags`.
"""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray, blocks
from imucal.atomic import replacing
from imucal.errors import WriteError
from imucal.recording import Recording

_TOPIC = "/imu/data_raw"
#: Messages laid out at once: 20 MB.
_MESSAGES = 1 << 16
_EUROC_HEADER = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows:
    """Some samples in a row: the number of the first, stamps in ns (n,), rates and forces (n, 3) in SI."""

    first: int
    stamps: IntArray
    rates: FloatArray
    forces: FloatArray


def _rows(recording: Recording) -> Iterator[Rows]:
    clock, columns = recording.series[0].clock, [series.samples for series in recording.series]
    for part in blocks(clock.n, *columns, size=_MESSAGES):
        own = clock.slice(part.start, part.stop)
        place = own.grid() + (own.segments[0].offset - clock.segments[0].offset)
        stamps = (clock.start_ns or 0) + np.rint(place * (1e9 / clock.rate_hz)).astype(np.int64)
        values = np.stack([column[part] for column in columns], axis=1)
        yield Rows(first=part.start, stamps=stamps, rates=values[:, :3], forces=values[:, 3:])


def write_log(recording: Recording, path: Path) -> None:
    """Write a recording whose six axes share one clock; the suffix of `path` names the format.

    ``.csv`` (EuRoC columns), ``.mcap`` (ROS 2, zstd), ``.bag`` (ROS 1, lz4), ``.db3`` (one ROS 2
    sqlite3 file), no suffix (a ROS 2 sqlite3 bag folder).

    Raises
    ------
    WriteError
        If the suffix is unknown, or the file exists already or can't be written.
    """
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        known = ", ".join(suffix or "none (a folder)" for suffix in WRITERS)
        msg = f"{path}: unknown log suffix {path.suffix!r}; expected one of {known}"
        raise WriteError(msg)
    if path.exists():
        msg = f"{path}: exists already; a log is never overwritten, choose another name or remove it"
        raise WriteError(msg)
    with replacing(path) as scratch:
        writer(scratch, _rows(recording))


def _write_csv(path: Path, parts: Iterator[Rows]) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(_EUROC_HEADER)
        for part in parts:
            rows = np.concatenate([part.rates, part.forces], axis=1).tolist()
            for stamp, row in zip(part.stamps.tolist(), rows, strict=True):
                stream.write(f"{stamp},{','.join(map(repr, row))}\n")


def _imu_bytes(head: list[tuple[str, str]], part: Rows) -> NDArray[np.void]:
    """Return one `sensor_msgs/Imu` per row: the fields of `head`, then 37 doubles, shape (n,)."""
    body = [("orientation", "<f8", 4), ("orientation_covariance", "<f8", 9), ("angular_velocity", "<f8", 3)]
    body += [("gyro_covariance", "<f8", 9), ("linear_acceleration", "<f8", 3), ("accel_covariance", "<f8", 9)]
    messages = np.zeros(part.stamps.size, dtype=np.dtype([*head, *body]))
    messages["sec"], messages["nsec"] = np.divmod(part.stamps, 1_000_000_000)
    messages["orientation"][:, 3] = 1.0
    messages["orientation_covariance"][:, 0] = -1.0
    messages["angular_velocity"] = part.rates
    messages["linear_acceleration"] = part.forces
    return messages


def ros2_messages(part: Rows) -> NDArray[np.void]:
    """Return CDR, little endian; the frame id is padded so that the doubles are aligned."""
    head = [("encapsulation", "<u4"), ("sec", "<i4"), ("nsec", "<u4"), ("length", "<u4"), ("frame", "S4")]
    messages = _imu_bytes(head, part)
    messages["encapsulation"] = 0x0100
    messages["length"], messages["frame"] = 4, b"imu"
    return messages


def _ros1_messages(part: Rows) -> NDArray[np.void]:
    head = [("seq", "<u4"), ("sec", "<u4"), ("nsec", "<u4"), ("length", "<u4"), ("frame", "S3")]
    messages = _imu_bytes(head, part)
    messages["seq"] = np.arange(part.first, part.first + part.stamps.size)
    messages["length"], messages["frame"] = 3, b"imu"
    return messages


def _stamped(
    parts: Iterator[Rows], messages: Callable[[Rows], NDArray[np.void]]
) -> Iterator[tuple[int, bytes]]:
    """Yield the stamp of each message, in ns, and its bytes."""
    for part in parts:
        for stamp, message in zip(part.stamps.tolist(), messages(part), strict=True):
            yield stamp, message.tobytes()


def _write_mcap(path: Path, parts: Iterator[Rows]) -> None:
    from mcap.writer import Writer
    from rosbags.typesys import Stores, get_typestore

    definition, _ = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef("sensor_msgs/msg/Imu", ros_version=2)
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="imucal")
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", definition.encode())
        channel = writer.register_channel(_TOPIC, "cdr", schema)
        for stamp, message in _stamped(parts, ros2_messages):
            writer.add_message(channel, stamp, message, stamp)
        writer.finish()  # type: ignore[no-untyped-call]


def _write_ros1_bag(path: Path, parts: Iterator[Rows]) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    with writer:
        typestore = get_typestore(Stores.ROS1_NOETIC)
        connection = writer.add_connection(_TOPIC, "sensor_msgs/msg/Imu", typestore=typestore)
        for stamp, message in _stamped(parts, _ros1_messages):
            writer.write(connection, stamp, message)


def _write_ros2_folder(path: Path, parts: Iterator[Rows]) -> None:
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    with Writer(path, version=9) as writer:
        typestore = get_typestore(Stores.ROS2_HUMBLE)
        connection = writer.add_connection(_TOPIC, "sensor_msgs/msg/Imu", typestore=typestore)
        for stamp, message in _stamped(parts, ros2_messages):
            writer.write(connection, stamp, message)


def _write_ros2_file(path: Path, parts: Iterator[Rows]) -> None:
    folder = path.with_suffix("")
    _write_ros2_folder(folder, parts)
    (written,) = folder.glob("*.db3")
    written.replace(path)
    shutil.rmtree(folder)


#: Suffix of a log -> function that writes it.
WRITERS: dict[str, Callable[[Path, Iterator[Rows]], None]] = {
    ".csv": _write_csv,
    ".mcap": _write_mcap,
    ".bag": _write_ros1_bag,
    ".db3": _write_ros2_file,
    "": _write_ros2_folder,
}
