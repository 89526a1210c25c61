"""The row of the range: motion that is cut off at the limit of an axis."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, IntArray
from imucal.health.diagnosis import Question, Row, Values
from imucal.recording import Sensor
from imucal.screening.windows import Profile, amount

__all__ = ["range_row"]

_CHECK = "Check the driver."

#: Samples in a row at the extreme value: a peak of a motion has one or two.
_IN_A_ROW = 3
#: Number of such runs, unless one is long: a held sample at a peak is one.
_RUNS = 2
#: Length of a single run that is enough, in samples.
_LONG_RUN = 12
#: Median change just before and after a run, in steps of the axis; at rest it is one step.
_ABRUPT_STEPS = 3.0
#: Least share of an axis's span between its median and a limit: an axis that rests there is not clipped.
_AWAY = 0.15


@dataclass(frozen=True, kw_only=True)
class _Clip:
    name: str
    sensor: Sensor
    word: str
    limit: float
    samples: int
    first_s: float


def range_row(profiles: Sequence[Profile]) -> Row:
    """Return the row of clipped axes."""
    question = Question("range", "saturated")
    alive = [p for p in profiles if not p.constant]
    if not alive:
        return question.answer("unknown", "no axis has data", "Check the driver.")
    limits = [_clip(p, word) for p in alive for word in ("highest", "lowest")]
    clips = [clip for clip in limits if clip is not None]
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
        found += f"; so {'is' if len(others) == 1 else 'are'} {', '.join(others)}"
    advice = "Choose a larger range of the sensor: a filter integrates the missing part of each peak."
    return question.answer("fail", found, advice, values=largest)


def _peak(p: Profile) -> float:
    return float(max(abs(p.windows.high.max()), abs(p.windows.low.min())))


def _peaks(alive: Sequence[Profile]) -> list[str]:
    """Return the largest value of each sensor as text."""
    peaks: dict[Sensor, float] = {}
    for p in alive:
        peaks[p.series.sensor] = max(_peak(p), peaks.get(p.series.sensor, 0.0))
    return [f"{sensor.short} {amount(value, sensor)}" for sensor, value in peaks.items()]


def _clip(p: Profile, word: str) -> _Clip | None:
    samples = p.series.samples
    limit = float(samples.max() if word == "highest" else samples.min())
    # 32-bit values of one limit may differ by rounding.
    at_limit = np.abs(samples - limit) <= 1e-6 * abs(limit)
    flags = np.diff(np.concatenate([[0], at_limit.view(np.int8), [0]]))
    firsts, ends = np.flatnonzero(flags == 1), np.flatnonzero(flags == -1)
    lengths = ends - firsts
    runs = lengths >= _IN_A_ROW
    if runs.sum() < _RUNS and (not lengths.size or lengths.max() < _LONG_RUN):
        return None
    span = float(samples.max() - samples.min())
    if abs(limit - float(np.median(samples))) < _AWAY * span:
        return None
    steps = _changes(samples, firsts[runs], ends[runs], limit)
    smallest = p.lsb if p.lsb is not None else 0.0
    if not steps.size or float(np.median(steps)) < max(_ABRUPT_STEPS * smallest, 1e-4 * span):
        return None
    first = int(firsts[runs][0])
    place = int(p.series.clock.grid(first, first + 1)[0])
    return _Clip(
        name=p.name,
        sensor=p.series.sensor,
        word=word,
        limit=limit,
        samples=int(lengths[runs].sum()),
        first_s=place * p.series.tau0,
    )


def _changes(samples: FloatArray, firsts: IntArray, ends: IntArray, limit: float) -> FloatArray:
    """Return the distances from the limit of the samples before and after its runs."""
    before, after = firsts[firsts > 0] - 1, ends[ends < samples.size]
    return np.asarray(np.abs(samples[np.concatenate([before, after])] - limit))
