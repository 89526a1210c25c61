"""The row of the range: motion that is cut off at the limit of an axis."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.health.diagnosis import Question, Row, Values
from imucal.health.evidence import Evidence, Limit, near, samples_shown
from imucal.recording import Sensor
from imucal.screening.windows import Profile, amount, name_list

__all__ = ["clipped_values", "range_row"]

_CHECK = "Check the driver."

#: Samples in a row at the extreme value: a peak of a motion has one or two.
_IN_A_ROW = 3
#: Number of such runs, unless one is long: a held sample at a peak is one.
_RUNS = 2
#: Length of a single run that is enough, in samples.
_LONG_RUN = 12
#: Fewest samples at a limit that vibration reaches for one or two samples at a time.
_PILED = 10
#: Steps within a limit whose samples are counted: without clipping, a sine has 2.3 times as many there.
_INSIDE_STEPS = 10
#: Least ratio of the samples at a limit to those just within it.
_PILED_RATIO = 1.5
#: Smallest difference of two samples that counts, as a share of an axis's span.
_FINEST = 1e-4
#: Median change just before and after a run, in steps of the axis; at rest it is one step.
_ABRUPT_STEPS = 3.0
#: Least share of an axis's span between its median and a limit: an axis that rests there is not clipped.
_AWAY = 0.15


@dataclass(frozen=True, kw_only=True)
class _Clip:
    """Samples at a limit: `samples` of them; `longest` is the first index and the end of the longest run."""

    profile: Profile
    word: str
    limit: float
    samples: int
    first_s: float
    longest: tuple[int, int]

    @property
    def name(self) -> str:
        return self.profile.name

    @property
    def sensor(self) -> Sensor:
        return self.profile.series.sensor


def range_row(profiles: Sequence[Profile]) -> Row:
    """Return the row of clipped axes."""
    question = Question("range", "saturated")
    alive = [p for p in profiles if not p.constant]
    if not alive:
        return question.answer("unknown", "no axis has data", _CHECK)
    clips = [clip for p in alive for clip in _clips(p)]
    largest: Values = {p.name: _peak(p) for p in alive}
    if not clips:
        found = f"no axis stays at an extreme value; the largest are {' and '.join(_peaks(alive))}"
        return question.answer("pass", found, values=largest)
    worst = max(clips, key=lambda clip: clip.samples)
    limit = amount(worst.limit, worst.sensor)
    found = (
        f"{worst.name} is at its {worst.word} value, {limit}, {worst.samples} times: it is saturated, "
        f"first at {worst.first_s:.1f} s"
    )
    others = sorted({clip.name for clip in clips} - {worst.name})
    if others:
        found += f"; so {'is' if len(others) == 1 else 'are'} {name_list(others)}"
    advice = "Choose a larger range of the sensor: a filter integrates the missing part of each peak."
    return question.answer("fail", found, advice, values=largest, evidence=_evidence(worst))


def _evidence(clip: _Clip) -> Evidence:
    series = clip.profile.series
    first, stop = clip.longest
    shown = samples_shown(
        [series],
        near(first, stop, series.n),
        bad=np.flatnonzero(_at_limit(series.samples, clip.limit)),
        bad_label=f"at the {clip.word} value",
        title=f"the longest time of {clip.name} at its {clip.word} value",
    )
    return replace(shown, limits=(Limit(label=f"{clip.limit:.4g} {series.unit}", value=clip.limit),))


def _at_limit(samples: FloatArray, limit: float) -> BoolArray:
    # 32-bit values of one limit may differ by rounding.
    return np.asarray(np.abs(samples - limit) <= 1e-6 * abs(limit))


def clipped_values(p: Profile) -> tuple[float, ...]:
    """Return the limits at which an axis is clipped."""
    return tuple(clip.limit for clip in _clips(p))


def _clips(p: Profile) -> tuple[_Clip, ...]:
    clips = (_clip(p, word) for word in ("highest", "lowest"))
    return tuple(clip for clip in clips if clip is not None)


def _peak(p: Profile) -> float:
    return float(max(abs(p.windows.high.max()), abs(p.windows.low.min())))


def _peaks(alive: Sequence[Profile]) -> list[str]:
    """Return the largest value of each sensor as text."""
    peaks: dict[Sensor, float] = {}
    for p in alive:
        peaks[p.series.sensor] = max(_peak(p), peaks.get(p.series.sensor, 0.0))
    return [f"{amount(value, sensor)} of the {sensor}" for sensor, value in peaks.items()]


def _clip(p: Profile, word: str) -> _Clip | None:
    samples = p.series.samples
    limit = float(samples.max() if word == "highest" else samples.min())
    at_limit = _at_limit(samples, limit)
    flags = np.diff(np.concatenate([[0], at_limit.view(np.int8), [0]]))
    firsts, ends = np.flatnonzero(flags == 1), np.flatnonzero(flags == -1)
    lengths = ends - firsts
    runs = lengths >= _IN_A_ROW
    span = float(samples.max() - samples.min())
    smallest = p.lsb if p.lsb is not None else 0.0
    if runs.sum() < _RUNS and (not lengths.size or lengths.max() < _LONG_RUN):
        if not _is_piled(samples, at_limit, limit, max(smallest, _FINEST * span)):
            return None
        runs = lengths > 0
    if abs(limit - float(np.median(samples))) < _AWAY * span:
        return None
    steps = _changes(samples, firsts[runs], ends[runs], limit)
    if not steps.size or float(np.median(steps)) < max(_ABRUPT_STEPS * smallest, _FINEST * span):
        return None
    first = int(firsts[runs][0])
    place = int(p.series.clock.grid(first, first + 1)[0])
    longest = int(lengths.argmax())
    return _Clip(
        profile=p,
        word=word,
        limit=limit,
        samples=int(lengths[runs].sum()),
        first_s=place * p.series.tau0,
        longest=(int(firsts[longest]), int(ends[longest])),
    )


def _is_piled(samples: FloatArray, at_limit: BoolArray, limit: float, step: float) -> bool:
    """Return whether an axis is far more often at a limit than just within it, as clipped peaks are."""
    count = int(at_limit.sum())
    if count < _PILED:
        return False
    near_limit = np.abs(samples - limit) <= (_INSIDE_STEPS + 0.5) * step
    return bool(count > _PILED_RATIO * (int(near_limit.sum()) - count))


def _changes(samples: FloatArray, firsts: IntArray, ends: IntArray, limit: float) -> FloatArray:
    """Return the distances from the limit of the samples before and after its runs."""
    before, after = firsts[firsts > 0] - 1, ends[ends < samples.size]
    return np.asarray(np.abs(samples[np.concatenate([before, after])] - limit))
