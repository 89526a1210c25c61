"""OpenVINS' ``kalibr_imu_chain.yaml``: Kalibr's numbers in an OpenCV file, with the IMU's intrinsics.

Source: OpenVINS, ``config/euroc_mav/kalibr_imu_chain.yaml``, ``ov_core/src/utils/opencv_yaml_parse.h``.
"""

import numpy as np

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Numbers
from imucal.report.exports.kalibr import FORMULA
from imucal.report.exports.target import Body, Target, matrix, opencv_yaml, plain, quoted, real


def _body(numbers: Numbers) -> Body:
    values = numbers.densities()
    accel_n, accel_k, gyro_n, gyro_k = values
    name, remark = numbers.topic()
    unit, zero = np.eye(3).tolist(), np.zeros((3, 3)).tolist()
    lines = [
        "imu0:",
        "  T_i_b:",
        *matrix(np.eye(4).tolist(), "    "),
        f"  accelerometer_noise_density: {real(accel_n.value)}  # m/s^2/sqrt(Hz); {accel_n.note}",
        f"  accelerometer_random_walk: {real(accel_k.value)}  # m/s^3/sqrt(Hz); {accel_k.note}",
        f"  gyroscope_noise_density: {real(gyro_n.value)}  # rad/s/sqrt(Hz); {gyro_n.note}",
        f"  gyroscope_random_walk: {real(gyro_k.value)}  # rad/s^2/sqrt(Hz); {gyro_k.note}",
        f"  rostopic: {quoted(name)}  # {plain(remark)}",
        "  time_offset: 0.0",
        f"  update_rate: {real(numbers.rate_hz(Sensor.GYROSCOPE))}  # Hz, of the gyroscope",
        '  model: "kalibr"',
    ]
    for key, rows in (("Tw", unit), ("R_IMUtoGYRO", unit), ("Ta", unit), ("R_IMUtoACC", unit), ("Tg", zero)):
        lines += [f"  {key}:", *matrix(rows, "    ")]
    return values, lines


TARGET = Target(
    name="openvins",
    title="OpenVINS kalibr_imu_chain.yaml",
    file_name="kalibr_imu_chain.yaml",
    heading="OpenVINS kalibr_imu_chain.yaml",
    kind="continuous-time densities, SI; OpenVINS makes them discrete with the stamps of the messages",
    formulas=(FORMULA,),
    body=_body,
    notes=("matrices: identity (no intrinsics are measured at rest); T_i_b, Tw, Ta, Tg are yours to set",),
    layout=opencv_yaml,
    aliases=("ovins", "msckf"),
)
