"""Requirements of a log, and which turns can be used."""

import math

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.calibration.poses import RestMeans, Triad, attitudes, find_rests, step_of
from imucal.errors import DataError, Fix
from imucal.findings import Finding
from imucal.recording import AXES
from imucal.screening.faults import wrong_axes, wrong_gyroscope_unit
from imucal.screening.values import looks_like, wrong_gravity

__all__ = [
    "ADVICE", "MIN_RESTS", "require_attitudes", "require_range", "require_rests",
    "trouble_of", "unusable_turns",
]  # fmt: skip

#: Minimum number of rests: one for each scale and bias.
MIN_RESTS = 6
#: Length of the shortest rests that are worth a try, in s.
_SHORTEST_S = 0.4
#: Lengths of gravity of a log in g.
_IN_G = 0.85, 1.15
#: Readings at 1 rad/s of a log in deg/s.
_IN_DEGREES = 50.0, 65.0
#: Least span of noise within a rest, in steps; with less, a rest may be constant.
_NOISY = 3
#: A longer turn is not used, in s.
_LONGEST_TURN_S = 60.0
#: Least repetitions of an extreme on a clipped axis.
_REPEATED = 3
#: Least distance of the extreme of a clipped axis from rest, in steps.
_FAR = 20
#: Length of a segment in which a vibration is searched for, in s: a resolution of 0.5 Hz.
_SEGMENT_S = 2.0
#: Least number of segments, and least samples of one.
_MIN_SEGMENTS = 4
_MIN_SEGMENT = 64
#: Lowest frequency of a vibration, in Hz; slower motion is handling.
_SLOWEST_VIBRATION_HZ = 5.0
#: Bins on each side with which a line is compared, and how far its power must be above their median: white
#: noise
#: exceeds 30 in fewer than one of 10^6 bins.
_NEIGHBOURS = 8
_FAR_ABOVE = 30.0
ADVICE = "put the IMU down on each face and on six edges, 5 s each: about 2 minutes"


def require_rests(spans_s: FloatArray, accelerometer: Triad, gyroscope: Triad | None) -> None:
    """Raise a DataError if there are fewer than 6 rests, spans of shape (m, 2)."""
    if len(spans_s) >= MIN_RESTS:
        return
    short = len(find_rests(accelerometer, gyroscope, at_least_s=_SHORTEST_S))
    held = len(find_rests(accelerometer, gyroscope, in_hand=True)) if gyroscope is not None else 0
    shorter: list[Fix] = []
    found = f"rests in {accelerometer.end_s:.0f} s: found {len(spans_s)}, expected at least {MIN_RESTS}"
    if short >= MIN_RESTS:
        found += f"; {short} rests last {_SHORTEST_S:g} s or longer"
        shorter = [Fix("", "rest_at_least", f"{_SHORTEST_S:g}s")]
    elif held >= MIN_RESTS:
        found += f"; {held} rests have the tremor of a hand"
        shorter = [Fix("", "in_hand")]
    advice = ADVICE
    vibration = _vibration(accelerometer)
    if vibration is not None:
        frequency_hz, amplitude = vibration
        advice = (
            f"it vibrates at about {frequency_hz:.3g} Hz, with {amplitude:.2g} {accelerometer.sensor.unit}; "
            "switch the "
            "motors off, or put it on a table that is at rest"
        )
    raise DataError(found, fixes=[Fix(advice), *shorter])


def _vibration(data: Triad) -> tuple[float, float] | None:
    """Return frequency in Hz and amplitude, in units of the samples, of a vibration during the whole log.

    The axis and the frequency are those with the largest power. None if it is not far above its neighbours,
    or if it is not there in most segments.
    """
    samples = np.nan_to_num(data.samples)
    size = min(round(_SEGMENT_S * data.rate_hz), len(samples) // _MIN_SEGMENTS)
    if size < _MIN_SEGMENT:
        return None
    count = len(samples) // size
    segments = samples[: count * size].reshape(count, size, -1)
    window = np.hanning(size)[:, None]
    power = np.abs(np.fft.rfft((segments - segments.mean(axis=1, keepdims=True)) * window, axis=1)) ** 2
    # Turns are in few segments, and their spectrum falls with frequency.
    usual = np.quantile(power, 1 / 4, axis=0)
    frequencies = np.fft.rfftfreq(size, 1 / data.rate_hz)
    usual[frequencies < _SLOWEST_VIBRATION_HZ] = 0.0
    place, axis = np.unravel_index(int(np.argmax(usual)), usual.shape)
    around = usual[max(0, place - _NEIGHBOURS) : place + _NEIGHBOURS + 1, axis]
    if not usual[place, axis] > _FAR_ABOVE * np.median(around[around > 0]):
        return None
    # A line of amplitude a has the power (a/2 sum of the window)^2.
    amplitude = 2 * math.sqrt(usual[place, axis]) / window.sum()
    return float(frequencies[place]), float(amplitude)


def require_attitudes(means: FloatArray) -> None:
    """Raise a DataError if all means of an accelerometer in SI units have one direction."""
    norm = np.linalg.norm(means, axis=1)
    # Raw counts may have an offset that hides the direction.
    if np.all((norm > 5) & (norm < 15)) and attitudes(means / norm[:, None]) == 1:
        raise DataError(f"all {len(means)} rests have the same attitude within 10°", fix=Fix(ADVICE))


def require_range(data: Triad, rests: RestMeans) -> None:
    """Raise a DataError if the samples are in g, or an axis is clipped at rest."""
    norm = float(np.median(np.linalg.norm(rests.means, axis=1)))
    if _IN_G[0] < norm < _IN_G[1]:
        found = wrong_gravity(norm, looks_like("g"))
        raise DataError(found, fix=Fix("", "accel_unit", "g"), code="unit-suspect")
    for axis, column in enumerate(data.samples.T):
        parts = [column[first:end] for first, end in rests.spans]
        extremes = np.nanmin(column), np.nanmax(column)
        constant = np.array([np.ptp(part) == 0 and part[0] in extremes for part in parts])
        # With coarse steps other rests are constant too.
        if constant.any() and np.median([np.ptp(part) for part in parts]) > _NOISY * step_of(column):
            value = float(parts[int(np.argmax(constant))][0])
            share = f"{int(constant.sum())} of {len(parts)} rests"
            raise DataError(
                f"accel_{AXES[axis]} is clipped at {value:.4g} in {share}",
                fix=Fix("choose a larger range of the accelerometer"),
            )


def trouble_of(start: FloatArray) -> Finding | None:
    """Return why a start of the gyroscope can't be right, with a way to fix it; None if it can be right."""
    signed = np.sign(np.where(np.abs(start) > 1e-6 * np.abs(start).max(), start, 0.0))
    if not np.array_equal(signed, np.eye(3)):
        return wrong_axes(signed.T)
    scale = float(np.median(1 / np.linalg.norm(start, axis=0)))
    if _IN_DEGREES[0] < scale < _IN_DEGREES[1]:
        return wrong_gyroscope_unit(scale, "deg/s")
    return None


def unusable_turns(data: Triad, rests: RestMeans) -> list[str]:
    """Return why each turn between rests cannot be used, or an empty text."""
    level = np.median(rests.means, axis=0)
    finite = [column[np.isfinite(column)] for column in data.samples.T]
    extremes = [(low, high) for low, high in ((c.min(), c.max()) for c in finite)]
    far = [_FAR * step_of(column) for column in finite]
    reasons = []
    for first, end in zip(rests.spans[:-1, 1], rests.spans[1:, 0], strict=True):
        part = data.samples[first:end]
        clipped = any(
            abs(value - level[axis]) > far[axis] and _repeats(part[:, axis] == value)
            for axis in range(3)
            for value in extremes[axis]
        )
        gap = not np.isfinite(part).all()
        long = len(part) > _LONGEST_TURN_S * data.rate_hz
        reasons.append("gap" if gap else "clipped" if clipped else "long" if long else "")
    return reasons


def _repeats(equal: BoolArray) -> bool:
    return bool(np.convolve(equal, np.ones(_REPEATED), "valid").max(initial=0) >= _REPEATED)
