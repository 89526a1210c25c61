"""Tones: how strong, at what frequency, and what may make them.

A low-pass filter at the sensor's output: the density falls towards half the sampling rate.
"""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.screening.windows import Density, Profile, amount

#: How often an axis without a tone may show one.
_FALSE_ALARM = 1e-4
#: Error of the floor, which is the median of some dozen neighbours.
_MARGIN = 1.5
#: A tone is at most this many bins wide on either side: the Hann window's main lobe, and one.
_LOBE = 3
#: Neighbours of a bin on either side that give its floor; fewer at low frequencies, where it slopes.
_NEIGHBOURS = 24
#: Lowest bin looked at.
_LOWEST = 8
#: Tones named in a finding.
_NAMED = 4
#: A tone that lifts the Allan variance at its own hump by less than this part is not worth a warning.
_VISIBLE = 0.1
#: Mains frequencies, in Hz, how many harmonics are looked for, and how far the grid may be off.
_MAINS, _HARMONICS, _GRID_ERROR = (50.0, 60.0), 3, 4e-3


@dataclass(frozen=True, slots=True)
class Tone:
    """A line in a spectrum: frequency in Hz, amplitude of the sine in U, and its hump.

    `hump` is how much it adds to the Allan variance where it adds most, relative to what the noise
    around it gives there.
    """

    frequency_hz: float
    amplitude: float
    hump: float


def tones(density: Density) -> tuple[Tone, ...]:
    """Return the tones of a spectrum, the strongest first.

    A bin is one where it exceeds the median of its neighbours by more than chance allows, the bins
    beside it do not (a broad hump is no tone), and it is the largest around.
    """
    from scipy.special import chdtri

    psd = density.psd
    last = psd.size - _LOBE - 2
    if last <= _LOWEST:
        return ()
    limit = _MARGIN * float(chdtri(density.edf, _FALSE_ALARM / psd.size)) / density.edf
    floor = _floor(psd)
    candidates = np.flatnonzero(psd > limit * floor)
    found = []
    for k in candidates[(candidates >= _LOWEST) & (candidates <= last)].tolist():
        around = psd[k - _LOBE : k + _LOBE + 1]
        beside = max(psd[k - _LOBE - 1], psd[k + _LOBE + 1])
        if psd[k] == around.max() and beside - floor[k] < 0.1 * (psd[k] - floor[k]):
            found.append(_tone(density, k, float(floor[k])))
    return tuple(sorted(found, key=lambda tone: tone.hump, reverse=True))


def _floor(psd: FloatArray) -> FloatArray:
    """Return the median of the neighbours of each bin, the line's own lobe left out; shape of `psd`."""
    floor = np.full(psd.size, np.inf)
    reach = _LOBE + _NEIGHBOURS
    if psd.size > 2 * reach:
        around = np.lib.stride_tricks.sliding_window_view(psd, 2 * reach + 1)
        # Sorting so few is seven times as quick as NumPy's median.
        rising = np.sort(np.concatenate([around[:, :_NEIGHBOURS], around[:, -_NEIGHBOURS:]], axis=1), axis=1)
        floor[reach:-reach] = (rising[:, _NEIGHBOURS - 1] + rising[:, _NEIGHBOURS]) / 2
    for k in (*range(_LOWEST, min(reach, psd.size)), *range(max(reach, psd.size - reach), psd.size)):
        near = max(4, min(_NEIGHBOURS, k // 3))
        low, high = max(1, k - _LOBE - near), min(psd.size - 1, k + _LOBE + 1 + near)
        beside = np.concatenate([psd[low : k - _LOBE], psd[k + _LOBE + 1 : high]])
        floor[k] = np.median(beside) if beside.size else np.inf
    return floor


def _tone(density: Density, k: int, floor: float) -> Tone:
    lobe = slice(k - _LOBE, k + _LOBE + 1)
    excess = np.maximum(density.psd[lobe] - floor, 0.0)
    power = 2 * float(excess.sum()) * density.spacing_hz
    frequency = float(density.frequency[lobe] @ excess / excess.sum())
    # A sine's Allan variance A^2 sin^4(x)/x^2, x = pi f tau, peaks at 0.525 A^2, tau = 0.371 / f,
    # where white noise of the floor's density has floor / tau.
    hump = 0.525 * 2 * power * 0.371 / (frequency * floor) if floor > 0 else np.inf
    return Tone(frequency, float(np.sqrt(2 * power)), hump)


def likely_cause(frequency_hz: float, *, rate_hz: float, resolution_hz: float) -> str:
    """Return what may make a tone of some frequency in samples of some rate, in a few words.

    Frequencies above half the rate appear folded: |f - k rate|. Only what fits within the
    resolution is claimed.
    """
    for mains in _MAINS:
        for harmonic in range(1, _HARMONICS + 1):
            true = harmonic * mains
            close = max(resolution_hz, _GRID_ERROR * true)
            folded = abs(true - round(true / rate_hz) * rate_hz)
            if abs(frequency_hz - folded) < close and folded > 2 * close:
                name = f"{mains:.0f} Hz mains" + (f", harmonic {harmonic}" if harmonic > 1 else "")
                return name if true == folded else f"{name}, folded by the sampling"
    divisor = rate_hz / frequency_hz
    whole = round(divisor)
    off = abs(rate_hz / whole - frequency_hz)
    if 2 <= whole <= 8 and off < resolution_hz < 5e-3 * frequency_hz:
        return f"the sampling rate over {whole}: the timing of the logger or the sensor"
    if frequency_hz < 1:
        return "a beat of two clocks, or a heating or cooling cycle"
    if frequency_hz < 15:
        return "the swaying of a building or table, or a folded higher tone"
    if frequency_hz < 250:
        return f"a fan or motor at {60 * frequency_hz:.0f} rpm, or a folded higher tone"
    return "electronics, or a resonance"


def check_tones(profile: Profile) -> tuple[Finding, ...]:
    """Return a finding that names the tones of an axis, a warning where they shape its Allan curve."""
    density, series = profile.density, profile.series
    found = tones(density) if density is not None else ()
    if density is None or not found:
        return ()
    named = []
    for tone in found[:_NAMED]:
        cause = likely_cause(
            tone.frequency_hz, rate_hz=series.rate_hz, resolution_hz=1.5 * density.spacing_hz
        )
        height = amount(tone.amplitude, series.sensor)
        named.append(f"{height} at {tone.frequency_hz:.4g} Hz, perhaps {cause}")
    if len(found) > _NAMED:
        named.append(f"and {len(found) - _NAMED} weaker")
    visible = found[0].hump > _VISIBLE
    many = len(found) > 1
    count = f"{len(found)} tones" if many else "a tone"
    effect = f", which {'bend' if many else 'bends'} the Allan curve" if visible else ""
    return (
        Finding(
            level="warning" if visible else "info",
            code="tone",
            text=f"{series.name} holds {count}{effect}: {'; '.join(named)}.",
            advice="Remove the source and record again; the fit leaves lines out." if visible else "",
            axis=series.name,
        ),
    )


#: Bands of equal width that the density is averaged in.
_BANDS = 64
#: The end must fall below this part of the plateau, surely.
_FALL = 0.5
#: The plateau may rise or fall by this factor over its octave.
_FLAT = 1.2
#: The plateau lies above this part of half the sampling rate: lower ones are slow noise, not filters.
_ROLLOFF_LOWEST = 0.03
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
        for first in np.flatnonzero(frequency >= _ROLLOFF_LOWEST * nyquist).tolist()
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
