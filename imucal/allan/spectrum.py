"""The log-binned power spectral density, the picture beside the Allan curve."""

from dataclasses import dataclass

import numpy as np

from imucal.allan.dct import dct_bins, dct_ordinates
from imucal.arrays import FloatArray, read_only
from imucal.errors import DataError
from imucal.recording import AxisSeries


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spectrum:
    """A two-sided power spectral density, averaged over bins of rising width.

    Attributes
    ----------
    frequency
        Mean frequency of each bin, shape (k,), in Hz, rising.
    psd
        Two-sided density, shape (k,), in U²/Hz.
    count
        Degrees of freedom of each bin, shape (k,): the ordinates it averages.
    """

    frequency: FloatArray
    psd: FloatArray
    count: FloatArray

    def __post_init__(self) -> None:
        for name in ("frequency", "psd", "count"):
            array = read_only(np.asarray(getattr(self, name), dtype=np.float64))
            object.__setattr__(self, name, array)


def spectrum(series: AxisSeries, *, per_octave: int = 12) -> Spectrum:
    """Return the log-binned psd of an axis, without its missing samples.

    Each run of unbroken samples gives its DCT-II, whose squared ordinates estimate the two-sided
    density without leakage from drift; runs are averaged bin by bin. The lowest eight frequencies
    stand alone, then bins widen to `per_octave` an octave.

    Raises
    ------
    DataError
        If no run holds at least 2 samples.
    """
    series = series.finite()
    runs = [s for s in series.clock.segments if s.size >= 2]
    if not runs:
        msg = f"{series.name}: a spectrum needs at least 2 neighbouring samples, got {series.n} samples"
        raise DataError(msg)
    grid = dct_bins(max(run.size for run in runs), singles=8, per_octave=per_octave)
    edges = np.pi * np.append(grid.first - 0.5, grid.n - 0.5) / grid.n
    power, count, omega = np.zeros((3, grid.size))
    for run in runs:
        squares = np.square(dct_ordinates(series.samples[run.start : run.stop]))
        angle = np.pi * np.arange(1, run.size) / run.size
        bins = np.searchsorted(edges, angle) - 1
        power += np.bincount(bins, squares, grid.size)
        omega += np.bincount(bins, angle, grid.size)
        count += np.bincount(bins, minlength=grid.size)
    filled = count > 0
    frequency = omega[filled] / count[filled] * series.rate_hz / (2 * np.pi)
    return Spectrum(frequency=frequency, psd=power[filled] / count[filled] * series.tau0, count=count[filled])
