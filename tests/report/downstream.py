"""Parsers of the target programs' formats: each converts an exported file back into N and K.

For a log of one sensor, the result contains only that sensor's numbers.
"""

import ast
import json
import math
import re
import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import yaml

from imucal.units import G0

__all__ = ["READERS", "Recovered", "opencv", "qgroundcontrol"]

#: (axis or sensor name, symbol) -> coefficient in SI.
Recovered = dict[tuple[str, str], float]

_RATE_HZ = 200.0
_DEGREE = math.pi / 180
_SHORT = {"gyroscope": "gyro", "accelerometer": "accel"}
#: Numbers of most formats, in the order of a parser's list of keys.
_FOUR = (("accel", "N"), ("accel", "K"), ("gyro", "N"), ("gyro", "K"))
_KALIBR = (
    "accelerometer_noise_density accelerometer_random_walk gyroscope_noise_density gyroscope_random_walk"
)


def _yaml(path: Path) -> Any:  # noqa: ANN401 - whatever the file holds
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def _json(path: Path) -> Any:  # noqa: ANN401 - whatever the file holds
    def refuse(name: str) -> float:
        msg = f"{name} is no JSON"
        raise ValueError(msg)

    data = json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    assert "written by imucal" in data["_imucal"][0]
    return data


def opencv(path: Path) -> Any:  # noqa: ANN401 - cv2 is optional
    """Open a file with OpenCV; skip the test if OpenCV is not installed."""
    import pytest

    cv2 = pytest.importorskip("cv2", reason="opencv-python-headless is not installed")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert storage.isOpened()
    return storage


def _opencv_map(storage: Any, *section: str) -> dict[str, Any]:  # noqa: ANN401 - cv2.FileStorage
    """Return the nodes of a section by name."""
    node = storage.root()
    for name in section:
        node = node.getNode(name)
    return {name: node.getNode(name) for name in node.keys()}  # noqa: SIM118 - a FileNode is no mapping


def _opencv_real(node: Any) -> float:  # noqa: ANN401 - cv2.FileNode
    assert node.isReal(), f"{node.name()} is not a real number for OpenCV"
    return float(node.real())


def _opencv_reals(path: Path, *section: str) -> dict[str, float]:
    """Return the reals of a section, without numbers that OpenCV reads as integers."""
    storage = opencv(path)  # the nodes need this object
    found = _opencv_map(storage, *section).items()
    return {name: float(node.real()) for name, node in found if node.isReal()}


def _four(data: Mapping[str, Any], keys: str, white: float = 1.0, walk: float = 1.0) -> Recovered:
    """Return the numbers of the existing keys, divided by the factor of their symbol."""
    factor = {"N": white, "K": walk}
    present = [
        (name, term) for name, term in zip(keys.split(), _FOUR, strict=True) if data.get(name) is not None
    ]
    assert present, f"none of {keys} in {list(data)}"
    for name, _ in present:
        assert isinstance(data[name], float), f"{name} is {data[name]!r}, no real number"
        assert data[name] > 0
    return {term: data[name] / factor[term[1]] for name, term in present}


def _roots(recovered: Recovered) -> Recovered:
    return {key: math.sqrt(value) for key, value in recovered.items()}


def _kalibr(path: Path) -> Recovered:
    data = _yaml(path)
    assert set(data) <= {*_KALIBR.split(), "rostopic", "update_rate"}
    assert data["update_rate"] == _RATE_HZ
    assert data["rostopic"] == "/imu/data"
    return _four(data, _KALIBR)


def _openvins(path: Path) -> Recovered:
    storage = opencv(path)
    imu = _opencv_map(storage, "imu0")
    assert imu["model"].string() == "kalibr"
    assert imu["rostopic"].string() == "/imu/data"
    assert _opencv_real(imu["update_rate"]) == _RATE_HZ
    assert _opencv_real(imu["time_offset"]) == 0
    for key, size in {"T_i_b": 4, "Tw": 3, "R_IMUtoGYRO": 3, "Ta": 3, "R_IMUtoACC": 3, "Tg": 3}.items():
        node = imu[key]
        rows = [
            [_opencv_real(node.at(i).at(j)) for j in range(node.at(i).size())] for i in range(node.size())
        ]
        np.testing.assert_array_equal(rows, np.zeros((3, 3)) if key == "Tg" else np.eye(size))
    return _four(_opencv_reals(path, "imu0"), _KALIBR)


def _vins(path: Path) -> Recovered:
    data = _opencv_reals(path)
    assert data["g_norm"] == G0
    return _four(data, "acc_n acc_w gyr_n gyr_w", math.sqrt(2 * _RATE_HZ), math.sqrt(_RATE_HZ))


def _orbslam3(path: Path) -> Recovered:
    data = _opencv_reals(path)
    assert data["IMU.Frequency"] == _RATE_HZ
    return _four(data, "IMU.NoiseAcc IMU.AccWalk IMU.NoiseGyro IMU.GyroWalk")


def _okvis2(path: Path) -> Recovered:
    data = _opencv_reals(path, "imu_parameters")
    assert data["g"] == G0
    return _four(data, "sigma_a_c sigma_aw_c sigma_g_c sigma_gw_c")


def _kimera(path: Path) -> Recovered:
    """Read like Kimera-VIO, which refuses any pose other than the identity."""
    storage = opencv(path)
    found = _opencv_map(storage)
    assert found["imu_preintegration_type"].isInt()
    pose = found["T_BS"].getNode("data")
    np.testing.assert_array_equal([pose.at(i).real() for i in range(16)], np.eye(4).ravel())
    gravity = found["n_gravity"]
    assert [gravity.at(i).real() for i in range(gravity.size())] == [0, 0, -G0]
    data = _opencv_reals(path)
    assert data["rate_hz"] == _RATE_HZ
    assert data["imu_integration_sigma"] > 0
    return _four(data, _KALIBR)


def _msckf_vio(path: Path) -> Recovered:
    return _four(_yaml(path)["noise"], "acc acc_bias gyro gyro_bias")


def _svo_pro(path: Path) -> Recovered:
    data = _yaml(path)["imu_params"]
    assert (data["imu_rate"], data["g"]) == (_RATE_HZ, G0)
    return _four(data, "sigma_acc_c sigma_acc_bias_c sigma_omega_c sigma_omega_bias_c")


def _info(text: str) -> dict[str, Any]:
    """Parse Boost's INFO format: a key and a value per line, braces for sections, comments from ``;``."""
    root: dict[str, Any] = {}
    stack, last = [root], ""
    for line in text.splitlines():
        words = line.partition(";")[0].split()
        if words == ["{"]:
            stack[-1][last] = {}
            stack.append(stack[-1][last])
        elif words == ["}"]:
            stack.pop()
        elif words:
            last, *value = words
            assert len(value) <= 1
            stack[-1][last] = float(value[0]) if value else {}
    assert stack == [root]
    return root


def _rovio(path: Path) -> Recovered:
    noise = _info(path.read_text(encoding="utf-8"))["Prediction"]["PredictionNoise"]
    keys = {"vel": ("accel", "N"), "acb": ("accel", "K"), "att": ("gyro", "N"), "gyb": ("gyro", "K")}
    return {
        (f"{keys[name][0]}_{'xyz'[int(i)]}", keys[name][1]): math.sqrt(value)
        for (name, _, i), value in ((key.partition("_"), value) for key, value in noise.items())
    }


def _basalt(path: Path) -> Recovered:
    data = _json(path)["value0"]
    assert data["imu_update_rate"] == _RATE_HZ
    keys = ("accel_noise_std", "accel_bias_std", "gyro_noise_std", "gyro_bias_std")
    return {
        (f"{sensor}_{axis}", symbol): value
        for key, (sensor, symbol) in zip(keys, _FOUR, strict=True)
        for axis, value in zip("xyz", data.get(key, ()), strict=False)
    }


def _gtsam(path: Path) -> Recovered:
    """Run the module with fakes of GTSAM that record the setters of versions 4.2 and 4.3."""
    source = path.read_text(encoding="utf-8")
    ast.parse(source)
    called = _gtsam_setters(source, old=True)
    np.testing.assert_array_equal(called.pop("setBiasAccOmegaInit"), np.zeros((6, 6)))
    newer = _gtsam_setters(source, old=False)
    assert newer.keys() == called.keys()
    for value in called.values():
        np.testing.assert_array_equal(value, value[0, 0] * np.eye(3))
    assert called["setIntegrationCovariance"][0, 0] == 1e-8
    values = {name: float(value[0, 0]) for name, value in called.items()}
    keys = "setAccelerometerCovariance setBiasAccCovariance setGyroscopeCovariance setBiasOmegaCovariance"
    return _roots(_four(values, keys))


def _gtsam_setters(source: str, *, old: bool) -> dict[str, Any]:
    called: dict[str, Any] = {}
    names = {"AccelerometerCovariance", "BiasAccCovariance", "GyroscopeCovariance", "BiasOmegaCovariance"}
    names |= {"IntegrationCovariance", *(("BiasAccOmegaInit",) if old else ())}

    def recorder(name: str) -> Callable[[object, Any], None]:
        return lambda _, value: called.__setitem__(name, value)

    params: Any = type("Params", (), {f"set{name}": recorder(f"set{name}") for name in names})
    params.MakeSharedU = staticmethod(lambda gravity: params() if gravity == G0 else None)
    module = types.ModuleType("gtsam")
    module.PreintegrationCombinedParams = params  # type: ignore[attr-defined]
    space: dict[str, Any] = {"gtsam": module}
    exec(compile(source.replace("import gtsam\n", ""), "<export>", "exec"), space)  # noqa: S102 - under test
    space["imu_params"]()
    return called


def _lio_sam(path: Path) -> Recovered:
    data = _yaml(path)["lio_sam"]
    assert data["imuGravity"] == G0
    return _four(data, "imuAccNoise imuAccBiasN imuGyrNoise imuGyrBiasN")


def _fast_lio(path: Path) -> Recovered:
    return _fast(_yaml(path)["mapping"])


def _fast_livo2(path: Path) -> Recovered:
    return _fast(_yaml(path)["imu"])


def _fast(data: dict[str, float]) -> Recovered:
    return _roots(_four(data, "acc_cov b_acc_cov gyr_cov b_gyr_cov", _RATE_HZ, _RATE_HZ))


def _point_lio(path: Path) -> Recovered:
    data = _yaml(path)["mapping"]
    assert data["imu_time_inte"] == 1 / _RATE_HZ
    for measured, put_in in (("imu_meas_acc_cov", "acc_cov_input"), ("imu_meas_omg_cov", "gyr_cov_input")):
        assert data.get(measured) == data.get(put_in)
    return _roots(_four(data, "acc_cov_input b_acc_cov gyr_cov_input b_gyr_cov", _RATE_HZ, _RATE_HZ))


def _glim(path: Path) -> Recovered:
    """Use one number for the walk of both sensors, the larger one."""
    data = _json(path)["sensors"]
    names = {"imu_acc_noise": "accel", "imu_gyro_noise": "gyro"}
    recovered = {(short, "N"): data[name] for name, short in names.items() if name in data}
    larger = "accel" if "imu_acc_noise" in data else "gyro"
    return {**recovered, (larger, "K"): data["imu_bias_noise"] / math.sqrt(0.1)}


def _dlio(path: Path) -> Recovered:
    """Read the comment: there is no key for noise, only the error of the average of 3 s."""
    if not _yaml(path)["dlio"]:
        return {}
    bias = _yaml(path)["dlio"]["imu"]["intrinsics"]["gyro"]["bias"]
    assert len(bias) == 3
    known = re.search(r"N/sqrt\(3 s\) = (.*) rad/s", path.read_text(encoding="utf-8"))
    assert known is not None
    return {
        (f"gyro_{axis}", "N~"): float(value) * math.sqrt(3)
        for axis, value in zip("xyz", known[1].split(", "), strict=True)
    }


def _ros(path: Path) -> Recovered:
    """Use the rate next to each covariance, which is that of the samples."""
    data, recovered = _yaml(path), {}
    for key, sensor in (("angular_velocity", "gyro"), ("linear_acceleration", "accel")):
        if f"{key}_covariance" not in data:
            continue
        rate = re.search(rf"{key}_covariance: .*# samples at (\S+) Hz", path.read_text(encoding="utf-8"))
        assert rate is not None
        covariance = np.array(data[f"{key}_covariance"]).reshape(3, 3)
        np.testing.assert_array_equal(covariance, np.diag(np.diag(covariance)))
        for axis, variance in zip("xyz", np.diag(covariance), strict=True):
            recovered[f"{sensor}_{axis}", "N"] = math.sqrt(variance / float(rate[1]))
    return recovered


def _autoware(path: Path) -> Recovered:
    """Use one number for the accelerometer, and one per axis of the gyroscope."""
    data, root = _yaml(path)["/**"]["ros__parameters"], math.sqrt(_RATE_HZ)
    stddev = {axis: data.get(f"angular_velocity_stddev_{axis}{axis}") for axis in "xyz"}
    recovered = {(f"gyro_{axis}", "N"): value / root for axis, value in stddev.items() if value}
    assert all(isinstance(value, float) for value in data.values())
    assert len([name for name in data if name.startswith("angular_velocity_offset_")]) == len(recovered)
    if "acceleration_stddev" in data:
        recovered["accel", "N"] = data["acceleration_stddev"] / root
    return recovered


def _fusioncore(path: Path) -> Recovered:
    """Take the roots of the variances of the biases, which are added once per sample."""
    data = dict(_yaml(path)["fusioncore"]["ros__parameters"])
    data |= {name: math.sqrt(value) for name, value in data.items() if name.startswith("ukf.q_")}
    keys = "imu.accel_noise ukf.q_accel_bias imu.gyro_noise ukf.q_gyro_bias"
    return _four(data, keys, math.sqrt(_RATE_HZ), 1 / math.sqrt(_RATE_HZ))


def qgroundcontrol(text: str) -> dict[str, float]:
    """Parse like QGroundControl: five tab-separated fields, 9 is a float; other lines are skipped."""
    values = {}
    for line in text.splitlines():
        fields = line.split("\t")
        if line.startswith("#") or len(fields) != 5:
            continue
        vehicle, component, name, value, kind = fields
        assert (vehicle, component, kind) == ("1", "1", "9")
        assert re.fullmatch(r"\d+\.\d+", value)
        values[name] = float(value)
    return values


def _name_value(text: str) -> dict[str, float]:
    """Parse like pymavlink and MAVProxy: a name and a value; other lines are skipped."""
    rows = (line.partition("#")[0].split() for line in text.splitlines())
    return {row[0]: float(row[1]) for row in rows if len(row) == 2}


def _px4(path: Path) -> Recovered:
    text = path.read_text(encoding="utf-8")
    values, period = qgroundcontrol(text), math.sqrt(0.01)
    assert _name_value(text) == values
    return _four(values, "EKF2_ACC_NOISE EKF2_ACC_B_NOISE EKF2_GYR_NOISE EKF2_GYR_B_NOISE", *[1 / period] * 2)


def _ardupilot(path: Path) -> Recovered:
    values, period = _name_value(path.read_text(encoding="utf-8")), math.sqrt(0.012)
    return _four(values, "EK3_ACC_P_NSE EK3_ABIAS_P_NSE EK3_GYRO_P_NSE EK3_GBIAS_P_NSE", *[1 / period] * 2)


def _gazebo(path: Path) -> Recovered:
    sensor = ET.parse(path).getroot().find("./model/link/sensor")  # noqa: S314 - our own file
    assert sensor is not None
    assert sensor.findtext("update_rate") == "200.0"
    recovered = {}
    for element, short in (("angular_velocity", "gyro"), ("linear_acceleration", "accel")):
        for axis in sensor.findall(f"./imu/{element}/*"):
            noise = axis.find("noise")
            assert noise is not None
            assert noise.get("type") == "gaussian"
            value = {child.tag: float(child.text or "nan") for child in noise}
            assert value["mean"] == value["bias_mean"] == value["bias_stddev"] == 0
            recovered[f"{short}_{axis.tag}", "N"] = value["stddev"] / math.sqrt(_RATE_HZ)
            recovered[f"{short}_{axis.tag}", "K"] = value["dynamic_bias_stddev"]
            recovered[f"{short}_{axis.tag}", "T"] = value["dynamic_bias_correlation_time"]
    return recovered


def _airsim(path: Path) -> Recovered:
    """Convert like AirSim: deg/sqrt(h) and mg become SI; the bias walks with stability/sqrt(tau)."""
    data: dict[str, float] = _json(path)["DefaultSensors"]["Imu"]
    recovered: Recovered = {}
    assert (data["SensorType"], data["Enabled"]) == (2, True)
    if "AngularRandomWalk" in data:
        walk = data["GyroBiasStability"] / 3600 * _DEGREE / math.sqrt(data["GyroBiasStabilityTau"])
        recovered |= {("gyro", "N"): data["AngularRandomWalk"] / 60 * _DEGREE, ("gyro", "K"): walk}
    if "VelocityRandomWalk" in data:
        walk = data["AccelBiasStability"] * 1e-6 * G0 / math.sqrt(data["AccelBiasStabilityTau"])
        recovered |= {("accel", "N"): data["VelocityRandomWalk"] * G0 / 1e3, ("accel", "K"): walk}
    return recovered


def _carla(path: Path) -> Recovered:
    data = _json(path)["sensor.other.imu"]
    tick = data.pop("sensor_tick")
    assert tick == 1 / _RATE_HZ
    return {
        (f"{sensor}_{axis}", "N"): value * math.sqrt(tick)
        for (_, sensor, _, axis), value in ((key.split("_"), value) for key, value in data.items())
    }


def _isaac_sim(path: Path) -> Recovered:
    """Run the module, whose dictionary is the input of Pegasus' IMU."""
    space: dict[str, Any] = {}
    exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), space)  # noqa: S102 - the file under test
    config, recovered = space["imu_config"], {}
    assert config.pop("update_rate") == _RATE_HZ
    for name, values in config.items():
        assert values["bias_correlation_time"] == 3600
        recovered[_SHORT[name], "N"] = values["noise_density"]
        recovered[_SHORT[name], "K"] = values["random_walk"]
    return recovered


def _isaac_ros(path: Path) -> Recovered:
    data = _yaml(path)["/**"]["ros__parameters"]
    assert data["calibration_frequency"] == _RATE_HZ
    return _four(data, "accel_noise_density accel_random_walk gyro_noise_density gyro_random_walk")


def _euroc(path: Path) -> Recovered:
    data = _yaml(path)
    assert data["sensor_type"] == "imu"
    assert data["rate_hz"] == _RATE_HZ
    assert data["T_BS"] == {"cols": 4, "rows": 4, "data": np.eye(4).ravel().tolist()}
    return _four(data, _KALIBR)


def _kf_gins(path: Path) -> Recovered:
    """Undo the data-sheet units; K follows from the steady state of a walk, sigma = K sqrt(T/2)."""
    data, recovered = _yaml(path)["imunoise"], {}
    walk = math.sqrt(data["corrtime"] * 3600 / 2)
    units = {
        "arw": ("gyro", "N", _DEGREE / 60),
        "vrw": ("accel", "N", 1 / 60),
        "gbstd": ("gyro", "K", _DEGREE / 3600 / walk),
        "abstd": ("accel", "K", 1e-5 / walk),
    }
    for key, (sensor, symbol, factor) in units.items():
        for axis, value in zip("xyz", data.get(key, ()), strict=False):
            recovered[f"{sensor}_{axis}", symbol] = value * factor
    return recovered


def _matlab_pairs(path: Path, function: str) -> dict[str, list[float]]:
    """Return the name-value pairs of a call, without comments and continuations."""
    text = re.sub(r"%.*", "", path.read_text(encoding="utf-8")).replace("...\n", " ")
    call = re.search(rf"\w+ = {function}\((.*?)\);", text)
    if call is None:
        return {}
    pairs = re.findall(r"'(\w+)',\s*(?:diag\()?\[([^\]]*)\]", call[1])
    return {name: [float(value) for value in values.split(",")] for name, values in pairs}


def _matlab(path: Path) -> Recovered:
    recovered = {}
    for name in ("gyro", "accel"):
        pairs = _matlab_pairs(path, f"{name}params")
        for key, symbol in (("NoiseDensity", "N"), ("BiasInstability", "B"), ("RandomWalk", "K")):
            for axis, value in zip("xyz", pairs.get(key, ()), strict=False):
                recovered[f"{name}_{axis}", symbol] = value
    assert "'SampleRate', 200.0" in path.read_text(encoding="utf-8")
    return recovered


def _factor_imu(path: Path) -> Recovered:
    pairs, recovered = _matlab_pairs(path, "factorIMUParameters"), {}
    for name, short in (("Gyroscope", "gyro"), ("Accelerometer", "accel")):
        for key, symbol in ((f"{name}Noise", "N"), (f"{name}BiasNoise", "K")):
            for axis, value in zip("xyz", pairs.get(key, ()), strict=False):
                recovered[f"{short}_{axis}", symbol] = math.sqrt(value)
    assert "'SampleRate', 200.0" in path.read_text(encoding="utf-8")
    return recovered


def _state_space(path: Path) -> Recovered:
    recovered = {}
    for name, axis in _yaml(path)["axes"].items():
        recovered[name, "N"] = axis["white"] / math.sqrt(axis["rate_hz"])
        walk = next(state for state in axis["states"] if state["term"] == "K")
        assert walk["phi"] == 1
        recovered[name, "K"] = walk["q"] * math.sqrt(axis["rate_hz"])
    return recovered


def _generic(path: Path) -> Recovered:
    """Read values, bounds, and the discrete numbers at the sensor's own rate."""
    recovered = {}
    for sensor, block in _yaml(path)["imu"].items():
        rate = block["rate_hz"]
        for name in [axis for axis in "xyz" if axis in block]:
            axis = block[name]
            for symbol in ("N", "B", "K"):
                term = axis[symbol]
                recovered[f"{_SHORT[sensor]}_{name}", symbol] = term.get("value", term.get("upper_bound"))
            white, walk = (recovered[f"{_SHORT[sensor]}_{name}", symbol] for symbol in "NK")
            np.testing.assert_allclose(axis["white_noise_per_sample"], white * math.sqrt(rate), rtol=1e-7)
            np.testing.assert_allclose(axis["bias_step_per_sample"], walk / math.sqrt(rate), rtol=1e-7)
    return recovered


#: Name of a format -> its parser.
READERS: dict[str, Callable[[Path], Recovered]] = {
    "kalibr": _kalibr,
    "openvins": _openvins,
    "vins": _vins,
    "orbslam3": _orbslam3,
    "okvis2": _okvis2,
    "kimera-vio": _kimera,
    "msckf-vio": _msckf_vio,
    "svo-pro": _svo_pro,
    "rovio": _rovio,
    "basalt": _basalt,
    "gtsam": _gtsam,
    "lio-sam": _lio_sam,
    "fast-lio": _fast_lio,
    "fast-livo2": _fast_livo2,
    "point-lio": _point_lio,
    "glim": _glim,
    "dlio": _dlio,
    "ros": _ros,
    "autoware": _autoware,
    "fusioncore": _fusioncore,
    "px4": _px4,
    "ardupilot": _ardupilot,
    "gazebo": _gazebo,
    "airsim": _airsim,
    "carla": _carla,
    "isaac-sim": _isaac_sim,
    "isaac-ros": _isaac_ros,
    "euroc": _euroc,
    "kf-gins": _kf_gins,
    "matlab": _matlab,
    "factor-imu": _factor_imu,
    "gm": _state_space,
    "yaml": _generic,
}
