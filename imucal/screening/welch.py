"""Welch's power spectral density of the undisturbed parts of an axis."""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.recording import AxisSeries

#: Shortest and longest stretch that is transformed, in samples.
_SHORTEST, _LONGEST = 256, 16384
#: Stretches wanted of a short log; the most that are taken of a long one, spread evenly over it.
_WANTED, _MOST = 16, 256
#: Stretches that are transformed at once, which is a third quicker than one by one.
_TOGETHER = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Density:
    """A two-sided power spectral density at equal spacing.

    Attributes
    ----------
    frequency
        Shape (k,), in Hz, from 0 to the Nyquist frequency.
    psd
        Shape (k,), two-sided, in U²/Hz.
    edf
        Degrees of freedom of each value.
    """

    frequency: FloatArray
    psd: FloatArray
    edf: float

    @property
    def spacing_hz(self) -> float:
        """Distance of neighbouring frequencies, in Hz."""
        return float(self.frequency[1])


def density(series: AxisSeries, *, avoid: IntArray, width: int) -> Density | None:
    """Return the density of the stretches that hold no gap and no disturbance.

    `avoid`, shape (j,), rising, are the first samples of the disturbed windows, each `width` long.
    Hann windows that overlap by half. None where fewer than four stretches of 256 samples fit.
    O(n log n), and no more than 256 stretches however long the log is.

    Source: Welch (1967), IEEE Trans. Audio Electroacoust. 15(2).
    """
    size = _LONGEST
    while size > _SHORTEST and size * _WANTED > series.n:
        size //= 2
    while size >= _SHORTEST:
        starts = _starts(series, size, avoid, width)
        if starts.size >= min(_WANTED, 4):
            break
        size //= 2
    else:
        return None
    if starts.size > _MOST:
        starts = starts[np.linspace(0, starts.size - 1, _MOST).astype(np.int64)]
    taper = np.hanning(size + 1)[:-1]
    total = np.zeros(2 * (size // 2 + 1))
    # The same memory for all of them: a page that is new costs more than its share of a transform.
    tapered = np.empty((_TOGETHER, size))
    transform = np.empty((_TOGETHER, size // 2 + 1), dtype=np.complex128)
    for first in range(0, starts.size, _TOGETHER):
        some = starts[first : first + _TOGETHER].tolist()
        for row, start in zip(tapered, some, strict=False):
            row[:] = series.samples[start : start + size]
        rows, parts = tapered[: len(some)], transform[: len(some)]
        rows -= rows.mean(axis=1, keepdims=True)
        rows *= taper
        squares = np.fft.rfft(rows, out=parts).view(np.float64)
        total += np.square(squares, out=squares).sum(axis=0)
    power = total.reshape(-1, 2).sum(axis=1)
    power *= series.tau0 / (starts.size * (taper @ taper))
    # Neighbouring Hann stretches correlate by 1/6 in amplitude: 2/36 in power, twice.
    frequency = np.arange(power.size, dtype=np.float64) * (series.rate_hz / size)
    return Density(frequency=frequency, psd=power, edf=2 * starts.size / (1 + 2 / 36))


def _starts(series: AxisSeries, size: int, avoid: IntArray, width: int) -> IntArray:
    fitting = [segment for segment in series.clock.segments if segment.size >= size]
    starts = [np.arange(segment.start, segment.stop - size + 1, size // 2) for segment in fitting]
    every = np.concatenate([np.zeros(0, dtype=np.int64), *starts])
    before = np.searchsorted(avoid, every - width, side="right")
    kept: IntArray = every[np.searchsorted(avoid, every + size) == before]
    return kept
