"""Turns by an angle that the user knows, such as a full turn on a table, which gravity does not show."""

import math
import re
from dataclasses import dataclass

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.calibration.turn_data import TurnData, carried_directions, is_in_place
from imucal.errors import ArgumentError, DataError
from imucal.user_input import quantity

__all__ = ["KnownAngle", "known_angle", "known_of"]

#: Deviation in degrees with which a hand puts an IMU back against an edge, if the user does not give it.
_DEVIATION_DEG = 0.2
#: Smallest angle in degrees that is worth giving.
_SMALLEST_DEG = 30.0
#: Largest angle in degrees: a longer turn of 60 s is not used.
_LARGEST_DEG = 36000.0
#: Largest relative difference between a known angle and the one that the gyroscope measures.
_DIFFERENCE = 0.25
#: Scale from which samples are raw counts; no sensor in rad/s is wrong by so much.
_COUNTS = 5.0
#: Between an angle and its deviation.
_PLUS_MINUS = re.compile(r"\+-|\+/-|±")
_UNITS = {"": 1.0, "deg": 1.0, "°": 1.0}


@dataclass(frozen=True, kw_only=True)
class KnownAngle:
    """Angle of turns about the vertical, and its standard deviation, in rad."""

    angle: float
    deviation: float


def known_angle(text: str) -> KnownAngle:
    """Return the angle of a text such as ``360deg`` or ``360deg+-0.1deg``; otherwise raise an ArgumentError.

    The deviation is 0.2° by default.
    """
    angle_text, *others = _PLUS_MINUS.split(text)
    angle_deg = quantity(angle_text, _UNITS)
    deviation_deg = quantity(others[0], _UNITS) if others else _DEVIATION_DEG
    if angle_deg is None or deviation_deg is None or len(others) > 1:
        raise ArgumentError(f"{text!r} is not an angle; expected one such as 360deg or 360deg+-0.1deg")
    if not _SMALLEST_DEG <= angle_deg <= _LARGEST_DEG:
        raise ArgumentError(
            f"an angle of {angle_deg:g}° is outside {_SMALLEST_DEG:g}° to {_LARGEST_DEG:g}°; give the "
            "whole angle between two rests, such as 360deg"
        )
    if not 0 < deviation_deg < _DIFFERENCE * angle_deg:
        raise ArgumentError(
            f"{deviation_deg:g}° is no deviation of an angle of {angle_deg:g}°; expected more than 0 and at "
            f"most {_DIFFERENCE * angle_deg:g}°"
        )
    return KnownAngle(angle=math.radians(angle_deg), deviation=math.radians(deviation_deg))


def known_of(
    data: TurnData, start: FloatArray, known: KnownAngle, *, said_si: bool | None
) -> tuple[FloatArray, FloatArray]:
    """Return the signed known angle of each turn, shape (t,), NaN if it has none, and the start to use.

    A turn has the angle if it ends in the attitude in which it began, and if the gyroscope, with the start,
    measures the angle within a quarter. If no turn changes the attitude, the start of raw counts follows
    from the angle. `said_si` is whether the log is in rad/s, None if unknown. A DataError is raised if no
    turn has the angle.
    """
    in_place = is_in_place(data)
    if in_place.all() and said_si is not True:
        start = _scale_of_counts(data, known) * start
    measured = _about_vertical(data, start)
    known_turns = in_place & _near(np.abs(measured) / known.angle)
    if not known_turns.any():
        raise DataError(_none_found(data, measured, in_place, known))
    return np.where(known_turns, np.copysign(known.angle, measured), np.nan), start


def _scale_of_counts(data: TurnData, known: KnownAngle) -> float:
    """Return the scale with which most of the larger turns in place have the known angle, 1 for rad/s."""
    raw = np.abs(np.einsum("tni,ti->t", data.rates, data.before)) * data.tau0
    usual = float(np.median(raw[raw >= raw.max() / 2]))
    if usual == 0:
        return 1.0
    scale = known.angle / usual
    return scale if max(scale, 1 / scale) > _COUNTS else 1.0


def _near(ratio: FloatArray | float) -> BoolArray:
    return np.asarray(np.abs(np.asarray(ratio) - 1) < _DIFFERENCE)


def _about_vertical(data: TurnData, C: FloatArray) -> FloatArray:
    """Return the angle of each turn about the vertical, in rad, shape (t,); whole turns count."""
    up = carried_directions(data, C)
    return np.asarray(np.einsum("tni,tni->t", data.tau0 * data.rates @ C.T, up))


def _none_found(data: TurnData, measured: FloatArray, in_place: BoolArray, known: KnownAngle) -> str:
    angle_deg = math.degrees(known.angle)
    if not in_place.any():
        found = "no turn ends in the attitude in which it began"
    else:
        each = ", ".join(
            f"{abs(math.degrees(angle)):.0f}° at {first * data.tau0:.1f} s"
            for angle, (first, _) in zip(measured[in_place], data.spans[in_place], strict=True)
        )
        found = f"the turns in place have {each}"
    return (
        f"no turn by {angle_deg:g}° was found: {found}; leave the IMU at rest for some seconds before "
        "and after each turn, and turn without a rest on the way"
    )
