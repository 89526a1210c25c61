"""ArduPilot's logs: what was written comes back in SI, each IMU by its name, and damage is said."""

import sys
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest

from imucal.errors import ChoiceError, ReadError
from imucal.readers import describe, read
from tests.readers.ulog.ardupilot_logs import N, truth, write_dataflash, write_telemetry


def test_the_imu_of_a_dataflash_log(tmp_path: Path) -> None:
    """Bit by bit, in SI, with the temperature, on the board's clock."""
    recording = read(write_dataflash(tmp_path / "00000001.BIN"))
    for sensor, values in zip(("gyroscope", "accelerometer"), truth(), strict=True):
        for index, axis in enumerate("xyz"):
            npt.assert_array_equal(recording.axis(sensor, axis).samples, values[:, index])
    assert recording.series[0].rate_hz == pytest.approx(100)
    assert recording.series[0].clock.start_ns == 1_000_000_000
    assert recording.source.format == "dataflash"
    assert dict(recording.source.decisions)["gyroscope unit"] == "rad/s, as ArduPilot logs it"
    assert not recording.findings
    assert recording.temperature is not None
    npt.assert_array_equal(recording.temperature.samples, 31.5)


def test_several_imus_are_for_the_user_to_choose(tmp_path: Path) -> None:
    """The name that the message gives is typed."""
    path = write_dataflash(tmp_path / "log.bin", instances=2)
    with pytest.raises(ChoiceError, match=r"several IMU messages: IMU:0 \(.*\), IMU:1 \(.*name one"):
        read(path)
    npt.assert_array_equal(
        read(path, topic="IMU:1").axis("gyroscope", "y").samples, np.float32(truth()[0][:, 1] + 1)
    )


def test_a_batch_log_has_each_sensor_at_its_own_rate(tmp_path: Path) -> None:
    """By the time of sampling, not that of logging."""
    recording = read(write_dataflash(tmp_path / "log.bin", batch=True))
    gyro, accel = recording.axis("gyroscope", "x"), recording.axis("accelerometer", "z")
    assert (gyro.n, accel.n) == (N, N // 2)
    assert (gyro.rate_hz, accel.rate_hz) == pytest.approx((100, 50))
    assert gyro.clock.start_ns == accel.clock.start_ns == 1_000_000_000
    npt.assert_array_equal(accel.samples, truth()[1][::2, 2])


def test_a_damaged_dataflash_log_is_read_as_far_as_it_is_whole(tmp_path: Path) -> None:
    data = bytearray(write_dataflash(tmp_path / "whole.bin").read_bytes())
    cut, zeroed = tmp_path / "cut.bin", tmp_path / "zeroed.bin"
    cut.write_bytes(data[:6000])
    recording = read(cut)
    assert N // 3 < recording.series[0].n < N // 2
    assert not recording.findings
    data[6000:6100] = bytes(100)
    zeroed.write_bytes(data)
    recording = read(zeroed)
    npt.assert_array_equal(recording.series[0].samples[:100], truth()[0][:100, 0])
    assert [finding.code for finding in recording.findings][:1] == ["damaged"]


@pytest.mark.parametrize("name", ["raw_imu", "scaled_imu", "scaled_imu3"])
def test_what_a_vehicle_sent(name: str, tmp_path: Path) -> None:
    """Whole mg and mrad/s, as ArduPilot sends them."""
    recording = read(write_telemetry(tmp_path / "log.tlog", name=name))
    assert recording.source.format == "tlog"
    assert recording.source.topics == (name.upper(),)
    npt.assert_allclose(recording.axis("gyroscope", "z").samples, truth()[0][:, 2], atol=0.51e-3)
    npt.assert_allclose(recording.axis("accelerometer", "z").samples, truth()[1][:, 2], atol=0.51e-3 * 9.81)
    assert recording.series[0].rate_hz == pytest.approx(100)


def test_si_from_a_vehicle(tmp_path: Path) -> None:
    recording = read(write_telemetry(tmp_path / "log.tlog", name="highres_imu", autopilot=12))
    npt.assert_array_equal(recording.axis("accelerometer", "y").samples, truth()[1][:, 1])


def test_the_counts_of_another_autopilot_have_no_unit(tmp_path: Path) -> None:
    """RAW_IMU is raw: the scale that is asked for, typed, reads it."""
    path = write_telemetry(tmp_path / "log.tlog", autopilot=12)
    with pytest.raises(
        ChoiceError, match=r"the unit of the gyroscope is unknown.*the scale of its counts in rad/s"
    ):
        read(path)
    recording = read(path, gyro_scale=1e-3)
    npt.assert_allclose(recording.axis("gyroscope", "z").samples, truth()[0][:, 2], atol=0.51e-3)


def test_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The message says what to install; `describe` says it too."""
    path = write_dataflash(tmp_path / "log.bin")
    monkeypatch.setitem(sys.modules, "pymavlink", None)
    for action in (read, describe):
        with pytest.raises(ReadError) as caught:
            action(path)
        assert str(caught.value) == (
            f"{path}: a log of ArduPilot, which an extra reads; type: pip install 'imucal-noise[ardupilot]'"
        )


def test_other_binaries_that_end_so(tmp_path: Path) -> None:
    path = tmp_path / "log.bin"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(ReadError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
