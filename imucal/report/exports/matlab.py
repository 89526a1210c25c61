"""MATLAB ``gyroparams`` and ``accelparams`` (Navigation Toolbox), as a script that makes an ``imuSensor``.

Continuous, two-sided densities (``NoiseType`` ``'double-sided'``, the default where it exists).
``Resolution`` is left out: a log at rest doesn't show it reliably; take it from the data sheet.
Source: MathWorks documentation, gyroparams, accelparams, imuSensor.
"""

from collections.abc import Sequence

from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Number, Numbers
from imucal.report.exports.target import Body, Target, comment, real, vector

_KEYS = {"NoiseDensity": "N", "BiasInstability": "B", "RandomWalk": "K"}


def _body(numbers: Numbers) -> Body:
    gyro = {key: numbers.each(Sensor.GYROSCOPE, symbol) for key, symbol in _KEYS.items()}
    accel = {key: numbers.each(Sensor.ACCELEROMETER, symbol) for key, symbol in _KEYS.items()}
    used = [number for group in (*gyro.values(), *accel.values()) for number in group]
    lines = [
        *comment((number.note for number in used if number.bounded), "%"),
        *_params("gyro", "gyroparams", gyro),
        *_params("accel", "accelparams", accel),
        f"imu = imuSensor('accel-gyro', 'SampleRate', {real(numbers.rate_hz(Sensor.GYROSCOPE))}, ...",
        "    'Gyroscope', gyro, 'Accelerometer', accel);",
    ]
    return used, lines


def _layout(head: Sequence[str], body: Sequence[str]) -> str:
    return "\n".join([*comment(head, "%"), *body]) + "\n"


def _params(name: str, function: str, groups: dict[str, tuple[Number, Number, Number]]) -> list[str]:
    pairs = [f"    '{key}', {vector(number.value for number in group)}" for key, group in groups.items()]
    return [f"{name} = {function}( ...", ", ...\n".join(pairs) + ");"]


TARGET = Target(
    name="matlab",
    title="MATLAB gyroparams / accelparams",
    file_name="imu_params.m",
    heading="MATLAB imuSensor",
    kind="continuous-time, two-sided densities, SI",
    formulas=("NoiseDensity = N, BiasInstability = B, RandomWalk = K; no factor of the rate",),
    body=_body,
    notes=("B is the flicker coefficient, not the minimum of the curve (which is 0.664 B)",),
    layout=_layout,
    carries="N B K",
    per_axis=True,
    aliases=("gyroparams", "accelparams", "imusensor"),
)
