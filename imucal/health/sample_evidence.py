"""Evidence of the rows of samples: the samples around the first or the clearest bad place."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.health.evidence import Evidence, near, samples_shown
from imucal.recording import AxisSeries
from imucal.screening.values import copied_pairs, held_samples, midway_samples
from imucal.screening.windows import Profile

__all__ = [
    "copied",
    "dead",
    "held",
    "interleaved",
    "interpolated",
    "not_finite",
    "spiked",
    "stuck",
]

#: Samples of a picture in which single ones must be seen.
_FEW = 60
#: Samples of a picture of a motion.
_MANY = 500


def stuck(p: Profile) -> Evidence:
    """Return the first part in which an axis has one value."""
    frozen = p.windows.low == p.windows.high
    start, stop = _run(p.series.samples, int(p.windows.start[int(frozen.argmax())]))
    title = f"{p.name} stays at one value for {(stop - start) * p.series.tau0:.2g} s"
    bad = np.arange(start, stop)
    return samples_shown(
        [p.series], near(start, stop, p.series.n), bad=bad, bad_label="one value", title=title
    )


def _run(samples: FloatArray, place: int) -> tuple[int, int]:
    """Return the first index and the end of the samples around a place that are equal."""
    different = np.flatnonzero(samples != samples[place])
    after = int(np.searchsorted(different, place))
    start = int(different[after - 1]) + 1 if after else 0
    stop = int(different[after]) if after < different.size else samples.size
    return start, stop


def dead(p: Profile, axes: Sequence[Profile]) -> Evidence:
    """Return an axis that never changes, with the other axes of the sensor, around the fastest motion."""
    others = [one for one in axes if one.name != p.name and one.series.n == p.series.n]
    moves = [one for one in others if one.windows.size]
    place = 0
    if moves:
        loudest = max(moves, key=lambda one: float(one.windows.variance.max()))
        place = int(loudest.windows.start[int(loudest.windows.variance.argmax())])
    title = f"{p.name} never changes"
    series = [p.series, *(one.series for one in others)]
    return samples_shown(series, _centred(place, _MANY, p.series.n), title=title)


def not_finite(series: AxisSeries) -> Evidence | None:
    """Return the first sample that is no number, between its neighbours."""
    usable = series.usable
    bad = np.flatnonzero(~usable)
    if not usable.any() or not bad.size:
        return None
    good = np.flatnonzero(usable)
    between = np.interp(np.arange(series.n), good, series.samples[good])
    shown = replace(series, samples=np.where(usable, series.samples, np.nan))
    return samples_shown(
        [shown],
        _centred(int(bad[0]), _FEW, series.n),
        bad=bad,
        bad_label="NaN, infinite or absurd",
        heights=between,
        title=f"the first of {bad.size} samples of {series.name} that are not finite",
    )


def held(axes: Sequence[Profile]) -> Evidence | None:
    """Return samples that repeat the previous one on all axes, where the sensor moves fastest."""
    repeats = [held_samples(p.series.samples) for p in axes]
    bad = np.flatnonzero(np.logical_and.reduce(repeats)) + 1
    title = f"{axes[0].series.sensor} samples that repeat the previous one on all axes"
    return _fastest(axes, bad, bad_label=f"repeated ({axes[0].series.axis})", title=title)


def interpolated(axes: Sequence[Profile]) -> Evidence | None:
    """Return samples midway between their neighbours on all axes, where the sensor moves fastest."""
    midway: list[BoolArray] = [midway_samples(p, p.series.samples) for p in axes]
    bad = np.flatnonzero(np.logical_and.reduce(midway)) + 1
    title = f"{axes[0].series.sensor} samples midway between their neighbours on all axes"
    return _fastest(axes, bad, bad_label=f"on a line ({axes[0].series.axis})", title=title)


def _fastest(axes: Sequence[Profile], bad: IntArray, *, bad_label: str, title: str) -> Evidence | None:
    """Return the axes around the bad sample with the fastest motion."""
    size = axes[0].series.n
    inner = bad[(bad > 1) & (bad < size - 2)]
    if not inner.size:
        return None
    speed = np.sum([np.abs(p.series.samples[inner + 2] - p.series.samples[inner - 2]) for p in axes], axis=0)
    place = int(inner[int(speed.argmax())])
    return samples_shown(
        [p.series for p in axes], _centred(place, _FEW, size), bad=bad, bad_label=bad_label, title=title
    )


def spiked(p: Profile, places: IntArray) -> Evidence:
    """Return the samples around the largest spike of an axis."""
    samples = p.series.samples
    heights = np.abs(samples[places] - samples[places - 1])
    worst = int(places[int(heights.argmax())])
    title = f"the largest of {places.size} spikes of {p.name}"
    part = _centred(worst, 3 * _FEW, p.series.n)
    return samples_shown([p.series], part, bad=places, bad_label="spike", title=title)


def copied(profiles: Sequence[Profile]) -> Evidence | None:
    """Return two axes with the same samples, around their fastest motion."""
    for one, two, correlation in copied_pairs(profiles):
        place = int(one.windows.start[int(one.windows.variance.argmax())])
        sign = "the same samples" if correlation > 0 else "the same samples with opposite sign"
        title = f"{one.name} and {two.name} have {sign}"
        part = _centred(place, _MANY, one.series.n)
        if one.series.sensor is two.series.sensor:
            return samples_shown([one.series, two.series], part, title=title)
        return samples_shown([one.series], part, title=title)
    return None


def interleaved(axes: Sequence[Profile]) -> Evidence:
    """Return samples in the middle of a log that alternates between several sensors."""
    p = axes[0]
    title = f"samples of {p.name}, which alternate between several sensors"
    part = _centred(p.series.n // 2, _FEW, p.series.n)
    return samples_shown([p.series], part, title=title)


def _centred(place: int, width: int, size: int) -> slice:
    start = max(min(place - width // 2, size - width), 0)
    return slice(start, min(start + width, size))
