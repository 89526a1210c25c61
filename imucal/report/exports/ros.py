"""ROS ``sensor_msgs/Imu``: the covariance fields of a driver's messages.

Discrete variances per sample on the diagonal, row-major about x, y, z. All zero would mean
"unknown", and -1 as the first element "no estimate".
Source: ``sensor_msgs/msg/Imu.msg``.
"""

import numpy as np

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Number, Numbers
from imucal.report.exports.target import Body, Target, comment, vector


def _body(numbers: Numbers) -> Body:
    gyro = numbers.each(Sensor.GYROSCOPE, "N")
    accel = numbers.each(Sensor.ACCELEROMETER, "N")
    lines = [
        *comment(number.note for number in (*gyro, *accel) if number.bounded),
        f"angular_velocity_covariance: {_covariance(gyro, numbers.rate_hz(Sensor.GYROSCOPE))}",
        f"linear_acceleration_covariance: {_covariance(accel, numbers.rate_hz(Sensor.ACCELEROMETER))}",
    ]
    return (*gyro, *accel), lines


def _covariance(white: tuple[Number, Number, Number], rate_hz: float) -> str:
    diagonal = [number.value**2 * rate_hz for number in white]
    return vector(np.diag(diagonal).ravel().tolist())


TARGET = Target(
    name="ros",
    title="ROS sensor_msgs/Imu covariances",
    file_name="ros_imu_covariance.yaml",
    heading="ROS sensor_msgs/Imu covariances",
    kind="discrete variances per sample, SI, right for the rate f above only",
    formulas=("diagonal = N^2 * f of each axis (a variance: an inflation enters squared)",),
    body=_body,
    carries="N",
    per_axis=True,
    aliases=("ros2", "sensormsgs"),
)
