"""The times of samples: an even grid with continuous segments of samples."""

from bisect import bisect_left
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Segment:
    """A run of samples without a gap, ``samples[start:stop]``; its first sample is at ``offset * tau0``."""

    start: int
    stop: int
    offset: int

    @property
    def size(self) -> int:
        """Number of samples."""
        return self.stop - self.start


@dataclass(frozen=True, kw_only=True)
class Gap:
    """Missing samples between two segments; `start_s` of the first, in s from the first sample."""

    start_s: float
    missing: int
    duration_s: float


@dataclass(frozen=True, kw_only=True)
class Clock:
    """The times of samples on an even grid.

    Attributes
    ----------
    source
        Origin of the times: ``header stamp``, ``log time``, ``column time_us``, ``given rate``.
    rate_hz
        Measured sampling rate: the inverse of tau0.
    segments
        Runs of samples without a gap, in order; they do not overlap on the grid.
    start_ns
        Time of the first sample, in ns of the stamps' own epoch; None without stamps.
    jitter_s
        Standard deviation of the stamps about the even grid, in s; None without stamps.
    apart
        Whether the sensor was moved between segments: then no difference of an Allan variance spans two.
    """

    source: str
    rate_hz: float
    segments: tuple[Segment, ...]
    start_ns: int | None = None
    jitter_s: float | None = None
    apart: bool = False

    def __post_init__(self) -> None:
        if not (np.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise ValueError(f"rate_hz must be positive and finite, got {self.rate_hz}")
        expected, place = 0, 0
        for segment in self.segments:
            if segment.start != expected or segment.stop <= segment.start or segment.offset < place:
                raise ValueError(f"segments must follow each other and not overlap, got {segment}")
            expected, place = segment.stop, segment.offset + segment.size

    @classmethod
    def even(cls, n: int, rate_hz: float, *, source: str = "given rate") -> "Clock":
        """Return the clock of `n` samples without a gap."""
        segments = (Segment(0, n, 0),) if n else ()
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
        """Number of places on the even grid from the first sample to the last."""
        if not self.segments:
            return 0
        first, last = self.segments[0], self.segments[-1]
        return last.offset + last.size - first.offset

    @property
    def duration_s(self) -> float:
        """Time the grid spans, in s."""
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

    def grid(self, first: int = 0, stop: int | None = None) -> NDArray[np.int64]:
        """Place of each sample from index `first` to before `stop` on the even grid, from 0."""
        places = [np.zeros(0, dtype=np.int64)]
        for segment in self.segments:
            start, end = max(first, segment.start), segment.stop if stop is None else min(stop, segment.stop)
            if start < end:
                moved = segment.offset - segment.start - self.segments[0].offset
                places.append(np.arange(start + moved, end + moved))
        return places[1] if len(places) == 2 else np.concatenate(places)

    def index_at(self, time_s: float) -> int:
        """Return the index of the first sample taken at `time_s` or later, in s from the first; n if none."""
        # The product may round up for a time on the grid.
        return self.index_from(float(np.ceil(time_s * self.rate_hz - 1e-6)))

    def index_from(self, place: float) -> int:
        """Return the index of the first sample at or after a place of the grid; n if none."""
        at = bisect_left(self.segments, place, key=lambda s: s.offset + s.size - self.segments[0].offset - 1)
        if at == len(self.segments):
            return self.n
        segment = self.segments[at]
        return segment.start + max(0, int(place) - segment.offset + self.segments[0].offset)

    def slice(self, first: int, stop: int) -> "Clock":
        """Return the clock of the samples from index `first` to before `stop`."""
        segments = []
        for segment in self.segments:
            start, end = max(first, segment.start), min(stop, segment.stop)
            if start < end:
                offset = segment.offset + start - segment.start
                segments.append(Segment(start - first, end - first, offset))
        return self._of(segments)

    def keeping(self, keep: NDArray[np.bool_]) -> "Clock":
        """Return the clock of the samples where `keep`, shape (n,), is true; the rest become gaps."""
        if keep.shape != (self.n,):
            raise ValueError(f"keep must have shape ({self.n},), got {keep.shape}")
        segments, start = [], 0
        for segment in self.segments:
            flags = np.zeros(segment.size + 2, dtype=np.int8)
            flags[1:-1] = keep[segment.start : segment.stop]
            steps = np.diff(flags)
            firsts, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
            for first, end in zip(firsts.tolist(), ends.tolist(), strict=True):
                stop = start + end - first
                segments.append(Segment(start, stop, segment.offset + first))
                start = stop
        return self._of(segments)

    def _of(self, segments: list[Segment]) -> "Clock":
        start_ns = self.start_ns
        if start_ns is not None and segments:
            start_ns += round((segments[0].offset - self.segments[0].offset) * self.tau0 * 1e9)
        return replace(self, segments=tuple(segments), start_ns=start_ns)
