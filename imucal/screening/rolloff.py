"""A low-pass filter at the sensor's output: the density falls towards half the sampling rate."""

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.screening.profile import Profile
from imucal.screening.welch import Density

#: Bands of equal width that the density is averaged in.
_BANDS = 64
#: The end must fall below this part of the plateau, surely.
_FALL = 0.5
#: The plateau may rise or fall by this factor over its octave.
_FLAT = 1.2
#: The plateau lies above this part of half the sampling rate: lower ones are slow noise, not filters.
_LOWEST = 0.03
#: Repeated samples fall off too: more than this part of them is another finding.
_HELD = 0.2


def corner(density: Density) -> float | None:
    """Return the frequency, in Hz, at which the density has fallen to half its plateau; None if it does not.

    Only a fall from a flat octave counts: flicker and random walks fall all the way.
    """
    frequency, level, edf = _bands(density)
    nyquist = float(density.frequency[-1])
    end = float(level[frequency < 0.95 * nyquist][-4:].mean()) * (1 + 3 * np.sqrt(2 / (4 * edf)))
    plateaus = [
        plateau
        for first in np.flatnonzero(frequency >= _LOWEST * nyquist).tolist()
        if (plateau := _plateau(frequency, level, edf, first)) and end < _FALL * plateau[1]
    ]
    if not plateaus:
        return None
    start, height = max(plateaus, key=lambda plateau: plateau[1])
    fallen = frequency[(frequency >= start) & (level < 0.5 * height)]
    return float(fallen[0]) if fallen.size else None


def _plateau(frequency: FloatArray, level: FloatArray, edf: float, first: int) -> tuple[float, float] | None:
    """Return the end and the level of the octave from a band on; None where it is not flat."""
    stop = int(np.searchsorted(frequency, 2 * frequency[first]))
    middle = (first + stop) // 2
    if stop >= frequency.size or middle == first:
        return None
    lower, upper = float(level[first:middle].mean()), float(level[middle:stop].mean())
    error = float(np.sqrt(2 / edf * (1 / (middle - first) + 1 / (stop - middle))))
    flat = error < _FLAT - 1 and upper < _FLAT * lower and lower < _FLAT * upper
    return (float(frequency[stop]), (lower + upper) / 2) if flat else None


def _bands(density: Density) -> tuple[FloatArray, FloatArray, float]:
    """Return middle and level of each band, and its degrees of freedom; a median leaves tones out."""
    inner = np.arange(1, density.psd.size - 1)
    parts = np.array_split(inner, min(_BANDS, inner.size // 8))
    frequency = np.array([density.frequency[part].mean() for part in parts])
    level = np.array([np.median(density.psd[part]) for part in parts])
    # A median of normal values has 2/pi of the mean's efficiency; Hann neighbours correlate by 1.5.
    edf = inner.size / len(parts) * density.edf * (2 / np.pi) / 1.5
    return frequency, level, edf


def check_roll_off(profile: Profile) -> tuple[Finding, ...]:
    """Return a note on the output filter that the density shows."""
    series, density = profile.series, profile.density
    cutoff = corner(density) if density is not None else None
    held = profile.windows.repeats.sum() > _HELD * profile.windows.width * profile.windows.size
    if cutoff is None or held:
        return ()
    return (
        Finding(
            level="info",
            code="roll-off",
            text=(
                f"The density of {series.name} falls to half near {cutoff:.3g} Hz: a low-pass filter shapes "
                f"its output, sampled at {series.rate_hz:.4g} Hz."
            ),
            advice="Read N from the flat part below the filter, not from the first points of the curve.",
            axis=series.name,
        ),
    )
