"""MATLAB (Navigation Toolbox): a script that makes an ``imuSensor``, and one of ``factorIMUParameters``.

``gyroparams`` and ``accelparams`` take continuous, two-sided densities (``NoiseType``
``'double-sided'``, the default where it exists). ``Resolution`` is left out: a log at rest doesn't
show it reliably; take it from the data sheet.

``factorIMUParameters`` takes the squares of continuous densities, though its documentation gives
them in (rad/s)² and (m/s²)²: the code divides the noise by the sample time, multiplies the bias's by
the duration, and rounds the sample rate.
"""

from functools import partial

from imucal.report.exports.config_numbers import Number, Numbers
from imucal.report.exports.target import (
    ACCEL,
    DENSITY_SQUARED,
    GYRO,
    Body,
    Key,
    Target,
    below_comment,
    comment,
    real,
    triads,
    vector,
)

_KEYS = {"NoiseDensity": "N", "BiasInstability": "B", "RandomWalk": "K"}


def _body(numbers: Numbers) -> Body:
    used: list[Number] = []
    lines, passed = [], []
    for sensor in numbers.sensors:
        groups = {key: numbers.each(sensor, symbol) for key, symbol in _KEYS.items()}
        used += [number for group in groups.values() for number in group]
        pairs = [f"    '{key}', {vector(n.value for n in group)}" for key, group in groups.items()]
        lines += [f"{sensor.short} = {sensor.short}params( ...", ", ...\n".join(pairs) + ");"]
        passed.append(f"'{str(sensor).capitalize()}', {sensor.short}")
    return used, [
        *comment((number.note for number in used), "%"),
        *lines,
        f"imu = imuSensor('accel-gyro', 'SampleRate', {real(numbers.stream_hz)}, ...",
        f"    {', '.join(passed)});",
    ]


_FACTOR_KEYS = (
    Key("GyroscopeNoise", GYRO, "N", DENSITY_SQUARED),
    Key("GyroscopeBiasNoise", GYRO, "K", DENSITY_SQUARED),
    Key("AccelerometerNoise", ACCEL, "N", DENSITY_SQUARED),
    Key("AccelerometerBiasNoise", ACCEL, "K", DENSITY_SQUARED),
)


def _factor_body(numbers: Numbers) -> Body:
    used, members = triads(numbers, _FACTOR_KEYS)
    pairs = [f"    'SampleRate', {real(numbers.stream_hz)}"]
    pairs += [f"    '{name}', diag({values})" for name, values in members]
    said = comment((number.note for number in used), "%")
    return used, [*said, "imuParameters = factorIMUParameters( ...", ", ...\n".join(pairs) + ");"]


_layout = partial(below_comment, sign="%")


TARGETS = (
    Target(
        name="matlab",
        title="MATLAB gyroparams / accelparams",
        file_name="imu_params.m",
        heading="MATLAB imuSensor",
        source="documentation: MathWorks, gyroparams, accelparams, imuSensor",
        kind="continuous-time, two-sided densities, SI",
        formulas=("NoiseDensity = N, BiasInstability = B, RandomWalk = K; no factor of the rate",),
        body=_body,
        notes=("B is the flicker coefficient, not the minimum of the curve (which is 0.664 B)",),
        layout=_layout,
        carries="N B K",
        per_axis=True,
        aliases=("gyroparams", "accelparams", "imusensor"),
    ),
    Target(
        name="factor-imu",
        title="MATLAB factorIMUParameters",
        file_name="factor_imu_parameters.m",
        source="source: cerescodegen imu_factor.cpp, as shipped with the toolbox; documentation",
        kind="continuous-time covariances (densities squared), SI, whatever unit the documentation gives",
        formulas=("Noise = N^2, BiasNoise = K^2 of each axis; the code divides Noise by the sample time",),
        body=_factor_body,
        per_axis=True,
        notes=("SampleRate must be 100 or more, and is rounded to a whole number by the code",),
        layout=_layout,
        aliases=("factorimuparameters",),
    ),
)
