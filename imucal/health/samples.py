"""Rows about samples: missing axes, stuck, repeated and interpolated samples, spikes, copies."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from imucal.arrays import BoolArray, IntArray, blocks, distinct
from imucal.findings import Finding
from imucal.health import sample_evidence
from imucal.health.clipping import clipped_values
from imucal.health.diagnosis import Question, Row, Status, Values
from imucal.health.evidence import Evidence
from imucal.health.stream import Stream
from imucal.recording import AXES, Sensor
from imucal.screening.interleaved import check_interleaved
from imucal.screening.values import (
    check_duplicates,
    check_filled,
    check_no_data,
    check_not_finite,
    check_stuck,
)
from imucal.screening.windows import Profile, excerpt, name_list

__all__ = ["sample_rows"]

#: Variance of a window of another axis, over that of its quiet windows, that shows motion.
_MOVING = 25.0
#: Fewest samples in motion for a comparison of neighbours.
_MIN_SAMPLES = 256
#: Share of a step that is the rounding of interpolated samples that were not rounded to steps again.
_EXACT = 0.3
#: Noise over the step of an axis above which three samples on a line are no coincidence, and a window at rest
#: never repeats one value.
_FINE = 2.0
#: A spike differs from both its neighbours by this many typical differences nearby. Gaussian noise reaches 8;
#: taps ring for several samples.
_SPIKE = 25.0
#: Samples whose median is the typical difference nearby.
_NEARBY = 15
#: Fewest spikes that are reported: one may be a knock.
_SPIKES = 3
#: Number of spikes per hour from which they are a fault of the driver or the cable.
_MANY_SPIKES_PER_H = 3600.0


_STUCK = Question("stuck samples", "stuck")
_HELD = Question("repeated samples", "held-samples")
_BETWEEN = Question("interpolated samples", "interpolated-samples")
_SPIKES_OF = Question("spikes", "spikes")
_COPIES = Question("copied axes", "duplicate-axes")
#: Questions that some samples cannot answer.
_OF_MANY = (_STUCK, _HELD, _BETWEEN, _SPIKES_OF, _COPIES)
_FEW = "no axis has enough samples that change"
_LONGER = "Record for 10 s or longer."


def sample_rows(stream: Stream) -> tuple[Row, ...]:
    """Return the rows of samples, in the order of the checks."""
    alive = [p for p in stream.profiles if p.windows.size and not p.constant]
    rows = (_axes_row(stream), _numbers_row(stream))
    if not any(p.series.n >= _MIN_SAMPLES for p in alive):
        return (*rows, *(question.answer("unknown", _FEW, _LONGER) for question in _OF_MANY))
    filled = (*stream.recording.findings, *_filled(stream))
    return (
        *rows,
        _stuck_row(alive, stream),
        _held_row(alive, filled),
        _between_row(alive, filled),
        _spikes_row(alive),
        _copies_row(alive),
    )


def _numbers_row(stream: Stream) -> Row:
    damaged = [one for p in stream.profiles for one in check_not_finite(p)]

    def evidence_of(finding: Finding) -> Evidence | None:
        return sample_evidence.not_finite(stream.recording[finding.axis or ""])

    question = Question("samples that are numbers", "not-finite")
    return _row(question, damaged, "all samples are finite", evidence_of)


def _stuck_row(alive: Sequence[Profile], stream: Stream) -> Row:
    stuck = [one for p in alive for one in _stuck(p, stream)]

    def evidence_of(finding: Finding) -> Evidence:
        (p,) = _named(alive, finding.axis)
        return sample_evidence.stuck(replace(p, windows=p.windows.take(~_clipped(p))))

    still = "no axis stays at one value while the IMU moves"
    return _row(_STUCK, stuck, still, evidence_of, worst="fail")


def _held_row(alive: Sequence[Profile], filled: Sequence[Finding]) -> Row:
    return _row(
        _HELD,
        _once_per_sensor(filled, "held-samples"),
        "no samples repeat on all axes",
        lambda finding: sample_evidence.held(_named(alive, finding.axis)),
        worst="fail",
        advice="Log each sample once: a filter takes a repeated sample for a new one.",
    )


def _between_row(alive: Sequence[Profile], filled: Sequence[Finding]) -> Row:
    return _row(
        _BETWEEN,
        _once_per_sensor(filled, "interpolated-samples"),
        "no samples are on a line between their neighbours",
        lambda finding: sample_evidence.interpolated(_named(alive, finding.axis)),
        worst="fail",
        advice="Log the sensor's own samples and leave lost ones out: a filter bridges short gaps.",
    )


def _copies_row(alive: Sequence[Profile]) -> Row:
    copies = [*check_duplicates(alive), *check_interleaved(alive)]

    def evidence_of(finding: Finding) -> Evidence | None:
        # A copy is a finding about two axes, which has no axis of its own.
        if finding.axis is None:
            return sample_evidence.copied(alive)
        return sample_evidence.interleaved(_named(alive, finding.axis))

    return _row(_COPIES, copies, "no two axes have the same samples", evidence_of)


def _named(profiles: Sequence[Profile], name: str | None) -> list[Profile]:
    """Return the profile of an axis, such as ``gyro_x``, or those of a sensor, such as ``gyro``."""
    return [p for p in profiles if name in {p.name, p.series.sensor.short}]


def _filled(stream: Stream) -> tuple[Finding, ...]:
    """Return the findings about repeated and interpolated samples while the IMU moves."""
    moving = [_in_motion(p, stream) for p in stream.profiles]
    long = [p for p in moving if p.series.n >= _MIN_SAMPLES]
    exact = [replace(p, lsb=_EXACT * p.lsb) if p.lsb is not None else p for p in long]
    return (*check_filled(long), *check_filled(exact))


def _once_per_sensor(findings: Sequence[Finding], code: str) -> list[Finding]:
    """Return the first finding of a code for each axis or sensor."""
    return list({finding.axis: finding for finding in reversed(findings) if finding.code == code}.values())


def _row(
    question: Question,
    findings: Sequence[Finding],
    good: str,
    evidence_of: Callable[[Finding], Evidence | None],
    *,
    worst: Status = "warn",
    advice: str = "",
) -> Row:
    """Return the row of the worst finding, with the axes of the others; warnings have the status `worst`.

    `advice` is for filters, in place of the finding's, which is for fits.
    """
    if not findings:
        return question.answer("pass", good)
    levels: dict[str, Status] = {"error": "fail", "warning": worst, "info": "warn"}
    order = ("error", "warning", "info")
    first, *others = sorted(findings, key=lambda one: order.index(one.level))
    row = question.answer_by(first, levels[first.level], evidence=evidence_of(first))
    axis = f"{first.axis}: " if first.axis else ""
    more = [one.axis for one in others if one.axis]
    also = f" So {'is' if len(more) == 1 else 'are'} {name_list(more)}." if more else ""
    return replace(row, found=f"{axis}{row.found}{also}", advice=advice or row.advice)


def _axes_row(stream: Stream) -> Row:
    question = Question("axes with data", "axis-missing")
    profiles = stream.profiles
    present = {series.name for series in stream.recording.series}
    wanted = [f"{sensor.short}_{axis}" for sensor in Sensor for axis in AXES]
    missing = [one for one in wanted if one not in present]
    empty = [finding for p in profiles for finding in check_no_data(p)]
    if missing:
        found = f"{name_list(missing)} {'is' if len(missing) == 1 else 'are'} not in the log"
        advice = "A filter needs three axes of both sensors: check the choice of columns or topics."
        return question.answer("fail", found, advice)
    if empty:
        return _row(question, empty, "", lambda finding: _dead(finding, stream))
    return question.answer("pass", "all six axes have data")


def _dead(finding: Finding, stream: Stream) -> Evidence | None:
    (p,) = _named(stream.profiles, finding.axis)
    return sample_evidence.dead(p, stream.of_sensor(p.series.sensor)) if p.series.n else None


def _moves(p: Profile, stream: Stream) -> BoolArray:
    """Return in which windows of an axis another axis on the same windows moves, shape (k,)."""
    windows = p.windows
    moves = np.zeros(windows.size, dtype=np.bool_)
    for other in stream.profiles:
        if other.name == p.name or other.constant or other.windows.size != windows.size:
            continue
        variance = other.windows.variance
        varying = variance[variance > 0]
        if varying.size:
            moves |= variance > _MOVING * max(float(np.quantile(varying, 0.05)), (other.lsb or 0.0) ** 2)
    return moves


def _in_motion(p: Profile, stream: Stream) -> Profile:
    """Return the profile with its samples in fast motion: at rest, coarse samples repeat on all axes."""
    if not p.windows.size:
        return p
    still = stream.resting(p)
    axes = [one for one in stream.of_sensor(p.series.sensor) if one.windows.size == p.windows.size]
    speed = np.sum([one.windows.step_variance for one in axes], axis=0)
    if not still.all():
        # In slow motion three coarse samples are often on a line.
        still |= speed < np.median(speed[~still])
    keep = np.ones(p.series.n, dtype=np.bool_)
    for start in p.windows.start[still].tolist():
        keep[start : start + p.windows.width] = False
    return replace(p, series=p.series.keeping(keep)) if keep.sum() >= _MIN_SAMPLES else p


def _stuck(p: Profile, stream: Stream) -> tuple[Finding, ...]:
    """Return findings for an axis with one value while others move, or at rest if its noise is fine."""
    moves = _moves(p, stream)
    fine = p.lsb is None or p.noise > _FINE * p.lsb
    keep = np.ones_like(moves) if fine else moves
    keep &= ~_clipped(p)
    return (
        check_stuck(replace(p, windows=p.windows.take(keep), disturbed=p.disturbed[keep]))
        if keep.any()
        else ()
    )


def _clipped(p: Profile) -> BoolArray:
    """Return which windows are at a limit of the range, for which there is another row."""
    frozen = p.windows.low == p.windows.high
    if not frozen.any():
        return np.asarray(frozen)
    return np.asarray(frozen & np.isin(p.windows.low, clipped_values(p)))


def _spikes_row(profiles: Sequence[Profile]) -> Row:
    places = {p.name: _spikes(p) for p in profiles}
    counts = {axis: indices.size for axis, indices in places.items()}
    total = sum(counts.values())
    values: Values = {axis: float(count) for axis, count in counts.items()}
    most = max(counts, key=lambda axis: counts[axis], default=None)
    if most is None or counts[most] < _SPIKES:
        found = "no axis has more than two samples that are far from both their neighbours"
        return _SPIKES_OF.answer("pass", found, values=values)
    hours = max(p.series.duration_s for p in profiles) / 3600
    found = f"{total} single samples are far from both their neighbours, most of them on {most}"
    status: Status = "fail" if counts[most] / hours > _MANY_SPIKES_PER_H else "warn"
    advice = "Check the driver and the cable; let the filter reject outliers."
    (worst,) = _named(profiles, most)
    evidence = sample_evidence.spiked(worst, places[most])
    return _SPIKES_OF.answer(status, found, advice, values=values, evidence=evidence)


def _spikes(p: Profile) -> IntArray:
    """Return the indices of the samples that differ from both neighbours, which agree with each other."""
    samples = p.series.samples
    # Spikes raise the variance of windows, but not the median step.
    some = np.concatenate([np.abs(np.diff(samples[part])) for part in excerpt(samples.size)])
    noise = min(p.noise, 1.4826 / math.sqrt(2) * float(np.median(some))) if some.size else 0.0
    floor = max(noise, p.lsb or 0.0) / 2
    found: list[IntArray] = [np.zeros(0, dtype=np.int64)]
    for part in blocks(samples.size):
        begin = max(part.start - 2, 0)
        steps = np.diff(samples[begin : part.stop + 2])
        if steps.size < _NEARBY:
            continue
        there, back = steps[:-1], steps[1:]
        least = np.minimum(np.abs(there), np.abs(back))
        opposite = (there * back < 0) & (np.abs(there + back) < 0.5 * least)
        candidates = np.flatnonzero(opposite & (least > _SPIKE * floor))
        if not candidates.size:
            continue
        usual = median_filter(np.abs(steps), size=2 * _NEARBY + 1, mode="nearest")
        sharp = least[candidates] > _SPIKE * np.maximum(usual[candidates], floor)
        found.append(candidates[sharp] + begin + 1)
    return distinct(np.concatenate(found))
