"""What all checks of one axis share, worked out once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray
from imucal.recording import AxisSeries
from imucal.screening.stillness import disturbed, without_spikes
from imucal.screening.welch import Density, density
from imucal.screening.windows import Windows, cut

#: Samples that show the LSB, in stretches spread over the log.
_STRETCHES, _STRETCH = 16, 2048
#: Steps of more LSB than this say little about the LSB.
_FEW = 12
#: A step may differ by this part of an LSB from a multiple: decimal and float32 rounding.
_TOLERANCE = 0.15


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Profile:
    """One axis, as the checks see it.

    Attributes
    ----------
    series
        The axis without NaN, infinite and absurd samples.
    left_out
        How many those are.
    windows
        Its windows; spikes are left out of the mean and variance of windows that stand out.
    disturbed
        Which windows are not at rest, shape (k,).
    lsb
        The step of its values, in U; None where they are not on a lattice.
    noise
        Deviation of its white noise, per sample, in U.
    density
        Its power spectral density at rest; None of a short log.
    """

    series: AxisSeries
    left_out: int
    windows: Windows
    disturbed: NDArray[np.bool_]
    lsb: float | None
    noise: float
    density: Density | None

    @property
    def name(self) -> str:
        """`gyro_x` … `accel_z`."""
        return self.series.name

    @property
    def constant(self) -> bool:
        """Whether no sample differs from another."""
        return not self.windows.size or bool(self.windows.low.min() == self.windows.high.max())


def profile(series: AxisSeries) -> Profile:
    """Return the profile of an axis; one pass over the samples, and a bounded number of transforms."""
    whole = series
    series = series.finite()
    windows = cut(series)
    lsb = resolution(series)
    marks = disturbed(windows, lsb)
    if marks.any():
        windows = without_spikes(series, windows, marks)
        marks = disturbed(windows, lsb)
    quiet = windows.step_variance[~marks & (windows.variance > 0)]
    return Profile(
        series=series,
        left_out=whole.n - series.n,
        windows=windows,
        disturbed=marks,
        lsb=lsb,
        noise=float(np.sqrt(np.median(quiet))) if quiet.size else 0.0,
        density=density(series, avoid=windows.start[marks], width=windows.width),
    )


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Blocks:
    """Means over equal spans of time; `time_s` (middle, s) and `mean` (U) have shape (k,)."""

    time_s: FloatArray
    mean: FloatArray


def blocks(profile: Profile, count: int) -> Blocks:
    """Return the means of the undisturbed windows over `count` equal spans; empty spans are left out."""
    windows = profile.windows
    rest = ~profile.disturbed
    middle = windows.time_s[rest] + windows.length_s / 2
    index = np.minimum((middle / profile.series.duration_s * count).astype(np.int64), count - 1)
    number = np.bincount(index, minlength=count)
    filled = number > 0
    offset = float(windows.mean[rest][0]) if middle.size else 0.0
    total = np.bincount(index, weights=windows.mean[rest] - offset, minlength=count)
    when = np.bincount(index, weights=middle, minlength=count)
    return Blocks(time_s=when[filled] / number[filled], mean=offset + total[filled] / number[filled])
