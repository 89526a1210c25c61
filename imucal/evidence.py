"""What samples reveal about their unit and their sensor: gravity, noise, steps of a converter, repeats.

Readers decide units by it before samples are in SI; the screening checks samples in SI by the same limits.
"""

from collections.abc import Sequence

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.units import G0

__all__ = [
    "FASTEST_AT_REST",
    "GRAVITY_TOLERANCE",
    "MAX_GYRO_NOISE",
    "gravity_unit",
    "gyroscope_step_unit",
    "is_gravity_per_sample",
    "share_together",
    "value_step",
]

#: Largest relative difference between the length of a mean acceleration at rest and gravity: the scale of an
#: uncalibrated accelerometer.
GRAVITY_TOLERANCE = 0.2
#: Unit of an accelerometer -> length of gravity in it.
_GRAVITY = {"m/s^2": G0, "g": 1.0, "mg": 1e3, "ug": 1e6}
#: Largest relative difference between gravity and increments of velocity times the rate.
_INCREMENT_TOLERANCE = 0.03

#: Fastest rate of a gyroscope at rest, in rad/s: the largest bias.
FASTEST_AT_REST = 0.4
#: Noise of a gyroscope, in rad/s/sqrt(Hz), above which its unit is doubtful: 0.11 deg/s/sqrt(Hz), twice that
#: of the noisiest sensors on sale (0.03 to 0.05).
MAX_GYRO_NOISE = 2e-3

#: InvenSense at 250 deg/s full range, in deg/s per count.
_INVENSENSE_STEP = 1 / 131
#: Bosch and others at 125 deg/s: full range over 15 bits.
_BOSCH_STEP = 125 / 32768
#: ST at 250 deg/s.
_ST_STEP = 8.75e-3
#: BNO055 in fusion mode.
_BNO_STEP = 1 / 16
#: Steps of common converters, in deg/s per count; other ranges differ by powers of two.
GYRO_STEPS = (
    *(_INVENSENSE_STEP * 2.0**k for k in range(-1, 4)),
    *(_BOSCH_STEP * 2.0**k for k in range(6)),
    *(_ST_STEP * 2.0**k for k in range(-1, 5)),
    _BNO_STEP,
)
#: Relative difference of equal steps; data sheets round 32.75 to 32.8 counts per deg/s.
_STEP_TOLERANCE = 2e-3

#: Fewest different values of an axis that show a step.
_MIN_VALUES = 2
#: Closer values, relative to the largest one, differ by the rounding of a 32-bit float.
_ROUNDING = 4e-7
#: Longest distance between neighbouring values that is compared with the step, in steps.
_FEW_STEPS = 12
#: Tolerance of a multiple, in steps: decimal and float32 rounding.
_MULTIPLE_TOLERANCE = 0.15

#: Least share of samples marked on all axes.
_MIN_TOGETHER = 0.005


def gravity_unit(length: float) -> str | None:
    """Return the unit of an accelerometer in which a length is gravity: m/s^2, g, mg or ug; or None."""
    near = (u for u, gravity in _GRAVITY.items() if abs(length / gravity - 1) <= GRAVITY_TOLERANCE)
    return next(near, None)


def is_gravity_per_sample(length: float, rate_hz: float) -> bool:
    """Return whether vectors of this length are gravity as increments of velocity, in m/s per sample."""
    return abs(length * rate_hz / G0 - 1) <= _INCREMENT_TOLERANCE


def value_step(values: FloatArray) -> float | None:
    """Return the step between neighbouring values, shape (n,), in any unit.

    None if the values are constant or not on a lattice.
    """
    different = np.unique(values)
    if different.size < _MIN_VALUES:
        return None
    steps = np.diff(different)
    steps = steps[steps > _ROUNDING * np.abs(different).max()]
    if not steps.size:
        return None
    step = float(steps.min())
    near = steps[steps < (_FEW_STEPS + 0.5) * step]
    if steps.size > 2 and near.size < max(2, steps.size // 4):
        return None
    step = float(near.sum() / np.rint(near / step).sum())
    off = np.abs(near / step - np.rint(near / step))
    return step if off.max() < _MULTIPLE_TOLERANCE else None


def gyroscope_step_unit(steps: Sequence[float | None]) -> tuple[str, float] | None:
    """Return the unit in which the steps of all axes are those of a usual converter, and its step in deg/s.

    The unit is deg/s or rad/s; None if a step is missing or unknown.
    """
    for unit, factor in (("deg/s", 1.0), ("rad/s", np.pi / 180)):
        for known in GYRO_STEPS:
            if steps and all(one and abs(one / (known * factor) - 1) < _STEP_TOLERANCE for one in steps):
                return unit, known
    return None


def share_together(marks: Sequence[BoolArray]) -> float:
    """Return the share of samples that are marked on all axes, shape (n,) each; 0 if chance explains it.

    Coarse samples repeat by chance, on each axis by itself.
    """
    each = [float(mark.mean()) for mark in marks]
    together = float(np.all(marks, axis=0).mean())
    apart = float(np.prod(each))
    by_chance = together - apart <= 0.5 * (min(each) - apart)
    return 0.0 if together < _MIN_TOGETHER or by_chance else together
