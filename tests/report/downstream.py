"""The consumers' side: each downstream file read by a real parser of its format, turned back into N and K."""

import ast
import math
import re
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import yaml

__all__ = ["READERS", "Recovered", "opencv"]

#: Axis or sensor name and symbol -> coefficient in SI.
Recovered = dict[tuple[str, str], float]

_RATE_HZ = 200.0
_DEGREE = math.pi / 180


def _yaml(path: Path) -> Any:  # noqa: ANN401 - whatever the file holds
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def opencv(path: Path) -> Any:  # noqa: ANN401 - cv2 is optional
    """Open a file as OpenCV does; skip the test where OpenCV isn't there."""
    import pytest

    cv2 = pytest.importorskip("cv2", reason="opencv-python-headless is not installed")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert storage.isOpened()
    return storage


def _opencv_real(node: Any) -> float:  # noqa: ANN401 - cv2.FileNode
    assert node.isReal(), f"{node.name()} is not a real number for OpenCV"
    return float(node.real())


def _four(accel_n: float, accel_k: float, gyro_n: float, gyro_k: float) -> Recovered:
    return {("accel", "N"): accel_n, ("accel", "K"): accel_k, ("gyro", "N"): gyro_n, ("gyro", "K"): gyro_k}


def _kalibr(path: Path) -> Recovered:
    data = _yaml(path)
    assert set(data) == {
        "accelerometer_noise_density",
        "accelerometer_random_walk",
        "gyroscope_noise_density",
        "gyroscope_random_walk",
        "rostopic",
        "update_rate",
    }
    assert data["update_rate"] == _RATE_HZ
    assert data["rostopic"] == "/imu/data"
    values = [data[key] for key in list(data)[:4]]
    assert all(isinstance(value, float) and value > 0 for value in values)
    return _four(*values)


def _openvins(path: Path) -> Recovered:
    storage = opencv(path)  # its nodes live as long as it does
    imu = storage.getNode("imu0")
    assert imu.getNode("model").string() == "kalibr"
    assert imu.getNode("rostopic").string() == "/imu/data"
    assert _opencv_real(imu.getNode("update_rate")) == _RATE_HZ
    assert _opencv_real(imu.getNode("time_offset")) == 0
    for key, size in {"T_i_b": 4, "Tw": 3, "R_IMUtoGYRO": 3, "Ta": 3, "R_IMUtoACC": 3, "Tg": 3}.items():
        node = imu.getNode(key)
        rows = [
            [_opencv_real(node.at(i).at(j)) for j in range(node.at(i).size())] for i in range(node.size())
        ]
        np.testing.assert_array_equal(rows, np.zeros((3, 3)) if key == "Tg" else np.eye(size))
    keys = (
        "accelerometer_noise_density",
        "accelerometer_random_walk",
        "gyroscope_noise_density",
        "gyroscope_random_walk",
    )
    return _four(*(_opencv_real(imu.getNode(key)) for key in keys))


def _vins(path: Path) -> Recovered:
    storage = opencv(path)
    acc_n, acc_w, gyr_n, gyr_w, gravity = (
        _opencv_real(storage.getNode(key)) for key in ("acc_n", "acc_w", "gyr_n", "gyr_w", "g_norm")
    )
    assert 9.7 < gravity < 9.9
    white, walk = math.sqrt(2 * _RATE_HZ), math.sqrt(_RATE_HZ)
    return _four(acc_n / white, acc_w / walk, gyr_n / white, gyr_w / walk)


def _orbslam3(path: Path) -> Recovered:
    storage = opencv(path)
    assert _opencv_real(storage.getNode("IMU.Frequency")) == _RATE_HZ
    keys = ("IMU.NoiseAcc", "IMU.AccWalk", "IMU.NoiseGyro", "IMU.GyroWalk")
    return _four(*(_opencv_real(storage.getNode(key)) for key in keys))


def _gtsam(path: Path) -> Recovered:
    """Run the module against a double of GTSAM that records the setters."""
    source = path.read_text(encoding="utf-8")
    ast.parse(source)
    called: dict[str, Any] = {}

    class Params:
        @staticmethod
        def MakeSharedU(gravity: float) -> "Params":  # noqa: N802 - GTSAM's name
            assert 9.7 < gravity < 9.9
            return Params()

        def __getattr__(self, name: str) -> Callable[[Any], None]:
            return lambda value: called.__setitem__(name, value)

    module = types.ModuleType("gtsam")
    module.PreintegrationCombinedParams = Params  # type: ignore[attr-defined]
    names: dict[str, Any] = {"gtsam": module}
    body = source.replace("import gtsam\n", "")
    exec(compile(body, str(path), "exec"), names)  # noqa: S102 - the file under test
    names["imu_params"]()
    for value in called.values():
        np.testing.assert_array_equal(value, value[0, 0] * np.eye(3))
    assert called["setIntegrationCovariance"][0, 0] == 1e-8
    keys = (
        "setAccelerometerCovariance",
        "setBiasAccCovariance",
        "setGyroscopeCovariance",
        "setBiasOmegaCovariance",
    )
    return _four(*(math.sqrt(called[key][0, 0]) for key in keys))


def _lio_sam(path: Path) -> Recovered:
    data = _yaml(path)["lio_sam"]
    assert 9.7 < data["imuGravity"] < 9.9
    return _four(data["imuAccNoise"], data["imuAccBiasN"], data["imuGyrNoise"], data["imuGyrBiasN"])


def _fast_lio(path: Path) -> Recovered:
    data = _yaml(path)["mapping"]
    keys = ("acc_cov", "b_acc_cov", "gyr_cov", "b_gyr_cov")
    return _four(*(math.sqrt(data[key] / _RATE_HZ) for key in keys))


def _ros(path: Path) -> Recovered:
    data, recovered = _yaml(path), {}
    for key, sensor in (("angular_velocity", "gyro"), ("linear_acceleration", "accel")):
        covariance = np.array(data[f"{key}_covariance"]).reshape(3, 3)
        np.testing.assert_array_equal(covariance, np.diag(np.diag(covariance)))
        for axis, variance in zip("xyz", np.diag(covariance), strict=True):
            recovered[f"{sensor}_{axis}", "N"] = math.sqrt(variance / _RATE_HZ)
    return recovered


def _px4(path: Path) -> Recovered:
    """Read as QGroundControl does: skip comments, five tab-separated fields, 9 is a float."""
    values = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            continue
        vehicle, component, name, value, kind = line.split("\t")
        assert (vehicle, component, kind) == ("1", "1", "9")
        assert re.fullmatch(r"\d+\.\d+", value)
        values[name] = float(value)
    period = math.sqrt(0.01)
    keys = ("EKF2_ACC_NOISE", "EKF2_ACC_B_NOISE", "EKF2_GYR_NOISE", "EKF2_GYR_B_NOISE")
    return _four(*(values[key] * period for key in keys))


def _gazebo(path: Path) -> Recovered:
    sensor = ET.parse(path).getroot().find("./model/link/sensor")  # noqa: S314 - our own file
    assert sensor is not None
    assert sensor.findtext("update_rate") == "200.0"
    recovered = {}
    for element, short in (("angular_velocity", "gyro"), ("linear_acceleration", "accel")):
        for axis in "xyz":
            noise = sensor.find(f"./imu/{element}/{axis}/noise")
            assert noise is not None
            assert noise.get("type") == "gaussian"
            value = {child.tag: float(child.text or "nan") for child in noise}
            assert value["mean"] == value["bias_mean"] == value["bias_stddev"] == 0
            recovered[f"{short}_{axis}", "N"] = value["stddev"] / math.sqrt(_RATE_HZ)
            recovered[f"{short}_{axis}", "K"] = value["dynamic_bias_stddev"]
            recovered[f"{short}_{axis}", "T"] = value["dynamic_bias_correlation_time"]
    return recovered


def _isaac(path: Path) -> Recovered:
    data = _yaml(path)["/**"]["ros__parameters"]
    assert data["calibration_frequency"] == _RATE_HZ
    keys = ("accel_noise_density", "accel_random_walk", "gyro_noise_density", "gyro_random_walk")
    return _four(*(data[key] for key in keys))


def _euroc(path: Path) -> Recovered:
    data = _yaml(path)
    assert data["sensor_type"] == "imu"
    assert data["rate_hz"] == _RATE_HZ
    assert data["T_BS"] == {"cols": 4, "rows": 4, "data": np.eye(4).ravel().tolist()}
    keys = (
        "accelerometer_noise_density",
        "accelerometer_random_walk",
        "gyroscope_noise_density",
        "gyroscope_random_walk",
    )
    return _four(*(data[key] for key in keys))


def _kf_gins(path: Path) -> Recovered:
    """Undo the data-sheet units; K from the steady state of a walk, sigma = K sqrt(T/2)."""
    data, recovered = _yaml(path)["imunoise"], {}
    time = data["corrtime"] * 3600
    for i, axis in enumerate("xyz"):
        recovered[f"gyro_{axis}", "N"] = data["arw"][i] * _DEGREE / 60
        recovered[f"accel_{axis}", "N"] = data["vrw"][i] / 60
        recovered[f"gyro_{axis}", "K"] = data["gbstd"][i] * _DEGREE / 3600 / math.sqrt(time / 2)
        recovered[f"accel_{axis}", "K"] = data["abstd"][i] * 1e-5 / math.sqrt(time / 2)
    return recovered


def _matlab(path: Path) -> Recovered:
    """Read the name-value pairs of the two calls, comments and continuations removed."""
    text = re.sub(r"%.*", "", path.read_text(encoding="utf-8")).replace("...\n", " ")
    recovered = {}
    for name, function in (("gyro", "gyroparams"), ("accel", "accelparams")):
        call = re.search(rf"{name} = {function}\((.*?)\);", text)
        assert call is not None
        pairs = dict(re.findall(r"'(\w+)',\s*\[([^\]]*)\]", call[1]))
        for key, symbol in (("NoiseDensity", "N"), ("BiasInstability", "B"), ("RandomWalk", "K")):
            for axis, value in zip("xyz", pairs[key].split(","), strict=True):
                recovered[f"{name}_{axis}", symbol] = float(value)
    return recovered


def _state_space(path: Path) -> Recovered:
    recovered = {}
    for name, axis in _yaml(path)["axes"].items():
        recovered[name, "N"] = axis["white"] / math.sqrt(axis["rate_hz"])
        walk = next(state for state in axis["states"] if state["term"] == "K")
        assert walk["phi"] == 1
        recovered[name, "K"] = walk["q"] * math.sqrt(axis["rate_hz"])
    return recovered


#: Name of a format -> its reader.
READERS: dict[str, Callable[[Path], Recovered]] = {
    "kalibr": _kalibr,
    "openvins": _openvins,
    "vins": _vins,
    "orbslam3": _orbslam3,
    "gtsam": _gtsam,
    "lio-sam": _lio_sam,
    "fast-lio": _fast_lio,
    "ros": _ros,
    "px4": _px4,
    "gazebo": _gazebo,
    "isaac-ros": _isaac,
    "euroc": _euroc,
    "kf-gins": _kf_gins,
    "matlab": _matlab,
    "gm": _state_space,
}
