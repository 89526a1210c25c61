"""Rows that are no new samples: headers of loggers, values held by a slower sensor, messages sent twice."""

from collections.abc import Sequence
from hashlib import blake2b
from typing import Any

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.errors import ChoiceError
from imucal.evidence import share_together
from imucal.findings import Finding
from imucal.readers.clocks import repeats
from imucal.readers.sensor_rows import SensorRows
from imucal.readers.table_stamps import stamps_of
from imucal.readers.work import Work

#: Above this share of repeated rows, the sensor is slower than the log; below, samples were sent twice.
_MAX_REPEATED = 0.1
#: Fewest samples that must remain.
_MIN_REMAINING = 64
#: A step that differs from the median by this share is irregular; jitter of usual drivers is smaller.
_IRREGULAR = 0.25
#: Largest share of irregular steps between the remaining samples: some samples are equal by chance.
_BY_CHANCE = 1e-3
#: Ratio of the median steps from which every sample was logged more than once.
_SLOWER = 1.5

#: Most rows with the first time stamp that are left out: headers of loggers have up to 3 such rows. More rows
#: are samples from before the clock was set.
_MAX_FIRST_ROWS = 8
#: Rows after them that must all have different stamps; otherwise the clock is coarse, and they are samples.
_ROWS_BELOW = 1000

#: Values compared to find held samples.
_LOOKED_AT = 1_000_000


def without_first_rows(work: Work, sensors: Sequence[SensorRows]) -> list[SensorRows]:
    """Drop the first rows if they repeat one time stamp and no other row does.

    PSINS writes rows of initial values and scales, with the time zero, above the samples. At most one of the
    rows can be a sample: the last, if it is like the samples below.
    """
    if any(columns.is_topic for columns in sensors):
        # Messages have no such rows.
        return [*sensors]
    groups: dict[tuple[Any, ...], list[SensorRows]] = {}
    for columns in sensors:
        groups.setdefault(_rows_of(columns), []).append(columns)
    surplus = {rows: _first_rows(group) for rows, group in groups.items()}
    for rows, first in surplus.items():
        if first:
            text = (
                f"The first rows repeat one time stamp, unlike the others: {first} of them are no samples "
                "and were left out."
            )
            axis = groups[rows][0].plan.triad.sensor.short if len(groups) > 1 else None
            work.findings.append(Finding("info", "first-rows", text, axis=axis))
    return [_from_row(columns, surplus[_rows_of(columns)]) for columns in sensors]


def _rows_of(columns: SensorRows) -> tuple[Any, ...]:
    """Return a key that is equal for sensors with the same rows and time."""
    return columns.plan.time, columns.plan.triad.rows, columns.rows_left, columns.n


def _first_rows(sensors: Sequence[SensorRows]) -> int:
    """Return the number of first rows that are no samples of sensors with the same rows."""
    times = [column[: _MAX_FIRST_ROWS + _ROWS_BELOW] for column in sensors[0].time]
    if not times or times[0].size < _MIN_REMAINING:
        return 0
    repeated = np.all([np.diff(time) == 0 for time in times], axis=0)
    equal_stamps = int(np.argmin(repeated))
    if not 0 < equal_stamps < _MAX_FIRST_ROWS or repeated[equal_stamps:].any():
        return 0
    axes = [axis[equal_stamps : equal_stamps + _ROWS_BELOW] for columns in sensors for axis in columns.axes]
    last_is_sample = not any(_is_far(axis[0], axis[1:]) for axis in axes)
    return equal_stamps if last_is_sample else equal_stamps + 1


def _is_far(value: float, others: FloatArray) -> bool:
    """Return whether a value is further from the range of the others than the range is wide."""
    low, high = float(others.min()), float(others.max())
    return bool(value < 2 * low - high or value > 2 * high - low)


def _from_row(columns: SensorRows, first: int) -> SensorRows:
    if not first:
        return columns
    keep = np.ones(columns.n, np.bool_)
    keep[:first] = False
    return columns.where(keep, _mark(columns, keep))


def _mark(columns: SensorRows, keep: BoolArray) -> bytes:
    """Return the hash of all masks so far and a further one."""
    return blake2b(columns.rows_left + keep.tobytes()).digest()


def without_held(work: Work, columns: SensorRows) -> SensorRows:
    """Drop samples that repeat the previous one on all axes, if the others are at least as regular in time.

    A topic or table with two sensors repeats the last sample of the slower one.
    """
    axes, n = columns.axes, columns.n
    if len(axes) < 2 or n <= _MIN_REMAINING or work.options.rate_hz is not None:
        return columns
    together = share_together([np.diff(axis[:_LOOKED_AT]) == 0 for axis in axes])
    if not together or (1 - together) * n < _MIN_REMAINING:
        return columns
    stamps = _stamps_alone(work, columns)
    if stamps is None:
        return columns
    keep = _is_new(axes)
    remaining = int(keep.sum())
    steps = np.diff(stamps)
    own_steps = np.diff(stamps[keep])
    sent_again = int(np.count_nonzero((steps == 0) & ~keep[1:]))
    irregular = _irregular(steps)
    own_irregular = _irregular(own_steps)
    slower = float(np.median(own_steps)) >= _SLOWER * float(np.median(steps))
    # `sent_twice` drops messages that were recorded twice.
    is_message = columns.compared is not None
    few_sent_again = sent_again > 0 and (is_message or sent_again <= _MAX_REPEATED * n)
    regular = own_irregular <= _BY_CHANCE * remaining
    if few_sent_again or not regular or not (slower or own_irregular < irregular):
        return columns
    sensor = columns.plan.triad.sensor
    text = (
        f"{n - remaining} of {n} {sensor} samples repeat the previous one on all axes, and the others are "
        "regular in time: the sensor is slower than its log. The repeats were dropped."
    )
    work.findings.append(Finding("info", "held-samples", text, axis=sensor.short))
    return columns.where(keep, _mark(columns, keep))


def _is_new(axes: Sequence[FloatArray]) -> BoolArray:
    """Return which samples differ from the previous one on some axis, shape (n,)."""
    new = np.zeros(axes[0].size, np.bool_)
    new[0] = True
    for axis in axes:
        new[1:] |= axis[1:] != axis[:-1]
    return new


def _stamps_alone(work: Work, columns: SensorRows) -> IntArray | None:
    """Return the stamps of a sensor in ns without findings; None if it has none, or if they are ambiguous."""
    plan = columns.plan
    if plan.time is None or plan.time.kind == "counter":
        return None
    try:
        return stamps_of(work.silent(), columns.place, plan.time, columns.time, plan.triad.sensor)
    except ChoiceError:
        return None


def _irregular(steps: IntArray) -> int:
    """Return the number of steps that differ from the median."""
    usual = float(np.median(steps))
    return int(np.count_nonzero(np.abs(steps - usual) > _IRREGULAR * usual))


def sent_twice(work: Work, stamps: IntArray, columns: SensorRows) -> BoolArray | None:
    """Return which samples repeat the previous one; None if none do or the sensor is slower than the log."""
    rows = columns.axes if columns.compared is None else columns.compared
    same = repeats(stamps, rows) if rows else None
    share = float(same.mean()) if same is not None and same.size else 0.0
    if share <= _MAX_REPEATED or columns.compared is not None:
        return same
    sensor = columns.plan.triad.sensor
    text = (
        f"{share:.0%} of the rows of the {sensor} repeat the previous time stamp and values: the log was "
        "written faster than the sensor was read."
    )
    advice = "Log each sample once: repeated samples distort the curve at short averaging times."
    work.findings.append(Finding("warning", "held-samples", text, advice, axis=sensor.short))
    return None
