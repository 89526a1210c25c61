"""Kalibr's ``imu.yaml``.

Continuous densities; Kalibr divides by sqrt(dt) itself and refuses a value that is not positive.
Its ``*_random_walk`` is K, not the angle random walk.
Source: Kalibr, ``aslam_offline_calibration/kalibr/python/kalibr_common/ConfigReader.py``.
"""

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Numbers
from imucal.report.exports.target import Body, Target, plain, quoted, real

FORMULA = "noise_density = N (white noise), random_walk = K (of the bias); no factor of the rate"


def _body(numbers: Numbers) -> Body:
    values = numbers.densities()
    name, remark = numbers.topic()
    lines = [
        f"accelerometer_noise_density: {real(values.accel_n.value)}  # m/s^2/sqrt(Hz); {values.accel_n.note}",
        f"accelerometer_random_walk: {real(values.accel_k.value)}  # m/s^3/sqrt(Hz); {values.accel_k.note}",
        f"gyroscope_noise_density: {real(values.gyro_n.value)}  # rad/s/sqrt(Hz); {values.gyro_n.note}",
        f"gyroscope_random_walk: {real(values.gyro_k.value)}  # rad/s^2/sqrt(Hz); {values.gyro_k.note}",
        f"rostopic: {quoted(name)}  # {plain(remark)}",
        f"update_rate: {real(numbers.rate_hz(Sensor.GYROSCOPE))}  # Hz, of the gyroscope",
    ]
    return values, lines


TARGET = Target(
    name="kalibr",
    title="Kalibr imu.yaml",
    file_name="kalibr_imu.yaml",
    heading="Kalibr imu.yaml",
    kind="continuous-time densities, SI; Kalibr makes them discrete with update_rate",
    formulas=(FORMULA,),
    body=_body,
)
