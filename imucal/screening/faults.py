"""Findings about both sensors of a moving log, in the words of `imucal.calibrate` and `imucal.doctor`."""

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.recording import AXES, Sensor
from imucal.screening.values import unit_suspect
from imucal.screening.windows import name_list

__all__ = ["signed_axes", "wrong_axes", "wrong_gyroscope_unit"]


def wrong_gyroscope_unit(factor: float, unit: str = "") -> Finding:
    """Return the finding for a gyroscope that shows `factor` for 1 rad/s; `unit` is empty if unknown."""
    text = f"The gyroscope may not be in rad/s: it shows {factor:.3g} times the rates at which gravity turns."
    return unit_suspect(Sensor.GYROSCOPE, text, unit)


def wrong_axes(order: FloatArray) -> Finding:
    """Return the finding for a gyroscope whose axes measure the rows of `order`, signed axes of f."""
    if np.array_equal(order, -np.eye(3)):
        found = "all three axes of the gyroscope have the wrong sign"
    else:
        pairs = zip(AXES, signed_axes(order), strict=True)
        wrong = [f"{axis} is along {right}" for axis, right in pairs if axis != right]
        found = f"the gyroscope's {name_list(wrong)} of the accelerometer"
    text = f"The order and signs of the axes contradict the turns: {found}."
    advice = "Correct the axes in the driver, or when reading the log; a filter diverges with these."
    return Finding("error", "axes", text, advice, axis="gyro")


def signed_axes(order: FloatArray) -> list[str]:
    """Return a signed axis, such as ``-y``, for each row of a signed permutation."""
    places = [int(np.abs(row).argmax()) for row in order]
    return [f"{'-' if row[place] < 0 else ''}{AXES[place]}" for row, place in zip(order, places, strict=True)]
