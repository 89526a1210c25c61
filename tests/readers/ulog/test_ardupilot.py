"""ArduPilot logs: samples in SI units, the choice of an IMU, and damage."""

import sys
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest

from imucal.errors import ChoiceError, ReadError
from imucal.readers import describe, read
from tests.raising import raises
from tests.readers.ulog.ardupilot_logs import N, truth, write_dataflash, write_telemetry


def test_the_samples_of_a_dataflash_log_are_exact(tmp_path: Path) -> None:
    """Samples are in SI units, with the temperature, on the clock of the board."""
    recording = read(write_dataflash(tmp_path / "00000001.BIN"))
    for sensor, values in zip(("gyroscope", "accelerometer"), truth(), strict=True):
        for index, axis in enumerate("xyz"):
            npt.assert_array_equal(recording.axis(sensor, axis).samples, values[:, index])
    assert recording.series[0].rate_hz == pytest.approx(100)
    assert recording.series[0].clock.start_ns == 1_000_000_000
    assert recording.source.format == "dataflash"
    assert dict(recording.source.decisions)["gyroscope unit"] == "rad/s, as in logs of ArduPilot"
    assert not recording.findings
    assert recording.temperature is not None
    npt.assert_array_equal(recording.temperature.samples, 31.5)


def test_several_imus_require_a_choice(tmp_path: Path) -> None:
    """The names in the error can be used as topics."""
    path = write_dataflash(tmp_path / "log.bin", instances=2)
    with raises(
        ChoiceError,
        r"2 topics carry IMU samples; .*\n  IMU:0 .*\n  IMU:1 ",
        place="log.bin",
        argument="topic",
    ):
        read(path)
    npt.assert_array_equal(
        read(path, topic="IMU:1").axis("gyroscope", "y").samples, np.float32(truth()[0][:, 1] + 1)
    )


def test_each_sensor_of_a_batch_log_has_its_own_rate(tmp_path: Path) -> None:
    """The clock uses the time of sampling, not the time of logging."""
    recording = read(write_dataflash(tmp_path / "log.bin", batch=True))
    gyro, accel = recording.axis("gyroscope", "x"), recording.axis("accelerometer", "z")
    assert (gyro.n, accel.n) == (N, N // 2)
    assert (gyro.rate_hz, accel.rate_hz) == pytest.approx((100, 50))
    assert gyro.clock.start_ns == accel.clock.start_ns == 1_000_000_000
    npt.assert_array_equal(accel.samples, truth()[1][::2, 2])


def test_a_damaged_dataflash_log_is_read_up_to_the_damage(tmp_path: Path) -> None:
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


def test_columns_of_a_message_can_be_named(tmp_path: Path) -> None:
    """The error for a missing column lists the existing ones."""
    path = write_dataflash(tmp_path / "log.bin")
    recording = read(path, columns="g=GyrY+GyrX+GyrZ")
    npt.assert_array_equal(recording.axis("gyroscope", "x").samples, truth()[0][:, 1])
    assert len(recording.series) == 3
    with raises(
        ChoiceError, "no column 'wx'; found timestamp, GyrX, .*, T$", place="log.bin", argument="columns"
    ):
        read(path, columns="g=wx+wy+wz")


def test_telemetry_is_named(tmp_path: Path) -> None:
    path = write_telemetry(tmp_path / "log.tlog")
    for action in (read, describe):
        with pytest.raises(ReadError) as caught:
            action(path)
        assert str(caught.value) == (
            f"{path}: it is telemetry of MAVLink (.tlog); give the board's own log (DataFlash, .bin), which "
            "has all samples"
        )


def test_without_the_extra_the_error_explains_the_installation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`read` and `describe` raise the same error."""
    path = write_dataflash(tmp_path / "log.bin")
    monkeypatch.setitem(sys.modules, "pymavlink", None)
    for action in (read, describe):
        with pytest.raises(ReadError) as caught:
            action(path)
        assert str(caught.value) == (
            f"{path}: a log of ArduPilot, which an extra reads; type: pip install 'imucal-noise[ardupilot]'"
        )


def test_other_files_with_the_extension_bin_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.bin"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(ReadError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
