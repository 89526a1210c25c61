"""What all checks of one axis share, worked out once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucal.recording import AxisSeries
from imucal.screen.resolution import resolution
from imucal.screen.stillness import disturbed, without_spikes
from imucal.screen.welch import Density, density
from imucal.screen.windows import Windows, cut

__all__ = ["Profile", "profile"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Profile:
    """One axis, as the checks see it.

    Attributes
    ----------
    series
        The axis without NaN and infinite samples.
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
        windows=windows,
        disturbed=marks,
        lsb=lsb,
        noise=float(np.sqrt(np.median(quiet))) if quiet.size else 0.0,
        density=density(series, avoid=windows.start[marks], width=windows.width),
    )
