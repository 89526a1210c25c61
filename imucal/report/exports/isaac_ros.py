"""Isaac ROS Visual SLAM: node parameters.

Continuous densities, with the rate they are made discrete with.
Source: Isaac ROS documentation, ``isaac_ros_visual_slam``, parameters.
"""

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Numbers
from imucal.report.exports.target import Body, Target, real


def _body(numbers: Numbers) -> Body:
    values = numbers.densities()
    rate = real(numbers.rate_hz(Sensor.GYROSCOPE))
    lines = [
        "/**:",
        "  ros__parameters:",
        f"    gyro_noise_density: {real(values.gyro_n.value)}  # rad/s/sqrt(Hz); {values.gyro_n.note}",
        f"    gyro_random_walk: {real(values.gyro_k.value)}  # rad/s^2/sqrt(Hz); {values.gyro_k.note}",
        f"    accel_noise_density: {real(values.accel_n.value)}  # m/s^2/sqrt(Hz); {values.accel_n.note}",
        f"    accel_random_walk: {real(values.accel_k.value)}  # m/s^3/sqrt(Hz); {values.accel_k.note}",
        f"    calibration_frequency: {rate}  # Hz, of the gyroscope",
    ]
    return values, lines


TARGET = Target(
    name="isaac-ros",
    title="Isaac ROS Visual SLAM parameters",
    file_name="isaac_ros_imu.yaml",
    heading="Isaac ROS Visual SLAM parameters, the IMU's",
    kind="continuous-time densities, SI; the node makes them discrete with calibration_frequency",
    formulas=("noise_density = N, random_walk = K; no factor of the rate",),
    body=_body,
    aliases=("isaac", "cuvslam"),
)
