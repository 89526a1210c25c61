"""Autopilots: PX4's EKF2 and ArduPilot's EK3, as parameter files.

Both take a standard deviation at the filter's own period dt, not at the IMU's: they square it, times
dt for an increment (N/sqrt(dt)), and the bias's times dt² (K/sqrt(dt)). At rest the numbers are
floors: vibration dominates in flight.
"""

from collections.abc import Callable, Iterable

from imucal.report.exports.config_numbers import Numbers
from imucal.report.exports.target import Entry, Key, KeyedBody, Target, at_period, comment, decimal, four

#: Period of EKF2's prediction, in s (EKF2_PREDICT_US = 10000).
_PX4_S = 0.01
#: Shortest period of EK3's prediction, in s (EKF_TARGET_DT).
_EK3_S = 0.012
#: MAVLink's type of a 32-bit float.
_REAL32 = 9

#: Parameter -> lowest and highest value that its autopilot documents; ground stations warn outside.
_DOCUMENTED = {
    "EKF2_GYR_NOISE": (0.0001, 0.1),
    "EKF2_ACC_NOISE": (0.01, 1.0),
    "EKF2_GYR_B_NOISE": (0.0, 0.01),
    "EKF2_ACC_B_NOISE": (0.0, 0.01),
    "EK3_GYRO_P_NSE": (0.0001, 0.1),
    "EK3_ACC_P_NSE": (0.01, 1.0),
    "EK3_GBIAS_P_NSE": (0.00001, 0.001),
    "EK3_ABIAS_P_NSE": (0.00001, 0.02),
}
_FLOORS = "numbers at rest are floors: in flight, vibration dominates; raise them to what the logs show"


def _body(keys: tuple[Key, ...], autopilot: str, rows: Callable[[list[Entry]], list[str]]) -> KeyedBody:
    """Return the body of a parameter file: where each number is from, what is out of range, the rows."""

    def text(_: Numbers, found: list[Entry]) -> list[str]:
        found = sorted(found)
        said = comment(f"{entry.name}: {entry.number.note}" for entry in found)
        return [*said, *comment(_out_of_range(found, autopilot)), *rows(found)]

    return KeyedBody(keys, text)


def _out_of_range(found: Iterable[Entry], autopilot: str) -> list[str]:
    """Say which numbers a ground station will warn of."""
    said = []
    for entry in found:
        low, high = _DOCUMENTED[entry.name]
        if not low <= entry.value <= high:
            said.append(
                f"{entry.name}: {entry.value:.3g} is outside the range {autopilot} documents, "
                f"{low:g} to {high:g}"
            )
    return said


def _name_value(found: Iterable[Entry]) -> list[str]:
    return [f"{entry.name} {decimal(entry.value)}" for entry in found]


def _px4_rows(found: list[Entry]) -> list[str]:
    """Return both tables: each reader passes over the lines of the other.

    QGroundControl wants five fields between tabs, the vehicle's own number first, and skips other
    lines; pymavlink and MAVProxy want a name and a value, and say "Invalid line" of the others.
    """
    return [
        "#",
        "# For QGroundControl (pymavlink passes over these lines)",
        "# Vehicle-Id Component-Id Name Value Type",
        *(f"1\t1\t{entry.name}\t{decimal(entry.value)}\t{_REAL32}" for entry in found),
        "#",
        "# The same for pymavlink and MAVProxy (QGroundControl passes over these lines)",
        *_name_value(found),
    ]


TARGETS = (
    Target(
        name="px4",
        title="PX4 EKF2 parameters",
        file_name="px4_ekf2.params",
        source="source: ekf2/EKF/covariance.cpp; QGroundControl, ParameterManager.cc; run: pymavlink",
        kind=f"discrete at EKF2's own period dt = {_PX4_S:g} s, SI, whatever the rate of the IMU",
        formulas=("NOISE = N / sqrt(dt), B_NOISE = K / sqrt(dt)",),
        body=_body(
            four("EKF2_ACC_NOISE EKF2_ACC_B_NOISE EKF2_GYR_NOISE EKF2_GYR_B_NOISE", at_period(_PX4_S)),
            "PX4",
            _px4_rows,
        ),
        notes=(_FLOORS,),
        aliases=("ekf2", "px4ekf2"),
    ),
    Target(
        name="ardupilot",
        title="ArduPilot EKF3 (EK3) parameters",
        file_name="ardupilot_ek3.parm",
        source="source: AP_NavEKF3_core.cpp (CovariancePrediction), AP_NavEKF3.cpp; run: pymavlink",
        kind=f"discrete at EK3's own period dt = {_EK3_S:g} s, SI, whatever the rate of the IMU",
        formulas=(
            "GYRO_P_NSE, ACC_P_NSE = N / sqrt(dt); GBIAS_P_NSE, ABIAS_P_NSE = K / sqrt(dt)",
            "dt is longer where the main loop is slower than 83 Hz (planes: 50 Hz, 0.02 s)",
        ),
        body=_body(
            four("EK3_ACC_P_NSE EK3_ABIAS_P_NSE EK3_GYRO_P_NSE EK3_GBIAS_P_NSE", at_period(_EK3_S)),
            "ArduPilot",
            _name_value,
        ),
        notes=(_FLOORS,),
        aliases=("ek3", "ekf3", "arducopter", "arduplane"),
    ),
)
