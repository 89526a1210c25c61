"""A low-pass filter at the sensor's output: the density falls towards half the sampling rate."""

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.screen.profile import Profile
from imucal.screen.welch import Density

__all__ = ["check_roll_off", "corner"]

#: Bands of equal width that the density is averaged in.
_BANDS = 64
#: The end must fall below this part of the plateau, surely.
_FALL = 0.5
#: The plateau may rise or fall by this factor over its octave.
_FLAT = 1.2
#: The plateau lies above this part of half the sampling rate: lower ones are slow noise, not filters.
_LOWEST = 0.03


def corner(density: Density) -> float | None:
    """Return the frequency, in Hz, at which the density has fallen to half its plateau; None if it does not.

    Only a fall from a flat octave counts: flicker and random walks fall all the way.
    """
    frequency, level, edf = _bands(density)
    error = np.sqrt(2 / edf)
    nyquist = float(density.frequency[-1])
    inner = frequency < 0.95 * nyquist
    end = float(level[inner][-4:].mean())
    best: tuple[float, float] | None = None
    for i in range(1, level.size):
        top = int(np.searchsorted(frequency, 2 * frequency[i]))
        if frequency[i] < _LOWEST * nyquist or top + 4 > inner.sum():
            continue
        below, above = (
            level[i : i + max(1, (top - i) // 2)].mean(),
            level[i + (top - i) // 2 : top + 1].mean(),
        )
        plateau = float(level[i : top + 1].mean())
        flat = 1 / _FLAT < below / above < _FLAT + 2 * error[i]
        if (
            flat
            and end * (1 + 3 * float(error[-1]) / 2) < _FALL * plateau
            and (best is None or plateau > best[1])
        ):
            best = (float(frequency[top]), plateau)
    if best is None:
        return None
    start, plateau = best
    fallen = np.flatnonzero((frequency >= start) & (level < 0.5 * plateau))
    return float(frequency[fallen[0]]) if fallen.size else None


def _bands(density: Density) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the middle, the level and the degrees of freedom of each band; a median leaves tones out."""
    inner = np.arange(1, density.psd.size - 1)
    parts = np.array_split(inner, min(_BANDS, inner.size // 8))
    frequency = np.array([density.frequency[part].mean() for part in parts])
    level = np.array([np.median(density.psd[part]) for part in parts])
    # A median of normal values has 2/pi of the mean's efficiency; Hann neighbours correlate by 1.5.
    edf = np.array([part.size * density.edf * (2 / np.pi) / 1.5 for part in parts])
    return frequency, level, edf


def check_roll_off(profile: Profile) -> tuple[Finding, ...]:
    """Return a note on the output filter that the density shows."""
    series, density = profile.series, profile.density
    cutoff = corner(density) if density is not None else None
    if cutoff is None:
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
