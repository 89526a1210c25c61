"""Parameters as users see them: scale error, misalignment, bias and g-sensitivity, with intervals."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.accelerometer import LOWER, Status
from imucal.calibration.frames import Frame
from imucal.calibration.gyro_rest import GyroRest
from imucal.calibration.slow_noise import AccelerometerEstimate
from imucal.calibration.turns import TurnsFit

__all__ = ["Parameter", "accelerometer_parameters", "gyroscope_parameters", "inverse", "is_si"]

#: Scales within this factor of 1 are scale errors; others belong to raw counts.
_SI = 1.5
_NINE = [(i, j) for i in range(3) for j in range(3)]


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A value with its 95 % interval.

    `unit` is ``%`` for a scale error, ``raw/(m/s^2)`` or ``raw/(rad/s)`` for the scale of raw counts,
    ``deg`` for a misalignment, the sensor's unit for a bias and ``(rad/s)/(m/s^2)`` for g-sensitivity.
    `status` is ``estimated``, ``weak``, ``not-significant`` (0 is applied) or ``not-observable``, without a
    value.
    """

    value: float | None
    low: float | None
    high: float | None
    unit: str
    status: str

    @property
    def half_width(self) -> float | None:
        return None if self.low is None or self.high is None else (self.high - self.low) / 2


def is_si(M: FloatArray) -> bool:
    """Whether a matrix is near 1, as of a sensor in SI units."""
    scales = np.linalg.norm(M, axis=1)
    return bool(np.all((scales < _SI) & (scales > 1 / _SI)))


def accelerometer_parameters(
    found: AccelerometerEstimate, frame: Frame, *, si: bool = True
) -> Mapping[str, Parameter]:
    """Return the nine parameters of an accelerometer by the names of the frame.

    `si` is whether its samples are in m/s².
    """
    C = np.zeros((3, 3))
    C[LOWER] = found.theta[:6]
    values, rows, units = _seen(inverse(frame.R @ C), frame.entries, "m/s^2", si=si)
    full = np.zeros((9, 9))
    full[:6, :6] = rows @ frame.derivatives.reshape(9, 6)
    full[6:, 6:] = np.eye(3)
    values = np.concatenate([values, found.theta[6:]])
    units += ["m/s^2" if si else "raw"] * 3
    intervals = values[:, None] + found.mixture.interval(full[:, found.fit.free])
    return {
        name: _parameter(value, interval, unit, status)
        for name, value, interval, unit, status in zip(
            frame.parameters, values, intervals, units, found.fit.statuses, strict=True
        )
    }


def gyroscope_parameters(
    rest: GyroRest, turns: TurnsFit | None, *, si: bool = True
) -> Mapping[str, Parameter]:
    """Return scale_x …, misalignment_xy …, bias_x … and g_sensitivity_xx … of a gyroscope.

    Without turns the first nine are not observable. `si` is whether its samples are in rad/s.
    """
    names = [f"scale_{'xyz'[i]}" if i == j else f"misalignment_{'xyz'[i]}{'xyz'[j]}" for i, j in _NINE]
    statuses: tuple[Status, ...] = ("not-observable",) * 9
    values, halves, units = np.zeros(9), np.zeros(9), ["%" if i == j else "deg" for i, j in _NINE]
    if turns is not None:
        statuses = turns.statuses
        values, rows, units = _seen(inverse(turns.C), _NINE, "rad/s", si=si)
        halves = turns.quantile * np.sqrt(np.einsum("ij,jk,ik->i", rows, turns.covariance, rows))
    intervals = values[:, None] + halves[:, None] * np.array([-1.0, 1.0])
    found = {
        name: _parameter(value, interval, unit, status)
        for name, value, interval, unit, status in zip(names, values, intervals, units, statuses, strict=True)
    }
    for axis, value, interval in zip("xyz", rest.b, rest.b_interval, strict=True):
        found[f"bias_{axis}"] = _parameter(value, interval, "rad/s" if si else "raw", "estimated")
    status = "estimated" if rest.significant else "not-significant"
    for i, j in _NINE:
        own = status if np.isfinite(rest.G_estimate[i, j]) else "not-observable"
        unit = "(rad/s)/(m/s^2)" if si else "raw/(m/s^2)"
        found[f"g_sensitivity_{'xyz'[i]}{'xyz'[j]}"] = _parameter(
            rest.G_estimate[i, j], rest.G_interval[i, j], unit, own
        )
    return found


def _seen(
    M: FloatArray, entries: list[tuple[int, int]], unit: str, *, si: bool
) -> tuple[FloatArray, FloatArray, list[str]]:
    """Return scale errors in % and misalignments M_ij / M_ii in deg, derivatives in C by rows, and units."""
    values, rows, units = [], [], []
    # dM = -M dC M
    slopes = -np.einsum("ik,lj->ijkl", M, M)
    degree = np.degrees(1.0)
    for i, j in entries:
        if i == j:
            values.append(100 * (M[i, i] - 1) if si else M[i, i])
            slope = slopes[i, i] * (100 if si else 1)
            units.append("%" if si else f"raw/({unit})")
        else:
            values.append(degree * M[i, j] / M[i, i])
            slope = degree * (slopes[i, j] - M[i, j] / M[i, i] * slopes[i, i]) / M[i, i]
            units.append("deg")
        rows.append(slope.ravel())
    return np.array(values), np.array(rows), units


def inverse(C: FloatArray) -> FloatArray:
    """Return C⁻¹."""
    return np.asarray(np.linalg.inv(C), dtype=np.float64)


def _parameter(value: float, interval: FloatArray, unit: str, status: str) -> Parameter:
    if status == "not-observable":
        return Parameter(value=None, low=None, high=None, unit=unit, status=status)
    low, high = (float(end) for end in interval)
    return Parameter(value=float(value), low=low, high=high, unit=unit, status=status)
