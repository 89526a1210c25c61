"""Rests of a log in which the IMU is put down, turned and put down again.

A rest lasts a second or more, so the limits differ from those of `imucal.rests`.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from imucal.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from imucal.calibration.mean_covariance import mean_covariance
from imucal.clock import Clock
from imucal.errors import DataError, Fix
from imucal.noise import NoiseModel
from imucal.recording import AXES, AxisSeries, Recording, Sensor
from imucal.screening.motion import rests_between
from imucal.screening.windows import cut, quietest

__all__ = [
    "RestMeans",
    "Triad",
    "at_other_times",
    "attitudes",
    "find_rests",
    "half_differences",
    "moved_rests",
    "step_of",
    "triad",
]

#: Length of a window in s.
_WINDOW_S = 0.2
#: Fewest samples of a window.
_WINDOW_SAMPLES = 8
#: Length of the quietest stretch of an axis, in s.
_STRETCH_S = 5.0
#: Multiple of the variance of the quietest stretch that ends a rest.
_QUIET = 6.0
#: Minimum number of windows of a log.
_MIN_WINDOWS = 10
#: Limit of the mean rate at rest, in deviations.
_OFF_LEVEL = 8.0
#: Limit of a jump of the acceleration at rest, in deviations.
_JUMP = 8.0
#: Limit of the mean rate at rest as a share of the rate in a fast part of the turns, 1 to 3 rad/s:
#: g-sensitivities of 5e-4 (rad/s)/(m/s²) are usual, and change the rate by 5e-3 rad/s.
_BY_GRAVITY = 3e-3
#: Quantile of the rates of moving windows that is a fast part.
_FAST = 0.9
#: Time removed at both ends of a rest, in s.
_CLEAR_S = 0.15
#: Rates in a hand that count as rest, in rad/s.
_IN_HAND = 0.03
#: Change of the acceleration by a tilt in a hand, in m/s² per rad: gravity.
_IN_HAND_JUMP = 10.0
#: Deviations by which the halves of a moved rest differ.
_MOVED = 4.0
#: Probability that any rest of a log seems to have moved by chance; with many rests it raises the limit.
_FALSE_ALARMS = 1e-3
#: Angle within which rests have the same attitude, in rad.
_SAME_ATTITUDE = math.radians(10.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Triad(ReadOnlyArrays):
    """Three axes of one sensor on one even grid.

    Raw `samples`, shape (n, 3), are NaN if missing or unusable. `offset_s` is the time of the first sample
    after the first one of the accelerometer.
    """

    sensor: Sensor
    samples: FloatArray
    rate_hz: float
    offset_s: float = 0.0

    def places(self, times_s: FloatArray) -> IntArray:
        """Return the index of the first sample at or after each time."""
        found = np.ceil((np.asarray(times_s) - self.offset_s) * self.rate_hz - 1e-6).astype(np.int64)
        return np.clip(found, 0, len(self.samples))

    @property
    def end_s(self) -> float:
        """Time after the last sample, as `offset_s`."""
        return self.offset_s + len(self.samples) / self.rate_hz


@dataclass(frozen=True, kw_only=True, eq=False)
class RestMeans(ReadOnlyArrays):
    """Measurements of one sensor in m rests; `spans` are first sample and end, shape (m, 2).

    `deviations`, shape (3,), are those of the samples within the rests.
    """

    spans: IntArray
    means: FloatArray
    deviations: FloatArray

    @classmethod
    def of(cls, data: Triad, spans_s: FloatArray) -> "RestMeans":
        spans = data.places(spans_s)
        parts = [data.samples[first:end] for first, end in spans]
        variances = np.array([part.var(axis=0, ddof=1) for part in parts])
        lengths = np.diff(spans, axis=1)[:, 0] - 1.0
        # Noise below half a step may show no change at rest.
        steps = [step_of(data.samples[:, axis]) for axis in range(3)]
        pooled = np.average(variances, axis=0, weights=lengths) if parts else np.zeros(3)
        return cls(
            spans=spans,
            means=np.array([part.mean(axis=0) for part in parts]).reshape(-1, 3),
            deviations=np.sqrt(np.maximum(pooled, np.array(steps) ** 2 / 12)),
        )


def triad(recording: Recording, sensor: Sensor) -> Triad | None:
    """Return a sensor's axes on one grid; None if the recording lacks the sensor.

    If only some of the axes exist, or they have different clocks, a DataError is raised.
    """
    own = sorted((one for one in recording.series if one.sensor is sensor), key=lambda one: one.axis)
    if not own:
        return None
    if len(own) != 3:
        names = ", ".join(series.axis for series in own)
        problem = f"the {sensor} has only {names}; calibration needs x, y and z"
        raise DataError(problem, place=recording.source.path)
    clock = own[0].clock
    if len({(series.clock.segments, series.rate_hz) for series in own}) != 1:
        problem = f"the {sensor} has a different clock for each axis"
        raise DataError(problem, place=recording.source.path, fix=Fix("read it from one topic"))
    samples = np.full((clock.grid_size, 3), np.nan)
    for column, series in zip(samples.T, own, strict=True):
        column[clock.grid()] = np.where(series.usable, series.samples, np.nan)
    return Triad(sensor=sensor, samples=samples, rate_hz=clock.rate_hz, offset_s=_offset_s(recording, clock))


def _offset_s(recording: Recording, clock: Clock) -> float:
    """Return the time of a clock's first sample after the accelerometer's; 0 without stamps."""
    reference = next((s.clock for s in recording.series if s.sensor is Sensor.ACCELEROMETER), clock)
    if clock.start_ns is None or reference.start_ns is None:
        return 0.0
    return (clock.start_ns - reference.start_ns) / 1e9


def find_rests(
    accelerometer: Triad, gyroscope: Triad | None, *, at_least_s: float = 1.0, in_hand: bool = False
) -> FloatArray:
    """Return start and end of each rest, shape (m, 2), in s from the first sample of the accelerometer.

    If `in_hand`, rates below 0.03 rad/s count as rest. An axis that never changes raises a DataError.
    """
    sensors = [accelerometer] if gyroscope is None else [accelerometer, gyroscope]
    start, end = max(data.offset_s for data in sensors), min(data.end_s for data in sensors)
    moved = [(0.0, start), (end, end)]
    for data in sensors:
        _require_alive(data)
        moved += _moved(data, _IN_HAND if in_hand else 0.0)
    rests = np.array(rests_between(moved, end, clear_s=_CLEAR_S))
    shortest = max(at_least_s, *(_WINDOW_SAMPLES / data.rate_hz for data in sensors))
    return np.asarray(rests[np.diff(rests, axis=1)[:, 0] >= shortest])


def _moved(data: Triad, still: float) -> list[tuple[float, float]]:
    """Return when a sensor moved or lacks samples, in s; rates below `still` count as rest."""
    known = np.asarray(np.isfinite(data.samples).all(axis=1))
    clock = Clock.even(len(known), data.rate_hz).keeping(known)
    axes = zip(AXES, data.samples[known].T, strict=True)
    series = [AxisSeries(sensor=data.sensor, axis=axis, samples=one, clock=clock) for axis, one in axes]
    own = [cut(one, length_s=_WINDOW_S, least=_WINDOW_SAMPLES) for one in series]
    mean, variance = np.stack([[one.mean, one.variance] for one in own], axis=2)
    windows = own[0]
    if windows.size < _MIN_WINDOWS:
        return [(0.0, math.inf)]
    reference = np.array([quietest(one, round(_STRETCH_S / windows.length_s)) for one in variance.T])
    deviation = np.sqrt(reference / windows.width)
    accelerometer = data.sensor is Sensor.ACCELEROMETER
    # A hand also tilts within a window.
    tremor = still * _IN_HAND_JUMP * windows.length_s if accelerometer else still / 2
    quiet = (variance < np.maximum(_QUIET * reference, tremor**2)).all(axis=1)
    moved = [(gap.start_s, gap.start_s + gap.duration_s) for gap in clock.gaps]
    if accelerometer:
        limit = _JUMP * math.sqrt(2) * deviation + tremor
        jumped = (np.abs(np.diff(mean, axis=0)) > limit).any(axis=1)
        moved += [(at, at) for at in windows.time_s[1:][jumped]]
    elif quiet.any():
        level = np.median(mean[quiet], axis=0)
        spread = 1.4826 * np.median(np.abs(mean[quiet] - level), axis=0) + deviation
        off_level = np.abs(mean - level)
        # Gravity changes the rate at rest with the attitude, and its noise may be much smaller.
        moving = off_level[~quiet].max(axis=1)
        by_gravity = _BY_GRAVITY * float(np.quantile(moving, _FAST)) if moving.size else 0.0
        quiet &= (off_level < np.maximum(_OFF_LEVEL * spread, max(still, by_gravity))).all(axis=1)
    moved += zip(windows.time_s[~quiet], windows.end_s[~quiet], strict=True)
    begin = data.offset_s + clock.segments[0].offset / data.rate_hz
    return [(begin + first, begin + last) for first, last in moved]


def _require_alive(data: Triad) -> None:
    known = np.isfinite(data.samples)
    spans = np.where(known, data.samples, -np.inf).max(axis=0) > np.where(known, data.samples, np.inf).min(
        axis=0
    )
    if dead := [f"{data.sensor.short}_{axis}" for axis, alive in zip("xyz", spans, strict=True) if not alive]:
        raise DataError(f"{', '.join(dead)} never changes; check the driver and the cable")


def half_differences(data: Triad, rests: RestMeans, models: tuple[NoiseModel, ...]) -> FloatArray:
    """Return the difference of the two half means of each rest and axis, in deviations, shape (m, 3).

    If most are large, as in a trembling hand, their robust spread replaces the deviation.
    """
    first, end = rests.spans.T
    middle = (first + end) // 2
    halves = np.column_stack([first, middle, middle, end]).reshape(-1, 2)
    means = np.array([data.samples[a:b].mean(axis=0) for a, b in halves]).reshape(-1, 2, 3)
    z = np.empty((len(first), 3))
    for axis, model in enumerate(models):
        K = mean_covariance(model, halves, rate_hz=data.rate_hz, samples=len(data.samples))
        variance = np.diag(K)[::2] + np.diag(K)[1::2] - 2 * np.diag(K, 1)[::2]
        z[:, axis] = (means[:, 1, axis] - means[:, 0, axis]) / np.sqrt(variance)
    return np.asarray(z / max(1.0, 1.4826 * float(np.median(np.abs(z)))))


def moved_rests(z: FloatArray) -> BoolArray:
    """Return which rests moved, for `half_differences` of all axes, shape (m, 3) or (m, 6).

    A tilt moves two axes, so a sensor's squares are added: chi² with 3 degrees of freedom.
    """
    squares = (z.reshape(len(z), -1, 3) ** 2).sum(axis=2)
    limit = max(_MOVED**2, float(chdtri(3, _FALSE_ALARMS / max(squares.size, 1))))
    return np.asarray((squares > limit).any(axis=1))


def attitudes(up: FloatArray) -> int:
    """Return how many attitudes differ by more than 10°, for unit vectors of shape (m, 3)."""
    found: list[FloatArray] = []
    for one in up:
        if all(one @ other < math.cos(_SAME_ATTITUDE) for other in found):
            found.append(one)
    return len(found)


def step_of(samples: FloatArray) -> float:
    """Return the smallest difference between distinct values; 0 if there is one value only."""
    different = np.diff(np.unique(samples[np.isfinite(samples)]))
    # Values from counts also differ by rounding.
    real = (
        different[different > 1e-9 * np.abs(samples[np.isfinite(samples)]).max()]
        if different.size
        else different
    )
    return float(real.min()) if real.size else 0.0


def at_other_times(data: Triad, values: FloatArray, other: Triad) -> FloatArray:
    """Interpolate values of one sensor's samples at the times of another's."""
    same = data.rate_hz == other.rate_hz and other.offset_s == 0 and len(values) == len(other.samples)
    if same and np.isfinite(values).all():
        return values
    times = np.arange(len(values)) / data.rate_hz
    wanted = np.arange(len(other.samples)) / other.rate_hz + other.offset_s
    known = np.isfinite(values).all(axis=1)
    return np.column_stack([np.interp(wanted, times[known], column[known]) for column in values.T])
