"""LIO-SAM: the IMU part of ``params.yaml``.

Continuous densities: they are squared and handed to GTSAM's preintegration.
Source: LIO-SAM, ``config/params.yaml``, ``src/imuPreintegration.cpp``.
"""

from imucal.report.exports.config_numbers import Numbers
from imucal.report.exports.target import Body, Target, real
from imucal.units import G0


def _body(numbers: Numbers) -> Body:
    values = numbers.densities()
    lines = [
        "lio_sam:",
        f"  imuAccNoise: {real(values.accel_n.value)}  # m/s^2/sqrt(Hz); {values.accel_n.note}",
        f"  imuGyrNoise: {real(values.gyro_n.value)}  # rad/s/sqrt(Hz); {values.gyro_n.note}",
        f"  imuAccBiasN: {real(values.accel_k.value)}  # m/s^3/sqrt(Hz); {values.accel_k.note}",
        f"  imuGyrBiasN: {real(values.gyro_k.value)}  # rad/s^2/sqrt(Hz); {values.gyro_k.note}",
        f"  imuGravity: {real(G0)}  # m/s^2, standard gravity; set that of your place",
    ]
    return values, lines


TARGET = Target(
    name="lio-sam",
    title="LIO-SAM params.yaml (IMU part)",
    file_name="lio_sam_imu.yaml",
    heading="LIO-SAM params.yaml, its IMU part",
    kind="continuous-time densities, SI; GTSAM makes them discrete with the stamps",
    formulas=("Noise = N, BiasN = K; no factor of the rate",),
    body=_body,
    notes=("ROS 2: put the five keys under '/**: ros__parameters:' in place of 'lio_sam:'",),
)
