"""Rows about the output filter and about vibration, from the spectra of quiet parts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from imucal.arrays import FloatArray
from imucal.health.diagnosis import Question, Row, Values
from imucal.health.evidence import Curve, Evidence, Limit, thinned
from imucal.health.stream import Stream
from imucal.screening.motion import density_at_rest

__all__ = ["filter_row", "vibration_row"]

#: Density at the highest frequencies over that in the middle below which there is an output filter.
_ROLLED_OFF = 0.5
#: Frequencies of the middle, as shares of half the sampling rate: above flicker and drift.
_MIDDLE = (0.1, 0.3)
#: The highest frequencies, as a share of half the sampling rate.
_HIGH = 0.85
#: Density of a line over the median nearby; with 4 averaged stretches chance exceeds it once in 1e6 bins.
_LINE = 8.0
#: Number of frequencies nearby.
_NEARBY = 41
#: Power of a line over that of all the noise, that is notable.
_NOTABLE = 0.05
#: Lowest line, in Hz: below it the spectrum of a resting hand is no line.
_LOWEST_HZ = 5.0

_REST = "Record a rest of 20 s, with motors and fans as in use."


def _densities(stream: Stream) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return frequencies in Hz and the density at rest of each axis that rests for long enough."""
    found = {}
    for p in stream.profiles:
        if p.constant:
            continue
        resting = replace(p, disturbed=~stream.resting(p))
        density = density_at_rest(resting)
        if density is not None:
            found[p.name] = np.linspace(0, p.series.rate_hz / 2, density.size), density
    return found


def filter_row(stream: Stream) -> Row:
    """Return the row of the output filter, which delays the samples and hides vibration."""
    question = Question("output filter", "roll-off")
    densities = _densities(stream)
    if not densities:
        found = "no rest is long enough for a spectrum"
        return question.answer("unknown", found, _REST)
    values: Values = {}
    for axis, (frequency, density) in densities.items():
        edge = _corner(frequency, density)
        if edge is not None:
            values[axis] = edge
    if not values:
        found = "the noise at rest is flat up to half the sampling rate"
        return question.answer("pass", found)
    lowest = min(values, key=lambda axis: float(values[axis] or 0))
    found = f"an output filter halves the noise of {lowest} at about {values[lowest]:.3g} Hz"
    return question.answer("pass", found, values=values)


def _corner(frequency: FloatArray, density: FloatArray) -> float | None:
    """Return the lowest frequency in Hz from which the density stays below half; None without a filter."""
    share = frequency / frequency[-1]
    middle = float(np.median(density[(share > _MIDDLE[0]) & (share < _MIDDLE[1])]))
    # The last frequency has another distribution.
    high = float(np.median(density[:-1][share[:-1] > _HIGH]))
    if not middle > 0 or high > _ROLLED_OFF * middle:
        return None
    width = max(3, density.size // 32)
    smooth = np.convolve(density, np.full(width, 1 / width), "same")
    above = np.flatnonzero((smooth > middle / 2) & (share < _HIGH))
    return float(frequency[above[-1]]) if above.size else float(frequency[1])


def vibration_row(stream: Stream) -> Row:
    """Return the row of lines in the spectrum at rest."""
    question = Question("vibration", "tone")
    densities = _densities(stream)
    if not densities:
        found = "no rest is long enough for a spectrum"
        return question.answer("unknown", found, _REST)
    lines = [(axis, *line) for axis, pair in densities.items() for line in _lines(*pair)]
    if not lines:
        found = "the spectrum at rest has no line above the noise"
        return question.answer("pass", found)
    axis, frequency, share = max(lines, key=lambda line: line[2])
    found = (
        f"{axis} has a line at {frequency:.4g} Hz at rest with {share:.0%} of the noise power; it may be an "
        "alias, which one sampling rate can't tell"
    )
    values: Values = {"axis": axis, "frequency_hz": frequency, "share": share}
    advice = "Look for fans, motors and mains; isolate the IMU, and use its low-pass filter."
    evidence = _evidence(axis, *densities[axis], line_hz=frequency)
    return question.answer("warn", found, advice, values=values, evidence=evidence)


def _evidence(axis: str, frequency: FloatArray, density: FloatArray, *, line_hz: float) -> Evidence:
    """Return the spectrum with a line; the mean level is at frequency 0, which is left out."""
    unit = "rad/s" if axis.startswith("gyro") else "m/s²"
    x, y = thinned(frequency[1:], np.sqrt(density[1:]))
    return Evidence(
        title=f"spectrum of {axis} at rest, the root of the two-sided density",
        x_label="frequency (Hz)",
        y_label=f"spectrum ({unit}/√Hz)",
        curves=(Curve(label=axis, x=x, y=y),),
        limits=(Limit(label=f"{line_hz:.4g} Hz", value=line_hz, upright=True),),
        log_y=True,
    )


def _lines(frequency: FloatArray, density: FloatArray) -> Sequence[tuple[float, float]]:
    """Return frequency in Hz and share of the total power of each notable line."""
    usual = median_filter(density, size=_NEARBY, mode="reflect")
    total = float(usual.sum())
    found = []
    for k in np.flatnonzero(
        (density > _LINE * usual) & (frequency > _LOWEST_HZ) & (frequency < frequency[-1])
    ):
        near = slice(max(int(k) - 1, 0), int(k) + 2)
        if density[k] < density[near].max():
            continue
        share = float((density[near] - usual[near]).sum()) / total if total > 0 else 0.0
        if share > _NOTABLE:
            found.append((float(frequency[k]), share))
    return found
