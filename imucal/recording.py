"""What was measured: sensors, clocks, axes and recordings. Always SI units."""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, read_only
from imucal.errors import DataError
from imucal.findings import Finding

__all__ = [
    "Axis",
    "AxisSeries",
    "Clock",
    "Gap",
    "Recording",
    "Segment",
    "Sensor",
    "Source",
    "Temperature",
]

Axis: TypeAlias = Literal["x", "y", "z"]


class Sensor(StrEnum):
    """A triad of an IMU."""

    GYROSCOPE = "gyroscope"
    ACCELEROMETER = "accelerometer"

    @property
    def short(self) -> str:
        """`gyro` or `accel`, the start of an axis name."""
        return "gyro" if self is Sensor.GYROSCOPE else "accel"

    @property
    def unit(self) -> str:
        """The SI unit of its samples: `rad/s` or `m/s^2`."""
        return "rad/s" if self is Sensor.GYROSCOPE else "m/s^2"


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """A run of unbroken samples.

    Attributes
    ----------
    start, stop
        The samples are ``samples[start:stop]``.
    offset
        Place of the first of them on the clock's even grid: it was taken at ``offset * tau0``.
    """

    start: int
    stop: int
    offset: int

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.stop - self.start


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """Samples that are missing between two segments.

    Attributes
    ----------
    start_s
        Time of the first missing sample, in s from the first sample.
    missing
        Number of missing samples.
    duration_s
        ``missing * tau0``, in s.
    """

    start_s: float
    missing: int
    duration_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Clock:
    """When the samples were taken: an even grid, of which segments are filled.

    Attributes
    ----------
    source
        What the stamps are, in words: ``header stamp``, ``log time``, ``column time_us``, ``given rate``.
    rate_hz
        Measured sampling rate: the inverse of tau0.
    segments
        Runs of unbroken samples, in order; they do not overlap on the grid.
    start_ns
        Time of the first sample, in ns of the stamps' own epoch; None where the log has no stamps.
    jitter_s
        Standard deviation of the stamps about the even grid, in s; None where there are no stamps.
    """

    source: str
    rate_hz: float
    segments: tuple[Segment, ...]
    start_ns: int | None = None
    jitter_s: float | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.rate_hz) and self.rate_hz > 0):
            msg = f"rate_hz must be positive and finite, got {self.rate_hz}"
            raise ValueError(msg)
        expected, place = 0, 0
        for segment in self.segments:
            if segment.start != expected or segment.stop <= segment.start or segment.offset < place:
                msg = f"segments must follow each other and not overlap, got {segment}"
                raise ValueError(msg)
            expected, place = segment.stop, segment.offset + segment.size

    @classmethod
    def even(cls, n: int, rate_hz: float, *, source: str = "given rate") -> "Clock":
        """Return the clock of `n` samples without a gap."""
        segments = (Segment(start=0, stop=n, offset=0),) if n else ()
        return cls(source=source, rate_hz=rate_hz, segments=segments)

    @property
    def tau0(self) -> float:
        """Sampling period, in s."""
        return 1.0 / self.rate_hz

    @property
    def n(self) -> int:
        """Number of samples."""
        return self.segments[-1].stop if self.segments else 0

    @property
    def grid_size(self) -> int:
        """Number of places on the even grid from the first sample to the last, filled or not."""
        if not self.segments:
            return 0
        first, last = self.segments[0], self.segments[-1]
        return last.offset + last.size - first.offset

    @property
    def duration_s(self) -> float:
        """Time the grid spans, ``grid_size * tau0``, in s."""
        return self.grid_size * self.tau0

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """The missing samples between segments."""
        gaps = []
        for before, after in zip(self.segments, self.segments[1:], strict=False):
            end = before.offset + before.size
            missing = after.offset - end
            if missing:
                start = (end - self.segments[0].offset) * self.tau0
                gaps.append(Gap(start_s=start, missing=missing, duration_s=missing * self.tau0))
        return tuple(gaps)

    @property
    def missing(self) -> int:
        """Number of missing samples."""
        return self.grid_size - self.n

    def grid(self) -> NDArray[np.int64]:
        """Place of every sample on the even grid, shape (n,), from 0."""
        if not self.segments:
            return np.zeros(0, dtype=np.int64)
        first = self.segments[0].offset
        return np.concatenate([np.arange(s.size) + (s.offset - first) for s in self.segments])

    def index_at(self, time_s: float) -> int:
        """Return the index of the first sample taken at `time_s` or later, in s from the first; n if none."""
        if not self.segments:
            return 0
        # A stamp on the grid counts as on time even when the product rounds up.
        place = time_s * self.rate_hz + self.segments[0].offset - 1e-6
        for segment in self.segments:
            if place <= segment.offset + segment.size - 1:
                return segment.start + max(0, int(np.ceil(place - segment.offset)))
        return self.n

    def slice(self, first: int, stop: int) -> "Clock":
        """Return the clock of the samples from index `first` to before `stop`."""
        segments = []
        for segment in self.segments:
            start, end = max(first, segment.start), min(stop, segment.stop)
            if start < end:
                offset = segment.offset + start - segment.start
                segments.append(Segment(start=start - first, stop=end - first, offset=offset))
        start_ns = self.start_ns
        if start_ns is not None and segments:
            start_ns += round((segments[0].offset - self.segments[0].offset) * self.tau0 * 1e9)
        return replace(self, segments=tuple(segments), start_ns=start_ns)

    def keeping(self, keep: NDArray[np.bool_]) -> "Clock":
        """Return the clock of the samples where `keep`, shape (n,), is true; the rest become gaps."""
        if keep.shape != (self.n,):
            msg = f"keep must have shape ({self.n},), got {keep.shape}"
            raise ValueError(msg)
        segments, start = [], 0
        for segment in self.segments:
            flags = np.zeros(segment.size + 2, dtype=np.int8)
            flags[1:-1] = keep[segment.start : segment.stop]
            steps = np.diff(flags)
            firsts, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
            for first, end in zip(firsts.tolist(), ends.tolist(), strict=True):
                stop = start + end - first
                segments.append(Segment(start=start, stop=stop, offset=segment.offset + first))
                start = stop
        return replace(self, segments=tuple(segments))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisSeries:
    """The samples of one axis.

    Attributes
    ----------
    sensor, axis
        What was measured: a gyroscope's rate in rad/s or an accelerometer's specific force in m/s^2.
    samples
        Shape (n,), read-only float64, SI. May hold NaN as read from a log; see `finite`.
    clock
        When they were taken; ``clock.n == n``.
    """

    sensor: Sensor
    axis: Axis
    samples: FloatArray
    clock: Clock

    def __post_init__(self) -> None:
        samples = np.asarray(self.samples, dtype=np.float64)
        if samples.ndim != 1:
            msg = f"samples must have shape (n,), got {samples.shape}"
            raise ValueError(msg)
        if samples.size != self.clock.n:
            msg = f"the clock has {self.clock.n} samples, the series {samples.size}"
            raise ValueError(msg)
        object.__setattr__(self, "samples", read_only(samples))

    @classmethod
    def from_samples(
        cls, samples: FloatArray, *, rate_hz: float, sensor: str = "gyroscope", axis: Axis = "x"
    ) -> "AxisSeries":
        """Return a series of your own samples, evenly spaced, in SI units.

        Raises
        ------
        ValueError
            If `samples` is not one-dimensional, or `rate_hz` is not positive.
        """
        array = np.asarray(samples, dtype=np.float64)
        clock = Clock.even(array.size, rate_hz)
        return cls(sensor=Sensor(sensor), axis=axis, samples=array, clock=clock)

    @property
    def name(self) -> str:
        """`gyro_x` … `accel_z`."""
        return f"{self.sensor.short}_{self.axis}"

    @property
    def unit(self) -> str:
        """SI unit of the samples."""
        return self.sensor.unit

    @property
    def n(self) -> int:
        """Number of samples."""
        return self.samples.size

    @property
    def rate_hz(self) -> float:
        """Sampling rate, in Hz."""
        return self.clock.rate_hz

    @property
    def tau0(self) -> float:
        """Sampling period, in s."""
        return self.clock.tau0

    @property
    def duration_s(self) -> float:
        """Time the samples span, gaps included, in s."""
        return self.clock.duration_s

    def keeping(self, keep: NDArray[np.bool_]) -> "AxisSeries":
        """Return the series of the samples where `keep` is true; the others become gaps."""
        if keep.all():
            return self
        return replace(self, samples=self.samples[keep], clock=self.clock.keeping(keep))

    def finite(self) -> "AxisSeries":
        """Return the series without NaN and infinite samples; they become gaps."""
        return self.keeping(np.isfinite(self.samples))

    def between(self, start_s: float, end_s: float) -> "AxisSeries":
        """Return the samples taken from `start_s` to before `end_s`, in s from the first sample.

        Copies nothing.
        """
        first, stop = self.clock.index_at(start_s), self.clock.index_at(end_s)
        return replace(self, samples=self.samples[first:stop], clock=self.clock.slice(first, stop))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Temperature:
    """The IMU's temperature, where the log has it.

    Attributes
    ----------
    samples
        Shape (n,), read-only float64, in degrees Celsius.
    clock
        When they were taken; the same object as an axis's where both stand in the same messages.
    """

    samples: FloatArray
    clock: Clock

    def __post_init__(self) -> None:
        object.__setattr__(self, "samples", read_only(np.asarray(self.samples, dtype=np.float64)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Where a recording comes from.

    Attributes
    ----------
    path
        The log, as the user named it.
    format
        ``csv``, ``mcap``, ``rosbag1``, ``rosbag2-sqlite3``, ``rosbag2-mcap``, …
    topics, message_types
        What was read, pairwise; for a table its column names and an empty tuple.
    decisions
        How each choice was made, such as ``("gyroscope unit", "deg/s, from the column header")``.
    """

    path: str
    format: str
    topics: tuple[str, ...] = ()
    message_types: tuple[str, ...] = ()
    decisions: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """All axes read from a log.

    Attributes
    ----------
    source
        Where it comes from.
    series
        The axes, gyroscope x, y, z first; the two sensors may have different clocks.
    temperature
        The IMU's temperature, or None.
    findings
        What reading the log showed: gaps, clocks, losses.
    """

    source: Source
    series: tuple[AxisSeries, ...]
    temperature: Temperature | None = None
    findings: tuple[Finding, ...] = ()

    def between(self, start_s: float, end_s: float) -> "Recording":
        """Return what was measured from `start_s` to before `end_s`, in s from the start of each clock.

        Raises
        ------
        DataError
            If nothing was measured then.
        """
        series = tuple(cut for one in self.series if (cut := one.between(start_s, end_s)).n)
        if not series:
            longest = max((one.duration_s for one in self.series), default=0.0)
            msg = (
                f"{self.source.path}: no samples from {start_s:g} s to {end_s:g} s; it lasts {longest:.6g} s"
            )
            raise DataError(msg)
        temperature = self.temperature
        if temperature is not None:
            clock = temperature.clock
            first, stop = clock.index_at(start_s), clock.index_at(end_s)
            temperature = Temperature(samples=temperature.samples[first:stop], clock=clock.slice(first, stop))
        return replace(self, series=series, temperature=temperature)

    def axis(self, sensor: str, axis: str) -> AxisSeries:
        """Return one axis, such as ``axis("gyroscope", "x")``.

        Raises
        ------
        DataError
            If the recording has no such axis.
        """
        for series in self.series:
            if series.sensor == sensor and series.axis == axis:
                return series
        found = ", ".join(series.name for series in self.series) or "none"
        msg = f"{self.source.path}: no axis {sensor} {axis}; found {found}"
        raise DataError(msg)
