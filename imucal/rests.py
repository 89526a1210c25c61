"""at_rest: a drive -> a recording of its rests, whose joint fit is more precise than the longest rest's.

The mean of an axis differs between rests because of gravity, the earth's rotation and changes of the supply.
So each rest is shifted to the level of the longest, and has a free mean in the fit. No difference of the
Allan variance spans two rests. Unlike in a screening, the reference is the quietest stretch of each axis,
because a drive is not mostly at rest.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import FloatArray
from imucal.clock import Clock
from imucal.errors import DataError
from imucal.findings import Finding
from imucal.recording import AxisSeries, Recording, Sensor
from imucal.screening.motion import disturbances_of, rests_between
from imucal.screening.windows import Profile, Windows, profile, quietest
from imucal.units import duration

__all__ = ["at_rest"]

#: Minimum length of a rest, in s.
_SHORTEST_S = 20.0
#: Minimum length of a rest, in samples.
_MIN_SAMPLES = 128
#: Time omitted on both sides of a motion, in s: a car rocks for a while.
_CLEAR_S = 2.0
#: The same in samples: the fit treats shorter gaps as lost samples.
_CLEAR = 33
#: The longest rests; the fit has at most this many blocks.
_MAX_RESTS = 48
#: Length of the quietest stretch, in s.
_STRETCH_S = 10.0
#: A window is quiet below this multiple of the variance of the quietest stretch.
_QUIET = 4.0
#: A rest is shaken above this multiple of the quietest rest's noise power.
_SHAKEN = 1.5
#: A gyroscope turns steadily if its mean differs this much from the other rests, in rad/s.
_TURNED = math.radians(1.0)


@dataclass(frozen=True, kw_only=True)
class _Stretch:
    """A time without motion; `why` it is not used, or an empty text."""

    start_s: float
    end_s: float
    why: str = ""

    @property
    def length_s(self) -> float:
        return self.end_s - self.start_s


def at_rest(recording: Recording) -> Recording:
    """Return the rests of a recording, with gaps between them; a finding lists them.

    `imucal.fit` fits them together. A rest lasts at least 20 s and begins and ends two seconds away
    from any motion. A rest is not used if it has more noise than the quietest one, for example from a running
    engine, or if the gyroscope turns steadily. At most 48 rests are used, the longest ones.

    Raises
    ------
    DataError
        If the recording contains no rest.
    """
    profiles = [one for one in (profile(series, _quiet) for series in recording.series) if one.windows.size]
    stretches = _judged(profiles, _stretches(profiles)) if profiles else []
    rests = [one for one in stretches if not one.why]
    duration_s = max((series.duration_s for series in recording.series), default=0.0)
    if not rests:
        longest = max((one.length_s for one in stretches), default=0.0)
        msg = (
            f"found no rest of at least {_SHORTEST_S:g} s in {duration(duration_s)}, "
            f"the longest being {duration(longest)}; leave the IMU alone for longer"
        )
        raise DataError(msg, place=recording.source.path)
    first = rests[0].start_s
    part = recording.between(first, rests[-1].end_s)
    spans = [(one.start_s - first, one.end_s - first) for one in rests]
    clocks: dict[int, Clock] = {}
    cuts = [_cut(series.finite(), spans, clocks) for series in part.series]
    series = tuple(cut for cut in cuts if cut.n)
    return replace(part, series=series, findings=(*part.findings, _finding(stretches, rests, duration_s)))


def _quiet(windows: Windows) -> Windows:
    """Return the non-constant windows that are about as quiet as the quietest stretch."""
    count = max(8, round(_STRETCH_S / windows.length_s))
    limit = _QUIET * quietest(windows.variance, count)
    return windows.take((windows.variance > 0) & (windows.variance < limit))


def _stretches(profiles: Sequence[Profile]) -> list[_Stretch]:
    """Return the times without motion of any axis; a gap between blocks of a fit ends one."""
    moved = [(one.start_s, one.end_s) for one in disturbances_of(profiles)]
    tau0 = max(p.series.tau0 for p in profiles)
    clear = max(_CLEAR_S, _CLEAR * tau0)
    for clock in {id(p.series.clock): p.series.clock for p in profiles}.values():
        moved += [(g.start_s, g.start_s + g.duration_s) for g in clock.gaps if g.missing > 2 * _CLEAR]
    duration_s = max(p.series.duration_s for p in profiles)
    shortest = max(_SHORTEST_S, _MIN_SAMPLES * tau0)
    return [
        _Stretch(start_s=start, end_s=end, why="" if end - start >= shortest else "short")
        for start, end in rests_between(moved, duration_s, clear_s=clear)
        if end > start
    ]


def _judged(profiles: Sequence[Profile], stretches: Sequence[_Stretch]) -> list[_Stretch]:
    """Add the reason to stretches that are shaken, turned, or too many."""
    long = [one for one in stretches if not one.why]
    if not long:
        return list(stretches)
    loudest, turned = np.ones(len(long)), np.zeros(len(long))
    for p in profiles:
        power, mean = _power_and_mean(p, long)
        positive = power[power > 0]
        if not positive.size:
            continue
        loudest = np.fmax(loudest, power / positive.min())
        if p.series.sensor is Sensor.GYROSCOPE:
            turned = np.fmax(turned, np.abs(mean - np.nanmedian(mean)))
    why = np.where(turned > _TURNED, "turned", np.where(loudest > _SHAKEN, "shaken", ""))
    used = sorted((i for i, word in enumerate(why.tolist()) if not word), key=lambda i: -long[i].length_s)
    why[used[_MAX_RESTS:]] = "beyond"
    judged = {one: replace(one, why=word) for one, word in zip(long, why.tolist(), strict=True)}
    return [judged.get(one, one) for one in stretches]


def _power_and_mean(p: Profile, stretches: Sequence[_Stretch]) -> tuple[FloatArray, FloatArray]:
    """Return the median variance and the mean of an axis in each stretch; NaN without a window.

    The variance of a coarse axis depends on its level between two steps, so the square of a step is added.
    """
    found = np.full((2, len(stretches)), np.nan)
    for column, one in zip(found.T, stretches, strict=True):
        inside = (p.windows.time_s >= one.start_s) & (p.windows.end_s <= one.end_s)
        if inside.any():
            column[:] = np.median(p.windows.variance[inside]), p.windows.mean[inside].mean()
    return found[0] + (p.lsb or 0.0) ** 2, found[1]


def _cut(series: AxisSeries, spans: Sequence[tuple[float, float]], clocks: dict[int, Clock]) -> AxisSeries:
    """Return the samples in `spans`, in s from the first sample, shifted to the level of the longest.

    `clocks` contains the shortened clocks: axes that share a clock still share one.
    """
    places = [(series.clock.index_at(start), series.clock.index_at(end)) for start, end in spans]
    keep = np.zeros(series.n, dtype=bool)
    samples = series.samples.copy()
    level = None
    for first, stop in sorted(places, key=lambda place: place[0] - place[1]):
        if stop > first:
            keep[first:stop] = True
            mean = float(samples[first:stop].mean())
            level = mean if level is None else level
            samples[first:stop] += level - mean
    clock = clocks.setdefault(id(series.clock), replace(series.clock.keeping(keep), apart=True))
    return replace(series, samples=samples[keep], clock=clock)


_REASONS = {
    "short": f"shorter than {_SHORTEST_S:g} s",
    "shaken": "with more noise than the quietest, as from a running engine",
    "turned": "with a steady rotation",
    "beyond": f"not among the {_MAX_RESTS} longest",
}


def _finding(stretches: Sequence[_Stretch], rests: Sequence[_Stretch], duration_s: float) -> Finding:
    total = sum(one.length_s for one in rests)
    begins = ", ".join(f"{one.start_s:.1f} s ({duration(one.length_s)})" for one in rests)
    moving = duration_s - sum(one.length_s for one in stretches)
    text = (
        f"The fit uses {_rests(len(rests))}, {duration(total)} of {duration(duration_s)}, starting at "
        f"{begins}. Each rest has its own level; no average spans two rests."
    )
    if left := "; ".join(_left_out(stretches, moving)):
        text += f" Left out: {left}."
    if rests[0].start_s > 0:
        text += f" Other times count from the start of the first rest, {rests[0].start_s:.1f} s."
    return Finding("info", "rests", text)


def _rests(count: int) -> str:
    return f"{count} rest{'' if count == 1 else 's'}"


def _left_out(stretches: Sequence[_Stretch], moving: float) -> Iterator[str]:
    if moving > 0:
        yield f"{duration(moving)} of motion or vibration"
    for why, words in _REASONS.items():
        own = [one.length_s for one in stretches if one.why == why]
        if own:
            yield f"{_rests(len(own))} {words} ({duration(sum(own))} in all)"
