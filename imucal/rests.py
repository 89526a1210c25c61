"""at_rest: a drive -> the recording of its rests alone, from which one fit learns more than from the longest.

Between rests an IMU is turned, and its bias may differ from one to the next by what gravity, the earth's
rotation and a change of supply do to it. So each rest is put on the level of the longest, and stands for
itself: a fit multiplies the likelihoods of the rests, whose means are free in it, and no difference of the
Allan variance spans two. What the levels say of the slow noise is given up.

A screening takes a log to be mostly at rest; a drive is mostly not. So the yardstick of what is quiet is the
quietest stretch of each axis, and then all windows that are about as quiet.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from imucal.arguments import takes
from imucal.arrays import FloatArray
from imucal.clock import Clock
from imucal.errors import DataError
from imucal.findings import Finding
from imucal.frozen import frozen
from imucal.recording import AxisSeries, Recording, Sensor
from imucal.screening.motion import disturbances_of, rests_between
from imucal.screening.windows import Profile, Windows, profile, quietest, time

__all__ = ["at_rest"]

#: A shorter rest is not used, in s; nor one of fewer samples.
_SHORTEST_S, _FEWEST = 20.0, 128
#: Left out on both sides of a motion, in s, and in samples: a car rocks on its springs for a while, and a fit
#: takes a shorter gap for one of lost samples.
_CLEAR_S, _CLEAR = 2.0, 33
#: Most rests that are used, the longest: a fit keeps so many blocks apart.
_MOST = 48
#: Length of the quietest stretch, in s; windows of less than so many times its variance are quiet.
_STRETCH_S, _QUIET = 10.0, 4.0
#: A rest whose noise has so many times the power of the quietest rest's is shaken, as by an engine.
_SHAKEN = 1.5
#: A gyroscope whose mean is so far from that of the other rests is turned steadily, in rad/s.
_TURNED = math.radians(1.0)


@frozen
class _Stretch:
    """Nothing moved from start to end, in s; `why` it is not used all the same, or an empty text."""

    start_s: float
    end_s: float
    why: str = ""

    @property
    def length_s(self) -> float:
        return self.end_s - self.start_s


@takes('imucal.at_rest(imucal.read("drive.mcap"))', recording=Recording)
def at_rest(recording: Recording) -> Recording:
    """Return the rests of a recording, with gaps where it was moved; a finding says which they are.

    `imucal.characterize` fits them together. A rest lasts at least 20 s, two seconds clear of what moves or
    shakes the IMU. It is not used where its noise is louder than that of the quietest rest, as it is while an
    engine runs, or where the gyroscope turns steadily; and of more than 48 rests the longest are.

    Raises
    ------
    DataError
        If the recording holds no rest.
    """
    profiles = [one for one in (profile(series, _quiet) for series in recording.series) if one.windows.size]
    stretches = _judged(profiles, _stretches(profiles)) if profiles else []
    rests = [one for one in stretches if not one.why]
    duration = max((series.duration_s for series in recording.series), default=0.0)
    if not rests:
        longest = max((one.length_s for one in stretches), default=0.0)
        msg = (
            f"{recording.source.path}: found no rest of at least {_SHORTEST_S:g} s in {time(duration)}, "
            f"the longest being {time(longest)}; leave the IMU alone for longer"
        )
        raise DataError(msg)
    first = rests[0].start_s
    part = recording.between(first, rests[-1].end_s)
    spans = [(one.start_s - first, one.end_s - first) for one in rests]
    clocks: dict[int, Clock] = {}
    cuts = [_cut(series.finite(), spans, clocks) for series in part.series]
    series = tuple(cut for cut in cuts if cut.n)
    return replace(part, series=series, findings=(*part.findings, _finding(stretches, rests, duration)))


def _quiet(windows: Windows) -> Windows:
    """Return the windows of an axis that are about as quiet as its quietest stretch; constant ones aside."""
    count = max(8, round(_STRETCH_S / windows.length_s))
    limit = _QUIET * quietest(windows.variance, count)
    return windows.take((windows.variance > 0) & (windows.variance < limit))


def _stretches(profiles: Sequence[Profile]) -> list[_Stretch]:
    """Return when no axis is moved, in order of time; a gap of the log that parts a fit's blocks ends one."""
    moved = [(one.start_s, one.end_s) for one in disturbances_of(profiles)]
    tau0 = max(p.series.tau0 for p in profiles)
    clear = max(_CLEAR_S, _CLEAR * tau0)
    for clock in {id(p.series.clock): p.series.clock for p in profiles}.values():
        moved += [(g.start_s, g.start_s + g.duration_s) for g in clock.gaps if g.missing > 2 * _CLEAR]
    duration = max(p.series.duration_s for p in profiles)
    shortest = max(_SHORTEST_S, _FEWEST * tau0)
    return [
        _Stretch(start_s=start, end_s=end, why="" if end - start >= shortest else "short")
        for start, end in rests_between(moved, duration, clear_s=clear)
        if end > start
    ]


def _judged(profiles: Sequence[Profile], stretches: Sequence[_Stretch]) -> list[_Stretch]:
    """Return the stretches with why those are not used that are shaken, turned, or too many."""
    long = [one for one in stretches if not one.why]
    if not long:
        return list(stretches)
    loudest, turned = np.ones(len(long)), np.zeros(len(long))
    for p in profiles:
        power, mean = _power_and_mean(p, long)
        told = power[power > 0]
        if not told.size:
            continue
        loudest = np.fmax(loudest, power / told.min())
        if p.series.sensor is Sensor.GYROSCOPE:
            turned = np.fmax(turned, np.abs(mean - np.nanmedian(mean)))
    why = np.where(turned > _TURNED, "turned", np.where(loudest > _SHAKEN, "shaken", ""))
    used = sorted((i for i, word in enumerate(why.tolist()) if not word), key=lambda i: -long[i].length_s)
    why[used[_MOST:]] = "beyond"
    judged = {one: replace(one, why=word) for one, word in zip(long, why.tolist(), strict=True)}
    return [judged.get(one, one) for one in stretches]


def _power_and_mean(p: Profile, stretches: Sequence[_Stretch]) -> tuple[FloatArray, FloatArray]:
    """Return the usual variance of an axis in each stretch, and its mean; NaN where it has no window there.

    Of a coarse axis the variance depends on where between two steps its level lies: a step's square is added.
    """
    found = np.full((2, len(stretches)), np.nan)
    for column, one in zip(found.T, stretches, strict=True):
        inside = (p.windows.time_s >= one.start_s) & (p.windows.end_s <= one.end_s)
        if inside.any():
            column[:] = np.median(p.windows.variance[inside]), p.windows.mean[inside].mean()
    return found[0] + (p.lsb or 0.0) ** 2, found[1]


def _cut(series: AxisSeries, spans: Sequence[tuple[float, float]], clocks: dict[int, Clock]) -> AxisSeries:
    """Return the samples of some spans of time, in s from the first sample, all on the longest one's level.

    Axes that shared a clock share what is left of it, which is kept in `clocks`: one clock is one object.
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


#: Why a stretch is not used -> what the finding says of such.
_WORDS = {
    "short": f"shorter than {_SHORTEST_S:g} s",
    "shaken": "with more noise than the quietest, as from a running engine",
    "turned": "with a steady rotation",
    "beyond": f"not among the {_MOST} longest",
}


def _finding(stretches: Sequence[_Stretch], rests: Sequence[_Stretch], duration: float) -> Finding:
    """Return the note on which rests are used, and what is not and why."""
    total = sum(one.length_s for one in rests)
    begins = ", ".join(f"{one.start_s:.1f} s ({time(one.length_s)})" for one in rests)
    moving = duration - sum(one.length_s for one in stretches)
    text = (
        f"The fit uses {_rests(len(rests))}, {time(total)} of {time(duration)}, starting at {begins}. Each "
        "rest has its own level; no average spans two rests."
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
        yield f"{time(moving)} of motion or vibration"
    for why, words in _WORDS.items():
        own = [one.length_s for one in stretches if one.why == why]
        if own:
            yield f"{_rests(len(own))} {words} ({time(sum(own))} in all)"
