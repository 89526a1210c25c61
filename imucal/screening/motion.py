"""Was the IMU at rest? Checks for hand-held logs, touches, motion at the ends and a changed pose."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.findings import Finding, Level
from imucal.recording import Sensor
from imucal.screening.values import gravity, shaken
from imucal.screening.windows import Profile, amount, name_list, span, usual_variance
from imucal.units import duration

#: Gap below which disturbances are joined, in s.
_APART_S = 3.0
#: Quiet time removed on both sides of a disturbance, in s.
_SETTLE_S = 1.0
#: Shortest rest worth keeping, in s.
_WORTH_S = 5.0
#: Disturbed fraction of a log above which it was not at rest.
_MOVING = 0.2
#: Fraction of the log that belongs to its start or end.
_ENDS = 0.1
#: Ratio of the disturbances' energy to the noise's above which they are an error.
_LOUDER = 1.0
#: Change of gravity's direction, in degrees, that is a turn and no drift.
_TURN_DEG = 2.0
#: Number of windows that are averaged for a pose.
_POSE_WINDOWS = 5
#: Smallest gravity, in U, whose direction is known.
_MIN_GRAVITY = 0.5

#: Band of a hand, a walking person or an engine, in Hz.
_BAND_HZ = (0.5, 10.0)
#: Rate in the band, in rad/s rms: ten times that of a poor gyroscope at rest.
_LOUD = 3e-3
#: Shortest transformed stretch, in samples.
_SHORTEST = 256
#: Longest transformed stretch, in samples.
_LONGEST = 16384
#: Least number of stretches of a usable log.
_MIN_STRETCHES = 4
#: Number of stretches that a short log is divided into.
_USUAL_STRETCHES = 16
#: Largest number of stretches; they are spread over a long log.
_MAX_STRETCHES = 256
#: Density in the band over that in the upper half of frequencies of coloured noise.
_COLOURED = 8.0


@dataclass(frozen=True)
class Disturbance:
    """A disturbance of some axes; `factor` is its peak level over their noise."""

    start_s: float
    end_s: float
    axes: tuple[str, ...]
    factor: float

    def words(self) -> str:
        loudest = f"{self.factor:.0f} times the noise" if self.factor >= 2 else "a shift of the level"
        return f"{span(self.start_s, self.end_s)} ({name_list(list(self.axes))}; {loudest})"


def check_shaken(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return an error if an accelerometer without gravity moves."""
    if not (found := shaken(profiles)):
        return ()
    axis, deviation = found
    text = (
        f"The IMU was not at rest: {axis} has a standard deviation of "
        f"{amount(deviation, Sensor.ACCELEROMETER)}, and the accelerometer shows no gravity."
    )
    advice = "This looks like linear acceleration of a moving device. Record the raw acceleration at rest."
    return (Finding("error", "motion", text, advice),)


def check_tremor(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return an error if two axes of the gyroscope are shaken all the time.

    The limits are absolute because there is no quiet part for comparison.
    """
    shaken = [(p, rms) for p in profiles if p.series.sensor is Sensor.GYROSCOPE and (rms := _tremor(p))]
    if len(shaken) < 2:
        return ()
    worst, rms = max(shaken, key=lambda pair: pair[1])
    low, high = _BAND_HZ
    text = (
        f"The IMU was not at rest: {worst.name} moves by {amount(rms, Sensor.GYROSCOPE)} rms between {low:g} "
        f"and {high:g} Hz, as in a hand or on a running machine."
    )
    advice = "Record again with the IMU on a firm, quiet surface; these numbers are not its noise."
    return (Finding("error", "motion", text, advice),)


def _tremor(profile: Profile) -> float:
    """Return the rms rate in the band, in rad/s, if it is loud and coloured; if not, 0."""
    low, high = _BAND_HZ
    if 4 * high > profile.series.rate_hz or (psd := density_at_rest(profile)) is None:
        return 0.0
    frequency = np.linspace(0, profile.series.rate_hz / 2, psd.size)
    band = (frequency >= low) & (frequency <= high)
    if not band.any():
        return 0.0
    rms = float(np.sqrt(2 * psd[band].sum() * frequency[1]))
    coloured = psd[band].mean() > _COLOURED * psd[frequency > frequency[-1] / 2].mean()
    return rms if rms > _LOUD and coloured else 0.0


def density_at_rest(profile: Profile) -> FloatArray | None:
    """Return the two-sided density, in U²/Hz, of stretches without gaps and disturbances.

    It has equal spacing from 0 to the Nyquist frequency. None if fewer than four stretches of 256 samples
    fit.

    Source: Welch (1967), IEEE Trans. Audio Electroacoust. 15(2).
    """
    series, size = profile.series, _LONGEST
    while size > _SHORTEST and size * _USUAL_STRETCHES > series.n:
        size //= 2
    while (starts := _stretches(profile, size)).size < _MIN_STRETCHES:
        size //= 2
        if size < _SHORTEST:
            return None
    if starts.size > _MAX_STRETCHES:
        starts = starts[np.linspace(0, starts.size - 1, _MAX_STRETCHES).astype(np.int64)]
    taper = np.hanning(size + 1)[:-1]
    power = np.zeros(size // 2 + 1)
    for start in starts.tolist():
        samples = series.samples[start : start + size]
        transform = np.fft.rfft((samples - samples.mean()) * taper)
        power += transform.real**2 + transform.imag**2
    return power * (series.tau0 / (starts.size * (taper @ taper)))


def _stretches(profile: Profile, size: int) -> IntArray:
    windows, segments = profile.windows, profile.series.clock.segments
    avoid = windows.start[profile.disturbed]
    starts = [np.arange(s.start, s.stop - size + 1, size // 2) for s in segments if s.size >= size]
    every = np.concatenate([np.zeros(0, dtype=np.int64), *starts])
    before = np.searchsorted(avoid, every - windows.width, side="right")
    return np.asarray(every[np.searchsorted(avoid, every + size) == before])


def check_motion(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return findings for disturbances on any axis, with the part worth keeping."""
    disturbances = disturbances_of(profiles)
    if not disturbances:
        return ()
    duration_s = max(p.series.duration_s for p in profiles)
    keep = _longest_rest(disturbances, duration_s)
    moving = sum(d.end_s - d.start_s for d in disturbances) / duration_s
    if moving > _MOVING or keep is None:
        hopeless = moving > 0.5 or keep is None
        level: Level = "error" if hopeless else _level(profiles, disturbances, duration_s)
        return (_not_at_rest(disturbances, moving, keep, level),)
    ends = [d for d in disturbances if d.end_s < _ENDS * duration_s or d.start_s > (1 - _ENDS) * duration_s]
    middle = [d for d in disturbances if d not in ends]
    moved = (_moved(ends, _level(profiles, ends, duration_s), duration_s, keep),) if ends else ()
    return (*moved, _touched(middle, _level(profiles, middle, duration_s), keep)) if middle else moved


def _moved(ends: list[Disturbance], level: Level, duration_s: float, keep: tuple[float, float]) -> Finding:
    sides = name_list(list(dict.fromkeys("start" if d.start_s < duration_s / 2 else "end" for d in ends)))
    text = f"The IMU was moved near the {sides} of the log: {_listed(ends)}."
    return Finding(level, "motion", text, "Leave this part out.", keep_s=keep)


def _touched(middle: list[Disturbance], level: Level, keep: tuple[float, float]) -> Finding:
    text = f"Something touched or shook the IMU {_times(len(middle))}: {_listed(middle)}."
    advice = "Record again undisturbed, or keep an undisturbed part."
    return Finding(level, "touch", text, advice, keep_s=keep)


def check_turned(profiles: Sequence[Profile]) -> tuple[Finding, ...]:
    """Return an error if gravity changes its direction: the IMU rested in two poses."""
    accel = [p for p in profiles if p.series.sensor is Sensor.ACCELEROMETER]
    if gravity(accel) is None:
        return ()
    rest = ~np.any([p.disturbed for p in accel], axis=0)
    down = np.stack([p.windows.mean[rest] for p in accel], axis=1)
    seconds = accel[0].windows.time_s[rest]
    keep = _longest_rest(disturbances_of(profiles), accel[0].series.duration_s)
    start, end = keep or (0.0, np.inf)
    kept = (seconds >= start) & (seconds < end)
    if down.shape[0] < _POSE_WINDOWS or not kept.any():
        return ()
    even = np.full(_POSE_WINDOWS, 1 / _POSE_WINDOWS)
    smooth = np.stack([np.convolve(column, even, "valid") for column in down.T], axis=1)
    usual = down[kept].mean(axis=0)
    lengths = np.linalg.norm(smooth, axis=1) * np.linalg.norm(usual)
    if not lengths.min() > 0 or np.linalg.norm(usual) < _MIN_GRAVITY:
        return ()
    angles = np.degrees(np.arccos(np.clip(smooth @ usual / lengths, -1, 1)))
    if angles.max() < _TURN_DEG:
        return ()
    turn = int(np.linalg.norm(np.diff(down, axis=0), axis=1).argmax())
    text = (
        f"The IMU was turned by up to {angles.max():.0f} degrees, mostly near {seconds[turn]:.1f} s: the "
        "direction of gravity changes."
    )
    advice = "Record again in one pose."
    return (Finding("error", "motion", text, advice, keep_s=keep),)


def disturbances_of(profiles: Sequence[Profile]) -> list[Disturbance]:
    """Return the disturbances of any axis in order of time; close ones are joined."""
    spans = [
        (float(start), float(end), profile.name, factor)
        for profile in profiles
        for start, end, factor in _spans(profile)
    ]
    joined: list[Disturbance] = []
    for start, end, name, factor in sorted(spans):
        if joined and start < joined[-1].end_s + _APART_S:
            last = joined[-1]
            axes = tuple(dict.fromkeys((*last.axes, name)))
            joined[-1] = Disturbance(last.start_s, max(last.end_s, end), axes, max(last.factor, factor))
        else:
            joined.append(Disturbance(start, end, (name,), factor))
    return joined


def _spans(profile: Profile) -> list[tuple[float, float, float]]:
    """Return start, end and level over the noise of each run of disturbed windows."""
    windows, marks = profile.windows, profile.disturbed
    if not marks.any():
        return []
    steps = np.diff(np.concatenate([[0], marks.astype(np.int8), [0]]))
    firsts, lasts = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1) - 1
    scale = _scale(profile)
    spans = []
    for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True):
        loudest = windows.variance[first : last + 1].max()
        factor = float(np.sqrt(loudest / scale)) if scale > 0 else float("inf")
        spans.append((windows.time_s[first], windows.end_s[last], factor))
    return spans


def _level(profiles: Sequence[Profile], disturbances: list[Disturbance], duration_s: float) -> Level:
    loud = any(_power(profile, disturbances) > _LOUDER * duration_s for profile in profiles)
    return "error" if loud else "warning"


def _power(profile: Profile, disturbances: list[Disturbance]) -> float:
    """Return the energy of disturbances on an axis, as the time, in s, in which its noise has as much.

    It includes the variance within windows, and means beyond the range of the undisturbed windows.
    """
    windows, scale = profile.windows, _scale(profile)
    within = np.zeros(windows.size, dtype=bool)
    for each in disturbances:
        within |= (windows.time_s >= each.start_s) & (windows.end_s <= each.end_s)
    rest = ~(within | profile.disturbed)
    if not (rest.any() and scale > 0):
        return 0.0
    away = np.abs(windows.mean - np.median(windows.mean[rest]))
    beyond = np.maximum(0.0, away - away[rest].max())
    excess = (windows.variance + beyond**2)[within] / scale - 1
    return float(np.maximum(excess, 0.0).sum()) * windows.length_s


def _scale(profile: Profile) -> float:
    """Return the variance of a quiet window, in U²; at least that of rounding."""
    return max(usual_variance(profile.windows), (profile.lsb or 0.0) ** 2 / 12)


def _longest_rest(disturbances: list[Disturbance], duration_s: float) -> tuple[float, float] | None:
    """Return the longest rest, in s, a second clear of disturbances; None if all are short."""
    rests = rests_between([(d.start_s, d.end_s) for d in disturbances], duration_s, clear_s=_SETTLE_S)
    start, end = max(rests, key=lambda rest: rest[1] - rest[0])
    return (round(start, 1), round(end, 1)) if end - start >= _WORTH_S else None


def rests_between(
    disturbed: Sequence[tuple[float, float]], duration_s: float, *, clear_s: float
) -> list[tuple[float, float]]:
    """Return start and end of each rest, in s, `clear_s` away from disturbances; some may be empty."""
    rests, begin = [], 0.0
    for start, end in sorted(disturbed):
        rests.append((begin, start - clear_s))
        begin = max(begin, end + clear_s)
    return [*rests, (begin, duration_s)]


def _not_at_rest(
    disturbances: list[Disturbance], moving: float, keep: tuple[float, float] | None, level: Level
) -> Finding:
    text = f"The IMU was not at rest: it moved {_times(len(disturbances))}, {moving:.0%} of the log; "
    advice = "Record again with the IMU on a firm, quiet surface"
    if keep is None:
        text += f"it never rested for {_WORTH_S:g} s."
    else:
        text += f"the longest rest is {duration(keep[1] - keep[0])}."
    return Finding(level, "motion", text, f"{advice}.", keep_s=keep)


def _listed(disturbances: list[Disturbance]) -> str:
    loudest = sorted(disturbances, key=lambda d: d.factor, reverse=True)[:3]
    words = "; ".join(d.words() for d in sorted(loudest, key=lambda d: d.start_s))
    more = len(disturbances) - len(loudest)
    return f"{words}; and {more} more" if more else words


def _times(count: int) -> str:
    return {1: "once", 2: "twice"}.get(count, f"{count} times")
