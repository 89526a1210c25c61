"""Tones: how strong, at what frequency, and what may make them."""

from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.findings import Finding
from imucal.screening.profile import Profile
from imucal.screening.welch import Density
from imucal.screening.words import amount

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
