"""Tests of calibrations from files of imucal and of other programs."""

import json
from pathlib import Path

import numpy as np
import pytest

import imucal
from imucal.calibration.document import Intrinsics
from imucal.calibration.exports import render_calibration
from imucal.calibration.intrinsics_files import load_calibration
from imucal.errors import ChoiceError, DataError, ReadError
from tests.calibration.test_exports import FOUND
from tests.raising import raises


def equal(found: Intrinsics, truth: Intrinsics, *, biases: bool = True, sensitivity: bool = True) -> None:
    """Compare two calibrations; some formats have no biases or no g-sensitivity."""
    np.testing.assert_allclose(found.C_a, truth.C_a, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(found.C_g, truth.C_g, rtol=1e-12, atol=1e-15)  # type: ignore[arg-type]
    if biases:
        np.testing.assert_allclose(found.b_a, truth.b_a, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(found.b_g, truth.b_g, rtol=1e-12, atol=1e-15)  # type: ignore[arg-type]
    if sensitivity:
        np.testing.assert_allclose(found.G, truth.G, rtol=1e-12, atol=1e-18)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["kalibr", "openvins", "yaml", "librealsense"])
def test_exports_are_read_back(name: str, tmp_path: Path) -> None:
    """Kalibr and OpenVINS have no biases, and librealsense has no g-sensitivity."""
    file = tmp_path / ("file.json" if name == "librealsense" else "file.yaml")
    file.write_text(render_calibration(FOUND, name), encoding="utf-8")
    truth = FOUND.in_frame("kalibr") if name in {"kalibr", "openvins"} else FOUND
    equal(
        load_calibration(file),
        truth,
        biases=name not in {"kalibr", "openvins"},
        sensitivity=name != "librealsense",
    )


def test_the_two_files_of_imu_tk_are_read_together(tmp_path: Path) -> None:
    """Either of them or their folder names both."""
    parts = render_calibration(FOUND, "imu-tk").split("# save the lines below as ")[1:]
    for part in parts:
        name, _, body = part.partition("\n")
        (tmp_path / name.strip()).write_text(body, encoding="utf-8")
    truth = FOUND.in_frame("imu-tk")
    for place in (tmp_path, tmp_path / "imu_acc.calib", tmp_path / "imu_gyro.calib"):
        equal(load_calibration(place), truth, sensitivity=False)
    (tmp_path / "imu_gyro.calib").unlink()
    with raises(ReadError, "No such file", place="imu_gyro.calib"):
        load_calibration(tmp_path)
    (tmp_path / "other_acc.calib").write_bytes((tmp_path / "imu_acc.calib").read_bytes())
    with raises(ChoiceError, "found imu_acc.calib, other_acc.calib"):
        load_calibration(tmp_path)


def test_librealsense_multiplies_rows(tmp_path: Path) -> None:
    """Its tool fits rows: corrected = raw S - bias, with S = scale_and_alignment by rows."""
    S = np.array([[1.01, 0.02, 0.0], [0.03, 0.98, -0.01], [0.0, 0.04, 1.02]])
    bias = np.array([0.1, -0.2, 0.3])
    entry = {"scale_and_alignment": S.ravel().tolist(), "bias": bias.tolist()}
    plain = {"scale_and_alignment": np.eye(3).ravel().tolist(), "bias": [0.0, 0.0, 0.0]}
    file = tmp_path / "calibration.json"
    file.write_text(json.dumps({"imus": [{"accelerometer": entry, "gyroscope": plain}]}), encoding="utf-8")
    found = load_calibration(file)
    raw = np.array([1.0, 2.0, 9.0])
    np.testing.assert_allclose(found.C_a @ (raw - found.b_a), raw @ S - bias, rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.yaml", "imu0:\n  accelerometer_noise_density: 1.0\n", "contains no scale and misalignment"),
        ("a.yaml", "[1, 2", "is no YAML"),
        ("a.yaml", "calibration: {C_a: [[1, 0], [0, 1]]}", "calibration.C_a is missing or wrong"),
        ("a.yaml", "Ta: [[1, 0, 0], [0, 0, 0], [0, 0, 1]]\nTw: 1", "Tw is missing or wrong, expected 3 x 3"),
        ("a.json", '{"imus": []}', "imus: found 0, expected one"),
        ("a.json", '{"schema": "imucal/report/2"}', "is no calibration"),
        ("a.json", "{", "is no JSON"),
        ("a.json", '{"imus": [{"accelerometer": {"bias": 1}}]}', "scale_and_alignment is missing"),
        ("x.calib", "1 " * 21, "neither 'acc' nor 'gyro'"),
        ("a.yaml", "Ta: [[.nan, 0, 0], [0, 1, 0], [0, 0, 1]]\nTw: 1", "not finite"),
    ],
)
def test_other_files_are_refused(name: str, content: str, message: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content, encoding="utf-8")
    with raises(ReadError, message, place=name):
        load_calibration(tmp_path / name)


def test_folders_without_a_calibration_are_refused(tmp_path: Path) -> None:
    with raises(ReadError, "found no calibration in this folder"):
        load_calibration(tmp_path)
    with raises(ReadError, "No such file"):
        load_calibration(tmp_path / "nothing")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x80")
    with raises(ReadError, "is no text"):
        load_calibration(tmp_path / "binary.yaml")


def test_a_loaded_calibration_corrects_a_recording(tmp_path: Path) -> None:
    """A recording is corrected once; one of another frame has a finding."""
    recording = imucal.read(Path(__file__).parents[2] / "sample_logs" / "poses.mcap")
    calibration = imucal.calibrate(recording)
    file = tmp_path / "imu_calibration.yaml"
    file.write_text(render_calibration(Intrinsics.of(calibration), "yaml"), encoding="utf-8")
    first, second = (imucal.apply(c, recording) for c in (calibration, imucal.load_calibration(file)))
    for one, other in zip(first.series, second.series, strict=True):
        np.testing.assert_array_equal(one.samples, other.samples)
    with raises(DataError, "already corrected"):
        imucal.apply(calibration, first)
    again = imucal.calibrate(first)
    assert np.abs(again.accelerometer.b).max() < 1e-4
    assert np.abs(again.accelerometer.C - np.eye(3)).max() < 1e-5
