"""PX4 ULog: samples equal those of pyulog, in SI units, on the clock of the flight controller."""

import struct
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest
from pyulog import ULog

from imucal.arrays import FloatArray
from imucal.errors import ChoiceError, ImucalError, ReadError
from imucal.readers import read as read_any
from imucal.readers.formats import describe_log as describe
from imucal.readers.read_options import ReadOptions
from imucal.readers.reading import read_one as read
from imucal.readers.ulog_walk import walk
from imucal.recording import Sensor
from tests.raising import raises
from tests.real_data import real_data

LOGS = ("mcap_test_ulog", "pyulog_sample", "pyulog_sample_px4_events", "pyulog_sample_log_small")


class Writer:
    """Write a ULog file of given messages. Source: docs.px4.io, ULog file format."""

    def __init__(self) -> None:
        self.data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000)
        self._section(b"B", bytes(40))
        self._ids: dict[tuple[str, int], int] = {}

    def _section(self, kind: bytes, body: bytes) -> None:
        self.data += struct.pack("<H", len(body)) + kind + body

    def format(self, name: str, fields: str) -> None:
        self._section(b"F", f"{name}:{fields}".encode())

    def add(self, name: str, multi: int = 0) -> None:
        self._ids[name, multi] = len(self._ids)
        self._section(b"A", struct.pack("<BH", multi, self._ids[name, multi]) + name.encode())

    def message(self, name: str, body: bytes, multi: int = 0) -> None:
        self._section(b"D", struct.pack("<H", self._ids[name, multi]) + body)

    def dropout(self, milliseconds: int) -> None:
        self._section(b"O", struct.pack("<H", milliseconds))

    def store(self, path: Path) -> Path:
        path.write_bytes(self.data)
        return path


SENSOR = (
    "uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float x;float y;float z;"
    "float temperature;"
)
FIFO = (
    "uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float dt;float scale;uint8_t samples;"
    "int16_t[32] x;int16_t[32] y;int16_t[32] z;"
)


def vectors(n: int, seed: int = 0) -> FloatArray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, 3)).astype(np.float32).astype(np.float64)


def two_sensors(path: Path, *, instances: int = 1) -> Path:
    """Write gyroscopes at 200 Hz and accelerometers at 100 Hz."""
    log = Writer()
    log.format("sensor_gyro", SENSOR)
    log.format("sensor_accel", SENSOR)
    for multi in range(instances):
        log.add("sensor_gyro", multi)
        log.add("sensor_accel", multi)
    for i in range(400):
        for multi in range(instances):
            for name, step in (("sensor_gyro", 5000), ("sensor_accel", 10000)):
                if name == "sensor_gyro" or i % 2 == 0:
                    k = i if name == "sensor_gyro" else i // 2
                    now = 1_000_000 + k * step
                    values = vectors(400, multi + 10 * (name == "sensor_accel"))[k]
                    log.message(name, struct.pack("<QQI4f", now + 300, now, 7, *values, 30.0), multi)
    return log.store(path)


@pytest.mark.parametrize("name", LOGS)
def test_samples_equal_those_of_pyulog(name: str) -> None:
    """Every sample of sensor_combined is compared bit by bit."""
    path = real_data("formats", f"{name}.ulg")
    recording = read(path, ReadOptions())
    (message,) = [entry for entry in ULog(str(path)).data_list if entry.name == "sensor_combined"]
    for series in recording.series:
        field = "gyro_rad" if series.sensor is Sensor.GYROSCOPE else "accelerometer_m_s2"
        npt.assert_array_equal(series.samples, message.data[f"{field}[{'xyz'.index(series.axis)}]"])
    assert recording.source.topics == ("sensor_combined",)
    assert len({id(series.clock) for series in recording.series}) == 1
    assert recording.series[0].clock.start_ns == int(message.data["timestamp"][0]) * 1000


def test_each_sensor_has_its_own_clock(tmp_path: Path) -> None:
    """The clock uses the time of sampling; the temperature has a clock too."""
    recording = read_any(two_sensors(tmp_path / "log.ulg"))
    gyro, accel = recording.axis("gyroscope", "y"), recording.axis("accelerometer", "z")
    npt.assert_array_equal(gyro.samples, vectors(400, 0)[:, 1])
    npt.assert_array_equal(accel.samples, vectors(400, 10)[:200, 2])
    assert (gyro.rate_hz, accel.rate_hz) == pytest.approx((200, 100))
    assert gyro.clock.start_ns == 1_000_000_000
    assert recording.temperature is not None
    npt.assert_array_equal(recording.temperature.samples, 30.0)


def test_several_sensors_require_a_choice(tmp_path: Path) -> None:
    """Two gyroscopes have the full rate, and none is chosen silently."""
    path = two_sensors(tmp_path / "log.ulg", instances=2)
    with pytest.raises(ChoiceError) as caught:
        read(path, ReadOptions())
    assert str(caught.value) == (
        f"{path}: 4 topics carry IMU samples; choose one of these topics\n"
        "  sensor_accel:0  sensor_accel  200 messages  100 Hz  1.99 s\n"
        "  sensor_accel:1  sensor_accel  200 messages  100 Hz  1.99 s\n"
        "  sensor_gyro:0   sensor_gyro   400 messages  200 Hz  1.995 s\n"
        "  sensor_gyro:1   sensor_gyro   400 messages  200 Hz  1.995 s"
    )
    recording = read(path, ReadOptions(topics=("sensor_gyro:1", "sensor_accel:0")))
    npt.assert_array_equal(recording.axis("gyroscope", "x").samples, vectors(400, 1)[:, 0])
    npt.assert_array_equal(recording.axis("accelerometer", "x").samples, vectors(400, 10)[:200, 0])


def test_samples_of_a_fifo_have_their_own_times(tmp_path: Path) -> None:
    """The rate is 8 kHz, in messages of 8 samples, one of 5."""
    log = Writer()
    log.format("sensor_gyro_fifo", FIFO)
    log.add("sensor_gyro_fifo")
    counts = np.random.default_rng(3).integers(-2000, 2000, (50, 3, 32)).astype(np.int16)
    scale, dt = np.float32(0.001), 125.0
    expected, now = [], 1_000_000
    for k in range(50):
        samples = 5 if k == 20 else 8
        now += int(samples * dt)
        head = struct.pack("<QQIffB", now + 50, now, 7, dt, scale, samples)
        log.message("sensor_gyro_fifo", head + counts[k].tobytes())
        expected.append(counts[k, :, :samples].T * np.float64(scale))
    recording = read(log.store(tmp_path / "log.ulg"), ReadOptions())
    gyro = recording.axis("gyroscope", "z")
    npt.assert_array_equal(gyro.samples, np.concatenate(expected)[:, 2])
    assert gyro.rate_hz == pytest.approx(8000)
    assert gyro.clock.missing == 0
    assert gyro.clock.start_ns == 1_000_000_000 + 125_000
    assert describe(tmp_path / "log.ulg", ReadOptions()).topics[0].count == 397


def test_integrals_become_rates(tmp_path: Path) -> None:
    """vehicle_imu contains an angle and its duration; a duration of zero gives no sample."""
    log = Writer()
    log.format(
        "vehicle_imu",
        "uint64_t timestamp;uint64_t timestamp_sample;uint32_t accel_device_id;uint32_t gyro_device_id;"
        "float[3] delta_angle;float[3] delta_velocity;uint16_t delta_angle_dt;uint16_t delta_velocity_dt;",
    )
    log.add("vehicle_imu")
    angle, velocity = vectors(100, 1) * 1e-3, vectors(100, 2)
    for i in range(100):
        over = 0 if i == 50 else 5000
        body = struct.pack(
            "<QQII3f3fHH", 10**6 + i * 5000, 10**6 + i * 5000, 1, 2, *angle[i], *velocity[i], over, 5000
        )
        log.message("vehicle_imu", body)
    recording = read(log.store(tmp_path / "log.ulg"), ReadOptions())
    kept = np.delete(np.arange(100), 50)
    npt.assert_array_equal(
        recording.axis("gyroscope", "x").samples, angle.astype(np.float32).astype(np.float64)[kept, 0] / 5e-3
    )
    npt.assert_array_equal(recording.axis("accelerometer", "y").samples, velocity[:, 1] / 5e-3)
    assert recording.axis("gyroscope", "x").clock.missing == 1


def test_dropouts_are_reported(tmp_path: Path) -> None:
    """The logger itself records what it lost."""
    path = two_sensors(tmp_path / "log.ulg")
    log = Writer()
    log.data = path.read_bytes()
    log.dropout(250)
    finding = next(f for f in read(log.store(path), ReadOptions()).findings if f.code == "dropouts")
    assert finding.text == "The logger reports a dropout of 0.25 s in all: its card was too slow."


def test_an_unknown_topic_is_refused() -> None:
    """The error lists the topics."""
    path = real_data("formats", "pyulog_sample.ulg")
    with pytest.raises(ChoiceError) as caught:
        read(path, ReadOptions(topics=("sensor_gyro",)))
    assert str(caught.value) == (
        f"{path}: there is no topic sensor_gyro; choose one of these topics\n"
        "  sensor_combined  sensor_combined  17070 messages  247.8 Hz  68.88 s"
    )


def test_a_log_without_imu_is_refused(tmp_path: Path) -> None:
    """The error lists the required messages."""
    log = Writer()
    log.format("battery", "uint64_t timestamp;float v;")
    log.add("battery")
    log.message("battery", struct.pack("<Qf", 5, 12.0))
    path = log.store(tmp_path / "log.ulg")
    with pytest.raises(ChoiceError) as caught:
        read(path, ReadOptions())
    assert str(caught.value).startswith(
        f"{path}: no IMU messages; expected one of sensor_combined, vehicle_imu,"
    )


def test_other_bytes_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.ulg"
    path.write_bytes(b"ULog\x01\x12\x36" + bytes(100))
    with raises(ReadError, "not a readable ULog file", place="log.ulg"):
        read(path, ReadOptions())


def test_a_damaged_log_is_read_or_refused_with_a_message(tmp_path: Path) -> None:
    """Damage: the log is cut, or has flipped or zeroed bytes."""
    data = two_sensors(tmp_path / "whole.ulg").read_bytes()
    path = tmp_path / "log.ulg"
    for seed in range(60):
        rng = np.random.default_rng(seed)
        damaged = bytearray(data)
        place = int(rng.integers(0, len(data)))
        if seed % 3 == 0:
            damaged = damaged[:place]
        elif seed % 3 == 1:
            damaged[place] ^= 1 << int(rng.integers(0, 8))
        else:
            damaged[place : place + 64] = bytes(min(64, len(data) - place))
        path.write_bytes(bytes(damaged))
        try:
            recording = read(path, ReadOptions())
        except ImucalError as error:
            assert str(path) in str(error)  # noqa: PT017 - the message is the point
        else:
            assert recording.series


def messages_of(data: bytes | bytearray) -> list[int]:
    """Return the starts of the samples of the first gyroscope, and the end of the log."""
    starts, at = [], 16
    while at < len(data):
        size, kind = struct.unpack_from("<HB", data, at)
        if kind == ord("D") and data[at + 3 : at + 5] == b"\0\0":
            starts.append(at)
        at += 3 + size
    return [*starts, at]


def test_a_log_that_ends_within_a_message_is_truncated(tmp_path: Path) -> None:
    """A log cut between two messages is complete for all that is known."""
    path = two_sensors(tmp_path / "log.ulg")
    data = path.read_bytes()
    at = messages_of(data)[100]
    path.write_bytes(data[:at])
    assert "truncated" not in codes(path)
    for lost in (1, 2, 3, 20):
        path.write_bytes(data[: at + lost])
        assert codes(path) >= {"truncated"}
        assert read(path, ReadOptions()).series[0].n == 100
        with raises(ReadError, "strict reading", place="log.ulg"):
            read(path, ReadOptions(strict=True))


@pytest.mark.parametrize("shift", [-30, -1, 1, 24])
def test_samples_after_lost_or_inserted_bytes_are_not_shifted(shift: int, tmp_path: Path) -> None:
    """The damaged message is left out, and all others equal those of the sound log."""
    path = two_sensors(tmp_path / "log.ulg")
    data = path.read_bytes()
    sound = read(path, ReadOptions())
    at = messages_of(data)[150] + 11
    inserted = np.random.default_rng(5).bytes(max(shift, 0))
    path.write_bytes(data[:at] + inserted + data[at + max(-shift, 0) :])
    damaged = read(path, ReadOptions())
    assert "damaged" in {finding.code for finding in damaged.findings}
    for one, other in zip(sound.series, damaged.series, strict=True):
        assert one.n - 2 <= other.n < one.n + (one.sensor is not Sensor.GYROSCOPE)
        assert np.isin(other.samples, one.samples).all()


def test_a_changed_size_of_a_message_is_damage(tmp_path: Path) -> None:
    """The sizes of the messages follow from their formats."""
    path = two_sensors(tmp_path / "log.ulg")
    data = bytearray(path.read_bytes())
    data[messages_of(data)[50]] += 1
    path.write_bytes(data)
    assert codes(path) >= {"damaged"}
    assert read(path, ReadOptions()).series[0].n == 398


def test_padding_at_the_end_of_a_message_may_be_left_out() -> None:
    log = Writer()
    log.format("vector", "float x;float y;float z;")
    log.format("sensor_gyro", "uint64_t timestamp;vector[1] v;float x;float y;float z;uint8_t[4] _padding0;")
    log.add("sensor_gyro")
    for i in range(100):
        body = struct.pack("<Q6f", 10_000 * (i + 1), 0, 0, 0, *vectors(100)[i])
        log.message("sensor_gyro", body + bytes(4 * (i % 2)))
    walked = walk(log.data)
    assert (walked.damaged, walked.truncated) == (False, False)
    assert walked.sound() == log.data


def test_data_appended_after_a_crash_are_walked(tmp_path: Path) -> None:
    """The flags contain the place; the message before it may be incomplete."""
    path = two_sensors(tmp_path / "log.ulg")
    data = bytearray(path.read_bytes())
    at = messages_of(data)[200]
    cut = at + 10
    data[16 + 3 + 16 : 16 + 3 + 24] = struct.pack("<Q", cut)
    walked = walk(bytes(data[:cut] + data[at:]))
    assert (walked.truncated, walked.damaged, walked.resumed) == (True, False, False)
    assert walked.sound()[59:] == data[59:]


def codes(path: Path) -> set[str]:
    """Return the codes of a log's findings."""
    return {finding.code for finding in describe(path, ReadOptions()).findings}
