"""PX4 EKF2 parameters, as QGroundControl and ``param load`` read them.

Discrete at the filter's own period (10 ms), not at the IMU's. At rest the numbers are floors:
vibration dominates in flight. Source: PX4, ``src/modules/ekf2/EKF/covariance.cpp``
(``predictCovariance``), ``params_*.yaml``; the text format of QGroundControl's parameter files.
"""

import math

from imucal.report.exports.config_numbers import Number, Numbers
from imucal.report.exports.target import Body, Target, comment, decimal

#: Period of EKF2's prediction, in s (EKF2_PREDICT_US = 10000).
_PERIOD_S = 0.01

#: Parameter -> lowest and highest value that PX4 documents; ground stations warn outside.
_DOCUMENTED = {
    "EKF2_GYR_NOISE": (0.0001, 0.1),
    "EKF2_ACC_NOISE": (0.01, 1.0),
    "EKF2_GYR_B_NOISE": (0.0, 0.01),
    "EKF2_ACC_B_NOISE": (0.0, 0.01),
}

#: MAVLink's type of a 32-bit float.
_REAL32 = 9


def _body(numbers: Numbers) -> Body:
    found = numbers.densities()
    values = {
        "EKF2_GYR_NOISE": found.gyro_n,
        "EKF2_ACC_NOISE": found.accel_n,
        "EKF2_GYR_B_NOISE": found.gyro_k,
        "EKF2_ACC_B_NOISE": found.accel_k,
    }
    lines = comment(f"{name}: {number.note}" for name, number in values.items())
    lines += comment(_out_of_range(values))
    lines.append("#\n# Vehicle-Id Component-Id Name Value Type")
    lines += [
        f"1\t1\t{name}\t{decimal(_discrete(number))}\t{_REAL32}" for name, number in sorted(values.items())
    ]
    return found, lines


def _discrete(number: Number) -> float:
    return number.value / math.sqrt(_PERIOD_S)


def _out_of_range(values: dict[str, Number]) -> list[str]:
    """Say which numbers a ground station will warn of."""
    lines = []
    for name, number in values.items():
        low, high = _DOCUMENTED[name]
        if not low <= _discrete(number) <= high:
            lines.append(
                f"{name}: {_discrete(number):.3g} is outside the range PX4 documents, {low:g} to {high:g}"
            )
    return lines


TARGET = Target(
    name="px4",
    title="PX4 EKF2 parameters",
    file_name="px4_ekf2.params",
    heading="PX4 EKF2 parameters",
    kind=f"discrete at EKF2's own period dt = {_PERIOD_S:g} s, SI, whatever the rate of the IMU",
    formulas=("NOISE = N / sqrt(dt), B_NOISE = K / sqrt(dt)",),
    body=_body,
    notes=("numbers at rest are floors: in flight, vibration dominates; raise them to what the logs show",),
    aliases=("ekf2", "px4ekf2"),
)
