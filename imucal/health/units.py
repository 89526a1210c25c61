"""Rows about units and gravity."""

import math
from dataclasses import replace

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import ChoiceError, Fix
from imucal.evidence import FASTEST_AT_REST, gravity_unit, gyroscope_step_unit, is_gravity_per_sample
from imucal.findings import Finding
from imucal.health.axes import HOW_TO_TURN, Orders
from imucal.health.diagnosis import Question, Row, Values
from imucal.health.motion_evidence import (
    first_attitude,
    gravity_length_over_time,
    rate_over_time,
    turned_angles,
)
from imucal.health.stream import Stream
from imucal.health.turning import Turning
from imucal.recording import Sensor
from imucal.screening.faults import wrong_gyroscope_unit
from imucal.screening.values import (
    check_gravity_length,
    check_gyroscope_unit,
    check_swapped,
    shaken,
    unit_suspect,
)
from imucal.screening.windows import Profile
from imucal.units import G0

__all__ = [
    "UP",
    "accelerometer_unit_row",
    "check_expected",
    "gravity_length",
    "gravity_row",
    "gyroscope_unit_row",
    "has_gravity",
    "up_row",
]

#: Directions that `expect` accepts.
UP = tuple(f"{axis}-{direction}" for axis in "xyz" for direction in ("up", "down"))

#: Error of the gyroscope's scale that is a fault of its unit or its range.
_WRONG_SCALE = 0.2
#: The same, that is notable: uncalibrated sensors are within 3 %, and fast turns add 6 % in a BROAD log.
_NOTABLE_SCALE = 0.1
#: Fastest rotation that a gyroscope on sale measures, in rad/s: 4000 deg/s, with a margin.
_FASTEST = 75.0
#: Share of the samples that must be faster, so that spikes don't count.
_FAST_SHARE = 1e-3
#: Length, in shares of gravity, below which an accelerometer at rest shows none.
_NO_GRAVITY = 0.1
#: Largest robust deviation of that length, as a share of it: without gravity it follows the motion.
_STEADY = 0.2
#: Cosine of the largest angle between gravity and the axis that is up: 30°.
_ALONG = math.cos(math.radians(30.0))

_GYROSCOPE_UNIT = Question("gyroscope unit", "gyroscope-unit")
_RECORD_RESTS = "Record some rests of 2 s."
_WHOLE = "Log x, y and z of the sensor."


def gravity_length(stream: Stream) -> float | None:
    """Return the median length of the accelerometer's mean at quiet moments; None without three axes."""
    lengths = _lengths(stream)
    return float(np.median(lengths)) if lengths.size else None


def _lengths(stream: Stream) -> FloatArray:
    axes = stream.quiet(Sensor.ACCELEROMETER)
    if len(axes) != 3:
        return np.zeros(0)
    return np.asarray(np.linalg.norm([p.windows.mean for p in axes], axis=0))


def _in_one_attitude(stream: Stream) -> tuple[Profile, ...]:
    """Return the accelerometer's quiet windows in one attitude: the mean over several is not gravity."""
    axes, lengths = stream.quiet(Sensor.ACCELEROMETER), _lengths(stream)
    means = np.array([p.windows.mean for p in axes])
    usual = int(np.abs(lengths - np.median(lengths)).argmin())
    near = means[:, usual] @ means >= _ALONG * lengths[usual] * lengths
    return tuple(replace(p, windows=p.windows.take(near), disturbed=p.disturbed[near]) for p in axes)


def has_gravity(stream: Stream) -> bool:
    """Return whether the length at quiet moments is the same everywhere, or that of gravity."""
    lengths = _lengths(stream)
    middle = float(np.median(lengths))
    spread = 1.4826 * float(np.median(np.abs(lengths - middle)))
    rate = stream.of_sensor(Sensor.ACCELEROMETER)[0].series.rate_hz
    steady = spread < _STEADY * middle
    known = gravity_unit(middle) is not None or is_gravity_per_sample(middle, rate)
    return steady and (known or middle > _NO_GRAVITY * G0)


def accelerometer_unit_row(stream: Stream) -> Row:
    """Return the row of the accelerometer's unit."""
    question = Question("accelerometer unit", "accelerometer-unit")
    length = gravity_length(stream)
    if length is None:
        found = "the length of gravity needs all three axes of the accelerometer"
        return question.answer("unknown", found, _WHOLE)
    values: Values = {"length": length}
    axes = _in_one_attitude(stream)
    swapped = check_swapped((*axes, *stream.quiet(Sensor.GYROSCOPE)))
    if swapped:
        evidence = gravity_length_over_time(stream, swapped=True)
        return question.answer_by(swapped[0], "fail", values, evidence)
    if not has_gravity(stream):
        found = "the accelerometer shows no gravity, so its unit can't be told"
        return question.answer("unknown", found, _RECORD_RESTS, values=values)
    if shaken(axes) and gravity_unit(length) is None:
        found = f"the accelerometer is shaken, and |a| of {length:.3g} at quiet moments is gravity in no unit"
        return question.answer("unknown", found, _RECORD_RESTS, values=values)
    for finding in check_gravity_length(axes):
        return question.answer_by(finding, "fail", values, gravity_length_over_time(stream))
    found = f"at quiet moments |a| is {length:.4g} m/s^2, expected {G0:.1f}"
    return question.answer("pass", found, values=values)


def gyroscope_unit_row(stream: Stream, turning: Turning | None, orders: Orders | None) -> Row:
    """Return the row of the gyroscope's unit: by turns, by steps, or by impossible rates."""
    if turning is not None and orders is not None:
        return _unit_by_turns(turning, orders)
    axes = stream.of_sensor(Sensor.GYROSCOPE)
    alive = [p for p in axes if not p.constant]
    if not alive:
        found = "the gyroscope has no data"
        return _GYROSCOPE_UNIT.answer("unknown", found, _WHOLE)
    resting = stream.quiet(Sensor.GYROSCOPE) if len(stream.rests) else ()
    for finding in check_gyroscope_unit(resting):
        evidence = rate_over_time(stream, fastest=FASTEST_AT_REST, label="fastest at rest")
        return _GYROSCOPE_UNIT.answer_by(finding, "fail", {"scale": None}, evidence)
    steps = [p.lsb for p in alive]
    by_step = gyroscope_step_unit(steps)
    fastest = max(float(np.quantile(np.abs(p.series.samples), 1 - _FAST_SHARE)) for p in alive)
    in_degrees = ""
    if fastest > _FASTEST:
        in_degrees = f"it shows {fastest:.4g} rad/s, more than any gyroscope measures"
    elif by_step is not None and by_step[0] == "deg/s":
        in_degrees = f"its steps of {steps[0]:.5g} are a usual LSB in deg/s"
    if in_degrees:
        evidence = rate_over_time(stream, fastest=_FASTEST, label="fastest sensors")
        return _GYROSCOPE_UNIT.answer_by(_unit_finding(in_degrees), "fail", {"scale": None}, evidence)
    if by_step is not None:
        found = f"its steps of {steps[0]:.5g} rad/s are a usual LSB, {by_step[1]:.5g} deg/s"
        return _GYROSCOPE_UNIT.answer("pass", found, values={"scale": None})
    found = "no turn compares the gyroscope with gravity"
    return _GYROSCOPE_UNIT.answer("unknown", found, f"{HOW_TO_TURN}.")


def _unit_finding(reason: str) -> Finding:
    """Return the finding of `imucal.fit` for a gyroscope in deg/s."""
    text = f"The gyroscope may not be in rad/s: {reason}."
    return unit_suspect(Sensor.GYROSCOPE, text, "deg/s")


def _unit_by_turns(turning: Turning, orders: Orders) -> Row:
    row = _row_of_turns(orders)
    if row.status not in {"fail", "warn"}:
        return row
    return replace(row, evidence=turned_angles(turning, order=orders.best, shown=orders.well_explained))


def _row_of_turns(orders: Orders) -> Row:
    values: Values = {"scale": orders.scale, "finding": None}
    if orders.unit == "rad/s":
        return _scale_row(orders, values)
    factor = 1 / orders.scale
    finding = wrong_gyroscope_unit(factor, orders.unit)
    if orders.unit:
        return _GYROSCOPE_UNIT.answer_by(finding, "fail", values)
    if abs(orders.scale * math.pi / 180 - 1) < _WRONG_SCALE:
        advice = "Values in rad/s seem to have been read as deg/s: run again with --gyro-unit rad/s."
        fix = Fix("", "gyro_unit", "rad/s")
        return _GYROSCOPE_UNIT.answer_by(replace(finding, advice=advice, fix=fix), "fail", values)
    advice = (
        f"Give the gyroscope's scale when reading: --gyro-scale {orders.scale:.4g}, if these are raw counts."
    )
    fix = Fix("", "gyro_scale", f"{orders.scale:.4g}")
    return _GYROSCOPE_UNIT.answer_by(replace(finding, advice=advice, fix=fix), "fail", values)


def _scale_row(orders: Orders, values: Values) -> Row:
    low, high = orders.scale_range
    error = abs(orders.scale - 1)
    sure = 0.0 if low < 1 < high else min(abs(low - 1), abs(high - 1))
    found = f"gravity turns {orders.scale:.3f} times as fast as the gyroscope shows"
    advice = "Check the range of the gyroscope in the driver, or calibrate it."
    if error > _NOTABLE_SCALE and sure <= _NOTABLE_SCALE:
        found += f", {low:.2f} in one half and {high:.2f} in the other"
        return _GYROSCOPE_UNIT.answer("unknown", found, f"{HOW_TO_TURN}.", values=values)
    if error > _WRONG_SCALE:
        return _GYROSCOPE_UNIT.answer("fail", found, advice, values=values)
    if error > _NOTABLE_SCALE:
        return _GYROSCOPE_UNIT.answer("warn", found, advice, values=values)
    return _GYROSCOPE_UNIT.answer("pass", found, values=values)


def gravity_row(stream: Stream) -> Row:
    """Return the row of gravity in the samples."""
    question = Question("gravity", "no-gravity")
    length = gravity_length(stream)
    if length is None:
        found = "gravity needs all three axes of the accelerometer"
        return question.answer("unknown", found, _WHOLE)
    values: Values = {"length": length}
    if not has_gravity(stream):
        found = f"the accelerometer shows no gravity at quiet moments: |a| is {length:.2g} m/s^2"
        advice = "If a driver removes gravity, log the raw acceleration: a filter needs it."
        evidence = gravity_length_over_time(stream)
        return question.answer("fail", found, advice, values=values, evidence=evidence)
    unit = gravity_unit(length)
    if unit is None:
        found = f"|a| is {length:.3g} at quiet moments, which is gravity in no usual unit"
        return question.answer(
            "unknown",
            found,
            "Correct the unit first.",
            values=values,
        )
    found = f"gravity is in the samples: |a| is {length:.3g} {unit} at quiet moments"
    return question.answer("pass", found, values=values)


def check_expected(expect: str | None) -> None:
    """Raise a ChoiceError unless `expect` is None or one of `UP`."""
    if expect is not None and expect not in UP:
        fixes = [Fix(f"give {one}", "expect", one) for one in UP]
        raise ChoiceError(f"unknown direction {expect!r}", fixes=fixes)


def up_row(stream: Stream, expect: str | None) -> Row:
    """Return the row of the axis that points up at the first rest."""
    question = Question("axis that is up", "up")
    how = "Begin with a rest of 2 s in the usual attitude, and give --expect, such as z-up."
    direction = _first_direction(stream)
    if direction is None:
        found = "there is no quiet moment with gravity on three axes"
        return question.answer("unknown", found, how)
    axis = int(np.abs(direction).argmax())
    seen = f"{'xyz'[axis]}-{'up' if direction[axis] > 0 else 'down'}"
    angle = math.degrees(math.acos(min(1.0, float(np.abs(direction[axis])))))
    values: Values = {"up": seen, "angle_deg": angle}
    at_first = f"{seen} at the first rest, {angle:.0f}° off, if the specific force points up at rest (ROS)"
    if expect is None:
        found = f"{at_first}; a log alone can't tell whether this is right"
        return question.answer("unknown", found, how, values=values)
    if np.abs(direction[axis]) < _ALONG:
        found = f"no axis is within 30° of gravity at the first rest; the nearest is {seen}"
        return question.answer("unknown", found, how, values=values)
    if seen == expect:
        return question.answer("pass", at_first, values=values)
    found = f"{at_first}; expected {expect}"
    advice = "Check how the IMU is mounted, and the order and signs of the axes in the driver."
    if seen[0] == expect[0]:
        advice = "The accelerometer is inverted (it contains gravity, not f), or the IMU is upside down."
    evidence = first_attitude(stream, length=gravity_length(stream) or G0)
    return question.answer("fail", found, advice, values=values, evidence=evidence)


def _first_direction(stream: Stream) -> FloatArray | None:
    """Return the direction of the specific force at the first rest or quiet moment, shape (3,)."""
    axes, length = stream.quiet(Sensor.ACCELEROMETER), gravity_length(stream)
    if length is None or not length > 0 or gravity_unit(length) is None or not has_gravity(stream):
        return None
    time = axes[0].windows.time_s
    end = stream.rests[0, 1] if len(stream.rests) else time[0] + 2 * axes[0].windows.length_s
    first = time < end
    mean = np.array([p.windows.mean[first].mean() for p in axes])
    return np.asarray(mean / np.linalg.norm(mean))
