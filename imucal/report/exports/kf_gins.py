"""KF-GINS: the ``imunoise`` block, in data-sheet units.

The biases are first-order Gauss-Markov processes given by their steady state; one correlation time
serves both sensors. Source: KF-GINS, ``dataset/kf-gins.yaml``, ``src/kf-gins/gi_engine.cpp``.
"""

import math

from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Numbers, SlowNoise
from imucal.report.exports.target import Body, Target, comment, real, vector

#: m/s^2 in a mGal.
_MGAL = 1e-5
_HOUR = 3600.0


def _body(numbers: Numbers) -> Body:
    gyro, accel = numbers.each(Sensor.GYROSCOPE, "N"), numbers.each(Sensor.ACCELEROMETER, "N")
    gyro_slow = [numbers.slow(axis) for axis in numbers.triad(Sensor.GYROSCOPE)]
    accel_slow = [numbers.slow(axis) for axis in numbers.triad(Sensor.ACCELEROMETER)]
    slow = gyro_slow + accel_slow
    time = min(process.correlation_time for process in slow)
    arw = TERMS["N"].datasheet_unit(Sensor.GYROSCOPE).factor
    vrw = TERMS["N"].datasheet_unit(Sensor.ACCELEROMETER).factor
    deg_per_hour = TERMS["B"].datasheet_unit(Sensor.GYROSCOPE).factor
    used = [*gyro, *accel, *(process.number for process in slow if process.number)]
    notes = (number.note for number in (*gyro, *accel) if number.bounded)
    lines = [
        *comment([*notes, *(process.note for process in slow)]),
        "imunoise:",
        f"  arw: {vector(number.value * arw for number in gyro)}  # deg/sqrt(h)",
        f"  vrw: {vector(number.value * vrw for number in accel)}  # m/s/sqrt(h)",
        f"  gbstd: {vector(_steady(process, time) * deg_per_hour for process in gyro_slow)}  # deg/h",
        f"  abstd: {vector(_steady(process, time) / _MGAL for process in accel_slow)}  # mGal",
        "  # gsstd, asstd: scale factors aren't measured at rest; keep the lines of your own file",
        f"  corrtime: {real(time / _HOUR)}  # h",
    ]
    return used, lines


def _steady(process: SlowNoise, time: float) -> float:
    """Return the steady state at the common T: a term's own sigma; a walk keeps its driving noise."""
    return process.sigma if process.number is None else process.driving * math.sqrt(time / 2)


TARGET = Target(
    name="kf-gins",
    title="KF-GINS imunoise block",
    file_name="kf_gins_imunoise.yaml",
    heading="KF-GINS imunoise",
    kind="continuous-time, in data-sheet units; biases are first-order Gauss-Markov processes",
    formulas=(
        "arw, vrw = N",
        "gbstd, abstd = sigma of the Gauss-Markov term; of a random walk K: K * sqrt(T / 2)",
        "corrtime = the shortest T of all axes (one serves both sensors); 1 h where none was measured",
    ),
    body=_body,
    notes=("the order of the axes is the log's; KF-GINS wants forward, right, down",),
    carries="N K GM",
    per_axis=True,
)
