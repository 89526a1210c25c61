"""A recording of a temperature ramp in blocks: means of each axis, and the temperature, over equal times."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.errors import DataError, Fix
from imucal.recording import AxisSeries, Recording
from imucal.temperature.thermometer import Thermometer, branches_of, turning_points

#: Number of blocks: a ramp of 1 h has blocks of 19 s. The covariance of their noise is a full matrix.
_BLOCKS = 192
#: Fewest samples in a full block: white noise of a mean is then known from its neighbours.
_SAMPLES = 4
#: Fewest blocks with samples of an axis: noise is told from effects of temperature by its fast changes.
_MIN_BLOCKS = 64
#: An outlier is this many times the median distance from the mean of its neighbours: 10 deviations.
_OUTLIER = 15.0
#: A block with a smaller share of its samples is left out.
_LEAST_SHARE = 0.25
#: Share of the span by which the temperature must change between two turns: a controller overshoots by less.
_TURN_SHARE = 0.2
#: Smallest span in which bias can be told from noise, in K.
LEAST_SPAN_K = 5.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Ramp:
    """The temperature over a log in b blocks.

    `edges_s`, shape (b + 1,), are in s from the first sample of the thermometer. `temperature`, shape (b,),
    is in degrees Celsius. `branch`, shape (b,), numbers the branches; `heats` is whether each of them heats.
    """

    thermometer: Thermometer
    edges_s: FloatArray
    temperature: FloatArray
    branch: IntArray
    heats: BoolArray

    @classmethod
    def of(cls, recording: Recording) -> "Ramp":
        """Return the ramp of a recording, or raise a DataError if it has no ramp of the temperature."""
        place = recording.source.path
        thermometer = Thermometer.of(recording)
        fewest = min(series.n for series in recording.series)
        blocks = min(_BLOCKS, fewest // _SAMPLES)
        if blocks < _MIN_BLOCKS:
            problem = f"{fewest} samples are too few: expected at least {_SAMPLES * _MIN_BLOCKS}"
            raise DataError(problem, place=place)
        edges = np.linspace(0, thermometer.duration_s, blocks + 1)
        temperature = thermometer.means(thermometer.samples, edges)
        span = float(np.ptp(temperature))
        if span < LEAST_SPAN_K:
            problem = f"the temperature spans only {span:.2g} K, expected at least {LEAST_SPAN_K:g} K"
            raise DataError(problem, place=place, fix=Fix("record while the IMU heats and cools"))
        branch, heats = branches_of(temperature, turning_points(temperature, _TURN_SHARE * span))
        return cls(
            thermometer=thermometer, edges_s=edges, temperature=temperature, branch=branch, heats=heats
        )

    @property
    def blocks(self) -> int:
        return self.temperature.size

    @property
    def block_s(self) -> float:
        return float(self.edges_s[1])

    @cached_property
    def span_k(self) -> float:
        return float(np.ptp(self.temperature))

    @property
    def middle_c(self) -> float:
        return float(self.temperature.min()) + self.half_k

    @property
    def half_k(self) -> float:
        return self.span_k / 2

    @property
    def heating(self) -> BoolArray:
        """Whether each block is in a branch that heats, shape (b,)."""
        return self.heats[self.branch]

    @property
    def speed_k_per_s(self) -> FloatArray:
        """The rate of change of the temperature in each block, shape (b,), in K/s."""
        return np.gradient(self.temperature, self.block_s)

    def lagging(self, lag_s: float) -> FloatArray:
        """Return the block means of the temperature behind a first-order lag, shape (b,)."""
        return self.thermometer.means(self.thermometer.lagging(lag_s), self.edges_s)


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisBlocks:
    """The means of one axis in the blocks of a ramp that have samples.

    `places`, shape (m,), are their numbers, `means` in U and `counts` the samples of each.
    `white_variance` is the variance of a sample about the line through its neighbours, in U².
    """

    series: AxisSeries
    places: IntArray
    means: FloatArray
    counts: FloatArray
    white_variance: float

    @classmethod
    def of(cls, series: AxisSeries, ramp: Ramp) -> "AxisBlocks":
        """Return the blocks of an axis; raise a DataError if there are too few."""
        finite = series.finite()
        cleaned = finite.keeping(_plain(finite.samples))
        seconds = ramp.thermometer.seconds_of(cleaned.clock)
        block = np.searchsorted(ramp.edges_s, seconds, side="right") - 1
        inside = (block >= 0) & (block < ramp.blocks)
        block, samples = block[inside], cleaned.samples[inside]
        count = np.bincount(block, minlength=ramp.blocks)
        total = np.bincount(block, weights=samples, minlength=ramp.blocks)
        places = np.flatnonzero(count >= max(1.0, _LEAST_SHARE * ramp.block_s / series.tau0))
        if places.size < _MIN_BLOCKS:
            problem = f"{series.name} has samples in {places.size} of {ramp.blocks} parts of the ramp"
            raise DataError(f"{problem}, expected at least {_MIN_BLOCKS}", place=series.name)
        # The second difference of white noise has 6 times its variance.
        second = np.diff(cleaned.samples, 2)
        return cls(
            series=series,
            places=places,
            means=total[places] / count[places],
            counts=count[places].astype(np.float64),
            white_variance=float(np.mean(second**2)) / 6 if second.size else 0.0,
        )

    def take(self, keep: BoolArray) -> "AxisBlocks":
        """Return the blocks where `keep`, shape (m,), is true."""
        return AxisBlocks(
            series=self.series,
            places=self.places[keep],
            means=self.means[keep],
            counts=self.counts[keep],
            white_variance=self.white_variance,
        )


def _plain(samples: FloatArray) -> BoolArray:
    """Return which samples are no outliers, shape (n,), by the distance from the mean of their neighbours.

    The outlier removal of a noise fit takes the steep ends of a ramp for outliers.
    """
    plain = np.ones(samples.size, dtype=np.bool_)
    if samples.size < _SAMPLES:
        return plain
    distance = np.abs(samples[1:-1] - (samples[:-2] + samples[2:]) / 2)
    usual = float(np.median(distance))
    if usual > 0:
        plain[1:-1] = distance < _OUTLIER * usual
        ends = np.abs(samples[[0, -1]] - samples[[1, -2]])
        plain[[0, -1]] = ends < _OUTLIER * usual
    return plain
