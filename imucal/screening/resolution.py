"""The smallest step of an axis's samples: its LSB, or the digits the log was written with."""

import numpy as np

from imucal.arrays import FloatArray
from imucal.recording import AxisSeries

#: Samples looked at, in stretches spread over the log.
_STRETCHES, _STRETCH = 16, 2048
#: Steps of more LSB than this say little about the LSB.
_FEW = 12
#: A step may differ by this part of an LSB from a multiple: decimal and float32 rounding.
_TOLERANCE = 0.15


def excerpt(n: int) -> list[slice]:
    """Return at most 16 stretches of 2048 indices, spread evenly over `n` samples."""
    if n <= _STRETCHES * _STRETCH:
        return [slice(0, n)]
    firsts = np.linspace(0, n - _STRETCH, _STRETCHES).astype(np.int64)
    return [slice(first, first + _STRETCH) for first in firsts.tolist()]


def resolution(series: AxisSeries) -> float | None:
    """Return the step between neighbouring values, in U; None where values are not on a lattice.

    A constant axis has none.
    """
    values = np.unique(np.concatenate([series.samples[part] for part in excerpt(series.n)]))
    return _lattice_step(values)


def _lattice_step(values: FloatArray) -> float | None:
    if values.size < 2:
        return None
    steps = np.diff(values)
    # Values that differ by the rounding of a 32-bit float are one value.
    steps = steps[steps > 4e-7 * np.abs(values).max()]
    if not steps.size:
        return None
    step = float(steps.min())
    near = steps[steps < (_FEW + 0.5) * step]
    if steps.size > 2 and near.size < max(2, steps.size // 4):
        return None
    step = float(near.sum() / np.rint(near / step).sum())
    off = np.abs(near / step - np.rint(near / step))
    return step if off.max() < _TOLERANCE else None
