"""What all checks of one axis share, worked out once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucal.recording import ABSURD, AxisSeries
from imucal.screening.resolution import resolution
from imucal.screening.stillness import disturbed, without_spikes
from imucal.screening.welch import Density, density
from imucal.screening.windows import Windows, cut

#: Samples looked at in one go.
_BLOCK = 1 << 20


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
    series = _sane(series)
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


def _sane(series: AxisSeries) -> AxisSeries:
    """Return the axis without NaN, infinite and absurd samples; they become gaps."""
    blocks = [series.samples[first : first + _BLOCK] for first in range(0, series.n, _BLOCK)]
    keep = [np.abs(block) <= ABSURD for block in blocks]
    if all(part.all() for part in keep):
        return series
    return series.keeping(np.concatenate(keep))
