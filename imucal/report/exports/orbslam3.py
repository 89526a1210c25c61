"""ORB-SLAM3: the IMU part of an OpenCV config.

Continuous densities. The code multiplies N by, and divides K by, the root of ``IMU.Frequency``, so
that a wrong frequency moves them in opposite directions.
Source: ORB-SLAM3, ``src/Tracking.cc`` (newParameterLoader), ``src/ImuTypes.cc``.
"""

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Numbers
from imucal.report.exports.target import Body, Target, opencv_yaml, real


def _body(numbers: Numbers) -> Body:
    values = numbers.densities()
    lines = [
        f"IMU.NoiseGyro: {real(values.gyro_n.value)}  # rad/s/sqrt(Hz); {values.gyro_n.note}",
        f"IMU.NoiseAcc: {real(values.accel_n.value)}  # m/s^2/sqrt(Hz); {values.accel_n.note}",
        f"IMU.GyroWalk: {real(values.gyro_k.value)}  # rad/s^2/sqrt(Hz); {values.gyro_k.note}",
        f"IMU.AccWalk: {real(values.accel_k.value)}  # m/s^3/sqrt(Hz); {values.accel_k.note}",
        f"IMU.Frequency: {real(numbers.rate_hz(Sensor.GYROSCOPE))}  # Hz, of the gyroscope",
    ]
    return values, lines


TARGET = Target(
    name="orbslam3",
    title="ORB-SLAM3 config (IMU part)",
    file_name="orbslam3_imu.yaml",
    heading="ORB-SLAM3 config, its IMU part",
    kind="continuous-time densities, SI; ORB-SLAM3 makes them discrete with IMU.Frequency",
    formulas=(
        "Noise = N, Walk = K; no factor of the rate",
        "IMU.Frequency must be the true rate: the code takes N * sqrt(f) and K / sqrt(f)",
    ),
    body=_body,
    layout=opencv_yaml,
    aliases=("orbslam",),
)
