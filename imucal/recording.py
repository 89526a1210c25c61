"""Sensors, axes and recordings, always in SI units."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray, ReadOnlyArrays, blocks, read_only
from imucal.clock import Clock
from imucal.display import Displayed
from imucal.errors import ArgumentError, DataError, MissingError
from imucal.findings import Finding
from imucal.user_input import seconds_of

Axis: TypeAlias = Literal["x", "y", "z"]

AXES: tuple[Axis, ...] = ("x", "y", "z")

#: A finding of more missing samples is a warning.
_FEW = 1e-3
#: Larger values are damage in any unit: counts of 48 bits are smaller. Sums of fourth powers can't overflow.
ABSURD = 1e15
#: A smaller range of values is no measurement in any unit: white noise of the best sensors is above 1e-12.
#: Products of four powers can't underflow.
TINY = 1e-30


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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AxisSeries(Displayed):
    """The samples of one axis.

    Attributes
    ----------
    sensor, axis
        A gyroscope measures the rate in rad/s, an accelerometer the specific force in m/s^2.
    samples
        Shape (n,), read-only float64, SI. May contain NaN as read from a log; see `finite`.
    clock
        Times of the samples; ``clock.n == n``.
    """

    sensor: Sensor
    axis: Axis
    samples: FloatArray
    clock: Clock
    #: Whether all samples are usable, so that steps after the first skip the test.
    _known_finite: bool = field(default=False, init=False, repr=False)

    def __post_init__(self) -> None:
        samples = np.asarray(self.samples, dtype=np.float64)
        if samples.ndim != 1:
            raise ArgumentError(f"samples must have shape (n,), got {samples.shape}")
        if samples.size != self.clock.n:
            raise ArgumentError(f"the clock has {self.clock.n} samples, the series {samples.size}")
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
        """Return the series without NaN, infinite and absurd samples; they become gaps."""
        if not self._known_finite:
            if not all(bool(_sane(self.samples[part]).all()) for part in blocks(self.n)):
                return self.keeping(self.usable)
            object.__setattr__(self, "_known_finite", True)
        return self

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Which samples are not NaN and within `ABSURD`, shape (n,)."""
        keep = np.empty(self.n, dtype=np.bool_)
        for part in blocks(self.n):
            keep[part] = _sane(self.samples[part])
        return keep

    def between(self, start_s: float, end_s: float) -> "AxisSeries":
        """Return the samples from `start_s` to before `end_s`, in s from the first sample; copies nothing."""
        first, stop = self.clock.index_at(start_s), self.clock.index_at(end_s)
        return replace(self, samples=self.samples[first:stop], clock=self.clock.slice(first, stop))


@dataclass(frozen=True, kw_only=True, eq=False)
class Temperature(ReadOnlyArrays):
    """The IMU's temperature in degrees Celsius, shape (n,), read-only float64.

    If it is in the messages of an axis, both share one clock object.
    """

    samples: FloatArray
    clock: Clock


@dataclass(frozen=True, kw_only=True, eq=False)
class StampTrace(ReadOnlyArrays):
    """The time stamps of a log as they are, thinned to the extremes of parts of it, for pictures.

    `interval_s`, shape (k,), are the times since the previous stamp at the samples `index`. `late_s`, shape
    (j,), are log time minus stamp at the samples `compared`; empty without a log time besides the stamps.
    """

    index: IntArray
    interval_s: FloatArray
    compared: IntArray
    late_s: FloatArray


@dataclass(frozen=True, kw_only=True)
class LogFileInfo:
    """A file of a log, with its path as it was read, and its checksum.

    A URL has neither user nor query. `blake2b` is the BLAKE2b checksum of 64 bytes (RFC 7693), as ``b2sum``
    prints it; None if the file could not be read to its end. `etag` is the ETag of the object behind a URL,
    or the time of its last change.
    """

    path: str
    size_bytes: int
    blake2b: str | None = None
    etag: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", _as_text(self.path))


@dataclass(frozen=True, kw_only=True)
class ReadRange:
    """The part of a log that was read, over all its axes, gaps included.

    `from_s` is the omitted time before it, in s from the first sample. `start_ns` and `end_ns` are its time
    stamps in ns of their epoch, or None without stamps.
    """

    from_s: float = 0.0
    duration_s: float
    start_ns: int | None = None
    end_ns: int | None = None

    @classmethod
    def of(cls, series: Sequence[AxisSeries], *, from_s: float = 0.0) -> "ReadRange":
        if (span := span_ns(series)) is None:
            return cls(from_s=from_s, duration_s=max(one.duration_s for one in series))
        start, end = span
        return cls(from_s=from_s, duration_s=(end - start) / 1e9, start_ns=start, end_ns=end)


def span_ns(series: Iterable[AxisSeries]) -> tuple[int, int] | None:
    """Return the time of the first sample and the end of the last one, in ns; None without stamps."""
    spans = [(c.start_ns, c.duration_s) for one in series if (c := one.clock).start_ns is not None]
    return (min(spans)[0], max(start + round(length * 1e9) for start, length in spans)) if spans else None


#: Value of the unit of samples that stay raw counts.
RAW_COUNTS = "count"


@dataclass(frozen=True, kw_only=True)
class Source:
    """The origin of a recording: the path of the log, and its format such as ``rosbag2-mcap``.

    `topics` and `message_types` are pairs; for a table, `topics` contains column names and there are no
    types. `decisions` contains each choice and its reason, such as ``("gyroscope unit", "deg/s, from the
    column header")``. `values` are answers without reasons, for programs: frame, layout and units, such as
    ``{"gyroscope unit": "deg/s"}``; reports do not contain them. `files` contains sizes and checksums:
    always for standard input, otherwise on request. `read` is the range that was read; None for the whole
    log.
    """

    path: str
    format: str
    topics: tuple[str, ...] = ()
    message_types: tuple[str, ...] = ()
    decisions: tuple[tuple[str, str], ...] = ()
    values: Mapping[str, str] = field(default_factory=dict, compare=False, repr=False)
    files: tuple[LogFileInfo, ...] = ()
    read: ReadRange | None = None

    @property
    def name(self) -> str:
        """The name of the file or folder without its path."""
        return self.path.rstrip("/").rsplit("/", 1)[-1] or self.path

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", _as_text(self.path))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Recording(Displayed):
    """All axes read from a log.

    Attributes
    ----------
    series
        The axes, gyroscope x, y, z first; the two sensors may have different clocks.
    temperature
        The IMU's temperature, or None.
    findings
        Findings of the reader: gaps, clocks, losses.
    stamps
        The time stamps of each clock, thinned; empty without stamps.
    """

    source: Source
    series: tuple[AxisSeries, ...]
    temperature: Temperature | None = None
    findings: tuple[Finding, ...] = ()
    stamps: tuple[StampTrace, ...] = ()

    def between(self, start_s: float, end_s: float) -> "Recording":
        """Return the samples from `start_s` to before `end_s`, in s from the start of each clock.

        Raises
        ------
        DataError
            If there are no samples in this time.
        """
        # Axes that share a clock object must share it afterwards, too.
        clocks = {id(one.clock): one.between(start_s, end_s).clock for one in self.series}
        cuts = [replace(one.between(start_s, end_s), clock=clocks[id(one.clock)]) for one in self.series]
        series = tuple(cut for cut in cuts if cut.n)
        if not series:
            longest = max((one.duration_s for one in self.series), default=0.0)
            where = (
                f"from {start_s:g} s on" if end_s == float("inf") else f"from {start_s:g} s to {end_s:g} s"
            )
            problem = f"no samples {where}; it lasts {longest:.6g} s"
            raise DataError(problem, place=self.source.path)
        temperature = self.temperature
        if temperature is not None:
            clock = temperature.clock
            first, stop = clock.index_at(start_s), clock.index_at(end_s)
            temperature = Temperature(samples=temperature.samples[first:stop], clock=clock.slice(first, stop))
        before = self.source.read.from_s if self.source.read is not None else 0.0
        source = replace(self.source, read=ReadRange.of(series, from_s=before + start_s))
        others = [finding for finding in self.findings if finding.code != "gaps"]
        findings = tuple(dict.fromkeys([*others, *gap_findings(one.clock for one in series)]))
        return replace(self, source=source, series=series, temperature=temperature, findings=findings)

    def skip(self, length: str | float) -> "Recording":
        """Return the recording without its start, such as ``skip("60s")`` or ``skip("5min")``."""
        return self.between(seconds_of(length), np.inf)

    def take(self, length: str | float) -> "Recording":
        """Return the start of the recording, such as ``take("1h")``."""
        return self.between(0.0, seconds_of(length))

    def axis(self, sensor: str, axis: str) -> AxisSeries:
        """Return one axis, such as ``axis("gyroscope", "x")`` or ``axis("gyro", "x")``.

        Raises
        ------
        DataError
            If the recording has no such axis.
        """
        for series in self.series:
            if sensor in {series.sensor, series.sensor.short} and series.axis == axis:
                return series
        raise DataError(f"no axis {sensor} {axis}; {self._names}", place=self.source.path)

    def __getitem__(self, name: str) -> AxisSeries:
        for series in self.series:
            if series.name == name:
                return series
        raise MissingError(f"no axis {name!r}; {self._names}", place=self.source.path)

    @property
    def rate_hz(self) -> float:
        """Sampling rate of all axes, in Hz.

        Raises
        ------
        DataError
            If the sensors have different rates.
        """
        rates = {one.rate_hz for one in self.series}
        if len(rates) != 1:
            found = ", ".join(f"{one.name} {one.rate_hz:.6g} Hz" for one in self.series) or "no axis"
            raise DataError(
                f"{self.source.path}: no common rate: {found}; choose an axis: recording['gyro_x']"
            )
        return rates.pop()

    @property
    def _names(self) -> str:
        return f"found {', '.join(series.name for series in self.series) or 'none'}"


def gap_findings(clocks: Iterable[Clock]) -> Iterator[Finding]:
    """Yield a finding for each clock with missing samples."""
    for clock in {id(clock): clock for clock in clocks if clock.gaps}.values():
        gaps, share = clock.gaps, clock.missing / clock.grid_size
        longest = max(gaps, key=lambda gap: gap.missing)
        samples, are = ("sample", "is") if clock.missing == 1 else ("samples", "are")
        text = (
            f"{clock.missing} {samples} ({share:.2g} of all) {are} missing in "
            f"{'one gap' if len(gaps) == 1 else f'{len(gaps)} gaps'}; "
            f"the longest is {longest.duration_s:.4g} s at {longest.start_s:.6g} s."
        )
        yield Finding("warning" if share > _FEW else "info", "gaps", text)


def _sane(samples: FloatArray) -> NDArray[np.bool_]:
    return (samples > -ABSURD) & (samples < ABSURD)


def _as_text(path: str) -> str:
    return path.encode("utf-8", "backslashreplace").decode()
