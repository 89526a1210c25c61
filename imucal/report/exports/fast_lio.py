"""FAST-LIO and FAST-LIO2: the covariances under ``mapping:``.

Discrete variances per sample: the filter multiplies them by dt² at each step.
Source: FAST-LIO, ``src/IMU_Processing.hpp`` (UndistortPcl), ``include/IKFoM_toolkit``.
"""

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Numbers
from imucal.report.exports.target import Body, Target, real


def _body(numbers: Numbers) -> Body:
    values = numbers.densities()
    accel, gyro = numbers.rate_hz(Sensor.ACCELEROMETER), numbers.rate_hz(Sensor.GYROSCOPE)
    lines = [
        "mapping:",
        f"  acc_cov: {real(values.accel_n.value**2 * accel)}  # (m/s^2)^2; {values.accel_n.note}",
        f"  gyr_cov: {real(values.gyro_n.value**2 * gyro)}  # (rad/s)^2; {values.gyro_n.note}",
        f"  b_acc_cov: {real(values.accel_k.value**2 * accel)}  # (m/s^3)^2; {values.accel_k.note}",
        f"  b_gyr_cov: {real(values.gyro_k.value**2 * gyro)}  # (rad/s^2)^2; {values.gyro_k.note}",
    ]
    return values, lines


TARGET = Target(
    name="fast-lio",
    title="FAST-LIO / FAST-LIO2 config (mapping covariances)",
    file_name="fast_lio_imu.yaml",
    heading="FAST-LIO / FAST-LIO2 config, its IMU part",
    kind="discrete variances per sample, SI, right for the rate f above only",
    formulas=("cov = N^2 * f, b_cov = K^2 * f (variances: an inflation enters squared)",),
    body=_body,
    aliases=("fastlio2",),
)
