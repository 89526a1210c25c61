"""VINS-Mono and VINS-Fusion: the IMU part of an OpenCV config.

Discrete standard deviations per sample. Their covariance propagation takes half of the white
variance twice (mid-point integration), so that the wanted value is ``N sqrt(2 f)``; the common
``N sqrt(f)`` is sqrt(2) low. The walk enters once, ``K sqrt(f)``.
Source: VINS-Mono, ``vins_estimator/src/factor/integration_base.h``.
"""

import math

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Numbers
from imucal.report.exports.target import Body, Target, opencv_yaml, real
from imucal.units import G0


def _body(numbers: Numbers) -> Body:
    values = numbers.densities()
    accel, gyro = numbers.rate_hz(Sensor.ACCELEROMETER), numbers.rate_hz(Sensor.GYROSCOPE)
    lines = [
        f"acc_n: {real(values.accel_n.value * math.sqrt(2 * accel))}  # m/s^2; {values.accel_n.note}",
        f"gyr_n: {real(values.gyro_n.value * math.sqrt(2 * gyro))}  # rad/s; {values.gyro_n.note}",
        f"acc_w: {real(values.accel_k.value * math.sqrt(accel))}  # m/s^3; {values.accel_k.note}",
        f"gyr_w: {real(values.gyro_k.value * math.sqrt(gyro))}  # rad/s^2; {values.gyro_k.note}",
        f"g_norm: {real(G0)}  # m/s^2, standard gravity; set that of your place",
    ]
    return values, lines


TARGET = Target(
    name="vins",
    title="VINS-Mono / VINS-Fusion config (IMU part)",
    file_name="vins_imu.yaml",
    heading="VINS-Mono / VINS-Fusion config, its IMU part",
    kind="discrete standard deviations per sample, SI, right for the rate f above only",
    formulas=(
        "acc_n, gyr_n = N * sqrt(2 f): VINS averages two samples but takes half of the variance twice",
        "acc_w, gyr_w = K * sqrt(f)",
    ),
    body=_body,
    layout=opencv_yaml,
    aliases=("vinsmono", "vinsfusion"),
)
