"""Simulated logs: noise models of a gyroscope and an accelerometer -> Recording -> log file.

Files are CSV, MCAP, ROS 1 and ROS 2 bags of `sensor_msgs/Imu` with unknown orientation. A structured
array contains the bytes of many messages; `mcap` and `rosbags` write the containers.
"""

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray, blocks
from imucal.atomic import replacing
from imucal.clock import Clock
from imucal.errors import ArgumentError, Fix, WriteError
from imucal.noise import NoiseModel
from imucal.readers.compression import lz4_for_ros1
from imucal.recording import AXES, AxisSeries, Recording, Sensor, Source

#: Time of the first simulated sample: 2026-01-01 00:00 UTC, in ns.
START_NS = 1_767_225_600_000_000_000


@dataclass(frozen=True, kw_only=True)
class SensorTruth:
    """The noise model, the means of x, y and z, and the resolution `lsb` (0: none) of a sensor, all in SI."""

    model: NoiseModel
    mean: tuple[float, float, float]
    lsb: float = 0.0

    def rows(self, n: int, *, rate_hz: float, rng: np.random.Generator) -> Iterator[FloatArray]:
        """Yield the samples of the axes x, y, z, each of shape (n,)."""
        for constant in self.mean:
            samples = self.model.simulate(n, rate_hz=rate_hz, rng=rng)
            samples += constant
            if self.lsb:
                samples /= self.lsb
                np.round(samples, out=samples)
                samples *= self.lsb
            yield samples


def simulate_recording(
    *,
    gyroscope: SensorTruth,
    accelerometer: SensorTruth,
    rate_hz: float,
    duration_s: float,
    seed: int,
    gaps_s: Sequence[tuple[float, float]] = (),
) -> Recording:
    """Return a recording of simulated noise.

    The same seed gives the same samples. `gaps_s` contains start and length, in s, of gaps. Raises a
    ValueError if no sample is left.
    """
    n = max(1, round(duration_s * rate_hz))
    rng = np.random.default_rng(seed)
    keep = np.ones(n, dtype=np.bool_)
    for part in blocks(n):
        seconds = np.arange(part.start, part.stop) / rate_hz
        for start, length in gaps_s:
            keep[part] &= ~((seconds >= start) & (seconds < start + length))
    if not keep.any():
        raise ArgumentError("the gaps remove all samples")
    even = Clock.even(n, rate_hz, source="simulated")
    clock = replace(even, start_ns=START_NS, jitter_s=0.0).keeping(keep)
    truths = {Sensor.GYROSCOPE: gyroscope, Sensor.ACCELEROMETER: accelerometer}
    series = tuple(
        AxisSeries(sensor=sensor, axis=axis, samples=row[keep], clock=clock)
        for sensor, truth in truths.items()
        for axis, row in zip(AXES, truth.rows(n, rate_hz=rate_hz, rng=rng), strict=True)
    )
    return Recording(source=Source(path="simulated", format="simulated"), series=series)


_TOPIC = "/imu/data_raw"
#: Messages per structured array: 20 MB.
_MESSAGES = 1 << 16
_EUROC_HEADER = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
)
_HEAT_HEADER = ",temperature [degC]"


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """Consecutive samples: index of the first, stamps in ns, shape (n,), rates and forces in SI, (n, 3).

    `temperature`, shape (n,), is in degrees Celsius; None without one.
    """

    first: int
    stamps: IntArray
    rates: FloatArray
    forces: FloatArray
    temperature: FloatArray | None = None


def _rows(recording: Recording) -> Iterator[Rows]:
    clock, columns = recording.series[0].clock, [series.samples for series in recording.series]
    heat = recording.temperature
    known = heat.samples if heat is not None and heat.clock is clock else None
    for part in blocks(clock.n, size=_MESSAGES):
        place = clock.grid(part.start, part.stop)
        stamps = (clock.start_ns or 0) + np.rint(place * (1e9 / clock.rate_hz)).astype(np.int64)
        values = np.stack([column[part] for column in columns], axis=1)
        yield Rows(
            first=part.start,
            stamps=stamps,
            rates=values[:, :3],
            forces=values[:, 3:],
            temperature=None if known is None else known[part],
        )


def write_log(recording: Recording, path: Path) -> None:
    """Write a recording whose six axes share one clock; the suffix of `path` selects the format.

    ``.csv`` (EuRoC columns), ``.mcap`` (ROS 2, zstd), ``.bag`` (ROS 1, lz4), ``.db3`` (one ROS 2 sqlite3
    file), no suffix (a ROS 2 sqlite3 bag folder). Raises a WriteError if the suffix is unknown, or if the
    file exists already or can't be written.
    """
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        known = ", ".join(suffix or "none (a folder)" for suffix in WRITERS)
        raise WriteError(f"unknown log suffix {path.suffix!r}; expected one of {known}", place=path)
    if path.exists():
        raise WriteError("exists already", place=path, fix=Fix("choose another name, or remove it"))
    with replacing(path) as scratch:
        writer(scratch, _rows(recording))


def _write_csv(path: Path, parts: Iterator[Rows]) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        for number, part in enumerate(parts):
            columns = [part.rates, part.forces]
            if part.temperature is not None:
                columns.append(part.temperature[:, np.newaxis])
            if not number:
                stream.write(_EUROC_HEADER + (_HEAT_HEADER if part.temperature is not None else "") + "\n")
            rows = np.concatenate(columns, axis=1).tolist()
            for stamp, row in zip(part.stamps.tolist(), rows, strict=True):
                stream.write(f"{stamp},{','.join(map(repr, row))}\n")


def _imu_bytes(part: Rows, head: str, frame: str) -> NDArray[np.void]:
    """Return one `sensor_msgs/Imu` per row, shape (n,): field `head`, stamp, frame, then 37 doubles."""
    names = (
        f"{head} sec nsec length frame orientation orientation_covariance angular_velocity gyro_covariance"
    )
    layout = f"<u4,<i4,<u4,<u4,{frame},4<f8,9<f8,3<f8,9<f8,3<f8,9<f8"
    messages = np.zeros(part.stamps.size, dtype=layout)
    messages.dtype.names = (*names.split(), "linear_acceleration", "accel_covariance")
    messages["sec"], messages["nsec"] = np.divmod(part.stamps, 1_000_000_000)
    messages["frame"] = b"imu"
    messages["orientation"][:, 3] = 1.0
    messages["orientation_covariance"][:, 0] = -1.0
    messages["angular_velocity"] = part.rates
    messages["linear_acceleration"] = part.forces
    return messages


def ros2_messages(part: Rows) -> NDArray[np.void]:
    """Return CDR, little endian; the frame id is padded so that the doubles are aligned."""
    messages = _imu_bytes(part, "encapsulation", "S4")
    messages["encapsulation"], messages["length"] = 0x0100, 4
    return messages


def _ros1_messages(part: Rows) -> NDArray[np.void]:
    messages = _imu_bytes(part, "seq", "S3")
    messages["seq"], messages["length"] = np.arange(part.first, part.first + part.stamps.size), 3
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

    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    writer.compressor = lz4_for_ros1
    _fill(writer, "ROS1_NOETIC", _stamped(parts, _ros1_messages))


def _write_ros2_folder(path: Path, parts: Iterator[Rows]) -> None:
    from rosbags.rosbag2 import Writer

    _fill(Writer(path, version=9), "ROS2_HUMBLE", _stamped(parts, ros2_messages))


def _fill(writer: Any, store: str, messages: Iterator[tuple[int, bytes]]) -> None:  # noqa: ANN401 - of rosbags
    from rosbags.typesys import Stores, get_typestore

    with writer:
        typestore = get_typestore(Stores[store])
        connection = writer.add_connection(_TOPIC, "sensor_msgs/msg/Imu", typestore=typestore)
        for stamp, message in messages:
            writer.write(connection, stamp, message)


def _write_ros2_file(path: Path, parts: Iterator[Rows]) -> None:
    folder = path.with_suffix("")
    _write_ros2_folder(folder, parts)
    (written,) = folder.glob("*.db3")
    written.replace(path)
    shutil.rmtree(folder)


WRITERS: dict[str, Callable[[Path, Iterator[Rows]], None]] = {
    ".csv": _write_csv,
    ".mcap": _write_mcap,
    ".bag": _write_ros1_bag,
    ".db3": _write_ros2_file,
    "": _write_ros2_folder,
}
