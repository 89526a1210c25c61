"""Kalibr's text of a camera-IMU calibration with residuals of known truth.

Source of the layout: Kalibr, ``kalibr_imu_camera_calibration/IccUtil.py`` and
``kalibr_common/ConfigReader.py``.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from imucal.arrays import FloatArray

#: imu.yaml of the simulated calibration: key -> number, in SI.
GIVEN = {
    "accelerometer_noise_density": 1e-3,
    "accelerometer_random_walk": 1e-5,
    "gyroscope_noise_density": 1e-4,
    "gyroscope_random_walk": 1e-6,
}
RATE_HZ = 200.0


def residuals(factor: float, dimension: int, rng: np.random.Generator, outliers: int = 0) -> FloatArray:
    """Return 20 000 normalised residuals of errors that are `factor` times as large as the given noise."""
    errors = factor * rng.normal(size=(20_000, dimension))
    errors[:outliers] *= 50.0
    return np.asarray(np.linalg.norm(errors, axis=1))


def statistics(name: str, values: FloatArray) -> str:
    return f"{name} mean {np.mean(values)}, median {np.median(values)}, std: {np.std(values)}"


def results(
    gyro: Sequence[float] = (1.0,),
    *,
    accel: Sequence[float] = (1.0,),
    camera: float | None = 1.0,
    given: Sequence[Mapping[str, float]] = (GIVEN,),
    outliers: int = 0,
    seed: int = 60_300,
) -> str:
    """Return results-imucam.txt of one camera and as many IMUs as there are factors."""
    rng = np.random.default_rng(seed)
    corners = "no corners" if camera is None else statistics("", residuals(camera, 2, rng)).strip()
    lines = ["Calibration results", "===================", "Normalized Residuals", "-" * 28]
    lines.append(f"Reprojection error (cam0):     {corners}")
    for i, (of_gyro, of_accel) in enumerate(zip(gyro, accel, strict=True)):
        lines.append(statistics(f"Gyroscope error (imu{i}):       ", residuals(of_gyro, 3, rng, outliers)))
        lines.append(statistics(f"Accelerometer error (imu{i}):   ", residuals(of_accel, 3, rng)))
    lines += ["", "Residuals", "-" * 28, "Reprojection error (cam0) [px]:     mean 0.2, median 0.2, std: 0.1"]
    lines += ["Gyroscope error (imu0) [rad/s]:     mean 0.01, median 0.01, std: 0.01", ""]
    lines += [
        "Transformation (cam0):",
        "-" * 23,
        "T_ci:  (imu0 to cam0): ",
        "[[1. 0. 0. 0.]",
        " [0. 1. 0. 0.]",
    ]
    lines += ["", "IMU configuration", "=================", ""]
    for i, numbers in enumerate(given):
        lines += [f"IMU{i}:", " " + "-" * 28, "  Model: calibrated", f"  Update rate: {RATE_HZ}"]
        for sensor in ("accelerometer", "gyroscope"):
            density, walk = numbers[f"{sensor}_noise_density"], numbers[f"{sensor}_random_walk"]
            lines += [f"  {sensor.capitalize()}:", f"    Noise density: {density} "]
            lines += [f"    Noise density (discrete): {density * RATE_HZ**0.5} ", f"    Random walk: {walk}"]
        # The model scale-misalignment prints both sensors again.
        lines += ["  Gyroscope: ", "    M:", "      [[ 1.  0.  0.]", "  Accelerometer: ", "    M:"]
        lines += [
            "  T_ib (imu0 to imu0)",
            "    [[1. 0. 0. 0.]",
            "  time offset with respect to IMU0: 0.0 [s]",
            "",
        ]
    return "\n".join(lines) + "\n"
