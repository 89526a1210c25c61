"""EuRoC (ASL dataset format): ``imu0/sensor.yaml``.

Source: Burri et al. (2016), "The EuRoC micro aerial vehicle datasets"; ``mav0/imu0/sensor.yaml``.
"""

import numpy as np

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Numbers
from imucal.report.exports.target import Body, Target, quoted, real, vector


def _body(numbers: Numbers) -> Body:
    values = numbers.densities()
    rows = np.eye(4).tolist()
    data = [f"  data: [{vector(rows[0])[1:-1]},"]
    data += [f"         {vector(row)[1:-1]}," for row in rows[1:-1]]
    data += [f"         {vector(rows[-1])[1:-1]}]"]
    lines = [
        "sensor_type: imu",
        f"comment: {quoted(numbers.report.source.path)}",
        "T_BS:  # identity: the body frame is the IMU's; set yours",
        "  cols: 4",
        "  rows: 4",
        *data,
        f"rate_hz: {real(numbers.rate_hz(Sensor.GYROSCOPE))}  # of the gyroscope",
        f"gyroscope_noise_density: {real(values.gyro_n.value)}  # rad/s/sqrt(Hz); {values.gyro_n.note}",
        f"gyroscope_random_walk: {real(values.gyro_k.value)}  # rad/s^2/sqrt(Hz); {values.gyro_k.note}",
        f"accelerometer_noise_density: {real(values.accel_n.value)}  # m/s^2/sqrt(Hz); {values.accel_n.note}",
        f"accelerometer_random_walk: {real(values.accel_k.value)}  # m/s^3/sqrt(Hz); {values.accel_k.note}",
    ]
    return values, lines


TARGET = Target(
    name="euroc",
    title="EuRoC (ASL dataset) sensor.yaml",
    file_name="euroc_sensor.yaml",
    heading="EuRoC (ASL dataset) sensor.yaml",
    kind="continuous-time densities, SI",
    formulas=("noise_density = N, random_walk = K (of the bias); no factor of the rate",),
    body=_body,
    aliases=("asl",),
)
