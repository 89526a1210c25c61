"""The temperature of a log on an even grid, also as a sensor behind a thermal resistance feels it."""

from dataclasses import dataclass

import numpy as np
import scipy

from imucal.arrays import BoolArray, FloatArray, IntArray, ReadOnlyArrays
from imucal.clock import Clock
from imucal.errors import DataError, Fix
from imucal.fitting.regressors import lagged
from imucal.recording import Recording

#: Most places of the grid: a first-order lag of a hundredth of the log is then exact to 0.1 %.
_PLACES = 65536
#: A temperature is compared with the median of this many neighbours: two in a row may be wrong.
_NEIGHBOURS = 5
#: No part heats by this much between two samples, in K.
_OUTLIER_K = 5.0
#: Where PX4 logs it, and not in sensor_combined.
_IN_PX4 = "read the topics that contain it: --topic sensor_gyro --topic sensor_accel"
#: Where other logs have it.
_IN_OTHERS = "name its column, such as temp=8 in --columns, or log a topic of sensor_msgs/Temperature"
#: Fewer different temperatures are no ramp.
_FEW = 16


@dataclass(frozen=True, kw_only=True, eq=False)
class Thermometer(ReadOnlyArrays):
    """The temperature in degrees Celsius, shape (n,), every `step_s` seconds.

    `start_ns` is the time stamp of the first temperature of the log, or None without stamps, and `period_s`
    the time between two of them. A place is the mean of one or more of them.
    """

    samples: FloatArray
    step_s: float
    period_s: float
    start_ns: int | None

    @classmethod
    def of(cls, recording: Recording) -> "Thermometer":
        """Return the thermometer of a log; missing values are interpolated.

        A DataError is raised if the log has no temperature, or hardly any value.
        """
        place = recording.source.path
        temperature = recording.temperature
        if temperature is None:
            how = _IN_PX4 if recording.source.format == "ulog" else _IN_OTHERS
            raise DataError("the log has no temperature", place=place, fix=Fix(how))
        clock = temperature.clock
        known = np.isfinite(temperature.samples)
        known[known] = _plausible(temperature.samples[known])
        if np.unique(temperature.samples[known]).size < _FEW:
            problem = f"the temperature has fewer than {_FEW} different values"
            raise DataError(problem, place=place)
        seconds = clock.grid()[known] * clock.tau0
        places = min(clock.grid_size, _PLACES)
        step_s = clock.duration_s / places
        # Each place is the mean of the samples nearest to it, so that rounding and noise are averaged.
        nearest = np.minimum((seconds / step_s).astype(np.int64), places - 1)
        count = np.bincount(nearest, minlength=places)
        total = np.bincount(nearest, weights=temperature.samples[known], minlength=places)
        filled = np.flatnonzero(count)
        even = np.interp(np.arange(places), filled, total[filled] / count[filled])
        return cls(samples=even, step_s=step_s, period_s=clock.tau0, start_ns=clock.start_ns)

    @property
    def duration_s(self) -> float:
        return self.samples.size * self.step_s

    @property
    def times_s(self) -> FloatArray:
        """The mean time of the temperatures of each place, shape (n,), in s from the first."""
        return np.asarray((np.arange(self.samples.size) + 0.5) * self.step_s - 0.5 * self.period_s)

    def seconds_of(self, clock: Clock) -> FloatArray:
        """Return the times of the samples of a clock, shape (m,), in s from the first temperature."""
        seconds = clock.grid() * clock.tau0
        if clock.start_ns is None or self.start_ns is None:
            return np.asarray(seconds)
        return np.asarray(seconds + (clock.start_ns - self.start_ns) / 1e9)

    def lagging(self, lag_s: float) -> FloatArray:
        """Return the temperature behind a first-order lag, in s, shape (n,); at the start both are equal."""
        return lagged(self.samples, lag_s / self.step_s)

    def means(self, samples: FloatArray, edges_s: FloatArray) -> FloatArray:
        """Return the means of `samples`, shape (n,), between `edges_s`, shape (b + 1,), in s; shape (b,)."""
        total = np.concatenate([[0.0], np.cumsum(samples - samples[0])])
        integral = np.interp(edges_s / self.step_s, np.arange(total.size), total)
        return np.asarray(samples[0] + np.diff(integral) * self.step_s / np.diff(edges_s))


def _plausible(samples: FloatArray) -> BoolArray:
    """Return which temperatures are no outliers, such as the -127 °C of a failed transfer, shape (n,)."""
    usual = scipy.ndimage.median_filter(samples, size=_NEIGHBOURS, mode="nearest")
    return np.asarray(np.abs(samples - usual) < _OUTLIER_K)


def turning_points(temperature: FloatArray, least: float) -> IntArray:
    """Return the places at which the temperature turns, with the first and the last place.

    Between two of them it changes by at least `least`, except after the last turn.
    """
    turns = [0]
    low = high = 0
    rising: bool | None = None
    for place, value in enumerate(temperature.tolist()):
        high = place if value >= temperature[high] else high
        low = place if value <= temperature[low] else low
        if rising is not False and temperature[high] - value >= least:
            # The temperature before the first branch is part of it.
            turns += [high] if rising else []
            rising = False
            low = place
        elif rising is not True and value - temperature[low] >= least:
            turns += [low] if rising is False else []
            rising = True
            high = place
    return np.array([*turns, temperature.size - 1])


def branches_of(temperature: FloatArray, turns: IntArray) -> tuple[IntArray, BoolArray]:
    """Return the branch of each place, shape (n,), and whether each branch heats, shape (branches,)."""
    starts = turns[:-1]
    branch = np.searchsorted(starts, np.arange(temperature.size), side="right") - 1
    heats = temperature[turns[1:]] > temperature[starts]
    return branch, heats
