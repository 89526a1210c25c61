"""ROS ``sensor_msgs/Imu``: the covariance fields of a driver's messages.

Discrete variances per sample on the diagonal, row-major about x, y, z. All zero would mean
"unknown", and -1 as the first element "no estimate". A sample's variance belongs to the rate of the
sensor that it is of, which is written beside it. Nav2 and robot_localization read these fields.
"""

import numpy as np

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Number, Numbers
from imucal.report.exports.target import Body, Target, comment, vector

_FIELDS = {Sensor.GYROSCOPE: "angular_velocity", Sensor.ACCELEROMETER: "linear_acceleration"}


def _body(numbers: Numbers) -> Body:
    used: list[Number] = []
    lines = []
    for sensor in numbers.sensors:
        white, rate_hz = numbers.each(sensor, "N"), numbers.rate_hz(sensor)
        used += white
        said = f"# samples at {rate_hz:.9g} Hz"
        lines.append(f"{_FIELDS[sensor]}_covariance: {_covariance(white, rate_hz)}  {said}")
    return used, [*comment(number.note for number in used), *lines]


def _covariance(white: tuple[Number, Number, Number], rate_hz: float) -> str:
    diagonal = [number.value**2 * rate_hz for number in white]
    return vector(np.diag(diagonal).ravel().tolist())


TARGETS = (
    Target(
        name="ros",
        title="ROS sensor_msgs/Imu covariances",
        file_name="ros_imu_covariance.yaml",
        source="source: sensor_msgs/msg/Imu.msg",
        kind="discrete variances per sample, SI, right for the rate beside each only",
        formulas=("diagonal = N^2 * f of each axis (a variance: an inflation enters squared)",),
        body=_body,
        carries="N",
        per_axis=True,
        own_rates=True,
        aliases=("ros2", "sensormsgs", "nav2", "robot-localization"),
    ),
)
